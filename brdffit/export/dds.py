"""DDS files whose MIP levels are given: a writer that holds one level at a time.

Source: DDS_HEADER and DDS_HEADER_DXT10 (Microsoft, Direct3D documentation). The DX10 header is always written, since
the old one cannot say sRGB; a 2-D texture always has all levels, since Godot refuses a chain that stops short.
"""

from __future__ import annotations

import struct
from typing import BinaryIO

from brdffit.export.formats import LevelData, PixelFormat, chain, checked

_CAPS, _HEIGHT, _WIDTH, _PITCH, _PIXEL_FORMAT, _MIP_COUNT, _LINEAR_SIZE = 1, 2, 4, 8, 0x1000, 0x20000, 0x80000
_COMPLEX, _TEXTURE, _MIPMAP = 0x8, 0x1000, 0x400000
_FOURCC, _TEXTURE_2D = 0x4, 3
#: Caps of a cube map with six faces, and the flag of the DX10 header.
_ALL_FACES, _CUBE = 0xFE00, 0x4


def write_dds(file: BinaryIO, pixels: PixelFormat, size: tuple[int, int], levels: LevelData, *, faces: int = 1,
    count: int | None = None,
) -> None:  # fmt: skip
    """Write a 2-D texture with all levels down to 1x1, or a cube map (whose data is held whole: faces come one by one).

    Args:
        file: opened for writing in binary.
        pixels: a format with a DXGI number.
        size: (height, width) of level 0.
        levels: data of a level by its number, rows from the top without padding; asked from the largest level on.
            Of a cube map the faces +X -X +Y -Y +Z -Z in a row.
        faces: 6 for a cube map.
        count: levels of a cube map that are given; None for all.

    Raises:
        ValueError: when a level has the wrong number of bytes, or the format has no DXGI number.
        OSError: when the file cannot be written.
    """
    sizes = chain(size, count)
    file.write(header(pixels, size, len(sizes), faces))
    if faces == 1:
        for level in range(len(sizes)):
            file.write(checked(pixels, sizes, levels, level))
        return
    whole = [checked(pixels, sizes, levels, level, faces) for level in range(len(sizes))]
    for face in range(faces):
        for data in whole:
            each = len(data) // faces
            file.write(data[face * each : (face + 1) * each])


def header(pixels: PixelFormat, size: tuple[int, int], levels: int, faces: int = 1) -> bytes:
    """What stands before the data of ``levels`` levels: 148 bytes.

    Raises:
        ValueError: when the format has no DXGI number.
    """
    if pixels.dxgi is None:
        raise ValueError(f"DDS has no {pixels.name}")
    height, width = size
    blocks = pixels.edge > 1
    flags = _CAPS | _HEIGHT | _WIDTH | _PIXEL_FORMAT | (_LINEAR_SIZE if blocks else _PITCH)
    caps = _TEXTURE
    if levels > 1:
        flags, caps = flags | _MIP_COUNT, caps | _COMPLEX | _MIPMAP
    pitch = pixels.level_bytes(size) if blocks else width * pixels.block_bytes
    return (
        struct.pack("<4s7I44x", b"DDS ", 124, flags, height, width, pitch, 0, levels)
        + struct.pack("<2I4s5I", 32, _FOURCC, b"DX10", 0, 0, 0, 0, 0)
        + struct.pack("<5I", caps, _ALL_FACES if faces == 6 else 0, 0, 0, 0)
        + struct.pack("<5I", pixels.dxgi, _TEXTURE_2D, _CUBE if faces == 6 else 0, 1, 0)
    )
