"""From stored pixels to quantities: decoding by role, resampling, slopes of a height."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

#: Largest difference of two channels that are equal but for the rounding of a JPEG.
ALIKE = 3.0 / 255.0
#: Length below which a stored normal is no direction: (127, 127, 127) and (128, 128, 128) decode to 0.007.
ZERO_LENGTH = 0.02
#: Smallest z of a unit normal, one code step at 8 bits: below it the slope is not determined.
MIN_NORMAL_Z = 2.0 / 255.0


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
    if max(float(np.abs(pixels[..., 0] - pixels[..., k]).max()) for k in (1, 2)) <= ALIKE:
        return pixels[:, :, 1], ""
    taken = {"roughness": "G", "gloss": "G", "metallic": "B"}.get(role, "R")
    return pixels[:, :, "RGB".index(taken)], taken


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


def rebuilt_how(pixels: NDArray, vectors: NDArray) -> str:
    """Why z of stored normals must be rebuilt from x and y: what the map has instead; "" where z is as it says.

    Args:
        pixels: (H, W, C) as stored.
        vectors: (H, W, 2 or 3) of them, in [-1, 1].
    """
    if pixels.shape[2] == 2:
        return "has two channels"
    z = vectors[:, :, 2]
    if float(np.ptp(z)) == 0.0:
        # Block-compressed maps come back with a blue of zero or a constant; a constant map keeps what it says.
        constant = float(np.ptp(vectors, axis=(0, 1)).max()) == 0.0
        return "" if constant and float(z.flat[0]) > 0.0 else "has two channels"
    implied = rebuild_z(vectors[:, :, :2])
    spread, mean = float(implied.std()), float(z.mean(dtype=np.float64))
    # A blue of 255 that a JPEG has roughened says nothing either: it does not follow x and y.
    if spread > 0.01 and mean > 0.97 and float(z.std()) < 0.25 * spread and mean > float(implied.mean()) + spread:
        return "has two channels and a blue that does not follow them"
    return ""


def x_in_alpha(pixels: NDArray) -> bool:
    """Whether an RGBA normal map holds x in alpha and y in green (DXT5nm): red is constant, alpha varies about 0.5."""
    if pixels.shape[2] != 4:
        return False
    red, alpha = pixels[:, :, 0], pixels[:, :, 3]
    if float(np.ptp(red)) > ALIKE or float(np.ptp(alpha)) < 4.0 * ALIKE:
        return False
    return abs(float(alpha.mean(dtype=np.float64)) - 0.5) < 0.2 and abs(float(red.flat[0]) - 0.5) > 0.2


def slopes_of_normals(vectors: NDArray) -> NDArray:
    """(H, W, 2) slopes (-x/z, -y/z) of normals of any length (H, W, 2 or 3), with z held at 0.1 or more."""
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
