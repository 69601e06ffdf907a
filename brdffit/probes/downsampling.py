"""The first pass of Manson and Sloan 2016 (section 4): an intermediate pyramid by quadratic B-splines.

The weight of each of the four bilinear reads is 1/8 + J/(2 sum J), with J = (1 + u^2 + v^2)^(-3/2) at the read: half a
constant, half the Jacobian normalised to unit sum. (The paper's text reads (1 + J)/2; with the published tables that is
less accurate, and the published shader does as here.) Weights sum to one, so a constant image stays constant.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.probes.cubemap import border
from brdffit.probes.kernels.pyramid import pad_level, pull_level, push_level


def jacobian(u: NDArray, v: NDArray) -> NDArray:
    """J, the solid angle over the area on the cube of half side 1."""
    return np.power(1.0 + u * u + v * v, -1.5)


@lru_cache(maxsize=32)
def read_weights(n: int) -> NDArray:
    """(4, n + 2, n + 2) weights of the four reads of each coarse texel, padded by mirroring (kernels/pyramid.py)."""
    centre = (2.0 * np.arange(n) + 1.0) / n - 1.0
    step = 0.75 / n
    reads = [(-step, step), (step, step), (-step, -step), (step, -step)]
    density = np.stack([jacobian(centre[None, :] + x, -centre[:, None] + y) for x, y in reads])
    weights = np.pad(0.125 + 0.5 * density / density.sum(axis=0), ((0, 0), (1, 1), (1, 1)), mode="edge")
    for outer in (0, n + 1):
        weights[:, :, outer] = weights[[1, 0, 3, 2], :, outer]
    for outer in (0, n + 1):
        weights[:, outer] = weights[[2, 3, 0, 1], outer]
    weights.setflags(write=False)
    return weights


class Layout:
    """Layout of all levels of a single-channel cube map in one flat float64 array, as the kernels take it.

    Args:
        base: texels along a face of level 0, a power of two.
    """

    def __init__(self, base: int) -> None:
        self.sizes = tuple(base >> k for k in range(base.bit_length()))
        counts = [6 * (n + 2) ** 2 for n in self.sizes]
        self.offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        self.borders = tuple(tuple(border(n)) for n in self.sizes)
        self.weights = tuple(read_weights(n) for n in self.sizes)

    def interior(self, flat: NDArray, level: int) -> NDArray:
        """View (6, n, n) of a level."""
        n = self.sizes[level]
        return flat[self.offsets[level] : self.offsets[level + 1]].reshape(6, n + 2, n + 2)[:, 1:-1, 1:-1]

    def pad(self, flat: NDArray, level: int) -> None:
        """Fill the border of a level."""
        pad_level(flat, self.offsets[level], *self.borders[level])

    def build(self, image: NDArray, box: bool = False) -> NDArray:
        """The flat pyramid, every level padded, of one channel (6, base, base); ``box``: of plain means of four."""
        flat = np.zeros(self.offsets[-1])
        self.interior(flat, 0)[...] = image
        self.pad(flat, 0)
        for k in range(1, len(self.sizes)):
            if box:
                n = self.sizes[k]
                self.interior(flat, k)[...] = self.interior(flat, k - 1).reshape(6, n, 2, n, 2).mean(axis=(2, 4))
            else:
                pull_level(flat, self.offsets[k - 1], self.offsets[k], self.sizes[k], self.weights[k])
            self.pad(flat, k)
        return flat

    def push(self, flat: NDArray, level: int) -> None:
        """Spread the padded ``level`` over the interior of the next finer one: the transpose of ``pull_level``."""
        push_level(flat, self.offsets[level - 1], self.offsets[level], self.sizes[level], self.weights[level])


@lru_cache(maxsize=4)
def layout_of(base: int) -> Layout:
    """The layout of the pyramid over a base of ``base``^2."""
    return Layout(base)


class ColourPyramid(NamedTuple):
    """The levels of a cube map (6, base, base, 3): flat pyramids (3, ...) of its channels, and their layout."""

    layout: Layout
    flat: NDArray

    @classmethod
    def of(cls, cube: NDArray, box: bool = False) -> ColourPyramid:
        """All levels of a cube map, by B-splines or, with ``box``, by plain means of four."""
        layout = layout_of(cube.shape[1])
        return cls(layout, np.stack([layout.build(cube[..., channel], box) for channel in range(3)]))
