"""Nodes and weights of the error integral, one set a footprint, and the table of the apparent lobe on them.

<T,T>, <T,D> and <D,D> all come from the same nodes h_j with the same weights W_j, so the fit is a weighted linear
least-squares problem in the lobe's values. Two things follow. Cauchy-Schwarz holds exactly for any nodes, so the
optimiser can find no lobe for which <T,D>^2 exceeds <T,T><D,D>. And where a lobe can represent the target, every rule
finds it; elsewhere the error of the rule enters the result in second order, in proportion to the residual.

For sharp and separate lobes the nodes must lie on their peaks, so they are drawn from the mixture of the base lobes,

    p(h) = sum_i c_i D_i(h) (n_i.h),     sum_i c_i = 1,   D_i a GGX lobe of base texel i's tensor,

by a three-dimensional low-discrepancy point set (choice of lobe; radius and angle in its frame), and weighted with the
density of the *whole* mixture, W_j = w(h_j) / (N p(h_j)): the balance heuristic of multiple importance sampling (Veach
and Guibas 1995). A node of a wide lobe that falls on a narrow peak then has the same small weight as the narrow lobe's
own nodes, so wide and sharp lobes can share a footprint. Nodes follow GGX lobes for every model, because GGX has the
longest tails and w / p stays bounded. One further lobe joins the mixture with a share of the nodes: the closed-form
start of the fit. It covers half vectors where the fitted lobe is not small but the target may be; there a few nodes of
very large weight would otherwise decide (a defensive mixture, Hesterberg 1995).

Sampling D (n.h) of a GGX lobe: slopes s = Sigma^(1/2) r (cos f, sin f) with r^2 = u / (1 - u), u and f uniform.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import inline, kernel, types
from brdffit.halfangle.density import half_angle_density
from brdffit.halfangle.frame import half_powers, tangent_frame, tensor_of_log
from brdffit.models.elementary import inverse_root, reciprocal
from brdffit.models.ggx import profile  # bound anew for other source models
from brdffit.models.ggx import profile as ggx_profile

real = np.float32
#: Whether lobes end at their own horizon; kernels of fits without that effect are bound to False.
HORIZON = True

# Columns of a lobe: normal; roughness tensor (xx, yy, xy), or only alpha^2 where the base is isotropic; shape;
# footprint weight times specular RGB; mixture weight; K(shape) of the model's normalisation, times GAIN; twice the
# covariance of normals inside the sample's own part of the footprint (xx, yy, xy); scale of the lobe nearest to the
# average over that part; M (uu, vv, uv) of ``mean_over_normals`` (0: the lobe itself). The remaining columns are filled
# by ``frame_lobes``.
NORMAL, TENSOR, ALPHA_SQUARED, SHAPE, SPECULAR, MIXTURE, NORMALISATION, SPREAD, GAIN = 0, 3, 3, 6, 7, 10, 11, 12, 15
MEAN, WIDE_AXES, NARROW_AXES, HEIGHT = 16, 19, 25, 31
LOBE_COLUMNS = 32

# Rows of a node array. MEASURE keeps W_j where a loss changes WEIGHT.
H_X, H_Y, H_Z, RED, GREEN, BLUE, DENSITY, WEIGHT, MEASURE = range(9)
NODE_ROWS = 9

# Share of the nodes that a guard lobe draws.
_GUARD_SHARE = 0.25

# Powers of the plastic number's reciprocal: the R2 sequence, an additive recurrence of low discrepancy (Roberts 2018).
_R2 = (0.7548776662466927, 0.5698402909980532)


def lattice(nodes: int, shift: tuple[float, float, float] = (0.5, 0.5, 0.5)) -> NDArray:
    """Point set (3, nodes) float32: lobe coordinate in [0, 1), ascending; r cos f and r sin f in a lobe's frame.

    ``shift``, each entry in [0, 1), moves the point set, which gives an independent rule of the same size.
    """
    j = np.arange(nodes, dtype=np.float64)
    choice = (j + shift[0]) / nodes
    u = (shift[1] + _R2[0] * j) % 1.0
    angle = 2.0 * np.pi * ((shift[2] + _R2[1] * j) % 1.0)
    # The lobe's far tail (r > 100) is cut: no node there carries weight.
    radius = np.sqrt(u / np.maximum(1.0 - u, 1e-4))
    return np.stack([choice, radius * np.cos(angle), radius * np.sin(angle)]).astype(np.float32)


@kernel
def add_defensive_lobe(lobes, count, share, m_x, m_y, a, b, c):
    """Write a lobe without colour into ``lobes[count]`` and give it ``share`` of the mixture."""
    for i in range(count):
        lobes[i, MIXTURE] *= 1.0 - share
    for k in range(lobes.shape[1]):
        lobes[count, k] = 0.0
    inverse = 1.0 / math.sqrt(1.0 + m_x * m_x + m_y * m_y)
    lobes[count, 0], lobes[count, 1], lobes[count, 2] = -m_x * inverse, -m_y * inverse, inverse
    lobes[count, TENSOR], lobes[count, TENSOR + 1], lobes[count, TENSOR + 2] = tensor_of_log(a, b, c)
    lobes[count, MIXTURE] = share


@kernel
def normalise_shapes(lobes, count, has_shape, log_normalisation):
    """NORMALISATION <- K(shape) times GAIN of every lobe, with one K for all where the base has no map of the shape."""
    k = math.exp(log_normalisation(lobes[0, SHAPE])[0])
    for i in range(count):
        if has_shape:
            k = math.exp(log_normalisation(lobes[i, SHAPE])[0])
        lobes[i, NORMALISATION] = k * lobes[i, GAIN]


@kernel
def add_guard(lobes, count, theta):
    """Insert the lobe ``theta`` (6,) before the defensive one, without colour: it draws nodes and adds nothing.

    The tensors of ``lobes`` must be full ones. It gets a quarter of the mixture; all other shares shrink alike.
    """
    for k in range(lobes.shape[1]):
        lobes[count + 1, k], lobes[count, k] = lobes[count, k], 0.0
    inverse = 1.0 / math.sqrt(1.0 + theta[0] * theta[0] + theta[1] * theta[1])
    lobes[count, 0], lobes[count, 1], lobes[count, 2] = -theta[0] * inverse, -theta[1] * inverse, inverse
    xx, yy, xy = tensor_of_log(theta[2], theta[3], theta[4])
    lobes[count, TENSOR], lobes[count, TENSOR + 1], lobes[count, TENSOR + 2] = xx, yy, xy
    lobes[count, SHAPE] = lobes[0, SHAPE]
    for i in range(count + 2):
        lobes[i, MIXTURE] *= 1.0 - _GUARD_SHARE
    lobes[count, MIXTURE] = _GUARD_SHARE


@inline
def _set_axes(lobe, column, matrix, tangents):
    """Write the rows of a symmetric tangent-plane matrix (xx, yy, xy), as vectors in space, from ``column`` on."""
    xx, yy, xy = matrix
    t_x, t_y, t_z, b_x, b_y, b_z = tangents
    lobe[column], lobe[column + 1], lobe[column + 2] = xx * t_x + xy * b_x, xx * t_y + xy * b_y, xx * t_z + xy * b_z
    lobe[column + 3], lobe[column + 4], lobe[column + 5] = xy * t_x + yy * b_x, xy * t_y + yy * b_y, xy * t_z + yy * b_z


@kernel
def frame_lobes(lobes, count, isotropic):
    """Fill the columns of ``lobes[:count + 1]`` that ``place_nodes`` and ``tabulate`` read.

    WIDE_AXES and NARROW_AXES: the rows of Sigma^(1/2) and Sigma^(-1/2) as vectors in space, three numbers each
    (NARROW_AXES is not needed for isotropic lobes); HEIGHT: peak of a GGX lobe, 1 / (pi sqrt(det Sigma)). The last
    lobe, ``lobes[count]``, is the defensive one; its tensor is always a full one.
    """
    for i in range(count + 1):
        lobe = lobes[i]
        tangents = tangent_frame(lobe[0], lobe[1], lobe[2])
        if isotropic and i < count:
            alpha = math.sqrt(lobe[ALPHA_SQUARED])
            _set_axes(lobe, WIDE_AXES, (alpha, alpha, 0.0), tangents)
            lobe[HEIGHT] = 1.0 / (math.pi * lobe[ALPHA_SQUARED])
        else:
            wide, narrow, root = half_powers(lobe[TENSOR], lobe[TENSOR + 1], lobe[TENSOR + 2])
            _set_axes(lobe, WIDE_AXES, wide, tangents)
            _set_axes(lobe, NARROW_AXES, narrow, tangents)
            lobe[HEIGHT] = 1.0 / (math.pi * root)


@inline
def _axes(lobe, column):
    """The two vectors in space that are stored from ``column`` on, in the kernel's float type."""
    return (
        real(lobe[column]), real(lobe[column + 1]), real(lobe[column + 2]),
        real(lobe[column + 3]), real(lobe[column + 4]), real(lobe[column + 5]),
    )  # fmt: skip


