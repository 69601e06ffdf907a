"""One set of a library: read it, then bake it. Two steps, so that the next set is read while this one is fitted.

The files are those of ``brdffit.pipeline.bake_to_folder``; the manifest also holds the request (see ``state``), and
``preview.png`` is a thumbnail.
"""

from __future__ import annotations

import dataclasses
import os
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from brdffit import pipeline
from brdffit.assessment import assess
from brdffit.errors import BrdffitError, InputError
from brdffit.files.image_io import file_sha256
from brdffit.library import store
from brdffit.library.discovery import material_file
from brdffit.library.grouping import named_group
from brdffit.library.state import build_request, code_digest, input_files
from brdffit.library.task import Outcome, Task
from brdffit.library.thumbnail import make_thumbnail
from brdffit.methods import Material, Method, get_method, with_options
from brdffit.svbrdf import Svbrdf
from brdffit.textures.reading import explicit_roles, read_texture_set, set_of_names
from brdffit.textures.settling import settle
from brdffit.textures.texture_set import TextureSet


@cache
def _method(name: str) -> Method:
    # Looked up once a worker: entry points are searched in every package that is installed.
    return get_method(name)


def _options(task: Task) -> Any:
    return pipeline.bake_options(_method(task.method), task.preset, task.options)


@dataclass
class ReadTask:
    """A task with its texels in memory.

    Attributes:
        read: what was read, with the SHA-256 of each file that could be.
        request: all that the result depends on, see ``state``.
        seconds: spent on it.
    """

    read: pipeline.ReadSet
    request: dict[str, Any]
    seconds: float


def read_set(task: Task) -> ReadTask:
    """Hash the inputs of a task, and decode them.

    Raises:
        InputError: for a set that cannot be used, or whose files change while they are read.
    """
    start = time.perf_counter()
    options = _options(task)
    if task.code != code_digest(task.method, task.options.get("model")):
        raise InputError(
            f"'{task.found.source}' was not baked: this worker runs other sources of brdffit than the run that "
            "sent it, expected the same; start the run, or the workers, again."
        )
    files = input_files(task)
    before = _stamps(files)
    digests = {name: file_sha256(path) for name, path in files.items()}
    read = pipeline.read_set(open_set(task), {}, options)
    if _stamps(input_files(task)) != before:
        raise InputError(f"The files of '{task.found.source}' changed while they were read: run again for this set.")
    read.digests = {path: digests[name] for name, path in files.items()}
    return ReadTask(read, build_request(task, options, digests), time.perf_counter() - start)


def open_set(task: Task) -> TextureSet:
    """The texture set of a task; its pixels are read later.

    Raises:
        InputError: as ``read_texture_set``.
    """
    found, reading = task.found, dict(task.reading)
    if found.files is None:
        if found.material or (reading.get("material") and material_file(found) is None):
            reading["material"] = found.material
        texture_set = read_texture_set(found.source, **reading)
        texture_set.name = found.name
        return texture_set
    # The same steps as in read_texture_set, for some files of a folder that holds more.
    named = named_group(found.folder, found.files, found.udim)
    explicit = explicit_roles(found.folder, dict(reading.pop("roles") or {}))
    reading.pop("material", None)
    texture_set = set_of_names(found.folder, named, explicit)
    texture_set.name = found.name
    settle(texture_set, found.folder, **reading)
    return texture_set


def bake_set(task: Task, found: ReadTask, threads: int) -> Outcome:
    """Fit, measure and write a set that was read.

    Raises:
        BrdffitError: as ``bake_to_folder``.
    """
    read = found.read
    phases = pipeline.Phases(reading=found.seconds)
    options = dataclasses.replace(_options(task), threads=threads)
    with store.writing(task, read.material.size) as write:
        baked = pipeline.run(read, _method(task.method), options, phases)
        manifest, _ = pipeline.finish(
            read, baked, phases, write=write, draw=lambda: make_thumbnail(read.material.svbrdf.over_black(), baked),
            record={"request": found.request},
        )  # fmt: skip
    return Outcome(task.key, None, sum(level["texels"] for level in manifest["levels"]), phases.seconds)


def warm_up(methods_and_models: set[tuple[str, str | None]]) -> None:
    """Compile, or load, all that these methods and lobe models (None: the method's own) need, by a small bake."""
    flat = np.zeros((4, 4, 3), np.float32)
    svbrdf = Svbrdf(flat + np.array([0, 0, 1], np.float32), flat - 3.0, flat + 0.5, flat + 0.5, height=flat[..., 0])
    read = pipeline.ReadSet("warm-up", Material(svbrdf))
    for name, model in sorted(methods_and_models, key=str):
        method = get_method(name)
        wanted = {"quality": "draft", "threads": 1} | ({"model": model} if model else {})
        baked = pipeline.run(read, method, with_options(method.options(), wanted), pipeline.Phases())
        assess(read.material, baked)
        make_thumbnail(svbrdf, baked)


def sentence_of(error: BaseException, task: Task) -> str:
    """The sentence about a set that failed."""
    if isinstance(error, BrdffitError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"'{task.found.source}' needs more memory than there is: leave it out, or bake it on a larger machine."
    return f"'{task.found.source}' failed by an error of the program ({type(error).__name__}: {error})."


def _stamps(files: dict[str, Path]) -> dict[str, tuple[int, ...]]:
    stamps: dict[str, tuple[int, ...]] = {}
    for name, path in files.items():
        try:
            stat = os.stat(path)
        except OSError as error:
            raise InputError(f"'{path}' cannot be read: {error.strerror}.") from error
        stamps[name] = (stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_ino)
    return stamps
