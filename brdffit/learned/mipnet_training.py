"""Training of the method ``mipnet``: one patch a step, all its levels, with the L1 loss of tone-mapped renderings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import numba_type, types
from brdffit.fitting.batch import model_kernels
from brdffit.halfangle.objective import lobe_values_type, log_normalisation_type, moments_type
from brdffit.learned.crops import SIDE, Source
from brdffit.learned.judging import figure_of, judged_patches
from brdffit.learned.kernels.rendering import seen_rows, tonemapped_rows
from brdffit.learned.latent import OUTPUTS, lifted
from brdffit.learned.latent_losses import half_vectors
from brdffit.learned.mipnet import HIDDEN, INPUTS, KIND, TEXEL, MipNetwork, fours, fours_back
from brdffit.learned.tasks import ChainTask
from brdffit.roughness import DEFAULT_MIN_ROUGHNESS
from brdffit.svbrdf import Svbrdf

#: Levels predicted from a patch, 16 x 16 to 1 x 1, and half vectors that all of them are rendered from.
LEVELS, HALVES = 5, 32
#: Longest gradient of a texel, with normals in units of its lobe's width, times the number of texels.
_STEEPEST = 10.0


class MipnetTask(ChainTask):
    """The network and the sets that its patches are cut from.

    Args:
        sources, held_out: see ``SetsTask``.
        seed: of initial weights and patches.
    """

    kind, rates = KIND, (1e-3, 1e-5)

    def __init__(self, sources: Sequence[str | Path], held_out: Sequence[str | Path], seed: int) -> None:
        super().__init__(sources, held_out)
        rng = np.random.default_rng(seed)
        self.network = MipNetwork(rng)
        self.sets = [Source(each) for each in self.sources]
        self.judged = judged_patches(self.judging, rng)

    def accumulate(self, rng: np.random.Generator) -> float:
        """Add the gradient of one patch; returns its loss."""
        normal, tensor, light = self.sets[int(rng.integers(len(self.sets)))].patch(rng)
        return learn_patch(self.network, normal, tensor, light, half_vectors(HALVES, rng))

    def figure(self) -> float:
        """Mean over sets and levels of the SNR in dB, on held-out sets."""
        return figure_of(self.judged, lambda svbrdf: say_levels(self.network, svbrdf))

    def meta(self) -> dict[str, Any]:
        """Provenance."""
        return {
            "architecture": {"inputs": INPUTS, "hidden": list(HIDDEN), "outputs": TEXEL},
            "loss": f"L1 of log(1 + radiance), {HALVES} half vectors, {LEVELS} levels",
            **self.provenance(),
        }


def texels_of(normal: NDArray, log_roughness: NDArray) -> NDArray:
    """(H, W, TEXEL) float64 of normals and log tensors (H, W, 3)."""
    return np.concatenate([normal[..., :2], log_roughness], axis=2, dtype=np.float64)


def say_levels(network: MipNetwork, svbrdf: Svbrdf) -> list[NDArray]:
    """Outputs (h * w, OUTPUTS) of the levels of a base, down to the first with an odd side, as of ``latent``."""
    image, levels = texels_of(svbrdf.normal, svbrdf.log_roughness), []
    while True:
        said = np.zeros((image.shape[0] * image.shape[1], OUTPUTS))
        said[:, :TEXEL] = image.reshape(-1, TEXEL)
        levels.append(said)
        if image.shape[0] % 2 or image.shape[1] % 2:
            return levels
        texels, _ = network.forward(fours(image))
        image = texels.reshape(image.shape[0] // 2, image.shape[1] // 2, TEXEL)


def learn_patch(network: MipNetwork, normal: NDArray, tensor: NDArray, light: NDArray, half: NDArray) -> float:
    """Mean loss of the levels of a patch (SIDE, SIDE); adds to the gradient.

    The rendering of the base, averaged over each footprint, is the truth for the lobes of each level.
    """
    kernels = model_kernels("ggx", "ggx")
    image = texels_of(normal, tensor)
    seen = np.zeros((SIDE * SIDE, half.shape[1]))
    slopes = lobes_of(image.reshape(-1, TEXEL))
    seen_rows(slopes, light.reshape(-1).astype(np.float64), half, seen, kernels.values, kernels.log_normalisation)
    truth, scale = seen.reshape(SIDE, SIDE, -1), light.astype(np.float64)[..., None]
    steps, gradients, total = [], [], 0.0
    for _ in range(LEVELS):
        side = image.shape[0] // 2
        texels, step = network.forward(fours(image), keep=True)
        steps.append(step)
        truth, scale = (
            fours(truth).mean(axis=1).reshape(side, side, -1),
            fours(scale).mean(axis=1).reshape(side, side, 1),
        )
        loss, by_texel = rendered_loss(texels, scale.reshape(-1), half, truth.reshape(side * side, -1))
        total += loss / LEVELS
        gradients.append(by_texel / LEVELS)
        image = texels.reshape(side, side, TEXEL)
    carried = np.zeros_like(gradients[-1])
    for step, by_texel in zip(reversed(steps), reversed(gradients), strict=True):
        carried = network.backward(by_texel + carried, step)
        side = 2 * math.isqrt(len(by_texel))
        carried = fours_back(carried, (side, side)).reshape(-1, TEXEL)
    return total


def lobes_of(texels: NDArray) -> NDArray:
    """(n, 5) slopes and log tensor of texels (n, TEXEL)."""
    normal = lifted(texels[:, :2])
    return np.concatenate([-normal[:, :2] / normal[:, 2:], texels[:, 2:]], axis=1)


def rendered_loss(texels: NDArray, scale: NDArray, half: NDArray, truth: NDArray) -> tuple[float, NDArray]:
    """Mean loss of texels (n, TEXEL) with scales (n,), and its gradient (n, TEXEL).

    They are rendered from ``half`` (3, J) and compared with ``truth`` (n, J). With slopes m = -xy / z,
    dm/dxy = -(I + m m') / z.
    """
    kernels = model_kernels("ggx", "ggx")
    theta, by_theta = lobes_of(texels), np.zeros((len(texels), 5))
    low = 4.0 * math.log(DEFAULT_MIN_ROUGHNESS)
    loss = _tonemapped_kernel()(
        theta, scale, half, truth, low, by_theta, kernels.moments, kernels.values, kernels.log_normalisation
    )
    by_theta = np.where(np.isfinite(by_theta).all(axis=1, keepdims=True), by_theta, 0.0)
    slopes, by_slopes = theta[:, :2], by_theta[:, :2]
    z = 1.0 / np.sqrt(1.0 + np.square(slopes).sum(axis=1, keepdims=True))
    by_xy = -(by_slopes + (by_slopes * slopes).sum(axis=1, keepdims=True) * slopes) / z
    gradient = np.concatenate([by_xy, by_theta[:, 2:]], axis=1)
    width = np.exp(0.25 * (texels[:, 2:3] + texels[:, 3:4]))
    length = np.sqrt((np.square(by_xy) * width**2).sum(axis=1) + np.square(by_theta[:, 2:]).sum(axis=1)) * len(texels)
    return float(loss), gradient * np.minimum(1.0, _STEEPEST / np.maximum(length, 1e-12))[:, None]


@cache
def _tonemapped_kernel() -> Any:
    """``tonemapped_rows``, compiled for function-typed arguments so that it can be cached on disk."""
    line, square, half = np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1), np.float32)
    floats, normalisation = types.float32, log_normalisation_type
    data = tuple(map(numba_type, (square, line, half, square, 0.0, square)))
    tonemapped_rows.compile((*data, moments_type(floats), lobe_values_type(floats), normalisation))
    tonemapped_rows.disable_compile()
    return tonemapped_rows
