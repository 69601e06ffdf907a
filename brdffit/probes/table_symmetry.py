"""Symmetries of a table: its free taps, and one texel for each orbit.

A table whose three axes hold the same taps is invariant under cyclic permutations of the axes of the cube. If the taps
also come in mirror pairs (x, -x), it is invariant under every permutation of the axes. The error is then the same at
all texels of an orbit, and measuring one of them is enough. A search over fewer numbers also finds better minima.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit.probes.cubemap import face_points

#: No symmetry; the same taps for all axes; the same taps for all axes, in mirror pairs.
SYMMETRIES = ("none", "axes", "mirror")


def free_taps(symmetry: str, taps: int) -> int:
    """Number of free taps of a table with ``taps`` taps a frame."""
    return {"none": 3 * taps, "axes": taps, "mirror": taps // 2}[symmetry]


def unfold(free: NDArray, symmetry: str) -> NDArray:
    """The table (5, terms, 3 N) that the free taps (5, terms, free) stand for."""
    if symmetry == "none":
        return free
    if symmetry == "mirror":
        free = np.concatenate([free, _mirrored(free)], axis=2)
    return np.concatenate([free] * 3, axis=2)


def fold(gradient: NDArray, symmetry: str) -> NDArray:
    """The gradient with respect to the free taps, from that with respect to the table: the transpose of ``unfold``."""
    if symmetry == "none":
        return gradient
    count = gradient.shape[2] // 3
    gradient = gradient[:, :, :count] + gradient[:, :, count : 2 * count] + gradient[:, :, 2 * count :]
    if symmetry == "mirror":
        half = count // 2
        gradient = gradient[:, :, :half] + _mirrored(gradient[:, :, half:])
    return gradient


def _mirrored(table: NDArray) -> NDArray:
    out = table.copy()
    out[0] *= -1.0
    return out


def orbits(texels: NDArray, symmetry: str) -> tuple[NDArray, NDArray]:
    """One texel of each orbit of ``texels`` (T, 3: face, u, v) under the symmetry, and the size of its orbit."""
    if symmetry == "none":
        return texels, np.ones(len(texels))
    points = face_points(texels[:, 1], texels[:, 2])[texels[:, 0].astype(int), np.arange(len(texels))]
    points = np.round(points, 9) + 0.0
    if symmetry == "mirror":
        key = np.sort(points, axis=1)
    else:
        turned = np.stack([points, np.roll(points, 1, axis=1), np.roll(points, 2, axis=1)], axis=1)
        order = np.lexsort(turned.transpose(2, 0, 1)[::-1], axis=-1)
        key = np.take_along_axis(turned, order[:, :1, None], axis=1)[:, 0]
    _, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
    return texels[first], count.astype(np.float64)
