"""When the closed-form lobe is good enough: an estimate of its error from the footprint's moments alone.

For lobes that differ little, LEAN's error is second order. In slopes scaled to the mean tensor, with C the covariance
of the normals and V that of the tensors, the apparent lobe is D + (1/2) C : grad grad D + (1/2) V : d^2 D / dSigma^2
and LEAN's is D + 2 C : dD / dSigma. For GGX, D = u^2 / pi with u = 1 / (1 + t^2), and in the plane (where the integral
of a function of u is pi times that over du / u^2):

- normals, C = c I: the difference is c (12 u^3 - 12 u^4 - 2 u^2) / pi; its square over |D|^2 = 1 / (3 pi) is 0.914 c^2;
- tensors: v (3 u^4 - 2 u^3) / pi with v the relative variance of alpha^2, so 0.257 v^2;
- a channel whose mean normal is off by t: 1.2 t^2 of that channel's share (brdffit.fitting.bfgs);
- an isotropic fit leaves an anisotropy of up to 2 c: 0.2 c^2 at most.

Lobes with a Gaussian peak lose less: for them LEAN's first order is exact. The sum is doubled, for what is left out
(third moments, the horizon); a test holds it against the truth on random footprints.
"""

from __future__ import annotations

import math

from brdffit._jit import kernel
from brdffit.halfangle.closed_forms import tensor_of
from brdffit.halfangle.quadrature import MIXTURE, SHAPE, SPECULAR

_NORMALS, _TENSORS, _CHANNELS, _ANISOTROPY = 0.914, 0.257, 1.2, 0.2
_SAFETY = 2.0
_ALIKE = 1e-3


@kernel
def closed_form_error(lobes, count, isotropic_base, isotropic_fit):
    """Relative squared error of the closed-form lobe of a footprint, as a safe estimate; infinite where none holds.

    MIXTURE holds shares that sum to 1 (no defensive lobe yet).
    """
    x, y, z, total = 0.0, 0.0, 0.0, 0.0
    xx, yy, xy, least = 0.0, 0.0, 0.0, 1e30
    low, high = 1e30, -1e30
    for i in range(count):
        w = lobes[i, MIXTURE]
        x += w * lobes[i, 0]
        y += w * lobes[i, 1]
        z += w * lobes[i, 2]
        t_xx, t_yy, t_xy, smallest = tensor_of(lobes, i, isotropic_base)
        xx += w * t_xx
        yy += w * t_yy
        xy += w * t_xy
        least = min(least, smallest)
        low, high = min(low, lobes[i, SHAPE]), max(high, lobes[i, SHAPE])
        total += lobes[i, SPECULAR] + lobes[i, SPECULAR + 1] + lobes[i, SPECULAR + 2]
    if high - low > _ALIKE or z < 0.5 or not total > 0.0:
        return 1e30
    normals, tensors = 0.0, 0.0
    r_x, r_y, r_z, r_w = 0.0, 0.0, 0.0, 0.0
    b_x, b_y, b_z, b_w = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        w = lobes[i, MIXTURE]
        d_x, d_y, d_z = lobes[i, 0] - x, lobes[i, 1] - y, lobes[i, 2] - z
        normals += w * (d_x * d_x + d_y * d_y + d_z * d_z)
        t_xx, t_yy, t_xy, _ = tensor_of(lobes, i, isotropic_base)
        tensors += w * ((t_xx - xx) ** 2 + (t_yy - yy) ** 2 + 2.0 * (t_xy - xy) ** 2)
        red, blue = lobes[i, SPECULAR], lobes[i, SPECULAR + 2]
        r_w += red
        b_w += blue
        r_x += red * d_x
        r_y += red * d_y
        r_z += red * d_z
        b_x += blue * d_x
        b_y += blue * d_y
        b_z += blue * d_z
    c = normals / least
    v = tensors / (least * least)
    error = (_NORMALS + (_ANISOTROPY if isotropic_fit else 0.0)) * c * c + _TENSORS * v * v
    # Green lies between or is as far off: what red and blue miss is counted for all three.
    for offset, weight in (
        (r_x * r_x + r_y * r_y + r_z * r_z, r_w),
        (b_x * b_x + b_y * b_y + b_z * b_z, b_w),
    ):
        if weight > 1e-6 * total:
            error += _CHANNELS * offset / (weight * weight * least)
    return _SAFETY * error if math.isfinite(error) else 1e30
