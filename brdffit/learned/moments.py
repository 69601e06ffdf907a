"""Moments of a footprint that are linear: the moments of a union are the weighted mean of its parts' moments.

Weighted by reflected energy, over the lobes of a footprint with normals n, tensors Sigma, and u = log sqrt(det Sigma):

    third and fourth moments of n (10 and 15; |n| = 1, so that they hold the first and second),
    E[Sigma] (3), E[exp(-u)], E[u^2], E[u n] (3), E[u n n'] (6; its trace is E[u]).

What is read off them (``features``) is central: taken in the plane of the mean normal, where the first moments vanish,
and in units of the widened lobe, so that it depends neither on which way the surface faces nor on how wide the lobe is.
Normals' own components are bounded, so steep normals do no harm; sums must be double precision, for a variance of 1e-10
is a difference of numbers near 1.

The closed form that all is relative to is LEAN's (Olano and Baker 2010) in that plane: Sigma_0 = E[Sigma] + 2 Cov(n),
eigenvectors p and q, eigenvalues l_1 >= l_2.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel
from brdffit.halfangle.closed_forms import STEEPEST_SLOPE, tensor_of
from brdffit.halfangle.frame import eigen_log, tangent_frame
from brdffit.halfangle.quadrature import MIXTURE

# Third moments xxx xxy xxz xyy xyz xzz yyy yyz yzz zzz; fourth xxxx xxxy xxxz xxyy xxyz xxzz xyyy xyyz xyzz xzzz yyyy
# yyyz yyzz yzzz zzzz; tensor xx yy xy; inverse; u^2; u x y z; u xx xy xz yy yz zz.
THIRD, FOURTH, TENSOR, INVERSE, SQUARE, ALONG, ACROSS = 0, 10, 25, 28, 29, 30, 33
MOMENTS = 39

# Features: logs of size and stretch; z in the lobe's frame; tensor; third and fourth moments; of u: deviation,
# correlations with position and its squares; sharpness of the sharpest; spread as vMF sees it; size itself; level of u.
SIZE, STRETCH, UPRIGHT, TENSORS, THIRDS, FOURTHS = 0, 1, 2, 5, 8, 12
DEVIATION, SHARPEST, TILTS, BENDS, SPHERICAL, WIDTH, LEVEL = 17, 18, 19, 21, 24, 25, 26
FEATURES = 27

#: What changes sign when the first axis, or the second, is turned about.
FIRST_ODD = (3, 7, 8, 10, 13, 15, 19, 23)
SECOND_ODD = (4, 7, 9, 11, 13, 15, 20, 23)

# The closed form of a texel: its normal, the axes p and q, square roots of l_1 and l_2, log tensor.
NORMAL, FIRST, SECOND, ROOTS, LOG_TENSOR = 0, 3, 6, 9, 11
CLOSED = 14


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


@inline
def along(m, at, v):
    """A symmetric tensor of order 2, from index ``at``, with a vector: a vector."""
    return (
        m[at] * v[0] + m[at + 1] * v[1] + m[at + 2] * v[2],
        m[at + 1] * v[0] + m[at + 3] * v[1] + m[at + 4] * v[2],
        m[at + 2] * v[0] + m[at + 4] * v[1] + m[at + 5] * v[2],
    )


@inline
def third_along(m, v):
    """The third moments with a vector: a symmetric tensor (xx, xy, xz, yy, yz, zz)."""
    a, b, c = v
    return (
        m[0] * a + m[1] * b + m[2] * c, m[1] * a + m[3] * b + m[4] * c, m[2] * a + m[4] * b + m[5] * c,
        m[3] * a + m[6] * b + m[7] * c, m[4] * a + m[7] * b + m[8] * c, m[5] * a + m[8] * b + m[9] * c,
    )  # fmt: skip


@inline
def fourth_along(m, v):
    """The fourth moments with a vector: a symmetric tensor of order 3, in the order of the third moments."""
    a, b, c = v
    return (
        m[10] * a + m[11] * b + m[12] * c, m[11] * a + m[13] * b + m[14] * c, m[12] * a + m[14] * b + m[15] * c,
        m[13] * a + m[16] * b + m[17] * c, m[14] * a + m[17] * b + m[18] * c, m[15] * a + m[18] * b + m[19] * c,
        m[16] * a + m[20] * b + m[21] * c, m[17] * a + m[21] * b + m[22] * c, m[18] * a + m[22] * b + m[23] * c,
        m[19] * a + m[23] * b + m[24] * c,
    )  # fmt: skip


@inline
def dot(a, b):
    """Of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def signed_root(x):
    """sqrt(x), odd: moments of high order become comparable to a length."""
    return math.copysign(math.sqrt(abs(x)), x)


