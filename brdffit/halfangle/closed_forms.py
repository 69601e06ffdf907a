"""Closed-form lobes of a footprint: starts of the fit, and the lobe that guards the quadrature."""

from __future__ import annotations

import math

from brdffit._jit import inline, kernel
from brdffit.halfangle.frame import eigen_log, tangent_frame
from brdffit.halfangle.objective import PARAMETERS
from brdffit.halfangle.quadrature import ALPHA_SQUARED, LOG_TENSOR, MIXTURE, SHAPE, SPREAD

# A footprint whose normals differ by less than this share of the lobe's width is flat: e is below 1e-6 (60 dB).
_FLAT_SHARE = 1e-3
# Rows of starts: LEAN's moments; the narrowest lobe where the target is highest; vMF; narrower shares of the moments
# (L2 follows the peak, not the tail).
LEAN, PEAK, VMF, NARROWER = range(4)
_NARROWER_SHARES = (0.4, 0.12)
STARTS = NARROWER + len(_NARROWER_SHARES)
STEEPEST_SLOPE = 20.0

#: Share of the quadrature nodes that the closed-form lobe draws.
DEFENSIVE_SHARE = 0.25


@inline
def tensor_of(lobes, i, isotropic):
    """Sigma of a base lobe as (xx, yy, xy, smallest eigenvalue)."""
    if isotropic:
        alpha_squared = lobes[i, ALPHA_SQUARED]
        return alpha_squared, alpha_squared, 0.0, alpha_squared
    l1, l2, cos, sin = eigen_log(lobes[i, LOG_TENSOR], lobes[i, LOG_TENSOR + 1], lobes[i, LOG_TENSOR + 2])
    e1, e2 = math.exp(l1), math.exp(l2)
    return e1 * cos * cos + e2 * sin * sin, e1 * sin * sin + e2 * cos * cos, (e1 - e2) * cos * sin, e2


@kernel
def closed_forms(lobes, count, isotropic_base, starts, isotropic):
    """Closed-form starts, weighted by reflected energy; returns whether the footprint is flat.

    LEAN's moments are taken in the frame of the mean normal, where slopes do not explode even if the mean is steep.
    Rows of ``starts`` (STARTS, 6) as named above; PEAK's normal is set later, when the target is known.
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
    # A mean below the horizon cannot be written as a slope; keep a sliver above it.
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
    for row in range(STARTS):
        starts[row, 0], starts[row, 1], starts[row, 5] = m_x, m_y, shape
    set_log_tensor(starts, LEAN, 2, xx + 2.0 * uu, yy + 2.0 * vv, xy + 2.0 * uv, isotropic)
    kappa = length * (3.0 - length * length) / max(1.0 - length * length, 1e-9)
    spread = 2.0 / max(kappa, 1e-3)
    set_log_tensor(starts, VMF, 2, xx + spread, yy + spread, xy, isotropic)
    for k in range(len(_NARROWER_SHARES)):
        share = 2.0 * _NARROWER_SHARES[k]
        set_log_tensor(
            starts, NARROWER + k, 2, shrink * xx + share * uu, shrink * yy + share * vv, shrink * xy + share * uv,
            isotropic,
        )  # fmt: skip
    for p in range(2, PARAMETERS):
        starts[PEAK, p] = starts[STARTS - 1, p]
    alike = widest < (1.0 + _FLAT_SHARE) * 2.0 * narrowest and farthest < _FLAT_SHARE * _FLAT_SHARE * narrowest
    return isotropic_base and alike and most_shape - least_shape < _FLAT_SHARE


@inline
def set_log_tensor(table, row, column, xx, yy, xy, isotropic):
    """Write the matrix logarithm of a tensor into table[row, column:column+3]; isotropic keeps the determinant."""
    l1, l2, cos, sin = eigen_log(xx, yy, xy)
    l1, l2 = math.log(max(l1, 1e-12)), math.log(max(l2, 1e-12))
    if isotropic:
        l1 = l2 = 0.5 * (l1 + l2)
    table[row, column] = l1 * cos * cos + l2 * sin * sin
    table[row, column + 1] = l1 * sin * sin + l2 * cos * cos
    table[row, column + 2] = (l1 - l2) * cos * sin


@kernel
def widen_lobes(lobes, count, isotropic):
    """Add to each lobe the SPREAD of its own part of the footprint; tensors become full ones, no longer isotropic."""
    for i in range(count):
        xx, yy, xy, _ = tensor_of(lobes, i, isotropic)
        xx, yy, xy = xx + lobes[i, SPREAD], yy + lobes[i, SPREAD + 1], xy + lobes[i, SPREAD + 2]
        set_log_tensor(lobes, i, LOG_TENSOR, xx, yy, xy, False)
