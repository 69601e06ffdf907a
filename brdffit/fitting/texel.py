"""The fit of one texel: footprint, target, starts, search, check."""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, part
from brdffit.fitting.alike import SHARP, prefer_average, take_if_alike
from brdffit.fitting.bfgs import FREE_ANISOTROPY
from brdffit.fitting.losses import (
    DISPLAYED,
    L1,
    RELATIVE,
    ROUNDS,
    SEEN,
    add_squares,
    weigh_absolutely,
    weigh_as_seen,
    weigh_relatively,
)
from brdffit.fitting.near_lean import stay_near_lean
from brdffit.fitting.scoring import (
    ALBEDO,
    BLUE_SCALE,
    COVERAGE,
    DISAGREEMENT,
    FILTERED,
    GREEN_SCALE,
    RED_SCALE,
    RESIDUAL,
    TARGET_NORM,
    settle_scale,
    share_out,
    target_norm,
)
from brdffit.fitting.search import BESIDE, clamp_to_domain, fit_on_nodes, search_on, within_domain
from brdffit.fitting.shortcuts import (
    FLAT_EXCESS,
    NOT_KNOWN,
    closed_form,
    fitted_error,
)
from brdffit.fitting.status import (
    CLOSED_FORM,
    CONVERGED,
    FALLBACK,
    FEW_NODES,
    FLAT,
    NO_SPECULAR,
    POOR,
    REFINED,
)
from brdffit.halfangle.albedo import albedo_of_lobes
from brdffit.halfangle.apparent_lobe import (
    gather_lobes,
    normalise_mixture,
)
from brdffit.halfangle.closed_forms import (
    DEFENSIVE_SHARE,
    DEFENSIVE_SHARE_SEEN,
    LEAN,
    STARTS,
    first_start,
    footprint_moments,
    light_lobes,
    take_from_tensor,
    widen_lobes,
    widen_round_lobes,
)
from brdffit.halfangle.footprints import REFLECTED, average_of_footprint, average_of_lobes, set_average, take_footprint
from brdffit.halfangle.frame import eigen_log
from brdffit.halfangle.lights import BASE_BLUR, points_of, segment, values_of
from brdffit.halfangle.merging import mean_spread, merge_lobes
from brdffit.halfangle.objective import FREE, HELD, HOLDS, PARAMETERS
from brdffit.halfangle.quadrature import (
    SHAPE,
    WIDE_AXES,
    add_defensive_lobe,
    add_guard,
    frame_lobes,
    normalise_shapes,
    place_nodes,
    weigh_nodes,
)

real = np.float32

# A mean spread below this (in units of the lobe's width) stretches lobes so little that they are kept isotropic, which
# makes their table cheaper, at an error of 1e-6.
_NARROW_SPREAD = 0.002
# Departures of the coverage from 1: above the first a lobe is hidden from the nodes and gets nodes of its own, above
# the second its fit is given up.
_HIDDEN, _LOST = 0.3, 0.6
# Added to a footprint's strata where its samples are compared with them, so that small footprints may be cut up more.
_FEW_STRATA = 16
# Log alpha^2 of the closed-form lobe above which a good part of the nodes that it draws lies below the horizon.
_WIDE = math.log(0.25)
# Residual and squared ratio of axes above which a lobe is looked at again with nodes of its own.
_MISSED, _LONG = 0.05, 8.0
# Change of an entry of the log tensor, or of the normal in widths of the lobe, above which a lobe may have left the
# nodes with which it was looked at again.
_MOVED = 0.15
#: How often a texel may add nodes around a lobe that was found where there are none.
GUARDS = 3


@inline
def is_suspect(theta, residual, light):
    """Whether nodes may have missed where a lobe shines in the dark: it misses much of its target, and is long, as the
    smallest light shows it."""
    l1, l2, _, _ = eigen_log(theta[2], theta[3], theta[4])
    return residual > _MISSED and math.exp(l1) + light > _LONG * (math.exp(l2) + light)


@inline
def has_moved(theta, before, light):
    """Whether a lobe has turned, grown or shifted so far that nodes of the lobe ``before`` (5,) may not show it."""
    x, y, xx, yy, xy = before
    change = max(max(abs(theta[2] - xx), abs(theta[3] - yy)), abs(theta[4] - xy))
    shift = (theta[0] - x) ** 2 + (theta[1] - y) ** 2
    # Slopes change by 1 / n_z^2 of the angle.
    steep = 1.0 + theta[0] * theta[0] + theta[1] * theta[1]
    wide = math.exp(max(theta[2], theta[3])) + light
    return change > _MOVED or shift > _MOVED * _MOVED * wide * steep * steep


