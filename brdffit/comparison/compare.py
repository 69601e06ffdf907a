"""Compare all methods with the reference on one texture set after another, and collect the records."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from brdffit.comparison.options import CompareOptions, Listener, PictureFiles, variant
from brdffit.comparison.set_comparison import SetComparison, fit_of
from brdffit.comparison.surroundings import surroundings_of
from brdffit.comparison.views import Studio
from brdffit.machine import core_count, machine
from brdffit.methods import method_names
from brdffit.render import lights as light_sets
from brdffit.report.records import (
    Comparison,
    MethodInfo,
    Report,
    SetResult,
)
from brdffit.svbrdf import Svbrdf
from brdffit.textures.texture_set import TextureSet


def compare(
    sources: Sequence[str | os.PathLike[str] | TextureSet | Svbrdf],
    asked: CompareOptions | Sequence[CompareOptions] = CompareOptions(),  # noqa: B008
    *,
    command: str = "",
    listener: Listener | None = None,
) -> Report:
    """Compare the methods on every set.

    Args:
        sources: folders of textures, .gltf, .glb or .mtlx files, TextureSets or Svbrdfs.
        asked: options of the comparison; one for all sets, or one for each (of the same methods).
        command: command line that repeats the comparison, for the record.
        listener: called with phases and texels.

    Returns:
        The records, with the pictures and pages that they name.

    Raises:
        InputError: for a set or an environment that cannot be used, or when no method can bake a set.
        UnknownNameError: for an unknown name.
    """
    began = time.perf_counter()
    asked_of_each = [asked] * len(sources) if isinstance(asked, CompareOptions) else list(asked)
    asked = asked_of_each[0]
    methods = list(asked.methods) or method_names()
    results: list[SetResult] = []
    pictures: PictureFiles = {}
    viewer: dict[str, str] = {}
    for number, source in enumerate(sources):
        name = _free_name(_name(source, number), [result.name for result in results])
        work = SetComparison(name, source, asked_of_each[number], methods, _studio(asked_of_each[number]), listener)
        results.append(work.run())
        pictures.update(work.pictures)
        viewer.update(work.viewer)
    options: dict[str, Any] = {name: _plain(value) for name, value in asdict(asked.shared).items()}
    comparison = Comparison(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        command=command,
        machine=machine() | {"threads": asked.shared.threads or core_count()},
        options={
            **options, "environment": Path(asked.environment).name if asked.environment else "procedural",
            "pixels": asked.pixels, "frames": asked.frames, "texels": asked.texels, "pairs": asked.pairs,
            "samples": asked.samples, "through_probe": asked.through_probe,
        },
        methods=[
            MethodInfo(name=name, summary=variant(name, asked.options)[0].summary, fit=name == fit_of(methods))
            for name in methods
        ],
        sets=results,
        seconds=time.perf_counter() - began,
    )  # fmt: skip
    return Report(comparison, pictures, viewer)


def _studio(asked: CompareOptions) -> Studio:
    environment, probe = surroundings_of(asked.environment, asked.through_probe)
    return Studio(
        pixels=asked.pixels, frames=asked.frames, samples=asked.samples,
        environment=environment, probe=probe,
        lights=asked.lights or light_sets.few(), lit=asked.lit, terms=asked.terms, reach=asked.shared.reach,
        pixel_filter=asked.shared.pixel_filter, threads=asked.shared.threads,
    )  # fmt: skip


def _plain(value: Any) -> Any:
    """A value as records hold it: of several numbers, their text."""
    return value if value is None or isinstance(value, (bool, int, float, str)) else ",".join(map(str, value))


def _name(source: Any, number: int) -> str:
    if isinstance(source, Svbrdf):
        return f"set-{number + 1}"
    if isinstance(source, TextureSet):
        return source.name
    path = Path(source).resolve()
    return path.name if path.is_dir() else path.stem


def _free_name(name: str, taken: Sequence[str]) -> str:
    """Sets of one name in different folders get numbers."""
    number, free = 2, name
    while free in taken:
        free, number = f"{name}-{number}", number + 1
    return free
