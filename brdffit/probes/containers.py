"""Cube maps with their levels in KTX2, KTX1 and DDS: a writer, packed formats, and a reader.

Levels are lists of cube maps (6, n, n, 3), the largest first, faces in the order +X -X +Y -Y +Z -Z. Sources: KTX File
Format Specification 1 and 2, the DDS documentation, EXT_texture_shared_exponent, EXT_packed_float.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zstandard
from numpy.typing import NDArray

from brdffit.errors import InputError, OutputError
from brdffit.export.compression import encode_level
from brdffit.export.dds import write_dds
from brdffit.export.decompression import decode_blocks
from brdffit.export.formats import FORMATS, PixelFormat, Sample
from brdffit.export.ktx2 import IDENTIFIER, key_values, write_ktx2

#: Compression level of Zstandard.
_ZSTD_LEVEL = 19
_KTX1 = b"\xabKTX 11\xbb\r\n\x1a\n"


class RadianceFormat(NamedTuple):
    """A way to store radiance.

    Attributes:
        pixels: the format as KTX2 and DDS number it.
        largest: largest value that is written.
        opengl: (type, format, internal format) of a KTX1 header; None where KTX1 cannot hold the format here.
    """

    pixels: PixelFormat
    largest: float
    opengl: tuple[int, int, int] | None


_ONE = 0x3F800000
#: Three mantissas of 9 bits, each followed by the exponent that they share, of bias 15. In KTX2's data format
#: descriptor the mantissa's upper value, which stands for 1, is then 8448 = 2^9 (1 + 31/2).
_SHARED_EXPONENT = tuple(
    sample
    for channel in range(3)
    for sample in (Sample(9 * channel, 9, channel, 0, 8448), Sample(27, 5, 0x20 | channel, 15, 31))
)
_SMALL_FLOATS = (Sample(0, 11, 0x80, 0, _ONE), Sample(11, 11, 0x81, 0, _ONE), Sample(22, 10, 0x82, 0, _ONE))
_RGB9E5 = PixelFormat("rgb9e5", 123, 67, 4, 1, 4, False, 1, _SHARED_EXPONENT, 3)
_R11G11B10F = PixelFormat("r11g11b10f", 122, 26, 4, 1, 4, False, 1, _SMALL_FLOATS, 3)
RADIANCE_FORMATS = {
    "rgba16f": RadianceFormat(FORMATS["rgba16f"], 65504.0, (0x140B, 0x1908, 0x881A)),
    "rgba32f": RadianceFormat(FORMATS["rgba32f"], 3.0e38, (0x1406, 0x1908, 0x8814)),
    "rgb9e5": RadianceFormat(_RGB9E5, 65408.0, (0x8C3E, 0x1907, 0x8C3D)),
    "r11g11b10f": RadianceFormat(_R11G11B10F, 64512.0, (0x8C3B, 0x1907, 0x8C3A)),
    "bc6h": RadianceFormat(FORMATS["bc6h"], 65504.0, None),
}


def pack_rgb9e5(radiance: NDArray) -> NDArray:
    """(...,) uint32 of (..., 3) radiance: three mantissas of 9 bits, one exponent of bias 15; clamped to 65408."""
    x = np.clip(np.asarray(radiance, np.float64), 0.0, RADIANCE_FORMATS["rgb9e5"].largest)
    largest = x.max(axis=-1)
    exponent = np.maximum(-16.0, np.floor(np.log2(np.maximum(largest, 1e-30)))) + 16.0
    # Where rounding carries a mantissa to 2^9, the exponent grows by one.
    exponent += np.floor(largest / np.exp2(exponent - 24.0) + 0.5) == 512.0
    mantissa = np.floor(x / np.exp2(exponent - 24.0)[..., None] + 0.5).astype(np.uint32)
    return mantissa[..., 0] | mantissa[..., 1] << 9 | mantissa[..., 2] << 18 | exponent.astype(np.uint32) << 27


def unpack_rgb9e5(packed: NDArray) -> NDArray:
    """(..., 3) float32 of what ``pack_rgb9e5`` gives."""
    unit = np.exp2((packed >> 27).astype(np.float64) - 24.0)
    return np.stack([(packed >> shift & 511) * unit for shift in (0, 9, 18)], axis=-1).astype(np.float32)


def _small_float(x: NDArray, bits: int) -> NDArray:
    """uint32 bit patterns of unsigned floats with 5 bits of exponent and ``bits`` of mantissa, rounded to nearest."""
    x = np.clip(np.asarray(x, np.float64), 0.0, (2.0 - 2.0**-bits) * 2.0**15)
    exponent = np.clip(np.floor(np.log2(np.maximum(x, 2.0**-14))), -14.0, 15.0)
    # The leading one of normal numbers, and a mantissa that rounding carries over, add one to the exponent's field.
    return (np.round(x / np.exp2(exponent - bits)) + (exponent + 14.0) * 2.0**bits).astype(np.uint32)


def pack_r11g11b10f(radiance: NDArray) -> NDArray:
    """(...,) uint32 of (..., 3) radiance: floats of 11, 11 and 10 bits without a sign; clamped to 64512."""
    x = np.minimum(radiance, RADIANCE_FORMATS["r11g11b10f"].largest)
    return _small_float(x[..., 0], 6) | _small_float(x[..., 1], 6) << 11 | _small_float(x[..., 2], 5) << 22


def unpack_r11g11b10f(packed: NDArray) -> NDArray:
    """(..., 3) float32 of what ``pack_r11g11b10f`` gives: halves without a sign, of shorter mantissas."""
    halves = [(packed >> shift & (1 << bits + 5) - 1) << 10 - bits for shift, bits in ((0, 6), (11, 6), (22, 5))]
    return np.stack(halves, axis=-1).astype(np.uint16).view(np.float16).astype(np.float32)


def encoded(cube: NDArray, texel_format: str) -> bytes:
    """Bytes of a cube map (6, n, n, 3), face by face; values beyond the format are clamped, never infinite."""
    cube = np.clip(np.asarray(cube, np.float32), 0.0, RADIANCE_FORMATS[texel_format].largest)
    if texel_format == "rgb9e5":
        return pack_rgb9e5(cube).astype("<u4").tobytes()
    if texel_format == "r11g11b10f":
        return pack_r11g11b10f(cube).astype("<u4").tobytes()
    opaque = np.concatenate([cube, np.ones_like(cube[..., :1])], axis=-1)
    return b"".join(encode_level(RADIANCE_FORMATS[texel_format].pixels, face) for face in opaque)


def _decoded(data: bytes, n: int, texel_format: str) -> NDArray:
    """(6, n, n, 3) float32 of ``encoded`` bytes.

    Raises:
        ValueError: when there are too few of them.
    """
    pixels = RADIANCE_FORMATS[texel_format].pixels
    size = pixels.level_bytes((n, n))
    if len(data) < 6 * size:
        raise ValueError(f"a level has {len(data)} bytes, expected {6 * size}")
    unpack = {"rgb9e5": unpack_rgb9e5, "r11g11b10f": unpack_r11g11b10f}.get(texel_format)
    if unpack:
        return unpack(np.frombuffer(data, "<u4", 6 * n * n).reshape(6, n, n))
    faces = [decode_blocks(pixels, (n, n), data[face * size : (face + 1) * size]) for face in range(6)]
    return np.stack(faces)[..., :3]


def write_cube(
    path: Path, container: str, levels: Sequence[NDArray], texel_format: str, metadata: Mapping[str, str] | None = None
) -> None:
    """Write a cube map with these levels.

    Args:
        path: the file.
        container: "ktx2" (with Zstandard), "dds" (DX10 header) or "ktx1".
        levels: cube maps (6, n, n, 3), each half the size of the one before.
        texel_format: a name of RADIANCE_FORMATS.
        metadata: key-value pairs of KTX1.

    Raises:
        OutputError: when it cannot be written.
    """
    pixels, n = RADIANCE_FORMATS[texel_format].pixels, levels[0].shape[1]

    def data(level: int) -> bytes:
        return encoded(levels[level], texel_format)

    try:
        with path.open("wb") as file:
            if container == "ktx2":
                write_ktx2(file, pixels, (n, n), data, zstd=_ZSTD_LEVEL, faces=6, count=len(levels))
            elif container == "dds":
                write_dds(file, pixels, (n, n), data, faces=6, count=len(levels))
            else:
                file.write(_ktx1([data(level) for level in range(len(levels))], n, texel_format, metadata or {}))
    except OSError as error:
        raise OutputError(f"'{path}' could not be written: {error.strerror}.") from error


def _ktx1(levels: Sequence[bytes], n: int, texel_format: str, metadata: Mapping[str, str]) -> bytes:
    """Bytes of a KTX1 cube map. imageSize counts one face; rows of at least 4 bytes a texel need no padding."""
    pairs = key_values(metadata)
    pixels, _, opengl = RADIANCE_FORMATS[texel_format]
    if opengl is None:
        raise ValueError(f"KTX1 has no {texel_format} here")
    gl_type, gl_format, internal = opengl
    head = _KTX1 + struct.pack(
        "<13I", 0x04030201, gl_type, pixels.type_size, gl_format, internal, gl_format, n, n, 0, 0, 6, len(levels),
        len(pairs),
    )  # fmt: skip
    return head + pairs + b"".join(struct.pack("<I", len(data) // 6) + data for data in levels)


@dataclass(frozen=True)
class CubeFile:
    """A cube map that was read: its levels, how they are stored, and the file's key-value pairs."""

    levels: list[NDArray]
    texel_format: str
    metadata: dict[str, str] = field(default_factory=dict)


