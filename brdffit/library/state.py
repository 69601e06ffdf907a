"""Whether a set must be baked again: its manifest's request is compared with the one that would be made now.

A request is everything that a result depends on: the contents of every file that could be read (by SHA-256, used or
not: a new map may take another's place), how they are read, all options, the sources of the program, and the versions
of what its numbers depend on. Files are always hashed, never trusted by size or date: a set cannot be skipped wrongly,
and hashing reads a library in a fraction of the time a bake takes. Files of the output are checked by presence and
size.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from brdffit.errors import InputError
from brdffit.export.manifest import FORMAT
from brdffit.files.image_io import IMAGE_SUFFIXES, file_sha256
from brdffit.library.discovery import material_file, references
from brdffit.library.task import Task
from brdffit.machine import versions
from brdffit.methods import DEFAULT, get_method
from brdffit.options import BakeOptions
from brdffit.pipeline import bake_options, bound_sources
from brdffit.textures.reading import SUFFIXES

_PACKAGE = Path(__file__).resolve().parents[1]
#: Sources that no pixel depends on; a change of them leaves results up to date.
_NO_MATTER = ("cli.py", "cli_options.py", "comparison/", "console.py", "library/", "report/",
              "terminal.py", "tradeoff/", "viewer/")  # fmt: skip
#: Sources of the library that its pictures and manifests depend on.
_MATTER = ("library/bake.py", "library/state.py", "library/thumbnail.py")


@cache
def code_digest(method: str = DEFAULT, model: str | None = None) -> str:
    """SHA-256 of the sources that a bake runs through: kernels, readers, writers, and a method and model of others."""
    digest = hashlib.sha256()
    baselines = _PACKAGE.parent / "baselines"
    for root in (_PACKAGE, baselines):
        for path in sorted(root.rglob("*.py")):
            place = path.relative_to(root).as_posix()
            if root == baselines or place in _MATTER or not place.startswith(_NO_MATTER):
                digest.update(f"{place}\0".encode() + path.read_bytes())
    for path in bound_sources(method, model):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def input_files(task: Task) -> dict[str, Path]:
    """Every file that could be read for a task, by its name as the request has it: relative to the set's folder.

    Raises:
        InputError: when the folder cannot be read.
    """
    found, folder = task.found, task.found.folder
    try:
        if found.files is not None:
            paths = [folder / name for name in found.files]
        elif found.source.is_file():
            paths = []
        else:
            kinds = (*IMAGE_SUFFIXES, *SUFFIXES)
            names = sorted(os.listdir(folder))
            paths = [folder / name for name in names if name.lower().endswith(kinds) and not name.startswith(".")]
    except OSError as error:
        raise InputError(f"'{found.source}' cannot be read: {error.strerror}.") from error
    entry = material_file(found)
    paths += references(entry, found.material) if entry is not None else []
    for text in (task.reading["roles"] or {}).values():
        file, _, channel = text.rpartition(":")
        paths.append(folder / (file if file and channel.upper() in ("R", "G", "B", "A") else text))
    return {Path(os.path.relpath(path, folder)).as_posix(): path for path in paths}


def build_request(task: Task, options: BakeOptions, digests: Mapping[str, str]) -> dict[str, Any]:
    """The request of a task whose files have these digests."""
    resolved = dataclasses.asdict(options)
    del resolved["threads"]
    return {
        "name": task.found.name,
        "reading": task.reading,
        "method": task.method,
        "preset": task.preset,
        "bits": task.bits,
        "compress": task.compress,
        "options": resolved,
        "grouped": task.found.files is not None,
        "files": dict(sorted(digests.items())),
        "code": task.code,
    }


def reason_to_bake(task: Task, manifest: Mapping[str, Any] | None, size_of: Callable[[str], int | None]) -> str | None:
    """Why a set must be baked, in a few words; None where what is there is what would be written.

    Args:
        task: the set and its options.
        manifest: of the set's output, or None.
        size_of: bytes of a file of the output by its relative name, or None where it is missing.
    """
    if manifest is None:
        return "new"
    try:
        if manifest["format"] != FORMAT or manifest["versions"] != versions():
            return "another version"
        was, files = manifest["request"], manifest["files"]
        if any(size_of(name) != said["bytes"] for name, said in files.items()):
            return "incomplete"
        # Cheap checks first: these read no input.
        paths = input_files(task)
        options = bake_options(get_method(task.method), task.preset, task.options)
        now = json.loads(json.dumps(build_request(task, options, dict.fromkeys(paths, ""))))
        apart = {"files": None, "code": None}
        if was | apart != now | apart:
            return "other options"
        if was["code"] != now["code"]:
            return "another version"
        if was["files"].keys() != paths.keys() or any(
            file_sha256(path) != was["files"][name] for name, path in paths.items()
        ):
            return "other inputs"
    except (KeyError, TypeError, AttributeError):
        return "another version"
    except InputError:
        return "other inputs"
    return None
