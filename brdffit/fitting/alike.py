"""Footprints whose lobes the smallest light hardly distinguishes, and lobes that it does not tell from the best."""

from __future__ import annotations

import math

from brdffit._jit import inline, part
from brdffit.fitting.scoring import (
    ALBEDO,
    BLUE_SCALE,
    EVALUATIONS,
    FILTERED,
    GREEN_SCALE,
    RED_SCALE,
    RESIDUAL,
    settle_scale,
)
from brdffit.fitting.search import clamp_to_domain
from brdffit.fitting.shortcuts import diffuse_beside, nearly_alike
from brdffit.halfangle.albedo import albedo_of
from brdffit.halfangle.closed_forms import LEAN, XX, first_start, footprint_moments
from brdffit.halfangle.lights import evaluate_table
from brdffit.halfangle.objective import PARAMETERS

#: Where the mean alpha^2 is below this multiple of the smallest light's a^2, lobes may look alike.
SHARP = 2.0
# Mirrors look alike if their errors differ by less than a share plus a floor; wider lobes if by less, down to nothing
# at that multiple. Then the positions that are tried between the found lobe (0) and the averaged (1).
_ALIKE, _ALIKE_FLOOR, _NEARER = 0.02, 3e-3, (1.0, 0.75, 0.5, 0.25)


@part
def take_if_alike(count, scratch, search, light, alike, isotropic, has_diffuse, red, green, blue):
    """LEAN's lobe into ``scratch.theta`` where the lobes differ so little under the smallest light that the search
    would gain less than what is negligible; returns whether."""
    lobes, theta, moments, report = scratch.lobes[0], scratch.theta, scratch.moments, scratch.report
    if not (red > 0.0 and green > 0.0 and blue > 0.0):
        return False
    footprint_moments(lobes, count, True, moments)
    loss = 0.1 * nearly_alike(lobes, count, moments, light)
    if not loss <= search.negligible:
        return False
    if has_diffuse and search.sky > 0.0:
        if diffuse_beside(scratch.moment, moments, red, green, blue, light) > search.negligible:
            return False
    first_start(moments, isotropic, scratch.starts)
    start = scratch.starts[LEAN]
    if alike > 0.0:
        # As in ``prefer_average``: by how much the width of the averaged lobe is off, as the smallest light shows it.
        wider = 0.5 * (math.exp(start[2]) + math.exp(start[3])) - math.exp(scratch.average[2])
        wider /= moments[XX] + light
        if 0.15 * wider * wider <= alike * _ALIKE_FLOOR:
            start = scratch.average
    for p in range(PARAMETERS):
        theta[p] = scratch.best[p] = start[p]
    clamp_to_domain(theta, search)
    keep_colour(theta, search, red, green, blue, report)
    report[RESIDUAL] = loss
    return True


@inline
def keep_colour(theta, search, red, green, blue, report):
    """The filtered colour as the scale of the lobe, times what makes up for light that it loses to masking."""
    scale = 1.0
    if report[ALBEDO] > 0.0:
        scale = min(max(report[ALBEDO] / max(albedo_of(theta), 0.01), search.scale_low), search.scale_high)
    report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE] = scale * red, scale * green, scale * blue


@part
def prefer_average(scratch, table, search, alike, moments_kernel, values_kernel, log_normalisation):
    """Replace the lobe that was found by the averaged one, or by one between, if the lights hardly distinguish them;
    returns whether.

    Lobes much sharper than the smallest light differ only in their tails, which are in proportion to alpha^2: too wide
    a lobe glows where the base is dark. ``alike``: 1 for mirrors, falling to 0 where lights show a lobe's width.
    """
    theta, start, setting, space = scratch.theta, scratch.start, scratch.setting, scratch.space
    found = evaluate_table(theta, table, setting, moments_kernel, log_normalisation, space.gradient, space.evaluation)
    bound = found + alike * (_ALIKE * (1.0 + found) + _ALIKE_FLOOR)
    for k in range(len(_NEARER)):
        for p in range(PARAMETERS):
            start[p] = theta[p] + _NEARER[k] * (scratch.average[p] - theta[p])
        clamp_to_domain(start, search)
        value = evaluate_table(
            start, table, setting, moments_kernel, log_normalisation, space.gradient, space.evaluation
        )
        scratch.report[EVALUATIONS] += 1
        if value <= bound:
            for p in range(PARAMETERS):
                theta[p] = start[p]
            settle_scale(
                theta, table, setting, values_kernel, log_normalisation, search.exponent, scratch.work, scratch.report
            )
            if k == 0 and search.rendered:
                # What the lights cannot tell apart gives no reason for another scale: a mirror stays as bright.
                r, g, b = scratch.report[FILTERED], scratch.report[FILTERED + 1], scratch.report[FILTERED + 2]
                keep_colour(theta, search, r, g, b, scratch.report)
            return True
    return False
