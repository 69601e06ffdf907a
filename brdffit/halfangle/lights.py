"""Lights with a size: the error integral over pairs of a viewer and a light of an angular radius.

No light is a point. A disc of angular radius r around l moves the half vector within about R = r / 2, so a picture
shows a lobe blurred over that disc, and lobes that differ by less than the blur look alike. The error integral over
lights of sizes s with shares w_s compares the blurred lobes,

    E = sum_s w_s int |T_s - F_s|^2 w(h) dh / int |T_s|^2 w(h) dh,
    T_s = sum_i w_i rho_i D(h; n_i, Sigma_i + a_s^2 I),     F_s = rho D(h; n, Sigma + a_s^2 I),

where a blurred lobe is replaced by the lobe of the same model whose tensor is wider by a_s^2 = ``Model.blur`` R^2 (see
docs/maths.md). All sizes share one scale rho, which stays a closed form, since all inner products are sums over s:

    rho = sum_s w_s <T_s, D_s> / |T_s|^2  /  sum_s w_s <D_s, D_s> / |T_s|^2.

A light that fills the sky shows only a lobe's integral, which is rho: its term is (1 - rho / rho_0)^2, rho_0 the
filtered colour. It needs no nodes; ``ENERGY`` of a setting is its share, and rho stays a closed form.

Each size is a segment of one table of nodes. At size s the lobe is that with the eigenvalues e^l + a_s^2, so the
kernels of a lobe run once for each segment, and the chain rule goes through L' = log(exp(L) + a^2 I). In the eigenbasis
of L, with f(l) = log(e^l + a^2), the diagonal of dL' is f'(l_i) = e^l_i / (e^l_i + a^2) times that of dL, and the
off-diagonal entry is the divided difference (f(l_1) - f(l_2)) / (l_1 - l_2) times that of dL (Daleckii and Krein 1965).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import inline, kernel, part
from brdffit.errors import InputError
from brdffit.halfangle.frame import eigen_log, scaled_frame
from brdffit.halfangle.objective import (
    BOUNDED,
    DIFFUSE,
    DIFFUSE_FORM,
    ENERGY,
    HELD,
    LOG_HIGH,
    LOG_LOW,
    SCALE,
    SCALE_HIGH,
    SCALE_LOW,
    SHAPE_HIGH,
    SHAPE_LOW,
    WALL,
    evaluate,
)
from brdffit.halfangle.quadrature import NODE_ROWS

real = np.float32

#: Columns of a table's ``lights``: a^2 for the model of the base, a^2 for the model of the fit, the share w_s.
BASE_BLUR, LOBE_BLUR, SHARE = range(3)
#: Most sizes of light: the scratch of an evaluation has room for them.
MOST_SIZES = 6
# What an evaluation keeps for each size: the lobe's frame, its sums, and (l1, l2, s1, s2, amplitude).
_FRAME, _SUMS, _OWN = 0, 9, 23
_KEPT = 28
#: Scratch of ``evaluate_table``; its first two entries hold TD and DD on return.
EVALUATION = 2 + _KEPT * MOST_SIZES

#: Angular radii in degrees of named lights.
NAMED_LIGHTS = {
    "point": (0.0,),
    "sun": (0.27,),
    "lamp": (5.0,),
    "window": (15.0,),
    "sky": (60.0,),
    "mixed": (2.0, 10.0, 40.0),
}

#: A single point light, with which the error integral is that of the papers.
POINT = np.array([[0.0, 0.0, 1.0]])


class Table(NamedTuple):
    """Nodes of all sizes: segment s of ``nodes`` and ``values`` is [first[s], first[s + 1]) times the rows of each.

    ``points`` hold the point sets, three rows a segment; ``lights`` (S, 3) the sizes (``BASE_BLUR``, ``LOBE_BLUR``,
    ``SHARE``).
    """

    points: NDArray
    nodes: NDArray
    values: NDArray
    first: NDArray
    lights: NDArray


def table_of(points: list[NDArray], lights: NDArray, floats: type = np.float32) -> Table:
    """A table for one point set (3, N_s) for each size, N_s even. ``floats`` is the type of nodes and values."""
    first = np.concatenate([[0], np.cumsum([each.shape[1] for each in points])]).astype(np.int64)
    size = int(first[-1])
    return Table(
        np.concatenate([each.ravel() for each in points]), np.zeros(NODE_ROWS * size, floats), np.zeros(size, floats),
        first, np.ascontiguousarray(lights, np.float64),
    )  # fmt: skip


def sizes_of(lights: str, base_blur: float, lobe_blur: float) -> NDArray:
    """Sizes (S, 3) (``BASE_BLUR``, ``LOBE_BLUR``, ``SHARE``) of an option such as ``mixed`` or ``2,10:0.5``, ascending.

    Args:
        lights: names of ``NAMED_LIGHTS`` or angular radii in degrees (0 to 90), separated by commas; a colon and a
            number give one a share other than 1. Shares are made to sum to 1.
        base_blur, lobe_blur: ``Model.blur`` of the base's model and of the fit's.

    Raises:
        InputError: for a word that is neither a name nor such a number, and for more than ``MOST_SIZES`` sizes.
    """
    found: dict[float, float] = {}
    for text in lights.split(","):
        name, _, share_text = text.strip().partition(":")
        share = _number(share_text, text) if share_text else 1.0
        radii = NAMED_LIGHTS.get(name) or (_number(name, text),)
        for radius in radii:
            if not (0.0 <= radius <= 90.0 and share > 0.0):
                raise InputError(f"'{text}' is no light: expected a radius of 0 to 90 degrees and a share above 0.")
            found[radius] = found.get(radius, 0.0) + share / len(radii)
    if len(found) > MOST_SIZES:
        raise InputError(f"The lights '{lights}' have {len(found)} sizes, expected at most {MOST_SIZES}.")
    whole = sum(found.values())
    squares = {radius: math.radians(0.5 * radius) ** 2 for radius in sorted(found)}
    return np.array([[base_blur * R2, lobe_blur * R2, found[r] / whole] for r, R2 in squares.items()])


def _number(text: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError:
        names = ", ".join(NAMED_LIGHTS)
        raise InputError(f"'{whole}' is no light: expected {names}, or a radius in degrees.") from None


@part
def segment(table, s):
    """The nodes (NODE_ROWS, N_s) of one size."""
    a, b = table.first[s], table.first[s + 1]
    return table.nodes[NODE_ROWS * a : NODE_ROWS * b].reshape(NODE_ROWS, b - a)


@part
def points_of(table, s):
    """The point set (3, N_s) of one size."""
    a, b = table.first[s], table.first[s + 1]
    return table.points[3 * a : 3 * b].reshape(3, b - a)


@part
def values_of(table, s):
    """The values (N_s,) of one size."""
    return table.values[table.first[s] : table.first[s + 1]]


@inline
def widened(theta, square, out):
    """``out`` (6,) <- the lobe ``theta`` with ``square`` I added to its tensor."""
    for p in range(6):
        out[p] = theta[p]
    if square > 0.0:
        l1, l2, cos, sin = eigen_log(theta[2], theta[3], theta[4])
        l1, l2 = math.log(math.exp(l1) + square), math.log(math.exp(l2) + square)
        out[2] = l1 * cos * cos + l2 * sin * sin
        out[3] = l1 * sin * sin + l2 * cos * cos
        out[4] = (l1 - l2) * cos * sin


@inline
def add_gradient(n_x, n_y, n_z, axes, slopes, amplitude, by_td, by_dd, sums, log_k_slope, gradient):
    """Add to ``gradient`` (6,) the gradient of by_td TD + by_dd DD by theta, from a lobe's ``sums``.

    ``axes``: (l1, l2, cos, sin, s1, s2) of the lobe that was summed. ``slopes``: derivatives of its log tensor by that
    of theta in the eigenbasis: first diagonal entry, second, off-diagonal (1, 1, 1 without a blur; see the head of this
    file).
    """
    l1, l2, cos, sin, s1, s2 = axes
    slope1, slope2, slope12 = slopes
    td, dd = amplitude * sums[0], amplitude * amplitude * sums[7]
    of_t, of_d = by_td * amplitude, by_dd * amplitude * amplitude
    uu, uv, vv = of_t * sums[1] + of_d * sums[8], of_t * sums[2] + of_d * sums[9], of_t * sums[3] + of_d * sums[10]
    along1, along2 = 2.0 * s1 * (of_t * sums[4] + of_d * sums[11]), 2.0 * s2 * (of_t * sums[5] + of_d * sums[12])
    sinh = 0.5 * (s2 * s2 - s1 * s1) / (s1 * s2)
    delta = 0.5 * (l1 - l2)
    kappa = sinh / delta if delta > 1e-4 else 1.0
    k = 1.0 / (1.0 + n_z)
    twist = -4.0 * sinh * uv * k
    by_t, by_b = along1 * cos - along2 * sin, along1 * sin + along2 * cos
    across = -n_x * n_y * k
    gradient[0] += n_z * (by_t * (1.0 - n_x * n_x * k) + by_b * across - twist * n_y)
    gradient[1] += n_z * (by_t * across + by_b * (1.0 - n_y * n_y * k) + twist * n_x)
    # The amplitude's own derivative: d log A = -(dl1 + dl2) / 2 + d log K.
    whole = by_td * td + 2.0 * by_dd * dd
    uu, vv = slope1 * uu, slope2 * vv
    cs, cross, apart = cos * sin, 2.0 * kappa * uv * slope12, slope1 - slope2
    gradient[2] += cs * cross - cos * cos * uu - sin * sin * vv - 0.5 * whole * (slope2 + cos * cos * apart)
    gradient[3] += -cs * cross - sin * sin * uu - cos * cos * vv - 0.5 * whole * (slope1 - cos * cos * apart)
    gradient[4] += 2.0 * cs * (vv - uu) - (cos * cos - sin * sin) * cross - cs * whole * apart
    gradient[5] += of_t * sums[6] + of_d * sums[13] + log_k_slope * whole


@inline
def add_walls(theta, l1, l2, cos, sin, setting, value, gradient):
    """Add the walls that keep log eigenvalues and shape within their bounds to ``gradient``; returns value + walls."""
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


@inline
def add_diffuse(n_x, n_y, n_z, form, gradient):
    """Add the gradient of n' A n to ``gradient``; returns n' A n.

    ``form``: xx, yy, zz, xy, xz, yz of A. With n = (-m, 1) n_z, dn / dm_x = n_z (n_x n - e_x).
    """
    a_x = form[0] * n_x + form[3] * n_y + form[4] * n_z
    a_y = form[3] * n_x + form[1] * n_y + form[5] * n_z
    a_z = form[4] * n_x + form[5] * n_y + form[2] * n_z
    value = n_x * a_x + n_y * a_y + n_z * a_z
    gradient[0] += 2.0 * n_z * (n_x * value - a_x)
    gradient[1] += 2.0 * n_z * (n_y * value - a_y)
    return value


@kernel
def evaluate_table(theta, table, setting, moments_kernel, log_normalisation, gradient, work):
    """Relative squared error minus 1, and its gradient by theta: ``evaluate`` over all sizes of light.

    ``gradient`` (6,) is written; ``work`` (EVALUATION,) is scratch, of which work[0] and work[1] hold TD and DD on
    return.
    """
    if table.lights.shape[0] == 1 and table.lights[0, LOBE_BLUR] == 0.0 and setting[HELD] != BOUNDED:
        return evaluate(theta, segment(table, 0), setting, moments_kernel, log_normalisation, gradient, work)
    inverse = 1.0 / math.sqrt(1.0 + theta[0] * theta[0] + theta[1] * theta[1])
    n_x, n_y = -theta[0] * inverse, -theta[1] * inverse
    l1, l2, cos, sin = eigen_log(theta[2], theta[3], theta[4])
    log_k, log_k_slope = log_normalisation(theta[5])
    k = math.exp(log_k) if log_k != 0.0 else 1.0
    shape = real(theta[5])
    sizes = table.lights.shape[0]
    td, dd = 0.0, 0.0
    for s in range(sizes):
        kept = work[2 + s * _KEPT : 2 + (s + 1) * _KEPT]
        square = table.lights[s, LOBE_BLUR]
        wide1, wide2 = l1, l2
        if square > 0.0:
            wide1, wide2 = math.log(math.exp(l1) + square), math.log(math.exp(l2) + square)
        s1, s2 = scaled_frame(n_x, n_y, inverse, wide1, wide2, cos, sin, kept[_FRAME : _FRAME + 9])
        amplitude = k * s1 * s2 / math.pi
        sums = kept[_SUMS : _SUMS + 14]
        moments_kernel(segment(table, s), kept[_FRAME : _FRAME + 9], shape, sums)
        td += amplitude * sums[0]
        dd += amplitude * amplitude * sums[7]
        kept[_OWN], kept[_OWN + 1], kept[_OWN + 2], kept[_OWN + 3] = wide1, wide2, s1, s2
        kept[_OWN + 4] = amplitude
    work[0], work[1] = td, dd
    if not dd > 0.0:
        value, by_td, by_dd = 0.0, 0.0, 0.0
    elif setting[HELD] == BOUNDED:
        # The sky's term is ENERGY (1 - x)^2, with x the scale relative to the filtered colour.
        sky = setting[ENERGY] / setting[SCALE]
        x = min(max((td + sky) / (dd + sky), setting[SCALE_LOW]), setting[SCALE_HIGH])
        value = setting[SCALE] * (x * x * (dd + sky) - 2.0 * x * (td + sky)) + setting[ENERGY]
        by_td, by_dd = -2.0 * setting[SCALE] * x, setting[SCALE] * x * x
    elif setting[HELD] > 0.0:
        value, by_td, by_dd = setting[SCALE] * (dd - 2.0 * td), -2.0 * setting[SCALE], setting[SCALE]
    else:
        rho = td / dd
        value, by_td, by_dd = -setting[SCALE] * rho * td, -2.0 * setting[SCALE] * rho, setting[SCALE] * rho * rho
    for p in range(6):
        gradient[p] = 0.0
    for s in range(sizes):
        kept = work[2 + s * _KEPT : 2 + (s + 1) * _KEPT]
        square = table.lights[s, LOBE_BLUR]
        wide1, wide2 = kept[_OWN], kept[_OWN + 1]
        slope1, slope2, slope12 = 1.0, 1.0, 1.0
        if square > 0.0:
            slope1, slope2 = 1.0 - square * math.exp(-wide1), 1.0 - square * math.exp(-wide2)
            slope12 = (wide1 - wide2) / (l1 - l2) if l1 - l2 > 2e-4 else slope1
        add_gradient(
            n_x, n_y, inverse, (wide1, wide2, cos, sin, kept[_OWN + 2], kept[_OWN + 3]),
            (slope1, slope2, slope12), kept[_OWN + 4], by_td, by_dd, kept[_SUMS : _SUMS + 14], log_k_slope, gradient,
        )  # fmt: skip
    value += add_diffuse(n_x, n_y, inverse, setting[DIFFUSE : DIFFUSE + DIFFUSE_FORM], gradient)
    return add_walls(theta, l1, l2, cos, sin, setting, value, gradient)
