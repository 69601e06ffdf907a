"""The fit of one texel: footprint, target, starts, search, check."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from brdffit._jit import inline, kernel
from brdffit.fitting.bfgs import FREE_NORMAL, minimise
from brdffit.fitting.status import (
    CONVERGED,
    FALLBACK,
    FLAT,
    NO_SPECULAR,
)
from brdffit.halfangle.apparent_lobe import gather_lobes, normalise_mixture, normalise_shapes
from brdffit.halfangle.frame import eigen_log, tangent_frame
from brdffit.halfangle.objective import (
    HELD,
    PARAMETERS,
    SCALE,
    TARGET,
    evaluate,
    evaluate_value,
)
from brdffit.halfangle.quadrature import (
    ALPHA_SQUARED,
    BLUE,
    GREEN,
    LOBE_COLUMNS,
    LOG_TENSOR,
    MIXTURE,
    NODE_ROWS,
    RED,
    SHAPE,
    SPECULAR,
    WEIGHT,
    place_nodes,
    weigh_nodes,
)

real = np.float32

# What a fit reports of itself, besides its parameters.
RED_SCALE, GREEN_SCALE, BLUE_SCALE, RESIDUAL, DISAGREEMENT, EVALUATIONS, TARGET_NORM = range(7)
REPORT = 7

# A footprint whose normals differ by less than this share of the lobe's width is flat: e is below 1e-6 (60 dB).
_FLAT_SHARE = 1e-3
# Starts are made with this much of the slope covariance (1: LEAN; less: L2 follows the peak, not the tail).
_START_SHARES = (1.0, 0.4, 0.12)
_STEEPEST_SLOPE = 20.0

#: What ``fit_texel`` returns when the rule's strata are too coarse for the footprint; never a texel's final status.
TOO_COARSE = 255


class Search(NamedTuple):
    """How the search goes on, the same for all texels.

    ``free``: mask of what is fitted; ``exponent``: of z.h in the half-angle density; ``tolerance``: of the error the
    model still promises to remove when it stops; ``starts``: how many are followed to the end; bounds of the log
    eigenvalues and of the shape; ``same_model``: base and pyramid share a lobe model; ``trusted``: largest
    disagreement of two half rules, as a share of the residual, that is not refined; ``coarse``: largest share of the
    energy in samples further than a lobe's width from the next.
    """

    free: int
    held: bool
    exponent: int
    tolerance: float
    iterations: int
    starts: int
    log_low: float
    log_high: float
    shape_low: float
    shape_high: float
    same_model: bool
    trusted: float
    coarse: float


class Scratch(NamedTuple):
    """Arrays that a worker allocates once."""

    lobes: np.ndarray
    nodes: np.ndarray
    values: np.ndarray
    work: np.ndarray
    setting: np.ndarray
    theta: np.ndarray
    best: np.ndarray
    start: np.ndarray
    starts: np.ndarray
    colour: np.ndarray


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

    Row 0 of ``starts`` (n, 7) is LEAN's moments taken in the frame of the mean normal (where slopes do not explode
    even if the mean is steep), row 1 vMF (isotropic, from the length of the mean), further rows narrower ones.
    """
    x, y, z = 0.0, 0.0, 0.0
    xx, yy, xy = 0.0, 0.0, 0.0
    sharp, shape = 0.0, 0.0
    narrowest, widest = 1e30, 0.0
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
        widest = max(widest, t_xx + t_yy)
    length = math.sqrt(x * x + y * y + z * z)
    if length < 1e-6:
        n_x, n_y, n_z = 0.0, 0.0, 1.0
    else:
        n_x, n_y, n_z = x / length, y / length, z / length
    # A mean below the horizon cannot be written as a slope; keep a sliver above it.
    if n_z < 1.0 / _STEEPEST_SLOPE:
        lift = 1.0 / math.sqrt(max(n_x * n_x + n_y * n_y, 1e-12))
        n_z = 1.0 / _STEEPEST_SLOPE
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
    for k in range(len(_START_SHARES)):
        share = 2.0 * _START_SHARES[k]
        keep = 1.0 if k == 0 else shrink
        row = k if k == 0 else k + 1
        starts[row, 0], starts[row, 1], starts[row, 5] = m_x, m_y, shape
        set_log_tensor(starts, row, keep * xx + share * uu, keep * yy + share * vv, keep * xy + share * uv, isotropic)
    kappa = length * (3.0 - length * length) / max(1.0 - length * length, 1e-9)
    starts[1, 0], starts[1, 1], starts[1, 5] = m_x, m_y, shape
    spread = 2.0 / max(kappa, 1e-3)
    set_log_tensor(starts, 1, xx + spread, yy + spread, xy, isotropic)
    even = widest < (1.0 + _FLAT_SHARE) * 2.0 * narrowest if isotropic_base else False
    return even and farthest < _FLAT_SHARE * _FLAT_SHARE * narrowest


