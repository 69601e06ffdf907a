"""Where a ray first meets a periodic height field, by its maximum pyramid (Tevs, Ihrke and Seidel 2008).

The field is a mesh: heights stand at integer columns and rows, and each cell between four of them is two triangles
that share the diagonal from (i, j) to (i + 1, j + 1). On a triangle the height is linear, so what a ray is above the
surface is linear between the points where it enters, crosses the diagonal and leaves: the intersection is exact, and
the same mesh can be given to any other ray tracer. (A bilinear patch would need a square root, and no other program
knows it.)

Level k of the pyramid holds the maxima of blocks of 2^k x 2^k cells, cut where the tile ends, so that sizes need not
be powers of two; the last level is the whole tile. A ray that stays above a block's maximum skips the block. It counts
cells in integers and its length only ever grows, so that rounding can neither stop it nor let it through the surface.

Coordinates are (column, row, height) in texels; a direction's second component points down the rows.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel

#: A ray that has met nothing after so many steps runs level for ever between the hills of a field that repeats.
MOST_STEPS = 200000
_FAR = 1e30


@inline
def height_in_cell(h00, h10, h01, h11, x, y):
    """Height at (x, y) in [0, 1]^2 of a cell of two triangles."""
    if x >= y:
        return h00 + x * (h10 - h00) + y * (h11 - h10)
    return h00 + y * (h01 - h00) + x * (h11 - h01)


@inline
def corners_of(height, row, column):
    """Heights of a cell's corners, first along the columns."""
    right = column + 1 if column + 1 < height.shape[1] else 0
    below = row + 1 if row + 1 < height.shape[0] else 0
    return (
        np.float64(height[row, column]),
        np.float64(height[row, right]),
        np.float64(height[below, column]),
        np.float64(height[below, right]),
    )


@inline
def gradient_of(h00, h10, h01, h11, side):
    """(by column, by row) of a cell's triangle: that where x - y = ``side`` is at least 0, or the other."""
    if side >= 0.0:
        return h10 - h00, h11 - h10
    return h11 - h01, h01 - h00


@inline
def surface_at(height, x, y):
    """(height, derivative by column, derivative by row) below a point of the plane."""
    columns, rows = height.shape[1], height.shape[0]
    i, j = math.floor(x), math.floor(y)
    h00, h10, h01, h11 = corners_of(height, np.int64(j) % rows, np.int64(i) % columns)
    across, down = gradient_of(h00, h10, h01, h11, (x - i) - (y - j))
    return height_in_cell(h00, h10, h01, h11, x - i, y - j), across, down


@inline
def in_unit(x):
    """x, held in [0, 1]."""
    return min(max(x, 0.0), 1.0)


@inline
def next_cell(cell, low, high, forward, count, origin, level):
    """Over a border of the block ``low`` to ``high`` along one axis of ``count`` cells: the cell behind it, where its
    tile begins, and whether the block of the next level is left too."""
    after = high if forward else low - 1
    leaves = (cell >> level >> 1) != (after >> level >> 1)
    if after == count:
        return np.int64(0), origin + count, leaves
    if after < 0:
        return np.int64(count - 1), origin - count, leaves
    return after, origin, leaves


@inline
def start_level(levels, across, span, fall):
    """The pyramid level to begin at: that of the cells a ray passes over from top to bottom, half of it."""
    cells = across * span / max(abs(fall), 1e-9)
    level = 0
    while cells > 2.0 and level < levels.shape[0] - 1:
        cells *= 0.5
        level += 1
    return level


