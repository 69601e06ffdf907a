"""What a ray sees of a traced surface: one path a sample, light gathered at each of its points.

A point reflects f(l, v) n.l of a light of irradiance 1 that it sees, and after that what a direction w, drawn with
density p from its own lobe and cosine, brings from the surface itself:

    L(v) = f(l, v) n.l V(l) + E_w[ f(w, v) n.w / p(w)  L(-w) ]

cut off after a number of bounces. BRDF, directions and their density are those of ``models.microfacet``; a texel is
read as the reference of maps reads it (``render._kernels``). What is off costs nothing: without displacement no ray is
traced to find the point (it is the one under the position on the plane), without shadowing none to the light, without
bounces none further.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import kernel
from brdffit.microgeometry.kernels.randomness import about, gaussian_pair, key_of, uniform
from brdffit.microgeometry.kernels.traversal import meet, surface_at
from brdffit.models.microfacet import density_rows, draw_rows
from brdffit.render._kernels import (
    BLOCK_ROWS,
    P_DIFFUSE,
    P_NORMAL,
    P_SHAPE,
    P_SPECULAR,
    TENSOR,
    look_up,
    make_scratch,
    place_samples,
)

real = np.float32

#: Rays along a surface begin so far above it, in texels: more than the rounding of the point that they leave.
_LIFT = 1e-6
#: Dimensions of the random numbers: two of the footprint, two of the light, then so many a bounce.
_PER_BOUNCE = 3


@kernel
def place_point(texels, level, roughness_kind, has_shape, facets, column, row, across, down, v, log_normalisation,
                scratch, block):  # fmt: skip
    """Write what the maps hold at a point of the surface into column 0 of a block of samples.

    ``across`` and ``down`` are the derivatives of the height there, ``v`` (3,) the direction to the viewer. Its normal
    is that of the triangle if ``facets``, or where a normal of maps looks away from a viewer who sees the point.
    """
    found, weight, normalisation = scratch
    found[:] = real(0.0)
    # Vertices stand at texel centres.
    look_up(texels, level, column + 0.5, row + 0.5, True, 1.0, found, 0)
    x, y, z = found[0, P_NORMAL], found[0, P_NORMAL + 1], found[0, P_NORMAL + 2]
    if facets or x * v[0] + y * v[1] + z * v[2] <= 0.0:
        # Rows run down, y up.
        found[0, P_NORMAL], found[0, P_NORMAL + 1], found[0, P_NORMAL + 2] = real(-across), real(down), real(1.0)
    weight[0] = 1.0
    shape = float(found[0, P_SHAPE]) if has_shape else float(texels[0, P_SHAPE])
    normalisation[0] = math.exp(log_normalisation(shape)[0])
    place_samples(found, 1, roughness_kind, 0.0, weight, normalisation, block)


@kernel
def draw_direction(key, dimension, block, texel, v, drawing):
    """The density of a direction drawn at the point of a block, which is left in the last array of ``drawing``.

    ``texel`` (1, 16) holds the point's colours. 0 where nothing is reflected at all.
    """
    normal, tensor, share, view, u, out, density = drawing
    lobe, matt = 0.0, 0.0
    for k in range(3):
        normal[0, k], tensor[0, k], view[0, k] = block[k, 0], block[TENSOR + k, 0], v[k]
        lobe += texel[0, P_SPECULAR + k]
        matt += texel[0, P_DIFFUSE + k]
    if lobe + matt <= 0.0:
        return 0.0
    share[0] = min(max(lobe / (lobe + matt), 0.1 if lobe > 0.0 else 0.0), 0.9 if matt > 0.0 else 1.0)
    # Of the lobe or by the cosine: its own number, so that the direction is drawn from a whole square.
    u[0, 0], u[0, 1] = uniform(key, dimension + 1), uniform(key, dimension + 2)
    u[0, 0] = u[0, 0] * share[0] if uniform(key, dimension) < share[0] else share[0] + u[0, 0] * (1.0 - share[0])
    draw_rows(normal, tensor, share, view, u, out)
    density_rows(normal, tensor, share, view, out, density)
    return density[0]


@kernel
def follow(height, maxima, levels, texels, level, roughness_kind, has_shape, facets, shadowing, bounces, key, column,
           row, level_of, across, down, v, lamp, out, log_normalisation, shade, scratch, block, drawing,
           sums):  # fmt: skip
    """Add to ``out`` (3,) what the path that begins at a point of the surface brings to the viewer.

    ``level_of`` is the point's height; ``v`` and ``lamp`` (3,) directions to viewer and light, ``v`` is overwritten.
    """
    w = drawing[5]
    red, green, blue = 1.0, 1.0, 1.0
    for bounce in range(bounces + 1):
        place_point(
            texels, level, roughness_kind, has_shape, facets, column, row, across, down, v, log_normalisation, scratch,
            block,
        )  # fmt: skip
        sums[:] = 0.0
        shade(block, 1, v, lamp, sums)
        lit = sums[0] + sums[1] + sums[2] > 0.0
        z = level_of + _LIFT
        if lit and shadowing:
            lit = (
                lamp[2] + lamp[1] * down - lamp[0] * across > 0.0
                and meet(height, maxima, levels, column, row, z, lamp[0], -lamp[1], lamp[2])[0] < 0.0
            )
        if lit:
            out[0] += red * sums[0]
            out[1] += green * sums[1]
            out[2] += blue * sums[2]
        if bounce == bounces:
            return
        density = draw_direction(key, 4 + _PER_BOUNCE * bounce, block, scratch[0], v, drawing)
        # Below the surface itself nothing comes from.
        if density <= 0.0 or w[0, 2] + w[0, 1] * down - w[0, 0] * across <= 0.0:
            return
        l_x, l_y, l_z = lamp[0], lamp[1], lamp[2]
        lamp[0], lamp[1], lamp[2] = w[0, 0], w[0, 1], w[0, 2]
        sums[:] = 0.0
        shade(block, 1, v, lamp, sums)
        v[0], v[1], v[2] = -lamp[0], -lamp[1], -lamp[2]
        lamp[0], lamp[1], lamp[2] = l_x, l_y, l_z
        red, green, blue = red * sums[0] / density, green * sums[1] / density, blue * sums[2] / density
        if red + green + blue <= 0.0:
            return
        t, column_met, row_met, across, down = meet(height, maxima, levels, column, row, z, -v[0], v[1], -v[2])
        if t < 0.0:
            return
        level_of = z - t * v[2]
        column, row = column_met % height.shape[1], row_met % height.shape[0]


@kernel
def reflect_rows(height, maxima, levels, texels, level, roughness_kind, has_shape, facets, reference, displacement,
                 shadowing, bounces, cap, position, sigma, light, view, seed, first, out, log_normalisation,
                 shade):  # fmt: skip
    """Write what n points of the plane reflect under a light of irradiance 1 on a surface that faces it, one sample.

    Args:
        height, maxima, levels: see ``traversal``.
        texels, level, roughness_kind, has_shape: the maps, packed.
        reference: height of the plane.
        cap: 1 minus the cosine of half the light's angular diameter.
        position: (n, 2) columns and rows in texels (texel i is centred on i + 1/2); ``sigma`` (n,) standard deviation
            of the Gaussian that they are spread by.
        light, view: (n, 3).
        seed, first: of the random numbers, and the number of the first sample.
        out: (n, 3) float32.
        log_normalisation, shade: kernels of the model, as values of function type (``tracer.reflect_loop``).
    """
    block, scratch, sums = np.empty((BLOCK_ROWS, 1), np.float32), make_scratch(1), np.empty(3)
    drawing = (
        np.empty((1, 3), np.float32), np.empty((1, 3), np.float32), np.empty(1), np.empty((1, 3)), np.empty((1, 2)),
        np.empty((1, 3)), np.empty(1),
    )  # fmt: skip
    v, lamp, found = np.empty(3), np.empty(3), np.empty(3)
    rows, columns = height.shape
    top = np.float64(maxima[levels[levels.shape[0] - 1, 0]])
    for n in range(out.shape[0]):
        out[n, 0], out[n, 1], out[n, 2] = real(0.0), real(0.0), real(0.0)
        key = key_of(seed, first + n)
        for k in range(3):
            v[k], lamp[k] = view[n, k], light[n, k]
        if cap > 0.0:
            lamp[0], lamp[1], lamp[2] = about(
                lamp[0], lamp[1], lamp[2], 1.0 - cap * uniform(key, 2), 2.0 * math.pi * uniform(key, 3)
            )
        if lamp[2] <= 0.0 or v[2] <= 0.0:
            continue
        x, y = position[n, 0] - 0.5, position[n, 1] - 0.5
        if sigma[n] > 0.0:
            along, over = gaussian_pair(uniform(key, 0), uniform(key, 1))
            x, y = x + sigma[n] * along, y + sigma[n] * over
        if displacement:
            # The ray meets the plane at the position; it comes in through the highest point.
            s = (top + 1e-3 - reference) / v[2]
            x, y, z = (x + s * v[0]) % columns, (y - s * v[1]) % rows, top + 1e-3
            t, x, y, across, down = meet(height, maxima, levels, x, y, z, -v[0], v[1], -v[2])
            if t < 0.0:
                continue
            z -= t * v[2]
            x, y = x % columns, y % rows
        else:
            x, y = x % columns, y % rows
            z, across, down = surface_at(height, x, y)
        found[:] = 0.0
        follow(
            height, maxima, levels, texels, level, roughness_kind, has_shape, facets, shadowing, bounces, key, x, y, z,
            across, down, v, lamp, found, log_normalisation, shade, scratch, block, drawing, sums,
        )  # fmt: skip
        out[n, 0], out[n, 1], out[n, 2] = real(found[0]), real(found[1]), real(found[2])
