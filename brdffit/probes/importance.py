"""Filtered importance sampling, which Manson and Sloan 2016 compare with: Hammersley points, levels by equation 4."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit.probes.kernels.importance import box_pyramid, filter_by_importance, importance_errors
from brdffit.probes.parallel import over_rows
from brdffit.probes.tables import Goal, layout_of


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
    half = np.arctan(alpha * np.sqrt(u / (1.0 - u)))
    density = alpha**2 / (np.pi * np.square(np.cos(half) ** 2 * (alpha**2 - 1.0) + 1.0))
    sine, cosine = np.sin(2.0 * half), np.cos(2.0 * half)
    samples = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine, 4.0 * np.pi / (count * density)], axis=1)
    return np.ascontiguousarray(samples[cosine > 0.0])


def preimage_errors(goal: Goal, alpha: float, count: int) -> NDArray:
    """(T,) L1 between the preimage of ``count`` samples and the exact one, at the texels of a goal (Table 1)."""
    layout = layout_of()
    errors, flat = np.empty(len(goal.texels)), np.zeros(layout.offsets[-1])
    borders = tuple(tuple(each) for each in layout.borders)
    importance_errors(
        lobe_samples(count, alpha), goal.texels, goal.wanted, flat, layout.offsets, layout.sizes, borders, errors
    )
    return errors


def filtered_by_importance(
    cube: NDArray, sizes_and_alphas: list[tuple[int, float]], count: int, threads: int = 1
) -> list[NDArray]:
    """Levels (6, n, n, 3) float32, one for each (n, alpha), of a cube map (6, N, N, 3), N a power of two.

    ``count`` is the number of samples a texel.
    """
    layout = layout_of(cube.shape[1])
    borders = tuple(tuple(each) for each in layout.borders)
    pyramids = np.zeros((3, layout.offsets[-1]))
    for channel in range(3):
        layout.interior(pyramids[channel], 0)[...] = cube[..., channel]
        box_pyramid(pyramids[channel], layout.offsets, layout.sizes, borders)
    out = []
    for n, alpha in sizes_and_alphas:
        samples, level = lobe_samples(count, alpha), np.empty((6, n, n, 3), np.float32)

        def rows(first: int, last: int, n: int = n, samples: NDArray = samples, into: NDArray = level) -> None:
            filter_by_importance(samples, n, first, last, pyramids, layout.offsets, layout.sizes, into)

        over_rows(rows, 6 * n, threads)
        out.append(level)
    return out
