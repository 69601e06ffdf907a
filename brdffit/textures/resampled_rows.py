"""Rows of an image that is resampled to another size, a few at a time.

The cubic of Catmull and Rom (1974) goes through the samples and keeps slopes better than straight lines do, which would
flatten the finest bumps halfway between texels. With t the place between the middle two of four samples, weights are

    (-t + 2 t^2 - t^3) / 2,  (2 - 5 t^2 + 3 t^3) / 2,  (t + 4 t^2 - 3 t^3) / 2,  (-t^2 + t^3) / 2;

they add to 1 and are exact on straight lines. Values are held within those of the four, so that none leaves its range.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit.files.image_rows import ImageRows


def read_at(file: ImageRows | ResampledRows, indices: NDArray) -> NDArray[np.float32]:
    """Rows (n, W, C) of a file with the given indices, which go upwards but where they go around its border."""
    breaks = np.flatnonzero(np.diff(indices) != 1) + 1
    runs = np.split(indices, breaks)
    return np.concatenate([file.read(int(run[0]), int(run[-1]) + 1) for run in runs])


class ResampledRows:
    """An open image file as if it had another size.

    Args:
        file: the image.
        size: (height, width) to resample to; texel centres are those of the same picture.
        tile: whether the image goes on beyond its border, or else ends there.
    """

    def __init__(self, file: ImageRows, size: tuple[int, int], tile: bool) -> None:
        self.file, self.size, self.tile, self.info = file, size, tile, file.info

    def read(self, first: int, last: int) -> NDArray[np.float32]:
        """Rows ``first`` to ``last`` (excluded), (rows, W, C); see ``ImageRows.read``."""
        taps, weights = self._taps(0, np.arange(first, last))
        low = int(taps.min())
        # Taps of rows that follow each other have no gaps.
        needed = self._inside(0, np.arange(low, int(taps.max()) + 1))
        rows = _weighted(read_at(self.file, needed), taps - low, weights, 0)
        taps, weights = self._taps(1, np.arange(self.size[1]))
        return _weighted(rows, self._inside(1, taps), weights, 1)

    def _taps(self, axis: int, at: NDArray) -> tuple[NDArray, NDArray]:
        """Samples (n, 4), some of them beyond the border, and their weights (n, 4) float32."""
        place = (at + 0.5) * self._count(axis) / self.size[axis] - 0.5
        low = np.floor(place).astype(np.int64)
        t = place - low
        square, cube = t * t, t * t * t
        weights = [2 * square - t - cube, 2 - 5 * square + 3 * cube, t + 4 * square - 3 * cube, cube - square]
        return low[:, None] + np.arange(-1, 3), (0.5 * np.stack(weights, axis=1)).astype(np.float32)

    def _inside(self, axis: int, indices: NDArray) -> NDArray:
        count = self._count(axis)
        return indices % count if self.tile else indices.clip(0, count - 1)

    def _count(self, axis: int) -> int:
        return (self.info.height, self.info.width)[axis]


def _weighted(array: NDArray, taps: NDArray, weights: NDArray, axis: int) -> NDArray:
    """Sums of four samples along an axis of (h, w, C), within the least and the largest of them."""
    low = high = np.take(array, taps[:, 0], axis)
    total = np.zeros_like(low)
    for k in range(4):
        each = np.take(array, taps[:, k], axis)
        total += each * weights[:, k].reshape(-1, *[1] * (2 - axis))
        low, high = np.minimum(low, each), np.maximum(high, each)
    return np.clip(total, low, high)