@inline
def set_log_tensor(starts, row, xx, yy, xy, isotropic):
    """Write the matrix logarithm of a tensor into starts[row, 2:5]; isotropic keeps the determinant."""
    l1, l2, cos, sin = eigen_log(xx, yy, xy)
    l1, l2 = math.log(max(l1, 1e-12)), math.log(max(l2, 1e-12))
    if isotropic:
        l1 = l2 = 0.5 * (l1 + l2)
    starts[row, 2] = l1 * cos * cos + l2 * sin * sin
    starts[row, 3] = l1 * sin * sin + l2 * cos * cos
    starts[row, 4] = (l1 - l2) * cos * sin


@inline
def clamp_to_domain(theta, search):
    """Eigenvalues and shape back within their bounds: the walls of the objective leave them a little outside."""
    l1, l2, cos, sin = eigen_log(theta[2], theta[3], theta[4])
    if l1 > search.log_high or l2 < search.log_low:
        l1 = min(max(l1, search.log_low), search.log_high)
        l2 = min(max(l2, search.log_low), search.log_high)
        theta[2] = l1 * cos * cos + l2 * sin * sin
        theta[3] = l1 * sin * sin + l2 * cos * cos
        theta[4] = (l1 - l2) * cos * sin
    theta[5] = min(max(theta[5], search.shape_low), search.shape_high)


@kernel
def target_norm(nodes):
    """<T,T> over all channels."""
    red, green, blue, weight = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT]
    norm = real(0.0)
    for j in range(nodes.shape[1]):
        norm += weight[j] * (red[j] * red[j] + green[j] * green[j] + blue[j] * blue[j])
    return float(norm)


@kernel
def aim(nodes, colour, target_norm, setting):
    """Set the scalar target for this colour: filtered colour if the scale is held, colour direction if it is free."""
    squared = colour[0] * colour[0] + colour[1] * colour[1] + colour[2] * colour[2]
    if setting[HELD] > 0.0:
        r, g, b = colour[0] / squared, colour[1] / squared, colour[2] / squared
        setting[SCALE] = squared / target_norm
    else:
        scale = 1.0 / math.sqrt(squared)
        r, g, b = colour[0] * scale, colour[1] * scale, colour[2] * scale
        setting[SCALE] = 1.0 / target_norm
    for j in range(nodes.shape[1]):
        s = r * nodes[RED, j] + g * nodes[GREEN, j] + b * nodes[BLUE, j]
        nodes[TARGET, j] = s * nodes[WEIGHT, j]


