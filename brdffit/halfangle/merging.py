"""Merging of lobes that a light of some size hardly distinguishes.

Under a light that widens lobes by a^2, lobes of similar roughness whose normals differ by less than a share of
sqrt(alpha^2 + a^2) look like one lobe with their mean normal and a SPREAD (twice the covariance of the normals), just
as the normals within one part of a patch do. So the lobes of a footprint are sorted into cells of that size, in the
plane of the equal-area projection of normals and in steps of the roughness, and each cell becomes one lobe. A cell
keeps its energy exactly and is widened by ``widen_lobes``, whose error is of the order of the fourth moment, small
because the normals of a cell lie within a lobe's width.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import inline, kernel
from brdffit.halfangle.frame import tangent_frame
from brdffit.halfangle.quadrature import (
    ALPHA_SQUARED,
    GAIN,
    MIXTURE,
    NORMALISATION,
    SHAPE,
    SPECULAR,
    SPREAD,
    WIDE_AXES,
)

#: Footprints of at most this many lobes are left as they are.
_FEW = 8
#: Factor of alpha^2 + a^2 from one step of the roughness to the next.
_STEP = 1.5
# Columns in use while lobes are merged: sums of u, v, u u, v v, u v in the frame of the cell's first normal, which
# follows.
_SUMS, _FIRST = WIDE_AXES, WIDE_AXES + 5


class Cells(NamedTuple):
    """Room for the cells of one footprint: ``keys`` (room, 3) int64 and a hash table ``slots`` (2^k,) int64."""

    keys: NDArray
    slots: NDArray


def make_cells(room: int) -> Cells:
    """Cells for footprints of at most ``room`` lobes."""
    return Cells(np.zeros((room, 3), np.int64), np.zeros(1 << max(4, math.ceil(math.log2(2 * room + 1))), np.int64))


@inline
def _cell_of(keys, slots, mask, count, q, x, y):
    """Index of the cell with the key (q, x, y). A new cell is entered under the index ``count``."""
    h = np.uint64(q) * np.uint64(0x9E3779B97F4A7C15) ^ np.uint64(x) * np.uint64(0xC2B2AE3D27D4EB4F)
    h = h ^ np.uint64(y) * np.uint64(0x165667B19E3779F9)
    at = np.int64((h ^ (h >> np.uint64(29))) & np.uint64(mask))
    while slots[at] != 0:
        k = slots[at] - 1
        if keys[k, 0] == q and keys[k, 1] == x and keys[k, 2] == y:
            return k
        at = (at + 1) & mask
    slots[at] = count + 1
    keys[count, 0], keys[count, 1], keys[count, 2] = q, x, y
    return count


@kernel
def merge_lobes(lobes, count, square, cell, cells):
    """Merge isotropic lobes in place; returns (how many are left, their mean relative spread).

    MIXTURE must hold each lobe's share of the reflected energy, which weighs its normal and roughness. ``square``: a^2
    of the light; ``cell``: side of a cell in units of sqrt(alpha^2 + a^2).
    """
    merged = count
    if count > _FEW:
        merged = _into_cells(lobes, count, square, cell, cells)
    return merged, mean_spread(lobes, merged, square)


@inline
def mean_spread(lobes, count, square):
    """Mean trace of SPREAD of isotropic lobes, relative to their alpha^2 under a light that adds ``square``."""
    spread = 0.0
    for i in range(count):
        lobe = lobes[i]
        wide = (lobe[SPREAD] + lobe[SPREAD + 1]) / (lobe[ALPHA_SQUARED] + square)
        spread += lobe[MIXTURE] * min(wide, 1.0)
    return spread


@kernel
def _into_cells(lobes, count, square, cell, cells):
    keys, slots = cells.keys, cells.slots
    mask = 15
    while mask < 2 * count:
        mask = 2 * mask + 1
    for i in range(mask + 1):
        slots[i] = 0
    merged = 0
    per_step = 1.0 / math.log(_STEP)
    last, step, inverse = -1.0, 0, 1.0
    for i in range(count):
        lobe = lobes[i]
        if lobe[ALPHA_SQUARED] != last:
            last = lobe[ALPHA_SQUARED]
            step = int(math.floor(math.log(last + square) * per_step + 0.5))
            inverse = 1.0 / (cell * math.exp(0.5 * step / per_step))
        # Lambert's equal-area projection.
        scale = inverse * math.sqrt(2.0 / (1.0 + max(lobe[2], -0.5)))
        negative = lobe[SPECULAR] + lobe[SPECULAR + 1] + lobe[SPECULAR + 2] < 0.0
        x, y = int(math.floor(lobe[0] * scale)), int(math.floor(lobe[1] * scale))
        k = _cell_of(keys, slots, mask, merged, 2 * step + int(negative), x, y)
        w = lobe[MIXTURE]
        if k == merged:
            _open_cell(lobes[k], lobe, w)
            merged += 1
        else:
            _add_to_cell(lobes[k], lobe, w)
    for k in range(merged):
        _close_cell(lobes[k])
    return merged


@inline
def _open_cell(into, lobe, w):
    """Start a cell with its first lobe (which may lie in the same row): weighted sums replace its values."""
    n_x, n_y, n_z = lobe[0], lobe[1], lobe[2]
    into[_FIRST], into[_FIRST + 1], into[_FIRST + 2] = n_x, n_y, n_z
    into[0], into[1], into[2] = n_x, n_y, n_z
    for k in (ALPHA_SQUARED, SHAPE, GAIN, SPREAD, SPREAD + 1, SPREAD + 2):
        into[k] = w * lobe[k]
    into[SPECULAR], into[SPECULAR + 1], into[SPECULAR + 2] = lobe[SPECULAR], lobe[SPECULAR + 1], lobe[SPECULAR + 2]
    into[MIXTURE] = w
    for k in range(5):
        into[_SUMS + k] = 0.0
    into[NORMALISATION] = 1.0


@inline
def _add_to_cell(into, lobe, w):
    n_x, n_y, n_z = into[_FIRST], into[_FIRST + 1], into[_FIRST + 2]
    t_x, t_y, t_z, b_x, b_y, b_z = tangent_frame(n_x, n_y, n_z)
    inverse = 1.0 / max(lobe[0] * n_x + lobe[1] * n_y + lobe[2] * n_z, 0.1)
    u = (lobe[0] * t_x + lobe[1] * t_y + lobe[2] * t_z) * inverse
    v = (lobe[0] * b_x + lobe[1] * b_y + lobe[2] * b_z) * inverse
    for k in (ALPHA_SQUARED, SHAPE, GAIN, SPREAD, SPREAD + 1, SPREAD + 2):
        into[k] += w * lobe[k]
    for k in range(3):
        into[SPECULAR + k] += lobe[SPECULAR + k]
    into[MIXTURE] += w
    into[_SUMS] += w * u
    into[_SUMS + 1] += w * v
    into[_SUMS + 2] += w * u * u
    into[_SUMS + 3] += w * v * v
    into[_SUMS + 4] += w * u * v
    into[NORMALISATION] += 1.0


@inline
def _close_cell(lobe):
    """Turn the sums of a cell into means, and add the covariance of its normals to SPREAD."""
    # A cell that reflects nothing has no weight to divide by. It adds nothing, so any valid lobe will do.
    total = lobe[MIXTURE]
    if not total > 0.0:
        lobe[ALPHA_SQUARED], lobe[GAIN] = max(lobe[ALPHA_SQUARED], 1e-6), 1.0
        return
    inverse = 1.0 / total
    for k in (ALPHA_SQUARED, SHAPE, GAIN, SPREAD, SPREAD + 1, SPREAD + 2):
        lobe[k] *= inverse
    if lobe[NORMALISATION] > 1.5:
        n_x, n_y, n_z = lobe[_FIRST], lobe[_FIRST + 1], lobe[_FIRST + 2]
        t_x, t_y, t_z, b_x, b_y, b_z = tangent_frame(n_x, n_y, n_z)
        u, v = lobe[_SUMS] * inverse, lobe[_SUMS + 1] * inverse
        x, y, z = n_x + u * t_x + v * b_x, n_y + u * t_y + v * b_y, n_z + u * t_z + v * b_z
        length = 1.0 / math.sqrt(x * x + y * y + z * z)
        lobe[0], lobe[1], lobe[2] = x * length, y * length, z * length
        lobe[SPREAD] += 2.0 * max(lobe[_SUMS + 2] * inverse - u * u, 0.0)
        lobe[SPREAD + 1] += 2.0 * max(lobe[_SUMS + 3] * inverse - v * v, 0.0)
        lobe[SPREAD + 2] += 2.0 * (lobe[_SUMS + 4] * inverse - u * v)
