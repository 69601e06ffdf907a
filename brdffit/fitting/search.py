"""The search on a full table: from which starts, how often, and what is made of the best end."""

from __future__ import annotations

import math
from typing import NamedTuple

from numpy.typing import NDArray

from brdffit._jit import inline, kernel, part
from brdffit.fitting.bfgs import FREE_ANISOTROPY, FREE_NORMAL, Space, minimise
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

#: Relative squared error of a lobe beside its target, whatever the gradient says.
BESIDE = 0.5
# Peaks of the target that a search beside it tries, how far apart (in widths of the narrow lobe, squared), and by which
# factors of log alpha^2 wider than the narrow lobe it starts there.
_PEAKS, _APART, _WIDER = 3, 16.0, (0.0, 1.5, 3.0)
# Squared cosine between the colour that a target was aimed with and the best scale's, above which they are the same.
_SAME_COLOUR = 0.999


class Search(NamedTuple):
    """How the search goes on, the same for all texels.

    ``free``: mask of what is fitted; ``scale``: what holds the scale (``FREE``, ``HOLDS``, ``BOUNDED``), and its least
    and greatest value in units of the filtered colour's; ``energy``: share of a sky that sees the energy alone;
    ``exponent``: of z.h in the half-angle density; ``step``: how many lobe widths the normal may turn from one sample
    of the footprint to the next; ``tolerance``: share of the error that a step must still promise; bounds of the log
    eigenvalues and of the shape; ``same_model``: base and pyramid share a lobe model; ``trusted``: largest disagreement
    of two half rules, as a share of the residual, that is not refined; ``negligible``: disagreement (relative squared
    error) that never is; ``crowd``: samples a stratum, in the mean, above which the first rule is passed over (16
    strata count for twice as many); ``floor``: relative squared error that few nodes, and an early stop, may cost a
    texel each; ``allowed``: that the closed form may; ``loss``: a code of brdffit.fitting.losses; ``sky``: share of an
    even sky in what the diffuse colour is fitted to; ``poor``: relative squared error above which further starts are
    tried; ``rescaled``: whether the first inverse Hessian is scaled by the first step; ``rendered``: whether a bounded
    scale makes good what a lobe loses as it is rendered (brdffit.halfangle.albedo); ``usual``: the rule that a texel
    starts with; ``cell``: how many widths of a lobe, as the smallest light shows it, the normals of a cell of merged
    lobes may span (0: none are merged); ``response``: the closed form's table.
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
    sky: float
    poor: float
    rescaled: bool
    rendered: bool
    usual: int
    cell: float
    response: Response


class Scratch(NamedTuple):
    """Arrays that a worker allocates once: ``lobes`` (S, room, LOBE_COLUMNS) and how many there are, a size of light;
    the rest as in ``fit_texel``."""

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


@kernel
def search_on(scratch, table, search, moments_kernel, values_kernel, log_normalisation):
    """Aim at ``scratch.colour`` anew, search from where the last search ended, and settle."""
    theta, space, setting, report = scratch.theta, scratch.space, scratch.setting, scratch.report
    aim(table, scratch.colour, report[TARGET_NORM], setting)
    value = evaluate_table(theta, table, setting, moments_kernel, log_normalisation, space.gradient, space.evaluation)
    _, evaluations, _ = minimise(
        theta, value, search.free, table, setting, moments_kernel, log_normalisation,
        search.tolerance, search.floor, search.iterations, search.rescaled, space,
    )  # fmt: skip
    report[EVALUATIONS] += evaluations + 1
    clamp_to_domain(theta, search)
    settle_scale(theta, table, setting, values_kernel, log_normalisation, search.exponent, scratch.work, report)


@part
def fit_on_nodes(scratch, table, search, follow, moments_kernel, values_kernel, log_normalisation):
    """Fit the lobe to a full table; ``scratch.colour`` holds the filtered colour. Returns a status."""
    theta, setting, report, colour = scratch.theta, scratch.setting, scratch.report, scratch.colour
    norm = target_norm(table)
    if not norm > 0.0:
        return FALLBACK
    report[TARGET_NORM] = norm
    setting[HELD], setting[ENERGY] = search.scale, search.energy
    setting[SCALE_LOW], setting[SCALE_HIGH] = search.scale_low, search.scale_high
    setting[LOG_LOW], setting[LOG_HIGH] = search.log_low, search.log_high
    setting[SHAPE_LOW], setting[SHAPE_HIGH] = search.shape_low, search.shape_high
    aim(table, colour, report[TARGET_NORM], setting)
    status = search_from_starts(scratch, table, search, follow, moments_kernel, log_normalisation)
    report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE] = colour[0], colour[1], colour[2]
    clamp_to_domain(theta, search)
    settle_scale(theta, table, setting, values_kernel, log_normalisation, search.exponent, scratch.work, report)
    if search.scale == FREE:
        # The best scale's colour may differ from the mean colour that the target was aimed with: aim again.
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
def search_from_starts(scratch, table, search, follow, moments_kernel, log_normalisation):
    """BFGS from the first ``follow`` starts, and from more while the best end is poor; it is left in scratch.theta.

    Returns its status.
    """
    starts, theta, space, setting = scratch.starts, scratch.theta, scratch.space, scratch.setting
    best_value, best_status = 1e30, FALLBACK
    for i in range(STARTS):
        # A start too wide for its target sits on a plateau: it "converges" at once, at a large error. Try the next.
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
            if i == 0:
                theta[p] = starts[i, p]
        value = evaluate_table(
            scratch.start, table, setting, moments_kernel, log_normalisation, space.gradient, space.evaluation
        )
        scratch.report[EVALUATIONS] += 1
        if not math.isfinite(value):
            continue
        value, evaluations, status = minimise(
            scratch.start, value, search.free, table, setting, moments_kernel, log_normalisation,
            search.tolerance, search.floor, search.iterations, search.rescaled, space,
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
    """BFGS from the highest separate peaks of the target, each from the best of a few widths; returns the best status.

    Where a footprint is made of needles, the best lobe stands on one of them or on a cluster, and a descent from
    anywhere else finds no slope that leads there.
    """
    theta, start, space, setting = scratch.theta, scratch.start, scratch.space, scratch.setting
    nodes, trial = segment(table, 0), scratch.starts[PEAK]
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
        value, evaluations, status = minimise(
            start, value, search.free, table, setting, moments_kernel, log_normalisation,
            search.tolerance, search.floor, search.iterations, search.rescaled, space,
        )  # fmt: skip
        scratch.report[EVALUATIONS] += evaluations
        if value < best_value:
            best_value, best_status = value, status
            for p in range(PARAMETERS):
                theta[p] = start[p]
    return best_status
