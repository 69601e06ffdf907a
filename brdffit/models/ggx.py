"""GGX (Trowbridge and Reitz 1975; Walter, Marschner, Li and Torrance 2007; anisotropic: Burley 2012).

D(h) = 1 / (pi sqrt(det Sigma) (x' Sigma^-1 x + (n.h)^2)^2).
"""

from __future__ import annotations

import numpy as np

from brdffit._jit import inline
from brdffit.models import Model
from brdffit.models.elementary import reciprocal

real = np.float32


@inline
def profile(q, C, s):
    """(q + C)^-2."""
    r = reciprocal(q + C)
    return r * r


@inline
def profile_gradient(q, C, s):
    """g = (q + C)^-2; dg/dq = dg/dC = -2 (q + C)^-3."""
    r = reciprocal(q + C)
    g = r * r
    slope = real(-2.0) * g * r
    return g, slope, slope, real(0.0)


@inline
def log_normalisation(s):
    """K = 1: the integral of D (n.h) over the hemisphere is 1."""
    return 0.0, 0.0


MODEL = Model(
    name="ggx",
    summary="GGX / Trowbridge-Reitz, anisotropic; what engines use today (default)",
    profile=profile,
    profile_gradient=profile_gradient,
    log_normalisation=log_normalisation,
    widening=(4.0, 3.0, 0.1),  # derived in brdffit.halfangle.response
    averages=True,
    blur=0.74,  # the nearest of scale 1; 0.75 at R = alpha / 4, 0.70 at 4 alpha
    source="Walter et al., Microfacet Models for Refraction through Rough Surfaces, EGSR 2007",
)
