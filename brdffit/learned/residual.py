"""A lobe as a closed form and a correction in the frame of that closed form.

With the closed form's normal n, axes p and q and eigenvalues l_1, l_2 (``moments``), a correction d (5,) gives

    v = n + d_0 sqrt(l_1) p + d_1 sqrt(l_2) q,   slopes m = -(v_x, v_y) / v_z,
    log Sigma = log Sigma_0 + Q [[d_2, d_4], [d_4, d_3]] Q',   Q = (p, q) in the tangent plane.

d = 0 leaves the closed form unchanged. Normals move in units of lobe widths and tensors by factors, so a correction of
a given size means the same for sharp and for dull lobes. v_z is bounded below so that slopes do not exceed
STEEPEST_SLOPE; ``pull_back`` ignores that bound.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit.halfangle.closed_forms import STEEPEST_SLOPE
from brdffit.learned.kernels.moments import FIRST, LOG_TENSOR, NORMAL, ROOTS, SECOND, TURN

#: Size of a correction.
CORRECTIONS = 5
#: Components that change sign when the first axis, or the second, is reversed.
FIRST_ODD, SECOND_ODD = (0, 4), (1, 4)


def _axes(closed: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Columns: sqrt(l_1) p and sqrt(l_2) q (n, 3), and cos and sin of p in the tangent plane (n,)."""
    p, q = closed[:, FIRST : FIRST + 3], closed[:, SECOND : SECOND + 3]
    # p = cos t + sin b, with t and b of ``tangent_frame``.
    cos, sin = closed[:, TURN], closed[:, TURN + 1]
    return closed[:, ROOTS, None] * p, closed[:, ROOTS + 1, None] * q, cos, sin


def _moved(closed: NDArray, d: NDArray, p: NDArray, q: NDArray) -> NDArray:
    v = closed[:, NORMAL : NORMAL + 3] + d[:, :1] * p + d[:, 1:2] * q
    flat = np.hypot(v[:, 0], v[:, 1])
    v[:, 2] = np.maximum(v[:, 2], flat / STEEPEST_SLOPE)
    return v


def compose(closed: NDArray, d: NDArray) -> NDArray:
    """theta (n, 5) float64, slopes and log tensor, of closed forms (n, CLOSED) and corrections (n, 5)."""
    p, q, cos, sin = _axes(closed)
    v = _moved(closed, d, p, q)
    theta = np.empty((len(d), 5))
    theta[:, :2] = -v[:, :2] / v[:, 2:]
    theta[:, 2:] = closed[:, LOG_TENSOR : LOG_TENSOR + 3]
    theta[:, 2] += cos * cos * d[:, 2] + sin * sin * d[:, 3] - 2.0 * cos * sin * d[:, 4]
    theta[:, 3] += sin * sin * d[:, 2] + cos * cos * d[:, 3] + 2.0 * cos * sin * d[:, 4]
    theta[:, 4] += cos * sin * (d[:, 2] - d[:, 3]) + (cos * cos - sin * sin) * d[:, 4]
    return theta


def pull_back(closed: NDArray, d: NDArray, by_theta: NDArray) -> NDArray:
    """dL/dd (n, 5) from dL/dtheta (n, 5): the transposed derivative of ``compose``.

    m = -v_xy / v_z, so dm/dv = -(I, m) / v_z, with m the slope itself.
    """
    p, q, cos, sin = _axes(closed)
    v = _moved(closed, d, p, q)
    g = by_theta
    by_v = np.stack([-g[:, 0], -g[:, 1], (g[:, 0] * v[:, 0] + g[:, 1] * v[:, 1]) / v[:, 2]], axis=1) / v[:, 2:]
    out = np.empty((len(d), 5))
    out[:, 0], out[:, 1] = (by_v * p).sum(axis=1), (by_v * q).sum(axis=1)
    a, b, c = g[:, 2], g[:, 3], g[:, 4]
    out[:, 2] = cos * cos * a + sin * sin * b + cos * sin * c
    out[:, 3] = sin * sin * a + cos * cos * b - cos * sin * c
    out[:, 4] = 2.0 * cos * sin * (b - a) + (cos * cos - sin * sin) * c
    return out
