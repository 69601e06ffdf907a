"""Pixel formats of texture containers: what KTX2 and DDS call them, and how large a level is.

Numbers are those of Vulkan (VkFormat), DXGI and the Khronos Data Format Specification 1.3.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from brdffit.svbrdf import level_sizes

#: Bytes of one level, by its number: a writer asks for levels one after another, so that it holds a single one.
LevelData = Callable[[int], bytes]

#: Qualifiers of a signed float.
_FLOAT = 0xC0
_LOWEST_FLOAT, _HIGHEST_FLOAT = (struct.unpack("<I", struct.pack("<f", value))[0] for value in (-1.0, 1.0))


@dataclass(frozen=True)
class Sample:
    """One channel in the data format descriptor of KTX2.

    Attributes:
        bit, bits: where in the block it starts, and how many there are.
        channel: KHR_DF_CHANNEL number with its qualifiers (0x10 linear, 0x40 signed, 0x80 float).
        lower, upper: codes that mean the ends of the range.
    """

    bit: int
    bits: int
    channel: int
    lower: int
    upper: int


@dataclass(frozen=True)
class PixelFormat:
    """How texels are stored.

    Attributes:
        name: as in this program.
        vulkan: VkFormat; 0 for UASTC, which has none.
        dxgi: DXGI number for DDS; None where DDS has none.
        type_size: bytes of the unit that endianness applies to (typeSize of KTX2); 1 for blocks.
        edge: texels an edge of a block: 1 or 4.
        block_bytes: bytes of a block.
        srgb: whether red, green and blue are sRGB-encoded.
        model: KHR_DF_MODEL number.
        samples: channels as KTX2 describes them.
        channels: how many channels an encoder stores.
    """

    name: str
    vulkan: int
    dxgi: int | None
    type_size: int
    edge: int
    block_bytes: int
    srgb: bool
    model: int
    samples: tuple[Sample, ...]
    channels: int

    @property
    def is_float(self) -> bool:
        """Whether numbers are floats."""
        return bool(self.samples[0].channel & 0x80)

    @property
    def takes_floats(self) -> bool:
        """Whether it keeps more of floats than of 8-bit codes: float formats, and BC4 and BC5."""
        return self.is_float or self.name in ("bc4", "bc5")

    def level_bytes(self, size: tuple[int, int]) -> int:
        """Bytes of a level of ``size`` (height, width), rounded up to whole blocks."""
        height, width = size
        return -(-height // self.edge) * -(-width // self.edge) * self.block_bytes


def _plain(bits: int, is_float: bool, srgb: bool = False) -> tuple[Sample, ...]:
    """Red, green, blue and alpha one after another; alpha is linear also where colours are sRGB."""
    lower, upper = (_LOWEST_FLOAT, _HIGHEST_FLOAT) if is_float else (0, 2**bits - 1)
    kind = _FLOAT if is_float else 0
    return tuple(
        Sample(place * bits, bits, number | kind | (0x10 if srgb and number == 15 else 0), lower, upper)
        for place, number in enumerate((0, 1, 2, 15))
    )


def _block(channel: int = 0, bit: int = 0, bits: int = 128) -> Sample:
    return Sample(bit, bits, channel, 0, 2**32 - 1)


_FORMATS = (
    PixelFormat("rgba8", 37, 28, 1, 1, 4, False, 1, _plain(8, False), 4),
    PixelFormat("rgba8_srgb", 43, 29, 1, 1, 4, True, 1, _plain(8, False, True), 4),
    PixelFormat("rgba16f", 97, 10, 2, 1, 8, False, 1, _plain(16, True), 4),
    PixelFormat("rgba32f", 109, 2, 4, 1, 16, False, 1, _plain(32, True), 4),
    PixelFormat("bc4", 139, 80, 1, 4, 8, False, 131, (_block(bits=64),), 1),
    PixelFormat("bc5", 141, 83, 1, 4, 16, False, 132, (_block(bits=64), _block(1, 64, 64)), 2),
    PixelFormat("bc6h", 143, 95, 1, 4, 16, False, 133, (Sample(0, 128, 0x80, 0, _HIGHEST_FLOAT),), 3),
    PixelFormat("bc7", 145, 98, 1, 4, 16, False, 134, (_block(),), 4),
    PixelFormat("bc7_srgb", 146, 99, 1, 4, 16, True, 134, (_block(),), 4),
    PixelFormat("uastc", 0, None, 1, 4, 16, False, 166, (_block(),), 3),
    PixelFormat("uastc_srgb", 0, None, 1, 4, 16, True, 166, (_block(),), 3),
    PixelFormat("uastc_rgba", 0, None, 1, 4, 16, False, 166, (_block(3),), 4),
    PixelFormat("uastc_rgba_srgb", 0, None, 1, 4, 16, True, 166, (_block(3),), 4),
)
FORMATS = {each.name: each for each in _FORMATS}


def chain(size: tuple[int, int], count: int | None = None) -> list[tuple[int, int]]:
    """(height, width) of every level down to 1x1: readers refuse chains that stop short.

    ``count`` levels only, for cube maps whose levels are lobes.
    """
    if min(size) < 1:
        raise ValueError(f"size is {size}, expected at least 1x1")
    sizes = level_sizes(size)
    if count is not None and not 1 <= count <= len(sizes):
        raise ValueError(f"{count} levels of {size}, expected 1 to {len(sizes)}")
    return sizes[:count]


def checked(
    pixels: PixelFormat, sizes: Sequence[tuple[int, int]], levels: LevelData, level: int, faces: int = 1
) -> bytes:
    """The data of a level, of all faces in a row, if it is as long as its size says.

    Raises:
        ValueError: when it is not: an encoder has gone wrong.
    """
    data, expected = levels(level), faces * pixels.level_bytes(sizes[level])
    if len(data) != expected:
        height, width = sizes[level]
        raise ValueError(f"level {level} ({width}x{height}, {pixels.name}) has {len(data)} bytes, expected {expected}")
    return data
