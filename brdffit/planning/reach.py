"""The MIP levels of a surface that the cameras of a scene can read.

Distance, field of view, resolution and tilt give the number of base texels that a pixel spans; trilinear filtering
reads the levels below and above the base-2 logarithm of that number (Baker: "determine the object's maximum MIP
level").
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from brdffit.planning.description import Camera, SceneFile, Surface
from brdffit.svbrdf import level_sizes

#: Largest angle in degrees between normal and view on a curved surface; beyond, its rim is ignored (as in
#: ``render.scenes.sphere``).
GRAZING = 80.0

# A footprint this close to a power of two reads that level alone.
_LEVEL_ROUNDING = 1e-9


@dataclass(frozen=True)
class Reach:
    """Levels that are read.

    Attributes:
        first, last: first and last level that are read, within those of the texture.
        ratio_low, ratio_high: least and most base texels that a pixel spans along the longer axis of its footprint.
        sentence: the same in words.
    """

    first: int
    last: int
    ratio_low: float
    ratio_high: float
    sentence: str


def reached_levels(scene: SceneFile, surface: Surface, base_size: tuple[int, int]) -> Reach:
    """Levels of ``surface`` that the cameras of ``scene`` read with trilinear filtering.

    A pixel's footprint is taken as ``render.scenes.level_of_detail`` takes it: its longer axis, 1 / cos(tilt) times the
    width of a pixel at the surface's distance. A pixel smaller than a texel reads level 0.

    Args:
        scene: as ``read_scene`` gives it.
        surface: one of the scene's.
        base_size: (height, width) of its base texture in texels.
    """
    texel, top = surface.texel(base_size), len(level_sizes(base_size)) - 1
    low, nearest = min((_texels_a_pixel(each, surface, texel, far=False), each.name) for each in scene.cameras)
    high, farthest = max((_texels_a_pixel(each, surface, texel, far=True), each.name) for each in scene.cameras)
    first = min(max(math.floor(math.log2(low) + _LEVEL_ROUNDING), 0), top)
    last = min(max(math.ceil(math.log2(high) - _LEVEL_ROUNDING), 0), top)
    named = "" if nearest == farthest else f" (nearest '{nearest}', farthest '{farthest}')"
    levels = f"level {first}" if first == last else f"levels {first} to {last}"
    return Reach(
        first, last, low, high, f"A pixel spans {_short(low)} to {_short(high)} texels{named}: {levels} of 0 to {top}."
    )


def pixel_width(camera: Camera, distance: float) -> float:
    """Width in metres of a pixel on a plane that faces the camera at ``distance``, the same all over the picture."""
    return 2.0 * math.tan(math.radians(0.5 * camera.field_of_view)) * distance / camera.resolution[0]


def shown_turn(camera: Camera, distance: float | NDArray, radius: float | None) -> NDArray:
    """Degrees by which the normal of a curved surface turns between the picture's middle and its corner, or the rim.

    A ray at angle a from the axis meets a ball of radius R, whose nearest point is ``distance`` d away, at an incidence
    i with sin i = (1 + d / R) sin a; its normal there has turned by i - a. 0 for a flat one, ``radius`` None.
    """
    distance = np.asarray(distance, np.float64)
    if radius is None:
        return np.zeros_like(distance)
    width, height = camera.resolution
    corner = math.atan(math.tan(math.radians(0.5 * camera.field_of_view)) * math.hypot(1.0, height / width))
    magnified = 1.0 + distance / radius
    angle = np.minimum(corner, np.arcsin(1.0 / magnified))
    return np.degrees(np.arcsin(np.minimum(magnified * np.sin(angle), 1.0)) - angle)


def _short(number: float) -> str:
    return f"{number:.2g}" if number < 100.0 else f"{number:.0f}"


def _texels_a_pixel(camera: Camera, surface: Surface, texel: float, far: bool) -> float:
    """Base texels along a pixel's footprint, where it is longest (``far``) or shortest."""
    distance, tilt = camera.distances[far], camera.tilts[far]
    # From farther away more of a ball is seen, so its largest turn is the one seen from there, for both ends.
    turn = float(shown_turn(camera, camera.distances[1], surface.radius))
    tilt = max(min(tilt + turn, GRAZING), tilt) if far else max(tilt - turn, 0.0)
    return pixel_width(camera, distance) / (texel * math.cos(math.radians(tilt)))
