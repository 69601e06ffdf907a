"""One set of a library as a piece of work: plain data that goes to a worker, on this machine or another."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Found:
    """A texture set below the root of a library.

    Attributes:
        key: its folder below the output, with slashes; its last part names the set.
        source: the folder, or the .gltf, .glb or .mtlx file.
        files: names of the folder's files that are this set, where the folder holds several; else None.
        udim: tile of a UDIM set (1001 and up), or None.
        material: name of the material in a file that holds several, or None.
    """

    key: str
    source: Path
    files: tuple[str, ...] | None = None
    udim: int | None = None
    material: str | None = None

    @property
    def name(self) -> str:
        """Name of the set, as it stands in the names of its pictures."""
        return self.key.rpartition("/")[2]

    @property
    def folder(self) -> Path:
        """The folder its files are relative to."""
        return self.source if self.source.is_dir() else self.source.parent


@dataclass(frozen=True)
class Task:
    """A set, and how it is to be baked.

    Attributes:
        found: the set.
        output: root of the library's output: a folder, or an address that fsspec knows.
        reading: arguments of ``read_texture_set``, those of ``textures.READING_OPTIONS``.
        method, preset, bits, compress: as in ``brdffit.pipeline.bake_to_folder``.
        options: options of the method that were given, by name.
        code: digest of the sources that are to bake it, see ``state.code_digest``.
    """

    found: Found
    output: str
    reading: dict[str, Any]
    method: str
    preset: str
    bits: int
    compress: str
    options: dict[str, Any]
    code: str

    @property
    def key(self) -> str:
        """The set's folder below the output."""
        return self.found.key


@dataclass
class Outcome:
    """How a task ended.

    Attributes:
        key: of the task.
        error: one sentence, or None where the set was baked.
        texels: of all levels.
        seconds: wall-clock seconds of each phase in the worker.
    """

    key: str
    error: str | None = None
    texels: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
