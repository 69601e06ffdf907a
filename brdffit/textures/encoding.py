"""From stored pixels to quantities: decoding by role, the noise floor of a normal map, resampling, slopes of a height.

Noise floor. An integer normal map with code step q (2/255 at 8 bits) cannot tell a toggle of one code from a flat
map; the variance of a 50/50 toggle is q^2 / 4 on each axis. Each texel has this much variance as a budget, and it is
taken from the detail of a Haar pyramid of the decoded x and y, fine scales first: a map that only dithers between two
neighbouring codes comes out flat at every scale, one with real slopes loses next to nothing. A JPEG stores luma and
chroma in whole codes, so that red and green move by more than a code when these toggle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Code step of a channel that is decoded to [-1, 1], by bit depth.
CODE_STEP = {8: 2.0 / 255.0, 16: 2.0 / 65535.0}
#: How far one code of Y, Cb, Cr moves red and green (ITU-T T.871).
_JPEG_TO_RED, _JPEG_TO_GREEN = (1.0, 0.0, 1.402), (1.0, 0.344136, 0.714136)
#: Length below which a stored normal is no direction: (127, 127, 127) and (128, 128, 128) decode to 0.007.
ZERO_LENGTH = 0.02
#: Smallest z of a unit normal, one code step at 8 bits: what lies lower has no slope that can be told.
MIN_NORMAL_Z = 2.0 / 255.0
#: Headroom for rounding when the detail of a dithering map is compared with what is left of its budget, and with all.
_ROUNDING, _ROUNDING_OF_ALL = 1.0 + 1e-3, 1e-4


def linear_from_srgb(encoded: NDArray) -> NDArray:
    """Linear values of sRGB-encoded ones in [0, 1] (IEC 61966-2-1)."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4).astype(np.float32)


@dataclass(frozen=True)
class CodeNoise:
    """What the codes of a normal map cannot tell from flat.

    Attributes:
        step: code step q of a component in [-1, 1]; 0 for float formats, which have no codes.
        variance: of x and y when every stored code toggles, each on its own; the budget of a texel.
        together: of x and y when luma and chroma toggle together; detail below this is noise altogether.
    """

    step: float
    variance: tuple[float, float]
    together: tuple[float, float]


def code_noise(bits: int, is_float: bool, file_format: str) -> CodeNoise:
    """The noise of a normal map stored with ``bits`` per channel; a JPEG's is that of its luma and chroma codes."""
    step = 0.0 if is_float else CODE_STEP.get(bits, 0.0)
    toggle = 0.25 * step * step
    if file_format != "jpeg":
        return CodeNoise(step, (toggle, toggle), (toggle, toggle))
    red, green = np.array(_JPEG_TO_RED), np.array(_JPEG_TO_GREEN)
    apart = (toggle * float(red @ red), toggle * float(green @ green))
    return CodeNoise(step, apart, (toggle * float(red.sum()) ** 2, toggle * float(green.sum()) ** 2))


def channel_index(channels: Sequence[str], asked: str, as_rgba: bool = False) -> int | None:
    """Index of channel "R", "G", "B" or "A" among those of an image; None where it has no such channel.

    A grey image (one channel, or two of which the second is alpha) has R. ``as_rgba`` spreads its grey over R, G and B,
    as formats do that define every picture as RGBA (glTF).
    """
    count = len(channels)
    if asked == "A":
        return {2: 1, 4: 3}.get(count, channels.index("A") if "A" in channels else None)
    if count <= 2 and "G" not in channels:
        return 0 if asked == "R" or as_rgba else None
    index = "RGB".index(asked)
    return index if index < count else None


def obvious_channel(pixels: NDArray, role: str) -> tuple[NDArray, str]:
    """(H, W) of a map that holds one quantity, and the channel taken ("" when all colours are alike).

    Where the colours differ, roughness lies in green and metallic in blue, as in glTF, and everything else in red.
    """
    if pixels.shape[2] < 3 or (
        np.array_equal(pixels[..., 0], pixels[..., 1]) and np.array_equal(pixels[..., 0], pixels[..., 2])
    ):
        return pixels[:, :, 0], ""
    # A JPEG's colours may differ by a rounding; only more than that is another quantity.
    if max(float(np.abs(pixels[..., 0] - pixels[..., k]).max()) for k in (1, 2)) <= 3.0 / 255.0:
        return pixels[:, :, 1], ""
    taken = {"roughness": "G", "gloss": "G", "metallic": "B"}.get(role, "R")
    return pixels[:, :, "RGB".index(taken)], taken