@inline
def spared(floor, nodes):
    """Error e up to which N nodes suffice: five parameters fitted to them follow their noise, which adds 5 e / N."""
    return floor * nodes / 5.0


@part
def fit_texel(
    base, strata, column, row, search, scratch, rules, footprints, index,
    tabulate_kernel, moments_kernel, values_kernel, log_normalisation, source_log_normalisation,
):  # fmt: skip
    """Fit one texel into ``scratch.theta`` (6,) and ``scratch.report``; returns a status.

    Its footprint is the one of this ``index`` in ``footprints``, or gathered from the base if there are none.
    ``rules`` are ordered from few nodes to many. A texel takes the next rule where the two halves of a rule disagree by
    more than ``search.trusted`` times the residual, and where its nodes miss the lobe that was found; that lobe then
    gets nodes of its own. ``scratch.best`` (6,) receives the closed-form start, to fall back on.
    """
    lobes, theta, report, lights = scratch.lobes[0], scratch.theta, scratch.report, rules[0].lights
    merged = footprints.sums.shape[0] > 0
    if merged:
        count, red, green, blue, some = take_footprint(footprints, index, lobes, scratch.moment)
        spread = mean_spread(lobes, count, lights[0, BASE_BLUR])
    else:
        count, spread = gather_lobes(
            base, strata, search.step, column, row, lobes[: lobes.shape[0] - GUARDS], scratch.moment
        )
        red, green, blue, some = normalise_mixture(lobes, count)
    for k in range(report.size):
        report[k] = 0.0
    expected = NOT_KNOWN
    if search.allowed > 0.0 and some and base.isotropic:
        expected = closed_form(
            lobes, count, base.grey, search.scale, search.scale_low, search.scale_high, red, green, blue,
            search.response, search.allowed, theta, report, scratch.work,
        )  # fmt: skip
        if expected <= search.allowed and within_domain(theta, search):
            return FLAT if expected <= FLAT_EXCESS else CLOSED_FORM
    sized = lights[0, BASE_BLUR] > 0.0
    alike = 0.0
    if sized and base.isotropic and search.same_model:
        x, y, z, log = average_of_lobes(lobes, count) if not merged else average_of_footprint(footprints, index)
        if set_average(x, y, z, log, lobes[0, SHAPE], scratch.average):
            alike = 1.0 - math.exp(scratch.average[2]) / (SHARP * lights[0, BASE_BLUR])
    if search.rendered and some:
        report[ALBEDO] = (
            albedo_of_lobes(lobes, count, base.isotropic) if not merged else footprints.sums[index, REFLECTED]
        )
    isotropic = search.free & FREE_ANISOTROPY == 0
    if sized and some and base.isotropic and search.same_model and not base.has_shape:
        alike_enough = take_if_alike(
            count, scratch, search, lights[0, BASE_BLUR], alike, isotropic, base.has_diffuse, red, green, blue
        )
        if alike_enough:
            return FLAT
    lobes_isotropic = see_lobes(base, lights, count, spread, search.cell, merged, scratch)
    count = scratch.counts[0]
    flat = footprint_moments(lobes, count, lobes_isotropic, scratch.moments)
    if sized:
        # Starts are lobes before any light widens them.
        take_from_tensor(scratch.moments, lights[0, BASE_BLUR], math.exp(search.log_low))
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
    narrow = sized and max(start[2], start[3]) < _WIDE
    share = DEFENSIVE_SHARE_SEEN if narrow else DEFENSIVE_SHARE
    for s in range(lights.shape[0]):
        own, many = scratch.lobes[s], scratch.counts[s]
        add_defensive_lobe(own, many, share, start[0], start[1], start[2], start[3], start[4])
        light_lobes(own, many, many + 1, False, lights[s, BASE_BLUR])
        normalise_shapes(own, many, base.has_shape, source_log_normalisation)
    crowded = count > search.crowd * (_FEW_STRATA + strata.x.size * strata.y.size)
    tier = search.usual + 1 if crowded else search.usual
    spare = spared(search.floor, rules[0].values.shape[0])
    if not crowded and fitted_error(expected) <= spare:
        tier = 0
    guards, mending, warm, checked = 0, False, False, False
    looked_at = (0.0, 0.0, 0.0, 0.0, 0.0)
    while True:
        # A texel that needs more nodes often has separate peaks: the highest gets a search of its own, once.
        follow = STARTS if mending else 2 if tier > search.usual else 1
        if warm and (checked or not mending and tier > search.usual + 1):
            follow = 0
        status = fit_by_rule(
            base, lobes_isotropic, some, scratch, rules[tier], search, follow, warm,
            tabulate_kernel, moments_kernel, values_kernel, log_normalisation,
        )  # fmt: skip
        hidden = abs(report[COVERAGE] - 1.0) > _HIDDEN
        doubtful = report[DISAGREEMENT] > search.trusted * report[RESIDUAL] + max(search.negligible, search.floor)
        if tier < search.usual and report[RESIDUAL] > spare and not doubtful and not hidden:
            # The tolerance does not allow so few nodes after all: the next rule continues from this lobe.
            doubtful = True
            for p in range(PARAMETERS):
                scratch.starts[LEAN, p] = theta[p]
        # More nodes refine what was found, but a lobe that hides from the nodes is none to start from.
        warm = sized and not hidden
        missed = hidden and guards < GUARDS
        if not missed:
            if checked:
                # A lobe that turned or grew may have left those nodes: once more, until it stays.
                moved = has_moved(theta, looked_at, lights[0, BASE_BLUR])
                again = moved or doubtful and tier < len(rules) - 1
                if guards >= GUARDS or not again or not is_suspect(theta, report[RESIDUAL], lights[0, BASE_BLUR]):
                    break
            elif report[RESIDUAL] > BESIDE and not mending:
                # The lobe misses its target: try all starts and the target's own peaks, with more nodes.
                mending = True
            elif not doubtful or tier == len(rules) - 1:
                # Nodes are few where a long lobe shines and its target is dark: look again, with nodes of its own.
                checked = sized and guards < GUARDS and is_suspect(theta, report[RESIDUAL], lights[0, BASE_BLUR])
                if not checked:
                    break
        if missed or checked:
            looked_at = (theta[0], theta[1], theta[2], theta[3], theta[4])
            if sized and guards == 0 and theta[0] * theta[0] + theta[1] * theta[1] > 1.0:
                # The tail of a steep lobe is wide and dim, but half vectors near the texture's own normal weigh most.
                for p in range(PARAMETERS):
                    scratch.start[p] = 0.0
                guard(base, lights, lobes_isotropic, scratch, scratch.start)
                lobes_isotropic = False
                guards += 1
            guard(base, lights, lobes_isotropic, scratch, theta)
            lobes_isotropic = False
            guards += 1
        tier = min(tier + 1, len(rules) - 1)
    if status == CONVERGED and tier != search.usual:
        status = REFINED if tier > search.usual else FEW_NODES
    if abs(report[COVERAGE] - 1.0) > _LOST:
        # The nodes still miss the lobe, so its residual means nothing.
        status = FALLBACK
        fall_back(scratch, rules[tier], search, values_kernel, log_normalisation)
    elif report[RESIDUAL] > BESIDE:
        status = POOR
    elif some and status != FALLBACK:
        averaged = alike > 0.0 and prefer_average(
            scratch, rules[tier], search, alike, moments_kernel, values_kernel, log_normalisation
        )
        if search.within > 0.0 and not averaged:
            stay_near_lean(scratch, rules[tier], search, max(alike, 0.0), values_kernel, log_normalisation)
    if not some:
        report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE] = 0.0, 0.0, 0.0
        return NO_SPECULAR
    if search.scale != FREE and report[FILTERED] + report[FILTERED + 1] + report[FILTERED + 2] <= 0.0:
        # Negative filter weights leave no colour to hold the scale at: the lobe is black and misses all of its target.
        report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE] = 0.0, 0.0, 0.0
        report[RESIDUAL] = 1.0
    return status


