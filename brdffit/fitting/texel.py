"""The fit of one texel: footprint, target, starts, search, check."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from brdffit._jit import inline, kernel
from brdffit.fitting.bfgs import FREE_NORMAL, minimise
from brdffit.fitting.status import (
    FALLBACK,
    FLAT,
    NO_SPECULAR,
)
from brdffit.halfangle.apparent_lobe import (
    Strata,
    add_defensive_lobe,
    gather_lobes,
    normalise_mixture,
    normalise_shapes,
)
from brdffit.halfangle.closed_forms import (
    DEFENSIVE_SHARE,
    LEAN,
    PEAK,
    STARTS,
    STEEPEST_SLOPE,
    VMF,
    closed_forms,
    coarse_share,
    widen_lobes,
)
from brdffit.halfangle.frame import eigen_log
from brdffit.halfangle.objective import (
    HELD,
    PARAMETERS,
    SCALE,
    TARGET,
    evaluate,
)
from brdffit.halfangle.quadrature import (
    BLUE,
    GREEN,
    H_X,
    H_Y,
    H_Z,
    RED,
    WEIGHT,
    place_nodes,
    weigh_nodes,
)

real = np.float32

# What a fit reports of itself, besides its parameters.
RED_SCALE, GREEN_SCALE, BLUE_SCALE, RESIDUAL, DISAGREEMENT, EVALUATIONS, TARGET_NORM, FILTERED = range(8)
# The filtered colour, (red, green, blue) from FILTERED on; 0 where a negative filter weight makes it negative.
REPORT = FILTERED + 3

# A mean squared step between samples below this (in units of the lobe's width) would widen lobes by less than 1%.
_NARROW_STEP = 0.03

#: What ``fit_texel`` returns when the rule's strata are too coarse for the footprint; never a texel's final status.
TOO_COARSE = 255


class Search(NamedTuple):
    """How the search goes on, the same for all texels.

    ``free``: mask of what is fitted; ``exponent``: of z.h in the half-angle density; ``tolerance``: of the error the
    model still promises to remove when it stops; ``starts``: how many are followed to the end; bounds of the log
    eigenvalues and of the shape; ``same_model``: base and pyramid share a lobe model; ``trusted``: largest
    disagreement of two half rules, as a share of the residual, that is not refined; ``coarse``: largest share of the
    energy in samples further than a lobe's width from the next; ``negligible``: disagreement (relative squared error)
    that is never refined; ``last_doubt``: last rule that a disagreement can lead to.
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
    negligible: float
    last_doubt: int