@kernel
def settle_scale(theta, nodes, setting, values_kernel, log_normalisation, values, work, report):
    """Best scale a channel (or the held one, already in ``report``), residual, and the disagreement of two half rules.

    The residual is summed as it stands, (T - rho D)^2, so that nothing cancels.
    """
    values_kernel(theta, nodes, log_normalisation, values, work)
    red, green, blue, weight = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT]
    dd, r, g, b = real(0.0), real(0.0), real(0.0), real(0.0)
    for j in range(nodes.shape[1]):
        wd = weight[j] * values[j]
        dd += wd * values[j]
        r += wd * red[j]
        g += wd * green[j]
        b += wd * blue[j]
    if not setting[HELD] > 0.0:
        ok = dd > 0.0
        report[RED_SCALE] = max(r / dd, 0.0) if ok else 0.0
        report[GREEN_SCALE] = max(g / dd, 0.0) if ok else 0.0
        report[BLUE_SCALE] = max(b / dd, 0.0) if ok else 0.0
    rho_r, rho_g, rho_b = real(report[RED_SCALE]), real(report[GREEN_SCALE]), real(report[BLUE_SCALE])
    total, alternating = real(0.0), real(0.0)
    for j in range(nodes.shape[1]):
        d_r, d_g, d_b = red[j] - rho_r * values[j], green[j] - rho_g * values[j], blue[j] - rho_b * values[j]
        term = weight[j] * (d_r * d_r + d_g * d_g + d_b * d_b)
        total += term
        alternating += term * real(1 - 2 * (j & 1))
    report[RESIDUAL] = total / report[TARGET_NORM]
    report[DISAGREEMENT] = abs(alternating) / report[TARGET_NORM]


@kernel
def coarse_share(lobes, count, isotropic, row_length):
    """Share of the reflected energy in samples from which the next sample of the row or column is a lobe's width away.

    Those are places where point samples of a smooth streak of normals would turn it into separate needles.
    """
    share = 0.0
    for i in range(count):
        _, _, _, width = tensor_of(lobes, i, isotropic)
        for k in (i + 1, i + row_length):
            if k < count and (k != i + 1 or k % row_length != 0):
                d_x, d_y, d_z = lobes[k, 0] - lobes[i, 0], lobes[k, 1] - lobes[i, 1], lobes[k, 2] - lobes[i, 2]
                if d_x * d_x + d_y * d_y + d_z * d_z > width:
                    share += lobes[i, MIXTURE]
                    break
    return share


@kernel
def fit_texel(
    base, strata, points, column, row, search, scratch, diffuse_moment, report, last_rule,
    tabulate_kernel, moments_kernel, values_kernel, log_normalisation, source_log_normalisation,
):  # fmt: skip
    """Fit one texel with one rule. The answer is left in ``scratch.theta``, the rest in ``report``; returns a status.

    Returns TOO_COARSE at once where the strata are too wide for the lobes, unless this is the ``last_rule``.
    ``scratch.best`` (6,) receives the closed-form start, to fall back on.
    """
    lobes, theta, work, setting = scratch.lobes, scratch.theta, scratch.work, scratch.setting
    nodes = scratch.nodes
    count = gather_lobes(base, strata, column, row, lobes, diffuse_moment)
    red, green, blue, some = normalise_mixture(lobes, count)
    isotropic = search.free & 2 == 0
    flat = closed_forms(lobes, count, base.isotropic, scratch.starts, isotropic)
    report[EVALUATIONS] = 0.0
    report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
    report[RESIDUAL], report[DISAGREEMENT] = 0.0, 0.0
    if flat and search.same_model:
        for p in range(PARAMETERS):
            theta[p] = scratch.starts[0, p]
            scratch.best[p] = theta[p]
        clamp_to_domain(theta, search)
        return FLAT if some else NO_SPECULAR
    if not last_rule and coarse_share(lobes, count, base.isotropic, strata.x.size) > search.coarse:
        return TOO_COARSE
    place_nodes(lobes, count, base.isotropic, points, search.exponent, nodes, work)
    normalise_shapes(lobes, count, base.has_shape, source_log_normalisation)
    tabulate_kernel(lobes, count, base.isotropic, base.grey, nodes, work)
    weigh_nodes(nodes)
    norm = target_norm(nodes)
    report[TARGET_NORM] = norm
    colour = scratch.colour
    colour[0], colour[1], colour[2] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
    if not (some and colour[0] + colour[1] + colour[2] > 0.0):
        colour[0] = colour[1] = colour[2] = 1.0
    setting[HELD] = 1.0 if search.held else 0.0
    setting[2], setting[3] = search.log_low, search.log_high
    setting[4], setting[5] = search.shape_low, search.shape_high
    if not norm > 0.0:
        for p in range(PARAMETERS):
            theta[p] = scratch.starts[1, p]
            scratch.best[p] = theta[p]
        clamp_to_domain(theta, search)
        return FALLBACK if some else NO_SPECULAR
    aim(nodes, colour, norm, setting)
    status, value = search_from_starts(
        scratch, search, len(_START_SHARES) + 1, moments_kernel, values_kernel, log_normalisation, report
    )
    report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE] = colour[0], colour[1], colour[2]
    clamp_to_domain(theta, search)
    settle_scale(theta, nodes, setting, values_kernel, log_normalisation, scratch.values, work, report)
    if not search.held:
        # The best scale's colour may differ from the mean colour that the target was aimed with: aim again.
        r, g, b = report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE]
        dot = r * colour[0] + g * colour[1] + b * colour[2]
        lengths = (r * r + g * g + b * b) * (colour[0] ** 2 + colour[1] ** 2 + colour[2] ** 2)
        if lengths > 0.0 and dot * dot < 0.999 * lengths:
            colour[0], colour[1], colour[2] = r, g, b
            aim(nodes, colour, norm, setting)
            value = evaluate(theta, nodes, setting, moments_kernel, log_normalisation, work[0:6], work[120:168])
            value, evaluations, again = minimise(
                theta, value, search.free, nodes, setting, moments_kernel, log_normalisation,
                search.tolerance, search.iterations, work,
            )  # fmt: skip
            report[EVALUATIONS] += evaluations + 1
            clamp_to_domain(theta, search)
            settle_scale(theta, nodes, setting, values_kernel, log_normalisation, scratch.values, work, report)
    if not math.isfinite(report[RESIDUAL]):
        return FALLBACK
    return status if some else NO_SPECULAR