@kernel
def features(m, out, closed):
    """Fill ``out`` (FEATURES,) and ``closed`` (CLOSED,) from the moments of a footprint."""
    # |n| = 1: first and second moments are traces of the third and fourth.
    mean = m[0] + m[3] + m[5], m[1] + m[6] + m[8], m[2] + m[7] + m[9]
    length = math.sqrt(dot(mean, mean))
    n_x, n_y, n_z = 0.0, 0.0, 1.0
    if length > 1e-6:
        n_x, n_y, n_z = mean[0] / length, mean[1] / length, mean[2] / length
    least_z = 1.0 / STEEPEST_SLOPE
    if n_z < least_z:  # a mean below the horizon is no slope: a sliver above it
        lift = math.sqrt((1.0 - least_z * least_z) / max(n_x * n_x + n_y * n_y, 1e-12))
        n_x, n_y, n_z = n_x * lift, n_y * lift, least_z
    t_x, t_y, t_z, b_x, b_y, b_z = tangent_frame(n_x, n_y, n_z)
    t, b = (t_x, t_y, t_z), (b_x, b_y, b_z)
    second = (
        m[10] + m[13] + m[15], m[11] + m[16] + m[18], m[12] + m[17] + m[19],
        m[13] + m[20] + m[22], m[14] + m[21] + m[23], m[15] + m[22] + m[24],
    )  # fmt: skip
    by_t, by_b = along(second, 0, t), along(second, 0, b)
    mean_t, mean_b = dot(mean, t), dot(mean, b)
    c_xx = max(dot(by_t, t) - mean_t * mean_t, 0.0)
    c_yy = max(dot(by_b, b) - mean_b * mean_b, 0.0)
    c_xy = dot(by_t, b) - mean_t * mean_b
    l1, l2, cos, sin = eigen_log(m[TENSOR] + 2.0 * c_xx, m[TENSOR + 1] + 2.0 * c_yy, m[TENSOR + 2] + 2.0 * c_xy)
    l1, l2 = max(l1, 1e-12), max(l2, 1e-12)
    r1, r2 = 1.0 / math.sqrt(l1), 1.0 / math.sqrt(l2)
    p = cos * t_x + sin * b_x, cos * t_y + sin * b_y, cos * t_z + sin * b_z
    q = cos * b_x - sin * t_x, cos * b_y - sin * t_y, cos * b_z - sin * t_z
    out[0] = 0.25 * (math.log(l1) + math.log(l2))
    out[1] = 0.5 * math.log(l1 / l2)
    out[2], out[3], out[4] = n_z, p[2], q[2]
    xx, yy, xy = m[TENSOR], m[TENSOR + 1], m[TENSOR + 2]
    out[5] = (cos * cos * xx + 2.0 * cos * sin * xy + sin * sin * yy) / l1
    out[6] = (sin * sin * xx - 2.0 * cos * sin * xy + cos * cos * yy) / l2
    out[7] = (cos * sin * (yy - xx) + (cos * cos - sin * sin) * xy) * r1 * r2
    third_p, third_q = third_along(m, p), third_along(m, q)
    pp, pq, qq = along(third_p, 0, p), along(third_p, 0, q), along(third_q, 0, q)
    out[8] = signed_root(dot(pp, p) * r1 / l1)
    out[9] = signed_root(dot(pp, q) * r2 / l1)
    out[10] = signed_root(dot(pq, q) * r1 / l2)
    out[11] = signed_root(dot(qq, q) * r2 / l2)
    fourth_p, fourth_q = fourth_along(m, p), fourth_along(m, q)
    four_pp, four_qq = third_along(fourth_p, p), third_along(fourth_q, q)
    ppp, ppq = along(four_pp, 0, p), along(four_pp, 0, q)
    qqp, qqq = along(four_qq, 0, p), along(four_qq, 0, q)
    out[12] = signed_root(dot(ppp, p)) / l1
    out[13] = signed_root(dot(ppp, q) * r1 * r2) * r1
    out[14] = signed_root(dot(ppq, q)) * r1 * r2
    out[15] = signed_root(dot(qqp, q) * r1 * r2) * r2
    out[16] = signed_root(dot(qqq, q)) / l2
    level = m[ACROSS] + m[ACROSS + 3] + m[ACROSS + 5]
    out[17] = math.sqrt(max(m[SQUARE] - level * level, 0.0))
    half_trace = 0.5 * (xx + yy)
    out[18] = math.log(max(m[INVERSE] * math.sqrt(max(xx * yy - xy * xy, 1e-24)), 1e-6))
    with_u = m[ALONG], m[ALONG + 1], m[ALONG + 2]
    out[19] = (dot(with_u, p) - level * dot(mean, p)) * r1
    out[20] = (dot(with_u, q) - level * dot(mean, q)) * r2
    u_p, u_q, s_p, s_q = along(m, ACROSS, p), along(m, ACROSS, q), along(second, 0, p), along(second, 0, q)
    out[21] = (dot(u_p, p) - level * dot(s_p, p)) / l1
    out[22] = (dot(u_q, q) - level * dot(s_q, q)) / l2
    out[23] = (dot(u_p, q) - level * dot(s_p, q)) * r1 * r2
    kappa = length * (3.0 - length * length) / max(1.0 - length * length, 1e-9)
    out[24] = math.log((half_trace + 2.0 / max(kappa, 1e-3)) * r1 * r2)
    out[25] = l1
    out[26] = level - 0.5 * (math.log(l1) + math.log(l2))
    closed[0], closed[1], closed[2] = n_x, n_y, n_z
    closed[3], closed[4], closed[5] = p
    closed[6], closed[7], closed[8] = q
    closed[9], closed[10] = math.sqrt(l1), math.sqrt(l2)
    g1, g2 = math.log(l1), math.log(l2)
    closed[11] = g1 * cos * cos + g2 * sin * sin
    closed[12] = g1 * sin * sin + g2 * cos * cos
    closed[13] = (g1 - g2) * cos * sin


@kernel
def all_features(moments, out, closed):
    """``features`` of rows (n, MOMENTS)."""
    for i in range(moments.shape[0]):
        features(moments[i], out[i], closed[i])


def features_of(moments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Features (n, FEATURES) and closed forms (n, CLOSED), float64, of moments (n, MOMENTS) float64."""
    out, closed = np.zeros((len(moments), FEATURES)), np.zeros((len(moments), CLOSED))
    all_features(np.ascontiguousarray(moments), out, closed)
    return out, closed