@kernel
def meet(height, maxima, levels, x, y, z, d_x, d_y, d_z):
    """(t, column, row, derivative by column, derivative by row) where a ray first meets the surface; t = -1 if nowhere.

    Args:
        height: (rows, columns) float32.
        maxima: pyramid, flat float32; ``levels`` (L, 3) int64: where each level begins, its rows and its columns.
        x, y, z: where the ray begins, above the surface.
        d_x, d_y, d_z: its direction; t is in units of its length.
    """
    rows, columns = height.shape
    last = levels.shape[0] - 1
    top = np.float64(maxima[levels[last, 0]])
    limit = _FAR
    if d_z > 0.0:
        limit = (top - z) / d_z
        if limit <= 0.0:
            return -1.0, 0.0, 0.0, 0.0, 0.0
    per_x = 1.0 / d_x if abs(d_x) > 1e-30 else _FAR
    per_y = 1.0 / d_y if abs(d_y) > 1e-30 else _FAR
    first_i, first_j = math.floor(x), math.floor(y)
    i, j = np.int64(first_i) % columns, np.int64(first_j) % rows
    # From here on the ray is counted from the tile that its cell lies in.
    origin_x, origin_y = first_i - i, first_j - j
    level = start_level(levels, math.sqrt(d_x * d_x + d_y * d_y), 1.0, d_z)
    t = 0.0
    for _ in range(MOST_STEPS):
        left = (i >> level) << level
        right = min(left + (1 << level), columns)
        upper = (j >> level) << level
        lower = min(upper + (1 << level), rows)
        t_x = ((right if d_x > 0.0 else left) + origin_x - x) * per_x if per_x != _FAR else _FAR
        t_y = ((lower if d_y > 0.0 else upper) + origin_y - y) * per_y if per_y != _FAR else _FAR
        t_out = max(min(min(t_x, t_y), limit), t)
        z_in, z_out = z + t * d_z, z + t_out * d_z
        most = np.float64(maxima[levels[level, 0] + (j >> level) * levels[level, 2] + (i >> level)])
        if min(z_in, z_out) <= most:
            if level > 0:
                level -= 1
                continue
            h00, h10, h01, h11 = corners_of(height, j, i)
            if t_out == _FAR:
                # Straight down: to below the lowest corner.
                t_out = max((min(min(h00, h10), min(h01, h11)) - 1.0 - z) / d_z, t)
                z_out = z + t_out * d_z
            at_x, at_y = origin_x + i - x, origin_y + j - y
            a, b = in_unit(t * d_x - at_x), in_unit(t * d_y - at_y)
            c, d = in_unit(t_out * d_x - at_x), in_unit(t_out * d_y - at_y)
            above = max(z_in - height_in_cell(h00, h10, h01, h11, a, b), 0.0)
            t_from, side, other = t, a - b, c - d
            if side * other < 0.0:
                # Both triangles: first as far as the diagonal.
                t_mid = t + (t_out - t) * (side / (side - other))
                m = in_unit(t_mid * d_x - at_x)
                above_mid = z + t_mid * d_z - (h00 + m * (h11 - h00))
                if above_mid < 0.0:
                    t = t + (t_mid - t) * (above / (above - above_mid))
                    across, down = gradient_of(h00, h10, h01, h11, side)
                    return t, x + t * d_x, y + t * d_y, across, down
                t_from, above, side = t_mid, above_mid, other
            above_out = z_out - height_in_cell(h00, h10, h01, h11, c, d)
            if above_out < 0.0:
                if side == 0.0:
                    side = other
                t = t_from + (t_out - t_from) * (above / (above - above_out))
                across, down = gradient_of(h00, h10, h01, h11, side)
                return t, x + t * d_x, y + t * d_y, across, down
        t = t_out
        if t >= limit:
            break
        if t_x <= t_y:
            j = min(max(np.int64(math.floor(y + t * d_y - origin_y)), upper), lower - 1)
            i, origin_x, leaves = next_cell(i, left, right, d_x > 0.0, columns, origin_x, level)
        else:
            i = min(max(np.int64(math.floor(x + t * d_x - origin_x)), left), right - 1)
            j, origin_y, leaves = next_cell(j, upper, lower, d_y > 0.0, rows, origin_y, level)
        if level < last and leaves:
            level += 1
    return -1.0, 0.0, 0.0, 0.0, 0.0


@kernel
def meet_rows(height, maxima, levels, origin, direction, out):
    """Write what ``meet`` finds for n rays, origins and directions (n, 3), into ``out`` (n, 5)."""
    for n in range(out.shape[0]):
        found = meet(
            height, maxima, levels, origin[n, 0], origin[n, 1], origin[n, 2], direction[n, 0], direction[n, 1],
            direction[n, 2],
        )  # fmt: skip
        for k in range(5):
            out[n, k] = found[k]
