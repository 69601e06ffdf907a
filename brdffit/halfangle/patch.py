"""One bilinear patch of the base: four texels, the values between them, and their change from texel to texel."""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline
from brdffit.halfangle.frame import tangent_frame

# Limits for a patch that is sampled once: ratio of perceptual roughness (alpha^2 then spreads by 12% of its mean, a
# relative squared error of 1e-4), ratio of colours, and difference of log tensors.
_ROUGHER, _BRIGHTER, _STRETCHED = 1.1, 1.5, 0.4


@inline
def hash_of(a, b, c, d):
    """A 32-bit mix of four integers (murmur3's finaliser over a linear combination)."""
    h = np.uint32(a) * np.uint32(0x9E3779B1) ^ np.uint32(b) * np.uint32(0x85EBCA77)
    h = h ^ np.uint32(c) * np.uint32(0xC2B2AE3D) ^ np.uint32(d) * np.uint32(0x27D4EB2F)
    h = np.uint32(h ^ (h >> np.uint32(16))) * np.uint32(0x85EBCA6B)
    h = np.uint32(h ^ (h >> np.uint32(13))) * np.uint32(0xC2B2AE35)
    return np.uint32(h ^ (h >> np.uint32(16)))


@inline
def wrapped(i, size, tile):
    """Texel index, wrapped or clamped if it lies beyond the border."""
    if 0 <= i < size:
        return i
    if tile:
        return i % size
    return min(max(i, 0), size - 1)


@inline
def texel_of(image, j, i):
    """Three channels of a texel, in double precision."""
    return np.float64(image[j, i, 0]), np.float64(image[j, i, 1]), np.float64(image[j, i, 2])


@inline
def corners(image, i0, i1, j0, j1):
    """The four texels of a patch: (j0, i0), (j0, i1), (j1, i0), (j1, i1)."""
    return texel_of(image, j0, i0), texel_of(image, j0, i1), texel_of(image, j1, i0), texel_of(image, j1, i1)


@inline
def four_of(image, i0, i1, j0, j1):
    """The four texels of an image of one channel, in double precision."""
    return np.float64(image[j0, i0]), np.float64(image[j0, i1]), np.float64(image[j1, i0]), np.float64(image[j1, i1])


