"""The error of the lobe that a renderer interpolates between texels, and its gradient by all texels at once.

At a point x between texels a renderer shades with the lobe of

    n = N / |N|,  N = sum_i w_i n_i,      Sigma = sum_i w_i Sigma_i,      rho = sum_i w_i rho_i,

w_i the bilinear (and, between levels, trilinear) weights. With T(h; x) the apparent lobe of the footprint around x,
nodes h_j with weights W_j, and D = K g(q, C) / (pi sqrt(det Sigma)) (see brdffit.models), the error of a point is

    e(x) = sum_jc W_j (T_jc - rho_c D_j)^2 / sum_jc W_j T_jc^2.

Gradient. With G_j = de / dD_j, y = Sigma^-1 (t.h, b.h), c = n.h:

- dSigma:  dD = D (-tr(Sigma^-1 dSigma) / 2) + amplitude g_q (-y' dSigma y);
- the frame: de/dt = sum 2 G g_q y_1 h, de/db = sum 2 G g_q y_2 h, de/dn = sum 2 G g_C c h (amplitude in G); t and b
  follow n as in ``frame.tangent_frame``, and dn = (I - n n') dN / |N|.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import kernel, numba_type, specialise, types
from brdffit.halfangle.frame import tangent_frame
from brdffit.halfangle.objective import RIM, log_normalisation_type
from brdffit.halfangle.quadrature import BLUE, GREEN, H_X, H_Y, H_Z, RED, WEIGHT
from brdffit.models import get_model
from brdffit.models.ggx import profile_gradient  # bound anew for other models

real = np.float32

#: Parameters of a texel: slopes of the normal, log tensor (a, b, c), specular RGB.
PARAMETERS = 8
# Channels that a renderer interpolates: normal, tensor (XX, YY, XY), specular RGB, shape (which is held).
NORMAL, TENSOR, SPECULAR, SHAPE, CHANNELS = 0, 3, 6, 9, 10


@kernel
def interpolated_errors(nodes, norm, corners, weights, fixed, channels, log_normalisation, errors, gradient):
    """Errors of S points into ``errors`` (S,), and the gradient of their sum by the channels into ``gradient`` (P, 9).

    ``nodes`` (S, NODE_ROWS, N) float32 and ``norm`` (S,): tables of the points and their <T,T>; ``corners`` (S, 4):
    rows of ``channels`` (P, 10) that a point lies between, with ``weights`` (S, 4); ``fixed`` (S, 10) is added to their
    weighted sum.
    """
    gradient[:] = 0.0
    p, back = np.empty(CHANNELS), np.empty(9)
    for s in range(corners.shape[0]):
        errors[s] = 0.0
        if not norm[s] > 0.0:
            continue
        for k in range(CHANNELS):
            p[k] = fixed[s, k]
            for i in range(4):
                p[k] += weights[s, i] * channels[corners[s, i], k]
        length = max(math.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]), 1e-6)
        x, y, z = p[0] / length, p[1] / length, p[2] / length
        t_x, t_y, t_z, b_x, b_y, b_z = tangent_frame(x, y, z)
        xx, yy, xy = p[3], p[4], p[5]
        determinant = max(xx * yy - xy * xy, max(1e-12 * xx * yy, 1e-30))
        # Sigma^-1 = L L' with L = [[l1, 0], [l2, l3]] makes q a sum of squares, never negative in single precision.
        l1 = math.sqrt(yy / determinant)
        l2, l3 = -xy / determinant / l1, 1.0 / math.sqrt(yy)
        amplitude = math.exp(log_normalisation(p[SHAPE])[0]) / (math.pi * math.sqrt(determinant))
        u_x, u_y, u_z = real(l1 * t_x + l2 * b_x), real(l1 * t_y + l2 * b_y), real(l1 * t_z + l2 * b_z)
        v_x, v_y, v_z = real(l3 * b_x), real(l3 * b_y), real(l3 * b_z)
        n_x, n_y, n_z = real(x), real(y), real(z)
        red, green, blue, scale, shape = real(p[6]), real(p[7]), real(p[8]), real(amplitude), real(p[SHAPE])
        table = nodes[s]
        h_x, h_y, h_z, weight = table[H_X], table[H_Y], table[H_Z], table[WEIGHT]
        t_red, t_green, t_blue = table[RED], table[GREEN], table[BLUE]
        o = real(0.0)
        e, d_red, d_green, d_blue, d_all, uu, uv, vv = o, o, o, o, o, o, o, o
        uh_x, uh_y, uh_z, vh_x, vh_y, vh_z, ch_x, ch_y, ch_z = o, o, o, o, o, o, o, o, o
        for j in range(table.shape[1]):
            u = u_x * h_x[j] + u_y * h_y[j] + u_z * h_z[j]
            v = v_x * h_x[j] + v_y * h_y[j] + v_z * h_z[j]
            c = n_x * h_x[j] + n_y * h_y[j] + n_z * h_z[j]
            g, g_q, g_C, g_s = profile_gradient(u * u + v * v, c * c, shape)
            # The lobe fades out at its own horizon, as in ``objective.moments``.
            f = min(max(c * real(1.0 / RIM), real(0.0)), real(1.0))
            fade = f * f * (real(3.0) - f - f)
            g_C = g_C * fade + (g * real(3.0 / (RIM * RIM)) * (real(1.0) - f) if c > real(0.0) else real(0.0))
            g_q *= fade
            d = scale * g * fade
            r0, r1, r2 = t_red[j] - red * d, t_green[j] - green * d, t_blue[j] - blue * d
            w0, w1, w2 = weight[j] * r0, weight[j] * r1, weight[j] * r2
            e += w0 * r0 + w1 * r1 + w2 * r2
            d_red += w0 * d
            d_green += w1 * d
            d_blue += w2 * d
            # Half of -de/dD; the factor -2 comes at the end.
            half = w0 * red + w1 * green + w2 * blue
            d_all += half * d
            by_q, by_c = half * scale * g_q, half * scale * g_C * c
            by_u, by_v = by_q * u, by_q * v
            uu += by_u * u
            uv += by_u * v
            vv += by_v * v
            uh_x += by_u * h_x[j]
            uh_y += by_u * h_y[j]
            uh_z += by_u * h_z[j]
            vh_x += by_v * h_x[j]
            vh_y += by_v * h_y[j]
            vh_z += by_v * h_z[j]
            ch_x += by_c * h_x[j]
            ch_y += by_c * h_y[j]
            ch_z += by_c * h_z[j]
        errors[s] = e / norm[s]
        tx, ty, tz = 2.0 * l1 * uh_x, 2.0 * l1 * uh_y, 2.0 * l1 * uh_z
        bx, by, bz = 2.0 * (l2 * uh_x + l3 * vh_x), 2.0 * (l2 * uh_y + l3 * vh_y), 2.0 * (l2 * uh_z + l3 * vh_z)
        # Columns of dt/dn and db/dn of the shortest-rotation frame, k = 1 / (1 + z).
        k1 = 1.0 / (1.0 + z)
        k2 = k1 * k1
        a_x = 2.0 * ch_x - k1 * (2.0 * x * tx + y * ty + y * bx) - tz
        a_y = 2.0 * ch_y - k1 * (x * ty + x * bx + 2.0 * y * by) - bz
        a_z = 2.0 * ch_z + k2 * (x * x * tx + x * y * ty + x * y * bx + y * y * by)
        along = a_x * x + a_y * y + a_z * z
        back[0], back[1], back[2] = (a_x - along * x) / length, (a_y - along * y) / length, (a_z - along * z) / length
        back[3] = -l1 * l1 * uu - 0.5 * d_all * yy / determinant
        back[4] = -(l2 * l2 * uu + 2.0 * l2 * l3 * uv + l3 * l3 * vv) - 0.5 * d_all * xx / determinant
        back[5] = -2.0 * l1 * (l2 * uu + l3 * uv) + d_all * xy / determinant
        back[6], back[7], back[8] = d_red, d_green, d_blue
        for i in range(4):
            share = -2.0 * weights[s, i] / norm[s]
            for k in range(9):
                gradient[corners[s, i], k] += share * back[k]


@cache
def interpolation_kernel(model: str) -> Any:
    """``interpolated_errors`` of a lobe model, compiled."""
    chosen = get_model(model)
    loop = specialise(interpolated_errors, f"_{model.replace('-', '_')}", profile_gradient=chosen.profile_gradient)
    line, plane = np.zeros(1), np.zeros((1, 1))
    data = [np.zeros((1, 1, 1), np.float32), line, np.zeros((1, 4), np.int64), plane, plane, plane]
    signature = (*map(numba_type, data), log_normalisation_type, types.float64[::1], types.float64[:, ::1])
    if signature not in loop.overloads:
        loop.compile(signature)
    return loop


def channels_of(theta: NDArray, shape: NDArray) -> NDArray:
    """Channels (n, 10) that a renderer interpolates, from texels' parameters (n, 8) and shapes (n,)."""
    slopes = np.concatenate([-theta[:, 0:2], np.ones((len(theta), 1))], axis=1)
    normal = slopes / np.linalg.norm(slopes, axis=1, keepdims=True)
    _, e1, e2, vectors = eigen(theta)
    tensor = _in_frame(e1, e2, np.zeros_like(e1), vectors)
    return np.concatenate([normal, tensor, theta[:, 5:8], shape[:, None]], axis=1)


