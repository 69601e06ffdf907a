"""Closed-form lobes of a footprint: the starts of the fit, and the defensive lobe of the quadrature."""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel
from brdffit.halfangle.frame import eigen_log, half_powers, tangent_frame
from brdffit.halfangle.objective import PARAMETERS
from brdffit.halfangle.patch import fading
from brdffit.halfangle.quadrature import (
    ALPHA_SQUARED,
    BLUE,
    GAIN,
    GREEN,
    H_X,
    H_Y,
    H_Z,
    MEAN,
    MIXTURE,
    RED,
    SHAPE,
    SPREAD,
    TENSOR,
    WEIGHT,
)

real = np.float32

# A footprint is flat if its normals differ by less than this share of the lobe's width, and alpha^2 and shape by less
# than this share: the error of one lobe is then about 1e-6 (60 dB).
_FLAT_SHARE = 1e-3
# Rows of starts: LEAN's moments; the narrowest lobe where the target is highest; vMF; smaller shares of the moments
# (L2 follows the peak, not the tail).
LEAN, PEAK, VMF, NARROWER = range(4)
_NARROWER_SHARES = (0.4, 0.12)
STARTS = NARROWER + len(_NARROWER_SHARES)
#: Largest slope of a fitted normal: 87 degrees from z.
STEEPEST_SLOPE = 20.0

# Moments of a footprint: slopes of the mean normal; mean tensor; covariance of slopes in the frame of the mean normal;
# mean shape; factor that shrinks the mean tensor to that of the sharp lobes; what vMF adds to alpha^2.
M_X, M_Y, XX, YY, XY, UU, VV, UV, SHAPES, SHRINK, VMF_SPREAD = range(11)
MOMENTS = 11

# Largest eigenvalue of MEAN: at 1/3 the mean over normals would reach 0 far away.
_LARGEST_MEAN = 0.3

#: Share of the quadrature nodes that the closed-form lobe draws; and under lights with a size, whose loss counts the
#: dark beside a sharp target, where only this lobe draws nodes.
DEFENSIVE_SHARE, DEFENSIVE_SHARE_SEEN = 0.25, 0.5


@inline
def tensor_of(lobes, i, isotropic):
    """Sigma of a base lobe as (xx, yy, xy, smallest eigenvalue)."""
    if isotropic:
        alpha_squared = lobes[i, ALPHA_SQUARED]
        return alpha_squared, alpha_squared, 0.0, alpha_squared
    xx, yy, xy = lobes[i, TENSOR], lobes[i, TENSOR + 1], lobes[i, TENSOR + 2]
    half = 0.5 * (xx - yy)
    # The smaller eigenvalue as det over the larger one, since the direct difference would cancel.
    largest = 0.5 * (xx + yy) + math.sqrt(half * half + xy * xy)
    return xx, yy, xy, max(xx * yy - xy * xy, 1e-24) / largest


@inline
def log_of_tensor(xx, yy, xy):
    """Matrix logarithm (a, b, c) of a tensor."""
    l1, l2, cos, sin = eigen_log(xx, yy, xy)
    l1, l2 = math.log(max(l1, 1e-12)), math.log(max(l2, 1e-12))
    return l1 * cos * cos + l2 * sin * sin, l1 * sin * sin + l2 * cos * cos, (l1 - l2) * cos * sin


