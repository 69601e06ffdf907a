"""Beckmann (Beckmann and Spizzichino 1963; anisotropic: Cook and Torrance 1982, Heitz 2014).

D(h) = exp(-s' Sigma^-1 s) / (pi sqrt(det Sigma) (n.h)^4), s the slope of h in the frame of n: with x the tangent-plane
part of h, s' Sigma^-1 s = q / C. Slopes are Gaussian with covariance Sigma / 2.
"""

from __future__ import annotations

import numpy as np

from brdffit._jit import inline
from brdffit.models import Model
from brdffit.models.elementary import exp_negative, reciprocal

real = np.float32

# Below n.h = 1e-3 the exponential has vanished for every alpha <= 1; the guard keeps 1 / C^2 finite.
_LEAST_C = 1e-6


@inline
def profile(q, C, s):
    """exp(-q / C) / C^2."""
    r = reciprocal(max(C, real(_LEAST_C)))
    return exp_negative(-q * r) * r * r


@inline
def profile_gradient(q, C, s):
    """g = exp(-q / C) / C^2; dg/dq = -g / C; dg/dC = g (q / C - 2) / C."""
    r = reciprocal(max(C, real(_LEAST_C)))
    x = q * r
    g = exp_negative(-x) * r * r
    return g, -g * r, g * (x - real(2.0)) * r, real(0.0)


@inline
def log_normalisation(s):
    """K = 1: exp(-|t|^2) integrates to pi over the plane of scaled slopes t."""
    return 0.0, 0.0


MODEL = Model(
    name="beckmann",
    summary="Beckmann: Gaussian slopes, anisotropic; the model that LEAN is exact for",
    profile=profile,
    profile_gradient=profile_gradient,
    log_normalisation=log_normalisation,
    source="Beckmann and Spizzichino 1963; Heitz, JCGT 3(2), 2014",
)
