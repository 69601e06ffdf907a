"""The half-angle density w(h): the probability density of the half vector of random directions l and v.

    w(h) = integral 4 (v.h) p(l) p(v) dv,   l = 2 (v.h) h - v,   v and l above the horizon   (dl = 4 (v.h) dh)

so that the mean of f(h(l, v)) over l and v is the integral of f w over the hemisphere.

**Uniform** l and v, p = 1 / (2 pi): w = (z.h) / pi.

**Cosine-distributed** l and v, p(v) = (z.v) / pi: w = (2 / pi) (z.h)^3. Derivation: in the frame of h with z tilted
by gamma, v = (sin t cos f, sin t sin f, cos t) and l is v with f turned by pi, so
(z.v)(z.l) = cos^2 t cos^2 gamma - sin^2 t cos^2 f sin^2 gamma, positive where sin^2 t < Y = 1 / (1 + k^2) with
k = |cos f| tan gamma. With y = sin^2 t (dv = dy df / (2 cos t)) the integral over y of
2 [(1 - y) cos^2 gamma - y cos^2 f sin^2 gamma] = 2 cos^2 gamma [1 - y (1 + k^2)] from 0 to Y is cos^2 gamma Y, and
integral_0^2pi df / (1 + tan^2 gamma cos^2 f) = 2 pi cos gamma. With the 1 / pi^2 of the two densities:
w = (2 / pi) cos^3 gamma. Both integrate to 1.
"""

from __future__ import annotations

import math

from brdffit._jit import inline

#: Exponent of z.h in w(h), by name of the distribution of l and v.
DENSITY_EXPONENTS = {"uniform": 1, "cosine": 3}

_UNIFORM = 1.0 / math.pi
_COSINE = 2.0 / math.pi


@inline
def half_angle_density(cos_h, exponent):
    """w at z.h = cos_h for exponent 1 (uniform l and v) or 3 (cosine-distributed); 0 below the horizon."""
    if cos_h <= 0.0:
        return 0.0
    return _COSINE * cos_h * cos_h * cos_h if exponent == 3 else _UNIFORM * cos_h
