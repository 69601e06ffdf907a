"""Two small lit balls, the averaged maps and the baked ones: enough to see in a long list what a bake gained."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit.assessment import averaged_levels
from brdffit.methods import Baked, Material
from brdffit.options import LobeOptions
from brdffit.render import metrics
from brdffit.render.ball import Part, lit_balls, over_background
from brdffit.svbrdf import Svbrdf

#: Diameter of a ball in pixels, the level that it shows where there are so many, and the room between two.
BALL, LEVEL, _GAP = 80, 3, 8
#: The ground of the page, and mean radiance of the balls before the curve.
_BACKGROUND = np.array([0.0072, 0.0082, 0.0105], np.float32)
_KEY = 0.30


def make_thumbnail(base: Svbrdf, baked: Baked) -> NDArray:
    """The balls side by side, before on the left: (BALL, 2 BALL + gap, 3) uint8, sRGB.

    Of a large base only a part is filtered for the left one: its cost does not grow with the base.
    """
    mip_level = min(LEVEL, len(baked.sizes) - 1)
    part = Part.of(base.size, mip_level)
    shown = part.crop(base, 0, base.size)
    options = LobeOptions(pixel_filter=baked.options.pixel_filter, levels=mip_level + 1, model=base.model)
    before = lit_balls(
        averaged_levels(Material(shown), options), [mip_level], BALL, part._replace(size=shown.size), threads=1
    )
    balls = [each[0].mean(axis=0) for each in (before, lit_balls(baked.appearance, [mip_level], BALL, part, threads=1))]
    exposure = _KEY / max(float(np.mean(balls)), 1e-6)
    picture = np.empty((BALL, 2 * BALL + _GAP, 3), np.float32)
    picture[:] = metrics.tone_map(_BACKGROUND / exposure, exposure)
    for lit, left in zip(balls, (0, BALL + _GAP), strict=True):
        picture[:, left : left + BALL] = metrics.tone_map(over_background(lit, _BACKGROUND / exposure), exposure)
    return np.rint(255.0 * picture).astype(np.uint8)
