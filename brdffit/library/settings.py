"""``library.toml``: how the sets of a library are baked, by patterns.

    exclude = ["old/*"]

    [options]
    quality = "draft"
    fit.loss = "l1"

    [[sets]]
    match = "metal/*"
    preset = "unreal"
    quality = "fine"

Patterns are those of ``fnmatch`` on a set's place below the root (``*`` crosses slashes). Of several entries that
match, later ones win; the command line wins over all. Beside method, preset, bits, compress and how a set is read, all
options of methods may stand there (``brdffit methods NAME``); each applies to the sets whose method has it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from brdffit.errors import InputError, UnknownNameError
from brdffit.library.task import Found
from brdffit.methods import DEFAULT, Method, get_method, method_names
from brdffit.options import flat, known_options, make_options, merged, refuse_unknown
from brdffit.pipeline import bake_options
from brdffit.textures import READING_OPTIONS

FILE_NAME = "library.toml"


class Common(Struct, forbid_unknown_fields=True, frozen=True):
    """Settings of a set that are no options of its method; None where it is not given."""

    method: str | None = None
    preset: str | None = None
    bits: Literal[8, 16] | None = None
    compress: Literal["fast", "good", "best"] | None = None
    wrap: Literal["tile", "clamp"] | None = None
    normal_y: Literal["gl", "dx"] | None = None
    height_scale: Annotated[float, Meta(gt=0.0)] | None = None
    denoise_normals: bool | None = None
    material: str | None = None
    roles: dict[str, str] | None = None


class _File(Struct, forbid_unknown_fields=True, frozen=True):
    """A whole file, its options as they stand there."""

    exclude: tuple[str, ...] = ()
    options: dict[str, Any] = {}
    sets: tuple[dict[str, Any], ...] = ()


class _Entry(Struct, frozen=True):
    """The fields of an entry for some sets beside their options."""

    match: str
    skip: bool = False


@dataclass(frozen=True)
class ForSets:
    """Options for the sets whose place matches; ``skip`` leaves them out."""

    match: str
    skip: bool = False
    said: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Settings:
    """A whole ``library.toml``."""

    exclude: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    sets: tuple[ForSets, ...] = ()

    def is_left_out(self, key: str) -> bool:
        """Whether a set or a folder is not to be baked."""
        skipped = [entry.skip for entry in self.sets if fnmatchcase(key, entry.match)]
        return any(fnmatchcase(key, pattern) for pattern in self.exclude) or (bool(skipped) and skipped[-1])

    def of(self, found: Found, command_line: Mapping[str, Any]) -> dict[str, Any]:
        """All settings and options of a set, merged."""
        usual = {"wrap": "clamp"} if found.udim is not None else {}  # a tile goes on in its neighbour, not in itself
        matching = [entry.said for entry in self.sets if fnmatchcase(found.key, entry.match)]
        return merged(usual, self.options, *matching, command_line)


def read_settings(path: Path | None, root: Path) -> Settings:
    """Settings from ``path``, or from ROOT/library.toml if there is one.

    Raises:
        InputError: when the file cannot be read or says something unknown; the sentence holds the path of the field.
    """
    if path is None:
        path = root / FILE_NAME
        if not path.is_file():
            return Settings()
    try:
        file = msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), _File)
        entries = [(msgspec.convert(each, _Entry), each) for each in file.sets]
        sets = tuple(
            ForSets(entry.match, entry.skip, _said(each, f"$.sets[{i}]")) for i, (entry, each) in enumerate(entries)
        )
        return Settings(file.exclude, _said(file.options, "$.options"), sets)
    except OSError as error:
        raise InputError(f"The settings '{path}' cannot be read: {error.strerror}.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, msgspec.ValidationError) as error:
        raise InputError(f"The settings '{path}' are not as expected: {str(error).rstrip('.')}.") from error


def _said(table: Mapping[str, Any], place: str) -> dict[str, Any]:
    """The settings and options of a table, by full name.

    Raises:
        msgspec.ValidationError: for what no method has, or a value that cannot be; the sentence holds the place.
        UnknownNameError: for a method or a preset that does not exist.
    """
    plain = {name: value for name, value in table.items() if name in Common.__struct_fields__}
    options = {k: v for k, v in table.items() if k not in plain and k not in _Entry.__struct_fields__}
    found = dict(flat(options))
    try:
        msgspec.convert(plain, Common)
    except msgspec.ValidationError as error:
        raise msgspec.ValidationError(f"{error} (in {place})") from error
    kinds = {name: method.options for name, method in _methods(plain.get("method", DEFAULT)).items()}
    bake_options(get_method(DEFAULT), plain.get("preset"), {})
    try:
        refuse_unknown(kinds, found)
        for name, kind in kinds.items():
            make_options(kind, known_options(kind, found), f"'{name}'")
    except UnknownNameError as error:
        raise msgspec.ValidationError(f"{error} (in {place})") from error
    return plain | found


@cache
def _methods(own: str) -> dict[str, Method]:
    """All installed methods, and one that a file names."""
    return {name: get_method(name) for name in (own, *method_names())}


def split_options(said: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a ``Task`` from all settings of a set; options that its method does not have are left out.

    Raises:
        UnknownNameError: for an unknown method, model or preset.
    """
    said = {name: value for name, value in said.items() if value not in (None, "auto")}
    reading = {name: said.pop(name, None) for name in READING_OPTIONS}
    reading["denoise_normals"] = bool(reading["denoise_normals"])
    method, preset, bits = said.pop("method", DEFAULT), said.pop("preset", "plain"), int(said.pop("bits", 8))
    compress = said.pop("compress", "good")
    options = known_options(get_method(method).options, said)
    bake_options(get_method(method), preset, options)
    return {
        "reading": reading, "method": method, "preset": preset, "bits": bits, "compress": compress, "options": options
    }  # fmt: skip
