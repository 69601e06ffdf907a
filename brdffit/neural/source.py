"""Sources that a neural material is learned from: a texture set whose height map is traced, or a file of queries."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from brdffit.errors import InputError
from brdffit.microgeometry.queries import Queries, QuerySource, read_queries
from brdffit.microgeometry.tracer import Effects, Microgeometry
from brdffit.neural.material import NeuralMaterial
from brdffit.neural.questions import Answers
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.reading import read_texture_set

#: Smallest and largest side of level 0 that can be learned.
_LEAST, _MOST = 4, 4096
#: Queries for each texel in the paper's training.
_PAPER_QUERIES = 220


class Opened(NamedTuple):
    """A source, (height, width) of level 0, entries for the meta of the file of weights, and sentences for the user."""

    source: QuerySource | Queries
    size: tuple[int, int]
    named: dict[str, Any]
    notes: list[str]


def open_source(
    path: Path, side: int, reading: Mapping[str, Any], bounces: int = 0, threads: int | None = None
) -> Opened:
    """Open a source of queries, and choose the size at which it is learned.

    Args:
        path: a texture set with a height map, or an .npz of measured queries.
        side: texels of the longer side of level 0.
        reading: how the set is read, see ``brdffit.textures.reading``.
        bounces: how often light may be reflected from the surface to itself.
        threads: workers; None for all cores.

    Raises:
        InputError: when the set cannot be read or has no height map, the file holds no queries, or the size cannot be
            learned.
    """
    if path.suffix.lower() == ".npz" and path.is_file():
        measured = read_queries(path)
        size, notes = learned_size(measured.size, side)
        count = len(measured.position)
        each = f"{count / math.prod(size):.0f} a texel of level 0 (the paper has {_PAPER_QUERIES})"
        notes.append(f"{count} measured queries, {each}.")
        return Opened(measured, size, {"source": str(path), "source_size": list(measured.size)}, notes)
    source = open_traced(path, reading, bounces, threads)
    size, notes = learned_size(source.size, side)
    named = {
        "source": str(path), "source_size": list(source.size), "bounces": bounces,
        "reading": {name: value for name, value in reading.items() if value},
    }  # fmt: skip
    return Opened(source, size, named, [*source.notes, *notes])


def open_traced(path: Path, reading: Mapping[str, Any], bounces: int = 0, threads: int | None = None) -> Microgeometry:
    """The traced surface of a texture set.

    Raises:
        InputError: when the set cannot be read or has no height map.
    """
    svbrdf = to_svbrdf(read_texture_set(path, **{name: value for name, value in reading.items() if value}))
    if svbrdf.height is None:
        raise InputError(
            f"'{path}' has no height map and a neural material is learned from one: give --role height=FILE."
        )
    return Microgeometry.of(svbrdf, Effects(bounces=bounces), threads=threads)


def learned_size(source: tuple[int, int], side: int) -> tuple[tuple[int, int], list[str]]:
    """Size of level 0, powers of two, for a tile of ``source`` (height, width) texels and a longer side of ``side``.

    Also returns notes for the user.

    Raises:
        InputError: for a side that cannot be learned.
    """
    if not _LEAST <= side <= _MOST:
        raise InputError(f"A neural material of {side} texels a side cannot be learned, expected {_LEAST} to {_MOST}.")
    exact = [side * length / max(source) for length in source]
    height, width = (1 << max(round(math.log2(length)), 0) for length in exact)
    notes = []
    if (height, width) != tuple(exact):
        notes.append(
            f"Sides must be powers of two: the tile of {source[1]}x{source[0]} texels is learned as {width}x{height}."
        )
    if max(height, width) > max(source):
        notes.append(
            "The material is learned at more texels than its maps have: level 0 holds nothing finer than they."
        )
    return (height, width), notes


def answers_for(material: NeuralMaterial, truth: Path | None) -> Answers | None:
    """The truth of a material: traced from the set ``truth``, or from the set that it was learned from.

    None where that set is not there, or the material was learned from measured queries.

    Raises:
        InputError: when the set cannot be read or has no height map.
    """
    meta = material.meta
    reading, path = {}, truth
    if truth is None:
        reading, path = dict(meta.get("reading") or {}), Path(str(meta.get("source", "")))
        # Measured queries cannot answer new ones.
        if not path.exists() or "source" not in meta or path.suffix.lower() == ".npz":
            return None
    assert path is not None
    source = open_traced(path, reading, int(meta.get("bounces", 0)))
    return Answers(source, material.network.design.size, material.on_plane)


def describe(material: NeuralMaterial, path: Path) -> list[str]:
    """Lines that describe a material and its file."""
    meta, design = material.meta, material.network.design
    height, width = design.size
    how = "as the paper" if meta.get("paper") else "guided by its surface" if meta.get("guided") else "unguided"
    lines = [
        f"{path.name}: {width}x{height} texels, {len(material.network.layout.sizes)} levels, "
        f"{design.weights} weights, {'with' if design.with_offset else 'without'} offset, {how}; "
        f"{path.stat().st_size / 1024:.0f} KiB",
        f"learned from {meta.get('source', 'an unknown source')} in {meta.get('steps')} steps, "
        f"{float(meta.get('seconds') or 0.0) / 60:.1f} minutes, seed {meta.get('seed')}, "
        f"light bouncing {meta.get('bounces', 0)} times",
    ]
    levels = zip(meta.get("mse_by_level", ()), meta.get("snr_db_by_level", ()), strict=False)
    lines += [f"level {k}: MSE {1e3 * mse:.3f}e-3, {snr:.1f} dB" for k, (mse, snr) in enumerate(levels)]
    return lines
