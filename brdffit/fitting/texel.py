"""The fit of one texel: footprint, target, starts, search, check."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from brdffit._jit import inline, kernel, part
from brdffit.fitting.bfgs import FREE_ANISOTROPY, FREE_NORMAL, minimise
from brdffit.fitting.losses import L1, RELATIVE, ROUNDS, weigh_absolutely, weigh_relatively
from brdffit.fitting.scoring import (
    BLUE_SCALE,
    COVERAGE,
    DISAGREEMENT,
    EVALUATIONS,
    FILTERED,
    GREEN_SCALE,
    RED_SCALE,
    RESIDUAL,
    TARGET_NORM,
    aim,
    settle_scale,
    target_norm,
)
from brdffit.fitting.shortcuts import FLAT_EXCESS, NOT_KNOWN, closed_form, fitted_error
from brdffit.fitting.status import (
    CLOSED_FORM,
    CONVERGED,
    FALLBACK,
    FEW_NODES,
    FLAT,
    NO_SPECULAR,
    REFINED,
)
from brdffit.halfangle.apparent_lobe import (
    add_defensive_lobe,
    add_guard,
    gather_lobes,
    normalise_mixture,
    normalise_shapes,
)
from brdffit.halfangle.closed_forms import (
    DEFENSIVE_SHARE,
    LEAN,
    PEAK,
    STARTS,
    first_start,
    footprint_moments,
    further_starts,
    start_at_peak,
    widen_lobes,
    widen_round_lobes,
)
from brdffit.halfangle.frame import eigen_log
from brdffit.halfangle.objective import (
    HELD,
    LOG_HIGH,
    LOG_LOW,
    PARAMETERS,
    SHAPE_HIGH,
    SHAPE_LOW,
    evaluate,
)
from brdffit.halfangle.quadrature import frame_lobes, place_nodes, weigh_nodes
from brdffit.halfangle.response import Response

real = np.float32

# A mean spread below this (in units of the lobe's width) stretches lobes so little that round ones will do, whose table
# is cheaper: an error of 1e-6.
_NARROW_SPREAD = 0.002
# A lobe is hidden from nodes that miss (or overrate) what they should see of it by this share.
_HIDDEN, _LOST = 0.3, 0.6
# Samples are many for a footprint that has so many strata more than it has.
_FEW_STRATA = 16
#: How often a lobe that was found where no nodes stand may ask for nodes of its own.
GUARDS = 3
# Relative squared error (8 dB) at which a search is not believed to have found the best lobe.
_POOR = 0.15
# Squared cosine between the colour that a target was aimed with and the best scale's, above which they are the same.
_SAME_COLOUR = 0.999


class Search(NamedTuple):
    """How the search goes on, the same for all texels.

    ``free``: mask of what is fitted; ``exponent``: of z.h in the half-angle density; ``step``: how many lobe widths the
    normal may turn from one sample of the footprint to the next; ``tolerance``: share of the error that a step must
    still promise; bounds of the log eigenvalues and of the shape; ``same_model``: base and pyramid share a lobe model;
    ``trusted``: largest disagreement of two half rules, as a share of the residual, that is not refined;
    ``negligible``: disagreement (relative squared error) that never is; ``crowd``: samples a stratum, in the mean,
    above which the first rule is passed over (16 strata count for twice as many); ``floor``: relative squared error
    that few nodes, and an early stop, may cost a texel each; ``allowed``: that the closed form may; ``loss``: L2,
    RELATIVE or L1; ``usual``: the rule that a texel starts with; ``response``: the closed form's table.
    """

    free: int
    held: bool
    exponent: int
    step: float
    tolerance: float
    iterations: int
    log_low: float
    log_high: float
    shape_low: float
    shape_high: float
    same_model: bool
    trusted: float
    negligible: float
    crowd: int
    floor: float
    allowed: float
    loss: int
    usual: int
    response: Response


class Scratch(NamedTuple):
    """Arrays that a worker allocates once."""

    lobes: np.ndarray
    work: np.ndarray
    setting: np.ndarray
    theta: np.ndarray
    best: np.ndarray
    start: np.ndarray
    starts: np.ndarray
    colour: np.ndarray
    moment: np.ndarray
    moments: np.ndarray
    report: np.ndarray


class Rule(NamedTuple):
    """Points of a quadrature rule and one worker's arrays for it."""

    points: np.ndarray
    nodes: np.ndarray
    values: np.ndarray


