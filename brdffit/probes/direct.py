"""Brute-force filtering, and bright texels that are taken out of an environment and added exactly to each level."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit.probes.cubemap import directions, mean_radiance, solid_angles
from brdffit.probes.kernels.direct import weigh_all
from brdffit.probes.lobe import lobe_integral
from brdffit.probes.parallel import over_rows


def packed_source(cube: NDArray) -> NDArray:
    """(7, 6 n^2) float64 directions, solid angles and radiance of the texels of a cube map (6, n, n, 3)."""
    n = cube.shape[1]
    angle = np.broadcast_to(solid_angles(n), (6, n, n)).reshape(1, -1)
    at = directions(n).reshape(-1, 3).T
    return np.ascontiguousarray(np.concatenate([at, angle, cube.reshape(-1, 3).T.astype(np.float64)]))


def filtered_exactly(source: NDArray, normals: NDArray, alpha: float, threads: int = 1) -> NDArray:
    """(q, 3) float64 filtered radiance around unit normals (q, 3): a sum over every texel of a ``packed_source``."""
    sums, totals = _weighed(source, normals, alpha, threads)
    return sums / totals[:, None]


def _weighed(source: NDArray, normals: NDArray, alpha: float, threads: int) -> tuple[NDArray, NDArray]:
    """(q, 3) sums of K A L over a ``packed_source``, K before normalisation, and (q,) sums of K A."""
    normals = np.ascontiguousarray(normals, np.float64)
    sums, totals = np.empty(normals.shape), np.empty(len(normals))
    over_rows(lambda first, last: weigh_all(normals, alpha, source, first, last, sums, totals), len(normals), threads)
    return sums, totals


def split_bright(cube: NDArray, cap: float) -> tuple[NDArray, NDArray]:
    """A cube map (6, n, n, 3) with its bright texels scaled down, and the radiance that was taken out as points (7, k).

    A texel is scaled so that its largest channel is at most ``cap`` times the mean of the largest channels; its hue
    stays. The points are laid out as a ``packed_source``; the cube map and the points together hold all the energy.
    """
    largest = cube.max(axis=-1)
    limit = cap * float(mean_radiance(largest[..., None])[0])
    scale = np.minimum(1.0, limit / np.maximum(largest, 1e-30))
    rest = (cube * scale[..., None]).astype(cube.dtype)
    bright = np.flatnonzero(largest.ravel() > limit)
    return rest, np.ascontiguousarray(packed_source(cube.astype(np.float64) - rest)[:, bright])


def add_bright(level: NDArray, points: NDArray, alpha: float, threads: int = 1) -> NDArray:
    """A filtered level (6, n, n, 3) plus the exact contribution of the ``points`` of ``split_bright``."""
    sums, _ = _weighed(points, directions(level.shape[1]).reshape(-1, 3), alpha, threads)
    return (level + sums.reshape(level.shape) / lobe_integral(alpha)).astype(level.dtype)