@inline
def weights_of(fx, fy):
    """Weights of the four texels of a patch at a point in it."""
    return (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy


@inline
def bilinear_of(four, w):
    """Bilinear value of one number; ``w`` holds the weights of the four texels."""
    return w[0] * four[0] + w[1] * four[1] + w[2] * four[2] + w[3] * four[3]


@inline
def bilinear(texels, w):
    """Bilinear value of three channels; ``w`` holds the weights of the four texels."""
    a, b, c, d = texels
    return (
        w[0] * a[0] + w[1] * b[0] + w[2] * c[0] + w[3] * d[0],
        w[0] * a[1] + w[1] * b[1] + w[2] * c[1] + w[3] * d[1],
        w[0] * a[2] + w[1] * b[2] + w[2] * c[2] + w[3] * d[2],
    )


@inline
def _distance(a, b):
    """Squared distance between two texels' normals."""
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2


@inline
def edges(normals):
    """Squared change of the normal along a patch, from one texel to the next: (along x, along y)."""
    a, b, c, d = normals
    return max(_distance(a, b), _distance(c, d)), max(_distance(a, c), _distance(b, d))


@inline
def _least_log(tensor):
    """A lower bound of the smaller eigenvalue of a log tensor (a, b, c)."""
    return min(tensor[0], tensor[1]) - abs(tensor[2])


@inline
def narrowest(tensors, roughness, isotropic):
    """Smallest alpha^2 of the four texels (a lower bound of it where they are anisotropic)."""
    if isotropic:
        return least(roughness) ** 4
    a, b, c, d = tensors
    return math.exp(least((_least_log(a), _least_log(b), _least_log(c), _least_log(d))))


@inline
def least(of):
    """The least of four."""
    return min(min(of[0], of[1]), min(of[2], of[3]))


@inline
def most(of):
    """The largest of four."""
    return max(max(of[0], of[1]), max(of[2], of[3]))


@inline
def reflecting(colours):
    """Sum of the colour channels of each of the four texels."""
    a, b, c, d = colours
    return a[0] + a[1] + a[2], b[0] + b[1] + b[2], c[0] + c[1] + c[2], d[0] + d[1] + d[2]


@inline
def alike(sums, tensors, roughness, isotropic, light):
    """Whether colour and roughness of the four texels differ so little that one sample may represent all of them.

    ``light``: alpha^2 that a light of some size adds.
    """
    if most(sums) > _BRIGHTER * least(sums):
        return False
    if isotropic:
        if light > 0.0:
            return most(roughness) ** 4 + light <= _ROUGHER**4 * (least(roughness) ** 4 + light)
        return most(roughness) <= _ROUGHER * least(roughness)
    e, f, g, h = tensors
    x, y, z = (e[0], f[0], g[0], h[0]), (e[1], f[1], g[1], h[1]), (e[2], f[2], g[2], h[2])
    return max(max(most(x) - least(x), most(y) - least(y)), most(z) - least(z)) <= _STRETCHED


@inline
def in_one_patch(offsets, centre, first):
    """How many strata from ``first`` on lie between the same two texels."""
    cell = math.floor(centre + offsets[first])
    last = first + 1
    while last < offsets.size and math.floor(centre + offsets[last]) == cell:
        last += 1
    return last - first


@inline
def inside(begin, width):
    """``begin`` moved so that a part of this ``width`` lies within a patch, [0, 1].

    A stratum as wide as a texel is centred on a texel: half of its samples would lie beyond the patch, where bilinear
    values are extrapolated (roughness may pass through 0). The shift of half a texel is small in a footprint of many.
    """
    return min(max(begin, 0.0), max(1.0 - width, 0.0))


@inline
def weighed(weights, first, many):
    """Weight of ``many`` strata from ``first`` on, and the offset of their centroid from their middle, in strata.

    One sample at the centroid represents them all: the mean of values that are linear between texels is then exact.
    Where weights differ in sign the offset is 0.
    """
    total, moment = 0.0, 0.0
    alike = True
    for g in range(many):
        weight = weights[first + g]
        total += weight
        moment += weight * (g - 0.5 * (many - 1))
        alike = alike and weight * weights[first] > 0.0
    return total, moment / total if alike else 0.0


@inline
def unit(n):
    """(unit vector, length) of a normal; (0, 0, 1) and length 1 for a vector of length 0."""
    length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    if length > 1e-6:
        inverse = 1.0 / length
        return (n[0] * inverse, n[1] * inverse, n[2] * inverse), length
    return (0.0, 0.0, 1.0), 1.0


@inline
def slopes_of(four, fx, fy):
    """Gradient of a bilinear number along x and y, per texel, at the point (fx, fy) of a patch."""
    a, b, c, d = four
    return (1.0 - fy) * (b - a) + fy * (d - c), (1.0 - fx) * (c - a) + fx * (d - b)


@inline
def arc_of(begin, end):
    """(foot, reach) of the line of normals from ``begin`` to ``end``, before these are made unit.

    The point begin + f (end - begin) is seen from the origin at the angle atan((f - foot) / reach) from where the line
    is nearest; reach is its distance there, in units of the line.
    """
    x, y, z = end[0] - begin[0], end[1] - begin[1], end[2] - begin[2]
    square = max(x * x + y * y + z * z, 1e-6)
    foot = -(begin[0] * x + begin[1] * y + begin[2] * z) / square
    n_x, n_y, n_z = begin[0] + foot * x, begin[1] + foot * y, begin[2] + foot * z
    return foot, max(math.sqrt((n_x * n_x + n_y * n_y + n_z * n_z) / square), 1e-2)


@inline
def angle_across(arc, begin, size, many):
    """The largest angle by which the normal turns across one of ``many`` strata of an arc."""
    largest = 0.0
    for g in range(many):
        first, last = begin + g * size, begin + (g + 1) * size
        largest = max(largest, math.atan((last - arc[0]) / arc[1]) - math.atan((first - arc[0]) / arc[1]))
    return largest


@inline
def part_of_arc(arc, begin, size, part, cuts):
    """(middle, width) of a part of strata that are cut into ``cuts`` parts each, across which normals turn alike."""
    first = begin + part // cuts * size
    low, high = math.atan((first - arc[0]) / arc[1]), math.atan((first + size - arc[0]) / arc[1])
    turn, k = (high - low) / cuts, part % cuts
    begins, ends = math.tan(low + k * turn), math.tan(low + (k + 1) * turn)
    return arc[0] + 0.5 * arc[1] * (begins + ends), arc[1] * (ends - begins)


@inline
def between(one, other, f):
    """The point at f on the line between two vectors."""
    g = 1.0 - f
    return g * one[0] + f * other[0], g * one[1] + f * other[1], g * one[2] + f * other[2]


@inline
def fading(spread):
    """Blend from the nearest lobe of any scale (1, for a small spread inside a part) to the nearest lobe of scale 1 (0,
    for a large one), which keeps the energy of every part right to 1%."""
    return 1.0 / (1.0 + 400.0 * spread * spread)


@inline
def narrowed(by_x, by_y, size_x, size_y):
    """Factors of alpha^2 and of the scale for a part of a patch across which the roughness changes.

    ``by_x``, ``by_y``: gradient of log perceptual roughness per texel; ``size_x``, ``size_y``: sides of the part. A
    variance v of log alpha^2 makes log alpha^2 of the nearest lobe less by v / 2 and its scale less by the share v / 5
    (derived in brdffit.halfangle.response; for a Gaussian peak v / 2 and v / 4), and log alpha^2 of the nearest lobe of
    scale 1 less by v / 4. Besides, the mean of log alpha^2 lies v / 8 below its value in the middle, because roughness
    r is linear across the part and log alpha^2 = 4 log r is concave.
    """
    v = 16.0 / 12.0 * (size_x * size_x * by_x * by_x + size_y * size_y * by_y * by_y)
    near = fading(v)
    return 1.0 / (1.0 + (0.375 + 0.25 * near) * v), 1.0 - 0.2 * near * v


@inline
def weighted(rough_x, rough_y, colour_x, colour_y, size_x, size_y):
    """Factor of alpha^2 for a part of a patch across which log roughness and log colour vary together."""
    covariance = 4.0 / 12.0 * (size_x * size_x * rough_x * colour_x + size_y * size_y * rough_y * colour_y)
    return min(max(1.0 + covariance, 0.5), 2.0)


@inline
def leaned(n, length, normals, fx, fy, weight_x, weight_y):
    """A sample's unit normal, moved towards the sharper and brighter side of its part of the patch.

    Where normals vary together with log alpha^2 or with the log of the colour, the normal of the nearest lobe moves by
    their covariance, away from rougher lobes (brdffit.halfangle.response; the same holds for a Gaussian peak).
    ``weight_x``, ``weight_y``: gradient of log colour minus that of log alpha^2 along each axis, times the squared size
    of the part.
    """
    a, b, c, d = normals
    scale = 1.0 / (12.0 * length)
    p, q, r, s = (
        (1.0 - fy) * weight_x * scale,
        fy * weight_x * scale,
        (1.0 - fx) * weight_y * scale,
        fx * weight_y * scale,
    )
    moved, _ = unit(
        (
            n[0] + p * (b[0] - a[0]) + q * (d[0] - c[0]) + r * (c[0] - a[0]) + s * (d[0] - b[0]),
            n[1] + p * (b[1] - a[1]) + q * (d[1] - c[1]) + r * (c[1] - a[1]) + s * (d[1] - b[1]),
            n[2] + p * (b[2] - a[2]) + q * (d[2] - c[2]) + r * (c[2] - a[2]) + s * (d[2] - b[2]),
        )
    )
    return moved


@inline
def spread_tensor(n, normals, fx, fy, size_x, size_y):
    """Twice the covariance (xx, yy, xy) of the normals across a part of a patch, ``size_x`` by ``size_y`` texels.

    Across a part of a smooth normal field the slopes are uniform over a parallelogram with edges g_x and g_y, so their
    covariance is (g_x g_x' + g_y g_y') / 12. LEAN (Olano and Baker 2010) adds twice that to the tensor. ``n`` is the
    unit normal in the middle.
    """
    a, b, c, d = normals
    t_x, t_y, t_z, b_x, b_y, b_z = tangent_frame(n[0], n[1], n[2])
    x_x = size_x * ((1.0 - fy) * (b[0] - a[0]) + fy * (d[0] - c[0]))
    x_y = size_x * ((1.0 - fy) * (b[1] - a[1]) + fy * (d[1] - c[1]))
    x_z = size_x * ((1.0 - fy) * (b[2] - a[2]) + fy * (d[2] - c[2]))
    y_x = size_y * ((1.0 - fx) * (c[0] - a[0]) + fx * (d[0] - b[0]))
    y_y = size_y * ((1.0 - fx) * (c[1] - a[1]) + fx * (d[1] - b[1]))
    y_z = size_y * ((1.0 - fx) * (c[2] - a[2]) + fx * (d[2] - b[2]))
    u_x, v_x = t_x * x_x + t_y * x_y + t_z * x_z, b_x * x_x + b_y * x_y + b_z * x_z
    u_y, v_y = t_x * y_x + t_y * y_y + t_z * y_z, b_x * y_x + b_y * y_y + b_z * y_z
    return (u_x * u_x + u_y * u_y) / 6.0, (v_x * v_x + v_y * v_y) / 6.0, (u_x * v_x + u_y * v_y) / 6.0