@inline
def spared(floor, nodes):
    """Error up to which so few nodes will do: five parameters fitted to N of them follow their noise, about 5 e / N."""
    return floor * nodes / 5.0


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


@inline
def within_domain(theta, search):
    """Whether the log eigenvalues are within their bounds."""
    l1, l2, _, _ = eigen_log(theta[2], theta[3], theta[4])
    return l1 <= search.log_high and l2 >= search.log_low


@part
def fit_texel(
    base, strata, column, row, search, scratch, rules,
    tabulate_kernel, moments_kernel, values_kernel, log_normalisation, source_log_normalisation,
):  # fmt: skip
    """Fit one texel: its answer is left in ``scratch.theta``, the rest in ``scratch.report``; returns a status.

    Rules go from few nodes to many. A texel moves on where the two halves of a rule disagree by more than
    ``search.trusted`` of the residual, or where its nodes do not see the lobe that was found; that lobe then draws
    nodes of its own. ``scratch.best`` (6,) receives the closed-form start, to fall back on.
    """
    lobes, theta, report = scratch.lobes, scratch.theta, scratch.report
    count, spread = gather_lobes(
        base, strata, search.step, column, row, lobes[: lobes.shape[0] - GUARDS], scratch.moment
    )
    red, green, blue, some = normalise_mixture(lobes, count)
    for k in range(report.size):
        report[k] = 0.0
    expected = NOT_KNOWN
    if search.allowed > 0.0 and some and base.isotropic:
        expected = closed_form(
            lobes, count, base.grey, search.held, red, green, blue, search.response, search.allowed, theta, report,
            scratch.work,
        )  # fmt: skip
        if expected <= search.allowed and within_domain(theta, search):
            return FLAT if expected <= FLAT_EXCESS else CLOSED_FORM
    isotropic = search.free & FREE_ANISOTROPY == 0
    lobes_isotropic = base.isotropic
    if spread > _NARROW_SPREAD:
        widen_lobes(lobes, count, lobes_isotropic, base.widening)
        lobes_isotropic = False
    elif spread > 0.0 and lobes_isotropic:
        widen_round_lobes(lobes, count, base.widening)
    flat = footprint_moments(lobes, count, lobes_isotropic, scratch.moments)
    first_start(scratch.moments, isotropic, scratch.starts)
    colour = scratch.colour
    colour[0], colour[1], colour[2] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
    for k in range(3):
        report[RED_SCALE + k] = report[FILTERED + k] = colour[k]
    start = scratch.starts[LEAN]
    clamp_to_domain(start, search)
    for p in range(PARAMETERS):
        theta[p] = scratch.best[p] = start[p]
    if flat and search.same_model:
        return FLAT if some else NO_SPECULAR
    add_defensive_lobe(lobes, count, DEFENSIVE_SHARE, start[0], start[1], start[2], start[3], start[4])
    normalise_shapes(lobes, count, base.has_shape, source_log_normalisation)
    crowded = count > search.crowd * (_FEW_STRATA + strata.x.size * strata.y.size)
    tier = search.usual + 1 if crowded else search.usual
    spare = spared(search.floor, rules[0].points.shape[1])
    if not crowded and fitted_error(expected) <= spare:
        tier = 0
    guards = 0
    while True:
        # A refined texel has separated peaks more often than not: the highest is worth a search of its own.
        follow = 2 if tier > search.usual else 1
        status = fit_by_rule(
            base, lobes, count, lobes_isotropic, some, scratch, rules[tier], search, follow,
            tabulate_kernel, moments_kernel, values_kernel, log_normalisation,
        )  # fmt: skip
        hidden = abs(report[COVERAGE] - 1.0) > _HIDDEN
        doubtful = report[DISAGREEMENT] > search.trusted * report[RESIDUAL] + max(search.negligible, search.floor)
        if tier < search.usual and report[RESIDUAL] > spare and not doubtful and not hidden:
            # Only more nodes than a tolerance spared: the search goes on from where it ended.
            doubtful = True
            for p in range(PARAMETERS):
                scratch.starts[LEAN, p] = theta[p]
        if hidden and guards < GUARDS:
            if lobes_isotropic:
                widen_lobes(lobes, count, lobes_isotropic, base.widening)
                lobes_isotropic = False
            add_guard(lobes, count, theta)
            count += 1
            guards += 1
        elif not doubtful or tier == len(rules) - 1:
            break
        tier = min(tier + 1, len(rules) - 1)
    if status == CONVERGED and tier != search.usual:
        status = REFINED if tier > search.usual else FEW_NODES
    if abs(report[COVERAGE] - 1.0) > _LOST:
        # Still out of sight of its nodes: nothing that they say of it counts.
        status = FALLBACK
        fall_back(scratch, rules[tier], search, values_kernel, log_normalisation)
    if not some:
        report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE] = 0.0, 0.0, 0.0
        return NO_SPECULAR
    if search.held and report[FILTERED] + report[FILTERED + 1] + report[FILTERED + 2] <= 0.0:
        # Negative filter weights leave no colour to hold: black, and all of the target is missed.
        report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE] = 0.0, 0.0, 0.0
        report[RESIDUAL] = 1.0
    return status


