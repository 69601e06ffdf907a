"""Two small lit balls, the averaged maps and the baked ones: enough to see in a long list what a bake gained."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from brdffit.methods import BakeOptions, Method, Pyramid, get_method
from brdffit.render import shading
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf

#: Diameter of a ball in pixels, the level that it shows where there are so many, and the room between two.
BALL, LEVEL, _GAP = 80, 3, 8
_AMBIENT = 0.12
#: The ground of the page.
_BACKGROUND = np.array([0.0072, 0.0082, 0.0105], np.float32)
#: Direction and irradiance of each light, and the alpha^2 by which its size widens every highlight.
_LIGHTS = (((-0.55, 0.60, 0.58), 3.0), ((0.80, -0.10, 0.40), 0.9))
_LIGHT_SIZE = np.array([0.08**2, 0.08**2, 0.0], np.float32)


def make_thumbnail(base: Svbrdf, pyramid: Pyramid) -> NDArray:
    """The balls side by side, before on the left: (BALL, 2 BALL + gap, 3) uint8, sRGB.

    Only as much of the base is filtered for the left one as the ball shows: its cost does not grow with the base.
    """
    mip_level = min(LEVEL, len(pyramid) - 1)
    side = BALL << mip_level
    shown = base.replace(**{name: array[:side, :side] for name, array in base.arrays().items()})
    options = BakeOptions(pixel_filter=pyramid.options.pixel_filter, levels=mip_level + 1, model=base.model)
    before = _naive().bake(shown, options)[mip_level].svbrdf
    balls = [_lit(level) for level in (before, pyramid[mip_level].svbrdf)]
    exposure = 0.30 / max(float(np.mean(balls)), 1e-6)
    picture = np.empty((BALL, 2 * BALL + _GAP, 3), np.float32)
    picture[:] = _BACKGROUND
    for lit, left in zip(balls, (0, BALL + _GAP), strict=True):
        coverage = _ball()[0][..., None]
        picture[:, left : left + BALL] = lit * exposure * coverage + _BACKGROUND * (1.0 - coverage)
    return _displayed(picture)


@cache
def _naive() -> Method:
    return get_method("naive")


@cache
def _ball() -> tuple[NDArray, ...]:
    """Coverage (n, n) of each pixel, and directions (n, n, 3) in the ball's own frame: viewer and the two lights."""
    at = (np.arange(BALL, dtype=np.float32) + 0.5) / BALL * 2.0 - 1.0
    x, y = np.meshgrid(at, -at)
    radius = np.sqrt(x * x + y * y)
    inside = np.minimum(radius, 0.985) / radius
    surface = shading.components(x * inside, y * inside, np.sqrt(1.0 - np.square(radius * inside)))

    def local(direction: tuple[float, float, float]) -> NDArray:
        vector = np.asarray(direction, np.float32)
        return shading.into_frame(np.broadcast_to(vector / np.linalg.norm(vector), surface.shape), surface)

    coverage = np.clip((1.0 - radius) * BALL / 2.0, 0.0, 1.0)
    return coverage, local((0.0, 0.0, 1.0)), *(local(direction) for direction, _ in _LIGHTS)


def _lit(level: Svbrdf) -> NDArray:
    """Radiance (n, n, 3) of the ball, one texel a pixel."""
    rows, columns = (np.arange(BALL) % size for size in level.size)
    texels = {name: array[np.ix_(rows, columns)] for name, array in level.arrays().items()}
    _, view, *lights = _ball()
    profile = shading.PROFILES.get(level.model, shading.beckmann_profile)
    tensor = tensor_from_log(texels["log_roughness"]) + _LIGHT_SIZE
    radiance = _AMBIENT * (texels["specular"] + texels["diffuse"])
    for light, (_, irradiance) in zip(lights, _LIGHTS, strict=True):
        reflected = shading.brdf(
            light, view, texels["normal"], tensor, texels["specular"], texels["diffuse"], profile=profile,
            shape=texels.get("shape"),
        )  # fmt: skip
        # The ball shadows itself where the light is below its own horizon.
        facing = np.clip(light[..., 2:] * 8.0 + 0.5, 0.0, 1.0)
        radiance = radiance + reflected * facing * np.float32(irradiance * np.pi)
    return radiance


def _displayed(radiance: NDArray) -> NDArray:
    """Linear radiance to sRGB codes: Reinhard's curve with white at 4."""
    radiance = np.maximum(radiance, 0.0)
    mapped = np.clip(radiance * (1.0 + radiance / 16.0) / (1.0 + radiance), 0.0, 1.0)
    encoded = np.where(mapped <= 0.0031308, 12.92 * mapped, 1.055 * np.power(mapped, 1.0 / 2.4) - 0.055)
    return np.rint(255.0 * encoded).astype(np.uint8)
