"""The scene file: cameras, surfaces, lights, target and budget, in TOML. Fields that are left out have defaults.

The smallest scene names one surface:

    [[surfaces]]
    set = "textures/oak"

Lengths are metres, angles degrees. Directions are in the frame of the surface's mean plane: x to the right, y up and z
out of it, as its texture is seen from the front.
"""

from __future__ import annotations

import difflib
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, get_args

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from brdffit.errors import InputError
from brdffit.export.presets import preset_names
from brdffit.models import model_names
from brdffit.planning.effects import NAMES
from brdffit.probes.presets import PRESETS
from brdffit.textures import READING_OPTIONS

#: The environment that ships, by name.
PROCEDURAL = "procedural"

# Bounds exclude infinity, which TOML can write; no real scene comes near them.
Positive = Annotated[float, Meta(gt=0.0, le=1e9)]
NotNegative = Annotated[float, Meta(ge=0.0, le=1e9)]
Finite = Annotated[float, Meta(ge=-1e9, le=1e9)]
Tilt = Annotated[float, Meta(ge=0.0, lt=90.0)]
# Not tuple[Positive, Positive]: msgspec 0.22 crashes on a union of a bounded number and a tuple of fixed length.
Distances = Annotated[tuple[Positive, ...], Meta(min_length=2, max_length=2)]
Tilts = Annotated[tuple[Tilt, ...], Meta(min_length=2, max_length=2)]
Colour = Annotated[tuple[NotNegative, ...], Meta(min_length=3, max_length=3)]
Pixels = Annotated[int, Meta(ge=1)]
Switch = Literal["auto", "on", "off"]
NormalY = Literal["gl", "dx"]
Wrap = Literal["tile", "clamp"]
Bits = Literal[8, 16]
Quality = Literal["draft", "standard", "fine"]
Filter = Literal["box", "gaussian", "mitchell"]


def _range(value: float | tuple[float, ...]) -> tuple[float, float]:
    return (value[0], value[1]) if isinstance(value, tuple) else (value, value)


