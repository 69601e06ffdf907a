"""BC4 blocks (two of them are BC5) of floats, and back: finer than 8 bits where a block varies little.

A block of 4x4 texels holds two ends e0 > e1 of 8 bits and, for each texel, one of 8 values e1 + k (e0 - e1) / 7.
Readers interpolate in floats (Direct3D 11.3 functional specification: to 1 / 65536), so that ends that are one code
apart give steps of a seventh of a code. Encoders of 8-bit texels throw that away; smooth normals need it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Ends that are tried lie from so many units outside of a block's smallest and largest value to so many inside; a unit
#: is a code, or a 28th of the block's range where that is more: a quarter of a step.
_OUTSIDE, _INSIDE, _UNITS = 3, 2, 28.0
#: Blocks encoded at a time: few enough for the processor's cache.
_AT_ONCE = 4096
#: Index of each number of sevenths above e1: 7 is e0 itself.
_INDEX = np.array([1, 7, 6, 5, 4, 3, 2, 0], np.uint64)
_STEPS = np.argsort(_INDEX).astype(np.float32)


def encode_bc4(channel: NDArray) -> NDArray:
    """Blocks (H / 4, W / 4, 8) uint8 of a channel (H, W) in [0, 1] whose sides are multiples of 4.

    Of all pairs of ends near the smallest and the largest value of a block the one with the least squared error is
    taken; each texel then takes the nearest value.
    """
    height, width = channel.shape
    texels = np.clip(channel, 0.0, 1.0).astype(np.float32) * np.float32(255.0)
    texels = texels.reshape(height // 4, 4, width // 4, 4).swapaxes(1, 2).reshape(-1, 16)
    parts = [_encode(texels[start : start + _AT_ONCE]) for start in range(0, len(texels), _AT_ONCE)]
    return np.concatenate(parts).reshape(height // 4, width // 4, 8)


def decode_bc4(blocks: NDArray) -> NDArray:
    """Channel (H, W) float32 in [0, 1] of blocks (H / 4, W / 4, 8) of ``encode_bc4``, that is with e0 > e1.

    Raises:
        ValueError: for blocks of the other kind, e0 <= e1, which are never written here.
    """
    rows, columns = blocks.shape[:2]
    high, low = (blocks[..., end].astype(np.float32) for end in (0, 1))
    if (high <= low).any():
        raise ValueError("a block has e0 <= e1, expected e0 > e1")
    bits = np.concatenate([blocks[..., 2:], np.zeros((rows, columns, 2), np.uint8)], axis=-1).view("<u8")
    steps = _STEPS[(bits >> (3 * np.arange(16, dtype=np.uint64))) & np.uint64(7)]
    texels = (low[..., None] + steps * ((high - low) / 7.0)[..., None]) / 255.0
    return texels.reshape(rows, columns, 4, 4).swapaxes(1, 2).reshape(4 * rows, 4 * columns).astype(np.float32)


def _encode(texels: NDArray) -> NDArray:
    """Blocks (n, 8) of texels (n, 16) in codes of 255."""
    lowest, highest = np.floor(texels.min(axis=1)), np.ceil(texels.max(axis=1))
    unit = np.maximum(np.rint((highest - lowest) / np.float32(_UNITS)), 1)
    least = np.full(len(texels), np.inf, np.float32)
    ends = np.zeros((2, len(texels)), np.float32)
    for down in range(-_OUTSIDE, _INSIDE + 1):
        low = np.clip(lowest + down * unit, 0, 254)
        for up in range(-_INSIDE, _OUTSIDE + 1):
            high = np.clip(np.maximum(highest + up * unit, low + 1), 1, 255)
            step = (high - low) / np.float32(7.0)
            error = _sevenths(texels, low, step) * step[:, None] + low[:, None] - texels
            squared = np.einsum("ij,ij->i", error, error)
            better = squared < least
            least = np.where(better, squared, least)
            ends = np.where(better, [high, low], ends)
    high, low = ends
    indices = _INDEX[_sevenths(texels, low, (high - low) / np.float32(7.0)).astype(np.int64)]
    bits = (indices << (3 * np.arange(16, dtype=np.uint64))).sum(axis=1, dtype=np.uint64)
    blocks = np.empty((len(texels), 8), np.uint8)
    blocks[:, 0], blocks[:, 1] = high, low
    blocks[:, 2:] = bits.astype("<u8").view(np.uint8).reshape(-1, 8)[:, :6]
    return blocks


def _sevenths(texels: NDArray, low: NDArray, step: NDArray) -> NDArray:
    return np.clip(np.rint((texels - low[:, None]) / step[:, None]), 0, 7)
