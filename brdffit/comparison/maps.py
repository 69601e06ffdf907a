"""Roughness and anisotropy of every level of a pyramid in one grey picture."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from brdffit.footprint import filter_channels, get_pixel_filter
from brdffit.report.records import MOST_ANISOTROPY
from brdffit.roughness import eigenvalues_of_log, perceptual_from_log_tensor
from brdffit.svbrdf import Svbrdf

#: Side of a level's tile, in pixels.
TILE = 96


def map_strip(levels: Sequence[Svbrdf]) -> NDArray:
    """(2 TILE, TILE * levels) uint8: perceptual roughness above, anisotropy below, level 0 at the left.

    Roughness 0 to 1 is 0 to 255. Anisotropy is the logarithm of the ratio of the two alphas, 0 at 1:1 and 255 at
    `MOST_ANISOTROPY`:1 and beyond. Levels are averaged or repeated to the tile's size.
    """
    columns = []
    for level in levels:
        major, minor = eigenvalues_of_log(level.log_roughness)
        anisotropy = 0.5 * np.log(major / minor) / np.log(MOST_ANISOTROPY)
        roughness = perceptual_from_log_tensor(level.log_roughness)
        columns.append(np.concatenate([_tile(np.clip(each, 0.0, 1.0)) for each in (roughness, anisotropy)]))
    return np.round(255.0 * np.concatenate(columns, axis=1)).astype(np.uint8)


def _tile(values: NDArray) -> NDArray:
    """(TILE, TILE) of (h, w): averaged where it is larger, repeated where it is smaller."""
    height, width = values.shape
    smaller = min(height, TILE), min(width, TILE)
    if smaller != (height, width):
        values = filter_channels(values[..., None], smaller, get_pixel_filter("box"), "clamp")[..., 0]
    rows, columns = (np.arange(TILE) * size // TILE for size in smaller)
    return values[rows[:, None], columns]
