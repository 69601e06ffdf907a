"""Moments of a footprint that are linear: the moments of a union are the weighted mean of its parts' moments.

Weighted by reflected energy, over the lobes of a footprint with normals n, tensors Sigma, and u = log sqrt(det Sigma):

    third and fourth moments of n (10 and 15; |n| = 1, so that they hold the first and second),
    E[Sigma] (3), E[exp(-u)], E[u^2], E[u n] (3), E[u n n'] (6; its trace is E[u]).

and, where r is the sine of a normal to the texture's own and K = max(1 - r^2 / ``WINDOW``^2, 0)^2,

    E[K], E[K n_x], E[K n_y], E[K n_x n_x], E[K n_x n_y], E[K n_y n_y], E[K sqrt(det Sigma)].

What is read off them (``features``) is central: taken in the plane of the mean normal, where the first moments vanish,
and in units of the widened lobe, so that it depends neither on which way the surface faces nor on how wide the lobe is.
Normals' own components are bounded, so steep normals do no harm; sums must be double precision, for a variance of 1e-10
is a difference of numbers near 1.

The closed form that all is relative to is LEAN's (Olano and Baker 2010) in that plane: Sigma_0 = E[Sigma] + 2 Cov(n),
eigenvectors p and q, eigenvalues l_1 >= l_2.

LEAN's lobe is far too wide where a footprint is flat for the most part and has steep edges: plates, tiles, planks. The
best lobe there is that of the flat part, so a second closed form is LEAN's of the lobes in the window K, with a few of
all lobes (``OTHERS``) so that it is always defined, of the share f and the tensor Sigma_1. A peak of share f and area
sqrt(det Sigma_1) gains f^2 / sqrt(det Sigma_1) of the squared target, so the first guess of how much of the second form
to take is the gate s(``STEEPNESS`` log(f^2 sqrt(det Sigma_0) / sqrt(det Sigma_1))), s(x) = 1 / (1 + exp(-x)).
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel
from brdffit.halfangle.closed_forms import STEEPEST_SLOPE, tensor_of
from brdffit.halfangle.quadrature import MIXTURE
from brdffit.nets.doubles import (
    EIGHT,
    all_of,
    chosen,
    eight,
    greatest,
    logarithm,
    magnitude,
    put,
    root,
    with_sign,
)

# Third moments xxx xxy xxz xyy xyz xzz yyy yyz yzz zzz; fourth xxxx xxxy xxxz xxyy xxyz xxzz xyyy xyyz xyzz xzzz yyyy
# yyyz yyzz yzzz zzzz; tensor xx yy xy; inverse; u^2; u x y z; u xx xy xz yy yz zz; within the window: 1 x y xx xy yy,
# size.
THIRD, FOURTH, TENSOR, INVERSE, SQUARE, ALONG, ACROSS, WITHIN = 0, 10, 25, 28, 29, 30, 33, 39
MOMENTS = 46
#: Sine at which the window ends, and its reciprocal squared.
WINDOW = math.sqrt(0.02)
NARROW = 1.0 / WINDOW**2
#: Share of all lobes that joins those in the window.
OTHERS = 1e-3
#: Of the gate.
STEEPNESS = 3.0

# Features: logs of size and stretch; z in the lobe's frame; tensor; third and fourth moments; of u: deviation,
# correlations with position and its squares; sharpness of the sharpest; spread as vMF sees it; size itself; level of u;
# of the second form, relative to the first: log of its share, log of its size, normal, log tensor (half the difference
# of the diagonal, off-diagonal).
SIZE, STRETCH, UPRIGHT, TENSORS, THIRDS, FOURTHS = 0, 1, 2, 5, 8, 12
DEVIATION, SHARPEST, TILTS, BENDS, SPHERICAL, WIDTH, LEVEL, FLAT = 17, 18, 19, 21, 24, 25, 26, 27
# How bright the diffuse light is beside the lobes (``glow``): it is no moment, and stands last.
GLOW = 33
FEATURES = 34
#: What is added to that ratio before its logarithm.
DARK = 0.05

#: What changes sign when the first axis, or the second, is turned about.
FIRST_ODD = (3, 7, 8, 10, 13, 15, 19, 23, 29, 32)
SECOND_ODD = (4, 7, 9, 11, 13, 15, 20, 23, 30, 32)

# The closed form of a texel: its normal, the axes p and q, square roots of l_1 and l_2, log tensor, and cos and sin of
# p in the tangent frame of the normal; the second form less the first: normal, log tensor, u; the gate's argument.
NORMAL, FIRST, SECOND, ROOTS, LOG_TENSOR, TURN, OTHER, SMALLER, GATE = 0, 3, 6, 9, 11, 14, 16, 22, 23
CLOSED = 24

_LEAST_Z = 1.0 / STEEPEST_SLOPE


@kernel
def lobe_moments(lobes, count, isotropic, out):
    """Fill ``out`` (MOMENTS,) from lobes whose MIXTURE sums to 1."""
    for k in range(MOMENTS):
        out[k] = 0.0
    for i in range(count):
        w = lobes[i, MIXTURE]
        x, y, z = lobes[i, 0], lobes[i, 1], lobes[i, 2]
        s_xx, s_yy, s_xy, _ = tensor_of(lobes, i, isotropic)
        size = math.sqrt(max(s_xx * s_yy - s_xy * s_xy, 1e-24))
        u = math.log(size)
        xx, xy, xz, yy, yz, zz = w * x * x, w * x * y, w * x * z, w * y * y, w * y * z, w * z * z
        out[0] += xx * x
        out[1] += xx * y
        out[2] += xx * z
        out[3] += xy * y
        out[4] += xy * z
        out[5] += xz * z
        out[6] += yy * y
        out[7] += yy * z
        out[8] += yz * z
        out[9] += zz * z
        p, q, r, s, t, v = x * x, x * y, x * z, y * y, y * z, z * z
        out[10] += xx * p
        out[11] += xx * q
        out[12] += xx * r
        out[13] += xx * s
        out[14] += xx * t
        out[15] += xx * v
        out[16] += xy * s
        out[17] += xy * t
        out[18] += xy * v
        out[19] += xz * v
        out[20] += yy * s
        out[21] += yy * t
        out[22] += yy * v
        out[23] += yz * v
        out[24] += zz * v
        out[25] += w * s_xx
        out[26] += w * s_yy
        out[27] += w * s_xy
        out[28] += w / size
        out[29] += w * u * u
        out[30] += w * u * x
        out[31] += w * u * y
        out[32] += w * u * z
        out[33] += u * xx
        out[34] += u * xy
        out[35] += u * xz
        out[36] += u * yy
        out[37] += u * yz
        out[38] += u * zz
        k = max(1.0 - NARROW * (p + s), 0.0)
        k = w * k * k
        out[39] += k
        out[40] += k * x
        out[41] += k * y
        out[42] += k * p
        out[43] += k * q
        out[44] += k * s
        out[45] += k * size


@inline
def glow(red, green, blue, energy):
    """log(d / r + ``DARK``) of eight footprints: d is the sum of the diffuse ``red``, ``green`` and ``blue``, each the
    length of its sum of colour times normal, r the energy of the lobes. On a screen the dark beyond a lobe counts where
    nothing else shines.
    """
    return logarithm((red + green + blue) / greatest(energy, 1e-9) + DARK)


@inline
def along(m, v):
    """A symmetric tensor of order 2 with a vector: a vector."""
    a, b, c = v
    return (m[0] * a + m[1] * b + m[2] * c, m[1] * a + m[3] * b + m[4] * c, m[2] * a + m[4] * b + m[5] * c)


@inline
def third_along(m, v):
    """A symmetric tensor of order 3 with a vector: a symmetric tensor (xx, xy, xz, yy, yz, zz)."""
    a, b, c = v
    return (
        m[0] * a + m[1] * b + m[2] * c, m[1] * a + m[3] * b + m[4] * c, m[2] * a + m[4] * b + m[5] * c,
        m[3] * a + m[6] * b + m[7] * c, m[4] * a + m[7] * b + m[8] * c, m[5] * a + m[8] * b + m[9] * c,
    )  # fmt: skip


@inline
def fourth_along(m, v):
    """A symmetric tensor of order 4 with a vector: one of order 3, in the order of the third moments."""
    a, b, c = v
    return (
        m[0] * a + m[1] * b + m[2] * c, m[1] * a + m[3] * b + m[4] * c, m[2] * a + m[4] * b + m[5] * c,
        m[3] * a + m[6] * b + m[7] * c, m[4] * a + m[7] * b + m[8] * c, m[5] * a + m[8] * b + m[9] * c,
        m[6] * a + m[10] * b + m[11] * c, m[7] * a + m[11] * b + m[12] * c, m[8] * a + m[12] * b + m[13] * c,
        m[9] * a + m[13] * b + m[14] * c,
    )  # fmt: skip


@inline
def dot(a, b):
    """Of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def signed_root(x):
    """sqrt(x), odd: moments of high order become comparable to a length."""
    return with_sign(root(magnitude(x)), x)


