"""A lobe judged on a tabulated target: the scalar target of a search, the best scale, the residual, the coverage."""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel
from brdffit.halfangle.albedo import albedo_of
from brdffit.halfangle.density import half_angle_density
from brdffit.halfangle.frame import lobe_frame
from brdffit.halfangle.lights import LOBE_BLUR, SHARE, segment, values_of, widened
from brdffit.halfangle.objective import BOUNDED, ENERGY, HELD, HOLDS, SCALE, SCALE_HIGH, SCALE_LOW, TARGET
from brdffit.halfangle.quadrature import BLUE, GREEN, H_X, H_Y, H_Z, MEASURE, RED, WEIGHT
from brdffit.models.elementary import alternate, reciprocal

real = np.float32

# Entries of a fit's report. ALBEDO: albedo of the footprint's lobes as rendered, 0 where a bounded scale should not
# follow it. FILTERED: first of three entries, the filtered colour, 0 where negative filter weights make it negative.
(
    RED_SCALE, GREEN_SCALE, BLUE_SCALE, RESIDUAL, DISAGREEMENT, COVERAGE, EVALUATIONS, TARGET_NORM, ALBEDO, FILTERED
) = range(10)  # fmt: skip
REPORT = FILTERED + 3


@inline
def _norm_of(nodes):
    """<T,T> over all channels, of the nodes of one size."""
    red, green, blue, weight = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT]
    norm = real(0.0)
    for j in range(nodes.shape[1]):
        norm += weight[j] * (red[j] * red[j] + green[j] * green[j] + blue[j] * blue[j])
    return float(norm)


@kernel
def target_norm(table):
    """<T,T> over all channels and sizes."""
    norm = 0.0
    for s in range(table.lights.shape[0]):
        norm += _norm_of(segment(table, s))
    return norm


@kernel
def share_out(table):
    """Scale the weights of each size so that its <T,T> equals its share. A single size is left as it is."""
    if table.lights.shape[0] == 1:
        return
    for s in range(table.lights.shape[0]):
        nodes = segment(table, s)
        norm = _norm_of(nodes)
        factor = real(table.lights[s, SHARE] / norm if norm > 0.0 else 0.0)
        weight = nodes[WEIGHT]
        for j in range(nodes.shape[1]):
            weight[j] *= factor


@kernel
def aim(table, colour, target_norm, setting):
    """Set the scalar target S (see brdffit.halfangle.objective) for this colour: for the colour itself if the scale is
    held or bounded, for its direction if the scale is free."""
    squared = colour[0] * colour[0] + colour[1] * colour[1] + colour[2] * colour[2]
    if setting[HELD] > 0.0:
        r, g, b = colour[0] / squared, colour[1] / squared, colour[2] / squared
        setting[SCALE] = squared / target_norm
    else:
        scale = 1.0 / math.sqrt(squared)
        r, g, b = colour[0] * scale, colour[1] * scale, colour[2] * scale
        setting[SCALE] = 1.0 / target_norm
    by_red, by_green, by_blue = real(r), real(g), real(b)
    for s in range(table.lights.shape[0]):
        nodes = segment(table, s)
        red, green, blue, weight, target = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT], nodes[TARGET]
        for j in range(nodes.shape[1]):
            target[j] = (by_red * red[j] + by_green * green[j] + by_blue * blue[j]) * weight[j]


@inline
def _bounded(scale, filtered, sky, dd, rendered, setting):
    """The best scale of a channel within its bounds: ``scale`` = <T,D> / <D,D> combined with the sky's term, then times
    ``rendered``, which makes up for light that the lobe loses to masking."""
    low, high = setting[SCALE_LOW] * filtered, setting[SCALE_HIGH] * filtered
    return min(max(rendered * min(max((scale * dd + sky * filtered) / (dd + sky), low), high), low), high)


