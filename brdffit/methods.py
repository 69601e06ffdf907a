"""The interface of methods, what they are given and return, and how they are found.

A method turns a material into what is drawn at a distance. Each method, ours and the baselines too, is one class that
follows ``Method``, named by an entry point of the group ``brdffit.methods`` (or given as ``module:object``). A method
whose result is a pyramid of lobes derives from ``LobeMethod`` and writes one function.
"""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError, OutputError, UnknownNameError
from brdffit.options import BakeOptions, LobeOptions
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf, level_sizes

#: The default method, with which reports compare the others.
DEFAULT = "bfgs"

#: progress(level, texels_done, texels_of_level): called from time to time while a level is baked.
Progress = Callable[[int, int, int], None]


@dataclass
class Material:
    """The input of a method: everything that a texture set holds.

    Attributes:
        svbrdf: one lobe a texel, with height, occlusion and opacity where the set has them.
    """

    svbrdf: Svbrdf

    @property
    def opacity(self) -> NDArray | None:
        """(H, W) weight of each texel in [0, 1], or None where all is opaque."""
        return self.svbrdf.opacity

    @property
    def height(self) -> NDArray | None:
        """(H, W) height in texels, positive up, or None."""
        return self.svbrdf.height

    @property
    def occlusion(self) -> NDArray | None:
        """(H, W) ambient occlusion in [0, 1], or None."""
        return self.svbrdf.occlusion

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in texels."""
        return self.svbrdf.size


@dataclass
class Level:
    """One MIP level of lobes and what the method says of it.

    Attributes:
        svbrdf: the level's own parameters.
        status: (H, W) uint8, index into ``brdffit.fitting.status.STATUSES``; None where nothing is searched.
        residual: (H, W) float32 relative squared error as the method itself measures it (where effects are switched
            off, against the target without them); None where nothing is searched.
        evaluations: (H, W) uint16 evaluations of the objective; None where nothing is searched.
        seconds: wall-clock seconds spent on this level.
    """

    svbrdf: Svbrdf
    status: NDArray | None = None
    residual: NDArray | None = None
    evaluations: NDArray | None = None
    seconds: float = 0.0


@dataclass
class Pyramid:
    """MIP levels of lobes from level 0 down, by one method."""

    method: str
    options: LobeOptions
    levels: list[Level]
    notes: list[str] = field(default_factory=list)

    @property
    def model(self) -> str:
        """Name of the lobe model of every level."""
        return self.levels[0].svbrdf.model

    def __len__(self) -> int:
        return len(self.levels)

    def __getitem__(self, mip_level: int) -> Level:
        return self.levels[mip_level]


class Image(NamedTuple):
    """A picture with all its MIP levels, written to one file.

    Attributes:
        name: of the file, without its ending.
        channels: their names.
        sizes: (height, width) of each level.
        rows: rows(level, slice) gives rows as (h, w, C) float32; they are made when written, so that little is held.
        unit: whether texels are unit vectors, and must be again after averaging.
    """

    name: str
    channels: tuple[str, ...]
    sizes: list[tuple[int, int]]
    rows: Callable[[int, slice], NDArray]
    unit: bool = False


@dataclass
class Baked:
    """The result of a method.

    Attributes:
        method: its name.
        options: those of the bake.
        appearance: what the renderer asks, see ``brdffit.appearance``.
        lobes: MIP levels of lobes, or None where the result is not made of lobes; half-angle figures, roughness maps
            and engine pictures need them.
        notes: sentences for the user.
        stored: pictures that hold a result without lobes.
        worn: the glTF file that the material comes from and the material's number in it; a GLB shows its geometry.
    """

    method: str
    options: BakeOptions
    appearance: Any
    lobes: Pyramid | None = None
    notes: list[str] = field(default_factory=list)
    stored: Sequence[Image] = ()
    worn: tuple[Path, int] | None = None

    @classmethod
    def of_lobes(cls, pyramid: Pyramid) -> Baked:
        """The result of a method that bakes lobes."""
        from brdffit.appearance import LobePyramid

        appearance = LobePyramid([level.svbrdf for level in pyramid.levels])
        return cls(pyramid.method, pyramid.options, appearance, pyramid, pyramid.notes)

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """(height, width) of each level."""
        if self.lobes is not None:
            return [level.svbrdf.size for level in self.lobes.levels]
        return level_sizes(self.appearance.base_size, self.options.levels)

    @property
    def levels(self) -> Sequence[Level | None]:
        """The levels of lobes; None for each level of a result without lobes."""
        return [None] * len(self.sizes) if self.lobes is None else self.lobes.levels

    @property
    def wrap(self) -> str:
        """What lies beyond the border: "tile" or "clamp"."""
        return getattr(self.appearance, "wrap", "tile") if self.lobes is None else self.lobes[0].svbrdf.wrap

    def check_finite(self, name: str) -> None:
        """Refuse lobes that are no finite numbers, which would spread over a whole picture.

        Raises:
            OutputError: with the name of the set, the level and how many of its texels.
        """
        for mip_level, level in enumerate(self.lobes.levels if self.lobes is not None else ()):
            if not level.svbrdf.is_finite():
                flat = [array.reshape(*level.svbrdf.size, -1) for array in level.svbrdf.arrays().values()]
                wrong = np.count_nonzero(~np.isfinite(np.concatenate(flat, axis=2)).all(axis=2))
                raise OutputError(
                    f"{name}: method '{self.method}' made {wrong} texels of level {mip_level} that are not finite "
                    "numbers; nothing was written. This is a fault of the method."
                )

    def images(self) -> list[Image]:
        """The pictures that hold the result exactly: what is exported."""
        return list(self.stored) if self.lobes is None else lobe_images(self.lobes)


def lobe_images(pyramid: Pyramid) -> list[Image]:
    """Images of normal, roughness tensor in alpha^2, specular and diffuse colour, and of shape and opacity if any."""
    levels = [level.svbrdf for level in pyramid.levels]

    sizes = [level.size for level in levels]
    images = [
        Image("normal", ("X", "Y", "Z"), sizes, lambda k, rows: levels[k].normal[rows], unit=True),
        Image("roughness", ("XX", "YY", "XY"), sizes, lambda k, rows: tensor_from_log(levels[k].log_roughness[rows])),
        Image("specular", ("R", "G", "B"), sizes, lambda k, rows: levels[k].specular[rows]),
        Image("diffuse", ("R", "G", "B"), sizes, lambda k, rows: levels[k].diffuse[rows]),
    ]
    shapes = [level.shape for level in levels]
    if shapes[0] is not None:
        images.append(Image("shape", ("Y",), sizes, lambda k, rows: shapes[k][rows, :, None]))  # type: ignore[index]
    opacities = [level.opacity for level in levels]
    if opacities[0] is not None:
        images.append(Image("opacity", ("A",), sizes, lambda k, rows: opacities[k][rows, :, None]))  # type: ignore[index]
    return images


@runtime_checkable
class Method(Protocol):
    """A way to bake a material. ``options`` is the dataclass of its options: what is not a field of it is refused."""

    name: str
    summary: str
    options: ClassVar[type[BakeOptions]]

    def prepare(self, material: Material, options: Any) -> None:
        """Compile, load or train what the bake needs; the seconds of the bake do not count this."""
        ...

    def bake(self, material: Material, options: Any, progress: Progress | None = None) -> Baked:
        """Bake a material.

        Raises:
            brdffit.errors.InputError: when the method needs something that the material lacks.
        """
        ...


class LobeMethod:
    """A method whose result is a pyramid of lobes; a subclass says how its levels are made."""

    name: ClassVar[str]
    summary: ClassVar[str]
    options: ClassVar[type[BakeOptions]] = LobeOptions

    def prepare(self, material: Material, options: Any) -> None:
        """Do nothing; a subclass may compile or load here."""

    def trained(self, options: Any) -> str:
        """A sentence on the training behind its bakes, shown beside their time; empty where there was none."""
        return ""

    def bake(self, material: Material, options: Any, progress: Progress | None = None) -> Baked:
        """Bake a material, see ``Method``."""
        weighted = material.svbrdf.weighted()
        pyramid = self.bake_lobes(weighted, options, progress)
        for level in pyramid.levels:
            level.svbrdf = _with_opacity(level.svbrdf, weighted, options).unweighted()
        return Baked.of_lobes(pyramid)

    def bake_lobes(self, svbrdf: Svbrdf, options: Any, progress: Progress | None = None) -> Pyramid:
        """Bake the levels; where ``svbrdf`` has opacity it is ``weighted``, as the levels' colours must be."""
        raise NotImplementedError


