"""Compiled loops of the renderer: one shading loop, specialised for lobe and terms, under drivers compiled once.

Physics and sources as in ``models/microfacet.py``. Samples of one footprint stand side by side in a block, one row a
quantity, so that the loop over them vectorises; all lights and all pixels that share the footprint use the same block.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel, types
from brdffit.halfangle.frame import eigen_log
from brdffit.halfangle.patch import hash_of, wrapped
from brdffit.models.microfacet import LEAST_REFLECTANCE, fifth_power, reflect

real = np.float32

# Terms; bound anew where some are off, and the branches fall away.
LOBE = True
MASKING = True
FRESNEL = True
DIFFUSE = True
COSINE = True

# Rows of a block of samples: normal; inverse tensor; tensor; K(shape) / (pi sqrt det), shape; filter weight, the same
# times the fading of Fresnel's rim, that fading; weight times specular, weight times diffuse under the specular;
# 1 / (pi sqrt det).
NORMAL, INVERSE, TENSOR, AMPLITUDE, SHAPE, RIM_WEIGHT, RIM, SPECULAR, MATT, DENSITY = (
    0, 3, 6, 9, 10, 11, 12, 13, 16, 19,
)  # fmt: skip
BLOCK_ROWS = 20
BLOCK = 512

# Channels of a packed texel; a cache line holds it.
P_NORMAL, P_ROUGHNESS, P_SPECULAR, P_DIFFUSE, P_SHAPE = 0, 3, 6, 9, 12
PACKED = 16

# How ROUGHNESS is stored: perceptual in its first channel, (a, b, c) of the log tensor, or (XX, YY, XY) in alpha^2.
PERCEPTUAL, LOG_TENSOR, PLAIN_TENSOR = 0, 1, 2

#: What shades: (block, count, view, light, sums); view and light are unit vectors (3,), sums (3,) is added to.
shade_type = types.FunctionType(
    types.void(types.float32[:, ::1], types.int64, types.float64[::1], types.float64[::1], types.float64[::1])
)
log_normalisation_type = types.FunctionType(types.UniTuple(types.float64, 2)(types.float64))


@kernel
def shade_block(block, count, view, light, sums):
    """Add to ``sums`` (3,) what the first ``count`` samples of a block send to ``view`` from a light of irradiance 1.

    Lobe x masking x Fresnel x cosine + diffuse x Fresnel's rest x cosine, see ``models.microfacet``.
    """
    v_x, v_y, v_z = real(view[0]), real(view[1]), real(view[2])
    l_x, l_y, l_z = real(light[0]), real(light[1]), real(light[2])
    m_x, m_y, m_z = light[0] + view[0], light[1] + view[1], light[2] + view[2]
    length = math.sqrt(m_x * m_x + m_y * m_y + m_z * m_z)
    if length < 1e-6:
        return
    h_x, h_y, h_z = real(m_x / length), real(m_y / length), real(m_z / length)
    # v.h is |l + v| / 2.
    grazing = fifth_power(real(0.5 * length))
    n_x, n_y, n_z = block[NORMAL], block[NORMAL + 1], block[NORMAL + 2]
    i_xx, i_yy, i_xy = block[INVERSE], block[INVERSE + 1], block[INVERSE + 2]
    t_xx, t_yy, t_xy = block[TENSOR], block[TENSOR + 1], block[TENSOR + 2]
    amplitude, shape, rim_weight, rim = block[AMPLITUDE], block[SHAPE], block[RIM_WEIGHT], block[RIM]
    s_r, s_g, s_b = block[SPECULAR], block[SPECULAR + 1], block[SPECULAR + 2]
    d_r, d_g, d_b = block[MATT], block[MATT + 1], block[MATT + 2]
    red, green, blue, peak = real(0.0), real(0.0), real(0.0), real(0.0)
    matt_red, matt_green, matt_blue = real(0.0), real(0.0), real(0.0)
    # From 0 on: an index that might be negative would keep the loop from being vectorised.
    for i in range(count):
        lobe, cosine = reflect(
            n_x[i], n_y[i], n_z[i], i_xx[i], i_yy[i], i_xy[i], t_xx[i], t_yy[i], t_xy[i], amplitude[i], shape[i],
            h_x, h_y, h_z, l_x, l_y, l_z, v_x, v_y, v_z,
        )  # fmt: skip
        if LOBE:
            if FRESNEL:
                peak += lobe * rim_weight[i]
                lobe -= lobe * grazing * rim[i]
            red += lobe * s_r[i]
            green += lobe * s_g[i]
            blue += lobe * s_b[i]
        if DIFFUSE:
            matt = cosine
            if FRESNEL:
                n_l = l_x * n_x[i] + l_y * n_y[i] + l_z * n_z[i]
                n_v = v_x * n_x[i] + v_y * n_y[i] + v_z * n_z[i]
                matt *= (real(1.0) - fifth_power(n_l) * rim[i]) * (real(1.0) - fifth_power(n_v) * rim[i])
            matt_red += matt * d_r[i]
            matt_green += matt * d_g[i]
            matt_blue += matt * d_b[i]
    total = 0.0
    if FRESNEL:
        total = grazing * peak
    sums[0] += total + red + matt_red * (1.0 / math.pi)
    sums[1] += total + green + matt_green * (1.0 / math.pi)
    sums[2] += total + blue + matt_blue * (1.0 / math.pi)


@inline
def look_up(packed, level, column, row, tile, scale, out, i):
    """Add to ``out[i]`` (PACKED,) ``scale`` times the bilinear value at a position in texels (texel k at k + 1/2).

    ``packed`` (N, PACKED) holds images row by row; ``level`` (3,) says where one begins, its height and its width.
    """
    x, y = column - 0.5, row - 0.5
    x0, y0 = math.floor(x), math.floor(y)
    fx, fy = x - x0, y - y0
    begin, height, width = level[0], level[1], level[2]
    i0, i1 = wrapped(int(x0), width, tile), wrapped(int(x0) + 1, width, tile)
    j0, j1 = wrapped(int(y0), height, tile), wrapped(int(y0) + 1, height, tile)
    w00, w10 = real(scale * (1.0 - fx) * (1.0 - fy)), real(scale * fx * (1.0 - fy))
    w01, w11 = real(scale * (1.0 - fx) * fy), real(scale * fx * fy)
    upper, lower = begin + j0 * width, begin + j1 * width
    a, b, c, d = upper + i0, upper + i1, lower + i0, lower + i1
    # Indexed, not sliced: a slice counts references, and threads would queue for the counter.
    for k in range(PACKED):
        out[i, k] += w00 * packed[a, k] + w10 * packed[b, k] + w01 * packed[c, k] + w11 * packed[d, k]


@kernel
def place_samples(texels, count, roughness_kind, widen, weight, normalisation, block):
    """Write interpolated texels (count, PACKED) into the columns of a block: unit normals, tensors with their inverses.

    ``weight`` and ``normalisation`` (count,) are of the filter and of the lobe. ``widen`` is added to alpha^2 along
    every axis: what the size of a light does to a lobe. Tensors are inverted in double precision, by their eigenvalues
    where the logarithm is stored.
    """
    for i in range(count):
        x, y, z = texels[i, 0], texels[i, 1], texels[i, 2]
        length = np.sqrt(x * x + y * y + z * z)
        some = length > real(1e-6)
        per = real(1.0) / (length if some else real(1.0))
        block[NORMAL, i] = x * per if some else real(0.0)
        block[NORMAL + 1, i] = y * per if some else real(0.0)
        block[NORMAL + 2, i] = z * per if some else real(1.0)
        block[SHAPE, i] = texels[i, P_SHAPE]
        r, g, b, w = texels[i, P_SPECULAR], texels[i, P_SPECULAR + 1], texels[i, P_SPECULAR + 2], real(weight[i])
        rim = min(max(r, max(g, b)) * real(1.0 / LEAST_REFLECTANCE), real(1.0))
        block[RIM, i] = rim
        block[RIM_WEIGHT, i] = w * rim
        block[SPECULAR, i], block[SPECULAR + 1, i], block[SPECULAR + 2, i] = w * r, w * g, w * b
        block[MATT, i] = w * texels[i, P_DIFFUSE] * max(real(1.0) - r, real(0.0))
        block[MATT + 1, i] = w * texels[i, P_DIFFUSE + 1] * max(real(1.0) - g, real(0.0))
        block[MATT + 2, i] = w * texels[i, P_DIFFUSE + 2] * max(real(1.0) - b, real(0.0))
    if roughness_kind == PERCEPTUAL:
        for i in range(count):
            alpha = texels[i, P_ROUGHNESS] * texels[i, P_ROUGHNESS]
            square = alpha * alpha + real(widen)
            inverse = real(1.0) / square
            block[INVERSE, i], block[INVERSE + 1, i], block[INVERSE + 2, i] = inverse, inverse, real(0.0)
            block[TENSOR, i], block[TENSOR + 1, i], block[TENSOR + 2, i] = square, square, real(0.0)
            block[DENSITY, i] = real(1.0 / math.pi) * inverse
            block[AMPLITUDE, i] = real(normalisation[i] / math.pi) * inverse
        return
    for i in range(count):
        a, b, c = float(texels[i, P_ROUGHNESS]), float(texels[i, P_ROUGHNESS + 1]), float(texels[i, P_ROUGHNESS + 2])
        if roughness_kind == LOG_TENSOR:
            l1, l2, cos, sin = eigen_log(a, b, c)
            e1, e2 = math.exp(l1) + widen, math.exp(l2) + widen
            root = math.sqrt(e1 * e2)
            xx, yy, xy = cos * cos * e1 + sin * sin * e2, sin * sin * e1 + cos * cos * e2, cos * sin * (e1 - e2)
            e1, e2 = 1.0 / e1, 1.0 / e2
            ixx, iyy, ixy = cos * cos * e1 + sin * sin * e2, sin * sin * e1 + cos * cos * e2, cos * sin * (e1 - e2)
        else:
            # Rounding of the stored entries can make a very eccentric tensor indefinite.
            a, b = a + widen, b + widen
            determinant = max(a * b - c * c, max(1e-12 * a * b, 1e-30))
            root = math.sqrt(determinant)
            xx, yy, xy = a, b, c
            ixx, iyy, ixy = b / determinant, a / determinant, -c / determinant
        block[INVERSE, i], block[INVERSE + 1, i], block[INVERSE + 2, i] = ixx, iyy, ixy
        block[TENSOR, i], block[TENSOR + 1, i], block[TENSOR + 2, i] = xx, yy, xy
        block[DENSITY, i] = 1.0 / (math.pi * root)
        block[AMPLITUDE, i] = normalisation[i] / (math.pi * root)


@kernel
def fill_block(packed, level, roughness_kind, has_shape, tile, footprint, strata_x, strata_y, weight_x, weight_y,
               first, last, half, key, widen, log_normalisation, scratch, block):  # fmt: skip
    """Fill columns 0 ... last - first - 1 of a block with one sample for each stratum first ... last - 1.

    ``footprint`` (6,): centre, axes row by row. ``strata_x`` and ``strata_y`` are lower ends of the strata in pixels
    from the centre, one more than there are strata. The sample is jittered in its stratum by a hash of ``key``, the
    stratum and ``half``.
    """
    across = strata_x.size - 1
    texels, weight, normalisation = scratch
    texels[:] = real(0.0)
    usual = math.exp(log_normalisation(float(packed[0, P_SHAPE]))[0])
    for number in range(first, last):
        row = number // across
        column = number - row * across
        bits = hash_of(key, row, column, half)
        low, high = (bits & np.uint32(0xFFFF)) + 0.5, (bits >> np.uint32(16)) + 0.5
        x = strata_x[column] + (strata_x[column + 1] - strata_x[column]) * (low / 65536.0)
        y = strata_y[row] + (strata_y[row + 1] - strata_y[row]) * (high / 65536.0)
        u = footprint[0] + footprint[2] * x + footprint[3] * y
        v = footprint[1] + footprint[4] * x + footprint[5] * y
        i = number - first
        look_up(packed, level, u, v, tile, 1.0, texels, i)
        weight[i] = weight_x[column] * weight_y[row]
        normalisation[i] = usual
        if has_shape:
            normalisation[i] = math.exp(log_normalisation(float(texels[i, P_SHAPE]))[0])
    place_samples(texels, last - first, roughness_kind, widen, weight, normalisation, block)


@inline
def make_scratch(columns):
    """Texels, weights and normalisations of this many samples."""
    return np.empty((columns, PACKED), np.float32), np.empty(columns), np.empty(columns)


@kernel
def reference_rows(packed, level, roughness_kind, has_shape, tile, footprints, starts, keys, view, frame, light,
                   irradiance, widen, strata_x, strata_y, weight_x, weight_y, half, out, log_normalisation,
                   shade):  # fmt: skip
    """Radiance of the pixels of some footprints: those of footprint g are starts[g] ... starts[g + 1] - 1.

    ``footprints`` (G, 6): centre, axes row by row. ``view`` (P, 3), ``frame`` (P, 3, 3), ``out`` (P, 3) float64.
    ``widen``: see ``place_samples``.
    """
    block = np.empty((BLOCK_ROWS, BLOCK), np.float32)
    scratch = make_scratch(BLOCK)
    v, towards, sums = np.empty(3), np.empty(3), np.empty(3)
    samples = (strata_x.size - 1) * (strata_y.size - 1)
    for g in range(starts.size - 1):
        for first in range(0, samples, BLOCK):
            last = min(first + BLOCK, samples)
            fill_block(
                packed, level, roughness_kind, has_shape, tile, footprints[g], strata_x, strata_y, weight_x,
                weight_y, first, last, half, keys[g], widen, log_normalisation, scratch, block,
            )  # fmt: skip
            for p in range(starts[g], starts[g + 1]):
                for k in range(3):
                    v[k] = view[p, k]
                light_pixel(block, last - first, v, frame[p], light, irradiance, towards, sums, out[p], shade)


@kernel
def light_pixel(block, count, v, frame, light, irradiance, towards, sums, out, shade):
    """Add to ``out`` (3,) what ``count`` samples reflect of all lights above the surface's own horizon."""
    for n in range(light.shape[0]):
        for k in range(3):
            towards[k] = frame[k, 0] * light[n, 0] + frame[k, 1] * light[n, 1] + frame[k, 2] * light[n, 2]
        if towards[2] <= 0.0:
            continue
        sums[:] = 0.0
        shade(block, count, v, towards, sums)
        for k in range(3):
            out[k] += irradiance[n, k] * sums[k]


