"""Ashikhmin and Shirley 2000, half-angle form (as Baker uses it for MIP filtering).

D(h) = sqrt((p_u+2)(p_v+2)) / (2 pi) (n.h)^((p_u x_u^2 + p_v x_v^2) / (1 - (n.h)^2)).

In the roughness tensor (p = 2 / alpha^2 - 2 along each axis, so P = 2 Sigma^-1 - 2 I): x'P x = 2 q - 2 (1 - C), hence
the exponent is 2 q / (1 - C) - 2, and with (n.h) = sqrt C

    D = 1 / (pi sqrt(det Sigma)) exp(q L(C)) / C,      L(C) = log(C) / (1 - C).

As C -> 1 the quotient L is 0/0 and tends to -1 (it is there, not at n.h -> 0, that the paper's form degenerates): a
series in 1 - C takes over. At p_u = p_v this is Blinn-Phong exactly.
"""

from __future__ import annotations

import numpy as np

from brdffit._jit import inline
from brdffit.models import Model
from brdffit.models.elementary import exp_negative, log_positive

real = np.float32

_LEAST_C = 1e-6


@inline
def log_quotient(C):
    """L = log(C) / (1 - C) and dL/dC = (1/C + L) / (1 - C); series in v = 1 - C where v < 0.1.

    log(1 - v) / v = -(1 + v/2 + v^2/3 + ...); the first dropped term is v^6/7 < 2e-7.
    """
    v = real(1.0) - C
    near = v < real(0.1)
    safe = real(0.5) if near else v
    quotient = log_positive(real(1.0) - safe) / safe
    slope = (real(1.0) / (real(1.0) - safe) + quotient) / safe
    series = real(1 / 2) + v * (real(1 / 3) + v * (real(1 / 4) + v * (real(1 / 5) + v * real(1 / 6))))
    series = real(-1.0) - v * series
    series_slope = real(1 / 2) + v * (real(2 / 3) + v * (real(3 / 4) + v * (real(4 / 5) + v * real(5 / 6))))
    return (series if near else quotient), (series_slope if near else slope)


@inline
def profile(q, C, s):
    """exp(q L(C)) / C."""
    C = max(C, real(_LEAST_C))
    quotient, _ = log_quotient(C)
    return exp_negative(min(q * quotient, real(0.0))) / C


@inline
def profile_gradient(q, C, s):
    """g = exp(q L) / C; dg/dq = g L; dg/dC = g (q L' - 1 / C)."""
    C = max(C, real(_LEAST_C))
    r = real(1.0) / C
    quotient, slope = log_quotient(C)
    g = exp_negative(min(q * quotient, real(0.0))) * r
    return g, g * quotient, g * (q * slope - r), real(0.0)


@inline
def log_normalisation(s):
    """Nothing to add: the half-angle form integrates to 1 with the cosine."""
    return 0.0, 0.0


MODEL = Model(
    name="ashikhmin-shirley",
    summary="Ashikhmin-Shirley, half-angle form: an anisotropic Blinn-Phong",
    profile=profile,
    profile_gradient=profile_gradient,
    log_normalisation=log_normalisation,
    source="Ashikhmin and Shirley, An Anisotropic Phong BRDF Model, JGT 5(2), 2000",
)
