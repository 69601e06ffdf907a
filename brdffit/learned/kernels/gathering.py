"""Sums of footprints that are no unions of finer ones: other pixel filters, sizes that do not halve."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import kernel
from brdffit.fitting.batch import diffuse_scale
from brdffit.halfangle.apparent_lobe import DIFFUSE_MOMENT, Base, Strata
from brdffit.halfangle.quadrature import LOBE_COLUMNS
from brdffit.learned.kernels.footprints import COLOUR, COLUMNS, DARKEST, DIFFUSE, ENERGY, PLANE, SUMS, empty_tiles
from brdffit.learned.kernels.moments import MOMENTS, lobe_moments
from brdffit.learned.kernels.tables import prepare_lobes


@kernel
def gather_rows(base, strata, first, rows, width, lobes, moments, diffuse, tiles):
    """Fill the tiles of rows ``first`` and on of a level."""
    across = (width + COLUMNS - 1) // COLUMNS
    for row in range(rows):
        for column in range(width):
            count, isotropic, red, green, blue, some = prepare_lobes(base, strata, column, first + row, lobes, diffuse)
            lobe_moments(lobes, count, isotropic, moments)
            red, green, blue = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
            energy = max(red + green + blue, DARKEST) if some else DARKEST
            at = (row // 2 * across + column // COLUMNS) * SUMS * PLANE + row % 2 * COLUMNS + column % COLUMNS
            for k in range(MOMENTS):
                tiles[at + k * PLANE] = energy * moments[k]
            tiles[at + ENERGY * PLANE] = energy
            tiles[at + COLOUR * PLANE], tiles[at + (COLOUR + 1) * PLANE] = red, green
            tiles[at + (COLOUR + 2) * PLANE] = blue
            for k in range(9):
                tiles[at + (DIFFUSE + k) * PLANE] = diffuse[k]


def gather_tiles(base: Base, strata: Strata, room: int, first: int, rows: int, width: int) -> NDArray:
    """Tiles of rows ``first`` and on of a level; ``room`` is how many lobes a footprint may have."""
    tiles, lobes = empty_tiles((rows, width)), np.zeros((room + 1, LOBE_COLUMNS))
    gather_rows(base, strata, first, rows, width, lobes, np.zeros(MOMENTS), np.zeros(DIFFUSE_MOMENT), tiles)
    return tiles


@kernel
def diffuse_rows(moments, normal, exponent, out):
    """Diffuse colours (n, 3) that fit footprints' ``Gathered.diffuse`` under normals (n, 3)."""
    for i in range(normal.shape[0]):
        for k in range(3):
            out[i, k] = diffuse_scale(moments[i], k, normal[i, 0], normal[i, 1], normal[i, 2], exponent)
