"""Textures of 8 floats a texel (7 channels and a 0): interpolation, its adjoint, its derivative by position, and blur.

Each row of a texture is stored with its first texel once more at the end, so that two neighbours are always 16 floats
in a row: one vector. With fractions (a, b) within a cell of texels T00, T01 (to the right), T10, T11, and the weight w
of the level,

    f = sum_levels w [(1 - b) ((1 - a) T00 + a T01) + b ((1 - a) T10 + a T11)],

    dL/dT = the same weights times dL/df,
    dL/dx = sum_levels w s sum_c dL/df_c [(1 - b) (T01 - T00) + b (T11 - T10)]_c,

where a unit of x is s texels of the level, and likewise by y. ``rooms`` holds a row (first float, width, height) for
each level; widths and heights are powers of two, and everything is periodic.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel
from brdffit.nets.vectors import LANES, add, add_halves, halves, load, multiply, multiply_add, store, subtract, total
from brdffit.neural.kernels.dense import NARROW, ROWS

#: Floats of a texel.
TEXEL = 8
#: Channels that are learned.
CHANNELS = 7
#: Columns of ``kept`` for each level that a query reads: fractions a and b, weight, texels of it by one of the base.
KEPT = 5

_F = np.float32


@inline
def _cell(x, y, first, width, height):
    """Indices of the cell's two rows, and the fractions within it, at (x, y) in texels of the level."""
    x, y = x - _F(0.5), y - _F(0.5)
    left, upper = math.floor(x), math.floor(y)
    column, row = int(left) & (width - 1), int(upper) & (height - 1)
    pitch = (width + 1) * TEXEL
    below = (row + 1) & (height - 1)
    at = first + column * TEXEL
    return at + row * pitch, at + below * pitch, _F(x - left), _F(y - upper)


@kernel
def interpolate(texture, rooms, levels, queries, start, shift, features, places, kept):
    """f of each query of a block into the first 7 columns of ``features``; what the backward pass needs is kept.

    ``levels``: how many are read, 2 (of the nearest to the query's level), or 1 (level 0). ``shift`` (2 * ROWS) is
    added to positions, in texels of level 0.
    """
    for i in range(ROWS):
        query = start + i
        x, y = queries[query, 0] + shift[2 * i], queries[query, 1] + shift[2 * i + 1]
        last = rooms.shape[0] - 1
        detail = min(max(queries[query, 2], _F(0.0)), _F(last))
        fine = max(min(int(detail), last - 1), 0)
        part = detail - _F(fine)
        value = halves(_F(0.0), _F(0.0))
        for h in range(levels):
            level = min(fine + h, last) if levels == 2 else 0
            weight = _F(1.0) if levels == 1 else (part if h else _F(1.0) - part)
            width, height = rooms[level, 1], rooms[level, 2]
            across, down = _F(width) / _F(rooms[0, 1]), _F(height) / _F(rooms[0, 2])
            upper, lower, a, b = _cell(x * across, y * down, rooms[level, 0], width, height)
            first = load(texture, upper)
            row = multiply_add(halves(b, b), subtract(load(texture, lower), first), first)
            value = multiply_add(halves(weight * (_F(1.0) - a), weight * a), row, value)
            places[i, 2 * h], places[i, 2 * h + 1] = upper, lower
            k = h * KEPT
            kept[i, k], kept[i, k + 1], kept[i, k + 2], kept[i, k + 3], kept[i, k + 4] = a, b, weight, across, down
        store(features, i * NARROW, add_halves(value))


@kernel
def spread(d_features):
    """Make each row of dL/df ready: 7 numbers, 0, and the same again."""
    for i in range(ROWS):
        at = i * NARROW
        d_features[at + CHANNELS] = _F(0.0)
        for c in range(TEXEL):
            d_features[at + TEXEL + c] = d_features[at + c]


