"""The closed form in place of a search, where the lobes of a footprint differ little: see brdffit.halfangle.response.

What it loses to the best lobe is of the order of the fourth moment of the lobes' differences x, and the error grows
with its square: the excess, in units of the target's norm, is put at 1.5 E[r^4]^2 with r^2 = t1^2 + t2^2 + l^2 / 4. A
test holds that against the truth on random footprints.
"""

from __future__ import annotations

import math

from brdffit._jit import inline, kernel
from brdffit.halfangle.closed_forms import STEEPEST_SLOPE
from brdffit.halfangle.objective import BOUNDED, HOLDS, PARAMETERS
from brdffit.halfangle.quadrature import ALPHA_SQUARED, GAIN, NORMALISATION, SHAPE, SPECULAR, SPREAD, TENSOR
from brdffit.halfangle.response import ANSWERS, BY_FIRST, OFF_PLANE, OFF_SCALE, ROW, SECOND, THIRD

_SAFETY = 1.5
# Columns that hold a lobe's l, t1 and t2 meanwhile: nothing is in them yet, for the lobes are isotropic.
_LOG, _ALONG, _ACROSS = NORMALISATION, TENSOR + 1, TENSOR + 2
#: An excess that is not known.
NOT_KNOWN = 1e30
#: Below this all lobes are alike.
FLAT_EXCESS = 1e-23
#: Scratch of ``closed_form``: moments, then one row of the table.
WORK = THIRD + ROW


@inline
def _blend(response, log_alpha, cosine, row):
    """The table's row at alpha and tilt, linear in between; returns whether it lies within the table."""
    a = max((log_alpha - response.log_alpha) / response.log_alpha_step, 0.0)
    z = (cosine - response.cosine) / response.cosine_step
    last_a, last_z = response.table.shape[0] - 1, response.table.shape[1] - 1
    if a > last_a or z < 0.0:
        return False
    i, k = min(int(a), last_a - 1), min(int(z), last_z - 1)
    fa, fz = a - i, min(z - k, 1.0)
    w00, w01, w10, w11 = (1.0 - fa) * (1.0 - fz), (1.0 - fa) * fz, fa * (1.0 - fz), fa * fz
    near, far = response.table[i], response.table[i + 1]
    r00, r01, r10, r11 = near[k], near[k + 1], far[k], far[k + 1]
    for m in range(ROW):
        row[m] = w00 * r00[m] + w01 * r01[m] + w10 * r10[m] + w11 * r11[m]
    return math.isfinite(row[0])


@inline
def fitted_error(excess):
    """About the error of the best lobe, 0.07 E[r^2]^2, where this is the closed form's excess."""
    return 0.07 * math.sqrt(excess / _SAFETY)


@kernel
def _own_scales(lobes, count, m1, m2, norm, row, report):
    """Scales of channels whose own lobes lie off the common middle, into ``report``[0:3]; returns the error left."""
    error = 0.0
    for channel in range(3):
        total, t1, t2, k = 0.0, 0.0, 0.0, 0.0
        for i in range(count):
            w = lobes[i, SPECULAR + channel]
            total += w
            t1 += w * lobes[i, _ALONG]
            t2 += w * lobes[i, _ACROSS]
            k += w * lobes[i, _LOG]
        t1, t2 = t1 - total * m1, t2 - total * m2
        report[channel] = max(
            report[channel] + t1 * row[BY_FIRST] + t2 * row[BY_FIRST + 1] + k * row[BY_FIRST + 2], 0.0
        )
        error += (t1 * t1 * row[OFF_SCALE] + t2 * t2 * row[OFF_SCALE + 1] + k * k * row[OFF_SCALE + 2]) / norm
    return error