@kernel
def sample_pyramid(packed, levels, tile, centre, base_size, detail, widen, log_normalisation, scratch, block):
    """Write the trilinear value of a pyramid at ``centre`` (2,) in base texels into column 0 of a block.

    ``levels`` (L, 3): of each level, see ``look_up``; ``base_size``: (width, height); ``detail``: continuous level.
    """
    top = levels.shape[0] - 1
    clamped = min(max(detail, 0.0), float(top))
    fine = int(clamped)
    part = clamped - fine
    texels, weight, normalisation = scratch
    texels[:] = real(0.0)
    for k in range(2):
        scale = 1.0 - part if k == 0 else part
        if scale > 0.0:
            level = levels[fine + k]
            column, row = centre[0] * level[2] / base_size[0], centre[1] * level[1] / base_size[1]
            look_up(packed, level, column, row, tile, scale, texels, 0)
    weight[0], normalisation[0] = 1.0, math.exp(log_normalisation(float(texels[0, P_SHAPE]))[0])
    place_samples(texels, 1, PLAIN_TENSOR, widen, weight, normalisation, block)


@kernel
def pyramid_rows(packed, levels, tile, centre, base_size, detail, view, frame, light, irradiance, widen, out,
                 log_normalisation, shade):  # fmt: skip
    """Radiance of pixels shaded once, each with the trilinear value of a pyramid. Arrays as in ``reference_rows``."""
    block, scratch = np.empty((BLOCK_ROWS, 1), np.float32), make_scratch(1)
    v, towards, sums = np.empty(3), np.empty(3), np.empty(3)
    for p in range(out.shape[0]):
        sample_pyramid(packed, levels, tile, centre[p], base_size, detail[p], widen, log_normalisation, scratch, block)
        for k in range(3):
            v[k] = view[p, k]
        light_pixel(block, 1, v, frame[p], light, irradiance, towards, sums, out[p], shade)