@kernel
def search_from_starts(scratch, search, available, moments_kernel, values_kernel, log_normalisation, report):
    """BFGS from the best of the closed-form starts (``search.starts`` of them at most); best end in scratch.theta."""
    starts, theta, work, setting, nodes = scratch.starts, scratch.theta, scratch.work, scratch.setting, scratch.nodes
    rows = available
    if search.free & FREE_NORMAL:
        # One more start: the narrowest tensor where the target is highest (separated peaks).
        red, green, blue, weight = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT]
        top, highest = 0, real(0.0)
        for j in range(nodes.shape[1]):
            height = red[j] + green[j] + blue[j]
            if height > highest and weight[j] > real(0.0):
                highest = height
                top = j
        if nodes[2, top] > 0.1:
            starts[rows, 0] = -nodes[0, top] / nodes[2, top]
            starts[rows, 1] = -nodes[1, top] / nodes[2, top]
            for p in range(2, PARAMETERS):
                starts[rows, p] = starts[available - 1, p]
            rows += 1
    for i in range(rows):
        starts[i, 5] = min(max(starts[i, 5], search.shape_low), search.shape_high)
        clamp_to_domain(starts[i], search)
        value = evaluate_value(starts[i], nodes, setting, values_kernel, log_normalisation, scratch.values, work)
        starts[i, 6] = value if math.isfinite(value) else 1e30
    report[EVALUATIONS] += rows
    best_value, best_status = 1e30, FALLBACK
    for turn in range(min(search.starts, rows)):
        i = 0
        for k in range(rows):
            if starts[k, 6] < starts[i, 6]:
                i = k
        if starts[i, 6] >= 1e30:
            break
        for p in range(PARAMETERS):
            scratch.start[p] = starts[i, p]
        if turn == 0:
            for p in range(PARAMETERS):
                scratch.best[p] = starts[i, p]
        starts[i, 6] = 1e30
        value = evaluate(scratch.start, nodes, setting, moments_kernel, log_normalisation, work[0:6], work[120:168])
        value, evaluations, status = minimise(
            scratch.start, value, search.free, nodes, setting, moments_kernel, log_normalisation,
            search.tolerance, search.iterations, work,
        )  # fmt: skip
        report[EVALUATIONS] += evaluations + 1
        if value < best_value:
            best_value, best_status = value, status
            for p in range(PARAMETERS):
                theta[p] = scratch.start[p]
    if best_value >= 1e30:
        for p in range(PARAMETERS):
            theta[p] = starts[1, p]
            scratch.best[p] = starts[1, p]
    return best_status, best_value
