"""Ashikhmin and Shirley 2000, half-angle form (as Baker uses it for MIP filtering).

D(h) = sqrt((p_u+2)(p_v+2)) / (2 pi) (n.h)^((p_u x_u^2 + p_v x_v^2) / (1 - (n.h)^2)).

In the roughness tensor (p = 2 / alpha^2 - 2 along each axis, so P = 2 Sigma^-1 - 2 I): x'P x = 2 q - 2 (1 - C), hence
the exponent is 2 q / (1 - C) - 2, and with (n.h) = sqrt C

    D = 1 / (pi sqrt(det Sigma)) exp((q - (1 - C)) L(C)),      L(C) = log(C) / (1 - C).

As C -> 1 the quotient L is 0/0 and tends to -1 (there, and not at n.h -> 0, the paper's form degenerates). Near C = 1
the kernel writes log C = u Q(u) with u = C - 1, so that L = -Q. At p_u = p_v this is Blinn-Phong exactly.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline
from brdffit.models import Model
from brdffit.models.elementary import exp_negative, log_parts, reciprocal

real = np.float32

_LEAST_C = 1e-6
_LN2 = math.log(2.0)
# From here on log C = u Q with u = C - 1 (see log_parts), and so L = -Q.
_NEAR = 0.75


@inline
def log_quotient(C):
    """L = log(C) / (1 - C) and dL/dC = (1 + C L) / (C (1 - C)); above 3/4 L = -Q and dL/dC is a minimax polynomial.

    The relative error is a few 1e-7, and 7e-6 for that polynomial.
    """
    k, u, quotient = log_parts(C)
    v = real(1.0) - C
    inverse = reciprocal(C * v)
    near = C > real(_NEAR)
    L = -quotient if near else (k * real(_LN2) + u * quotient) * (C * inverse)
    series = real(1.6943826180654333)
    series = series * u + real(-0.5857504991900313)
    series = series * u + real(0.7701566853635152)
    series = series * u + real(-0.6660261758776561)
    series = series * u + real(0.5000031707453986)
    return L, (series if near else (real(1.0) + C * L) * inverse)


@inline
def profile(q, C, s):
    """exp((q - (1 - C)) L(C))."""
    C = max(C, real(_LEAST_C))
    L, _ = log_quotient(C)
    return exp_negative((q - (real(1.0) - C)) * L)


@inline
def profile_gradient(q, C, s):
    """g = exp((q - (1 - C)) L); dg/dq = g L; dg/dC = g ((q - (1 - C)) L' + L)."""
    C = max(C, real(_LEAST_C))
    L, slope = log_quotient(C)
    beyond = q - (real(1.0) - C)
    g = exp_negative(beyond * L)
    return g, g * L, g * (beyond * slope + L), real(0.0)


@inline
def log_normalisation(s):
    """K = 1: the integral of D (n.h) over the hemisphere is 1."""
    return 0.0, 0.0


MODEL = Model(
    name="ashikhmin-shirley",
    summary="Ashikhmin-Shirley, half-angle form: an anisotropic Blinn-Phong",
    profile=profile,
    profile_gradient=profile_gradient,
    log_normalisation=log_normalisation,
    source="Ashikhmin and Shirley, An Anisotropic Phong BRDF Model, JGT 5(2), 2000",
)
