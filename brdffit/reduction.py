"""A very large height map becomes a small set: what is finer than its new texels becomes roughness and anisotropy.

``brdffit bake HEIGHT --levels-from K`` makes level K of a height map the level 0 of a set. All of a map of 16384x16384
texels would take 60 GiB, so it is read, turned into lobes and baked in bands of rows, of which one at a time
is in memory. A band has a margin above and below that is cut off again. A pixel filter reaches at most 2 texels of
level K from a texel's centre, and the bilinear base one texel of its own further: with a margin of 2 texels of level K
a band gives each of its texels the numbers that all of the map would. (Where strata are as wide as texels or wider,
from level 6 on in standard quality, samples are jittered by their place in the band.)
"""

from __future__ import annotations

import dataclasses
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.assessment import assess, averaged_levels
from brdffit.errors import InputError
from brdffit.export import writing as export
from brdffit.fitting.status import doubts
from brdffit.machine import free_memory
from brdffit.methods import Baked, Material, Method, Pyramid, get_method, with_options
from brdffit.options import BakeOptions
from brdffit.pipeline import (
    BakeReport,
    Phases,
    ProgressListener,
    ReadSet,
    bake_options,
    finish,
    run,
    split_reading,
)
from brdffit.render.preview import make_preview
from brdffit.svbrdf import Svbrdf
from brdffit.textures.rows import LargeSet, open_large

#: Peak memory in bytes a texel: of a band, of level K, of the shown part while bands are baked, and of it while it is
#: drawn. A test measures that they are enough.
BYTES_PER_TEXEL, BYTES_PER_REDUCED_TEXEL, BYTES_KEPT, BYTES_SHOWN = 320, 300, 60, 420
#: What the C library holds back of memory that threads freed, as a share of the peak: the same bake of 2048x2048 texels
#: peaked at 347 MB with one arena (MALLOC_ARENA_MAX=1) and at up to 496 MB with the usual eight a core.
_HELD_BACK = 0.25
#: Side of the part that the picture shows, and the levels that it shows beyond K.
_SHOWN, _SHOWN_LEVELS = 1024, (0, 1, 3)


@dataclass
class Reduced:
    """Level K of a large set: its ``lobes``, sentences on it, and a part of the base (side, side) for a picture."""

    lobes: Svbrdf
    notes: list[str]
    part: Svbrdf


