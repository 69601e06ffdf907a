"""Training of the method ``learned``: corrections of closed forms against the exact half-angle objective."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.learned import residual
from brdffit.learned.data import VARIANTS, footprints, read_set, training_table
from brdffit.learned.kernels import moments
from brdffit.learned.kernels.moments import features_of
from brdffit.learned.kernels.saying import MOST
from brdffit.learned.kernels.tables import Table, errors_of
from brdffit.learned.network import KIND, OUTPUTS, ResidualNetwork, difference
from brdffit.learned.residual import CORRECTIONS, compose, pull_back
from brdffit.learned.tasks import ChainTask

#: Texels of a batch.
BATCH = 4096
#: Texels of the training table.
TEXELS = 160_000
HIDDEN = (32, 16)
# The loss of a texel is log(e + this): errors above it count relative to themselves.
_FLOOR = 0.02
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
        self.table = training_table(self.sources, texels, rng)
        features, self.closed = features_of(self.table.moments)
        self.network.cover(features)
        self.inputs, self.difference = self.network.normalised(features), difference(features)[:, None]
        self.judged = [
            footprints(read_set(each), level, _HELD_OUT_TEXELS, rng)
            for each in self.judging
            for level in _HELD_OUT_LEVELS
        ]

    def accumulate(self, rng: np.random.Generator) -> float:
        """Add the gradient of one batch of random texels, with axes reversed at random; returns its loss."""
        index = rng.integers(0, len(self.table), BATCH)
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
        loss, gradient = loss_of(self.table, index, closed, out)
        self.network.chain.backward((gradient * signs / BATCH).astype(np.float32))
        return loss

    def figure(self) -> float:
        """Mean over sets and levels of the SNR in dB, on held-out sets."""
        return float(np.mean([-10.0 * np.log10(np.mean(error_of(self.network, table))) for table in self.judged]))

    def meta(self) -> dict[str, Any]:
        """Provenance."""
        return {
            "architecture": self.network.architecture(),
            "loss": f"mean of log(e + {_FLOOR}), e the half-angle error of the lobe at its best scale",
            **self.provenance(),
            "variants": [list(each) for each in VARIANTS],
            "texels": len(self.table),
            "batch": BATCH,
        }


def loss_of(table: Table, index: NDArray, closed: NDArray, out: NDArray) -> tuple[float, NDArray]:
    """Mean loss of outputs (n, OUTPUTS), and the gradient of each texel's loss (n, OUTPUTS), not divided by n.

    The scale is learned separately from the lobe. With k = exp(s) times the length of the filtered colour and k* the
    best scale, the error at k is e + w (k - k*)^2, where e is the error at the best scale. The lobe gets the gradient
    of e alone and s that of the square alone, both weighted by 1 / (e + floor).
    """
    d = np.clip(out[:, :CORRECTIONS], -MOST, MOST)
    found = errors_of(table, index, compose(closed, d))
    fine = np.isfinite(found.error) & np.isfinite(found.gradient).all(axis=1)
    error = np.where(fine, np.maximum(found.error, 0.0), 1.0)
    weight = np.where(fine, 1.0 / (error + _FLOOR), 0.0)
    gradient = np.zeros_like(out)
    gradient[:, :CORRECTIONS] = pull_back(closed, d, np.where(fine[:, None], found.gradient, 0.0)) * weight[:, None]
    length = np.linalg.norm(gradient[:, :CORRECTIONS], axis=1, keepdims=True)
    gradient[:, :CORRECTIONS] *= np.minimum(1.0, _STEEPEST / np.maximum(length, 1e-12))
    scale = table.colour[index] * np.exp(np.clip(out[:, CORRECTIONS], -2.0, 2.0))
    wrong = scale - found.scale
    # Clipping turns the squared error into a linear one where the scale is far off, so that it does not dominate.
    by_scale = 2.0 * np.clip(found.weight * weight * wrong * scale, -1.0, 1.0)
    gradient[:, CORRECTIONS] = np.where(fine, by_scale, 0.0)
    return float(np.mean(np.log(error + _FLOOR))), gradient


def error_of(network: ResidualNetwork, table: Table) -> NDArray:
    """Relative squared errors (n,) of the network's lobes, with its scales, on a table."""
    predicted = network.predict(table.moments)
    found = errors_of(table, np.arange(len(table)), predicted.theta)
    return np.clip(found.error, 0.0, None) + found.weight * (table.colour * predicted.factor - found.scale) ** 2