@kernel
def pair_rows(packed, level, roughness_kind, has_shape, tile, footprints, keys, view, light, weight, strata_x, strata_y,
              weight_x, weight_y, lobes, error, square, log_normalisation, shade, other_shade):  # fmt: skip
    """Errors of lobes at n footprints over Q pairs of directions; all float64 but ``packed`` and ``lobes``.

    ``view`` and ``light`` (n, Q, 3), ``weight`` (n, Q); ``lobes`` (n, M, BLOCK_ROWS, 1): of each footprint
    the M methods' lobes, shaded by ``other_shade``. Writes the weighted sums of (M - A)(M - B) into ``error``
    (M, n) and of A B into ``square`` (n,), A and B the two independent halves of the truth.
    """
    block = np.empty((BLOCK_ROWS, BLOCK), np.float32)
    scratch, sums = make_scratch(BLOCK), np.empty(3)
    pairs = view.shape[1]
    truth = np.empty((2, pairs, 3))
    samples = (strata_x.size - 1) * (strata_y.size - 1)
    for g in range(keys.size):
        truth[:] = 0.0
        for half in range(2):
            for first in range(0, samples, BLOCK):
                last = min(first + BLOCK, samples)
                fill_block(
                    packed, level, roughness_kind, has_shape, tile, footprints[g], strata_x, strata_y, weight_x,
                    weight_y, first, last, half, keys[g], 0.0, log_normalisation, scratch, block,
                )  # fmt: skip
                for pair in range(pairs):
                    shade(block, last - first, view[g, pair], light[g, pair], truth[half, pair])
        square[g] = 0.0
        for pair in range(pairs):
            for k in range(3):
                square[g] += weight[g, pair] * truth[0, pair, k] * truth[1, pair, k]
        for m in range(error.shape[0]):
            error[m, g] = 0.0
            for pair in range(pairs):
                sums[:] = 0.0
                other_shade(lobes[g, m], 1, view[g, pair], light[g, pair], sums)
                for k in range(3):
                    error[m, g] += weight[g, pair] * (sums[k] - truth[0, pair, k]) * (sums[k] - truth[1, pair, k])
