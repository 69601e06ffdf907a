"""BFGS for one texel.

The search runs in scaled coordinates z with theta = theta_0 + P z, where P's columns are the Gauss-Newton scale of a
lobe that fits exactly, so that the first inverse Hessian is the identity. For GGX on the plane, with D = (1 + t^2)^-2 /
pi and e = |D' - proj D'|^2 / |D|^2 for a change D' of the lobe:

- a shift of the peak by t (in units of alpha): e = 1.2 t^2, so 1 / sqrt(2.4) = 0.65;
- a common change of log alpha^2: e = 0.15 l^2 with free scale, so 1 / sqrt(0.3) = 1.8;
- an anisotropic change (a = -b, or c): e = 0.2 d^2, so 1 / sqrt(0.4) = 1.6.

Reduced fits drop columns: isotropic keeps the common change alone, a held normal drops the shifts.
"""

from __future__ import annotations

import math

from brdffit._jit import inline, kernel
from brdffit.fitting.status import CONVERGED, FALLBACK, ITERATION_LIMIT, PRECISION_LIMIT
from brdffit.halfangle.frame import eigen_log
from brdffit.halfangle.objective import PARAMETERS, evaluate

_SHIFT, _SIZE, _STRETCH, _SHAPE = 0.65, 1.8, 1.6, 1.0
_LONGEST_STEP = 2.0
_ARMIJO = 1e-4
_BACKTRACKS = 8
# Sums of a few hundred float32 terms around 1: no decrease below this can be told from rounding.
_NOISE = 5e-7

# What is fitted besides the scale: bits of a mask.
FREE_NORMAL, FREE_ANISOTROPY, FREE_SHAPE = 1, 2, 4

WORK = 200
# Where in ``work`` a search keeps its own: the step in theta, gradient by z, step in z, change of that gradient, its
# product with the inverse Hessian, columns of P, inverse Hessian.
_TURN, _SLOPES, _STEP, _CHANGE, _IMAGE, _COLUMNS, _INVERSE = 18, 24, 30, 36, 42, 48, 84
_SQUARE = PARAMETERS * PARAMETERS


@inline
def search_columns(theta, free, columns):
    """Fill ``columns`` (6, 6) with the search directions at theta; returns how many there are."""
    for i in range(PARAMETERS):
        for k in range(PARAMETERS):
            columns[i, k] = 0.0
    l1, l2, cos, sin = eigen_log(theta[2], theta[3], theta[4])
    k = 0
    if free & FREE_NORMAL:
        # dn is about dm / (1 + m^2) to within the tilt's cosine.
        lift = _SHIFT * (1.0 + theta[0] * theta[0] + theta[1] * theta[1])
        columns[0, 0], columns[1, 0] = lift * math.exp(0.5 * l1) * cos, lift * math.exp(0.5 * l1) * sin
        columns[0, 1], columns[1, 1] = -lift * math.exp(0.5 * l2) * sin, lift * math.exp(0.5 * l2) * cos
        k = 2
    columns[2, k] = columns[3, k] = _SIZE
    k += 1
    if free & FREE_ANISOTROPY:
        columns[2, k], columns[3, k] = _STRETCH, -_STRETCH
        columns[4, k + 1] = _STRETCH
        k += 2
    if free & FREE_SHAPE:
        columns[5, k] = _SHAPE
        k += 1
    return k


@kernel
def minimise(theta, value, free, nodes, setting, moments_kernel, log_normalisation, tolerance, floor, most, work):
    """Lower the objective from ``theta`` (6,), in place.

    ``work[0:6]`` must hold the gradient at theta and ``value`` the objective there (relative squared error - 1).
    Stops when the decrease that the model still predicts is below ``tolerance`` times the error itself, or below
    ``floor`` (in units of the objective).
    Returns (value, evaluations, status); theta is never worse than it was.
    """
    gradient, trial_gradient, trial, scratch = work[0:6], work[6:12], work[12:18], work[120:168]
    size = search_columns(theta, free, work[_COLUMNS : _COLUMNS + _SQUARE].reshape(PARAMETERS, PARAMETERS))
    # Directions that are not searched have zeros everywhere: loops of a known length are no loops to the compiler.
    for i in range(_SQUARE):
        work[_INVERSE + i] = 0.0
    for i in range(size):
        work[_INVERSE + i * PARAMETERS + i] = 1.0
    for i in range(PARAMETERS):
        s = 0.0
        for p in range(PARAMETERS):
            s += work[_COLUMNS + p * PARAMETERS + i] * gradient[p]
        work[_SLOPES + i] = s
    evaluations = 0
    for _ in range(most):
        slope = 0.0
        length = 0.0
        for i in range(PARAMETERS):
            s = 0.0
            for k in range(PARAMETERS):
                s -= work[_INVERSE + i * PARAMETERS + k] * work[_SLOPES + k]
            work[_STEP + i] = s
            slope += s * work[_SLOPES + i]
            length += s * s
        if not math.isfinite(slope):
            return value, evaluations, FALLBACK
        if -0.5 * slope <= max(max(tolerance * (1.0 + value), floor), _NOISE):
            return value, evaluations, CONVERGED
        for p in range(PARAMETERS):
            s = 0.0
            for i in range(PARAMETERS):
                s += work[_COLUMNS + p * PARAMETERS + i] * work[_STEP + i]
            work[_TURN + p] = s
        t = 1.0 if length <= _LONGEST_STEP * _LONGEST_STEP else _LONGEST_STEP / math.sqrt(length)
        accepted = False
        trial_value = value
        for _ in range(_BACKTRACKS):
            for p in range(PARAMETERS):
                trial[p] = theta[p] + t * work[_TURN + p]
            trial_value = evaluate(trial, nodes, setting, moments_kernel, log_normalisation, trial_gradient, scratch)
            evaluations += 1
            if trial_value <= value + _ARMIJO * t * slope:
                accepted = True
                break
            # Minimum of the parabola through value, slope and the trial, kept within sensible bounds.
            curvature = trial_value - value - t * slope
            shorter = -0.5 * slope * t * t / curvature if curvature > 0.0 else 0.1 * t
            t = min(max(shorter, 0.1 * t), 0.5 * t)
        if not accepted:
            return value, evaluations, PRECISION_LIMIT
        product = 0.0
        for i in range(PARAMETERS):
            g = 0.0
            for p in range(PARAMETERS):
                g += work[_COLUMNS + p * PARAMETERS + i] * trial_gradient[p]
            work[_CHANGE + i] = g - work[_SLOPES + i]
            work[_SLOPES + i] = g
            work[_STEP + i] *= t
            product += work[_STEP + i] * work[_CHANGE + i]
        for p in range(PARAMETERS):
            theta[p] = trial[p]
            gradient[p] = trial_gradient[p]
        value = trial_value
        # Without curvature along the step the update would lose positive definiteness: keep the old matrix.
        if product > 1e-14:
            quadratic = 0.0
            for i in range(PARAMETERS):
                s = 0.0
                for k in range(PARAMETERS):
                    s += work[_INVERSE + i * PARAMETERS + k] * work[_CHANGE + k]
                work[_IMAGE + i] = s
                quadratic += work[_CHANGE + i] * s
            share = 1.0 / product
            factor = (1.0 + quadratic * share) * share
            for i in range(PARAMETERS):
                along, across = factor * work[_STEP + i] - share * work[_IMAGE + i], share * work[_STEP + i]
                for k in range(PARAMETERS):
                    work[_INVERSE + i * PARAMETERS + k] += along * work[_STEP + k] - across * work[_IMAGE + k]
    return value, evaluations, ITERATION_LIMIT
