"""Training of the method ``learned``: corrections of closed forms by the error on a screen.

The error on a screen under lights with a size is what the default fit minimises; a share of the half-angle error under
point lights keeps the lobe right where a light is small. Both are exact (``kernels.displayed``, ``kernels.tables``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.learned import residual
from brdffit.learned.data import EDGED, VARIANTS, Footprints, footprints, read_set, training_data
from brdffit.learned.kernels import moments
from brdffit.learned.kernels.displayed import BOUNDS, LIGHTS, shown_errors
from brdffit.learned.kernels.moments import features_of
from brdffit.learned.kernels.saying import LOG_MOST, MOST
from brdffit.learned.kernels.tables import errors_of
from brdffit.learned.network import KIND, OUTPUTS, ResidualNetwork, difference
from brdffit.learned.residual import CORRECTIONS, compose, pull_back
from brdffit.learned.tasks import ChainTask

#: Texels of a batch.
BATCH = 4096
#: Texels of the training table.
TEXELS = 60_000
HIDDEN = (32, 16)
#: Share of the half-angle error under point lights in the loss; the rest is the error on a screen under ``LIGHTS``.
POINT_SHARE = 0.15
# The losses are log(e + these): errors above them count relative to themselves.
_FLOOR, _POINT_FLOOR = 0.02, 0.02
#: Longest gradient of a texel, so that a few texels with steep errors do not dominate a step.
_STEEPEST = 3.0
_HELD_OUT_LEVELS, _HELD_OUT_TEXELS = (1, 2, 3, 4, 5), 200


class ResidualTask(ChainTask):
    """The network, its training table, and held-out footprints.

    Args:
        sources, held_out: see ``SetsTask``.
        seed: of initial weights and of the table.
        texels: approximate number of footprints of the table.
    """

    kind, rates = KIND, (3e-3, 3e-5)

    def __init__(
        self, sources: Sequence[str | Path], held_out: Sequence[str | Path], seed: int, texels: int = TEXELS
    ) -> None:
        super().__init__(sources, held_out)
        rng = np.random.default_rng(seed)
        self.network = ResidualNetwork(HIDDEN, rng)
        self.data = training_data(self.sources, texels, rng)
        features, self.closed = features_of(self.data.point.moments, self.data.shown.glow)
        self.network.cover(features)
        self.inputs, self.difference = self.network.normalised(features), difference(features)[:, None]
        self.judged = [
            footprints(read_set(each), level, _HELD_OUT_TEXELS, rng)
            for each in self.judging
            for level in _HELD_OUT_LEVELS
        ]

    def accumulate(self, rng: np.random.Generator) -> float:
        """Add the gradient of one batch of random texels, with axes reversed at random; returns its loss."""
        index = rng.integers(0, len(self.data), BATCH)
        inputs, closed = self.inputs[index].copy(), self.closed[index]
        signs = np.repeat(self.difference[index], OUTPUTS, axis=1)
        mean, deviation = self.network.mean, self.network.deviation
        for odd, outs in (
            (moments.FIRST_ODD, residual.FIRST_ODD), (moments.SECOND_ODD, residual.SECOND_ODD)
        ):  # fmt: skip
            turned = rng.random(BATCH) < 0.5
            for k in odd:
                inputs[turned, k] = -inputs[turned, k] - np.float32(2.0 * mean[k] / deviation[k])
            for k in outs:
                signs[turned, k] *= -1.0
        out = self.network.chain.forward(inputs, keep=True).astype(np.float64) * signs
        loss, gradient = loss_of(self.data, index, closed, out)
        self.network.chain.backward((gradient * signs / BATCH).astype(np.float32))
        return loss

    def figure(self) -> float:
        """Mean over sets and levels of the SNR in dB, on held-out sets."""
        return float(np.mean([-10.0 * np.log10(np.mean(error_of(self.network, each))) for each in self.judged]))

    def meta(self) -> dict[str, Any]:
        """Provenance."""
        return {
            "architecture": self.network.architecture(),
            "loss": f"{1.0 - POINT_SHARE:g} log(e + {_FLOOR}) + {POINT_SHARE:g} log(e' + {_POINT_FLOOR}), "
            f"e the error on a screen under the lights '{LIGHTS}', scale within {BOUNDS[0]:g} to {BOUNDS[1]:g}, "
            "e' the half-angle error under point lights",
            "lights": LIGHTS,
            "random_variants": EDGED,
            **self.provenance(),
            "variants": [list(each) for each in VARIANTS],
            "texels": len(self.data),
            "batch": BATCH,
        }


def loss_of(data: Footprints, index: NDArray, closed: NDArray, out: NDArray) -> tuple[float, NDArray]:
    """Mean loss of outputs (n, OUTPUTS), and the gradient of each texel's loss (n, OUTPUTS), not divided by n.

    The loss is (1 - ``POINT_SHARE``) log(e + floor) + ``POINT_SHARE`` log(e' + floor'), e the error on a screen of the
    lobe at its best bounded scale, e' its half-angle error under point lights at its best scale. The scale is learned
    separately from the lobe: with k = exp(s) and k* the scale that the default fit would give the lobe, both over the
    filtered colour, s gets the gradient of w (k - k*)^2 / (e + floor), by which e grows at another scale.
    """
    d = np.clip(out[:, :CORRECTIONS], -MOST, MOST)
    theta = compose(closed, d)
    shown, point = shown_errors(data.shown, index, theta), errors_of(data.point, index, theta)
    loss, by_theta, fine = 0.0, np.zeros_like(theta), np.ones(len(theta), np.bool_)
    for found, share, floor in ((shown, 1.0 - POINT_SHARE, _FLOOR), (point, POINT_SHARE, _POINT_FLOOR)):
        fine &= np.isfinite(found.error) & np.isfinite(found.gradient).all(axis=1)
        error = np.where(fine, np.maximum(found.error, 0.0), 1.0) + floor
        loss += share * float(np.mean(np.log(error)))
        by_theta += np.where(fine[:, None], found.gradient, 0.0) * (share / error)[:, None]
    gradient = np.zeros_like(out)
    gradient[:, :CORRECTIONS] = pull_back(closed, d, by_theta)
    length = np.linalg.norm(gradient[:, :CORRECTIONS], axis=1, keepdims=True)
    gradient[:, :CORRECTIONS] *= np.minimum(1.0, _STEEPEST / np.maximum(length, 1e-12))
    scale = np.exp(np.clip(out[:, CORRECTIONS], -2.0 * LOG_MOST, 2.0 * LOG_MOST))
    weight = shown.weight / (np.maximum(shown.error, 0.0) + _FLOOR)
    # Clipping turns the squared error into a linear one where the scale is far off, so that it does not dominate.
    by_scale = 2.0 * np.clip(weight * (scale - shown.scale) * scale, -1.0, 1.0)
    gradient[:, CORRECTIONS] = np.where(fine, by_scale, 0.0)
    gradient[~fine] = 0.0
    return loss, gradient


def error_of(network: ResidualNetwork, data: Footprints) -> NDArray:
    """Half-angle errors (n,) of the network's lobes, with its scales."""
    table, predicted = data.point, network.predict(data.point.moments, data.shown.glow)
    found = errors_of(table, np.arange(len(table)), predicted.theta)
    return np.clip(found.error, 0.0, None) + found.weight * (table.colour * predicted.factor - found.scale) ** 2


def shown_error_of(network: ResidualNetwork, data: Footprints) -> NDArray:
    """Errors on a screen (n,) of the network's lobes, with its scales."""
    predicted = network.predict(data.point.moments, data.shown.glow)
    found = shown_errors(data.shown, np.arange(len(data)), predicted.theta)
    return np.clip(found.error, 0.0, None) + found.weight * (predicted.factor - found.scale) ** 2