def chain(theta: NDArray, gradient: NDArray) -> NDArray:
    """Gradient (n, 8) by texels' parameters (n, 8), from the gradient (n, 9) by their channels.

    dSigma = V (F o V' dL V) V' with F the divided differences of exp at the eigenvalues of L = log Sigma.
    """
    out = np.empty_like(theta)
    slopes = np.concatenate([-theta[:, 0:2], np.ones((len(theta), 1))], axis=1)
    length = np.linalg.norm(slopes, axis=1, keepdims=True)
    normal = slopes / length
    across = gradient[:, 0:3] - normal * np.sum(gradient[:, 0:3] * normal, axis=1, keepdims=True)
    out[:, 0:2] = -across[:, 0:2] / length
    logs, e1, e2, (cos, sin) = eigen(theta)
    g_xx, g_yy, g_xy = gradient[:, 3], gradient[:, 4], 0.5 * gradient[:, 5]
    first = cos * cos * g_xx + 2.0 * cos * sin * g_xy + sin * sin * g_yy
    second = sin * sin * g_xx - 2.0 * cos * sin * g_xy + cos * cos * g_yy
    mixed = cos * sin * (g_yy - g_xx) + (cos * cos - sin * sin) * g_xy
    delta = 0.5 * (logs[:, 0] - logs[:, 1])
    quotient = np.sqrt(e1 * e2) * np.where(delta > 1e-4, np.sinh(delta) / np.maximum(delta, 1e-4), 1.0)
    out[:, 2:5] = _in_frame(e1 * first, e2 * second, quotient * mixed, (cos, sin))
    out[:, 4] *= 2.0
    out[:, 5:8] = gradient[:, 6:9]
    return out