def subtract_noise_floor(xy: NDArray, noise: CodeNoise, wrap: str) -> NDArray:
    """Normal components (H, W, 2) in [-1, 1] without what their codes cannot tell from a flat map.

    Args:
        xy: decoded x and y, float32.
        noise: of ``code_noise``; without codes ``xy`` is returned as it is.
        wrap: "tile" or "clamp".

    The mean of each component stays; a map that comes out flat within q / 2 of zero comes out exactly zero.
    """
    if noise.step <= 0.0:
        return xy
    means, gains = [np.ascontiguousarray(np.moveaxis(np.asarray(xy, dtype=np.float32), 2, 0))], []
    budget = np.broadcast_to(np.array(noise.variance, np.float32)[:, None, None], means[0].shape)
    threshold = _ROUNDING * np.array([t / v for t, v in zip(noise.together, noise.variance, strict=True)], np.float32)
    slack = _ROUNDING_OF_ALL * np.array(noise.variance, np.float32)[:, None, None]
    while max(means[-1].shape[1:]) > 1:
        level = _pad_even(means[-1], wrap)
        coarse = _block_mean(level)
        # Not E[x^2] - E[x]^2: at 16 bits the noise lies below the rounding of that difference.
        detail = _block_mean(np.square(level - _repeat(coarse, level.shape[1:])))
        budget = _block_mean(_pad_even(budget, wrap))
        local_detail, local_budget = _mean_3x3(detail, wrap), _mean_3x3(budget, wrap)
        kept = local_detail > threshold[:, None, None] * local_budget + slack
        gains.append(np.sqrt(np.where(kept, 1.0 - local_budget / np.where(kept, local_detail, 1.0), 0.0)))
        budget = budget - np.minimum(detail, budget)
        means.append(coarse)
    out = means.pop()
    for level, gain in zip(reversed(means), reversed(gains), strict=True):
        size = level.shape[1:]
        coarse = _repeat(_block_mean(_pad_even(level, wrap)), size)
        out = _repeat(out, size) + _repeat(gain, size) * (level - coarse)
    for axis in range(2):
        if float(np.ptp(out[axis])) < 1e-6 and abs(float(out[axis].flat[0])) <= 0.5 * noise.step * _ROUNDING:
            out[axis] = 0.0
    return np.ascontiguousarray(np.moveaxis(out, 0, 2))


def rebuild_z(xy: NDArray) -> NDArray:
    """z (H, W) of unit normals from x and y (H, W, 2); 0 where x and y alone are longer than 1."""
    return np.sqrt(np.maximum(0.0, 1.0 - _squared_length(xy)))


def stored_vectors(pixels: NDArray, is_float: bool) -> NDArray:
    """Vectors (H, W, 2 or 3) of a stored normal map; float files may hold them signed instead of in [0, 1]."""
    pixels = pixels[:, :, :3]
    if is_float:
        across = float(np.abs(pixels[:, :, :2].mean(axis=(0, 1), dtype=np.float64)).max())
        if float(pixels.min()) < -0.01 or across < 0.1:
            return pixels
    return 2.0 * pixels - 1.0


def slopes_of_normals(vectors: NDArray) -> NDArray:
    """(H, W, 2) slopes (-x/z, -y/z) of normals of any length (H, W, 2 or 3), z held from the horizon."""
    xy = vectors[:, :, :2]
    constant = vectors.shape[2] < 3 or float(np.ptp(vectors[:, :, 2])) == 0.0
    z = rebuild_z(xy) if constant else vectors[:, :, 2]
    return -xy / np.maximum(z, 0.1)[:, :, None]