@kernel
def footprint_moments(lobes, count, isotropic_base, moments):
    """Fill ``moments`` (MOMENTS,), weighted by reflected energy; returns whether the footprint is flat.

    LEAN's moments are taken in the frame of the mean normal, where slopes stay finite even if the mean is steep.
    """
    x, y, z = 0.0, 0.0, 0.0
    xx, yy, xy = 0.0, 0.0, 0.0
    sharp, shape = 0.0, 0.0
    narrowest, widest = 1e30, 0.0
    least_shape, most_shape = 1e30, -1e30
    for i in range(count):
        w = lobes[i, MIXTURE]
        x += w * lobes[i, 0]
        y += w * lobes[i, 1]
        z += w * lobes[i, 2]
        t_xx, t_yy, t_xy, least = tensor_of(lobes, i, isotropic_base)
        xx += w * t_xx
        yy += w * t_yy
        xy += w * t_xy
        sharp += w / least
        shape += w * lobes[i, SHAPE]
        narrowest = min(narrowest, least)
        least_shape, most_shape = min(least_shape, lobes[i, SHAPE]), max(most_shape, lobes[i, SHAPE])
        widest = max(widest, t_xx + t_yy)
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-6:
        n_x, n_y, n_z = 0.0, 0.0, 1.0
    else:
        n_x, n_y, n_z = x / length, y / length, z / length
    # A mean normal below the horizon has no slope: lift it to just above the horizon.
    if n_z < 1.0 / STEEPEST_SLOPE:
        lift = 1.0 / math.sqrt(max(n_x * n_x + n_y * n_y, 1e-12))
        n_z = 1.0 / STEEPEST_SLOPE
        flat = math.sqrt(1.0 - n_z * n_z)
        n_x, n_y = n_x * lift * flat, n_y * lift * flat
    t_x, t_y, t_z, b_x, b_y, b_z = tangent_frame(n_x, n_y, n_z)
    uu, vv, uv, mu, mv, farthest = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        w = lobes[i, MIXTURE]
        cos = max(lobes[i, 0] * n_x + lobes[i, 1] * n_y + lobes[i, 2] * n_z, 0.1)
        u = (lobes[i, 0] * t_x + lobes[i, 1] * t_y + lobes[i, 2] * t_z) / cos
        v = (lobes[i, 0] * b_x + lobes[i, 1] * b_y + lobes[i, 2] * b_z) / cos
        uu += w * u * u
        vv += w * v * v
        uv += w * u * v
        mu += w * u
        mv += w * v
        farthest = max(farthest, u * u + v * v)
    uu, vv, uv = max(uu - mu * mu, 0.0), max(vv - mv * mv, 0.0), uv - mu * mv
    m_x, m_y = -n_x / n_z, -n_y / n_z
    # L2 follows the sharp lobes: narrower starts shrink the mean tensor to the harmonic mean of the smallest axes.
    shrink = min(1.0, 2.0 / (sharp * (xx + yy)))
    moments[M_X], moments[M_Y], moments[SHAPES] = m_x, m_y, shape
    moments[XX], moments[YY], moments[XY] = xx, yy, xy
    moments[UU], moments[VV], moments[UV] = uu, vv, uv
    moments[SHRINK] = shrink
    kappa = length * (3.0 - length * length) / max(1.0 - length * length, 1e-9)
    moments[VMF_SPREAD] = 2.0 / max(kappa, 1e-3)
    alike = widest < (1.0 + _FLAT_SHARE) * 2.0 * narrowest and farthest < _FLAT_SHARE * _FLAT_SHARE * narrowest
    return isotropic_base and alike and most_shape - least_shape < _FLAT_SHARE


@inline
def take_from_tensor(moments, square, least):
    """Subtract ``square`` from both eigenvalues of the mean tensor, but leave them at ``least`` or above."""
    mean, apart = 0.5 * (moments[XX] + moments[YY]), 0.5 * (moments[XX] - moments[YY])
    radius = math.sqrt(apart * apart + moments[XY] * moments[XY])
    large, small = max(mean + radius - square, least), max(mean - radius - square, least)
    share = 0.5 * (large - small) / radius if radius > 1e-12 * mean else 0.0
    moments[XX] = 0.5 * (large + small) + share * apart
    moments[YY] = 0.5 * (large + small) - share * apart
    moments[XY] *= share