def reduce_set(large: LargeSet, method: Method, options: BakeOptions, progress: ProgressListener | None) -> Reduced:
    """Bake level K of a large set, band by band.

    Raises:
        InputError: for a method that makes no lobes.
    """
    level = large.level
    only = {} if getattr(options, "reach", None) else {"reach": (level, level)}
    asked = with_options(options, {"levels": level + 1, "keep_level_0": False} | only)
    bands: list[dict[str, NDArray]] = []
    shown: list[dict[str, NDArray]] = []
    statuses: list[NDArray] = []
    done = 0
    total = math.prod(large.size)
    for first, last in large.bands:
        base, before = large.lobes(first << level, last << level)
        material = Material(base)
        if not bands:
            method.prepare(material, asked)

        def told(mip_level: int, texels: int, of: int, done: int = done, share: int = (last - first)) -> None:
            if progress is not None and mip_level == level:
                progress(0, done + texels * share * large.size[1] // of, total)

        baked = method.bake(material, asked, told)
        baked.check_finite(large.texture_set.name)
        if baked.lobes is None:
            raise InputError(f"The method '{method.name}' makes no lobes: no smaller set can be made of it.")
        found = baked.lobes[level]
        cut = slice(before >> level, (before >> level) + last - first)
        bands.append({name: array[cut] for name, array in found.svbrdf.arrays().items() if name != "height"})
        side, above = min(_SHOWN, *large.base), first << level
        if above < side:
            seen = slice(before, before + min(last << level, side) - above)
            shown.append({name: array[seen, :side].copy() for name, array in base.arrays().items()})
        if found.status is not None:
            statuses.append(found.status[cut].copy())
        done += (last - first) * large.size[1]
    lobes = found.svbrdf.replace(**_joined(bands), wrap=base.wrap, height=None)
    return Reduced(lobes, doubts(statuses), base.replace(**_joined(shown)))


def _joined(bands: list[dict[str, NDArray]]) -> dict[str, NDArray]:
    return {name: np.concatenate([band[name] for band in bands]) for name in bands[0]}


def bake_levels_from(
    source: str | os.PathLike[str], output: str | os.PathLike[str], levels_from: int, *, method: str = "bfgs",
    preset: str = "plain", bits: int = 8, compress: str = "good", preview: bool = True,
    progress: ProgressListener | None = None, **options: Any,
) -> BakeReport:  # fmt: skip
    """Bake a set whose level 0 is level ``levels_from`` of a height map, and write OUT/<name>; all files or none.

    Arguments as of ``pipeline.bake_to_folder``.

    Raises:
        InputError: as ``LargeSet``, and when memory will not do, before the run.
        UnknownNameError, OutputError: as ``bake_to_folder``.
    """
    if levels_from < 1:
        raise InputError(f"Levels are taken from {levels_from} on, expected 1 or more: a plain bake has them from 0.")
    reading, given = split_reading(options)
    chosen = get_method(method)
    asked = bake_options(chosen, preset, given)
    phases = Phases(progress)
    with phases("reading"):
        texture_set = open_large(source, reading)
        folder = Path(output) / texture_set.name
        large = LargeSet(texture_set, levels_from, asked.min_roughness)
    with large:
        export.check_writable(folder, large.size, preset, bits)
        _check_memory(large, phases)
        with phases("fitting"):
            reduced = reduce_set(large, chosen, asked, progress)
        texture_set.notes += [note for note in large.notes if note not in texture_set.notes]
    read = ReadSet(texture_set.name, Material(reduced.lobes), texture_set)
    baked = run(read, chosen, with_options(asked, {"keep_level_0": True}), phases)
    shown, figures = _held_against(reduced, baked, levels_from, asked)
    height, width = texture_set.size
    texture_set.note(
        f"Level 0 is level {levels_from} of {width}x{height} texels: half-angle SNR {figures['snr_db']:.1f} dB on "
        f"random texels, of averaged maps {figures['averaged_snr_db']:.1f} dB."
    )
    texture_set.notes += reduced.notes

    def draw() -> NDArray:
        averaged, after = shown
        levels = [levels_from + more for more in _SHOWN_LEVELS]
        return make_preview(
            reduced.part, averaged, after, title=read.name, name=baked.method, levels=levels, threads=asked.threads
        )

    manifest, measured = finish(
        read, baked, phases,
        write=lambda done, made, picture: export.write_baked(
            done, folder, name=read.name, preset=preset, bits=bits, compress=compress, manifest=made, preview=picture
        ),
        draw=draw if preview else None,
        record={"levels_from": {"level": levels_from, "size": [width, height], **figures}},
    )  # fmt: skip
    return BakeReport(folder, baked, measured, [*baked.notes, *read.notes], phases.seconds, manifest)


def predicted_memory(large: LargeSet) -> int:
    """Bytes that a bake takes at most, in addition to those of the program itself."""
    band = large.rows_of_band * large.base[1]
    shown = min(_SHOWN, *large.base) ** 2
    peak = max(BYTES_PER_TEXEL * band + BYTES_KEPT * shown, BYTES_SHOWN * shown)
    return round((1.0 + _HELD_BACK) * (peak + BYTES_PER_REDUCED_TEXEL * math.prod(large.size)))


def _check_memory(large: LargeSet, phases: Phases) -> None:
    """Report the predicted memory, and refuse a bake that needs more than is free.

    Raises:
        InputError: with what is needed and what is free.
    """
    height, width = large.size
    needed, free = predicted_memory(large), free_memory()
    sizes = f"{large.texture_set.size[1]}x{large.texture_set.size[0]} texels become {width}x{height}"
    large.texture_set.note(f"{sizes} in {len(large.bands)} bands; memory predicted: {needed / 2**30:.2f} GiB.")
    if phases.progress is not None:
        phases.progress.phase(f"{sizes} in {len(large.bands)} bands, about {needed / 2**30:.2f} GiB of memory")
    if free is not None and needed > free:
        raise InputError(
            f"'{large.texture_set.name}': {sizes} in about {needed / 2**30:.2f} GiB of memory, and "
            f"{free / 2**30:.2f} GiB are free: take levels from further on."
        )


def _held_against(
    reduced: Reduced, baked: Baked, level: int, options: BakeOptions
) -> tuple[tuple[Pyramid, Pyramid], dict[str, float]]:
    """The shown part by averaged maps and by the result, and the SNR in dB of level K of both on it."""
    material = Material(reduced.part)
    averaged = averaged_levels(material, with_options(options, {"levels": None, "keep_level_0": False}))
    assert baked.lobes is not None
    own = []
    for k, each in enumerate(averaged.levels):
        made = each.svbrdf
        if k >= level:
            height, width = made.size
            source = baked.lobes[min(k - level, len(baked.lobes) - 1)].svbrdf
            made = source.replace(**{name: array[:height, :width] for name, array in source.arrays().items()})
        own.append(dataclasses.replace(each, svbrdf=made))
    after = Pyramid(baked.method, baked.lobes.options, own)
    found = [assess(material, Baked.of_lobes(each), only=(level,))[level]["snr_db"] for each in (after, averaged)]
    return (averaged, after), {"snr_db": found[0], "averaged_snr_db": found[1]}