def read_cube_file(path: Path) -> CubeFile:
    """Read a cube map in KTX2, KTX1 or DDS, in one of RADIANCE_FORMATS.

    Raises:
        InputError: when it cannot be read, is no cube map, is damaged, or is stored in another format.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}.") from error
    readers = {IDENTIFIER[:7]: _read_ktx2, _KTX1[:7]: _read_ktx1, b"DDS ": _read_dds}
    for magic, reader in readers.items():
        if data.startswith(magic):
            try:
                return reader(path, data)
            except (struct.error, ValueError, zstandard.ZstdError) as error:
                what = "a header ends early" if isinstance(error, struct.error) else error
                raise InputError(f"'{path}' is truncated or damaged ({what}).") from error
    raise InputError(f"'{path}' is no KTX2, KTX1 or DDS file.")


def _named(path: Path, container: str, number: int) -> str:
    for name, (pixels, _, opengl) in RADIANCE_FORMATS.items():
        if number == {"KTX2": pixels.vulkan, "DDS": pixels.dxgi, "KTX1": opengl and opengl[2]}[container]:
            return name
    raise InputError(
        f"'{path}' is stored in format {number} of {container}, expected one of {', '.join(RADIANCE_FORMATS)}."
    )


def _need_cube(path: Path, faces: int, width: int, height: int) -> None:
    if faces != 6 or width != height or width == 0:
        raise InputError(f"'{path}' holds {faces} faces of {width}x{height}, expected the six square faces of a cube.")


def _read_pairs(data: bytes) -> dict[str, str]:
    out, at = {}, 0
    while at + 4 <= len(data):
        (size,) = struct.unpack_from("<I", data, at)
        key, _, value = data[at + 4 : at + 4 + size].partition(b"\0")
        out[key.decode(errors="replace")] = value.rstrip(b"\0").decode(errors="replace")
        at += 4 + size + (-size % 4)
    return out


def _read_ktx2(path: Path, data: bytes) -> CubeFile:
    vulkan, _, width, height, _, _, faces, count, packing = struct.unpack_from("<9I", data, 12)
    _need_cube(path, faces, width, height)
    texel_format = _named(path, "KTX2", vulkan)
    if packing not in (0, 2):
        raise InputError(f"'{path}' is supercompressed by scheme {packing}, expected none or Zstandard.")
    pairs_at, pairs_size = struct.unpack_from("<2I", data, 56)
    levels = []
    for k in range(max(count, 1)):
        at, size, _ = struct.unpack_from("<3Q", data, 80 + 24 * k)
        stored = data[at : at + size]
        plain = zstandard.ZstdDecompressor().decompress(stored) if packing == 2 else stored
        levels.append(_decoded(plain, max(width >> k, 1), texel_format))
    return CubeFile(levels, texel_format, _read_pairs(data[pairs_at : pairs_at + pairs_size]))


def _read_ktx1(path: Path, data: bytes) -> CubeFile:
    head = struct.unpack_from("<13I", data, 12)
    internal, width, height, faces, count, pairs_size = head[4], head[6], head[7], head[10], head[11], head[12]
    _need_cube(path, faces, width, height)
    texel_format = _named(path, "KTX1", internal)
    at, levels = 64 + pairs_size, []
    for k in range(max(count, 1)):
        (size,) = struct.unpack_from("<I", data, at)
        levels.append(_decoded(data[at + 4 : at + 4 + 6 * size], max(width >> k, 1), texel_format))
        at += 4 + 6 * size
    return CubeFile(levels, texel_format, _read_pairs(data[64 : 64 + pairs_size]))


def _read_dds(path: Path, data: bytes) -> CubeFile:
    height, width, _, _, count = struct.unpack_from("<5I", data, 12)
    fourcc, caps2 = data[84:88], struct.unpack_from("<I", data, 112)[0]
    _need_cube(path, 6 if caps2 & 0xFE00 == 0xFE00 else 1, width, height)
    if fourcc == b"DX10":
        texel_format, start = _named(path, "DDS", struct.unpack_from("<I", data, 128)[0]), 148
    else:
        # Numbers of D3DFMT_A16B16G16R16F and A32B32G32R32F.
        old = {113: "rgba16f", 116: "rgba32f"}
        number = struct.unpack("<I", fourcc)[0]
        if number not in old:
            raise InputError(f"'{path}' is stored as {fourcc!r}, expected floats (113, 116) or a DX10 header.")
        texel_format, start = old[number], 128
    sides = [max(width >> k, 1) for k in range(max(count, 1))]
    pixels = RADIANCE_FORMATS[texel_format].pixels
    ends = list(accumulate(pixels.level_bytes((n, n)) for n in sides))
    # Faces stand one after another, each with all of its levels.
    faces = [data[start + face * ends[-1] : start + (face + 1) * ends[-1]] for face in range(6)]
    chains = [b"".join(face[first:end] for face in faces) for first, end in zip([0, *ends], ends, strict=False)]
    levels = [_decoded(level, n, texel_format) for level, n in zip(chains, sides, strict=True)]
    return CubeFile(levels, texel_format)