@inline
def start_of(moments, tensors, slopes, spread, isotropic, start):
    """A start (6,): the mean normal, and Sigma = ``tensors`` E[Sigma] + ``slopes`` Cov + ``spread`` I."""
    a, b, c = log_of_tensor(
        tensors * moments[XX] + slopes * moments[UU] + spread, tensors * moments[YY] + slopes * moments[VV] + spread,
        tensors * moments[XY] + slopes * moments[UV],
    )  # fmt: skip
    if isotropic:
        # The determinant is kept.
        a = b = 0.5 * (a + b)
        c = 0.0
    start[0], start[1], start[2], start[3], start[4], start[5] = moments[M_X], moments[M_Y], a, b, c, moments[SHAPES]


@inline
def first_start(moments, isotropic, starts):
    """Fill LEAN's row of ``starts``."""
    start_of(moments, 1.0, 2.0, 0.0, isotropic, starts[LEAN])


@inline
def further_starts(moments, isotropic, starts):
    """Fill the other rows; PEAK's normal is set by ``start_at_peak`` once the target is tabulated."""
    start_of(moments, 1.0, 0.0, moments[VMF_SPREAD], isotropic, starts[VMF])
    for k in range(len(_NARROWER_SHARES)):
        start_of(moments, moments[SHRINK], 2.0 * _NARROWER_SHARES[k], 0.0, isotropic, starts[NARROWER + k])
    for p in range(PARAMETERS):
        starts[PEAK, p] = starts[STARTS - 1, p]


@kernel
def start_at_peak(nodes, start):
    """The normal of ``start`` <- the node where the target is highest, unless that node is too close to the horizon."""
    red, green, blue, weight = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT]
    top, highest = 0, real(0.0)
    for j in range(nodes.shape[1]):
        height = red[j] + green[j] + blue[j]
        if height > highest and weight[j] > real(0.0):
            highest = height
            top = j
    if nodes[H_Z, top] > 1.0 / STEEPEST_SLOPE:
        start[0], start[1] = -nodes[H_X, top] / nodes[H_Z, top], -nodes[H_Y, top] / nodes[H_Z, top]


@kernel
def closed_forms(lobes, count, isotropic_base, starts, isotropic):
    """All starts into ``starts`` (STARTS, 6), rows as named above; returns whether the footprint is flat."""
    moments = np.empty(MOMENTS)
    flat = footprint_moments(lobes, count, isotropic_base, moments)
    first_start(moments, isotropic, starts)
    further_starts(moments, isotropic, starts)
    return flat


@inline
def widening_at(widening, alpha_squared):
    """``Model.widening``, which holds for sharp lobes, corrected for a lobe of this alpha^2.

    On the sphere a wide lobe widens less. For GGX the correction agrees with the table of brdffit.halfangle.response to
    within a tenth, for the stretch up to alpha = 0.4 and for the size up to 0.7.
    """
    size, stretch, gain = widening
    less = 1.0 / (1.0 + 2.0 * alpha_squared * (1.0 + alpha_squared))
    return less * size, less * stretch, gain * max(1.0 - 3.0 * alpha_squared, 0.0)


@inline
def _average_lobe(lobe, xx, yy, xy, s_xx, s_yy, s_xy, less):
    """TENSOR and MEAN of a lobe averaged over normals of covariance C; ``less``: share of C that widens on the sphere.

    Where C is so large that the expansion fails, its part in MEAN is cut: the lobe alone has the second moments.
    """
    s_xx, s_yy, s_xy = less * s_xx, less * s_yy, less * s_xy
    lobe[TENSOR], lobe[TENSOR + 1], lobe[TENSOR + 2] = xx + 2.0 * s_xx, yy + 2.0 * s_yy, xy + 2.0 * s_xy
    _, narrow, _ = half_powers(lobe[TENSOR], lobe[TENSOR + 1], lobe[TENSOR + 2])
    a, b, c = narrow
    # M = N C N with N = Sigma'^(-1/2).
    p, q, r, s = a * s_xx + c * s_xy, a * s_xy + c * s_yy, c * s_xx + b * s_xy, c * s_xy + b * s_yy
    uu, uv, vv = p * a + q * c, p * c + q * b, r * c + s * b
    largest = 0.5 * (uu + vv + math.sqrt((uu - vv) * (uu - vv) + 4.0 * uv * uv))
    cut = _LARGEST_MEAN / largest if largest > _LARGEST_MEAN else 1.0
    lobe[MEAN], lobe[MEAN + 1], lobe[MEAN + 2] = cut * uu, cut * vv, cut * uv


