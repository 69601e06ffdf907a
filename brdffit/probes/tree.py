"""The default filter: a quadtree whose nodes are taken whole where a bound allows it (see kernels/tree.py)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit.probes.cubemap import directions, face_points, mean_radiance, solid_angles
from brdffit.probes.kernels.tree import NODE_FIELDS, filter_by_tree
from brdffit.probes.lobe import lobe_integral
from brdffit.probes.parallel import over_rows

#: The mean error goes about as this times sqrt(tau) (five environments, levels 1 to 6); the sum of bounds is far above.
_ERROR_OF_TAU = 0.07
#: tau of the first pass, which only finds out how bright the result is.
_COARSE_TAU = 0.1


def tau_for(tolerance: float) -> float:
    """The threshold of a node for a wanted mean relative error."""
    return (tolerance / _ERROR_OF_TAU) ** 2


class Tree:
    """A quadtree over a cube map (6, n, n, 3), n a power of two."""

    def __init__(self, cube: NDArray) -> None:
        n = cube.shape[1]
        self._mean = mean_radiance(cube)
        # The roots: 8x8 a face, fewer nodes than that never pass.
        self._top = max(int(np.log2(n)) - 3, 0)
        self._nodes, self._offsets = _build(cube.astype(np.float64), self._top)

    def filtered(
        self, normals: NDArray, alpha: float, tau: float, threads: int = 1, counts: NDArray | None = None
    ) -> NDArray:
        """(q, 3) float64 radiance around unit normals (q, 3); ``counts`` (q,) gets how many nodes were taken."""
        normals = np.ascontiguousarray(normals, np.float64)
        integral = lobe_integral(alpha)
        counts = np.zeros(len(normals), np.int64) if counts is None else counts
        out = np.tile(self._mean, (len(normals), 1))
        for threshold in (max(_COARSE_TAU, tau), tau):
            estimate, fresh = out, np.empty(normals.shape)

            def rows(
                first: int, last: int, tau: float = threshold, at: NDArray = estimate, to: NDArray = fresh
            ) -> None:
                filter_by_tree(
                    normals, alpha, integral, self._nodes, self._offsets, self._top, tau, at, first, last, to, counts
                )

            over_rows(rows, len(normals), threads)
            out = fresh
        return out

    def level(self, n: int, alpha: float, tau: float, threads: int = 1) -> NDArray:
        """A whole level (6, n, n, 3) float32."""
        filtered = self.filtered(directions(n).reshape(-1, 3), alpha, tau, threads)
        return filtered.reshape(6, n, n, 3).astype(np.float32)


def _build(cube: NDArray, top: int) -> tuple[NDArray, NDArray]:
    """Nodes (all, NODE_FIELDS) float32 of levels 0 (texels) to ``top``, and where each level begins."""
    n = cube.shape[1]
    area = np.broadcast_to(solid_angles(n)[None, :, :, None], (6, n, n, 1))
    radiance, square, centroid = cube, np.square(cube).sum(axis=-1, keepdims=True), directions(n)
    levels = []
    for _ in range(top + 1):
        size = radiance.shape[1]
        length = np.linalg.norm(centroid, axis=-1, keepdims=True)
        unit = centroid / length
        # Mean squared chord from the unit centroid: 2 (1 - length).
        chord = np.maximum(2.0 * (1.0 - length), 0.0)
        deviation = np.sqrt(np.maximum(square - np.square(radiance).sum(axis=-1, keepdims=True), 0.0))
        rho = _corner_angle(unit, size)
        fields = [unit, area, np.cos(rho), np.sin(rho), deviation, chord / 4.0, radiance]
        levels.append(np.concatenate(fields, axis=-1).reshape(-1, NODE_FIELDS).astype(np.float32))
        if size == 1:
            break
        total = _summed(area)
        radiance, square, centroid = (_summed(each * area) / total for each in (radiance, square, centroid))
        area = total
    offsets = np.concatenate([[0], np.cumsum([len(level) for level in levels])]).astype(np.int64)
    return np.ascontiguousarray(np.concatenate(levels)), offsets


def _summed(values: NDArray) -> NDArray:
    """Sums over blocks of 2x2 texels."""
    n = values.shape[1]
    return values.reshape(6, n // 2, 2, n // 2, 2, values.shape[3]).sum(axis=(2, 4))


def _corner_angle(unit: NDArray, n: int) -> NDArray:
    """(6, n, n, 1) largest angle from the centroid of a node to one of its corners."""
    edge = 2.0 * np.arange(n + 1) / n - 1.0
    corner = face_points(edge[None, :], -edge[:, None])
    corner /= np.linalg.norm(corner, axis=-1, keepdims=True)
    # 2 asin of half the chord keeps its digits for small angles.
    chords = [
        np.linalg.norm(corner[:, a : n + a, b : n + b] - unit, axis=-1, keepdims=True) for a in (0, 1) for b in (0, 1)
    ]
    return 2.0 * np.arcsin(np.minimum(0.5 * np.max(chords, axis=0), 1.0))