@kernel
def closed_form(lobes, count, grey, kind, low, high, red, green, blue, response, allowed, theta, report, work):
    """The lobe that answers to the footprint's moments, if it is within ``allowed`` of the best; returns its excess.

    Lobes are isotropic and of one shape, not widened; SPECULAR columns sum to (red, green, blue). Where the estimate
    (relative squared error above the best lobe's) is below ``allowed``, ``theta`` (6,) is filled, and ``report``[0:4]
    with its scale and its own error; elsewhere nothing is. ``kind``, ``low``, ``high``: of the scale, as in ``Search``.
    ``work`` (WORK,) is scratch.
    """
    # Weights by which a scale a channel, and so the sum over channels, sees each lobe.
    norm = red * red + green * green + blue * blue
    if not norm > 0.0:
        return NOT_KNOWN
    r, g, b = red / norm, green / norm, blue / norm
    x, y, z, middle, gain = 0.0, 0.0, 0.0, 0.0, 0.0
    last, log = -1.0, 0.0
    for i in range(count):
        lobe = lobes[i]
        if not (lobe[SPECULAR] >= 0.0 and lobe[SPECULAR + 1] >= 0.0 and lobe[SPECULAR + 2] >= 0.0):
            return NOT_KNOWN
        w = r * lobe[SPECULAR] + g * lobe[SPECULAR + 1] + b * lobe[SPECULAR + 2]
        if lobe[ALPHA_SQUARED] != last:
            last = lobe[ALPHA_SQUARED]
            log = math.log(last)
        lobe[_LOG] = log
        x += w * lobe[0]
        y += w * lobe[1]
        z += w * lobe[2]
        middle += w * log
        gain += w * lobe[GAIN]
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 1e-3:  # opposite normals: their mean has no direction
        return NOT_KNOWN
    x, y, z = x / length, y / length, z / length
    if z < 1.0 / STEEPEST_SLOPE:
        return NOT_KNOWN
    # Tangents along and across the tilt.
    sine = math.sqrt(x * x + y * y)
    cos, sin = (x / sine, y / sine) if sine > 1e-9 else (1.0, 0.0)
    a_x, a_y, a_z = z * cos, z * sin, -sine
    alpha = math.exp(0.5 * middle)
    inverse = 1.0 / alpha
    for m in range(THIRD):
        work[m] = 0.0
    m1, m2, fourth = 0.0, 0.0, 0.0
    s11, s12, s22 = 0.0, 0.0, 0.0
    for i in range(count):
        lobe = lobes[i]
        w = r * lobe[SPECULAR] + g * lobe[SPECULAR + 1] + b * lobe[SPECULAR + 2]
        scale = inverse / max(lobe[0] * x + lobe[1] * y + lobe[2] * z, 0.1)
        t1 = scale * (lobe[0] * a_x + lobe[1] * a_y + lobe[2] * a_z)
        t2 = scale * (lobe[1] * cos - lobe[0] * sin)
        k = lobe[_LOG] - middle
        lobe[_ALONG], lobe[_ACROSS], lobe[_LOG] = t1, t2, k
        t11, t12, t22, kk = t1 * t1, t1 * t2, t2 * t2, k * k
        m1 += w * t1
        m2 += w * t2
        s11 += w * lobe[SPREAD]
        s22 += w * lobe[SPREAD + 1]
        s12 += w * lobe[SPREAD + 2]
        squared = t11 + t22 + 0.25 * kk
        fourth += w * squared * squared
        work[0] += w * t11
        work[1] += w * t12
        work[2] += w * t22
        work[3] += w * t1 * k
        work[4] += w * t2 * k
        work[5] += w * kk
        work[6] += w * t11 * t1
        work[7] += w * t11 * t2
        work[8] += w * t12 * t2
        work[9] += w * t22 * t2
        work[10] += w * t11 * k
        work[11] += w * t12 * k
        work[12] += w * t22 * k
        work[13] += w * t1 * kk
        work[14] += w * t2 * kk
        work[15] += w * kk * k
    # SPREAD is twice the covariance within a sample's part of the footprint, in the frame of the pole's rotation.
    half = 0.5 * inverse * inverse
    within = half * (s11 + s22)
    fourth = math.sqrt(fourth) + within
    excess = _SAFETY * fourth**4
    if not excess <= allowed:
        return excess
    work[0] += half * (cos * cos * s11 + 2.0 * cos * sin * s12 + sin * sin * s22)
    work[1] += half * (cos * sin * (s22 - s11) + (cos * cos - sin * sin) * s12)
    work[2] += half * (sin * sin * s11 - 2.0 * cos * sin * s12 + cos * cos * s22)
    row = work[THIRD : THIRD + ROW]
    if not _blend(response, 0.5 * middle, z, row):
        return NOT_KNOWN
    scale, d1, d2, size, stretch, shear = 0.0, m1, m2, middle, 0.0, 0.0
    for m in range(THIRD):
        k, at = work[m], m * ANSWERS
        scale += k * row[at]
        d1 += k * row[at + 1]
        d2 += k * row[at + 2]
        size += k * row[at + 3]
        stretch += k * row[at + 4]
        shear += k * row[at + 5]
    error = 0.0
    for m in range(SECOND):
        for n in range(SECOND):
            error += work[m] * work[n] * row[OFF_PLANE + m * SECOND + n]
    n_x, n_y, n_z = x + alpha * (d1 * a_x - d2 * sin), y + alpha * (d1 * a_y + d2 * cos), z + alpha * d1 * a_z
    # The stretch, from along the tilt to the axes of the pole's rotation.
    c2, s2 = cos * cos - sin * sin, 2.0 * cos * sin
    theta[0], theta[1] = -n_x / n_z, -n_y / n_z
    theta[2], theta[3] = size + stretch * c2 - shear * s2, size - stretch * c2 + shear * s2
    theta[4] = stretch * s2 + shear * c2
    theta[PARAMETERS - 1] = lobes[0, SHAPE]
    scale = 1.0 if kind == HOLDS else gain + scale
    if kind == BOUNDED and not low <= scale <= high:
        return NOT_KNOWN
    report[0], report[1], report[2] = red * scale, green * scale, blue * scale
    if not grey:
        error += _own_scales(lobes, count, m1, m2, norm, row, report)
    report[3] = error
    return excess