@part
def fall_back(scratch, rule, search, values_kernel, log_normalisation):
    """The closed-form start with the filtered colour, and its residual on the nodes of a rule."""
    theta, setting, report = scratch.theta, scratch.setting, scratch.report
    for p in range(PARAMETERS):
        theta[p] = scratch.best[p]
    for k in range(3):
        report[k] = report[FILTERED + k]
    setting[HELD] = 1.0
    settle_scale(
        theta, rule.nodes, setting, values_kernel, log_normalisation, rule.values, search.exponent, scratch.work, report
    )


@part
def fit_by_rule(
    base, lobes, count, lobes_isotropic, some, scratch, rule, search, follow,
    tabulate_kernel, moments_kernel, values_kernel, log_normalisation,
):  # fmt: skip
    """Place the nodes of one rule, fill its table, fit from the first ``follow`` starts at least. Returns a status."""
    frame_lobes(lobes, count, lobes_isotropic)
    place_nodes(lobes, count, rule.points, search.exponent, rule.nodes)
    tabulate_kernel(lobes, count, lobes_isotropic, base.grey, rule.nodes)
    weigh_nodes(rule.nodes)
    if search.loss == RELATIVE:
        weigh_relatively(rule.nodes)
    colour = scratch.colour
    for k in range(3):
        colour[k] = scratch.report[FILTERED + k]
    if not some or colour[0] + colour[1] + colour[2] <= 0.0:
        colour[0] = colour[1] = colour[2] = 1.0
    status = fit_on_nodes(scratch, rule, search, follow, moments_kernel, values_kernel, log_normalisation)
    if search.loss == L1 and status != FALLBACK:
        report = scratch.report
        for _ in range(ROUNDS):
            weigh_absolutely(rule.nodes, rule.values, report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE])
            report[TARGET_NORM] = max(target_norm(rule.nodes), 1e-30)
            go_on(scratch, rule, search, moments_kernel, values_kernel, log_normalisation)
    return status


