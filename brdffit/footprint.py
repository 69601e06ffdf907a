"""The pixel filter and its footprint: linear filtering of stored channels, level by level.

The model is continuous. The base texture is reconstructed bilinearly between its texel centres, as a renderer does
(a tent in each axis), and the pixel filter, of the level's scale, is applied to that function. Per axis, texel ``x``
of a level of ``W_k`` texels over a base of ``W_0`` is centred on ``(x + 1/2) W_0 / W_k`` base texels, and one pixel is
``W_0 / W_k`` wide, an integer or not. The weight of base texel ``i`` is thus

    A[x, i] = int f((t - centre_x) / scale) / scale  tent(t - i - 1/2) dt

and both axes separate. Level 0 is a level like the others.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from brdffit.methods import one_of
from brdffit.svbrdf import WRAPS

if TYPE_CHECKING:
    from scipy import sparse

PIXEL_FILTERS = ("box", "gaussian", "mitchell")

#: Standard deviation of the Gaussian in pixels. Cut at three of them (radius 1.5, the customary default of renderers):
#: 0.3% of its mass is lost and put back by the normalisation, and a footprint stays a quarter narrower than at four.
GAUSSIAN_SIGMA = 0.5

#: Gauss-Legendre nodes in each piece between kinks: exact for box and Mitchell (at most degree 4 with the tent),
#: below 1e-12 for the Gaussian, whose pieces are never wider than a pixel.
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(8)

#: Bytes of the block of rows that is filtered at a time: a few blocks fit a core's cache.
_BLOCK_BYTES = 1 << 19

#: Beyond this many taps an axis is summed in double precision: n terms in single lose about n * 6e-8.
_SINGLE_PRECISION_TAPS = 24


@dataclass(frozen=True)
class PixelFilter:
    """A pixel filter, separable, the same in both axes.

    Attributes:
        name: one of ``PIXEL_FILTERS``.
        radius: half the width of its support, in pixels.
    """

    name: str
    radius: float

    @property
    def kinks(self) -> tuple[float, ...]:
        """Where the profile is not smooth, in pixels; the ends of its support first and last."""
        return (-2.0, -1.0, 0.0, 1.0, 2.0) if self.name == "mitchell" else (-self.radius, self.radius)

    def weight(self, x: NDArray) -> NDArray:
        """The one-dimensional profile at ``x`` pixels from the centre; its integral is 1. Any shape, float64.

        Sources: the Gaussian is truncated and renormalised; Mitchell & Netravali 1988, equation 8 with B = C = 1/3
        (negative beyond one pixel).
        """
        distance = np.abs(np.asarray(x, dtype=np.float64))
        if self.name == "box":
            profile = np.ones_like(distance)
        elif self.name == "gaussian":
            mass = GAUSSIAN_SIGMA * math.sqrt(2 * math.pi) * math.erf(self.radius / (GAUSSIAN_SIGMA * math.sqrt(2)))
            profile = np.exp(-0.5 * np.square(distance / GAUSSIAN_SIGMA)) / mass
        else:
            near = ((21 * distance - 36) * distance * distance + 16) / 18
            far = (((-7 * distance + 36) * distance - 60) * distance + 32) / 18
            profile = np.where(distance < 1, near, far)
        return np.where(distance <= self.radius, profile, 0.0)


_FILTERS = {
    "box": PixelFilter("box", 0.5),
    "gaussian": PixelFilter("gaussian", 3 * GAUSSIAN_SIGMA),
    "mitchell": PixelFilter("mitchell", 2.0),
}


def get_pixel_filter(name: str) -> PixelFilter:
    """The pixel filter of this name.

    Raises:
        brdffit.errors.UnknownNameError: with the nearest known name.
    """
    return _FILTERS[one_of("pixel filter", name, PIXEL_FILTERS)]


@lru_cache(maxsize=64)
def axis_matrix(pixel_filter: PixelFilter, base_size: int, level_size: int, wrap: str) -> sparse.csr_matrix:
    """Footprint weights along one axis: (level_size, base_size), float64, rows sum to 1. Do not write to it.

    ``wrap`` is "tile" or "clamp". Rows of Mitchell's filter have negative entries.
    """
    from scipy import sparse  # takes a tenth of a second

    if wrap not in WRAPS:
        raise ValueError(f"wrap is {wrap!r}, expected one of {WRAPS}")
    scale = base_size / level_size
    centres = (np.arange(level_size) + 0.5) * scale
    reach = pixel_filter.radius * scale
    # Kinks of the tents are at texel centres; kinks of the filter move with the pixel.
    first = np.floor(centres - reach - 0.5)
    tent_kinks = first[:, None] + 0.5 + np.arange(math.ceil(2 * reach) + 3)
    filter_kinks = centres[:, None] + scale * np.asarray(pixel_filter.kinks)
    breaks = np.concatenate([np.clip(tent_kinks, filter_kinks[:, :1], filter_kinks[:, -1:]), filter_kinks], axis=1)
    breaks.sort(axis=1)
    half = 0.5 * np.diff(breaks, axis=1)[..., None]
    position = 0.5 * (breaks[:, :-1] + breaks[:, 1:])[..., None] + half * _NODES
    mass = pixel_filter.weight((position - centres[:, None, None]) / scale) * half * _NODE_WEIGHTS

    # All nodes of a piece lie between the same two texel centres.
    left = np.floor(0.5 * (breaks[:, :-1] + breaks[:, 1:]) - 0.5)
    to_right = (mass * (position - 0.5 - left[..., None])).sum(axis=2)
    to_left = mass.sum(axis=2) - to_right
    texel = np.stack([left, left + 1]).astype(np.int64)
    texel = texel % base_size if wrap == "tile" else np.clip(texel, 0, base_size - 1)
    row = np.broadcast_to(np.arange(level_size)[:, None], texel.shape)
    weights = np.stack([to_left, to_right])
    matrix = sparse.csr_matrix((weights.ravel(), (row.ravel(), texel.ravel())), shape=(level_size, base_size))
    matrix.eliminate_zeros()
    total = np.asarray(matrix.sum(axis=1)).ravel()
    return sparse.diags_array(1.0 / total).tocsr() @ matrix


def filter_channels(image: NDArray, size: tuple[int, int], pixel_filter: PixelFilter, wrap: str) -> NDArray:
    """Filter ``image`` (H, W, C) float32 to a level of ``size`` (h, w): (h, w, C) float32.

    Works in blocks, so that beyond input and output little memory is taken.
    """
    height, width, channels = image.shape
    down = axis_matrix(pixel_filter, height, size[0], wrap)
    across = axis_matrix(pixel_filter, width, size[1], wrap)
    flat = np.ascontiguousarray(image, dtype=np.float32).reshape(height, width * channels)
    out = np.empty((*size, channels), dtype=np.float32)
    if _taps(down) > _SINGLE_PRECISION_TAPS:
        out[:] = _filter_rows(across, _filter_columns_exactly(down, flat).reshape(-1, width, channels), wrap)
        return out
    down = down.astype(np.float32)
    rows = max(1, _BLOCK_BYTES // flat[0].nbytes)
    for start in range(0, size[0], rows):
        block = down[start : start + rows] @ flat
        out[start : start + rows] = _filter_rows(across, block.reshape(-1, width, channels), wrap)
    return out


def filter_texels(
    image: NDArray, size: tuple[int, int], pixel_filter: PixelFilter, wrap: str, columns: NDArray, rows: NDArray
) -> NDArray:
    """Texels (columns[i], rows[i]) of ``filter_channels`` alone, (n, C) float32; the cost grows with their number."""
    down = axis_matrix(pixel_filter, image.shape[0], size[0], wrap)
    across = axis_matrix(pixel_filter, image.shape[1], size[1], wrap)
    out = np.empty((len(columns), image.shape[2]), np.float32)
    for i, (column, row) in enumerate(zip(columns, rows, strict=True)):
        y, x = (slice(matrix.indptr[k], matrix.indptr[k + 1]) for matrix, k in ((down, row), (across, column)))
        part = image[down.indices[y][:, None], across.indices[x]]
        out[i] = across.data[x] @ np.tensordot(down.data[y], part, axes=1)
    return out


def iter_pyramid(
    image: NDArray, sizes: Sequence[tuple[int, int]], pixel_filter: PixelFilter, wrap: str
) -> Iterator[NDArray]:
    """``filter_channels`` of ``image`` (H, W, C) float32 for each of ``sizes`` (h, w), finest first, one at a time.

    With the box filter, a level whose sides divide those of the level before is made from that level, exactly: where
    W_k = r W_{k+1}, the pixel of level k+1 at x is the interval [r x, r (x + 1)] W_0 / W_k, that is, the pixels
    r x ... r x + r - 1 of level k side by side, and the mean of a function over a union of equal intervals is the mean
    of its means. (Gaussian and Mitchell footprints overlap: no such law, they are filtered from the base.)
    Do not write to a level before the next is made.
    """
    finer: NDArray | None = None
    for height, width in sizes:
        if pixel_filter.name == "box" and finer is not None and not (finer.shape[0] % height or finer.shape[1] % width):
            finer = _mean_of_blocks(finer, (height, width))
        else:
            finer = filter_channels(image, (height, width), pixel_filter, wrap)
        yield finer


def filter_pyramid(
    image: NDArray, sizes: Sequence[tuple[int, int]], pixel_filter: PixelFilter, wrap: str
) -> list[NDArray]:
    """All levels of ``iter_pyramid`` in a list."""
    return list(iter_pyramid(image, sizes, pixel_filter, wrap))


def _mean_of_blocks(image: NDArray, size: tuple[int, int]) -> NDArray:
    """Means of equal blocks of (H, W, C), one for each texel of ``size``."""
    (height, width), channels = size, image.shape[2]
    down, across = image.shape[0] // height, image.shape[1] // width
    rows = image.reshape(height, down, width * across * channels)
    total = rows[:, 0] if down == 1 else rows[:, 0] + rows[:, 1]
    for i in range(2, down):
        total += rows[:, i]
    columns = total.reshape(height, width, across, channels)
    mean = columns[:, :, 0] * np.float32(1.0 / (down * across))
    for i in range(1, across):
        mean += columns[:, :, i] * np.float32(1.0 / (down * across))
    return mean


def _taps(matrix: sparse.csr_matrix) -> int:
    return int(np.diff(matrix.indptr).max())


def _filter_columns_exactly(matrix: sparse.csr_matrix, flat: NDArray) -> NDArray:
    """``matrix`` (h, H) times ``flat`` (H, N) float32, summed in double precision, a strip of columns at a time."""
    out = np.empty((matrix.shape[0], flat.shape[1]), dtype=np.float32)
    strip = max(16, 4 * _BLOCK_BYTES // (8 * flat.shape[0]))
    for start in range(0, flat.shape[1], strip):
        out[:, start : start + strip] = matrix @ flat[:, start : start + strip].astype(np.float64)
    return out


def _filter_rows(matrix: sparse.csr_matrix, block: NDArray, wrap: str) -> NDArray:
    """Filter each row of ``block`` (n, W, C) with ``matrix`` (w, W): (n, w, C) float32.

    Where the scale is an integer, all pixels have one stencil, and shifted copies of the block are summed; that is
    four times as fast as a sparse product for each row.
    """
    level_size, base_size = matrix.shape
    middle = slice(*matrix.indptr[level_size // 2 : level_size // 2 + 2])
    columns, order = matrix.indices[middle], np.argsort(matrix.indices[middle])
    inside = columns.min() > 0 and columns.max() < base_size - 1
    if base_size % level_size or not inside or len(columns) > _SINGLE_PRECISION_TAPS:
        return np.stack([matrix @ row for row in block]).astype(np.float32, copy=False)
    scale = base_size // level_size
    first = int(columns.min()) - scale * (level_size // 2)
    beyond = first + len(columns) - scale
    ends = np.arange(first, 0), np.arange(base_size, base_size + beyond)
    left, right = (end % base_size if wrap == "tile" else np.clip(end, 0, base_size - 1) for end in ends)
    padded = np.concatenate([block[:, left], block, block[:, right]], axis=1)
    out = np.zeros((block.shape[0], level_size, block.shape[2]), dtype=np.float32)
    for tap, weight in enumerate(matrix.data[middle][order].astype(np.float32)):
        out += weight * padded[:, tap : tap + scale * (level_size - 1) + 1 : scale]
    return out
