"""KTX2 files whose MIP levels are given: a writer that holds one level at a time.

Source: KTX File Format Specification 2.0 (Khronos), Data Format Specification 1.3. Levels lie in the file from the
smallest to the largest, so that a reader that streams shows something early; the index lists the largest first. The
same levels give the same bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from math import lcm
from typing import BinaryIO

from brdffit.export.formats import LevelData, PixelFormat, chain, checked

IDENTIFIER = b"\xabKTX 20\xbb\r\n\x1a\n"
_HEADER_BYTES, _INDEX_BYTES = 80, 24
_ZSTD = 2
_BT709, _NO_PRIMARIES = 1, 0
_LINEAR, _SRGB = 1, 2


def write_ktx2(
    file: BinaryIO, pixels: PixelFormat, size: tuple[int, int], levels: LevelData, *, zstd: int | None = None,
    faces: int = 1, count: int | None = None,
) -> None:  # fmt: skip
    """Write a 2-D texture with all levels down to 1x1, or a cube map.

    Args:
        file: opened for writing in binary, at its beginning, seekable.
        pixels: the format.
        size: (height, width) of level 0.
        levels: data of a level by its number, rows from the top without padding; asked from the smallest level on.
            Of a cube map the faces +X -X +Y -Y +Z -Z in a row.
        zstd: level of Zstandard supercompression, or None for none.
        faces: 6 for a cube map.
        count: levels of a cube map that are given; None for all.

    Raises:
        ValueError: when a level has the wrong number of bytes.
        OSError: when the file cannot be written.
    """
    sizes = chain(size, count)
    descriptor = _descriptor(pixels)
    # Rows run down the picture.
    pairs = key_values({"KTXorientation": "rd", "KTXwriter": "brdffit"})
    at_descriptor = _HEADER_BYTES + _INDEX_BYTES * len(sizes)
    at_pairs = at_descriptor + len(descriptor)
    start = file.tell()
    file.write(bytes(at_descriptor) + descriptor + pairs)
    position = at_pairs + len(pairs)
    # Supercompressed levels need no alignment; others that of their blocks and of four bytes.
    alignment = 1 if zstd is not None else lcm(pixels.block_bytes, 4)
    index = [(0, 0, 0)] * len(sizes)
    for level in reversed(range(len(sizes))):
        data = checked(pixels, sizes, levels, level, faces)
        stored = data if zstd is None else _compressed(data, zstd)
        padding = -position % alignment
        file.write(bytes(padding))
        file.write(stored)
        index[level] = (position + padding, len(stored), len(data))
        position += padding + len(stored)
    height, width = size
    supercompression = 0 if zstd is None else _ZSTD
    header = IDENTIFIER + struct.pack(
        "<9I", pixels.vulkan, pixels.type_size, width, height, 0, 0, faces, len(sizes), supercompression
    )
    header += struct.pack("<4I2Q", at_descriptor, len(descriptor), at_pairs, len(pairs), 0, 0)
    file.seek(start)
    file.write(header + b"".join(struct.pack("<3Q", *entry) for entry in index))
    file.seek(start + position)


def _compressed(data: bytes, zstd: int) -> bytes:
    import zstandard

    # Readers size their buffers by the frame's own content size.
    return zstandard.ZstdCompressor(level=zstd, write_content_size=True).compress(data)


def _descriptor(pixels: PixelFormat) -> bytes:
    """The basic block of the data format descriptor, behind its length."""
    # KHR_texture_basisu wants no primaries where there is no colour.
    primaries = _NO_PRIMARIES if pixels.vulkan == 0 and not pixels.srgb else _BT709
    transfer = _SRGB if pixels.srgb else _LINEAR
    edge = pixels.edge - 1
    block = struct.pack(
        "<IHH4B4B8B", 0, 2, 24 + 16 * len(pixels.samples), pixels.model, primaries, transfer, 0, edge, edge, 0, 0,
        pixels.block_bytes, *[0] * 7,
    )  # fmt: skip
    for sample in pixels.samples:
        block += struct.pack(
            "<HBB4BII", sample.bit, sample.bits - 1, sample.channel, 0, 0, 0, 0, sample.lower, sample.upper
        )
    return struct.pack("<I", 4 + len(block)) + block


def key_values(values: Mapping[str, str]) -> bytes:
    """Keys and values as KTX2 and KTX1 hold them: sorted, each padded to four bytes."""
    pairs = b""
    for key, value in sorted(values.items()):
        entry = key.encode() + b"\0" + value.encode() + b"\0"
        pairs += struct.pack("<I", len(entry)) + entry + bytes(-len(entry) % 4)
    return pairs
