"""The lobe that a probe is filtered by.

A probe is filtered by K(n.l) = D(h) (n.l) over the hemisphere, normalised to unit integral, with the viewer along the
normal, v = n (Manson and Sloan 2016, equation 3; the figures in their tables belong to the lobe with the cosine). With
c = n.l the half vector has (n.h)^2 = (1 + c)/2, and GGX becomes, up to a constant,

    K(c) = c / (p - m c)^2,    p = (1 + alpha^2)/2,  m = (1 - alpha^2)/2,    since p - m c = alpha^2 + m (1 - c).

Its integral over the sphere is 2 pi / m^2 (p/alpha^2 - 1 + ln(alpha^2/p)), and pi at alpha = 1, a plain cosine.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

#: Half width at half maximum of a narrow lobe, in radians, over alpha: 2 sqrt(sqrt 2 - 1).
_HALF_WIDTH = 2.0 * math.sqrt(math.sqrt(2.0) - 1.0)


def lobe(one_minus_cosine: NDArray, alpha: float) -> NDArray:
    """K before normalisation, in the shape of ``one_minus_cosine`` = 1 - n.l; 0 below the horizon.

    The argument is 1 - n.l because that keeps its digits near the peak.
    """
    m = 0.5 * (1.0 - alpha * alpha)
    cosine = np.maximum(1.0 - one_minus_cosine, 0.0)
    return cosine / np.square(alpha * alpha + m * one_minus_cosine)


def lobe_integral(alpha: float) -> float:
    """Integral over the sphere of K as ``lobe`` returns it."""
    square = alpha * alpha
    m, p = 0.5 * (1.0 - square), 0.5 * (1.0 + square)
    if m < 1e-3:
        # The closed form cancels around alpha = 1; its series there is 2 pi / p^2 sum (k+1) (m/p)^k / (k+2).
        terms = sum((k + 1) * (m / p) ** k / (k + 2) for k in range(6))
        return 2.0 * math.pi * terms / (p * p)
    return 2.0 * math.pi / (m * m) * (p / square - 1.0 + math.log(square / p))


def half_width(alpha: float) -> float:
    """Half width at half maximum in radians, to first order in alpha (2% too large at alpha = 0.2)."""
    return _HALF_WIDTH * alpha


def is_narrow(alpha: float, n: int) -> bool:
    """Whether the full width at half maximum is less than a texel of faces of n^2 (2/n in u).

    Lobes around texel centres then leave gaps between them, and a small lamp shows or not depending on where it lies.
    """
    return 2.0 * half_width(alpha) < 2.0 / n


def half_angles(u: NDArray, alpha: float) -> tuple[NDArray, NDArray]:
    """Angles of half vectors from the normal at which the distribution function of D (n.h) is ``u``, and D there."""
    angle = np.arctan(alpha * np.sqrt(u / (1.0 - u)))
    return angle, alpha**2 / (np.pi * np.square(np.cos(angle) ** 2 * (alpha**2 - 1.0) + 1.0))
