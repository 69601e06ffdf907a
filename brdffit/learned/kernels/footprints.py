"""Sums over a footprint, straight from the base: four lobes a base texel, and from there level by level.

Under the box filter a texel of level 0 sees the bilinear reconstruction within its square. It is sampled at a quarter
of a texel from its centre in each direction, where the reconstruction has the weights 3/4 and 1/4 along an axis; the
mean of the four has the weights 1/8, 3/4, 1/8 that the exact filter has, so colours are exact. A texel of the next
level is the mean of four of these: sums are linear. Between texels as a renderer reads them: normals (then brought to
unit length), perceptual roughness (log tensors where the base is anisotropic), colours.

A texel's sums are the moments of ``moments`` times the energy w = r + g + b that a lobe reflects, w itself, the colour,
and sum_i d_ic n_i by (channel, axis) of the diffuse part. They stand in tiles of two rows of 32 columns, (SUMS, PLANE):
eight texels side by side are one vector, a tile fits a core's cache, and four texels make one of the next level's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import inline, kernel
from brdffit.halfangle.patch import wrapped
from brdffit.learned.kernels.moments import MOMENTS, NARROW
from brdffit.nets.doubles import EIGHT, all_of, eight, exponential, greatest, logarithm, put, root
from brdffit.nets.vectors import LANES, halves, load, multiply, multiply_add, store

ENERGY, COLOUR, DIFFUSE = MOMENTS, MOMENTS + 1, MOMENTS + 4
SUMS = MOMENTS + 13
#: Columns that are worked on at once, in two rows: their sums fit a core's cache.
COLUMNS = 32
PLANE = 2 * COLUMNS
#: Channels of the base: normal, roughness or log tensor, specular, diffuse.
CHANNELS = 12
#: Rows of blended channels that two rows of texels need: each a quarter up and a quarter down.
BLENDS = 4
#: What a lobe that reflects nothing weighs, so that normals still mean something.
DARKEST = 1e-9
#: Of each of the four lobes of a texel.
QUARTER = 0.25


@kernel
def part(image, first, stride, width, out, to):
    """out[to + i] = image[first + i * stride], i < width, of flat arrays."""
    for i in range(width):
        out[to + i] = image[first + i * stride]


@kernel
def plain_row(base, row, plain, at, pitch):
    """Write the channels of a row of the base apart, from ``at`` on, ``pitch`` numbers each, column c at c + 1.

    One column before and some after go on beyond the border. Channels that all texels have in common are left out.
    """
    width = base.normal.shape[1]
    for c in range(CHANNELS):
        to, first = at + c * pitch, row * width * 3 + c % 3
        if c < 3:
            part(base.normal.reshape(-1), first, 3, width, plain, to + 1)
        elif c < 6 and not base.isotropic:
            part(base.log_roughness.reshape(-1), first, 3, width, plain, to + 1)
        elif c == 3:
            part(base.perceptual.reshape(-1), row * width, 1, width, plain, to + 1)
        elif 6 <= c < 9:
            part(base.specular.reshape(-1), first, 3, width, plain, to + 1)
        elif c >= 9 and base.has_diffuse:
            part(base.diffuse.reshape(-1), first, 3, width, plain, to + 1)
        else:
            continue
        plain[to] = plain[to + 1 + wrapped(-1, width, base.tile)]
        for i in range(width, pitch - 1):
            plain[to + 1 + i] = plain[to + 1 + wrapped(i, width, base.tile)]


@kernel
def blend_rows(base, row, fresh, plain, blended, pitch):
    """Fill ``blended`` (BLENDS, CHANNELS, pitch) float32, flat, for rows ``row`` and row + 1 of the base.

    Each row is read a quarter up and a quarter down. ``plain``, as large, keeps the four rows that are read: two of
    them need not be read again where the call before was for the two rows above, that is where not ``fresh``.
    """
    height, size = base.normal.shape[0], CHANNELS * pitch
    three, one = np.float32(0.75), np.float32(0.25)
    near, far = halves(three, three), halves(one, one)
    for k in range(0 if fresh else 2, BLENDS):
        slot = (row + k + BLENDS - 1) % BLENDS
        plain_row(base, wrapped(row + k - 1, height, base.tile), plain, slot * size, pitch)
    for k in range(BLENDS):
        own = (row + k // 2) % BLENDS * size
        other = (row + k // 2 + (1 if k % 2 else BLENDS - 1)) % BLENDS * size
        for i in range(0, size, LANES):
            i = min(i, size - LANES)
            store(
                blended, k * size + i, multiply_add(near, load(plain, own + i), multiply(far, load(plain, other + i)))
            )


@inline
def gain(rows, at, k, value, fresh):
    """Add to row k, or begin it where ``fresh``."""
    put(rows, at + k * PLANE, value if fresh else eight(rows, at + k * PLANE) + value)


@inline
def across(blended, at, side):
    """A channel of eight texels, a quarter of a texel to the left or to the right."""
    return 0.75 * eight(blended, at) + 0.25 * eight(blended, at + side)


@inline
def add_lobes(blended, at, pitch, side, isotropic, has_diffuse, rows, to, fresh):
    """Add one of the four lobes of each of eight texels to their sums, or begin them where ``fresh``."""
    x, y, z = across(blended, at, side), across(blended, at + pitch, side), across(blended, at + 2 * pitch, side)
    shrink = 1.0 / root(greatest(x * x + y * y + z * z, 1e-12))
    x, y, z = x * shrink, y * shrink, z * shrink
    red = QUARTER * greatest(across(blended, at + 6 * pitch, side), 0.0)
    green = QUARTER * greatest(across(blended, at + 7 * pitch, side), 0.0)
    blue = QUARTER * greatest(across(blended, at + 8 * pitch, side), 0.0)
    w = greatest(red + green + blue, DARKEST)
    a = across(blended, at + 3 * pitch, side)
    if isotropic:
        a = a * a
        size = greatest(a * a, 1e-12)
        u, s_xx, s_yy, s_xy = logarithm(size), size, size, all_of(0.0)
    else:
        b, c = across(blended, at + 4 * pitch, side), across(blended, at + 5 * pitch, side)
        # exp of a symmetric 2x2: e^u (cosh r I + sinh r / r N), N the part without trace, r its radius.
        u, half = 0.5 * (a + b), 0.5 * (a - b)
        r = root(half * half + c * c)
        up = exponential(r)
        down = 1.0 / up
        even, odd = 0.5 * (up + down), 0.5 * (up - down) / greatest(r, 1e-6)
        size = exponential(u)
        s_xx, s_yy, s_xy = size * (even + odd * half), size * (even - odd * half), size * odd * c
    xx, xy, xz, yy, yz, zz = w * x * x, w * x * y, w * x * z, w * y * y, w * y * z, w * z * z
    p, q, s, t, v = x * x, x * y, y * y, y * z, z * z
    gain(rows, to, 0, xx * x, fresh)
    gain(rows, to, 1, xx * y, fresh)
    gain(rows, to, 2, xx * z, fresh)
    gain(rows, to, 3, xy * y, fresh)
    gain(rows, to, 4, xy * z, fresh)
    gain(rows, to, 5, xz * z, fresh)
    gain(rows, to, 6, yy * y, fresh)
    gain(rows, to, 7, yy * z, fresh)
    gain(rows, to, 8, yz * z, fresh)
    gain(rows, to, 9, zz * z, fresh)
    gain(rows, to, 10, xx * p, fresh)
    gain(rows, to, 11, xx * q, fresh)
    gain(rows, to, 12, xz * p, fresh)
    gain(rows, to, 13, xx * s, fresh)
    gain(rows, to, 14, xx * t, fresh)
    gain(rows, to, 15, xx * v, fresh)
    gain(rows, to, 16, xy * s, fresh)
    gain(rows, to, 17, xy * t, fresh)
    gain(rows, to, 18, xy * v, fresh)
    gain(rows, to, 19, xz * v, fresh)
    gain(rows, to, 20, yy * s, fresh)
    gain(rows, to, 21, yy * t, fresh)
    gain(rows, to, 22, yy * v, fresh)
    gain(rows, to, 23, yz * v, fresh)
    gain(rows, to, 24, zz * v, fresh)
    gain(rows, to, 25, w * s_xx, fresh)
    gain(rows, to, 26, w * s_yy, fresh)
    gain(rows, to, 27, w * s_xy, fresh)
    gain(rows, to, 28, w / size, fresh)
    gain(rows, to, 29, w * u * u, fresh)
    gain(rows, to, 30, w * u * x, fresh)
    gain(rows, to, 31, w * u * y, fresh)
    gain(rows, to, 32, w * u * z, fresh)
    gain(rows, to, 33, u * xx, fresh)
    gain(rows, to, 34, u * xy, fresh)
    gain(rows, to, 35, u * xz, fresh)
    gain(rows, to, 36, u * yy, fresh)
    gain(rows, to, 37, u * yz, fresh)
    gain(rows, to, 38, u * zz, fresh)
    k = greatest(1.0 - NARROW * (p + s), 0.0)
    k = w * k * k
    gain(rows, to, 39, k, fresh)
    gain(rows, to, 40, k * x, fresh)
    gain(rows, to, 41, k * y, fresh)
    gain(rows, to, 42, k * p, fresh)
    gain(rows, to, 43, k * q, fresh)
    gain(rows, to, 44, k * s, fresh)
    gain(rows, to, 45, k * size, fresh)
    gain(rows, to, ENERGY, w, fresh)
    gain(rows, to, COLOUR, red, fresh)
    gain(rows, to, COLOUR + 1, green, fresh)
    gain(rows, to, COLOUR + 2, blue, fresh)
    if has_diffuse:
        for channel in range(3):
            d = QUARTER * across(blended, at + (9 + channel) * pitch, side)
            gain(rows, to, DIFFUSE + 3 * channel, d * x, fresh)
            gain(rows, to, DIFFUSE + 3 * channel + 1, d * y, fresh)
            gain(rows, to, DIFFUSE + 3 * channel + 2, d * z, fresh)


@kernel
def sample_columns(blended, pitch, first, count, isotropic, has_diffuse, rows):
    """Sums (SUMS, PLANE) of ``count`` columns from ``first`` on of two rows of level 0, the second from COLUMNS on."""
    for row in range(2):
        for i in range(0, count, EIGHT):
            to = row * COLUMNS + i
            up = 2 * row * CHANNELS * pitch + 1 + first + i
            down = up + CHANNELS * pitch
            add_lobes(blended, up, pitch, -1, isotropic, has_diffuse, rows, to, True)
            add_lobes(blended, up, pitch, 1, isotropic, has_diffuse, rows, to, False)
            add_lobes(blended, down, pitch, -1, isotropic, has_diffuse, rows, to, False)
            add_lobes(blended, down, pitch, 1, isotropic, has_diffuse, rows, to, False)


@kernel
def pool_columns(tiles, at, count, has_diffuse, pooled, row, column, width):
    """Means of two by two texels of one tile, ``count`` (even) columns, into the tiles of the next level.

    ``row`` and ``column``: of its first texel there; ``width``: of that level.
    """
    tile = (row // 2) * ((width + COLUMNS - 1) // COLUMNS) + column // COLUMNS
    to = tile * SUMS * PLANE + (row % 2) * COLUMNS + column % COLUMNS
    for k in range(SUMS if has_diffuse else DIFFUSE):
        a, b, out = at + k * PLANE, at + k * PLANE + COLUMNS, to + k * PLANE
        for i in range(count // 2):
            pooled[out + i] = 0.25 * (tiles[a + 2 * i] + tiles[a + 2 * i + 1] + tiles[b + 2 * i] + tiles[b + 2 * i + 1])


def empty_tiles(size: tuple[int, int]) -> NDArray:
    """Tiles of a level (height, width), flat: two rows of COLUMNS columns each, (SUMS, PLANE)."""
    height, width = size
    return np.zeros(-(-height // 2) * -(-width // COLUMNS) * SUMS * PLANE)


@kernel
def sum_blocks(base, columns, rows, side, out):
    """Mean sums (n, SUMS) of squares of side x side base texels, 1 or even, that begin at (columns[i], rows[i])."""
    width, pair = base.normal.shape[1], min(2, side)
    pitch = width + 2 + COLUMNS
    blended, sums = np.zeros(BLENDS * CHANNELS * pitch, np.float32), np.zeros(SUMS * PLANE)
    plain = np.zeros_like(blended)
    for i in range(columns.size):
        for k in range(SUMS):
            out[i, k] = 0.0
        for row in range(rows[i], rows[i] + side, 2):
            blend_rows(base, row, True, plain, blended, pitch)
            for first in range(columns[i], columns[i] + side, COLUMNS):
                count = min(COLUMNS, columns[i] + side - first)
                padded = (count + EIGHT - 1) // EIGHT * EIGHT
                sample_columns(blended, pitch, first, padded, base.isotropic, base.has_diffuse, sums)
                for k in range(SUMS):
                    for r in range(pair):
                        for c in range(count):
                            out[i, k] += sums[k * PLANE + r * COLUMNS + c] / (side * side)
