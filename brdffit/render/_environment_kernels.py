"""Compiled loops of light that has a size, an environment or lamps: lobe and light are sampled together.

Each sample of a footprint is paired with two directions, one drawn from the light (density p_e) and one from the lobe
(density p_l = D(h) (n.h) / (4 v.h)), and each counts f L / (p_e + p_l), the balance heuristic (Veach and Guibas 1995).
The lobe that is drawn from is GGX for every model: its tails are the longest. Directions below the plane of the texture
carry no light, as with directional lights and in the half-angle density. The diffuse part needs no directions: its
integral over an environment is a smooth function of the normal, taken from nine spherical harmonics, and lamps light it
from their middle.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel, types
from brdffit.halfangle.patch import hash_of
from brdffit.models.microfacet import fifth_power, reflect
from brdffit.render._kernels import (
    AMPLITUDE,
    BLOCK,
    BLOCK_ROWS,
    DENSITY,
    INVERSE,
    MATT,
    NORMAL,
    RIM,
    RIM_WEIGHT,
    SHAPE,
    SPECULAR,
    TENSOR,
    fill_block,
    make_scratch,
    sample_pyramid,
)

real = np.float32

# Terms; bound anew where some are off.
LOBE = True
MASKING = True
FRESNEL = True
DIFFUSE = True
COSINE = True

# Rows of the table of samples: r cos f and r sin f in a lobe's frame; direction, radiance and density p_e of a light.
ALONG, ACROSS, LIGHT_X, LIGHT_Y, LIGHT_Z, LIGHT_RED, LIGHT_GREEN, LIGHT_BLUE, LIGHT_DENSITY = range(9)
TABLE_ROWS = 9

# Rows of a block of directions in tangent space: the direction, its radiance, p_e.
TO_X, TO_Y, TO_Z, RED, GREEN, BLUE, CHANCE = range(7)
DIRECTION_ROWS = 7

#: What shades: (block, count, view, directions, sums), and (block, count, view, frame, harmonics, which, sums) for
#: diffuse; and what fills in the light of directions: (directions, count, frame, light).
shade_directions_type = types.FunctionType(
    types.void(types.float32[:, ::1], types.int64, types.float64[::1], types.float32[:, ::1], types.float64[::1])
)
shade_matt_type = types.FunctionType(
    types.void(
        types.float32[:, ::1], types.int64, types.float64[::1], types.float64[:, ::1], types.float32[:, :, :, ::1],
        types.int64, types.float64[::1],
    )
)  # fmt: skip
look_around_type = types.FunctionType(
    types.void(types.float32[:, ::1], types.int64, types.float64[:, ::1], types.float32[:, :, ::1])
)


@kernel
def shade_directions(block, count, view, directions, sums):
    """Add to ``sums`` (3,) what ``count`` samples reflect from their own directions, over the density p_e + p_l."""
    if not LOBE:
        return
    v_x, v_y, v_z = real(view[0]), real(view[1]), real(view[2])
    to_x, to_y, to_z, chance = directions[TO_X], directions[TO_Y], directions[TO_Z], directions[CHANCE]
    r, g, b = directions[RED], directions[GREEN], directions[BLUE]
    n_x, n_y, n_z = block[NORMAL], block[NORMAL + 1], block[NORMAL + 2]
    i_xx, i_yy, i_xy = block[INVERSE], block[INVERSE + 1], block[INVERSE + 2]
    t_xx, t_yy, t_xy = block[TENSOR], block[TENSOR + 1], block[TENSOR + 2]
    amplitude, shape, rim_weight, rim = block[AMPLITUDE], block[SHAPE], block[RIM_WEIGHT], block[RIM]
    s_r, s_g, s_b, density = block[SPECULAR], block[SPECULAR + 1], block[SPECULAR + 2], block[DENSITY]
    red, green, blue = real(0.0), real(0.0), real(0.0)
    for i in range(count):
        l_x, l_y, l_z = to_x[i], to_y[i], to_z[i]
        h_x, h_y, h_z = l_x + v_x, l_y + v_y, l_z + v_z
        square = h_x * h_x + h_y * h_y + h_z * h_z
        per = real(1.0) / np.sqrt(max(square, real(1e-12)))
        x, y, z = n_x[i], n_y[i], n_z[i]
        # Light from straight behind has no half vector, and nothing is reflected; (0, 0, 0) would divide 0 by 0.
        some = square > real(1e-8)
        h_x, h_y, h_z = h_x * per if some else x, h_y * per if some else y, h_z * per if some else z
        lobe, _ = reflect(
            x, y, z, i_xx[i], i_yy[i], i_xy[i], t_xx[i], t_yy[i], t_xy[i], amplitude[i], shape[i],
            h_x, h_y, h_z, l_x, l_y, l_z, v_x, v_y, v_z,
        )  # fmt: skip
        along = h_x * x + h_y * y
        k = along / max(real(1.0) + z, real(1e-6)) + h_z
        a, c, n_h = h_x - k * x, h_y - k * y, along + h_z * z
        q = max(a * (i_xx[i] * a + real(2.0) * i_xy[i] * c) + i_yy[i] * c * c, real(0.0)) + n_h * n_h
        # v.h is |l + v| / 2.
        v_h = max(real(0.5) * square * per, real(1e-6))
        drawn = density[i] * max(n_h, real(0.0)) / (q * q * real(4.0) * v_h)
        lobe = lobe / max(chance[i] + drawn, real(1e-20)) if l_z > real(0.0) else real(0.0)
        if FRESNEL:
            grazing = lobe * fifth_power(v_h)
            lobe -= grazing * rim[i]
            grazing *= rim_weight[i]
            red += r[i] * grazing
            green += g[i] * grazing
            blue += b[i] * grazing
        red += r[i] * lobe * s_r[i]
        green += g[i] * lobe * s_g[i]
        blue += b[i] * lobe * s_b[i]
    sums[0] += red
    sums[1] += green
    sums[2] += blue


@inline
def harmonic(c, k, x, y, z):
    """A quadratic function on the sphere of coefficients c[0 ... 8, k]."""
    value = c[0, k] + c[1, k] * x + c[2, k] * y + c[3, k] * z + c[4, k] * x * y + c[5, k] * y * z + c[6, k] * x * z
    return value + c[7, k] * (x * x - y * y) + c[8, k] * (real(3.0) * z * z - real(1.0))


@kernel
def shade_matt(block, count, view, frame, harmonics, which, sums):
    """Add to ``sums`` (3,) the diffuse part of ``count`` samples under the surroundings, of ``harmonics`` (K, 2, 9, 3).

    diffuse (1 - specular) (1 - w(n.v)) (E - E_w): E is the irradiance over pi, and E_w the same weighted with Schlick's
    w(n.l).
    """
    if not DIFFUSE:
        return
    v_x, v_y, v_z = real(view[0]), real(view[1]), real(view[2])
    n_x, n_y, n_z, rim = block[NORMAL], block[NORMAL + 1], block[NORMAL + 2], block[RIM]
    e, e_w = harmonics[which, 0], harmonics[which, 1]
    f00, f01, f02 = real(frame[0, 0]), real(frame[0, 1]), real(frame[0, 2])
    f10, f11, f12 = real(frame[1, 0]), real(frame[1, 1]), real(frame[1, 2])
    f20, f21, f22 = real(frame[2, 0]), real(frame[2, 1]), real(frame[2, 2])
    for k in range(3):
        total = real(0.0)
        colour = block[MATT + k]
        for i in range(count):
            x, y, z = n_x[i], n_y[i], n_z[i]
            n_v = v_x * x + v_y * y + v_z * z
            w_x, w_y, w_z = x * f00 + y * f10 + z * f20, x * f01 + y * f11 + z * f21, x * f02 + y * f12 + z * f22
            light = harmonic(e, k, w_x, w_y, w_z)
            if FRESNEL:
                light -= rim[i] * harmonic(e_w, k, w_x, w_y, w_z)
                light *= real(1.0) - rim[i] * fifth_power(n_v)
            light = max(light, real(0.0))
            total += light * colour[i]
        sums[k] += total


@inline
def arc_tangent(t):
    """atan t for |t| <= 1 to 1e-5: an odd polynomial of degree 11."""
    s = t * t
    p = real(0.05265332) - s * real(0.01172120)
    p = real(-0.11643287) + s * p
    p = real(0.19354346) + s * p
    p = real(-0.33262347) + s * p
    return t * (real(0.99997726) + s * p)


@inline
def arc_tangent_of(y, x):
    """atan2(y, x)."""
    a, b = abs(x), abs(y)
    angle = arc_tangent(min(a, b) / max(max(a, b), real(1e-20)))
    angle = real(0.5 * math.pi) - angle if b > a else angle
    angle = real(math.pi) - angle if x < real(0.0) else angle
    return -angle if y < real(0.0) else angle


@kernel
def directions_of_lights(table, first, count, frame, directions):
    """Fill ``directions`` with ``count`` lights of the table, carried into tangent space."""
    for i in range(count):
        x, y, z = table[LIGHT_X, first + i], table[LIGHT_Y, first + i], table[LIGHT_Z, first + i]
        for k in range(3):
            directions[TO_X + k, i] = frame[k, 0] * x + frame[k, 1] * y + frame[k, 2] * z
            directions[RED + k, i] = table[LIGHT_RED + k, first + i]
        directions[CHANCE, i] = table[LIGHT_DENSITY, first + i]


@kernel
def directions_of_lobes(block, table, first, count, view, directions):
    """Fill ``directions`` with one direction drawn from each lobe, but for its light.

    Slopes are L (r cos f, r sin f) with L L' = Sigma, r^2 = u / (1 - u); h along (slope, 1) in the frame of n.
    """
    v_x, v_y, v_z = real(view[0]), real(view[1]), real(view[2])
    for i in range(count):
        x, y, z = block[NORMAL, i], block[NORMAL + 1, i], block[NORMAL + 2, i]
        xx, xy = block[TENSOR, i], block[TENSOR + 2, i]
        # det Sigma from its square root, which was taken in double precision.
        root = real(1.0 / math.pi) / block[DENSITY, i]
        l_11 = np.sqrt(xx)
        a, b = table[ALONG, first + i], table[ACROSS, first + i]
        s, t = l_11 * a, xy / l_11 * a + root / l_11 * b
        per = real(1.0) / max(real(1.0) + z, real(1e-6))
        h_x = s * (real(1.0) - x * x * per) - t * x * y * per + x
        h_y = -s * x * y * per + t * (real(1.0) - y * y * per) + y
        h_z = -s * x - t * y + z
        twice = real(2.0) * (h_x * v_x + h_y * v_y + h_z * v_z) / (h_x * h_x + h_y * h_y + h_z * h_z)
        directions[TO_X, i] = twice * h_x - v_x
        directions[TO_Y, i] = twice * h_y - v_y
        directions[TO_Z, i] = twice * h_z - v_z


@kernel
def light_of_picture(directions, count, frame, picture):
    """Fill in the light of directions from an equirectangular ``picture`` (H, W, 4): radiance and p_e."""
    height, width = picture.shape[0], picture.shape[1]
    for i in range(count):
        x, y, z = directions[TO_X, i], directions[TO_Y, i], directions[TO_Z, i]
        w_x = real(frame[0, 0]) * x + real(frame[1, 0]) * y + real(frame[2, 0]) * z
        w_y = real(frame[0, 1]) * x + real(frame[1, 1]) * y + real(frame[2, 1]) * z
        w_z = real(frame[0, 2]) * x + real(frame[1, 2]) * y + real(frame[2, 2]) * z
        elevation = arc_tangent_of(w_y, np.sqrt(w_x * w_x + w_z * w_z))
        azimuth = arc_tangent_of(w_x, -w_z)
        row = int((real(0.5) - elevation * real(1.0 / math.pi)) * real(height))
        column = int((real(0.5) + azimuth * real(0.5 / math.pi)) * real(width))
        row, column = min(max(row, 0), height - 1), min(max(column, 0), width - 1)
        for k in range(3):
            directions[RED + k, i] = picture[row, column, k]
        directions[CHANCE, i] = picture[row, column, 3]


@kernel
def light_of_lamps(directions, count, frame, lamps):
    """Fill in the light of directions from ``lamps`` (n, 2, 4): middle and squared chord of its radius; radiance, p_e.

    A direction d lies in the disc of angular radius r about c where |d - c| < 2 sin(r / 2); that is precise for small
    discs, where cosines are all 1.
    """
    for k in range(RED, DIRECTION_ROWS):
        for i in range(count):
            directions[k, i] = real(0.0)
    for n in range(lamps.shape[0]):
        c_x, c_y, c_z = lamps[n, 0, 0], lamps[n, 0, 1], lamps[n, 0, 2]
        x = real(frame[0, 0]) * c_x + real(frame[0, 1]) * c_y + real(frame[0, 2]) * c_z
        y = real(frame[1, 0]) * c_x + real(frame[1, 1]) * c_y + real(frame[1, 2]) * c_z
        z = real(frame[2, 0]) * c_x + real(frame[2, 1]) * c_y + real(frame[2, 2]) * c_z
        most = lamps[n, 0, 3]
        red, green, blue, chance = lamps[n, 1, 0], lamps[n, 1, 1], lamps[n, 1, 2], lamps[n, 1, 3]
        for i in range(count):
            d_x, d_y, d_z = directions[TO_X, i] - x, directions[TO_Y, i] - y, directions[TO_Z, i] - z
            inside = real(1.0) if d_x * d_x + d_y * d_y + d_z * d_z < most else real(0.0)
            directions[RED, i] += inside * red
            directions[GREEN, i] += inside * green
            directions[BLUE, i] += inside * blue
            directions[CHANCE, i] += inside * chance


@kernel
def light_from_all_around(block, count, view, frame, table, light, harmonics, which, key, part, directions, out,
                          shade_lobe, shade_diffuse, look_around):  # fmt: skip
    """Add to ``out`` (3,) what ``count`` samples reflect of the light; ``key`` and ``part`` choose where."""
    room = table.shape[1] - BLOCK
    first = int(hash_of(key, part, 17, 1)) % room
    directions_of_lights(table, first, count, frame, directions)
    shade_lobe(block, count, view, directions, out)
    first = int(hash_of(key, part, 29, 2)) % room
    directions_of_lobes(block, table, first, count, view, directions)
    look_around(directions, count, frame, light)
    shade_lobe(block, count, view, directions, out)
    shade_diffuse(block, count, view, frame, harmonics, which, out)


@kernel
def environment_reference_rows(packed, level, roughness_kind, has_shape, tile, footprints, starts, keys, pixel_keys,
                               which, view, frame, table, light, harmonics, strata_x, strata_y, weight_x, weight_y,
                               half, out, log_normalisation, shade_lobe, shade_diffuse, look_around):  # fmt: skip
    """As ``reference_rows``, lit by what has a size.

    ``pixel_keys`` (P,) choose each pixel's directions, ``which`` (P,) its harmonics; for ``light`` see ``look_around``.
    """
    block, scratch = np.empty((BLOCK_ROWS, BLOCK), np.float32), make_scratch(BLOCK)
    directions = np.empty((DIRECTION_ROWS, BLOCK), np.float32)
    samples = (strata_x.size - 1) * (strata_y.size - 1)
    for g in range(starts.size - 1):
        for first in range(0, samples, BLOCK):
            last = min(first + BLOCK, samples)
            fill_block(
                packed, level, roughness_kind, has_shape, tile, footprints[g], strata_x, strata_y, weight_x,
                weight_y, first, last, half, keys[g], 0.0, log_normalisation, scratch, block,
            )  # fmt: skip
            for p in range(starts[g], starts[g + 1]):
                light_from_all_around(
                    block, last - first, view[p], frame[p], table, light, harmonics, which[p], pixel_keys[p],
                    2 * (first // BLOCK) + half, directions, out[p], shade_lobe, shade_diffuse, look_around,
                )  # fmt: skip


@kernel
def environment_pyramid_rows(packed, levels, tile, centre, base_size, detail, pixel_keys, which, view, frame, table,
                             light, harmonics, count, part, out, log_normalisation, shade_lobe, shade_diffuse,
                             look_around):  # fmt: skip
    """As ``pyramid_rows``, lit by what has a size: each pixel's lobe under ``count`` directions of either kind.

    ``count`` is at most ``BLOCK``. Calls of different ``part`` are independent.
    """
    single, scratch = np.empty((BLOCK_ROWS, 1), np.float32), make_scratch(1)
    block = np.empty((BLOCK_ROWS, BLOCK), np.float32)
    directions = np.empty((DIRECTION_ROWS, BLOCK), np.float32)
    share = 1.0 / count
    for p in range(out.shape[0]):
        sample_pyramid(packed, levels, tile, centre[p], base_size, detail[p], 0.0, log_normalisation, scratch, single)
        for row in range(BLOCK_ROWS):
            weighted = row == RIM_WEIGHT or SPECULAR <= row < MATT + 3
            block[row, :count] = single[row, 0] * real(share) if weighted else single[row, 0]
        light_from_all_around(
            block, count, view[p], frame[p], table, light, harmonics, which[p], pixel_keys[p], part, directions,
            out[p], shade_lobe, shade_diffuse, look_around,
        )  # fmt: skip