@kernel
def scatter(gradient, levels, d_features, places, kept):
    """Add dL/dT of a block, from rows made by ``spread``."""
    one = _F(1.0)
    for i in range(ROWS):
        d = load(d_features, i * NARROW)
        for h in range(levels):
            a, b, weight = kept[i, h * KEPT], kept[i, h * KEPT + 1], kept[i, h * KEPT + 2]
            across = multiply(halves(weight * (one - a), weight * a), d)
            upper, lower = places[i, 2 * h], places[i, 2 * h + 1]
            store(gradient, upper, multiply_add(halves(one - b, one - b), across, load(gradient, upper)))
            store(gradient, lower, multiply_add(halves(b, b), across, load(gradient, lower)))


@kernel
def by_position(texture, d_features, places, kept, d_shift):
    """dL/d(x, y) of a block into ``d_shift`` (2 * ROWS), a unit being a texel of level 0."""
    one = _F(1.0)
    for i in range(ROWS):
        d = load(d_features, i * NARROW)
        dx, dy = _F(0.0), _F(0.0)
        for h in range(2):
            a, b, weight = kept[i, h * KEPT], kept[i, h * KEPT + 1], kept[i, h * KEPT + 2]
            first = load(texture, places[i, 2 * h])
            down = subtract(load(texture, places[i, 2 * h + 1]), first)
            row = multiply(multiply_add(halves(b, b), down, first), d)
            dx += weight * kept[i, h * KEPT + 3] * total(multiply(halves(-one, one), row))
            dy += weight * kept[i, h * KEPT + 4] * total(multiply(halves(one - a, a), multiply(down, d)))
        d_shift[2 * i], d_shift[2 * i + 1] = dx, dy


@kernel
def blur_level(source, target, room, taps, scratch, padded):
    """Convolve one level (h, w, 8) with a periodic kernel along both axes, into ``target`` with its repeated column.

    Args:
        source: flat, h * w texels.
        target: flat; the level starts at room[0] and has room[1] = w columns (and one more) and room[2] = h rows.
        taps: (across, down) arrays of odd length: weights of the texels from -length // 2 on.
        scratch: h * w texels.
        padded: (w + length + 1) texels.
    """
    width, height = room[1], room[2]
    across, down = taps
    reach_x, reach_y = len(across) // 2, len(down) // 2
    line = width * TEXEL
    zero = halves(_F(0.0), _F(0.0))
    # Rows of 8 floats less than a vector (one texel) are summed one by one.
    whole = line - line % LANES
    for row in range(height):
        for i in range(0, whole, LANES):
            value = zero
            for t in range(len(down)):
                other = (row + t - reach_y) & (height - 1)
                value = multiply_add(halves(down[t], down[t]), load(source, other * line + i), value)
            store(scratch, row * line + i, value)
        for i in range(whole, line):
            value_i = _F(0.0)
            for t in range(len(down)):
                value_i += down[t] * source[((row + t - reach_y) & (height - 1)) * line + i]
            scratch[row * line + i] = value_i
    for row in range(height):
        for column in range(width + 2 * reach_x):
            other = (column - reach_x) & (width - 1)
            for c in range(TEXEL):
                padded[column * TEXEL + c] = scratch[row * line + other * TEXEL + c]
        at = room[0] + row * (width + 1) * TEXEL
        for i in range(0, whole, LANES):
            value = zero
            for t in range(len(across)):
                value = multiply_add(halves(across[t], across[t]), load(padded, i + t * TEXEL), value)
            store(target, at + i, value)
        for i in range(whole, line):
            value_i = _F(0.0)
            for t in range(len(across)):
                value_i += across[t] * padded[i + t * TEXEL]
            target[at + i] = value_i
        for c in range(TEXEL):
            target[at + line + c] = target[at + c]


@kernel
def gather_parts(flat, count, first, last, total_gradient):
    """total[first:last] = the sum over ``count`` parts of a gradient, one behind the other; the parts are cleared."""
    size = len(total_gradient)
    end = last - (last - first) % LANES
    zero = halves(_F(0.0), _F(0.0))
    for i in range(first, end, LANES):
        value = load(flat, i)
        store(flat, i, zero)
        for part in range(1, count):
            value = add(value, load(flat, part * size + i))
            store(flat, part * size + i, zero)
        store(total_gradient, i, value)
    for i in range(end, last):
        value_i = _F(0.0)
        for part in range(count):
            value_i += flat[part * size + i]
            flat[part * size + i] = _F(0.0)
        total_gradient[i] = value_i