@part
def guard(base, lights, lobes_isotropic, scratch, theta):
    """Let the lobe ``theta`` (6,) draw nodes of its own under each size of light; all tensors become full ones."""
    for s in range(lights.shape[0]):
        own, many = scratch.lobes[s], scratch.counts[s]
        if lobes_isotropic:
            widen_lobes(own, many, lobes_isotropic, base.widening)
        add_guard(own, many, theta)
        light_lobes(own, many, many + 1, False, lights[s, BASE_BLUR])
        scratch.counts[s] += 1


@part
def see_lobes(base, lights, count, spread, cell, merged, scratch):
    """Write into ``scratch.lobes[s]`` the ``count`` lobes of ``scratch.lobes[0]`` as each size of light shows them.

    Lobes that a light hardly distinguishes are merged (``cell`` > 0), from one size to the next (those of the first
    are ``merged`` already, or not); then every lobe is widened by the spread of its own normals and by the light.
    Returns whether all lobes are still isotropic.
    """
    sizes = lights.shape[0]
    scratch.counts[0] = count
    widest = spread
    if cell > 0.0 and base.isotropic:
        for s in range(sizes):
            own = scratch.lobes[s]
            if s > 0:
                for i in range(scratch.counts[s - 1]):
                    for k in range(WIDE_AXES):
                        own[i, k] = scratch.lobes[s - 1, i, k]
            if s > 0 or not merged:
                many = count if s == 0 else scratch.counts[s - 1]
                scratch.counts[s], spread = merge_lobes(own, many, lights[s, BASE_BLUR], cell, scratch.cells)
                widest = max(widest, spread)
    else:
        for s in range(1, sizes):
            scratch.counts[s] = count
            for i in range(count):
                for k in range(WIDE_AXES):
                    scratch.lobes[s, i, k] = scratch.lobes[0, i, k]
    for s in range(sizes):
        own, many = scratch.lobes[s], scratch.counts[s]
        if widest > _NARROW_SPREAD:
            widen_lobes(own, many, base.isotropic, base.widening, lights[s, BASE_BLUR], base.averages)
        elif widest > 0.0 and base.isotropic:
            widen_round_lobes(own, many, base.widening, lights[s, BASE_BLUR])
        elif lights[s, BASE_BLUR] > 0.0:
            light_lobes(own, 0, many, base.isotropic, lights[s, BASE_BLUR])
    return base.isotropic and not widest > _NARROW_SPREAD


