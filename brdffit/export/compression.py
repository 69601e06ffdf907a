"""Texels to blocks: BC6H and BC7 by ISPC Texture Compressor, UASTC by Basis Universal, BC4 and BC5 by ``bc4``.

The encoder of BC blocks returns too few bytes, without an error, for a level whose sides are not multiples of 4. So
such a level is padded here by repeating its last row and column, and the number of bytes is checked. Blocks do not
depend on each other, so bands of them go to threads, and the bytes are the same for any number of threads.
"""

from __future__ import annotations

import importlib
import struct
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import BrdffitError, UnknownNameError
from brdffit.export.bc4 import encode_bc4
from brdffit.export.formats import PixelFormat
from brdffit.machine import core_count

#: Time that an encoder may take; below, the profiles of ISPC's BC7 and BC6H and the efforts of Basis that they stand
#: for.
COMPRESSIONS = ("fast", "good", "best")
_BC7 = {"fast": "ultrafast", "good": "basic", "best": "slow"}
_BC6H = {"fast": "veryfast", "good": "basic", "best": "slow"}
# The encoder's ten efforts are five levels; 7 keeps 0.2 to 2 dB more than 2 and takes eight times as long.
_UASTC = {"fast": 0, "good": 2, "best": 7}
_BLOCK_ROWS_PER_BAND = 16


class MissingEncoderError(BrdffitError):
    """An encoder that is an optional extra is not installed."""


def check_compression(name: str) -> str:
    """``name`` if it is one of COMPRESSIONS.

    Raises:
        UnknownNameError: if not, with the nearest.
    """
    if name not in COMPRESSIONS:
        raise UnknownNameError("compression", name, COMPRESSIONS)
    return name


def require_basis(what: str) -> Any:
    """The module that encodes UASTC.

    Raises:
        MissingEncoderError: when it is not installed; the sentence names the extra.
    """
    try:
        import alktx2
    except ImportError as error:
        raise MissingEncoderError(
            f"{what} needs an encoder of Basis textures, which is not installed: pip install 'brdffit[basis]'."
        ) from error
    return alktx2


def encode_level(pixels: PixelFormat, texels: NDArray, effort: str = "good", threads: int | None = None) -> bytes:
    """One level in a format other than UASTC.

    Args:
        pixels: the format.
        texels: (H, W, C), C as the format has channels, or more: uint8; float32 or float16 for float formats; either
            for BC4 and BC5, floats in [0, 1], of which they keep more.
        effort: one of COMPRESSIONS; plain formats have none.
        threads: None takes all cores; the bytes do not depend on it.

    Returns:
        Rows of blocks (or texels) from the top.
    """
    texels = _channels(pixels, texels)
    if pixels.edge == 1:
        return np.ascontiguousarray(texels, _dtype(pixels)).tobytes()
    padded = pad_to_blocks(texels)
    bands = [padded[row : row + 4 * _BLOCK_ROWS_PER_BAND] for row in range(0, len(padded), 4 * _BLOCK_ROWS_PER_BAND)]
    if len(bands) == 1:
        data = _blocks(pixels, bands[0], effort)
    else:
        with ThreadPoolExecutor(threads or core_count()) as pool:
            data = b"".join(pool.map(lambda band: _blocks(pixels, band, effort), bands))
    expected = pixels.level_bytes(texels.shape[:2])
    if len(data) != expected:
        raise ValueError(f"the encoder of {pixels.name} returned {len(data)} bytes, expected {expected}")
    return data


def encode_uastc(
    pixels: PixelFormat, levels: Sequence[NDArray], effort: str = "good", threads: int | None = None
) -> list[bytes]:
    """UASTC blocks of each level; the encoder takes all levels at once.

    Its own file is not kept: it declares primaries for data too and carries a key without a name.

    Args:
        pixels: one of the formats "uastc...".
        levels: (H, W, 4) uint8 each, the largest first.
        effort: one of COMPRESSIONS.
        threads: None takes all cores; the bytes do not depend on it.

    Raises:
        MissingEncoderError: when the encoder is not installed.
    """
    encoder = require_basis("UASTC")
    raw = [(np.ascontiguousarray(level).tobytes(), level.shape[1], level.shape[0]) for level in levels]
    has_alpha = pixels.channels == 4
    # Below quality 100 the encoder trades accuracy for bytes that only Zstandard would save.
    stored = encoder.encode_raw_mips_to_ktx2(
        raw, has_alpha=has_alpha, codec="uastc", quality=100, effort=_UASTC[effort], srgb=pixels.srgb,
        linear=not pixels.srgb, threads=threads or core_count(), check_for_alpha=False, force_alpha=has_alpha,
    )  # fmt: skip
    return _levels_of(stored, len(levels))


def pad_to_blocks(texels: NDArray) -> NDArray:
    """(H, W, C) with both sides rounded up to multiples of 4, by repeating the last row and column."""
    height, width = texels.shape[:2]
    return np.pad(texels, ((0, -height % 4), (0, -width % 4), (0, 0)), mode="edge")


def _channels(pixels: PixelFormat, texels: NDArray) -> NDArray:
    """As many channels as the format takes: RGBA with alpha 1 for the wide ones, the first one or two for BC4, BC5."""
    wanted = 4 if pixels.name not in ("bc4", "bc5") else pixels.channels
    if texels.shape[2] >= wanted:
        return texels[..., :wanted]
    one = 1.0 if pixels.is_float else 255
    full = np.zeros((*texels.shape[:2], 4), texels.dtype)
    full[..., 3] = one
    full[..., : texels.shape[2]] = texels
    return full[..., :wanted]


def _dtype(pixels: PixelFormat) -> str:
    return {1: "u1", 2: "<f2", 4: "<f4"}[pixels.type_size]


def _blocks(pixels: PixelFormat, texels: NDArray, effort: str) -> bytes:
    """Blocks of a band whose sides are multiples of 4."""
    if pixels.name in ("bc4", "bc5"):
        scale = np.float32(1.0 if texels.dtype.kind == "f" else 1.0 / 255.0)
        channels = np.moveaxis(texels, -1, 0)
        return np.concatenate([encode_bc4(channel * scale) for channel in channels], axis=-1).tobytes()
    ispc: Any = importlib.import_module("ispc_texcomp")
    height, width, count = texels.shape
    dtype = np.float16 if pixels.is_float else np.uint8
    packed = np.ascontiguousarray(texels, dtype)
    surface = ispc.RGBASurface(packed.tobytes(), width, height, width * count * packed.itemsize)
    if pixels.name == "bc6h":
        return ispc.compress_blocks_bc6h(surface, ispc.BC6HEncSettings.from_profile(_BC6H[effort]))
    opaque = bool((texels[..., 3] == 255).all())
    profile = _BC7[effort] if opaque else "alpha_" + _BC7[effort]
    return ispc.compress_blocks_bc7(surface, ispc.BC7EncSettings.from_profile(profile))


def _levels_of(ktx2: bytes, count: int) -> list[bytes]:
    """Data of each level of a KTX2 file without supercompression."""
    (levels, supercompression) = struct.unpack_from("<2I", ktx2, 40)
    if levels != count or supercompression:
        raise ValueError(f"the encoder returned {levels} levels, supercompression {supercompression}")
    index = [struct.unpack_from("<3Q", ktx2, 80 + 24 * level) for level in range(count)]
    return [ktx2[offset : offset + length] for offset, length, _ in index]