def eigen(theta: NDArray) -> tuple[NDArray, NDArray, NDArray, tuple[NDArray, NDArray]]:
    """Log eigenvalues (n, 2), larger first, the eigenvalues (n,) each, and (cos, sin) of the first's direction."""
    a, b, c = theta[:, 2], theta[:, 3], theta[:, 4]
    angle = 0.5 * np.arctan2(2.0 * c, a - b)
    mean, radius = 0.5 * (a + b), np.hypot(0.5 * (a - b), c)
    logs = np.stack([mean + radius, mean - radius], axis=1)
    return logs, np.exp(logs[:, 0]), np.exp(logs[:, 1]), (np.cos(angle), np.sin(angle))


def _in_frame(first: NDArray, second: NDArray, mixed: NDArray, direction: tuple[NDArray, NDArray]) -> NDArray:
    """(n, 3) entries (xx, yy, xy) of the matrices [[first, mixed], [mixed, second]] given in the eigenframe."""
    cos, sin = direction
    xx = cos * cos * first - 2.0 * cos * sin * mixed + sin * sin * second
    yy = sin * sin * first + 2.0 * cos * sin * mixed + cos * cos * second
    return np.stack([xx, yy, cos * sin * (first - second) + (cos * cos - sin * sin) * mixed], axis=1)
