"""Alpha of cut-outs in pictures: each level passes the alpha test on the same share of its texels as level 0.

Averaged alpha under a test loses thin things first: a leaf's stalk falls below the cutoff two levels down. So alpha of
each level is scaled until the share of texels at or above the cutoff is that of level 0 (Castano 2010, "Computing alpha
mipmaps"). The opacity that weighed the maps, and opacity.exr, stay as filtered.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from brdffit.export.presets import Picture
from brdffit.svbrdf import Svbrdf


def share_above(opacity: NDArray, cutoff: float) -> float:
    """Share of texels that a test against ``cutoff`` lets pass."""
    return float(np.mean(opacity >= cutoff))


def with_kept_coverage(levels: Sequence[Svbrdf]) -> list[Svbrdf]:
    """Levels of a mask with opacity scaled so that each has the tested share of level 0; others as they are.

    On a level of n texels the share can be off by 1 / (2n), and by more where opacities are equal.
    """
    base = levels[0]
    if base.opacity is None or base.alpha != "mask":
        return list(levels)
    share = share_above(base.opacity, base.cutoff)
    return [base, *(_scaled(level, share) for level in levels[1:])]


def _scaled(level: Svbrdf, share: float) -> Svbrdf:
    assert level.opacity is not None
    values, counts = np.unique(level.opacity, return_counts=True)
    passing = np.append(np.cumsum(counts[::-1])[::-1], 0) / level.opacity.size
    # The threshold lies between two values: passing[k] is the share at or above values[k], the last that of none.
    chosen = int(np.argmin(np.abs(passing - share)))
    if chosen == len(values):
        threshold = float(values[-1]) * 1.01 + 1e-6
    else:
        below = float(values[chosen - 1]) if chosen else 0.0
        threshold = 0.5 * (float(values[chosen]) + below)
    scaled = level.opacity * np.float32(level.cutoff / max(threshold, 1e-6))
    return level.replace(opacity=np.clip(scaled, 0.0, 1.0).astype(np.float32))


def with_alpha(picture: Picture, level: Svbrdf) -> Picture:
    """A picture of colours with opacity as its fourth channel, where the material has alpha."""
    is_colour = picture.channels in (
        ("base_color_r", "base_color_g", "base_color_b"),
        ("diffuse_r", "diffuse_g", "diffuse_b"),
    )
    if not is_colour or level.opacity is None or not level.alpha:
        return picture
    return dataclasses.replace(picture, channels=(*picture.channels, "opacity"))
