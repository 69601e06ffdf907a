"""Readers of containers for the tests: strict ones of our own, and those of others, where they are installed."""

from __future__ import annotations

import shutil
import struct
import subprocess
from math import lcm
from pathlib import Path

import pytest
import zstandard

from brdffit.export.formats import FORMATS

CLIENTS = Path(__file__).parent / "clients"


def node(script, *arguments):
    """Run a script of tests/clients; skips where Node or its packages are not installed."""
    if shutil.which("node") is None:
        pytest.skip("Node.js is not installed")
    if not (CLIENTS / "node_modules").exists():
        pytest.skip("npm install --prefix tests/clients has not been run")
    return subprocess.run(
        ["node", str(CLIENTS / script), *map(str, arguments)], capture_output=True, text=True, check=False, timeout=300
    )


def read_ktx2(data):
    """(vkFormat, (height, width), levels) of a KTX2 file's bytes; the rules of the specification hold."""
    assert data[:12] == b"\xabKTX 20\xbb\r\n\x1a\n"
    vulkan, type_size, width, height, depth, layers, faces, count, scheme = struct.unpack_from("<9I", data, 12)
    dfd, dfd_bytes, kvd, kvd_bytes, sgd, sgd_bytes = struct.unpack_from("<4I2Q", data, 48)
    assert (depth, layers, faces, sgd, sgd_bytes) == (0, 0, 1, 0, 0)
    assert scheme in (0, 2)
    assert count == max(width, height).bit_length()
    index = [struct.unpack_from("<3Q", data, 80 + 24 * level) for level in range(count)]

    # The descriptor: its length twice, the model, the block, and as many samples as fill it.
    assert dfd == 80 + 24 * count
    total, vendor, version, block_bytes = struct.unpack_from("<IIHH", data, dfd)
    assert (total, vendor, version, block_bytes) == (dfd_bytes, 0, 2, dfd_bytes - 4)
    model, primaries, transfer, flags, edge_x, edge_y, edge_z, edge_w, plane_bytes = struct.unpack_from(
        "<9B", data, dfd + 12
    )
    matching = [
        each
        for each in FORMATS.values()
        if (each.vulkan, each.model, each.srgb) == (vulkan, model, transfer == 2)
        and len(each.samples) == (dfd_bytes - 28) // 16
        and each.samples[0].channel == data[dfd + 28 + 3]
    ]
    assert len(matching) == 1
    pixels = matching[0]
    assert (edge_x + 1, edge_y + 1, edge_z, edge_w) == (pixels.edge, pixels.edge, 0, 0)
    assert (plane_bytes, flags, type_size) == (pixels.block_bytes, 0, pixels.type_size)
    assert primaries == (0 if vulkan == 0 and transfer == 1 else 1)
    bits = 0
    for number in range(len(pixels.samples)):
        offset, length, _ = struct.unpack_from("<HBB", data, dfd + 28 + 16 * number)
        assert offset == bits
        bits += length + 1
    assert bits == 8 * pixels.block_bytes

    # Keys: sorted, each value closed by a zero, each padded with zeros to four bytes.
    assert kvd == dfd + dfd_bytes
    at, keys = kvd, []
    while at < kvd + kvd_bytes:
        (length,) = struct.unpack_from("<I", data, at)
        key, value, _ = data[at + 4 : at + 4 + length].split(b"\0")
        padding = data[at + 4 + length : at + 4 + length + -length % 4]
        assert not any(padding)
        keys.append((key.decode(), value.decode()))
        at += 4 + length + len(padding)
    assert at == kvd + kvd_bytes
    assert keys == sorted(keys)
    assert ("KTXorientation", "rd") in keys

    # Levels: the smallest first, aligned, nothing between them but zeros, nothing behind the last.
    end = kvd + kvd_bytes
    levels = [b""] * count
    for level in reversed(range(count)):
        offset, stored, plain = index[level]
        assert end <= offset < end + 16
        assert not any(data[end:offset])
        assert scheme == 2 or offset % lcm(pixels.block_bytes, 4) == 0
        content = data[offset : offset + stored]
        if scheme == 2:
            assert zstandard.frame_content_size(content) == plain
            content = zstandard.ZstdDecompressor().decompress(content)
        size = max(1, height >> level), max(1, width >> level)
        assert len(content) == plain == pixels.level_bytes(size)
        levels[level] = content
        end = offset + stored
    assert end == len(data)
    return pixels, (height, width), levels


def read_dds(data):
    """(format, (height, width), levels) of a DDS file's bytes with a DX10 header."""
    assert data[:4] == b"DDS "
    header, flags, height, width, pitch, depth, count = struct.unpack_from("<7I", data, 4)
    assert (header, depth) == (124, 0)
    assert count == max(width, height).bit_length()
    assert struct.unpack_from("<2I4s", data, 76) == (32, 4, b"DX10")
    (caps,) = struct.unpack_from("<I", data, 108)
    dxgi, dimension, misc, array, alpha = struct.unpack_from("<5I", data, 128)
    assert (dimension, misc, array, alpha) == (3, 0, 1, 0)
    (pixels,) = (each for each in FORMATS.values() if each.dxgi == dxgi)
    blocks = pixels.edge > 1
    assert flags == 0x1007 | (0x80000 if blocks else 0x8) | (0x20000 if count > 1 else 0)
    assert caps == 0x1000 | (0x400008 if count > 1 else 0)
    assert pitch == (pixels.level_bytes((height, width)) if blocks else width * pixels.block_bytes)
    levels, at = [], 148
    for level in range(count):
        length = pixels.level_bytes((max(1, height >> level), max(1, width >> level)))
        levels.append(data[at : at + length])
        at += length
    assert at == len(data)
    return pixels, (height, width), levels
