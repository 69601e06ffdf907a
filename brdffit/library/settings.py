"""``library.toml``: how the sets of a library are baked, by patterns.

    exclude = ["old/*"]

    [options]
    quality = "draft"

    [[sets]]
    match = "metal/*"
    preset = "unreal"
    quality = "fine"

Patterns are those of ``fnmatch`` on a set's place below the root (``*`` crosses slashes). Of several entries that
match, later ones win; the command line wins over all.
"""

from __future__ import annotations

import tomllib
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct

from brdffit.errors import InputError
from brdffit.library.task import Found
from brdffit.methods import DEFAULT, get_method
from brdffit.pipeline import bake_options
from brdffit.textures import READING_OPTIONS

FILE_NAME = "library.toml"

Positive = Annotated[float, Meta(gt=0.0)]


class Overrides(Struct, forbid_unknown_fields=True, frozen=True, omit_defaults=True):
    """What may be said of a set; None says nothing. As the options of ``brdffit bake``."""

    method: str | None = None
    preset: str | None = None
    bits: Literal[8, 16] | None = None
    model: str | None = None
    pixel_filter: Literal["box", "gaussian", "mitchell"] | None = None
    levels: Annotated[int, Meta(ge=1)] | None = None
    keep_level_0: bool | None = None
    quality: Literal["draft", "standard", "fine"] | None = None
    tolerance: Positive | None = None
    loss: Literal["l2", "relative", "l1"] | None = None
    refine: bool | None = None
    specular: Literal["auto", "free", "held"] | None = None
    lobe: Literal["auto", "anisotropic", "isotropic"] | None = None
    normal: Literal["free", "mean"] | None = None
    density: Literal["cosine", "uniform"] | None = None
    min_roughness: Annotated[float, Meta(gt=0.0, le=1.0)] | None = None
    wrap: Literal["tile", "clamp"] | None = None
    normal_y: Literal["gl", "dx"] | None = None
    height_scale: Positive | None = None
    denoise_normals: bool | None = None
    material: str | None = None
    roles: dict[str, str] | None = None

    def given(self) -> dict[str, Any]:
        """What is said, by name."""
        return {name: getattr(self, name) for name in self.__struct_fields__ if getattr(self, name) is not None}


class ForSets(Overrides, forbid_unknown_fields=True, frozen=True, omit_defaults=True, kw_only=True):
    """Overrides for the sets that match; ``skip`` leaves them out."""

    match: str
    skip: bool = False

    def given(self) -> dict[str, Any]:
        """What is said, by name."""
        return {name: value for name, value in super().given().items() if name not in ("match", "skip")}


class Settings(Struct, forbid_unknown_fields=True, frozen=True):
    """A whole ``library.toml``."""

    exclude: tuple[str, ...] = ()
    options: Overrides = Overrides()
    sets: tuple[ForSets, ...] = ()

    def is_left_out(self, key: str) -> bool:
        """Whether a set or a folder is not to be baked."""
        skipped = [entry.skip for entry in self.sets if fnmatchcase(key, entry.match)]
        return any(fnmatchcase(key, pattern) for pattern in self.exclude) or (bool(skipped) and skipped[-1])

    def of(self, found: Found, command_line: dict[str, Any]) -> dict[str, Any]:
        """All that is said of a set."""
        said: dict[str, Any] = {}
        if found.udim is not None:
            said["wrap"] = "clamp"  # a tile goes on in its neighbour, not in itself
        said |= self.options.given()
        for entry in self.sets:
            if fnmatchcase(found.key, entry.match):
                said |= entry.given()
        return said | command_line


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
        settings = msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), Settings)
    except OSError as error:
        raise InputError(f"The settings '{path}' cannot be read: {error.strerror}.") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, msgspec.ValidationError) as error:
        raise InputError(f"The settings '{path}' are not as expected: {error}.") from error
    for said in (settings.options, *settings.sets):
        split_options(said.given())  # unknown names are told now, not after an hour
    return settings


def split_options(said: dict[str, Any]) -> dict[str, Any]:
    """The fields of a ``Task`` from all that is said of a set.

    Raises:
        UnknownNameError: for an unknown method, model or preset.
    """
    said = {name: value for name, value in said.items() if value not in (None, "auto")}
    reading = {name: said.pop(name, None) for name in READING_OPTIONS}
    reading["denoise_normals"] = bool(reading["denoise_normals"])
    method, preset, bits = said.pop("method", DEFAULT), said.pop("preset", "plain"), int(said.pop("bits", 8))
    bake_options(get_method(method), preset, said)
    return {"reading": reading, "method": method, "preset": preset, "bits": bits, "options": said}
