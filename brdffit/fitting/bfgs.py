"""BFGS for one texel (Nocedal and Wright 2006, chapter 6).

The first inverse Hessian is that of Gauss-Newton for a lobe that fits exactly. For GGX on the plane, with
D = (1 + t^2)^-2 / pi and e = |D' - proj D'|^2 / |D|^2 for a change D' of the lobe:

- a shift of the peak by t (in units of alpha): e = 1.2 t^2, so 1 / sqrt(2.4) = 0.65;
- a common change of log alpha^2: e = 0.15 l^2 with free scale, so 1 / sqrt(0.3) = 1.8;
- an anisotropic change (a = -b, or c): e = 0.2 d^2, so 1 / sqrt(0.4) = 1.6.

With a loss other than L2 the true curvature differs by a factor. Searches with ``rescaled`` set multiply the matrix by
y's / y'Hy of the first step (equation 6.20).

The same numbers are the units in which the length of a step is measured. Parameters that are held have rows of zeros:
an isotropic fit keeps only the common change of log alpha^2, a held normal has no shifts.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import inline, kernel
from brdffit.fitting.status import CONVERGED, FALLBACK, ITERATION_LIMIT, PRECISION_LIMIT
from brdffit.halfangle.frame import tensor_of_log
from brdffit.halfangle.lights import EVALUATION, LOBE_BLUR, evaluate_table
from brdffit.halfangle.objective import PARAMETERS

_SHIFT, _SIZE, _STRETCH, _SHAPE = 0.65, 1.8, 1.6, 1.0
# Longest step; under lights with a size, below which the error is flat in log alpha^2: a long step from a wide start
# would end there, beyond the best lobe.
_LONGEST_STEP, _LONGEST_SEEN = 2.0, 0.7
_ARMIJO = 1e-4
_BACKTRACKS = 8
# Bounds of the factor by which the first step may scale the first matrix.
_LEAST_SCALE, _MOST_SCALE = 0.2, 5.0
# Steps after which a search may be given up, and by how much more than its quadratic model promises it could gain.
_TRIED, _HOPED = 3, 4.0
# The objective is a sum of a few hundred float32 terms, about 1 in all: a smaller decrease is rounding.
_NOISE = 5e-7

# What is fitted besides the scale and the mean log alpha^2: bits of a mask.
FREE_NORMAL, FREE_ANISOTROPY, FREE_SHAPE = 1, 2, 4


class Space(NamedTuple):
    """Arrays of one search: ``gradient`` at the current point; ``trial`` point and ``trial_gradient``; ``step``, the
    ``change`` of the gradient over it and the product ``image`` of the inverse Hessian with that change; ``inverse``
    Hessian; scratch of an ``evaluation``."""

    gradient: NDArray
    trial: NDArray
    trial_gradient: NDArray
    step: NDArray
    change: NDArray
    image: NDArray
    inverse: NDArray
    evaluation: NDArray


def make_space() -> Space:
    """The arrays of a search."""
    gradient, trial, trial_gradient, step, change, image = np.zeros((6, PARAMETERS))
    inverse = np.zeros((PARAMETERS, PARAMETERS))
    return Space(gradient, trial, trial_gradient, step, change, image, inverse, np.zeros(EVALUATION))


def directions_of(free: int) -> int:
    """How many directions of the parameter space a mask leaves free."""
    return 1 + 2 * bool(free & FREE_NORMAL) + 2 * bool(free & FREE_ANISOTROPY) + bool(free & FREE_SHAPE)


@inline
def first_inverse(theta, free, inverse):
    """Fill ``inverse`` (6, 6) with the inverse Hessian that a search starts from. Returns its block for the slopes of
    the normal as (xx, yy, xy), even where the normal is held."""
    for i in range(PARAMETERS):
        for k in range(PARAMETERS):
            inverse[i, k] = 0.0
    xx, yy, xy = tensor_of_log(theta[2], theta[3], theta[4])
    # Along the tilt dn = dm / (1 + m^2). Across it dn is larger by 1 / cos(tilt), which a first matrix may ignore.
    lift = _SHIFT * (1.0 + theta[0] * theta[0] + theta[1] * theta[1])
    xx, yy, xy = lift * lift * xx, lift * lift * yy, lift * lift * xy
    if free & FREE_NORMAL:
        inverse[0, 0], inverse[1, 1] = xx, yy
        inverse[0, 1] = inverse[1, 0] = xy
    size, stretch = _SIZE * _SIZE, _STRETCH * _STRETCH if free & FREE_ANISOTROPY else 0.0
    inverse[2, 2] = inverse[3, 3] = size + stretch
    inverse[2, 3] = inverse[3, 2] = size - stretch
    inverse[4, 4] = stretch
    inverse[5, 5] = _SHAPE * _SHAPE if free & FREE_SHAPE else 0.0
    return xx, yy, xy


@kernel
def minimise(
    theta, value, free, table, setting, moments_kernel, log_normalisation, tolerance, floor, most, rescaled, space, bar
):  # fmt: skip
    """Lower the objective from ``theta`` (6,), in place.

    ``space.gradient`` must hold the gradient at theta, and ``value`` the objective there (relative squared error - 1).
    The search stops when the decrease that the quadratic model still predicts is below ``tolerance`` times the error,
    below ``floor`` (in units of the objective) or below rounding, and after ``most`` steps; it is given up where the
    model promises to end above ``bar``, the objective of a better end.
    Returns (value, evaluations, status). The value never rises.
    """
    gradient, trial_gradient, trial = space.gradient, space.trial_gradient, space.trial
    step, change, image = space.step, space.change, space.image
    # Held parameters have zeros in the matrix: all loops then have a fixed length, which the compiler unrolls.
    inverse = space.inverse
    xx, yy, xy = first_inverse(theta, free, inverse)
    longest = _LONGEST_SEEN if table.lights[0, LOBE_BLUR] > 0.0 else _LONGEST_STEP
    evaluations = 0
    for iteration in range(most):
        slope = 0.0
        for i in range(PARAMETERS):
            s = 0.0
            for k in range(PARAMETERS):
                s -= inverse[i, k] * gradient[k]
            step[i] = s
            slope += s * gradient[i]
        if not math.isfinite(slope):
            return value, evaluations, FALLBACK
        if iteration >= _TRIED and value + _HOPED * 0.5 * slope > bar:
            return value, evaluations, CONVERGED
        if -0.5 * slope <= max(max(tolerance * (1.0 + value), floor), _NOISE):
            return value, evaluations, CONVERGED
        shift = (yy * step[0] ** 2 + xx * step[1] ** 2 - 2.0 * xy * step[0] * step[1]) / (xx * yy - xy * xy)
        size, stretch = 0.5 * (step[2] + step[3]) / _SIZE, 0.5 * (step[2] - step[3]) / _STRETCH
        length = shift + size**2 + stretch**2 + (step[4] / _STRETCH) ** 2 + (step[5] / _SHAPE) ** 2
        t = 1.0 if length <= longest * longest else longest / math.sqrt(length)
        accepted = False
        trial_value = value
        for _ in range(_BACKTRACKS):
            for p in range(PARAMETERS):
                trial[p] = theta[p] + t * step[p]
            trial_value = evaluate_table(
                trial, table, setting, moments_kernel, log_normalisation, trial_gradient, space.evaluation
            )
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
        for p in range(PARAMETERS):
            step[p] *= t
            change[p] = trial_gradient[p] - gradient[p]
            product += step[p] * change[p]
            theta[p] = trial[p]
            gradient[p] = trial_gradient[p]
        value = trial_value
        # Without positive curvature along the step the update would not stay positive definite: keep the old matrix.
        if product > 1e-14:
            quadratic = 0.0
            for i in range(PARAMETERS):
                s = 0.0
                for k in range(PARAMETERS):
                    s += inverse[i, k] * change[k]
                image[i] = s
                quadratic += change[i] * s
            if rescaled and iteration == 0 and quadratic > 0.0:
                # The curvature along the first step gives the scale of the first matrix.
                by = min(max(product / quadratic, _LEAST_SCALE), _MOST_SCALE)
                quadratic *= by
                for i in range(PARAMETERS):
                    image[i] *= by
                    for k in range(PARAMETERS):
                        inverse[i, k] *= by
            share = 1.0 / product
            factor = (1.0 + quadratic * share) * share
            for i in range(PARAMETERS):
                along, across = factor * step[i] - share * image[i], share * step[i]
                for k in range(PARAMETERS):
                    inverse[i, k] += along * step[k] - across * image[k]
    return value, evaluations, ITERATION_LIMIT