@kernel
def place_nodes(lobes, count, points, exponent, nodes):
    """Draw the nodes from the mixture of ``lobes[:count + 1]``, after ``frame_lobes``; MIXTURE must sum to 1.

    Writes rows H_X, H_Y, H_Z of ``nodes`` (NODE_ROWS, N) and w(h) / N into WEIGHT (0 below the horizon); clears the
    table rows.
    """
    size = points.shape[1]
    along, across = points[1], points[2]
    # A lobe gets the nodes whose lobe coordinate (j + shift) / N lies within its share of the mixture.
    shift = points[0, 0] * size
    h_x, h_y, h_z, weight = nodes[H_X], nodes[H_Y], nodes[H_Z], nodes[WEIGHT]
    reached = 0.0
    first = 0
    for i in range(count + 1):
        reached += lobes[i, MIXTURE]
        last = min(math.ceil(reached * size - shift), size) if i < count else size
        if last <= first:
            continue
        u_x, u_y, u_z, v_x, v_y, v_z = _axes(lobes[i], WIDE_AXES)
        n_x, n_y, n_z = real(lobes[i, 0]), real(lobes[i, 1]), real(lobes[i, 2])
        # In whole vectors of 16: the next lobe overwrites what is written beyond the last node. The index is unsigned,
        # since indices that may count from the end would keep the loop from being vectorised.
        for j in range(np.uint64(first), np.uint64(min(first + (last - first + 15) // 16 * 16, size))):
            h_x[j] = along[j] * u_x + across[j] * v_x + n_x
            h_y[j] = along[j] * u_y + across[j] * v_y + n_y
            h_z[j] = along[j] * u_z + across[j] * v_z + n_z
        first = last
    share = real(half_angle_density(1.0, exponent) / size)
    cubic = exponent == 3
    for j in range(size):
        scale = inverse_root(h_x[j] * h_x[j] + h_y[j] * h_y[j] + h_z[j] * h_z[j])
        z = h_z[j] * scale
        h_x[j] *= scale
        h_y[j] *= scale
        h_z[j] = z
        up = max(z, real(0.0))
        weight[j] = share * (up * up * up if cubic else up)
    nodes[RED : DENSITY + 1] = real(0.0)


@inline
def mean_over_normals(u, v, q, C, trace, m_uu, m_vv, m_uv):
    """Mean of GGX lobes over normals of covariance S, divided by the one lobe of the tensor Sigma' = Sigma + 2 S.

    In the plane, with D = (1 + x)^-2 / (pi sqrt(det Sigma)), x = t' Sigma^-1 t, the mean is D + (1/2) S : D'' to second
    order, D'' the matrix of second derivatives. The lobe of Sigma + 2 S has the same second moments, but also the tail
    of a wider lobe, while the mean keeps the tail of its lobes. With
    y = Sigma'^(-1/2) t, M = Sigma'^(-1/2) S Sigma'^(-1/2) and r = 1 / (1 + x) the ratio is

        1 + tr M (1 - 2 r) + y' M y r (12 r - 4),

    exactly 1 in energy. For normals spread over a square as wide as alpha it leaves 1/40 of the squared error that the
    nearest single lobe has, over a line of 2.5 alpha a tenth (there that lobe's tail is 3.8 times too bright along the
    line). It is positive while no eigenvalue of M exceeds 1/3, see ``widen_lobes``.
    """
    r = reciprocal(q + C)
    s = C * r
    form = u * (m_uu * u + (m_uv + m_uv) * v) + m_vv * v * v
    return real(1.0) + trace * (real(1.0) - s - s) + form * r * (real(12.0) * s - real(4.0))


@kernel
def tabulate(lobes, count, isotropic, grey, nodes):
    """Add every base lobe to the table, T_c(h_j) and p(h_j), and the defensive lobe to p, after ``frame_lobes``.

    A lobe with MEAN stands for the mean over its normals.

    ``grey``: every lobe has equal channels, so only one is summed. With the horizon effect base lobes end at their
    own horizon (n.h > 0).
    """
    size = nodes.shape[1]
    h_x, h_y, h_z = nodes[H_X], nodes[H_Y], nodes[H_Z]
    red, green, blue, density = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[DENSITY]
    for i in range(count + 1):
        base_isotropic = isotropic and i < count
        u_x, u_y, u_z, v_x, v_y, v_z = _axes(lobes[i], NARROW_AXES)
        scale = lobes[i, HEIGHT]
        inverse = real(math.pi * scale)  # of alpha^2, where the lobe is isotropic
        shape = real(lobes[i, SHAPE])
        k = scale * lobes[i, NORMALISATION]
        a_red = real(k * lobes[i, SPECULAR])
        a_green = real(k * lobes[i, SPECULAR + 1])
        a_blue = real(k * lobes[i, SPECULAR + 2])
        a_density = real(scale * lobes[i, MIXTURE])
        n_x, n_y, n_z = real(lobes[i, 0]), real(lobes[i, 1]), real(lobes[i, 2])
        if base_isotropic and grey:
            for j in range(size):
                d_x, d_y, d_z = h_x[j] - n_x, h_y[j] - n_y, h_z[j] - n_z
                chord = d_x * d_x + d_y * d_y + d_z * d_z
                sin2 = chord * (real(1.0) - real(0.25) * chord)
                cos = max(real(1.0) - real(0.5) * chord, real(0.0))
                q = sin2 * inverse
                C = real(1.0) - sin2
                g = profile(q, C, shape)
                red[j] += a_red * g if not HORIZON or cos > real(0.0) else real(0.0)
                density[j] += a_density * ggx_profile(q, C, shape) * cos
        elif base_isotropic:
            for j in range(size):
                # sin^2 from the chord |h - n|: 1 - (n.h)^2 would cancel for sharp lobes.
                d_x, d_y, d_z = h_x[j] - n_x, h_y[j] - n_y, h_z[j] - n_z
                chord = d_x * d_x + d_y * d_y + d_z * d_z
                sin2 = chord * (real(1.0) - real(0.25) * chord)
                cos = real(1.0) - real(0.5) * chord
                q = sin2 * inverse
                C = real(1.0) - sin2
                g = profile(q, C, shape) if not HORIZON or cos > real(0.0) else real(0.0)
                red[j] += a_red * g
                green[j] += a_green * g
                blue[j] += a_blue * g
                density[j] += a_density * ggx_profile(q, C, shape) * max(cos, real(0.0))
        elif lobes[i, MEAN] + lobes[i, MEAN + 1] > 0.0:
            m_uu, m_vv, m_uv = real(lobes[i, MEAN]), real(lobes[i, MEAN + 1]), real(lobes[i, MEAN + 2])
            trace = m_uu + m_vv
            if grey:
                for j in range(size):
                    u = u_x * h_x[j] + u_y * h_y[j] + u_z * h_z[j]
                    v = v_x * h_x[j] + v_y * h_y[j] + v_z * h_z[j]
                    cos = n_x * h_x[j] + n_y * h_y[j] + n_z * h_z[j]
                    q = u * u + v * v
                    C = cos * cos
                    single = ggx_profile(q, C, shape)
                    mean = single * mean_over_normals(u, v, q, C, trace, m_uu, m_vv, m_uv)
                    red[j] += a_red * mean if not HORIZON or cos > real(0.0) else real(0.0)
                    density[j] += a_density * single * max(cos, real(0.0))
                continue
            for j in range(size):
                u = u_x * h_x[j] + u_y * h_y[j] + u_z * h_z[j]
                v = v_x * h_x[j] + v_y * h_y[j] + v_z * h_z[j]
                cos = n_x * h_x[j] + n_y * h_y[j] + n_z * h_z[j]
                q = u * u + v * v
                C = cos * cos
                single = ggx_profile(q, C, shape)
                mean = single * mean_over_normals(u, v, q, C, trace, m_uu, m_vv, m_uv)
                g = mean if not HORIZON or cos > real(0.0) else real(0.0)
                red[j] += a_red * g
                green[j] += a_green * g
                blue[j] += a_blue * g
                density[j] += a_density * single * max(cos, real(0.0))
        elif grey:
            for j in range(size):
                u = u_x * h_x[j] + u_y * h_y[j] + u_z * h_z[j]
                v = v_x * h_x[j] + v_y * h_y[j] + v_z * h_z[j]
                cos = n_x * h_x[j] + n_y * h_y[j] + n_z * h_z[j]
                q = u * u + v * v
                C = cos * cos
                g = profile(q, C, shape)
                red[j] += a_red * g if not HORIZON or cos > real(0.0) else real(0.0)
                density[j] += a_density * ggx_profile(q, C, shape) * max(cos, real(0.0))
        else:
            for j in range(size):
                u = u_x * h_x[j] + u_y * h_y[j] + u_z * h_z[j]
                v = v_x * h_x[j] + v_y * h_y[j] + v_z * h_z[j]
                cos = n_x * h_x[j] + n_y * h_y[j] + n_z * h_z[j]
                q = u * u + v * v
                C = cos * cos
                g = profile(q, C, shape) if not HORIZON or cos > real(0.0) else real(0.0)
                red[j] += a_red * g
                green[j] += a_green * g
                blue[j] += a_blue * g
                density[j] += a_density * ggx_profile(q, C, shape) * max(cos, real(0.0))
    if grey:
        for j in range(size):
            green[j] = blue[j] = red[j]


def tabulate_type(floats):  # type: ignore[no-untyped-def]
    """Numba function type of ``tabulate`` on node arrays of this float type."""
    f64 = types.float64
    return types.FunctionType(types.void(f64[:, ::1], types.int64, types.boolean, types.boolean, floats[:, ::1]))


@kernel
def weigh_nodes(nodes):
    """WEIGHT, MEASURE <- w / (N p) once the table is filled; 0 for a node that no lobe reaches (p = 0)."""
    density, weight, measure = nodes[DENSITY], nodes[WEIGHT], nodes[MEASURE]
    for j in range(nodes.shape[1]):
        w = weight[j] * reciprocal(max(density[j], real(1e-30)))
        w = w if density[j] > real(0.0) else real(0.0)
        weight[j] = w
        measure[j] = w