@kernel
def go_on(scratch, rule, search, moments_kernel, values_kernel, log_normalisation):
    """Aim at ``scratch.colour`` anew, search from where the last search ended, and settle."""
    theta, work, setting, report = scratch.theta, scratch.work, scratch.setting, scratch.report
    aim(rule.nodes, scratch.colour, report[TARGET_NORM], setting)
    value = evaluate(theta, rule.nodes, setting, moments_kernel, log_normalisation, work[0:6], work[120:168])
    _, evaluations, _ = minimise(
        theta, value, search.free, rule.nodes, setting, moments_kernel, log_normalisation,
        search.tolerance, search.floor, search.iterations, work,
    )  # fmt: skip
    report[EVALUATIONS] += evaluations + 1
    clamp_to_domain(theta, search)
    settle_scale(
        theta, rule.nodes, setting, values_kernel, log_normalisation, rule.values, search.exponent, work, report
    )


@part
def fit_on_nodes(scratch, rule, search, follow, moments_kernel, values_kernel, log_normalisation):
    """Fit the lobe to a full table; ``scratch.colour`` holds the filtered colour. Returns a status."""
    theta, work, setting, report, colour = scratch.theta, scratch.work, scratch.setting, scratch.report, scratch.colour
    nodes = rule.nodes
    norm = target_norm(nodes)
    if not norm > 0.0:
        return FALLBACK
    report[TARGET_NORM] = norm
    setting[HELD] = 1.0 if search.held else 0.0
    setting[LOG_LOW], setting[LOG_HIGH] = search.log_low, search.log_high
    setting[SHAPE_LOW], setting[SHAPE_HIGH] = search.shape_low, search.shape_high
    aim(nodes, colour, report[TARGET_NORM], setting)
    status = search_from_starts(scratch, nodes, search, follow, moments_kernel, log_normalisation)
    report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE] = colour[0], colour[1], colour[2]
    clamp_to_domain(theta, search)
    settle_scale(theta, nodes, setting, values_kernel, log_normalisation, rule.values, search.exponent, work, report)
    if not search.held:
        # The best scale's colour may differ from the mean colour that the target was aimed with: aim again.
        r, g, b = report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE]
        dot = r * colour[0] + g * colour[1] + b * colour[2]
        lengths = (r * r + g * g + b * b) * (colour[0] ** 2 + colour[1] ** 2 + colour[2] ** 2)
        if lengths > 0.0 and dot * dot < _SAME_COLOUR * lengths:
            colour[0], colour[1], colour[2] = r, g, b
            go_on(scratch, rule, search, moments_kernel, values_kernel, log_normalisation)
    if not math.isfinite(report[RESIDUAL]):
        report[RESIDUAL] = 1.0
        return FALLBACK
    return status


@part
def search_from_starts(scratch, nodes, search, follow, moments_kernel, log_normalisation):
    """BFGS from the first ``follow`` starts, and from more while the best end is poor; it is left in scratch.theta.

    Returns its status.
    """
    starts, theta, work, setting = scratch.starts, scratch.theta, scratch.work, scratch.setting
    best_value, best_status = 1e30, FALLBACK
    for i in range(STARTS):
        # A start too wide for its target sits on a plateau: it "converges" at once, at a large error. Try the next.
        if i >= follow and 1.0 + best_value < _POOR:
            break
        if i == 1:
            further_starts(scratch.moments, search.free & FREE_ANISOTROPY == 0, starts)
            if search.free & FREE_NORMAL:
                start_at_peak(nodes, starts[PEAK])
        if i > 0:
            clamp_to_domain(starts[i], search)
        for p in range(PARAMETERS):
            scratch.start[p] = starts[i, p]
            if i == 0:
                theta[p] = starts[i, p]
        value = evaluate(scratch.start, nodes, setting, moments_kernel, log_normalisation, work[0:6], work[120:168])
        scratch.report[EVALUATIONS] += 1
        if not math.isfinite(value):
            continue
        value, evaluations, status = minimise(
            scratch.start, value, search.free, nodes, setting, moments_kernel, log_normalisation,
            search.tolerance, search.floor, search.iterations, work,
        )  # fmt: skip
        scratch.report[EVALUATIONS] += evaluations
        if value < best_value:
            best_value, best_status = value, status
            for p in range(PARAMETERS):
                theta[p] = scratch.start[p]
    return best_status
