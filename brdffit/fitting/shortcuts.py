"""A closed form instead of a search where the lobes of a footprint differ little (brdffit.halfangle.response).

Its lobe differs from the best one by the order of the fourth moment of the lobes' differences x, so its error exceeds
the least one by the order of that moment's square. The excess, relative to <T,T>, is estimated as 1.5 E[r^4]^2 with
r^2 = t1^2 + t2^2 + l^2 / 4; a test compares that with the truth on random footprints.

Under lights with a size, and for losses other than L2, there is no table. But where lobes differ little *as the
smallest light shows them*, LEAN's lobe, which the search would start from, is as good as the best (``nearly_alike``).
"""

from __future__ import annotations

import math

from brdffit._jit import inline, kernel
from brdffit.halfangle.closed_forms import M_X, M_Y, STEEPEST_SLOPE, UU, UV, VV, XX
from brdffit.halfangle.objective import BOUNDED, HOLDS, PARAMETERS
from brdffit.halfangle.quadrature import ALPHA_SQUARED, GAIN, MIXTURE, NORMALISATION, SHAPE, SPECULAR, SPREAD, TENSOR
from brdffit.halfangle.response import ANSWERS, BY_FIRST, OFF_PLANE, OFF_SCALE, ROW, SECOND, THIRD

_SAFETY = 1.5
# Columns that hold a lobe's l, t1 and t2 for now: NORMALISATION is not set yet, isotropic lobes need no further tensor.
_LOG, _ALONG, _ACROSS = NORMALISATION, TENSOR + 1, TENSOR + 2
#: The excess where the closed form does not apply.
NOT_KNOWN = 1e30
#: Excess below which all lobes are alike.
FLAT_EXCESS = 1e-23
#: Scratch of ``closed_form``: the moments, then one row of the table.
WORK = THIRD + ROW


@inline
def _blend(response, log_alpha, cosine, row):
    """Interpolate the table linearly at log alpha and the cosine of the tilt; returns whether both lie within it."""
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
    """Estimate of the best lobe's error, 0.07 E[r^4], from the excess of the closed form."""
    return 0.07 * math.sqrt(excess / _SAFETY)


@kernel
def _own_scales(lobes, count, m1, m2, norm, row, report):
    """Correct the scales in ``report``[0:3] for channels whose own mean lobe differs from the common one.

    Returns the error that the common lobe leaves in these channels.
    """
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
    """Fill in the lobe of the closed form if its excess is within ``allowed``; returns the excess.

    The excess is the estimated relative squared error above that of the best lobe. If it is above ``allowed`` or the
    closed form does not apply, ``report`` is left as it is and ``theta`` has no meaning; otherwise ``theta`` (6,) is
    the lobe, ``report``[0:3] its scale and ``report``[3] its error. Lobes must be isotropic, of one shape, not widened;
    SPECULAR columns sum to (red, green, blue). ``kind``, ``low``, ``high``: ``scale``, ``scale_low`` and ``scale_high``
    of ``Search``. ``work`` (WORK,) is scratch.
    """
    # Weight of each lobe in the error, which is summed over channels with a scale each.
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
    # SPREAD is twice the covariance within a sample's part of the footprint, in the frame of the shortest rotation.
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
    # Turn the stretch from the axes along and across the tilt to those of the shortest rotation.
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


@kernel
def nearly_alike(lobes, count, moments, light):
    """E[r^4] of isotropic lobes as a light that adds ``light`` to their alpha^2 shows them. A tenth of it bounds the
    relative squared error that LEAN's lobe adds to that of the best.

    r^2 = t^2 + l^2 / 4 with the turn t of a lobe's normal from the mean in widths, sqrt(s) with
    s = mean alpha^2 + ``light``, and l = (alpha^2 - mean alpha^2) / s. Normals spread by E[t^2] = v widen the nearest
    lobe by c v / 2 in log alpha^2, where c is LEAN's 2, or 3 or 4 for the nearest in L2 of held and of free scale
    (brdffit.halfangle.response). So LEAN's is at most v off, which costs 0.15 v^2 (brdffit.fitting.bfgs); half that
    where c is 3. Widths that spread by l cost less.

    ``moments``: those of ``footprint_moments`` for the lobes without their SPREAD, which is added here.
    """
    s = moments[XX] + light
    inverse = 1.0 / s
    bottom = 1.0 / math.sqrt(1.0 + moments[M_X] * moments[M_X] + moments[M_Y] * moments[M_Y])
    n_x, n_y, n_z = -moments[M_X] * bottom, -moments[M_Y] * bottom, bottom
    fourth, xx, yy, xy = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        lobe = lobes[i]
        w = lobe[MIXTURE]
        d_x, d_y, d_z = lobe[0] - n_x, lobe[1] - n_y, lobe[2] - n_z
        wider = (lobe[ALPHA_SQUARED] - moments[XX]) * inverse
        squared = (d_x * d_x + d_y * d_y + d_z * d_z) * inverse + 0.25 * wider * wider
        fourth += w * squared * squared
        xx += w * lobe[SPREAD]
        yy += w * lobe[SPREAD + 1]
        xy += w * lobe[SPREAD + 2]
    # SPREAD is twice a covariance, in frames that nearly agree.
    moments[UU] += 0.5 * xx
    moments[VV] += 0.5 * yy
    moments[UV] += 0.5 * xy
    return (math.sqrt(fourth) + 0.5 * (xx + yy) * inverse) ** 2


@kernel
def diffuse_beside(moment, moments, red, green, blue, light):
    """A bound of the error of diffuse light (``losses.set_diffuse_error``) that the mean normal of the specular lobes
    causes, relative to the target's norm under the displayed loss: a lobe of alpha^2 = s and sum of colours C has the
    peak P = C / (pi s), and its norm is (2 / pi) P^2 pi s / 3 at least, times a third, since C sums three channels, and
    times the loss's weight at the peak.
    """
    bottom = 1.0 / math.sqrt(1.0 + moments[M_X] * moments[M_X] + moments[M_Y] * moments[M_Y])
    n_x, n_y, n_z = -moments[M_X] * bottom, -moments[M_Y] * bottom, bottom
    apart, diffuse = 0.0, 0.0
    for channel in range(3):
        x, y, z = moment[3 * channel], moment[3 * channel + 1], moment[3 * channel + 2]
        along = x * n_x + y * n_y + z * n_z
        apart += max(x * x + y * y + z * z - along * along, 0.0)
        diffuse += max(along, 0.0)
    if not apart > 0.0:
        return 0.0
    s = moments[XX] + light
    peak = (red + green + blue) / (math.pi * s)
    knee = 16.0 / (9.0 * math.pi) * diffuse
    share = knee / (peak + knee) if knee > 0.0 else 0.0
    return 2.0 / math.pi**2 * apart / max(2.0 / 9.0 * peak * peak * s * share * math.sqrt(share), 1e-30)