def unit_normals(vectors: NDArray) -> tuple[NDArray, dict[str, int]]:
    """Unit normals (H, W, 3) with z of at least ``MIN_NORMAL_Z``, and how many texels were "zero" or "horizon".

    Vectors of no length become z; those at or below the horizon are lifted to it by turning them in their own azimuth.
    """
    vectors = np.asarray(vectors, dtype=np.float32)
    length = np.sqrt(_squared_length(vectors))
    zero = length < ZERO_LENGTH
    normals = vectors / np.where(zero, 1.0, length)[:, :, None]
    normals[zero] = (0.0, 0.0, 1.0)
    low = normals[:, :, 2] < MIN_NORMAL_Z
    if low.any():
        level = normals[low]
        across = np.hypot(level[:, 0], level[:, 1])
        scale = np.sqrt(1.0 - MIN_NORMAL_Z**2) / np.maximum(across, 1e-12)
        level[:, :2] *= scale[:, None]
        level[:, 2] = MIN_NORMAL_Z
        level[across < 1e-6] = (0.0, 0.0, 1.0)
        normals[low] = level
    return normals, {"zero": int(zero.sum()), "horizon": int(low.sum())}


def height_gradient(height: NDArray, wrap: str) -> NDArray:
    """(H, W, 2) derivatives (d/dx, d/dy with y up) of a height (H, W) per texel, by central differences."""
    padded = np.pad(height, 1, mode="wrap" if wrap == "tile" else "edge")
    across = padded[1:-1, 2:] - padded[1:-1, :-2]
    up = padded[:-2, 1:-1] - padded[2:, 1:-1]
    if wrap == "tile":
        return 0.5 * np.stack([across, up], axis=2)
    # At a clamped border the difference spans one texel only.
    span_x, span_y = np.full(height.shape[1], 0.5, np.float32), np.full(height.shape[0], 0.5, np.float32)
    span_x[[0, -1]], span_y[[0, -1]] = 1.0, 1.0
    return np.stack([across * span_x, up * span_y[:, None]], axis=2)


def normals_from_gradient(gradient: NDArray) -> NDArray:
    """Unit normals (H, W, 3) of a surface z = h(x, y) with gradient (H, W, 2)."""
    vectors = np.concatenate([-gradient, np.ones_like(gradient[:, :, :1])], axis=2)
    return vectors / np.sqrt(_squared_length(vectors))[:, :, None]


def resample(array: NDArray, size: tuple[int, int], wrap: str) -> NDArray:
    """Bilinear enlargement of (h, w) or (h, w, C) to ``size`` (H, W), texel centres held, border by ``wrap``."""
    for axis, target in enumerate(size):
        count = array.shape[axis]
        if count == target:
            continue
        position = (np.arange(target, dtype=np.float64) + 0.5) * count / target - 0.5
        low = np.floor(position).astype(np.int64)
        weight = (position - low).astype(np.float32)
        weight = weight.reshape([-1 if k == axis else 1 for k in range(array.ndim)])
        first, second = (
            (low % count, (low + 1) % count) if wrap == "tile" else (low.clip(0), (low + 1).clip(0, count - 1))
        )
        array = np.take(array, first, axis) * (1.0 - weight) + np.take(array, second, axis) * weight
    return array


def _squared_length(vectors: NDArray) -> NDArray:
    # Adding channels is many times faster than a reduction over a short axis.
    total = np.square(vectors[:, :, 0])
    for channel in range(1, vectors.shape[2]):
        total += np.square(vectors[:, :, channel])
    return total


def _pad_even(array: NDArray, wrap: str) -> NDArray:
    """(C, H, W) with sides padded to even; a side of one texel repeats itself."""
    odd_y, odd_x = array.shape[1] % 2, array.shape[2] % 2
    if not odd_y and not odd_x:
        return array
    return np.pad(array, ((0, 0), (0, odd_y), (0, odd_x)), mode="wrap" if wrap == "tile" else "edge")


def _block_mean(array: NDArray) -> NDArray:
    rows = array[:, 0::2] + array[:, 1::2]
    return 0.25 * (rows[:, :, 0::2] + rows[:, :, 1::2])


def _mean_3x3(array: NDArray, wrap: str) -> NDArray:
    padded = np.pad(array, ((0, 0), (1, 1), (1, 1)), mode="wrap" if wrap == "tile" else "edge")
    rows = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    return (rows[:, :, :-2] + rows[:, :, 1:-1] + rows[:, :, 2:]) / 9.0


def _repeat(array: NDArray, size: tuple[int, int]) -> NDArray:
    return np.repeat(np.repeat(array, 2, axis=1), 2, axis=2)[:, : size[0], : size[1]]
