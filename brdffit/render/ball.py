"""The lit ball of preview and thumbnail: one studio for all, drawn by the same loops as every other picture.

The texture is laid onto the ball from the front, one texel of a MIP level a pixel. Interpolation and lobes are the
renderer's: a base is interpolated as the reference does it, a pyramid as an engine does it.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import LobePyramid
from brdffit.render import scenes
from brdffit.render._footprints import Budget
from brdffit.render.lights import Lights
from brdffit.render.pictures import Drawable, appearance_of, render_appearance_halves
from brdffit.render.reference import render_halves
from brdffit.render.scenes import Scene
from brdffit.svbrdf import Svbrdf

#: Most base texels along a side that a ball shows; of a larger base only a part is shown.
MOST_TEXELS = 1024
#: Samples of a footprint in the reference.
_SAMPLES = Budget(48, 12, 128)
#: Directions of light for an appearance that is drawn in numpy: enough for a glance, at the cost of some noise.
_DIRECTIONS = 16

# Direction (x right, y up, z to the viewer), irradiance over pi, angular radius: a key lamp and a rim lamp, and for sky
# and ground lamps so wide that they meet.
_KEY, _WIDE = 0.19, 1.25
_LAMPS = (
    ((-0.55, 0.60, 0.58), (3.2, 3.1, 2.9), _KEY),
    ((0.85, -0.05, 0.30), (0.9, 1.1, 1.4), _KEY),
    ((0.00, 1.00, 0.35), (0.10, 0.10, 0.11), _WIDE),
    ((-0.85, 0.30, 0.45), (0.07, 0.07, 0.075), _WIDE),
    ((0.85, 0.30, 0.45), (0.07, 0.07, 0.075), _WIDE),
    ((0.00, -0.90, 0.50), (0.045, 0.043, 0.040), _WIDE),
)


def studio() -> Lights:
    """What lights the ball: two softboxes, and a sky and a floor of wide lamps."""
    direction, irradiance, radius = zip(*_LAMPS, strict=True)
    return Lights(np.array(direction), math.pi * np.array(irradiance), np.array(radius))


class Part(NamedTuple):
    """The part of a base that balls show: texels from ``first`` to ``first + extent``, of its ``size`` first ones.

    Beyond it lie as many texels more as the coarsest level shown needs to interpolate, so that nothing is cut off.
    """

    first: int
    extent: tuple[int, int]
    size: tuple[int, int]

    @classmethod
    def of(cls, base_size: tuple[int, int], deepest: int) -> Part:
        """All of a base; or a square of a large one, if its levels down to ``deepest`` are exact halves."""
        margin = 1 << deepest
        fits = all(side % margin == 0 and side >= MOST_TEXELS + 2 * margin for side in base_size)
        if not fits or MOST_TEXELS % margin:
            return cls(0, base_size, base_size)
        return cls(margin, (MOST_TEXELS, MOST_TEXELS), (MOST_TEXELS + 2 * margin,) * 2)

    def crop(self, level: Svbrdf, mip_level: int, whole: tuple[int, int]) -> Svbrdf:
        """A level of a base of the size ``whole``, cropped to the part."""
        if self.size == whole:
            return level
        height, width = (side >> mip_level for side in self.size)
        arrays = {name: array[:height, :width] for name, array in level.arrays().items()}
        return level.replace(**arrays, wrap="clamp")

    def scene(self, base_size: tuple[int, int], levels: Sequence[int], diameter: int) -> Scene:
        """A ball for each level, side by side; where one shows more than the part, the part repeats."""
        scene = scenes.side_by_side([scenes.sphere(base_size, level, (diameter, diameter)) for level in levels])
        # Positions of whole pixels: a remainder must not turn 1024 - 1e-13 into another texel.
        centre = self.first + np.round(scene.centre, 9) % np.array(self.extent[::-1], np.float64)
        return dataclasses.replace(scene, centre=centre)


def lit_balls(
    drawn: Drawable, levels: Sequence[int], diameter: int, part: Part | None = None, *, threads: int | None = None
) -> NDArray:
    """Balls that show some levels of an appearance: (levels, 2, n, n, 3) float32, two estimates of linear radiance."""
    appearance = appearance_of(drawn)
    size = appearance.base_size
    part = part or Part.of(size, max(levels))
    lamps = "sampled"
    if isinstance(appearance, LobePyramid):
        cropped = [part.crop(level, k, size) for k, level in enumerate(appearance.levels[: max(levels) + 1])]
        appearance, lamps = LobePyramid(cropped), "widened"
    scene = part.scene(appearance.base_size, levels, diameter)
    halves = render_appearance_halves(
        appearance, scene, studio(), lamps=lamps, directions=_DIRECTIONS, threads=threads
    )  # fmt: skip
    return _apart(halves, diameter)


def reference_balls(
    base: Svbrdf, levels: Sequence[int], diameter: int, part: Part | None = None, *, threads: int | None = None
) -> NDArray:
    """The same by the reference: each pixel the mean of what the base reflects in its footprint."""
    part = part or Part.of(base.size, max(levels))
    scene = part.scene(part.size, levels, diameter)
    cropped = part.crop(base, 0, base.size)
    return _apart(
        render_halves(cropped, scene, studio(), lamps="widened", samples=_SAMPLES, threads=threads).halves, diameter
    )


def _apart(halves: NDArray, diameter: int) -> NDArray:
    """(levels, 2, n, n, 3) of balls side by side, (2, n, levels n, 3)."""
    return halves.reshape(2, diameter, -1, diameter, 3).transpose(2, 0, 1, 3, 4)


def over_background(radiance: NDArray, background: NDArray) -> NDArray:
    """A ball (n, n, 3) with its soft rim on a ground (3,) of linear radiance."""
    coverage = _coverage(radiance.shape[0])
    return radiance * coverage + background * (1.0 - coverage)


@cache
def _coverage(diameter: int) -> NDArray:
    """(n, n, 1) share of each pixel that a ball covers."""
    return scenes.sphere((1, 1), 0, (diameter, diameter)).coverage[..., None]
