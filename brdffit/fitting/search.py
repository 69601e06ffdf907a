"""The search on a tabulated target: its starts, when further ones are tried, and the choice of the best end."""

from __future__ import annotations

import math
from typing import NamedTuple

from numpy.typing import NDArray

from brdffit._jit import inline, kernel, part
from brdffit.fitting.bfgs import FREE_ANISOTROPY, FREE_NORMAL, Space, minimise
from brdffit.fitting.losses import DISPLAYED, SEEN, set_diffuse_error
from brdffit.fitting.scoring import (
    BLUE_SCALE,
    EVALUATIONS,
    GREEN_SCALE,
    RED_SCALE,
    RESIDUAL,
    TARGET_NORM,
    aim,
    settle_scale,
    target_norm,
)
from brdffit.fitting.status import FALLBACK
from brdffit.halfangle.closed_forms import (
    PEAK,
    SHAPES,
    SHRINK,
    STARTS,
    STEEPEST_SLOPE,
    XX,
    YY,
    further_starts,
    start_at_peak,
)
from brdffit.halfangle.frame import eigen_log
from brdffit.halfangle.lights import LOBE_BLUR, evaluate_table, segment
from brdffit.halfangle.merging import Cells
from brdffit.halfangle.objective import (
    DIFFUSE,
    DIFFUSE_FORM,
    ENERGY,
    FREE,
    HELD,
    LOG_HIGH,
    LOG_LOW,
    PARAMETERS,
    SCALE_HIGH,
    SCALE_LOW,
    SHAPE_HIGH,
    SHAPE_LOW,
)
from brdffit.halfangle.quadrature import BLUE, GREEN, H_X, H_Y, H_Z, RED, WEIGHT
from brdffit.halfangle.response import Response

#: Relative squared error above which a lobe misses most of its target, even if the search converged.
BESIDE = 0.5
# Where the search misses its target: how many of its peaks are tried, how far apart they must be (in squared widths of
# the narrow lobe as the smallest light shows it), and what is added to the narrow lobe's log alpha^2 for each start.
_PEAKS, _APART, _WIDER = 3, 16.0, (0.0, 1.5, 3.0)
# Squared cosine between the colour of the scalar target and that of the best scale, above which both count as equal.
_SAME_COLOUR = 0.999


class Search(NamedTuple):
    """Settings of the search, the same for all texels of a level.

    Attributes:
        free: mask of the fitted parameters (brdffit.fitting.bfgs).
        scale: FREE, HOLDS or BOUNDED (brdffit.halfangle.objective).
        scale_low, scale_high: bounds of a bounded scale, in units of the filtered colour.
        energy: weight of a light from everywhere, which sees only a lobe's energy.
        exponent: of z.h in the half-angle density, 1 or 3.
        step: lobe widths by which the normal may turn from one sample of the footprint to the next.
        tolerance: share of the error; the search stops when its next step promises less.
        iterations: most steps of one search.
        log_low, log_high, shape_low, shape_high: bounds of the log eigenvalues and of the shape.
        same_model: whether base and pyramid share a lobe model.
        trusted: disagreement of the two halves of a rule, as a share of the residual, above which a texel gets more
            nodes.
        negligible: disagreement (relative squared error) below which it never does.
        crowd: a footprint with more samples than this times (16 + its strata) skips the first rule.
        floor: relative squared error that few nodes and an early stop may each add to a texel.
        allowed: relative squared error that the closed form may add.
        loss: a code of brdffit.fitting.losses.
        dark, squares: share of the mean light in DISPLAYED's denominator, weight of the squared error beside it.
        within: factor of the squared error of LEAN's lobe that the fit's may have, 0 for any
            (brdffit.fitting.near_lean).
        sky: weight of an even sky in the fit of the diffuse colour; the rest is point lights.
        poor: relative squared error above which further starts are tried.
        rescaled: whether the first step scales the first inverse Hessian.
        rendered: whether a bounded scale makes up for light that a lobe loses to masking (brdffit.halfangle.albedo).
        usual: index of the rule that a texel starts with, unless a tolerance lets it start with fewer nodes.
        cell: side of a cell of merged lobes, in widths of a lobe as each light shows it (0: nothing is merged).
        response: table of the closed form.
    """

    free: int
    scale: float
    scale_low: float
    scale_high: float
    energy: float
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
    dark: float
    squares: float
    within: float
    sky: float
    poor: float
    rescaled: bool
    rendered: bool
    usual: int
    cell: float
    response: Response