class _Strict(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table in which unknown fields are errors."""


class Camera(_Strict, frozen=True, kw_only=True):
    """A camera that looks at the surfaces.

    Attributes:
        name: used in plans.
        distance: to the surface in metres, or the nearest and the farthest.
        field_of_view: horizontal, in degrees.
        resolution: (width, height) of the picture in pixels, which are square.
        tilt: degrees between the view and the surface's normal, or the least and the most.
    """

    name: str = ""
    distance: Positive | Distances = (1.0, 10.0)
    field_of_view: Annotated[float, Meta(gt=0.0, lt=180.0)] = 50.0
    resolution: tuple[Pixels, Pixels] = (1920, 1080)
    tilt: Tilt | Tilts = (0.0, 60.0)

    def __post_init__(self) -> None:
        for name, (low, high) in (("distance", self.distances), ("tilt", self.tilts)):
            if low > high:
                raise ValueError(f"`{name}` goes from {low:g} to {high:g}, expected the smaller number first")

    @property
    def distances(self) -> tuple[float, float]:
        """Nearest and farthest, in metres."""
        return _range(self.distance)

    @property
    def tilts(self) -> tuple[float, float]:
        """Least and most, in degrees."""
        return _range(self.tilt)


class Surface(_Strict, frozen=True, kw_only=True):
    """A surface and its texture set.

    Attributes:
        set: folder of textures (or .gltf, .glb, .mtlx file), relative to the scene file; absolute after ``read_scene``.
        name: of its output folder; "": that of the set.
        texel_size: side of a base texel in metres; only one of this and ``repetitions`` may be given.
        repetitions: of the texture's width per metre; 1 if neither is given.
        radius: of a curved surface, in metres; None: flat.
        roles, normal_y, wrap, height_scale, denoise_normals, material: how the set is read, as with the options of
            ``brdffit bake``.
    """

    set: str
    name: str = ""
    texel_size: Positive | None = None
    repetitions: Positive | None = None
    radius: Positive | None = None
    roles: dict[str, str] | None = None
    normal_y: NormalY | None = None
    wrap: Wrap | None = None
    height_scale: Positive | None = None
    denoise_normals: bool = False
    material: str | None = None

    def __post_init__(self) -> None:
        if self.texel_size is not None and self.repetitions is not None:
            raise ValueError("`texel_size` and `repetitions` are both given, expected one of them: each follows")
        if not self.set:
            raise ValueError("`set` is empty, expected the folder of a texture set")
        if self.name in (".", "..") or "/" in self.name or "\\" in self.name:
            raise ValueError(f"`name` is '{self.name}', expected one that a folder can have")

    def texel(self, base_size: tuple[int, int]) -> float:
        """Side of a base texel in metres; ``base_size`` is (height, width) in texels."""
        return self.texel_size if self.texel_size is not None else 1.0 / ((self.repetitions or 1.0) * base_size[1])

    def reading(self) -> dict[str, Any]:
        """Arguments of ``brdffit.textures.texture_set.read_texture_set``."""
        return {name: getattr(self, name) for name in READING_OPTIONS}


class Light(_Strict, frozen=True, kw_only=True):
    """A distant light.

    Attributes:
        direction: towards the light; any length but zero.
        irradiance: linear, of a surface that faces the light: RGB, or one number for all three.
        size: diameter in degrees; 0: infinitely small.
    """

    direction: tuple[Finite, Finite, Finite]
    irradiance: NotNegative | Colour = 1.0
    size: Annotated[float, Meta(ge=0.0, le=180.0)] = 0.0

    def __post_init__(self) -> None:
        if not any(self.direction):
            raise ValueError("`direction` is zero, expected a vector towards the light")

    @property
    def rgb(self) -> tuple[float, float, float]:
        """Irradiance of the three channels."""
        r, g, b = self.irradiance if isinstance(self.irradiance, tuple) else (self.irradiance,) * 3
        return r, g, b


class Target(_Strict, frozen=True, kw_only=True):
    """The target of the bake: an output preset, and bits of its pictures."""

    preset: str = "plain"
    bits: Bits = 8


class Budget(_Strict, frozen=True, kw_only=True):
    """dB of SNR that all effects switched off may cost together, and seconds that a bake may take (None: no limit)."""

    db: Positive = 0.1
    seconds: Positive | None = None


class SceneFile(_Strict, frozen=True, kw_only=True):
    """A whole scene file.

    Attributes:
        cameras, surfaces, lights: at least one surface. Without a light and an ``environment``, the environment that
            ships is used.
        environment: equirectangular .hdr or .exr picture, relative to the scene file (y is up in it and its middle
            column lies behind the surface, at -z); "procedural": the one that ships; None: none.
        probe: engine whose reflection probe lights the environment views a second time in ``compare --scene``
            (``brdffit probe --for``), with its levels looked up by that engine's curve of roughness; None: none.
        target, budget: of the bake.
        effects: by name (``effects.NAMES``): "on", "off", or "auto", which leaves the verdict to the plan.
        model, quality, pixel_filter: as the options of ``brdffit bake``.
    """

    surfaces: Annotated[tuple[Surface, ...], Meta(min_length=1)]
    cameras: Annotated[tuple[Camera, ...], Meta(min_length=1)] = (Camera(),)
    lights: tuple[Light, ...] = ()
    environment: str | None = None
    probe: str | None = None
    target: Target = Target()
    budget: Budget = Budget()
    effects: dict[str, Switch] = {}
    model: str = "ggx"
    quality: Quality = "standard"
    pixel_filter: Filter = "box"

    def switch(self, effect: str) -> Switch:
        """The setting of an effect in the scene file."""
        return self.effects.get(effect, "auto")


def read_scene(path: str | Path) -> SceneFile:
    """Read a scene file and fill in the defaults that depend on other fields.

    Paths become absolute, surfaces and cameras get names, and a scene without any light gets the environment that
    ships.

    Raises:
        InputError: when the file cannot be read, has an unknown field or an impossible value, or names a set or an
            environment that does not exist; the sentence holds the file and the path of the field.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"The scene '{path}' cannot be read: {getattr(error, 'strerror', None) or error}.") from error
    scene = parse_scene(text, path)
    surfaces = tuple(
        replace(each, set=str(_existing(each.set, path, f"surfaces[{i}].set")), name=each.name or _stem(each.set, path))
        for i, each in enumerate(scene.surfaces)
    )
    for i, surface in enumerate(surfaces):
        first = [each.name for each in surfaces].index(surface.name)
        if first < i:
            what = f"'{surface.name}' is the name of surfaces[{first}] too, expected one of its own"
            _refuse(path, f"surfaces[{i}].name", what)
    cameras = tuple(replace(each, name=each.name or f"camera {i + 1}") for i, each in enumerate(scene.cameras))
    environment = scene.environment or (None if scene.lights else PROCEDURAL)
    if environment not in (None, PROCEDURAL):
        environment = str(_existing(environment, path, "environment"))
    return replace(scene, surfaces=surfaces, cameras=cameras, environment=environment)


