"""The light of an even sky that a lobe reflects when it is rendered with masking, which the error integral ignores.

The error integral compares lobes D(h). A renderer shades D(h) G2 / (4 n.l n.v) n.l, and with that factor the lobes of
rough bumps and the wide lobe fitted to them differ: each bump is masked by its own tilt and roughness only, while the
wide lobe is masked as a whole and ends at one horizon. On coarse sand seen from above (alpha 0.23 on the bumps, 0.6 of
the lobe) a quarter of the light is missing. So a bounded scale is multiplied, within its bounds, by the light that all
lobes of the footprint send to viewers over the light that the fitted lobe sends.

The table is of GGX, whose masking every lobe here uses (see brdffit.models.microfacet). It holds the reflected share
of an even sky above the texture, for a lobe of given alpha whose normal is tilted, averaged over viewers that are
cosine-distributed about the normal of the texture, as in the half-angle density:

    a(alpha, cos) = E_v int D(h) G2 / (4 n.v) [n.l > 0, n.v > 0, l_z > 0] dl.

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
        (0.025, 0.048, 0.099, 0.178, 0.286, 0.422, 0.587, 0.774, 0.960),
        (0.060, 0.094, 0.148, 0.225, 0.322, 0.444, 0.584, 0.738, 0.883),
        (0.092, 0.130, 0.183, 0.251, 0.336, 0.438, 0.553, 0.675, 0.792),
        (0.114, 0.153, 0.201, 0.261, 0.333, 0.416, 0.506, 0.604, 0.701),
        (0.127, 0.164, 0.207, 0.259, 0.318, 0.384, 0.457, 0.535, 0.614),
        (0.134, 0.167, 0.205, 0.249, 0.298, 0.351, 0.409, 0.472, 0.537),
        (0.136, 0.166, 0.199, 0.236, 0.276, 0.319, 0.365, 0.415, 0.469),
        (0.135, 0.161, 0.190, 0.222, 0.255, 0.289, 0.326, 0.366, 0.410),
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
