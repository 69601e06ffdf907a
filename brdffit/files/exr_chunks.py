"""Whether an EXR file is complete, found out without decoding it."""

from __future__ import annotations

import struct
from pathlib import Path

# Column and row of the tile, its two level numbers and the bytes of its data, all int32.
_CHUNK_HEAD = 20


def is_complete(path: Path) -> bool:
    """Whether all chunks of a tiled file of one part are there, one after the other up to the end of the file.

    "OpenEXR File Layout" (openexr.com): magic number and version, attributes (name, type, size, value) up to an empty
    name, the offset of each chunk, the chunks. A chunk that was never written has the offset 0.
    """
    with path.open("rb") as file:
        data = file.read(path.stat().st_size)
    try:
        at = 8
        while data[at]:
            for _ in ("name", "type"):
                at = data.index(0, at) + 1
            at += 4 + struct.unpack_from("<i", data, at)[0]
        table = at + 1
        count = (struct.unpack_from("<Q", data, table)[0] - table) // 8
        starts = sorted(struct.unpack_from(f"<{count}Q", data, table))
        ends = [start + _CHUNK_HEAD + struct.unpack_from("<i", data, start + 16)[0] for start in starts]
    except (struct.error, ValueError, IndexError):
        return False
    return starts == [table + 8 * count, *ends[:-1]] and ends[-1] == len(data)
