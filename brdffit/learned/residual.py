"""A lobe as two closed forms and a correction in the frame of the first.

With the first form's normal n, axes p and q and eigenvalues l_1, l_2, the second form's normal n_1 and tensor Sigma_1,
and the gate's argument x (``moments``), a correction d (6,) gives

    g = s(x + ``GATE_GAIN`` d_5),   s(x) = 1 / (1 + exp(-x)),   k = (det Sigma_1 / det Sigma_0)^(g / 4),
    v = n + g (n_1 - n) + k d_0 sqrt(l_1) p + k d_1 sqrt(l_2) q,   slopes m = -(v_x, v_y) / v_z,
    log Sigma = (1 - g) log Sigma_0 + g log Sigma_1 + Q [[d_2, d_4], [d_4, d_3]] Q',   Q = (p, q) in the tangent plane.

d = 0 leaves the closed forms as the gate's argument blends them. Normals move in units of lobe widths and tensors by
factors, so a correction of a given size means the same for sharp and for dull lobes. v_z is bounded below so that
slopes do not exceed STEEPEST_SLOPE; ``pull_back`` ignores that bound.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.halfangle.closed_forms import STEEPEST_SLOPE
from brdffit.learned.kernels.moments import (
    FIRST,
    GATE,
    LOG_TENSOR,
    NORMAL,
    OTHER,
    ROOTS,
    SECOND,
    SMALLER,
    TURN,
)
from brdffit.learned.kernels.saying import GATE_GAIN, MOST_GATE

#: Size of a correction.
CORRECTIONS = 6
#: Components that change sign when the first axis, or the second, is reversed.
FIRST_ODD, SECOND_ODD = (0, 4), (1, 4)


class _Parts(NamedTuple):
    """What a correction is made of, for n texels.

    Attributes:
        p, q: sqrt(l_1) p and sqrt(l_2) q (n, 3).
        cos, sin: of p in the tangent plane (n,).
        gate: share of the second closed form (n, 1).
        shrink: factor (n, 1) of the axes' lengths, as the gate shrinks the lobe.
    """

    p: NDArray
    q: NDArray
    cos: NDArray
    sin: NDArray
    gate: NDArray
    shrink: NDArray


def _parts(closed: NDArray, d: NDArray) -> _Parts:
    p, q = closed[:, FIRST : FIRST + 3], closed[:, SECOND : SECOND + 3]
    gate = 1.0 / (1.0 + np.exp(-np.clip(closed[:, GATE, None] + GATE_GAIN * d[:, 5:6], -MOST_GATE, MOST_GATE)))
    shrink = np.exp(0.5 * gate * closed[:, SMALLER, None])
    # p = cos t + sin b, with t and b of ``tangent_frame``.
    return _Parts(
        closed[:, ROOTS, None] * p, closed[:, ROOTS + 1, None] * q, closed[:, TURN], closed[:, TURN + 1], gate, shrink
    )


def _moved(closed: NDArray, d: NDArray, parts: _Parts) -> NDArray:
    """The normal, not of unit length, with the axes and the gate of ``parts``."""
    v = closed[:, NORMAL : NORMAL + 3] + parts.gate * closed[:, OTHER : OTHER + 3]
    v += parts.shrink * (d[:, :1] * parts.p + d[:, 1:2] * parts.q)
    flat = np.hypot(v[:, 0], v[:, 1])
    v[:, 2] = np.maximum(v[:, 2], flat / STEEPEST_SLOPE)
    return v


def compose(closed: NDArray, d: NDArray) -> NDArray:
    """theta (n, 5) float64, slopes and log tensor, of closed forms (n, CLOSED) and corrections (n, CORRECTIONS)."""
    parts = _parts(closed, d)
    cos, sin = parts.cos, parts.sin
    v = _moved(closed, d, parts)
    theta = np.empty((len(d), 5))
    theta[:, :2] = -v[:, :2] / v[:, 2:]
    theta[:, 2:] = closed[:, LOG_TENSOR : LOG_TENSOR + 3] + parts.gate * closed[:, OTHER + 3 : OTHER + 6]
    theta[:, 2] += cos * cos * d[:, 2] + sin * sin * d[:, 3] - 2.0 * cos * sin * d[:, 4]
    theta[:, 3] += sin * sin * d[:, 2] + cos * cos * d[:, 3] + 2.0 * cos * sin * d[:, 4]
    theta[:, 4] += cos * sin * (d[:, 2] - d[:, 3]) + (cos * cos - sin * sin) * d[:, 4]
    return theta


def pull_back(closed: NDArray, d: NDArray, by_theta: NDArray) -> NDArray:
    """dL/dd (n, CORRECTIONS) from dL/dtheta (n, 5): the transposed derivative of ``compose``.

    m = -v_xy / v_z, so dm/dv = -(I, m) / v_z, with m the slope itself. The gate g = s(x) has dg/dx = g (1 - g).
    """
    parts = _parts(closed, d)
    p, q, cos, sin, shrink = parts.p, parts.q, parts.cos, parts.sin, parts.shrink
    v = _moved(closed, d, parts)
    g = by_theta
    by_v = np.stack([-g[:, 0], -g[:, 1], (g[:, 0] * v[:, 0] + g[:, 1] * v[:, 1]) / v[:, 2]], axis=1) / v[:, 2:]
    out = np.empty((len(d), CORRECTIONS))
    out[:, 0], out[:, 1] = (by_v * shrink * p).sum(axis=1), (by_v * shrink * q).sum(axis=1)
    a, b, c = g[:, 2], g[:, 3], g[:, 4]
    out[:, 2] = cos * cos * a + sin * sin * b + cos * sin * c
    out[:, 3] = sin * sin * a + cos * cos * b - cos * sin * c
    out[:, 4] = 2.0 * cos * sin * (b - a) + (cos * cos - sin * sin) * c
    moved = 0.5 * closed[:, SMALLER] * (d[:, 0] * out[:, 0] + d[:, 1] * out[:, 1])
    by_gate = (by_v * closed[:, OTHER : OTHER + 3]).sum(axis=1) + moved
    by_gate += (g[:, 2:] * closed[:, OTHER + 3 : OTHER + 6]).sum(axis=1)
    out[:, 5] = GATE_GAIN * by_gate * (parts.gate * (1.0 - parts.gate))[:, 0]
    return out