def _with_opacity(level: Svbrdf, base: Svbrdf, options: Any) -> Svbrdf:
    """``level`` with the filtered weights of ``base`` (both ``weighted``), where the method did not carry them."""
    if base.opacity is None or level.opacity is not None:
        return level
    from brdffit.footprint import filter_channels, get_pixel_filter

    opacity = base.opacity
    if level.size != base.size or not options.keep_level_0:
        pixel_filter = get_pixel_filter(options.pixel_filter)
        opacity = filter_channels(opacity[..., None], level.size, pixel_filter, base.wrap)[..., 0]
    return level.replace(opacity=opacity, alpha=base.alpha, cutoff=base.cutoff)


#: Methods that run only when they are named, since they train for minutes.
BY_NAME = {"neural": "brdffit.neural.method:Neural"}


@cache
def _installed() -> dict[str, EntryPoint]:
    """Entry points by name; reading them takes tens of milliseconds."""
    return {point.name: point for point in entry_points(group="brdffit.methods")}


def method_names() -> list[str]:
    """Names of the installed methods, ours first."""
    return sorted(sorted(_installed()), key=lambda name: name != DEFAULT)


def lobe_method_names() -> list[str]:
    """Names of those installed methods whose result is a pyramid of lobes, ours first."""
    return [name for name in method_names() if isinstance(get_method(name), LobeMethod)]


def get_method(name: str) -> Method:
    """The method of this name, or of ``module:object``.

    Raises:
        InputError: when the module cannot be imported, or the object is no class of a method.
        UnknownNameError: with the nearest known name.
    """
    name = BY_NAME.get(name, name)
    if ":" in name:
        module, _, attribute = name.partition(":")
        try:
            found = getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            raise InputError(f"The method '{name}' cannot be loaded: {str(error).rstrip('.')}.") from error
        made = found() if isinstance(found, type) else found
        if not isinstance(made, Method):
            raise InputError(f"'{name}' is no method, expected a class that follows brdffit.methods.Method.")
        return made
    if name in _installed():
        return _installed()[name].load()()
    raise UnknownNameError("method", name, [*method_names(), *BY_NAME])


def one_of(kind: str, name: str, known: Sequence[str]) -> str:
    """``name``, if it is among the known ones.

    Raises:
        UnknownNameError: with the nearest known name.
    """
    if name not in known:
        raise UnknownNameError(kind, name, known)
    return name


def with_options(options: BakeOptions, changes: Mapping[str, Any]) -> Any:
    """A copy of ``options`` with some changed; changes that its type has no field for are left out."""
    names = {each.name for each in dataclasses.fields(options)}
    return dataclasses.replace(options, **{name: value for name, value in changes.items() if name in names})