@kernel
def widen_lobes(lobes, count, isotropic, widening, light=0.0, averages=False):
    """Widen each lobe by the SPREAD of its own part of the footprint; all tensors become full ones.

    ``light``: alpha^2 that a light of some size adds to every lobe first. ``averages``, where it has a size: a lobe
    becomes the mean over its normals (``quadrature.mean_over_normals``), Sigma + 2 C and MEAN, instead of the nearest
    single lobe.

    LEAN adds twice the covariance C of the normals, which keeps the moments, but for long-tailed lobes its error
    against the average over the part is three times that of the nearest lobe. Where C is small the widened lobe is that
    nearest one, of any size and scale (``Model.widening``, derived in brdffit.halfangle.response); the remaining
    difference then moves the fit in second order only. Where C is large that lobe would have too much energy, which
    counts from afar, where many parts overlap. There the widened lobe is the nearest of scale 1, Sigma + stretch C (for
    a sharp GGX lobe: fitting c (8 u^3 - 12 u^4) by a change of log alpha^2 alone gives 3 c).
    """
    for i in range(count):
        xx, yy, xy, least = tensor_of(lobes, i, isotropic)
        xx, yy, least = xx + light, yy + light, least + light
        size, stretch, gain = widening_at(widening, 0.5 * (xx + yy))
        s_xx, s_yy, s_xy = 0.5 * lobes[i, SPREAD], 0.5 * lobes[i, SPREAD + 1], 0.5 * lobes[i, SPREAD + 2]
        if averages and light > 0.0:
            _average_lobe(lobes[i], xx, yy, xy, s_xx, s_yy, s_xy, stretch / widening[1])
            continue
        lobes[i, MEAN], lobes[i, MEAN + 1], lobes[i, MEAN + 2] = 0.0, 0.0, 0.0
        before = max(xx * yy - xy * xy, least * least)
        # tr Sigma^-1 C.
        trace = (yy * s_xx + xx * s_yy - 2.0 * xy * s_xy) / before
        near = fading(trace)
        wider = 1.0 + 0.5 * (size - stretch) * trace * near
        lobes[i, TENSOR] = wider * (xx + stretch * s_xx)
        lobes[i, TENSOR + 1] = wider * (yy + stretch * s_yy)
        lobes[i, TENSOR + 2] = wider * (xy + stretch * s_xy)
        lobes[i, GAIN] *= 1.0 + size * gain * trace * near


@kernel
def light_lobes(lobes, first, last, isotropic, light):
    """Add ``light``, the alpha^2 by which a light of some size widens lobes, to lobes first to last - 1."""
    for i in range(first, last):
        lobes[i, TENSOR] += light
        if not isotropic:
            lobes[i, TENSOR + 1] += light
            lobes[i, MEAN], lobes[i, MEAN + 1], lobes[i, MEAN + 2] = 0.0, 0.0, 0.0


@kernel
def widen_round_lobes(lobes, count, widening, light=0.0):
    """As ``widen_lobes``, for isotropic lobes with spreads so small that they may stay isotropic."""
    for i in range(count):
        lobes[i, ALPHA_SQUARED] += light
        size, _, gain = widening_at(widening, lobes[i, ALPHA_SQUARED])
        # Twice the mean variance, in units of alpha^2.
        spread = 0.5 * (lobes[i, SPREAD] + lobes[i, SPREAD + 1]) / lobes[i, ALPHA_SQUARED]
        lobes[i, ALPHA_SQUARED] *= 1.0 + 0.5 * size * spread
        lobes[i, GAIN] *= 1.0 + size * gain * spread