@kernel
def settle_scale(theta, table, setting, values_kernel, log_normalisation, exponent, work, report):
    """Write the best scale of each channel (unless it is held), the residual, the disagreement of the two halves of
    the rule and the coverage into ``report``.

    A held scale must be in ``report`` already. The residual is summed as (T - rho D)^2, so that nothing cancels.
    ``work`` (24,) is scratch.
    """
    wide, frame = work[0:6], work[6:22]
    dd, r, g, b = real(0.0), real(0.0), real(0.0), real(0.0)
    coverage_found = 1.0
    for s in range(table.lights.shape[0]):
        nodes, values = segment(table, s), values_of(table, s)
        widened(theta, table.lights[s, LOBE_BLUR], wide)
        values_kernel(wide, nodes, log_normalisation, values, frame)
        red, green, blue, weight = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT]
        for j in range(nodes.shape[1]):
            wd = weight[j] * values[j]
            dd += wd * values[j]
            r += wd * red[j]
            g += wd * green[j]
            b += wd * blue[j]
        # ``values_kernel`` leaves the lobe's frame in its scratch.
        seen = _coverage_of(frame, nodes, exponent)
        if s == 0 or abs(seen - 1.0) > abs(coverage_found - 1.0):
            coverage_found = seen
    report[COVERAGE] = coverage_found
    if setting[HELD] != HOLDS:
        ok = dd > 0.0
        report[RED_SCALE] = max(r / dd, 0.0) if ok else 0.0
        report[GREEN_SCALE] = max(g / dd, 0.0) if ok else 0.0
        report[BLUE_SCALE] = max(b / dd, 0.0) if ok else 0.0
    if setting[HELD] == BOUNDED:
        squared = 0.0
        for k in range(3):
            squared += report[FILTERED + k] ** 2
        sky = setting[ENERGY] * report[TARGET_NORM] / max(squared, 1e-30)
        rendered = 1.0
        if report[ALBEDO] > 0.0:
            rendered = report[ALBEDO] / max(albedo_of(theta), 0.01)
        for k in range(3):
            report[RED_SCALE + k] = _bounded(report[RED_SCALE + k], report[FILTERED + k], sky, dd, rendered, setting)
    rho_r, rho_g, rho_b = real(report[RED_SCALE]), real(report[GREEN_SCALE]), real(report[BLUE_SCALE])
    total, alternating = real(0.0), real(0.0)
    for s in range(table.lights.shape[0]):
        nodes, values = segment(table, s), values_of(table, s)
        red, green, blue, weight = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT]
        for j in range(nodes.shape[1]):
            d_r, d_g, d_b = red[j] - rho_r * values[j], green[j] - rho_g * values[j], blue[j] - rho_b * values[j]
            term = weight[j] * (d_r * d_r + d_g * d_g + d_b * d_b)
            total += term
            alternating += alternate(term, j)
    report[RESIDUAL] = total / report[TARGET_NORM]
    report[DISAGREEMENT] = abs(alternating) / report[TARGET_NORM]


@kernel
def coverage(theta, nodes, exponent, frame):
    """A known integral over the lobe's peak by the nodes, divided by its exact value: 1 where they are dense enough.

    Far from 1, the nodes give noise for <D,D>, and a search could lower <D,D> by moving the lobe away from all nodes.
    (The integral of D (n.h) would not show that: half of it is tail, which distant nodes sample well.) The integral is
    that of G^2 (n.h)^5 above the horizon, with G the GGX lobe of the same normal and tensor for every model. With
    slopes t scaled by the tensor, G = (n.h)^-4 (1 + t^2)^-2 / (pi sqrt(det Sigma)) and
    dh = (n.h)^3 sqrt(det Sigma) dt, so it is the integral of (1 + t^2)^-4 / (pi^2 sqrt(det Sigma)) over the half-plane
    above the horizon, n_z + g.Sigma^(1/2) t > 0 with g the z components of the tangent axes. The border of that
    half-plane lies at the distance d = n_z / sqrt(g' Sigma g) from the peak, and the marginal density across it is in
    proportion to (1 + x^2)^-7/2, so the integral is 1 / (3 pi sqrt(det Sigma)) times
    1/2 + (15 s - 10 s^3 + 3 s^5) / 16, s = d / sqrt(1 + d^2).

    A node stands for the solid angle W / w(h), W its MEASURE. ``frame`` (9,) is scratch.
    """
    inverse = 1.0 / math.sqrt(1.0 + theta[0] * theta[0] + theta[1] * theta[1])
    lobe_frame(-theta[0] * inverse, -theta[1] * inverse, inverse, theta[2], theta[3], theta[4], frame)
    return _coverage_of(frame, nodes, exponent)


@kernel
def _coverage_of(frame, nodes, exponent):
    """``coverage`` of the lobe with this frame."""
    u_x, u_y, u_z = real(frame[0]), real(frame[1]), real(frame[2])
    v_x, v_y, v_z = real(frame[3]), real(frame[4]), real(frame[5])
    n_x, n_y, n_z = real(frame[6]), real(frame[7]), real(frame[8])
    h_x, h_y, h_z, weight = nodes[H_X], nodes[H_Y], nodes[H_Z], nodes[MEASURE]
    cubic = exponent == 3
    seen = real(0.0)
    for j in range(nodes.shape[1]):
        u = u_x * h_x[j] + u_y * h_y[j] + u_z * h_z[j]
        v = v_x * h_x[j] + v_y * h_y[j] + v_z * h_z[j]
        cos = max(n_x * h_x[j] + n_y * h_y[j] + n_z * h_z[j], real(0.0))
        C = cos * cos
        g = reciprocal(u * u + v * v + C)
        g *= g
        up = reciprocal(max(h_z[j], real(0.02)))  # no weight below the horizon
        seen += weight[j] * (up * up * up if cubic else up) * g * g * C * C * cos
    # Squared lengths of the frame's axes: the reciprocals of the tensor's eigenvalues.
    square1 = frame[0] * frame[0] + frame[1] * frame[1] + frame[2] * frame[2]
    square2 = frame[3] * frame[3] + frame[4] * frame[4] + frame[5] * frame[5]
    across1, across2 = frame[2] / square1, frame[5] / square2
    sine = frame[8] / math.sqrt(frame[8] * frame[8] + across1 * across1 + across2 * across2)
    above = 0.5 + sine * (15.0 + sine * sine * (3.0 * sine * sine - 10.0)) / 16.0
    return 3.0 / math.pi * math.sqrt(square1 * square2) * seen / (above * half_angle_density(1.0, exponent))
