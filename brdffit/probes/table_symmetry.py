"""Ties between the taps of a table, and the texels that remain to be looked at under them.

A table whose three axes hold the same taps is carried into itself when the cube is turned so that positive axes change
places; if the taps come in mirror pairs (x, -x) too, by every exchange of two axes. The error is then the same at all
texels of an orbit, and one of each is enough. Fewer numbers also find better minima (see docs of the command).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit.probes.cubemap import face_points

#: From free to tied: no tie, the same taps for all axes, these in mirror pairs.
SYMMETRIES = ("none", "axes", "mirror")


def free_taps(symmetry: str, taps: int) -> int:
    """How many taps are free for ``taps`` a frame."""
    return {"none": 3 * taps, "axes": taps, "mirror": taps // 2}[symmetry]


def unfold(free: NDArray, symmetry: str) -> NDArray:
    """The whole table (5, terms, 3 N) of the free taps (5, terms, free)."""
    if symmetry == "none":
        return free
    if symmetry == "mirror":
        free = np.concatenate([free, _mirrored(free)], axis=2)
    return np.concatenate([free] * 3, axis=2)


def fold(gradient: NDArray, symmetry: str) -> NDArray:
    """The gradient by the free taps of one by the whole table: the transpose of ``unfold``."""
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
    """One texel (face, u, v) of each orbit under the symmetry, and how many texels each stands for."""
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
