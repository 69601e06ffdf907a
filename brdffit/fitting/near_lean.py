"""Lobes whose squared error is far above that of LEAN's closed form move towards it.

BALANCED (brdffit.fitting.losses) gives highlights away for the dark beside them. Where the slopes of a base end at once
(brushed metal, bumps of a mirror), its lobe is too short for them and up to 4 dB behind LEAN's in squared error, though
closer as a screen shows it. More weight for the squared error would widen lobes everywhere. Here the lobe moves along
the straight line of parameters, normal, log tensor and scale, from where the search ended (0) to LEAN's with the
filtered colour (1), to the least t with

    S(t) <= c S(1),    S = sum_s w_s int |T_s - F_s|^2 w(h) dh / int |T_s|^2 w(h) dh + 0.001,

w_s the shares of the sizes of light. Nothing moves where S(0) is that small already, as it is where LEAN's lobe is the
worse one. The least t is found by bisection, since S falls along the line in practice; where it does not, t ends at
another crossing, or at LEAN's lobe, which satisfies the bound as well. t is halved again where the lobe would miss more
than half of its target as a screen shows it. On the line a lobe is better in FLIP than one of the same squared error
that a search for a mixture of both errors finds (docs/seen.md).

LEAN's lobe is the start of the search: the moments of what a renderer interpolates, narrower than those of texels.
"""

from __future__ import annotations

import numpy as np

from brdffit._jit import part
from brdffit.fitting.scoring import BLUE_SCALE, FILTERED, GREEN_SCALE, RED_SCALE, RESIDUAL, settle_scale
from brdffit.fitting.search import BESIDE, clamp_to_domain
from brdffit.halfangle.closed_forms import LEAN
from brdffit.halfangle.lights import LOBE_BLUR, SHARE, segment, values_of, widened
from brdffit.halfangle.objective import HELD, HOLDS, PARAMETERS
from brdffit.halfangle.quadrature import BLUE, GREEN, MEASURE, RED

real = np.float32

#: The first level from which lobes are held near LEAN's, and c: 1 dB. Nearer, what shows is a lobe's glow in the dark.
FIRST_LEVEL, WITHIN = 2, 10.0**0.1
# c of mirrors, lobes much sharper than the smallest light (2 dB): their glow is what shows most.
_WITHIN_MIRRORS = 10.0**0.2
# Squared error below which nothing is gained that shows (30 dB), and halvings of the line.
_UNSEEN, _HALVINGS = 1e-3, 5


def within_of(loss: str, mip_level: int) -> float:
    """c for a level of a fit with this loss; 0 where lobes stay as the search found them."""
    return WITHIN if loss == "balanced" and mip_level >= FIRST_LEVEL else 0.0


@part
def stay_near_lean(scratch, table, search, mirror, values_kernel, log_normalisation):
    """Move ``scratch.theta`` and the scale towards LEAN's, ``scratch.best`` (see the head of this file), and settle the
    residual.

    ``mirror``: 1 for mirrors, falling to 0 where lights show a lobe's width (``prefer_average``).
    """
    theta, best, report, work, setting = scratch.theta, scratch.best, scratch.report, scratch.work, scratch.setting
    near = squared_error(best, report, FILTERED, table, values_kernel, log_normalisation, work)
    here = squared_error(theta, report, RED_SCALE, table, values_kernel, log_normalisation, work)
    bound = max(search.within, _WITHIN_MIRRORS * mirror + search.within * (1.0 - mirror)) * (near + _UNSEEN)
    if not here + _UNSEEN > bound:
        return
    # The search is over: its starts are no longer needed.
    found = scratch.starts[LEAN]
    for p in range(PARAMETERS):
        found[p] = theta[p]
    r, g, b = report[RED_SCALE], report[GREEN_SCALE], report[BLUE_SCALE]
    behind, t = 0.0, 1.0
    for _ in range(_HALVINGS):
        between = 0.5 * (behind + t)
        _take_between(scratch, found, r, g, b, between)
        if squared_error(theta, report, RED_SCALE, table, values_kernel, log_normalisation, work) + _UNSEEN > bound:
            behind = between
        else:
            t = between
    held = setting[HELD]
    setting[HELD] = HOLDS
    for _ in range(_HALVINGS):
        _take_between(scratch, found, r, g, b, t)
        clamp_to_domain(theta, search)
        settle_scale(theta, table, setting, values_kernel, log_normalisation, search.exponent, work, report)
        if report[RESIDUAL] <= BESIDE:
            break
        # So far from what was found the lobe would miss most of its target, as a screen shows it.
        t *= 0.5
    setting[HELD] = held


@part
def _take_between(scratch, found, r, g, b, t):
    """``scratch.theta`` and the scale <- those at t between the lobe ``found``, of scale (r, g, b), and LEAN's."""
    theta, report = scratch.theta, scratch.report
    for p in range(PARAMETERS):
        theta[p] = found[p] + t * (scratch.best[p] - found[p])
    report[RED_SCALE] = r + t * (report[FILTERED] - r)
    report[GREEN_SCALE] = g + t * (report[FILTERED + 1] - g)
    report[BLUE_SCALE] = b + t * (report[FILTERED + 2] - b)


@part
def squared_error(theta, report, scale, table, values_kernel, log_normalisation, work):
    """Relative squared error over all sizes, by their shares, of a lobe whose scale is ``report[scale : scale + 3]``.

    ``work`` (24,) is scratch.
    """
    wide, frame = work[0:6], work[6:22]
    r, g, b = real(report[scale]), real(report[scale + 1]), real(report[scale + 2])
    total = 0.0
    for s in range(table.lights.shape[0]):
        nodes, values = segment(table, s), values_of(table, s)
        widened(theta, table.lights[s, LOBE_BLUR], wide)
        values_kernel(wide, nodes, log_normalisation, values, frame)
        red, green, blue, measure = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[MEASURE]
        square, missing = real(0.0), real(0.0)
        for j in range(nodes.shape[1]):
            d_r, d_g, d_b = red[j] - r * values[j], green[j] - g * values[j], blue[j] - b * values[j]
            square += measure[j] * (red[j] * red[j] + green[j] * green[j] + blue[j] * blue[j])
            missing += measure[j] * (d_r * d_r + d_g * d_g + d_b * d_b)
        if square > real(0.0):
            total += table.lights[s, SHARE] * missing / square
    return total