@inline
def principal(a, b, c):
    """Eigenvalues l1 >= l2 of [[a, c], [c, b]] and cos and sin of the first eigenvector, as ``eigen_log``."""
    mean, half = 0.5 * (a + b), 0.5 * (a - b)
    radius = root(half * half + c * c)
    larger = radius + magnitude(half)
    scale = 1.0 / root(greatest(2.0 * radius * larger, 1e-300))
    some, along_x = radius - 1e-12, half + 1e-300
    cos = chosen(some, chosen(along_x, larger, c) * scale, all_of(1.0))
    sin = chosen(some, chosen(along_x, c, larger) * scale, all_of(0.0))
    return mean + radius, mean - radius, cos, sin


@inline
def features(rows, at, plane, factor, out, closed, to, stride):
    """Features and closed forms of eight footprints, into out[to + k * stride] and closed[...], eight numbers each.

    Moment k stands at rows[at + k * plane] and is multiplied by ``factor``.
    """
    # |n| = 1: first and second moments are traces of the third and fourth.
    third = (
        factor * eight(rows, at + 0 * plane), factor * eight(rows, at + 1 * plane),
        factor * eight(rows, at + 2 * plane), factor * eight(rows, at + 3 * plane),
        factor * eight(rows, at + 4 * plane), factor * eight(rows, at + 5 * plane),
        factor * eight(rows, at + 6 * plane), factor * eight(rows, at + 7 * plane),
        factor * eight(rows, at + 8 * plane), factor * eight(rows, at + 9 * plane),
    )  # fmt: skip
    fourth = (
        factor * eight(rows, at + 10 * plane), factor * eight(rows, at + 11 * plane),
        factor * eight(rows, at + 12 * plane), factor * eight(rows, at + 13 * plane),
        factor * eight(rows, at + 14 * plane), factor * eight(rows, at + 15 * plane),
        factor * eight(rows, at + 16 * plane), factor * eight(rows, at + 17 * plane),
        factor * eight(rows, at + 18 * plane), factor * eight(rows, at + 19 * plane),
        factor * eight(rows, at + 20 * plane), factor * eight(rows, at + 21 * plane),
        factor * eight(rows, at + 22 * plane), factor * eight(rows, at + 23 * plane),
        factor * eight(rows, at + 24 * plane),
    )  # fmt: skip
    xx, yy = factor * eight(rows, at + 25 * plane), factor * eight(rows, at + 26 * plane)
    xy = factor * eight(rows, at + 27 * plane)
    inverse, square = factor * eight(rows, at + 28 * plane), factor * eight(rows, at + 29 * plane)
    with_u = (
        factor * eight(rows, at + 30 * plane), factor * eight(rows, at + 31 * plane),
        factor * eight(rows, at + 32 * plane),
    )  # fmt: skip
    across = (
        factor * eight(rows, at + 33 * plane), factor * eight(rows, at + 34 * plane),
        factor * eight(rows, at + 35 * plane), factor * eight(rows, at + 36 * plane),
        factor * eight(rows, at + 37 * plane), factor * eight(rows, at + 38 * plane),
    )  # fmt: skip
    mean = third[0] + third[3] + third[5], third[1] + third[6] + third[8], third[2] + third[7] + third[9]
    length = root(dot(mean, mean))
    some, shrink = length - 1e-6, 1.0 / greatest(length, 1e-6)
    n_x, n_y = chosen(some, mean[0] * shrink, all_of(0.0)), chosen(some, mean[1] * shrink, all_of(0.0))
    n_z = chosen(some, mean[2] * shrink, all_of(1.0))
    # A mean below the horizon is no slope: a sliver above it.
    lift = root((1.0 - _LEAST_Z * _LEAST_Z) / greatest(n_x * n_x + n_y * n_y, 1e-12))
    above = n_z - _LEAST_Z
    n_x, n_y = chosen(above, n_x, n_x * lift), chosen(above, n_y, n_y * lift)
    n_z = greatest(n_z, _LEAST_Z)
    k = 1.0 / (1.0 + n_z)
    skew = 0.0 - n_x * n_y * k
    t, b = (1.0 - n_x * n_x * k, skew, 0.0 - n_x), (skew, 1.0 - n_y * n_y * k, 0.0 - n_y)
    second = (
        fourth[0] + fourth[3] + fourth[5], fourth[1] + fourth[6] + fourth[8], fourth[2] + fourth[7] + fourth[9],
        fourth[3] + fourth[10] + fourth[12], fourth[4] + fourth[11] + fourth[13],
        fourth[5] + fourth[12] + fourth[14],
    )  # fmt: skip
    by_t, by_b = along(second, t), along(second, b)
    mean_t, mean_b = dot(mean, t), dot(mean, b)
    c_xx = greatest(dot(by_t, t) - mean_t * mean_t, 0.0)
    c_yy = greatest(dot(by_b, b) - mean_b * mean_b, 0.0)
    c_xy = dot(by_t, b) - mean_t * mean_b
    l1, l2, cos, sin = principal(xx + 2.0 * c_xx, yy + 2.0 * c_yy, xy + 2.0 * c_xy)
    l1, l2 = greatest(l1, 1e-12), greatest(l2, 1e-12)
    root1, root2 = root(l1), root(l2)
    r1, r2 = 1.0 / root1, 1.0 / root2
    i1, i2 = r1 * r1, r2 * r2
    g1, g2 = logarithm(l1), logarithm(l2)
    p = cos * t[0] + sin * b[0], cos * t[1] + sin * b[1], cos * t[2] + sin * b[2]
    q = cos * b[0] - sin * t[0], cos * b[1] - sin * t[1], cos * b[2] - sin * t[2]
    put(out, to, 0.25 * (g1 + g2))
    put(out, to + stride, 0.5 * (g1 - g2))
    put(out, to + 2 * stride, n_z)
    put(out, to + 3 * stride, p[2])
    put(out, to + 4 * stride, q[2])
    put(out, to + 5 * stride, (cos * cos * xx + 2.0 * cos * sin * xy + sin * sin * yy) * i1)
    put(out, to + 6 * stride, (sin * sin * xx - 2.0 * cos * sin * xy + cos * cos * yy) * i2)
    put(out, to + 7 * stride, (cos * sin * (yy - xx) + (cos * cos - sin * sin) * xy) * (r1 * r2))
    third_p, third_q = third_along(third, p), third_along(third, q)
    pp, pq, qq = along(third_p, p), along(third_p, q), along(third_q, q)
    put(out, to + 8 * stride, signed_root(dot(pp, p) * r1 * i1))
    put(out, to + 9 * stride, signed_root(dot(pp, q) * r2 * i1))
    put(out, to + 10 * stride, signed_root(dot(pq, q) * r1 * i2))
    put(out, to + 11 * stride, signed_root(dot(qq, q) * r2 * i2))
    fourth_p, fourth_q = fourth_along(fourth, p), fourth_along(fourth, q)
    four_pp, four_qq = third_along(fourth_p, p), third_along(fourth_q, q)
    ppp, ppq = along(four_pp, p), along(four_pp, q)
    qqp, qqq = along(four_qq, p), along(four_qq, q)
    put(out, to + 12 * stride, signed_root(dot(ppp, p)) * i1)
    put(out, to + 13 * stride, signed_root(dot(ppp, q) * r1 * r2) * r1)
    put(out, to + 14 * stride, signed_root(dot(ppq, q)) * r1 * r2)
    put(out, to + 15 * stride, signed_root(dot(qqp, q) * r1 * r2) * r2)
    put(out, to + 16 * stride, signed_root(dot(qqq, q)) * i2)
    level = across[0] + across[3] + across[5]
    put(out, to + 17 * stride, root(greatest(square - level * level, 0.0)))
    sharpest = greatest(inverse * root(greatest(xx * yy - xy * xy, 1e-24)), 1e-6)
    put(out, to + 18 * stride, logarithm(sharpest))
    put(out, to + 19 * stride, (dot(with_u, p) - level * dot(mean, p)) * r1)
    put(out, to + 20 * stride, (dot(with_u, q) - level * dot(mean, q)) * r2)
    u_p, u_q, s_p, s_q = along(across, p), along(across, q), along(second, p), along(second, q)
    put(out, to + 21 * stride, (dot(u_p, p) - level * dot(s_p, p)) * i1)
    put(out, to + 22 * stride, (dot(u_q, q) - level * dot(s_q, q)) * i2)
    put(out, to + 23 * stride, (dot(u_p, q) - level * dot(s_p, q)) * (r1 * r2))
    flat = greatest(1.0 - length * length, 1e-9)
    spread = 2.0 * flat / greatest(length * (3.0 - length * length), 1e-3)
    put(out, to + 24 * stride, logarithm((0.5 * (xx + yy) + spread) * (r1 * r2)))
    put(out, to + 25 * stride, l1)
    put(out, to + 26 * stride, level - 0.5 * (g1 + g2))
    part = factor * eight(rows, at + WITHIN * plane) + OTHERS
    s = 1.0 / part
    m_x = s * (factor * eight(rows, at + (WITHIN + 1) * plane) + OTHERS * mean[0])
    m_y = s * (factor * eight(rows, at + (WITHIN + 2) * plane) + OTHERS * mean[1])
    w_xx = greatest(s * (factor * eight(rows, at + (WITHIN + 3) * plane) + OTHERS * second[0]) - m_x * m_x, 0.0)
    w_xy = s * (factor * eight(rows, at + (WITHIN + 4) * plane) + OTHERS * second[1]) - m_x * m_y
    w_yy = greatest(s * (factor * eight(rows, at + (WITHIN + 5) * plane) + OTHERS * second[3]) - m_y * m_y, 0.0)
    mean_size = root(greatest(xx * yy - xy * xy, 1e-24))
    of_size = s * (factor * eight(rows, at + (WITHIN + 6) * plane) + OTHERS * mean_size) / mean_size
    l3, l4, cos2, sin2 = principal(
        of_size * xx + 2.0 * w_xx, of_size * yy + 2.0 * w_yy, of_size * xy + 2.0 * w_xy
    )  # fmt: skip
    g3, g4 = logarithm(greatest(l3, 1e-12)), logarithm(greatest(l4, 1e-12))
    m_z = root(greatest(1.0 - m_x * m_x - m_y * m_y, 0.01))
    d_x, d_y, d_z = m_x - n_x, m_y - n_y, m_z - n_z
    smaller = 0.5 * (g3 + g4 - g1 - g2)
    d_xx = g3 * cos2 * cos2 + g4 * sin2 * sin2 - g1 * cos * cos - g2 * sin * sin
    d_yy = g3 * sin2 * sin2 + g4 * cos2 * cos2 - g1 * sin * sin - g2 * cos * cos
    d_xy = (g3 - g4) * cos2 * sin2 - (g1 - g2) * cos * sin
    log_part = logarithm(part)
    put(out, to + 27 * stride, log_part)
    put(out, to + 28 * stride, smaller)
    put(out, to + 29 * stride, (d_x * p[0] + d_y * p[1] + d_z * p[2]) * r1)
    put(out, to + 30 * stride, (d_x * q[0] + d_y * q[1] + d_z * q[2]) * r2)
    put(out, to + 31 * stride, 0.5 * ((cos * cos - sin * sin) * (d_xx - d_yy) + 4.0 * cos * sin * d_xy))
    put(out, to + 32 * stride, cos * sin * (d_yy - d_xx) + (cos * cos - sin * sin) * d_xy)
    put(closed, to + OTHER * stride, d_x)
    put(closed, to + (OTHER + 1) * stride, d_y)
    put(closed, to + (OTHER + 2) * stride, d_z)
    put(closed, to + (OTHER + 3) * stride, d_xx)
    put(closed, to + (OTHER + 4) * stride, d_yy)
    put(closed, to + (OTHER + 5) * stride, d_xy)
    put(closed, to + SMALLER * stride, smaller)
    put(closed, to + GATE * stride, STEEPNESS * (2.0 * log_part - smaller))
    put(closed, to, n_x)
    put(closed, to + stride, n_y)
    put(closed, to + 2 * stride, n_z)
    for axis in range(3):
        put(closed, to + (FIRST + axis) * stride, p[axis])
        put(closed, to + (SECOND + axis) * stride, q[axis])
    put(closed, to + ROOTS * stride, root1)
    put(closed, to + (ROOTS + 1) * stride, root2)
    put(closed, to + LOG_TENSOR * stride, g1 * cos * cos + g2 * sin * sin)
    put(closed, to + (LOG_TENSOR + 1) * stride, g1 * sin * sin + g2 * cos * cos)
    put(closed, to + (LOG_TENSOR + 2) * stride, (g1 - g2) * cos * sin)
    put(closed, to + TURN * stride, cos)
    put(closed, to + (TURN + 1) * stride, sin)


@kernel
def all_features(rows, count, out, closed):
    """``features`` of flat moments (MOMENTS, count), count a multiple of 8, into (FEATURES, count), (CLOSED, count)."""
    one = all_of(1.0)
    for i in range(0, count, EIGHT):
        features(rows, i, count, one, out, closed, i, count)


def features_of(moments: np.ndarray, glows: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Features (n, FEATURES) and closed forms (n, CLOSED), float64, of moments (n, MOMENTS) and glows (n,) float64.

    Without glows, that feature is 0.
    """
    padded = max(1, -(-len(moments) // EIGHT)) * EIGHT
    rows = np.zeros((MOMENTS, padded))
    rows[:, : len(moments)] = np.asarray(moments).T
    out, closed = np.zeros((FEATURES, padded)), np.zeros((CLOSED, padded))
    all_features(rows.reshape(-1), padded, out.reshape(-1), closed.reshape(-1))
    if glows is not None:
        out[GLOW, : len(moments)] = glows
    return np.ascontiguousarray(out.T[: len(moments)]), np.ascontiguousarray(closed.T[: len(moments)])