class Scratch(NamedTuple):
    """Arrays that a worker allocates once.

    ``lobes`` (S, room, LOBE_COLUMNS) and their ``counts`` (S,) for each size of light; ``theta`` (6,) the current
    answer, ``best`` the closed-form start, ``average`` the averaged lobe, ``start`` and ``starts`` of searches;
    ``colour`` (3,) of the scalar target; ``moment`` the diffuse moments, ``moments`` those of the lobes; ``report`` as
    named in brdffit.fitting.scoring. The rest is scratch.
    """

    lobes: NDArray
    counts: NDArray
    cells: Cells
    space: Space
    work: NDArray
    setting: NDArray
    theta: NDArray
    best: NDArray
    average: NDArray
    start: NDArray
    starts: NDArray
    colour: NDArray
    moment: NDArray
    moments: NDArray
    report: NDArray


@inline
def clamp_to_domain(theta, search):
    """Clamp the eigenvalues and the shape to their bounds: the walls of the objective leave them a little outside."""
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


@kernel
def search_on(scratch, table, search, moments_kernel, values_kernel, log_normalisation):
    """Set the scalar target for ``scratch.colour``, search from where the last search ended, and settle the scale."""
    theta, space, setting, report = scratch.theta, scratch.space, scratch.setting, scratch.report
    aim(table, scratch.colour, report[TARGET_NORM], setting)
    value = evaluate_table(theta, table, setting, moments_kernel, log_normalisation, space.gradient, space.evaluation)
    _, evaluations, _ = minimise(
        theta, value, search.free, table, setting, moments_kernel, log_normalisation,
        search.tolerance, search.floor, search.iterations, search.rescaled, space, 1e30,
    )  # fmt: skip
    report[EVALUATIONS] += evaluations + 1
    clamp_to_domain(theta, search)
    settle_scale(theta, table, setting, values_kernel, log_normalisation, search.exponent, scratch.work, report)


@part
def fit_on_nodes(scratch, table, search, follow, warm, moments_kernel, values_kernel, log_normalisation):
    """Fit the lobe to a tabulated target; ``scratch.colour`` holds the filtered colour. Returns a status."""
    theta, setting, report, colour = scratch.theta, scratch.setting, scratch.report, scratch.colour
    norm = target_norm(table)
    if not norm > 0.0:
        return FALLBACK
    report[TARGET_NORM] = norm
    setting[HELD], setting[ENERGY] = search.scale, search.energy
    setting[SCALE_LOW], setting[SCALE_HIGH] = search.scale_low, search.scale_high
    setting[LOG_LOW], setting[LOG_HIGH] = search.log_low, search.log_high
    setting[SHAPE_LOW], setting[SHAPE_HIGH] = search.shape_low, search.shape_high
    sees_diffuse = search.sky > 0.0 and (search.loss == SEEN or search.loss == DISPLAYED)
    set_diffuse_error(table, scratch.moment, norm if sees_diffuse else 0.0, setting[DIFFUSE : DIFFUSE + DIFFUSE_FORM])
    aim(table, colour, report[TARGET_NORM], setting)
    status = search_from_starts(scratch, table, search, follow, warm, moments_kernel, log_normalisation)
    report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE] = colour[0], colour[1], colour[2]
    clamp_to_domain(theta, search)
    settle_scale(theta, table, setting, values_kernel, log_normalisation, search.exponent, scratch.work, report)
    if search.scale == FREE:
        # The best scale's colour may differ from the filtered colour of the scalar target: search once more with it.
        r, g, b = report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE]
        dot = r * colour[0] + g * colour[1] + b * colour[2]
        lengths = (r * r + g * g + b * b) * (colour[0] ** 2 + colour[1] ** 2 + colour[2] ** 2)
        if lengths > 0.0 and dot * dot < _SAME_COLOUR * lengths:
            colour[0], colour[1], colour[2] = r, g, b
            search_on(scratch, table, search, moments_kernel, values_kernel, log_normalisation)
    if not math.isfinite(report[RESIDUAL]):
        report[RESIDUAL] = 1.0
        return FALLBACK
    return status


