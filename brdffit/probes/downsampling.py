"""The first pass of Manson and Sloan 2016 (section 4): an intermediate pyramid by quadratic B-splines.

The weight of each of the four bilinear reads is 1/8 + J/(2 sum J), with J = (1 + u^2 + v^2)^(-3/2) at the read: half a
constant, half the Jacobian normalised to unit sum. (The paper's text reads (1 + J)/2; with the published tables that is
less accurate, and the published shader does as here.) Weights sum to one, so a constant image stays constant.

Kinds: "quadratic" (four reads), "exact" (16 texels, each with its own Jacobian), "unweighted" (four reads of 1/4) and
"box" (four texels by solid angle).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from brdffit.probes.cubemap import border, pad, solid_angles
from brdffit.probes.kernels.pyramid import pad_level, pull_level, push_level

KINDS = ("quadratic", "exact", "unweighted", "box")


def _jacobian(u: NDArray, v: NDArray) -> NDArray:
    return np.power(1.0 + u * u + v * v, -1.5)


@lru_cache(maxsize=32)
def read_weights(n: int, blended: bool = True) -> NDArray:
    """(4, n + 2, n + 2) weights of the four reads of each coarse texel, padded by mirroring (kernels/pyramid.py).

    ``blended``: with the Jacobian; otherwise every weight is 1/4.
    """
    weights = np.full((4, n + 2, n + 2), 0.25)
    if blended:
        centre = (2.0 * np.arange(n) + 1.0) / n - 1.0
        step = 0.75 / n
        reads = [(-step, step), (step, step), (-step, -step), (step, -step)]
        density = np.stack([_jacobian(centre[None, :] + x, -centre[:, None] + y) for x, y in reads])
        weights[:, 1:-1, 1:-1] = 0.125 + 0.5 * density / density.sum(axis=0)
        for inner, outer in ((1, 0), (n, n + 1)):
            weights[:, 1:-1, outer] = weights[[1, 0, 3, 2], 1:-1, inner]
            weights[:, outer, 1:-1] = weights[[2, 3, 0, 1], inner, 1:-1]
        for j_inner, j_outer in ((1, 0), (n, n + 1)):
            for i_inner, i_outer in ((1, 0), (n, n + 1)):
                weights[:, j_outer, i_outer] = weights[[3, 2, 1, 0], j_inner, i_inner]
    weights.setflags(write=False)
    return weights


@lru_cache(maxsize=32)
def stencil(n: int, kind: str) -> NDArray:
    """(4, 4, n, n) weights of the 4x4 fine texels (row, column) around each texel of a coarse face of n^2."""
    spline = np.array([0.125, 0.375, 0.375, 0.125])
    near, far = np.array([0.25, 0.75, 0.0, 0.0]), np.array([0.0, 0.0, 0.75, 0.25])
    out = np.zeros((4, 4, n, n))
    if kind == "box":
        angle = solid_angles(2 * n)
        total = sum(angle[a::2, b::2] for a in (0, 1) for b in (0, 1))
        for a in (0, 1):
            for b in (0, 1):
                out[1 + a, 1 + b] = angle[a::2, b::2] / total
    elif kind == "exact":
        # J at the fine texels; beyond an edge it is mirrored, as the read weights are.
        centre = (2.0 * np.arange(2 * n) + 1.0) / (2 * n) - 1.0
        density = np.pad(_jacobian(centre[None, :], centre[:, None]), 1, mode="symmetric")
        for a in range(4):
            for b in range(4):
                out[a, b] = spline[a] * spline[b] * density[a : a + 2 * n : 2, b : b + 2 * n : 2]
        out = 0.5 * (out / out.sum(axis=(0, 1)) + (spline[:, None] * spline)[:, :, None, None])
    else:
        weights = read_weights(n, kind == "quadratic")[:, 1:-1, 1:-1]
        for index, (rows, columns) in enumerate([(near, near), (near, far), (far, near), (far, far)]):
            out += rows[:, None, None, None] * columns[None, :, None, None] * weights[index]
    return out


def downsampled(cube: NDArray, kind: str = "quadratic") -> NDArray:
    """The next coarser level (6, n, n, channels) of a cube map (6, 2n, 2n, channels), by a stencil of KINDS."""
    n = cube.shape[1] // 2
    weights = stencil(n, kind)
    padded = pad(cube.astype(np.float64))
    out = np.zeros((6, n, n, cube.shape[3]))
    for a in range(4):
        for b in range(4):
            out += weights[a, b, None, :, :, None] * padded[:, a : a + 2 * n : 2, b : b + 2 * n : 2]
    return out


class Layout:
    """Layout of all levels of a single-channel cube map in one flat float64 array, as the kernels take it.

    Args:
        base: texels along a face of level 0, a power of two.
    """

    def __init__(self, base: int) -> None:
        self.sizes = tuple(base >> k for k in range(base.bit_length()))
        counts = [6 * (n + 2) ** 2 for n in self.sizes]
        self.offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self.borders = tuple(border(n) for n in self.sizes)
        self.weights = tuple(np.ascontiguousarray(read_weights(n)) for n in self.sizes)

    def interior(self, flat: NDArray, level: int) -> NDArray:
        """View (6, n, n) of a level."""
        n = self.sizes[level]
        return flat[self.offsets[level] : self.offsets[level + 1]].reshape(6, n + 2, n + 2)[:, 1:-1, 1:-1]

    def pad(self, flat: NDArray, level: int) -> None:
        """Fill the border of a level."""
        pad_level(flat, self.offsets[level], *self.borders[level])

    def build(self, image: NDArray) -> NDArray:
        """The flat pyramid, every level padded, of one channel (6, base, base)."""
        flat = np.zeros(self.offsets[-1])
        self.interior(flat, 0)[...] = image
        self.pad(flat, 0)
        for k in range(1, len(self.sizes)):
            pull_level(flat, self.offsets[k - 1], self.offsets[k], self.sizes[k], self.weights[k])
            self.pad(flat, k)
        return flat

    def push(self, flat: NDArray, level: int) -> None:
        """Spread the padded ``level`` over the interior of the next finer one: the transpose of ``pull_level``."""
        push_level(flat, self.offsets[level - 1], self.offsets[level], self.sizes[level], self.weights[level])
