"""The default filter: a quadtree whose nodes are not opened where an error bound allows it (see kernels/tree.py)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from brdffit.probes.cubemap import directions, face_points, mean_radiance, solid_angles
from brdffit.probes.kernels.tree import NODE_FIELDS, filter_by_tree
from brdffit.probes.lobe import lobe, lobe_integral
from brdffit.probes.parallel import over_rows

#: The mean error is less than this times sqrt(tau): 0.006 to 0.027 on five environments. The bounds are far larger.
_ERROR_OF_TAU = 0.05
#: Largest threshold: above it single texels of narrow lobes err by a tenth, which shows as a pattern.
_LARGEST_TAU = 0.04
#: tau of the first pass, which only estimates how bright the result is.
_COARSE_TAU = 0.1
#: Least alpha, in widths of a source texel (2/n), at which the sum of K over the texels equals its integral. In the
#: plane the spectrum of K falls as (1 + x) exp(-x), x = 2 alpha times the frequency; at 0.8, aliasing from the sampling
#: frequency 2 pi / width is 5e-4.
_RESOLVED = 0.8
#: Radius in source texels of the window in which ``texel_sums`` compares the sum over texels with the integral.
_WINDOW = 10.0


def tau_for(tolerance: float) -> float:
    """Threshold tau of a node for a wanted mean relative error of a level."""
    return min((tolerance / _ERROR_OF_TAU) ** 2, _LARGEST_TAU)


class Tree:
    """A quadtree over a cube map (6, n, n, 3), n a power of two."""

    def __init__(self, cube: NDArray) -> None:
        n = cube.shape[1]
        self._mean = mean_radiance(cube)
        # Roots are 2x2 nodes a face; ``filtered`` starts at 8x8 where the sum of K over the texels is not known.
        self._top = max(int(np.log2(n)) - 1, 0)
        self._size = n
        self._nodes, self._offsets = _build(cube.astype(np.float64), self._top)

    def filtered(
        self, normals: NDArray, alpha: float, tau: float, threads: int = 1, counts: NDArray | None = None,
        sums: NDArray | None = None,
    ) -> NDArray:  # fmt: skip
        """(q, 3) float64 filtered radiance around unit normals.

        Args:
            normals: (q, 3) unit vectors.
            alpha: roughness alpha of the lobe.
            tau: threshold of a node; 0 opens all of them.
            threads: workers; no result depends on their number.
            counts: (q,) int64, receives the number of nodes that were summed; None for no count.
            sums: (q,) sums of K times solid angle over the texels of the source (``texel_sums``). None: they are taken
                to be the integral of K if the texels resolve the lobe, else they are unknown.
        """
        normals = np.ascontiguousarray(normals, np.float64)
        counts = np.zeros(len(normals), np.int64) if counts is None else counts
        known = sums is not None or alpha > _RESOLVED * 2.0 / self._size
        integrals = np.full(len(normals), lobe_integral(alpha)) if sums is None else sums
        top = self._top if known else max(self._top - 2, 0)

        def one_pass(estimate: NDArray, tau: float, final: bool) -> NDArray:
            out = np.empty((len(normals), 6))

            def rows(first: int, last: int) -> None:
                filter_by_tree(
                    normals, alpha, integrals, known, self._nodes, self._offsets, top, tau, final, estimate,
                    first, last, out, counts,
                )  # fmt: skip

            over_rows(rows, len(normals), threads)
            return out

        coarse = one_pass(np.tile(self._mean, (len(normals), 2)), max(_COARSE_TAU, tau), False)
        return one_pass(coarse, tau, True)[:, :3]

    def level(self, n: int, alpha: float, tau: float, threads: int = 1) -> NDArray:
        """A level (6, n, n, 3) float32, filtered around its texel centres."""
        sums = None if alpha > _RESOLVED * 2.0 / self._size else texel_sums(self._size, n, alpha)
        filtered = self.filtered(directions(n).reshape(-1, 3), alpha, tau, threads, sums=sums)
        return filtered.reshape(6, n, n, 3).astype(np.float32)


@lru_cache(maxsize=8)
def texel_sums(source_n: int, n: int, alpha: float) -> NDArray:
    """(6 n^2,) sums of K A (A the solid angle) over all texels of a source of ``source_n``^2, one a texel of n^2.

    The sum differs from the integral of K only where K is narrow, near its peak. With a window w = (1 - d/D)^4 of
    d = 1 - n.l, which is 0 beyond ``_WINDOW`` texels, the difference is sum(K A w) - integral(K w). By symmetry, one
    eighth of a face is enough.
    """
    reach = _WINDOW * 2.0 / source_n
    far = 0.5 * reach**2
    at, angle = directions(source_n).reshape(-1, 3), np.tile(solid_angles(source_n).ravel(), 6)
    half = (n + 1) // 2
    row, column = np.tril_indices(half)
    normals = directions(n)[4, row, column]
    near = cKDTree(at).query_ball_point(normals, reach)
    owner, texel = np.repeat(np.arange(len(near)), [len(each) for each in near]), np.concatenate(near).astype(int)
    d = 0.5 * np.square(at[texel] - normals[owner]).sum(axis=1)
    inside = np.bincount(owner, lobe(d, alpha) * angle[texel] * np.maximum(1.0 - d / far, 0.0) ** 4, len(near))
    # The integral of K w: the solid angle is 2 pi dd, and d = alpha^2 sinh^2(x) resolves the peak.
    node, weight = np.polynomial.legendre.leggauss(200)
    x = 0.5 * (node + 1.0) * np.arcsinh(np.sqrt(far) / alpha)
    d = np.square(alpha * np.sinh(x))
    slope = 2.0 * alpha**2 * np.sinh(x) * np.cosh(x) * 0.5 * np.arcsinh(np.sqrt(far) / alpha)
    whole = 2.0 * np.pi * float((weight * slope * lobe(d, alpha) * (1.0 - d / far) ** 4).sum())
    quarter = np.empty((half, half))
    quarter[row, column] = quarter[column, row] = lobe_integral(alpha) + inside - whole
    other = quarter[:, n // 2 - 1 :: -1] if n > 1 else quarter[:, :0]
    rows = np.concatenate([quarter, other], axis=1)
    face = np.concatenate([rows, rows[n // 2 - 1 :: -1] if n > 1 else rows[:0]])
    return np.tile(face.ravel(), 6)


def _build(cube: NDArray, top: int) -> tuple[NDArray, NDArray]:
    """Nodes (all, NODE_FIELDS) float32 of levels 0 (texels) to ``top``, and the first node of each level."""
    n = cube.shape[1]
    area = np.broadcast_to(solid_angles(n)[None, :, :, None], (6, n, n, 1))
    radiance, square, centroid = cube, np.square(cube).sum(axis=-1, keepdims=True), directions(n)
    # Sums over texels of radiance (all channels) and of radiance times direction; 1e-30 avoids 0/0 on black texels.
    light = area * (cube.sum(axis=-1, keepdims=True) + 1e-30)
    moment = light * centroid
    levels = []
    for _ in range(top + 1):
        size = radiance.shape[1]
        unit, quarter = _centroid(centroid)
        bright, bright_quarter = _centroid(moment / light)
        deviation = np.sqrt(np.maximum(square - np.square(radiance).sum(axis=-1, keepdims=True), 0.0))
        rho = _corner_angle(unit, size)
        fields = [unit, area, np.cos(rho), np.sin(rho), deviation, quarter, radiance, bright, bright_quarter]
        levels.append(np.concatenate(fields, axis=-1).reshape(-1, NODE_FIELDS).astype(np.float32))
        if size == 1:
            break
        total = _summed(area)
        radiance, square, centroid = (_summed(each * area) / total for each in (radiance, square, centroid))
        area, light, moment = total, _summed(light), _summed(moment)
    offsets = np.concatenate([[0], np.cumsum([len(level) for level in levels])]).astype(np.int64)
    return np.ascontiguousarray(np.concatenate(levels)), offsets


def _centroid(mean: NDArray) -> tuple[NDArray, NDArray]:
    """The unit direction of a mean of directions (..., 3), and a quarter of their mean squared chord from it.

    The mean squared chord is 2 (1 - length of the mean).
    """
    length = np.linalg.norm(mean, axis=-1, keepdims=True)
    return mean / length, np.maximum(2.0 * (1.0 - length), 0.0) / 4.0


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
