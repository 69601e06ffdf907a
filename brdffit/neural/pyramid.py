"""The layout of the levels of a texture in memory, and the periodic blur of textures during training."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from brdffit.neural.kernels.textures import TEXEL, blur_level

#: A Gaussian with a standard deviation below this, in texels, is left out: its neighbouring taps are below 4e-6.
_NO_BLUR = 0.2


class Layout:
    """Levels of a texture of ``size`` (height, width), powers of two: (h / 2^l, w / 2^l), at least 1, down to 1 x 1.

    Attributes:
        sizes: (height, width) of each level.
        rooms: (levels, 3) int64: first float, width and height of each level in the kernels' layout, in which each row
            ends with a copy of its first texel.
        floats: number of floats of that layout.
    """

    def __init__(self, size: tuple[int, int], levels: int | None = None) -> None:
        self.size = size
        count = levels or max(size).bit_length()
        self.sizes = [(max(size[0] >> k, 1), max(size[1] >> k, 1)) for k in range(count)]
        firsts = np.cumsum([0, *(h * (w + 1) * TEXEL for h, w in self.sizes)])
        self.rooms = np.array([(first, w, h) for first, (h, w) in zip(firsts, self.sizes, strict=False)], np.int64)
        self.floats = int(firsts[-1])

    @cached_property
    def bounds(self) -> list[int]:
        """First float of each level, and the end, in the layout without repeated texels."""
        return np.cumsum([0, *(h * w * TEXEL for h, w in self.sizes)]).tolist()

    @property
    def learned(self) -> int:
        """Number of floats of the layout without repeated texels."""
        return self.bounds[-1]

    def read_through(self, texture: NDArray, sigma: float, out: NDArray) -> None:
        """Write ``texture``, blurred and in the kernels' layout, to ``out``.

        Args:
            texture: (learned,) float32, without repeated texels.
            sigma: standard deviation of the periodic Gaussian, in texels of level 0; it covers the same part of the
                tile on every level.
            out: (floats,) float32.
        """
        for k, (height, width) in enumerate(self.sizes):
            taps = tuple(
                periodic_taps(sigma * length / whole, length)
                for length, whole in zip((width, height), self.size[::-1], strict=True)
            )
            source = texture[self.bounds[k] : self.bounds[k + 1]]
            scratch = np.empty(height * width * TEXEL, np.float32)
            padded = np.empty((width + len(taps[0]) + 1) * TEXEL, np.float32)
            blur_level(source, out, self.rooms[k], taps, scratch, padded)

    def pull_back(self, gradient: NDArray, sigma: float) -> NDArray:
        """The gradient by ``texture`` (learned,) from that by ``out`` (floats,) of ``read_through``.

        The blur is symmetric and therefore its own adjoint; repeated texels are added to the first of their row.
        """
        texels = np.empty(self.learned, np.float32)
        for k, rows in enumerate(self.levels(gradient)):
            own = texels[self.bounds[k] : self.bounds[k + 1]].reshape(*self.sizes[k], TEXEL)
            own[:] = rows[:, :-1]
            own[:, 0] += rows[:, -1]
        if sigma < _NO_BLUR:
            return texels
        out = np.empty(self.floats, np.float32)
        self.read_through(texels, sigma, out)
        return np.concatenate([rows[:, :-1].reshape(-1) for rows in self.levels(out)])

    def levels(self, laid_out: NDArray) -> list[NDArray]:
        """Views (h, w + 1, 8) of each level in the kernels' layout; the last column repeats the first."""
        return [
            laid_out[first : first + height * (width + 1) * TEXEL].reshape(height, width + 1, TEXEL)
            for (first, _, _), (height, width) in zip(self.rooms.tolist(), self.sizes, strict=True)
        ]


def periodic_taps(sigma: float, length: int) -> NDArray:
    """Weights (odd,) float32 of a Gaussian to 4 sigma, wrapped around a period of ``length`` texels."""
    if sigma < _NO_BLUR or length == 1:
        return np.ones(1, np.float32)
    reach = math.ceil(4.0 * sigma)
    at = np.arange(-reach, reach + 1)
    weights = np.exp(-0.5 * (at / sigma) ** 2)
    if len(at) > length:
        # The texel half a period away occurs at both ends, with half its weight at each.
        half = length // 2
        around = np.bincount(at % length, weights, length)
        weights = around[np.arange(-half, half + 1) % length]
        weights[0] = weights[-1] = 0.5 * weights[0]
    return (weights / weights.sum()).astype(np.float32)
