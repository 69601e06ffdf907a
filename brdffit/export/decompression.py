"""Blocks back to texels, to measure what compression has cost: by OpenImageIO and by Basis Universal (UASTC).

BC4 and BC5 are decoded here: OpenImageIO rounds them to 8 bits, which graphics processors do not.
"""

from __future__ import annotations

import io
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from brdffit.export.bc4 import decode_bc4
from brdffit.export.compression import require_basis
from brdffit.export.dds import header
from brdffit.export.formats import PixelFormat, chain
from brdffit.export.ktx2 import write_ktx2
from brdffit.files.image_io import read_image


def decode_blocks(pixels: PixelFormat, size: tuple[int, int], data: bytes) -> NDArray:
    """(H, W, C) float32 of one level as a reader decodes it; in [0, 1] unless the format is of floats.

    sRGB stays encoded. C is 4 for wide formats, 1 for BC4, 2 for BC5.
    """
    height, width = size
    if pixels.edge == 1:
        kind = {1: np.uint8, 2: np.float16, 4: np.float32}[pixels.type_size]
        texels = np.frombuffer(data, kind).reshape(height, width, -1).astype(np.float32)
        return texels if pixels.is_float else texels / np.float32(255.0)
    if pixels.dxgi is None:
        return _decode_uastc(pixels, size, data)
    if pixels.name in ("bc4", "bc5"):
        blocks = np.frombuffer(data, np.uint8).reshape(-(-height // 4), -(-width // 4), pixels.channels, 8)
        decoded = [decode_bc4(blocks[:, :, channel]) for channel in range(pixels.channels)]
        return np.stack(decoded, axis=-1)[:height, :width]
    return _read(header(pixels, size, 1) + data, ".dds")[..., : pixels.channels]


def _decode_uastc(pixels: PixelFormat, size: tuple[int, int], data: bytes) -> NDArray:
    """By the reader of the encoder's own library, from a file of ours whose other levels are empty."""
    sizes = chain(size)
    file = io.BytesIO()
    levels = [data, *(bytes(pixels.level_bytes(each)) for each in sizes[1:])]
    write_ktx2(file, pixels, size, levels.__getitem__)
    png, _ = require_basis("UASTC").decode_ktx2_to_bytes(file.getvalue(), format="png", level=0)
    # Levels smaller than a block come back as whole blocks.
    return _read(png, ".png")[: size[0], : size[1]]


def _read(data: bytes, suffix: str) -> NDArray:
    """Pixels of an image file's bytes; the reader opens files only."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"level{suffix}")
        path.write_bytes(data)
        return read_image(path).pixels