@part
def search_from_starts(scratch, table, search, follow, warm, moments_kernel, log_normalisation):
    """BFGS from the first ``follow`` starts, and from further ones while the best end is poor.

    The best end is left in ``scratch.theta``; returns its status. If ``warm``, the search starts from there first, and
    other starts are given up as soon as they promise no more.
    """
    starts, theta, space, setting = scratch.starts, scratch.theta, scratch.space, scratch.setting
    best_value, best_status = 1e30, FALLBACK
    sized = table.lights[0, LOBE_BLUR] > 0.0
    if warm:
        value = evaluate_table(
            theta, table, setting, moments_kernel, log_normalisation, space.gradient, space.evaluation
        )
        scratch.report[EVALUATIONS] += 1
        if math.isfinite(value):
            best_value, evaluations, best_status = minimise(
                theta, value, search.free, table, setting, moments_kernel, log_normalisation,
                search.tolerance, search.floor, search.iterations, search.rescaled, space, 1e30,
            )  # fmt: skip
            scratch.report[EVALUATIONS] += evaluations
    for i in range(STARTS):
        # A start too wide for its target lies on a plateau and "converges" at once, at a large error: try the next.
        if i >= follow and 1.0 + best_value < search.poor:
            break
        if i == 1:
            further_starts(scratch.moments, search.free & FREE_ANISOTROPY == 0, starts)
            if search.free & FREE_NORMAL:
                start_at_peak(segment(table, 0), starts[PEAK])
        if i > 0:
            clamp_to_domain(starts[i], search)
        for p in range(PARAMETERS):
            scratch.start[p] = starts[i, p]
            if i == 0 and not best_value < 1e30:
                theta[p] = starts[i, p]
        value = evaluate_table(
            scratch.start, table, setting, moments_kernel, log_normalisation, space.gradient, space.evaluation
        )
        scratch.report[EVALUATIONS] += 1
        if not math.isfinite(value):
            continue
        bar = best_value if sized else 1e30
        value, evaluations, status = minimise(
            scratch.start, value, search.free, table, setting, moments_kernel, log_normalisation,
            search.tolerance, search.floor, search.iterations, search.rescaled, space, bar,
        )  # fmt: skip
        scratch.report[EVALUATIONS] += evaluations
        if value < best_value:
            best_value, best_status = value, status
            for p in range(PARAMETERS):
                theta[p] = scratch.start[p]
    if follow >= STARTS and 1.0 + best_value > BESIDE and search.free & FREE_NORMAL:
        best_status = search_from_peaks(
            scratch, table, search, best_value, best_status, moments_kernel, log_normalisation
        )
    return best_status


@kernel
def search_from_peaks(scratch, table, search, best_value, best_status, moments_kernel, log_normalisation):
    """BFGS from the highest separate peaks of the target, each from the best of a few widths.

    Where a footprint consists of sharp, separate peaks, the best lobe lies on one of them or on a cluster, and the
    gradient elsewhere does not lead there. Returns the status of the best end.
    """
    theta, start, space, setting = scratch.theta, scratch.start, scratch.space, scratch.setting
    nodes, trial = segment(table, 0), scratch.starts[PEAK]
    sized = table.lights[0, LOBE_BLUR] > 0.0
    red, green, blue, weight = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT]
    narrow = math.log(max(0.5 * scratch.moments[SHRINK] * (scratch.moments[XX] + scratch.moments[YY]), 1e-12))
    apart = _APART * (math.exp(narrow) + table.lights[0, LOBE_BLUR])
    found = scratch.work[24 : 24 + 3 * _PEAKS].reshape(_PEAKS, 3)
    for k in range(_PEAKS):
        top, highest = -1, 0.0
        for j in range(nodes.shape[1]):
            height = red[j] + green[j] + blue[j]
            if not (height > highest and weight[j] > 0.0 and nodes[H_Z, j] > 1.0 / STEEPEST_SLOPE):
                continue
            near = False
            for m in range(k):
                d_x, d_y, d_z = nodes[H_X, j] - found[m, 0], nodes[H_Y, j] - found[m, 1], nodes[H_Z, j] - found[m, 2]
                near = near or d_x * d_x + d_y * d_y + d_z * d_z < apart
            if not near:
                top, highest = j, height
        if top < 0:
            break
        found[k, 0], found[k, 1], found[k, 2] = nodes[H_X, top], nodes[H_Y, top], nodes[H_Z, top]
        least = 1e30
        for m in range(len(_WIDER)):
            trial[0], trial[1] = -found[k, 0] / found[k, 2], -found[k, 1] / found[k, 2]
            trial[2] = trial[3] = narrow + _WIDER[m]
            trial[4], trial[5] = 0.0, scratch.moments[SHAPES]
            clamp_to_domain(trial, search)
            value = evaluate_table(
                trial, table, setting, moments_kernel, log_normalisation, space.gradient, space.evaluation
            )
            if value < least:
                least = value
                for p in range(PARAMETERS):
                    start[p] = trial[p]
        value = evaluate_table(
            start, table, setting, moments_kernel, log_normalisation, space.gradient, space.evaluation
        )
        scratch.report[EVALUATIONS] += len(_WIDER) + 1
        if not math.isfinite(value):
            continue
        bar = best_value if sized else 1e30
        value, evaluations, status = minimise(
            start, value, search.free, table, setting, moments_kernel, log_normalisation,
            search.tolerance, search.floor, search.iterations, search.rescaled, space, bar,
        )  # fmt: skip
        scratch.report[EVALUATIONS] += evaluations
        if value < best_value:
            best_value, best_status = value, status
            for p in range(PARAMETERS):
                theta[p] = start[p]
    return best_status