class Workplace(NamedTuple):
    """A rule, and the arrays that a worker allocates for it once."""

    strata: Strata
    points: np.ndarray
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
def fit_texel(
    base, scratch, column, row, search, tier, last, diffuse_moment, report,
    tabulate_kernel, moments_kernel, values_kernel, log_normalisation, source_log_normalisation,
):  # fmt: skip
    """Fit one texel with one rule. The answer is left in ``scratch.theta``, the rest in ``report``; returns a status.

    Returns TOO_COARSE at once where the strata are too wide for the lobes, unless this is the ``last`` rule.
    ``scratch.best`` (6,) receives the closed-form start, to fall back on.
    """
    lobes, theta, work, setting = scratch.lobes, scratch.theta, scratch.work, scratch.setting
    nodes, strata, points = scratch.nodes, scratch.strata, scratch.points
    count = gather_lobes(base, strata, column, row, lobes, diffuse_moment)
    red, green, blue, some = normalise_mixture(lobes, count)
    isotropic = search.free & 2 == 0
    isotropic_base = base.isotropic
    flat = closed_forms(lobes, count, isotropic_base, scratch.starts, isotropic)
    report[EVALUATIONS] = 0.0
    report[FILTERED], report[FILTERED + 1], report[FILTERED + 2] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
    for k in range(3):
        report[RED_SCALE + k] = report[FILTERED + k]
    report[RESIDUAL], report[DISAGREEMENT] = 0.0, 0.0
    if flat and search.same_model:
        for p in range(PARAMETERS):
            theta[p] = scratch.starts[0, p]
            scratch.best[p] = theta[p]
        clamp_to_domain(theta, search)
        return FLAT if some else NO_SPECULAR
    if strata.jitter_x == 0.0 and strata.jitter_y == 0.0:
        share, mean_step = coarse_share(lobes, count, isotropic_base, strata.x.size)
        if not last and share > search.coarse:
            return TOO_COARSE
        if mean_step > _NARROW_STEP:
            widen_lobes(lobes, count, isotropic_base, strata.x.size)
            isotropic_base = False
            closed_forms(lobes, count, isotropic_base, scratch.starts, isotropic)
    clamp_to_domain(scratch.starts[LEAN], search)
    start = scratch.starts[LEAN]
    add_defensive_lobe(lobes, count, DEFENSIVE_SHARE, start[0], start[1], start[2], start[3], start[4])
    place_nodes(lobes, count, isotropic_base, points, search.exponent, nodes, work)
    normalise_shapes(lobes, count, base.has_shape, source_log_normalisation)
    tabulate_kernel(lobes, count, isotropic_base, base.grey, nodes, work)
    weigh_nodes(nodes)
    norm = target_norm(nodes)
    report[TARGET_NORM] = norm
    colour = scratch.colour
    colour[0], colour[1], colour[2] = report[FILTERED], report[FILTERED + 1], report[FILTERED + 2]
    if not (some and colour[0] + colour[1] + colour[2] > 0.0):
        colour[0] = colour[1] = colour[2] = 1.0
    setting[HELD] = 1.0 if search.held else 0.0
    setting[2], setting[3] = search.log_low, search.log_high
    setting[4], setting[5] = search.shape_low, search.shape_high
    if not norm > 0.0:
        for p in range(PARAMETERS):
            theta[p] = scratch.starts[VMF, p]
            scratch.best[p] = theta[p]
        clamp_to_domain(theta, search)
        return FALLBACK if some else NO_SPECULAR
    aim(nodes, colour, norm, setting)
    # A refined texel has separated peaks more often than not: the highest of them is worth a search of its own.
    follow = min(search.starts + (1 if tier > 0 else 0), STARTS)
    status, value = search_from_starts(scratch, search, follow, moments_kernel, log_normalisation, report)
    for k in range(3):
        report[RED_SCALE + k] = report[FILTERED + k] if some else 1.0
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
    if not some:
        # Fitted as if white; it reflects nothing all the same.
        report[RED_SCALE] = report[GREEN_SCALE] = report[BLUE_SCALE] = 0.0
    if not math.isfinite(report[RESIDUAL]):
        report[RESIDUAL] = 1.0
        return FALLBACK
    return status if some else NO_SPECULAR


@kernel
def search_from_starts(scratch, search, follow, moments_kernel, log_normalisation, report):
    """BFGS from the first ``follow`` starts; the best end is left in scratch.theta. Returns (status, value)."""
    starts, theta, work, setting, nodes = scratch.starts, scratch.theta, scratch.work, scratch.setting, scratch.nodes
    if search.free & FREE_NORMAL and follow > PEAK:
        red, green, blue, weight = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT]
        top, highest = 0, real(0.0)
        for j in range(nodes.shape[1]):
            height = red[j] + green[j] + blue[j]
            if height > highest and weight[j] > real(0.0):
                highest = height
                top = j
        if nodes[H_Z, top] > 1.0 / STEEPEST_SLOPE:
            starts[PEAK, 0] = -nodes[H_X, top] / nodes[H_Z, top]
            starts[PEAK, 1] = -nodes[H_Y, top] / nodes[H_Z, top]
    best_value, best_status = 1e30, FALLBACK
    for i in range(follow):
        clamp_to_domain(starts[i], search)
        for p in range(PARAMETERS):
            scratch.start[p] = starts[i, p]
            if i == 0:
                scratch.best[p] = theta[p] = starts[i, p]
        value = evaluate(scratch.start, nodes, setting, moments_kernel, log_normalisation, work[0:6], work[120:168])
        report[EVALUATIONS] += 1
        if not math.isfinite(value):
            continue
        value, evaluations, status = minimise(
            scratch.start, value, search.free, nodes, setting, moments_kernel, log_normalisation,
            search.tolerance, search.iterations, work,
        )  # fmt: skip
        report[EVALUATIONS] += evaluations
        if value < best_value:
            best_value, best_status = value, status
            for p in range(PARAMETERS):
                theta[p] = scratch.start[p]
    return best_status, best_value
