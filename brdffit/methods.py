"""What a method is, what it returns, and how methods are found.

A method turns a base SVBRDF into a pyramid. Ours, the baselines and whatever comes later are all alike: one class
with ``name``, ``summary`` and ``bake``, named by an entry point of the group ``brdffit.methods`` (or given as
``module:object``).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, runtime_checkable

from numpy.typing import NDArray

from brdffit.errors import UnknownNameError
from brdffit.roughness import DEFAULT_MIN_ROUGHNESS
from brdffit.svbrdf import Svbrdf

#: progress(level, texels_done, texels_of_level): called from time to time while a level is baked.
Progress = Callable[[int, int, int], None]

QUALITIES = ("draft", "standard", "fine")
#: Options that a plan decides (``brdffit plan``); Python may set them too, but no flag and no settings file does.
BY_PLAN = ("reach", "colour", "correlation", "coupling", "horizon")
LOSSES = ("l2", "relative", "l1")
COLOURS = ("channels", "shared")


@dataclass(frozen=True)
class BakeOptions:
    """What a user may ask of any method; a method ignores what it has no use for.

    Attributes:
        model: lobe model of the pyramid.
        pixel_filter: "box", "gaussian" or "mitchell", of each level's scale.
        levels: how many levels, level 0 counted; None goes down to 1x1.
        keep_level_0: leave level 0 as authored instead of filtering it for the pixel filter.
        tolerance: dB that a level's SNR may stay below the best lobe's; each texel is given no more work than that asks
            for. None: the preset ``quality`` alone.
        loss: "l2", "relative" (each half angle counts relative to what the target holds there) or "l1" (smoothed:
            tails count more than in l2).
        refine: move the texels of each level together, after their fit, so that what a renderer interpolates between
            texels and levels matches in l2; texel centres may lose by it (``residual`` is that of the fit, before).
        quality: "draft", "standard" or "fine" (sampling, quadrature and end of the nonlinear fit).
        specular: "free" (best scale in closed form) or "held" (filtered colour, for metallic-roughness outputs).
        lobe: "anisotropic" or "isotropic".
        normal: "free" or "mean" (held at the mean normal).
        density: "cosine" or "uniform": how l and v are distributed in the error integral.
        min_roughness: perceptual roughness floor, in (0, 1].
        reach: first and last level that any pixel reads; only they are fitted, the others are averaged channel by
            channel. Beyond the coarsest level, the coarsest is meant. None: all.
        colour: "channels" (what is best for red, green and blue together) or "shared" (the luminance is fitted; its
            scale times the filtered colour's hue).
        correlation: whether colours weigh the lobes of a footprint. Without, all lobes count alike, and the fitted
            scale multiplies the filtered colour; ``colour`` then says nothing.
        coupling: whether diffuse colour and normal are averaged together (bright sides of bumps stay bright). Without,
            diffuse colour is averaged alone.
        horizon: whether lobes end at their own horizon, n.h = 0, in the search.
        threads: worker threads; None takes all cores. The result does not depend on it.
    """

    model: str = "ggx"
    pixel_filter: str = "box"
    levels: int | None = None
    keep_level_0: bool = False
    quality: str = "standard"
    tolerance: float | None = None
    loss: str = "l2"
    refine: bool = False
    specular: str = "free"
    lobe: str = "anisotropic"
    normal: str = "free"
    density: str = "cosine"
    min_roughness: float = DEFAULT_MIN_ROUGHNESS
    reach: tuple[int, int] | None = None
    colour: str = "channels"
    correlation: bool = True
    coupling: bool = True
    horizon: bool = True
    threads: int | None = None


@dataclass
class Level:
    """One MIP level and what the method says of it.

    Attributes:
        svbrdf: the level's own parameters.
        status: (H, W) uint8, index into ``brdffit.fitting.status.STATUSES``; None for closed forms.
        residual: (H, W) float32 relative squared error as the method itself saw it (with effects off, of what it then
            saw); None for closed forms.
        evaluations: (H, W) uint16 objective evaluations; None for closed forms.
        seconds: wall-clock seconds spent on this level.
    """

    svbrdf: Svbrdf
    status: NDArray | None = None
    residual: NDArray | None = None
    evaluations: NDArray | None = None
    seconds: float = 0.0


@dataclass
class Pyramid:
    """MIP levels from level 0 down, by one method."""

    method: str
    options: BakeOptions
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


@runtime_checkable
class Method(Protocol):
    """A way to bake a pyramid."""

    name: str
    summary: str

    def bake(self, svbrdf: Svbrdf, options: BakeOptions, progress: Progress | None = None) -> Pyramid:
        """Bake ``svbrdf`` into a pyramid.

        Raises:
            brdffit.errors.InputError: when the method needs something that the SVBRDF lacks.
        """
        ...


@cache
def _installed() -> dict[str, EntryPoint]:
    """Entry points by name; reading them takes tens of milliseconds."""
    return {point.name: point for point in entry_points(group="brdffit.methods")}


def method_names() -> list[str]:
    """Names of the installed methods, ours first."""
    return sorted(sorted(_installed()), key=lambda name: name != "bfgs")


def get_method(name: str) -> Method:
    """The method of this name, or of ``module:object``.

    Raises:
        UnknownNameError: with the nearest known name.
    """
    if ":" in name:
        module, _, attribute = name.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)()
        except (ImportError, AttributeError) as error:
            raise UnknownNameError("method", name, method_names()) from error
    if name in _installed():
        return _installed()[name].load()()
    raise UnknownNameError("method", name, method_names())


def one_of(kind: str, name: str, known: Sequence[str]) -> str:
    """``name`` if it is known, else an UnknownNameError with the nearest name."""
    if name not in known:
        raise UnknownNameError(kind, name, known)
    return name