def parse_scene(text: str, path: str | Path) -> SceneFile:
    """Parse the text of a scene file without filling in defaults or checking paths; errors name ``path``.

    Raises:
        InputError: as ``read_scene``.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"The scene '{path}' is not TOML: {_small(str(error))}.") from error
    try:
        scene = msgspec.convert(data, SceneFile)
    except msgspec.ValidationError as error:
        what, _, where = str(error).partition(" - at ")
        _refuse(path, *_in_plain_words(what, where.strip("`").removeprefix("$").removeprefix("."), data), error)
    for where, kind, name, known in (
        ("target.preset", "preset", scene.target.preset, preset_names()),
        ("model", "model", scene.model, model_names()),
        *([("probe", "engine", scene.probe, list(PRESETS))] if scene.probe is not None else []),
        *(("effects", "effect", name, NAMES) for name in scene.effects),
    ):
        if name not in known:
            _refuse(path, where, f"there is no {kind} '{name}'{_nearest(name, known)}, known are {', '.join(known)}")
    return scene


def _existing(name: str, scene: Path, where: str) -> Path:
    """The absolute path of a file that a scene names.

    Raises:
        InputError: when it does not exist.
    """
    path = (scene.parent / name).resolve()
    if not path.exists():
        _refuse(scene, where, f"there is nothing at '{path}', expected a path relative to the scene file")
    return path


def _stem(name: str, scene: Path) -> str:
    path = (scene.parent / name).resolve()
    return path.name if path.is_dir() else path.stem


def _refuse(path: str | Path, where: str, what: str, cause: Exception | None = None) -> NoReturn:
    place = f", at {where}" if where else ""
    raise InputError(f"The scene '{path}' is not as expected{place}: {what}.") from cause


def _small(text: str) -> str:
    return text[:1].lower() + text[1:]


#: Values of the fields that take one of a few words, by the name of the field.
_CHOICES = {
    "effects": get_args(Switch), "normal_y": get_args(NormalY), "wrap": get_args(Wrap), "bits": get_args(Bits),
    "quality": get_args(Quality), "pixel_filter": get_args(Filter),
}  # fmt: skip
_STRUCTS = (SceneFile, Camera, Surface, Light, Target, Budget)
_WORDS = {
    "`float | array`": "a number or a list", "`float`": "a number", "`int`": "a whole number", "`str`": "a text",
    "`array`": "a list", "`object`": "a table",
}  # fmt: skip


def _in_plain_words(what: str, where: str, data: dict[str, Any]) -> tuple[str, str]:
    """The field and its error in plain words, with what was found and what was expected, from msgspec's message."""
    if where.startswith("effects["):  # msgspec does not name the key
        wrong = [name for name, value in data["effects"].items() if value not in _CHOICES["effects"]]
        where = f"effects.{wrong[0]}"
    field = where.split(".")[0] if where.startswith("effects") else where.rpartition(".")[2]
    if what.startswith("Invalid enum value") and field in _CHOICES:
        return where, f"found {what.rpartition('value ')[2]}, expected one of {', '.join(map(str, _CHOICES[field]))}"
    unknown = re.fullmatch(r"Object contains unknown field `(.*)`", what)
    if unknown:
        known = [name for each in _STRUCTS for name in each.__struct_fields__]
        return where, f"there is no field '{unknown[1]}'{_nearest(unknown[1], known)}"
    missing = re.fullmatch(r"Object missing required field `(.*)`", what)
    if missing:
        return where, f"`{missing[1]}` is missing"
    for word, plain in _WORDS.items():
        what = what.replace(word, plain)
    found = _found(data, where)
    return where, _small(what.partition(", got ")[0] if found else what) + found


def _nearest(name: str, known: Any) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
    return f" (did you mean '{near[0]}'?)" if near else ""


def _found(data: Any, where: str) -> str:
    """The value that was found at a field, if it is short."""
    for key, index in re.findall(r"(\w+)|\[(\d+)\]", where):
        try:
            data = data[int(index) if index else key]
        except (KeyError, IndexError, TypeError):
            return ""
    return f", found {data!r}" if where and isinstance(data, str | float | int | list) and len(repr(data)) < 60 else ""
