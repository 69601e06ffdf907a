"""How the best lobe changes with the spread of a footprint's lobes: a closed form of third order.

A footprint's lobes differ from a lobe in their middle by small x = (t1, t2, l): the turn of the normal in units of
alpha (gnomonic, t1 along the tilt) and the change of log alpha^2. With D the middle lobe, their average is

    T = D + E[x_i] D_i + 1/2 E[x_i x_j] D_ij + 1/6 E[x_i x_j x_k] D_ijk + ...,

D_i its derivatives by x_i. The best lobe near D, with its scale, is the L2 projection of T onto the space spanned by D
(for the scale) and its derivatives by the free parameters (turns, log alpha^2, and the two of an anisotropic tensor).
So every moment of x moves every parameter in proportion, and its part outside that space is the error. The factors
depend only on alpha and the tilt: one table for each model holds them, from finite differences on nodes drawn from the
lobe.

For a sharp GGX lobe they follow on paper. With u = 1 / (1 + t^2), D = u^2 / pi, and the integral of u^m over the plane
being pi / (m - 1): normals of covariance c I add c (8 u^3 - 12 u^4) / pi; the scale's direction is u^2 and that of
log alpha^2 is u^2 - 2 u^3, so log alpha^2 grows by 4 c (LEAN: 2 c), the scale by 0.8 c, and the error is 0.27 c^2
(LEAN: 0.91 c^2). An anisotropic covariance stretches log Sigma by three times its deviator (LEAN: two). A variance v of
log alpha^2 lowers log alpha^2 by v / 2 and the scale by 0.2 v. A test compares the table with these numbers.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import kernel, numba_type, types
from brdffit.halfangle.objective import lobe_values_type, log_normalisation_type
from brdffit.halfangle.quadrature import H_X, H_Y, H_Z, NODE_ROWS

#: Orders of (t1, t2, l) in each moment, second moments first.
MOMENT_ORDERS = (
    (2, 0, 0), (1, 1, 0), (0, 2, 0), (1, 0, 1), (0, 1, 1), (0, 0, 2),
    (3, 0, 0), (2, 1, 0), (1, 2, 0), (0, 3, 0), (2, 0, 1), (1, 1, 1), (0, 2, 1), (1, 0, 2), (0, 1, 2), (0, 0, 3),
)  # fmt: skip
SECOND = 6
THIRD = len(MOMENT_ORDERS)
#: Answers to each moment: change of the scale (relative), t1, t2, log alpha^2, and the stretch's two components.
ANSWERS = 6
# A row of the table: answers to each moment; change of a channel's own scale with its mean (t1, t2, l), and the squared
# error that remains; Gram matrix of the second moments' parts outside the spanned space.
BY_FIRST = THIRD * ANSWERS
OFF_SCALE = BY_FIRST + 3
OFF_PLANE = OFF_SCALE + 3
ROW = OFF_PLANE + SECOND * SECOND

#: Grid of the table: alpha in even steps of its logarithm, the cosine of the tilt in even steps.
ALPHAS = np.geomspace(0.025, 0.8, 11)
COSINES = np.linspace(0.4, 1.0, 7)
# Largest alpha over the cosine of the tilt: wider lobes reach the horizon, where the expansion fails.
_WIDEST = 0.7
_NODES, _STEP = 1536, 0.12
# Central differences of order 0 to 3: offsets and weights.
_STENCILS = (((0, 1.0),), ((1, 0.5), (-1, -0.5)), ((1, 1.0), (0, -2.0), (-1, 1.0)),
             ((2, 0.5), (1, -1.0), (-1, 1.0), (-2, -0.5)))  # fmt: skip


class Response(NamedTuple):
    """``table`` (A, Z, ROW) float64 over log alpha and the cosine of the tilt; first value and step of both. Entries
    are infinite where the expansion does not hold."""

    table: NDArray
    log_alpha: float
    log_alpha_step: float
    cosine: float
    cosine_step: float


#: Stands in for a table where none is needed.
NO_RESPONSE = Response(np.full((2, 2, ROW), np.inf), 0.0, 1.0, 0.0, 1.0)


@cache
def response_of(
    values_kernel: Any, log_normalisation: Any, exponent: int, *, turns: bool, stretches: bool, held: bool
) -> Response:
    """The table of one lobe model that has no shape parameter.

    Args:
        values_kernel, log_normalisation: of the model.
        exponent: of z.h in the half-angle density.
        turns, stretches, held: whether the fit turns the normal, stretches the tensor, and holds the scale.
    """
    table = np.full((len(ALPHAS), len(COSINES), ROW), np.inf)
    free = [not held, turns, turns, True, stretches, stretches]
    for a, alpha in enumerate(ALPHAS):
        for z, cosine in enumerate(COSINES):
            if alpha < _WIDEST * cosine:
                table[a, z] = _row(values_kernel, log_normalisation, exponent, float(alpha), float(cosine), free)
    log_alphas = np.log(ALPHAS)
    return Response(table, log_alphas[0], log_alphas[1] - log_alphas[0], COSINES[0], COSINES[1] - COSINES[0])


def _row(
    values_kernel: Any, log_normalisation: Any, exponent: int, alpha: float, cosine: float, free: list[bool]
) -> NDArray:
    nodes, weight = _nodes(alpha, cosine, exponent)
    lobes = np.zeros((len(_STEPS), _NODES))
    _filling_kernel()(values_kernel, log_normalisation, nodes, _parameters(alpha, cosine), lobes)
    derivatives = _WEIGHTS @ lobes
    by_moment, first, plane = derivatives[:THIRD], derivatives[THIRD : THIRD + 3], derivatives[THIRD:]
    plane = np.concatenate([lobes[_MIDDLE : _MIDDLE + 1], plane])
    spanned = plane[free]
    answers = np.zeros((THIRD, ANSWERS))
    answers[:, free] = np.linalg.solve((spanned * weight) @ spanned.T, (spanned * weight) @ by_moment.T).T
    off = by_moment[:SECOND] - answers[:SECOND, free] @ spanned
    norm = float(weight @ plane[0] ** 2)
    by_first = first @ (weight * plane[0]) / norm * free[0]
    off_scale = (first - by_first[:, None] * plane[0]) ** 2 @ weight / norm
    return np.concatenate([answers.ravel(), by_first, off_scale, ((off * weight) @ off.T / norm).ravel()])


def _differences() -> tuple[NDArray, NDArray]:
    """Steps (M, 5) in (t1, t2, l, stretch along, across), and weights (THIRD + 5, M) of the central differences.

    The first THIRD rows are the moments' derivatives over the factorials of Taylor's series, the last five the first
    derivatives.
    """
    weights: dict[tuple[int, ...], dict[int, float]] = {(0,) * 5: {}}
    for row, orders in enumerate(MOMENT_ORDERS):
        share = 1.0 / math.prod(math.factorial(order) * _STEP**order for order in orders)
        for (i, a), (j, b), (k, c) in product(*(_STENCILS[order] for order in orders)):
            weights.setdefault((i, j, k, 0, 0), {})[row] = share * a * b * c
    for axis, unit in enumerate(np.eye(5, dtype=int)):
        for side in (1, -1):
            weights.setdefault(tuple(side * unit), {})[THIRD + axis] = side / (2.0 * _STEP)
    matrix = np.zeros((THIRD + 5, len(weights)))
    for column, rows in enumerate(weights.values()):
        for row, weight in rows.items():
            matrix[row, column] = weight
    return np.array(list(weights)), matrix


_STEPS, _WEIGHTS = _differences()
_MIDDLE = 0


def _parameters(alpha: float, cosine: float) -> NDArray:
    """theta (M, 6) of the lobes at ``_STEPS`` from the middle one."""
    normal, along, across = _frame(cosine)
    t1, t2, size, stretch, shear = _STEP * _STEPS.T
    turned = normal + alpha * (t1[:, None] * along + t2[:, None] * across)
    log = 2.0 * math.log(alpha) + size
    slopes = -turned[:, :2] / turned[:, 2:]
    return np.column_stack([slopes, log + stretch, log - stretch, shear, np.zeros_like(log)])


@kernel
def _fill(values_kernel, log_normalisation, nodes, theta, lobes):
    """Write the values (M, N) of M lobes on the nodes."""
    values, work = np.zeros(nodes.shape[1], np.float32), np.zeros(16)
    for m in range(theta.shape[0]):
        values_kernel(theta[m], nodes, log_normalisation, values, work)
        for j in range(values.size):
            lobes[m, j] = values[j]


@cache
def _filling_kernel() -> Any:
    """``_fill``, compiled once for all models (their kernels are arguments of function type), cached on disk."""
    data = (numba_type(np.zeros((1, 1), np.float32)), *(numba_type(np.zeros((1, 1))),) * 2)
    _fill.compile((lobe_values_type(types.float32), log_normalisation_type, *data))
    _fill.disable_compile()
    return _fill


def _nodes(alpha: float, cosine: float, exponent: int) -> tuple[NDArray, NDArray]:
    """Nodes (NODE_ROWS, N) float32 drawn from the GGX lobe of 1.2 alpha, whose tails are the longest; weights (N,)."""
    wide = 1.2 * alpha
    half = np.arange(_NODES // 2)
    u, angle = (half + 0.5) / len(half), 2.0 * np.pi * ((half * 0.6180339887498949) % 1.0)
    # Mirrored across the tilt, so that integrals of functions that are odd across it vanish exactly.
    u, angle = np.tile(u, 2), np.concatenate([angle, -angle])
    radius = wide * np.sqrt(u / np.maximum(1.0 - u, 1e-4))
    normal, along, across = _frame(cosine)
    h = normal + radius[:, None] * (np.cos(angle)[:, None] * along + np.sin(angle)[:, None] * across)
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    c = h @ normal
    density = c / (np.pi * wide**2 * ((1.0 - c * c) / wide**2 + c * c) ** 2)
    nodes = np.zeros((NODE_ROWS, _NODES), np.float32)
    nodes[H_X], nodes[H_Y], nodes[H_Z] = h.T
    return nodes, np.maximum(h[:, 2], 0.0) ** exponent / density


def _frame(cosine: float) -> tuple[NDArray, NDArray, NDArray]:
    """The normal tilted along x, and its tangents along and across the tilt."""
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    return np.array([sine, 0.0, cosine]), np.array([cosine, 0.0, -sine]), np.array([0.0, 1.0, 0.0])
