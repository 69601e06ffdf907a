"""The other half of the split sum: scale and bias of F0 over (n.v, roughness), and what the split itself errs by.

For GGX with height-correlated Smith masking and Schlick's Fresnel (Karis 2013; Lagarde and de Rousiers 2014):
(scale, bias) = E[(1 - F) W], E[F W] with F = (1 - v.h)^5 and W = 4 V (n.l) (v.h) / (n.h) over half vectors drawn from
D (n.h). At n.v = 1 and alpha = 1 their sum is 1 - ln 2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_RADIAL, _AROUND = 96, 48


def scale_and_bias(cosine: NDArray, alpha: float) -> NDArray:
    """(..., 2) scale and bias at n.v = ``cosine`` (...), by Gauss points in the square of D's distribution."""
    node, weight = np.polynomial.legendre.leggauss(_RADIAL)
    turn, share = np.polynomial.legendre.leggauss(_AROUND)
    u = 0.5 * (node + 1.0)
    # Nodes gather at grazing half vectors, where masking bends.
    u, weight = 1.0 - (1.0 - u) ** 2, 0.5 * weight * 2.0 * (1.0 - u)
    azimuth, share = 0.5 * np.pi * (turn + 1.0), 0.5 * share
    cos_h = np.sqrt((1.0 - u) / (1.0 + (alpha * alpha - 1.0) * u))[:, None]
    sin_h = np.sqrt(np.maximum(1.0 - cos_h**2, 0.0))
    nv = np.maximum(np.asarray(cosine, np.float64), 1e-4)[..., None, None]
    sin_v = np.sqrt(np.maximum(1.0 - nv * nv, 0.0))
    vh = np.maximum(sin_v * sin_h * np.cos(azimuth) + nv * cos_h, 0.0)
    nl = np.maximum(2.0 * vh * cos_h - nv, 0.0)
    square = alpha * alpha
    lit = nl * np.sqrt(square + (1.0 - square) * nv * nv) + nv * np.sqrt(square + (1.0 - square) * nl * nl)
    visibility = 0.5 / np.maximum(lit, 1e-12)
    value = 4.0 * visibility * nl * vh / cos_h * weight[:, None] * share
    fresnel = (1.0 - vh) ** 5
    return np.stack([((1.0 - fresnel) * value).sum(axis=(-1, -2)), (fresnel * value).sum(axis=(-1, -2))], axis=-1)


def dfg_table(size: int = 64) -> NDArray:
    """(size, size, 2) float32: columns n.v, rows perceptual roughness, both at (k + 1/2)/size, row 0 the smoothest."""
    at = (np.arange(size) + 0.5) / size
    return np.stack([scale_and_bias(at, max(r * r, 1e-4)) for r in at]).astype(np.float32)
