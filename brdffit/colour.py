"""Colour: the transfer curve of sRGB, and the luminance of its primaries."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Luminance of linear RGB with the primaries of sRGB (ITU-R BT.709); single precision, so that images stay in it.
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


def encode_srgb(linear: NDArray) -> NDArray:
    """Codes in [0, 1] of linear values in [0, 1] (IEC 61966-2-1), any shape; the floating type is kept."""
    high = 1.055 * np.power(np.maximum(linear, 0.0031308), 1.0 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, high)


def decode_srgb(encoded: NDArray) -> NDArray:
    """Linear values in [0, 1] of codes in [0, 1] (IEC 61966-2-1), any shape; the floating type is kept."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
