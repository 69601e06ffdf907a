"""Generalised Beckmann: the shape-controlled lobe of Aittala, Weyrich and Lehtinen 2015 (after Brady et al. 2014).

D(h) = K(s) exp(-(s' Sigma^-1 s)^p) / (pi sqrt(det Sigma) (n.h)^4), with the shape exponent p = exp(s) as the fitted
parameter s: p = 1 is Beckmann, p < 1 has a sharper peak and a longer tail (higher kurtosis).

Normalisation, in scaled slopes t (d omega (n.h) = (n.h)^4 d^2 slope, and d^2 slope = sqrt(det Sigma) d^2 t):
integral exp(-|t|^(2p)) d^2 t = pi integral_0^inf exp(-y^p) dy = pi Gamma(1 + 1/p), so K = 1 / Gamma(1 + 1/p).
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline
from brdffit.models import Model
from brdffit.models.elementary import exp_negative, log_positive, reciprocal

real = np.float32

_LEAST_C = 1e-6
# q is a denominator; at 1e-20 the profile is 1 in float32 for every p >= 0.4.
_LEAST_Q = 1e-20
# y is capped at e^5: exp(-e^5) is 0 in any precision.
_MOST_LOG_Y = 5.0


@inline
def profile(q, C, s):
    """exp(-(q / C)^p) / C^2 with p = exp(s)."""
    r = reciprocal(max(C, real(_LEAST_C)))
    log_x = log_positive(max(q, real(_LEAST_Q)) * r)
    y = exp_negative(min(real(math.exp(s)) * log_x, real(_MOST_LOG_Y)))
    return exp_negative(-y) * r * r


@inline
def profile_gradient(q, C, s):
    """With x = q / C, y = x^p: dg/dq = -g p y / q; dg/dC = g (p y - 2) / C; dg/ds = -g p y log x."""
    C, q = max(C, real(_LEAST_C)), max(q, real(_LEAST_Q))
    inverse = reciprocal(q * C)
    r = q * inverse
    log_x = log_positive(q * r)
    p = real(math.exp(s))
    y = exp_negative(min(p * log_x, real(_MOST_LOG_Y)))
    g = exp_negative(-y) * r * r
    minus_py = -p * y
    slope = g * minus_py
    return g, slope * (C * inverse), g * (real(-2.0) - minus_py) * r, slope * log_x


@inline
def log_normalisation(s):
    """log K = -log Gamma(1 + 1/p); d log K / ds = digamma(1 + 1/p) / p.

    digamma by the recurrence up to 6 and its asymptotic series (error below 1e-10 there).
    """
    z = 1.0 + math.exp(-s)
    value = -math.lgamma(z)
    inverse_p = z - 1.0
    digamma = 0.0
    while z < 6.0:
        digamma -= 1.0 / z
        z += 1.0
    i2 = 1.0 / (z * z)
    digamma += math.log(z) - 0.5 / z - i2 * (1 / 12 - i2 * (1 / 120 - i2 * (1 / 252 - i2 / 240)))
    return value, digamma * inverse_p


MODEL = Model(
    name="generalised-beckmann",
    summary="Beckmann with a shape exponent (Aittala et al. 2015): tails from Gaussian to long; one more map",
    profile=profile,
    profile_gradient=profile_gradient,
    log_normalisation=log_normalisation,
    source="Aittala, Weyrich and Lehtinen, Two-Shot SVBRDF Capture for Stationary Materials, SIGGRAPH 2015",
    shape_bounds=(math.log(0.4), 0.0, math.log(2.5)),
)
