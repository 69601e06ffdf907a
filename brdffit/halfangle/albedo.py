"""The light of an even sky that a lobe reflects when it is rendered with masking, which the error integral ignores.

The error integral compares lobes D(h). A renderer shades D(h) G2 / (4 n.l n.v) n.l, and with that factor the lobes of
rough bumps and the wide lobe fitted to them differ: each bump is masked by its own tilt and roughness only, while the
wide lobe is masked as a whole and ends at one horizon. On coarse sand seen from above (alpha 0.23 on the bumps, 0.6 of
the lobe) a quarter of the light is missing. So a bounded scale is multiplied, within its bounds, by the light that all
lobes of the footprint send to viewers over the light that the fitted lobe sends.

The table is of GGX, whose masking every lobe here uses (see brdffit.models.microfacet). It holds the reflected share
of an even sky above the texture, for a lobe of given alpha whose normal is tilted, averaged over viewers that are
cosine-distributed about the normal of the texture, as in the half-angle density:

    a(alpha, cos) = E_v int D(h) G2 / (4 n.v) [n.l > 0, l_z > 0] dl.

A mirror (alpha = 0) reflects v to l = 2 (n.v) n - v, and the mean over v is a = cos^2. Anisotropic lobes are treated as
isotropic ones of the same det Sigma.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel
from brdffit.halfangle.quadrature import ALPHA_SQUARED, SPECULAR, SPREAD, TENSOR

# Rows: alpha from 0 to 1; columns: cos from 0 to 1; both in steps of 1/8. Integrated with 2^17 points of a
# low-discrepancy sequence; the test draws its own.
_ALBEDO = np.array(
    [
        (0.000, 0.016, 0.063, 0.141, 0.250, 0.391, 0.562, 0.766, 1.000),
        (0.049, 0.076, 0.130, 0.209, 0.317, 0.451, 0.613, 0.792, 0.960),
        (0.111, 0.151, 0.206, 0.282, 0.379, 0.497, 0.630, 0.768, 0.882),
        (0.165, 0.210, 0.266, 0.332, 0.413, 0.508, 0.612, 0.711, 0.792),
        (0.208, 0.254, 0.306, 0.361, 0.426, 0.500, 0.575, 0.644, 0.700),
        (0.239, 0.284, 0.330, 0.374, 0.425, 0.479, 0.532, 0.578, 0.614),
        (0.264, 0.304, 0.343, 0.377, 0.415, 0.454, 0.489, 0.516, 0.536),
        (0.281, 0.316, 0.349, 0.375, 0.402, 0.428, 0.448, 0.461, 0.468),
        (0.293, 0.324, 0.351, 0.369, 0.388, 0.402, 0.412, 0.413, 0.409),
    ]
)
_STEPS = 8


@inline
def albedo_at(alpha_squared, cosine):
    """a(alpha, cos), interpolated bilinearly; both are clamped to [0, 1]."""
    x, y = _STEPS * min(math.sqrt(alpha_squared), 1.0), _STEPS * min(max(cosine, 0.0), 1.0)
    i, j = min(int(x), _STEPS - 1), min(int(y), _STEPS - 1)
    x, y = x - i, y - j
    low = _ALBEDO[i, j] + y * (_ALBEDO[i, j + 1] - _ALBEDO[i, j])
    high = _ALBEDO[i + 1, j] + y * (_ALBEDO[i + 1, j + 1] - _ALBEDO[i + 1, j])
    return low + x * (high - low)


@inline
def diffuse_fresnel(n_z):
    """Share of the diffuse light of a tilted bump that Fresnel leaves to a viewer above it: 1 - (1 - n_z)^5.

    Under lights with a size the diffuse moments of a footprint hold diffuse colours times it.
    """
    m = 1.0 - min(max(n_z, 0.0), 1.0)
    return 1.0 - m * m * m * m * m


@kernel
def albedo_of_lobes(lobes, count, isotropic):
    """Mean albedo of the ``count`` lobes of a footprint, weighted by colour; 0 where filter weights leave no colour."""
    whole, reflected = 0.0, 0.0
    for i in range(count):
        lobe = lobes[i]
        w = lobe[SPECULAR] + lobe[SPECULAR + 1] + lobe[SPECULAR + 2]
        if isotropic:
            square = lobe[ALPHA_SQUARED]
        else:
            square = math.sqrt(max(lobe[TENSOR] * lobe[TENSOR + 1] - lobe[TENSOR + 2] ** 2, 1e-24))
        # SPREAD is twice the covariance of the sample's normals: their mean cosine is less by the factor 1 - trace / 4.
        cosine = lobe[2] * (1.0 - 0.25 * min(lobe[SPREAD] + lobe[SPREAD + 1], 1.0))
        whole += w
        reflected += w * albedo_at(square, cosine)
    return max(reflected / whole, 0.0) if whole > 1e-12 else 0.0


@kernel
def albedo_of(theta):
    """Albedo of the lobe ``theta`` (6,) with the scale 1."""
    return albedo_at(math.exp(0.5 * (theta[2] + theta[3])), 1.0 / math.sqrt(1.0 + theta[0] ** 2 + theta[1] ** 2))
