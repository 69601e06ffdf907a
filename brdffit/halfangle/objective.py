"""The error integral of one lobe against the table of a footprint, and its gradient.

With nodes h_j, weights W_j and a scalar target S_j, the lobe D(theta) enters through two sums, TD = sum W S D and
DD = sum W D^2, and the error relative to TT = sum_c sum W T_c^2 is

- free scale (variable projection, Golub and Pereyra 1973): e = (TT - TD^2 / DD) / TT with S = k.T, k the unit vector
  of the colour direction; the best scale is TD / DD;
- held scale rho: e = (TT + |rho|^2 (DD - 2 TD)) / TT with S = rho.T / |rho|^2.

Parameters theta = (m_x, m_y, a, b, c, s): slopes of the normal, log roughness tensor, shape.

Gradient. Everything about the lobe enters through q and C (see brdffit.models). In the eigenbasis of log Sigma =
V diag(l1, l2) V', with scaled coordinates u_i = exp(-l_i/2) v_i.x, q = u1^2 + u2^2, delta = (l1 - l2) / 2:

- tensor: d exp(-L) in that basis is the divided difference of exp, so
  dq = -sum_ij kappa_ij u_i u_j (V' dL V)_ij with kappa_11 = kappa_22 = 1, kappa_12 = sinh(delta) / delta;
  d log amplitude = -(da + db) / 2.
- normal: the frame turns by dR'R = [[0, w12, w13], [-w12, 0, w23], [-w13, -w23, 0]] with w13 = -t.dn, w23 = -b.dn,
  w12 = dt.b, so with g = V'(w13, w23):
  dq = -4 w12 sinh(delta) u1 u2 + 2 sum_i g_i exp(-l_i/2) u_i c,   dC = -2 sum_i g_i exp(l_i/2) u_i c.

- horizon: a lobe is 0 where n.h <= 0. A sum over nodes would jump when a node crosses that line, so the search uses the
  lobe times f(c) = x^2 (3 - 2x), x = c / RIM within [0, 1], which adds g f'(c) / (2 c) = 3 g (1 - x) / RIM^2 to the
  derivative by C. (The values of ``lobe_values``, and so the residual, end sharply.)

So one pass over the nodes sums a few moments of (u1, u2, c), and the chain rule is applied once, outside the loop.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import kernel, types
from brdffit.halfangle.frame import lobe_frame
from brdffit.halfangle.quadrature import H_X, H_Y, H_Z, HORIZON, WEIGHT
from brdffit.models.elementary import align_stack, product
from brdffit.models.ggx import profile, profile_gradient  # bound anew for other models

real = np.float32
# Whether the search turns the normal, and whether it stretches the tensor; kernels bound to False omit those moments.
TURNS = STRETCHES = True

#: n.h over which the search lets a lobe fade out at its horizon.
RIM = 0.05

PARAMETERS = 6
MOMENTS = 14
# Row of the scalar target times the weight: that of the mixture density, which is not needed any more by then.
TARGET = 6


@kernel
def moments(nodes, frame, shape, out):
    """Sums over the nodes, for the target (out[0:7], weight W S) and the lobe itself (out[7:14], weight 2 W g):
    the value; the q-derivative times (u1 u1, u1 u2, u2 u2); for the turn of the normal, i = 1, 2, u_i c times
    (q-derivative - exp(l_i) C-derivative); the s-derivative. out[7] is sum W g^2, without the factor 2.

    Without TURNS the sums with c are 0. Without STRETCHES (an isotropic lobe) the sum of u1 u1 holds that of
    u1 u1 + u2 u2 and the other two are 0, so the gradient by a takes the share of b.
    """
    align_stack()
    h_x, h_y, h_z, weight, target = nodes[H_X], nodes[H_Y], nodes[H_Z], nodes[WEIGHT], nodes[TARGET]
    u_x, u_y, u_z = real(frame[0]), real(frame[1]), real(frame[2])
    v_x, v_y, v_z = real(frame[3]), real(frame[4]), real(frame[5])
    n_x, n_y, n_z = real(frame[6]), real(frame[7]), real(frame[8])
    square1 = real(1.0) / (u_x * u_x + u_y * u_y + u_z * u_z)
    square2 = real(1.0) / (v_x * v_x + v_y * v_y + v_z * v_z)
    z = real(0.0)
    t0, t1, t2, t3, t4, t5, t6 = z, z, z, z, z, z, z
    d0, d1, d2, d3, d4, d5, d6 = z, z, z, z, z, z, z
    for j in range(nodes.shape[1]):
        u = u_x * h_x[j] + u_y * h_y[j] + u_z * h_z[j]
        v = v_x * h_x[j] + v_y * h_y[j] + v_z * h_z[j]
        c = n_x * h_x[j] + n_y * h_y[j] + n_z * h_z[j]
        g, g_q, g_C, g_s = profile_gradient(u * u + v * v, c * c, shape)
        if HORIZON:
            # Fade the lobe out at its own horizon; g(q, C) is even in c and would continue behind it.
            x = min(max(c * real(1.0 / RIM), real(0.0)), real(1.0))
            fade = x * x * (real(3.0) - x - x)
            fall = real(3.0 / (RIM * RIM)) * (real(1.0) - x) if c > real(0.0) else real(0.0)
            g_C = g_C * fade + g * fall
            g *= fade
            g_q *= fade
            g_s = product(g_s, fade)
        wd = weight[j] * g
        t0 += target[j] * g
        d0 += wd * g
        tq, dq = target[j] * g_q, wd * g_q
        uu, vv = u * u, v * v
        if STRETCHES:
            uv = u * v
            t1 += tq * uu
            t2 += tq * uv
            t3 += tq * vv
            d1 += dq * uu
            d2 += dq * uv
            d3 += dq * vv
        else:
            t1 += tq * (uu + vv)
            d1 += dq * (uu + vv)
        if TURNS:
            uc, vc = u * c * (g_q - square1 * g_C), v * c * (g_q - square2 * g_C)
            t4 += target[j] * uc
            t5 += target[j] * vc
            d4 += wd * uc
            d5 += wd * vc
        t6 += product(target[j], g_s)
        d6 += product(wd, g_s)
    out[0], out[1], out[2], out[3], out[4], out[5], out[6] = t0, t1, t2, t3, t4, t5, t6
    out[7], out[8], out[9], out[10], out[11], out[12], out[13] = d0, 2 * d1, 2 * d2, 2 * d3, 2 * d4, 2 * d5, 2 * d6


def moments_type(floats):  # type: ignore[no-untyped-def]
    """Numba function type of ``moments`` on node arrays of this float type."""
    f64 = types.float64
    return types.FunctionType(types.void(floats[:, ::1], f64[::1], floats, f64[::1]))


@kernel
def lobe_values(theta, nodes, log_normalisation, values, work):
    """D(h_j; theta) for every node into ``values`` (N,); ``work`` (16,) is scratch."""
    frame = work[0:9]
    inverse = 1.0 / math.sqrt(1.0 + theta[0] * theta[0] + theta[1] * theta[1])
    _, _, _, _, s1, s2 = lobe_frame(
        -theta[0] * inverse, -theta[1] * inverse, inverse, theta[2], theta[3], theta[4], frame
    )
    log_k, _ = log_normalisation(theta[5])
    amplitude = real((math.exp(log_k) if log_k != 0.0 else 1.0) * s1 * s2 / math.pi)
    shape = real(theta[5])
    h_x, h_y, h_z = nodes[H_X], nodes[H_Y], nodes[H_Z]
    u_x, u_y, u_z = real(frame[0]), real(frame[1]), real(frame[2])
    v_x, v_y, v_z = real(frame[3]), real(frame[4]), real(frame[5])
    n_x, n_y, n_z = real(frame[6]), real(frame[7]), real(frame[8])
    for j in range(nodes.shape[1]):
        u = u_x * h_x[j] + u_y * h_y[j] + u_z * h_z[j]
        v = v_x * h_x[j] + v_y * h_y[j] + v_z * h_z[j]
        c = n_x * h_x[j] + n_y * h_y[j] + n_z * h_z[j]
        g = amplitude * profile(u * u + v * v, c * c, shape)
        values[j] = g if not HORIZON or c > real(0.0) else real(0.0)


log_normalisation_type = types.FunctionType(types.UniTuple(types.float64, 2)(types.float64))


def lobe_values_type(floats):  # type: ignore[no-untyped-def]
    """Numba function type of ``lobe_values`` on node arrays of this float type."""
    f64 = types.float64
    return types.FunctionType(types.void(f64[::1], floats[:, ::1], log_normalisation_type, floats[::1], f64[::1]))


# Entries of a setting: treatment of the scale (FREE, HOLDS or BOUNDED); 1 / TT (FREE) or |rho|^2 / TT; bounds of the
# log eigenvalues and of s; for BOUNDED, the least and greatest scale in units of the filtered colour, and the share of
# a light from everywhere, which sees only the energy; A (xx, yy, zz, xy, xz, yz) of the error n' A n of diffuse light,
# which ``evaluate_table`` adds.
HELD, SCALE, LOG_LOW, LOG_HIGH, SHAPE_LOW, SHAPE_HIGH, SCALE_LOW, SCALE_HIGH, ENERGY, DIFFUSE = range(10)
DIFFUSE_FORM = 6
SETTINGS = DIFFUSE + DIFFUSE_FORM
FREE, HOLDS, BOUNDED = 0.0, 1.0, 2.0

# Weight of the walls at the edge of the domain, in relative squared error per squared log alpha^2: 0.1 outside costs
# 0.02, the error of 17 dB. Parameters that are still outside after the search are clamped.
WALL = 2.0


@kernel
def evaluate(theta, nodes, setting, moments_kernel, log_normalisation, gradient, work):
    """Relative squared error minus 1 (adding the 1 would only lose digits) and its gradient by theta.

    ``gradient`` (6,) is written; ``work`` (48,) is scratch, of which work[0] and work[1] hold TD and DD on return.
    Walls keep log eigenvalues and shape within their bounds.

    The normal is n = (-m_x, -m_y, 1) i with i = 1 / sqrt(1 + m^2), so t.dn = -i t_k and b.dn = -i b_k by the slope m_k,
    and (w13, w23) = i (t_k, b_k). For the shortest-rotation frame w12 = (n_y dn_x - n_x dn_y) / (1 + n_z), the
    connection of the sphere seen from the pole: -i n_y / (1 + n_z) by m_x and i n_x / (1 + n_z) by m_y.
    """
    frame, sums = work[2:11], work[11:25]
    inverse = 1.0 / math.sqrt(1.0 + theta[0] * theta[0] + theta[1] * theta[1])
    n_x, n_y = -theta[0] * inverse, -theta[1] * inverse
    l1, l2, cos, sin, s1, s2 = lobe_frame(n_x, n_y, inverse, theta[2], theta[3], theta[4], frame)
    log_k, log_k_slope = log_normalisation(theta[5])
    amplitude = (math.exp(log_k) if log_k != 0.0 else 1.0) * s1 * s2 / math.pi
    squared = amplitude * amplitude
    moments_kernel(nodes, frame, real(theta[5]), sums)
    td, dd = amplitude * sums[0], squared * sums[7]
    work[0], work[1] = td, dd
    if not dd > 0.0:
        value, by_td, by_dd = 0.0, 0.0, 0.0
    elif setting[HELD] > 0.0:
        value, by_td, by_dd = setting[SCALE] * (dd - 2.0 * td), -2.0 * setting[SCALE], setting[SCALE]
    else:
        rho = td / dd
        value, by_td, by_dd = -setting[SCALE] * rho * td, -2.0 * setting[SCALE] * rho, setting[SCALE] * rho * rho
    # Moments of by_td TD + by_dd DD, then the chain rule.
    of_t, of_d = by_td * amplitude, by_dd * squared
    uu, uv, vv = of_t * sums[1] + of_d * sums[8], of_t * sums[2] + of_d * sums[9], of_t * sums[3] + of_d * sums[10]
    along1, along2 = 2.0 * s1 * (of_t * sums[4] + of_d * sums[11]), 2.0 * s2 * (of_t * sums[5] + of_d * sums[12])
    sinh = 0.5 * (s2 * s2 - s1 * s1) / (s1 * s2)
    delta = 0.5 * (l1 - l2)
    kappa = sinh / delta if delta > 1e-4 else 1.0
    k = 1.0 / (1.0 + inverse)
    twist = -4.0 * sinh * uv * k
    by_t, by_b = along1 * cos - along2 * sin, along1 * sin + along2 * cos
    across = -n_x * n_y * k
    gradient[0] = inverse * (by_t * (1.0 - n_x * n_x * k) + by_b * across - twist * n_y)
    gradient[1] = inverse * (by_t * across + by_b * (1.0 - n_y * n_y * k) + twist * n_x)
    cs, cross = cos * sin, 2.0 * kappa * uv
    # The amplitude's own derivative: d log A = -(da + db)/2 + d log K.
    whole = by_td * td + 2.0 * by_dd * dd
    gradient[2] = cs * cross - cos * cos * uu - sin * sin * vv - 0.5 * whole
    gradient[3] = -cs * cross - sin * sin * uu - cos * cos * vv - 0.5 * whole
    gradient[4] = 2.0 * cs * (vv - uu) - (cos * cos - sin * sin) * cross
    gradient[5] = of_t * sums[6] + of_d * sums[13] + log_k_slope * whole
    if l1 > setting[LOG_HIGH] or l2 < setting[LOG_LOW]:
        for i in range(2):
            log_eigenvalue = l1 if i == 0 else l2
            outside = max(log_eigenvalue - setting[LOG_HIGH], 0.0) - max(setting[LOG_LOW] - log_eigenvalue, 0.0)
            value += WALL * outside * outside
            slope = 2.0 * WALL * outside
            along, across = (cos, sin) if i == 0 else (-sin, cos)
            gradient[2] += slope * along * along
            gradient[3] += slope * across * across
            gradient[4] += slope * 2.0 * along * across
    outside = max(theta[5] - setting[SHAPE_HIGH], 0.0) - max(setting[SHAPE_LOW] - theta[5], 0.0)
    value += WALL * outside * outside
    gradient[5] += 2.0 * WALL * outside
    return value