@part
def fall_back(scratch, table, search, values_kernel, log_normalisation):
    """Take the closed-form start with the filtered colour, and compute its residual on the nodes of a rule."""
    theta, setting, report = scratch.theta, scratch.setting, scratch.report
    for p in range(PARAMETERS):
        theta[p] = scratch.best[p]
    for k in range(3):
        report[k] = report[FILTERED + k]
    setting[HELD] = HOLDS
    settle_scale(theta, table, setting, values_kernel, log_normalisation, search.exponent, scratch.work, report)


@part
def fit_by_rule(
    base, lobes_isotropic, some, scratch, table, search, follow, warm,
    tabulate_kernel, moments_kernel, values_kernel, log_normalisation,
):  # fmt: skip
    """Place the nodes of one rule, fill its table, fit from the first ``follow`` starts at least, and
    from ``scratch.theta`` if ``warm``. Returns a status."""
    for s in range(table.lights.shape[0]):
        lobes, count, nodes = scratch.lobes[s], scratch.counts[s], segment(table, s)
        frame_lobes(lobes, count, lobes_isotropic)
        place_nodes(lobes, count, points_of(table, s), search.exponent, nodes)
        tabulate_kernel(lobes, count, lobes_isotropic, base.grey, nodes)
        weigh_nodes(nodes)
        if search.loss == RELATIVE:
            weigh_relatively(nodes)
        elif search.loss == SEEN or search.loss == DISPLAYED:
            weigh_as_seen(nodes, scratch.moment, search.loss == DISPLAYED, search.dark)
            if search.squares > 0.0:
                add_squares(nodes, search.squares)
    share_out(table)
    colour = scratch.colour
    for k in range(3):
        colour[k] = scratch.report[FILTERED + k]
    if not some or colour[0] + colour[1] + colour[2] <= 0.0:
        colour[0] = colour[1] = colour[2] = 1.0
    status = fit_on_nodes(scratch, table, search, follow, warm, moments_kernel, values_kernel, log_normalisation)
    if search.loss == L1 and status != FALLBACK:
        report = scratch.report
        for _ in range(ROUNDS):
            for s in range(table.lights.shape[0]):
                weigh_absolutely(
                    segment(table, s), values_of(table, s), report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE]
                )
            share_out(table)
            report[TARGET_NORM] = max(target_norm(table), 1e-30)
            search_on(scratch, table, search, moments_kernel, values_kernel, log_normalisation)
    return status
