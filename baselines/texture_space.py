"""Texture-space lighting, the high-quality variant of Baker's filter: light texels and filter their reflected light.

Lobes cannot be averaged, but light can: texels are lit at a finer level than the camera's by the current light and for
the current viewer, and the light that they reflect is filtered down to the pixel. Here a pixel of level d lights the
fitted lobes of level max(0, d - finer) at 2^finer points along each side of its footprint. At some level lit and
filtered texels vary less than a threshold over the texture (standard deviation over mean, averaged over some lights and
viewers). From there on lighting them one by one gains nothing and the fitted maps are used; between that level and the
one before, both are mixed. The level and the seconds that one light costs a frame are noted.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import LobePyramid, Lobes, Lookups
from brdffit.footprint import get_pixel_filter, iter_pyramid
from brdffit.methods import DEFAULT, Baked, Material, Progress, get_method, with_options
from brdffit.options import BakeOptions, LobeOptions, option
from brdffit.svbrdf import level_sizes

#: Pairs of light and viewer by which the level is found, and the most texels along a side that are lit for it.
_PAIRS, _MOST_TEXELS = 6, 512


@dataclass(frozen=True)
class TextureSpaceOptions(LobeOptions):
    """Options of texture-space lighting, and of the fit whose maps it uses."""

    group: ClassVar[str] = "texture-space"

    quality: str = option("standard", "quality of the fitted maps", names=("draft", "standard", "fine"))
    finer: int = option(2, "texels are lit so many levels finer than a pixel, 4^finer of them", least=0, most=5)
    threshold: float = option(0.1, "deviation of lit texels over their mean, below which fitted maps are used", above=0)


class LitTexels(NamedTuple):
    """The lobes of n pixels: fitted ones, and for some pixels those of the texels that are lit.

    Attributes:
        fitted: of all pixels.
        rows: (m,) indices of pixels lit in texture space. part: (m,) share of that light; the rest is fitted.
        lobes: of (m * points) texels, those of a pixel together.
    """

    fitted: Lobes
    rows: NDArray
    part: NDArray
    lobes: Lobes


@dataclass(frozen=True)
class TextureSpace:
    """A pyramid that is lit at a finer level than the pixel's, an ``Appearance``.

    Attributes:
        pyramid: the fitted maps.
        stop: level from which on only they are used.
        finer: levels by which lit texels are finer than a pixel.
    """

    pyramid: LobePyramid
    stop: float
    finer: int

    @property
    def base_size(self) -> tuple[int, int]:
        """(height, width) of level 0."""
        return self.pyramid.base_size

    @property
    def levels(self) -> Any:
        """The fitted levels."""
        return self.pyramid.levels

    def look_up(self, lookups: Lookups) -> LitTexels:
        """Fitted lobes of each pixel and, for pixels that are near enough, the lobes to light."""
        part = np.clip(self.stop - lookups.detail, 0.0, 1.0)
        rows = np.flatnonzero(part > 0.0)
        side = 1 << self.finer
        at = (np.arange(side) + 0.5) / side - 0.5
        offset = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
        near = lookups.part(rows)
        position = near.position[:, None] + np.einsum("nij,pj->npi", near.axes, offset)
        count = len(offset)
        fine = Lookups(
            position.reshape(-1, 2), np.repeat(near.axes / side, count, axis=0),
            np.repeat(near.detail - self.finer, count), np.repeat(near.view, count, axis=0),
        )  # fmt: skip
        return LitTexels(self.pyramid.look_up(lookups), rows, part[rows], self.pyramid.look_up(fine))

    def evaluate(self, texels: LitTexels, view: NDArray, light: NDArray) -> NDArray:
        """See ``brdffit.appearance.Appearance``: the mean light of the lit texels in the pixel."""
        found = self.pyramid.evaluate(texels.fitted, view, light)
        if len(texels.rows):
            points = 1 << (2 * self.finer)
            each = [np.repeat(direction[texels.rows], points, axis=0) for direction in (view, light)]
            lit = self.pyramid.evaluate(texels.lobes, *each).reshape(-1, points, 3).mean(axis=1)
            part = texels.part[:, None]
            found[texels.rows] = part * lit + (1.0 - part) * found[texels.rows]
        return found

    def sample(self, texels: LitTexels, view: NDArray, u: NDArray) -> NDArray:
        """See ``Appearance``: from the fitted lobe, which covers the lobes in the pixel."""
        return self.pyramid.sample(texels.fitted, view, u)

    def pdf(self, texels: LitTexels, view: NDArray, light: NDArray) -> NDArray:
        """See ``Appearance``."""
        return self.pyramid.pdf(texels.fitted, view, light)


class TextureSpaceLighting:
    """Lights texels of a finer level and filters their light as long as that pays; then uses the fitted maps."""

    name = "texture-space"
    summary = "texels of a finer level are lit and filtered down, fitted maps from where that pays no more (Baker)"
    options: ClassVar[type[BakeOptions]] = TextureSpaceOptions

    def prepare(self, material: Material, options: Any) -> None:
        """Prepare the fit."""
        fit = get_method(DEFAULT)
        fit.prepare(material, _fit_options(options))

    def bake(self, material: Material, options: Any, progress: Progress | None = None) -> Baked:
        """Bake a material, see ``brdffit.methods.Method``."""
        baked = get_method(DEFAULT).bake(material, _fit_options(options), progress)
        pyramid = LobePyramid(baked.appearance.levels)
        stop, seconds = stop_level(pyramid, options.threshold)
        last = len(pyramid.levels) - 1
        held = "are used at no level" if stop > last else f"are used from level {stop} on"
        texels = pyramid.base_size[0] * pyramid.base_size[1]
        notes = [
            f"Lit texels are filtered down; the fitted maps {held}, where lit texels vary by less than "
            f"{100.0 * options.threshold:g}% of their mean.",
            f"A frame that sees all {texels} texels of level 0 costs {seconds:.3f} s for each light on this machine.",
        ]
        appearance = TextureSpace(pyramid, float(stop), options.finer)
        return Baked(self.name, options, appearance, None, [*baked.notes, *notes], baked.images())


def _fit_options(options: TextureSpaceOptions) -> Any:
    """The options that the fit shares; level 0 stays as authored, since it is filtered after lighting."""
    shared = {name: getattr(options, name) for name in options.__dataclass_fields__}
    return with_options(get_method(DEFAULT).options(), shared | {"keep_level_0": True})


def stop_level(pyramid: LobePyramid, threshold: float) -> tuple[int, float]:
    """The first level at which lit texels vary less than the threshold (the number of levels if there is none), and the
    seconds that it takes to light every texel of level 0 by one light and to filter them down."""
    height, width = (min(side, _MOST_TEXELS) for side in pyramid.base_size)
    sizes = level_sizes((height, width))
    rows, columns = np.mgrid[:height, :width]
    position = np.stack([columns.ravel() + 0.5, rows.ravel() + 0.5], axis=-1)
    count = height * width
    view = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (count, 3))
    axes = np.broadcast_to(np.eye(2), (count, 2, 2))
    texels = pyramid.look_up(Lookups(position, axes, np.zeros(count), view))
    random = np.random.default_rng(0)
    varies = np.zeros((_PAIRS, len(sizes)))
    took = []
    for pair in range(_PAIRS):
        light, viewer = (np.broadcast_to(each, (count, 3)) for each in _directions(random))
        began = time.perf_counter()
        lit = pyramid.evaluate(texels, viewer, light).reshape(height, width, 3)
        levels = list(iter_pyramid(lit, sizes, get_pixel_filter("box"), pyramid.levels[0].wrap))
        took.append(time.perf_counter() - began)
        for k, level in enumerate(levels):
            grey = level.mean(axis=-1)
            varies[pair, k] = grey.std() / max(float(grey.mean()), 1e-9)
    # The last two levels have too few texels to tell how much they vary.
    below = [k for k in range(len(sizes) - 2) if varies[:, k].mean() < threshold]
    whole = pyramid.base_size[0] * pyramid.base_size[1] / count
    # The first pair compiles.
    seconds = float(np.median(took[1:])) * whole
    return (below[0] if below else len(pyramid.levels)), seconds


def _directions(random: np.random.Generator) -> tuple[NDArray, NDArray]:
    """A light and a viewer, cosine-distributed."""
    u = random.random((2, 2))
    radius, angle = np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
    both = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - u[:, 0])], axis=-1)
    return both[0], both[1]
