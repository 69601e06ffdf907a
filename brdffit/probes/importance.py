"""Filtered importance sampling, which Manson and Sloan 2016 compare with: Hammersley points, levels by equation 4."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit.probes.downsampling import ColourPyramid, layout_of
from brdffit.probes.kernels.importance import filter_by_importance, place_samples
from brdffit.probes.kernels.pyramid import fold_level
from brdffit.probes.kernels.tables import TAP_FIELDS, splat_taps
from brdffit.probes.lobe import half_angles
from brdffit.probes.parallel import over_rows
from brdffit.probes.tables import BASE_SIZE, Goal


def lobe_samples(count: int, alpha: float) -> NDArray:
    """(at most count, 4) directions l in the frame of the normal, and the solid angle that each stands for.

    Half vectors follow D at the Hammersley points, and l is the normal mirrored in them; directions below the horizon
    are left out. The solid angle is 4 pi / (N D), as in equation 4. (The density D/4 of l would give 4 / (N D), a third
    of it; small counts then err less and large ones more.)
    """
    k = np.arange(count)
    reversed_bits = np.zeros(count)
    for bit in range(32):
        reversed_bits += ((k >> bit) & 1) * 0.5 ** (bit + 1)
    turn, u = 2.0 * np.pi * (k + 0.5) / count, reversed_bits
    half, density = half_angles(u, alpha)
    sine, cosine = np.sin(2.0 * half), np.cos(2.0 * half)
    samples = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine, 4.0 * np.pi / (count * density)], axis=1)
    return np.ascontiguousarray(samples[cosine > 0.0])


def preimage_errors(goal: Goal, alpha: float, count: int) -> NDArray:
    """(T,) L1 between the preimage of ``count`` samples and the exact one, at the texels of a goal (Table 1)."""
    layout, samples, errors = layout_of(BASE_SIZE), lobe_samples(count, alpha), []
    taps = np.empty((len(samples), TAP_FIELDS))
    for (face, u, v), wanted in zip(goal.texels, goal.wanted, strict=True):
        flat, weights = np.zeros(layout.offsets[-1]), np.zeros((6, 1, 1))
        place_samples(samples, int(face), u, v, 4.0 / BASE_SIZE**2, taps)
        total = splat_taps(taps, len(taps), flat, layout.offsets, layout.sizes, 0)
        for level in range(len(layout.sizes) - 1, -1, -1):
            fold_level(flat, layout.offsets[level], *layout.borders[level])
            weights = layout.interior(flat, level) + weights
            if level:
                weights = (0.25 * weights).repeat(2, axis=1).repeat(2, axis=2)
        errors.append(np.abs(weights.ravel() / total - wanted).sum())
    return np.array(errors)


def filtered_by_importance(
    pyramid: ColourPyramid, n: int, alpha: float, count: int, threads: int = 1
) -> NDArray:  # fmt: skip
    """A level (6, n, n, 3) float32 by ``count`` samples a texel of a pyramid of plain means."""
    layout, flat = pyramid
    samples, out = lobe_samples(count, alpha), np.empty((6, n, n, 3), np.float32)

    def rows(first: int, last: int) -> None:
        filter_by_importance(samples, n, first, last, flat, layout.offsets, layout.sizes, out)

    over_rows(rows, 6 * n, threads)
    return out
