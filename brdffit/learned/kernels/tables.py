"""The exact half-angle objective as training data: nodes, weights and targets of footprints, kept for good.

A table holds, a texel, the nodes h_j, their weights W_j and the weighted scalar target of the product's own quadrature
(``brdffit.halfangle.quadrature``); the error of any lobe, its gradient and the best scale then take one pass over some
64 nodes and no random numbers, where a rendering loss would have variance.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import kernel, numba_type, part, types
from brdffit.fitting.batch import ModelKernels, model_kernels
from brdffit.halfangle.apparent_lobe import (
    DIFFUSE_MOMENT,
    Base,
    Strata,
    example_base,
    example_strata,
    gather_lobes,
    normalise_mixture,
)
from brdffit.halfangle.closed_forms import DEFENSIVE_SHARE, widen_lobes, widen_round_lobes
from brdffit.halfangle.objective import LOG_LOW, SCALE, SETTINGS, TARGET, evaluate, log_normalisation_type, moments_type
from brdffit.halfangle.quadrature import (
    BLUE,
    GREEN,
    H_X,
    H_Y,
    H_Z,
    LOBE_COLUMNS,
    NODE_ROWS,
    RED,
    WEIGHT,
    add_defensive_lobe,
    frame_lobes,
    lattice,
    normalise_shapes,
    place_nodes,
    tabulate_type,
    weigh_nodes,
)
from brdffit.learned.kernels.moments import CLOSED, FEATURES, LOG_TENSOR, MOMENTS, all_features, lobe_moments
from brdffit.nets.doubles import EIGHT
from brdffit.roughness import DEFAULT_MIN_ROUGHNESS

#: Nodes of a texel's table. Noise of so few averages out over the texels of a batch.
NODES = 64
#: Of the half-angle density: cosine-distributed lights and viewers.
EXPONENT = 3
#: Lobe widths that the normal may turn from one sample of a footprint to the next, as in the draft preset.
STEP = 3.0
_NARROW_SPREAD = 0.002
_ROWS = (H_X, H_Y, H_Z, WEIGHT, TARGET)


class Table(NamedTuple):
    """Footprints of n texels.

    ``nodes`` (n, 5, NODES) float32: h, weight, weighted target; ``norm`` (n,): <T,T>; ``colour`` (n,): length of the
    filtered colour; ``moments`` (n, MOMENTS) float64.
    """

    nodes: NDArray
    norm: NDArray
    colour: NDArray
    moments: NDArray

    def __len__(self) -> int:
        return len(self.norm)

    def rows(self, index: NDArray | slice) -> Table:
        """Some of its texels."""
        return Table(*(part[index] for part in self))

    @staticmethod
    def joined(tables: list[Table]) -> Table:
        """One table of several."""
        return Table(*(np.concatenate(parts) for parts in zip(*tables, strict=True)))


@kernel
def aim_at_colour(nodes, red, green, blue):
    """Fill the row of weighted scalar targets, of <T, colour> for a unit colour; returns <T,T> over all channels."""
    norm = 0.0
    for j in range(nodes.shape[1]):
        r, g, b, weight = nodes[RED, j], nodes[GREEN, j], nodes[BLUE, j], nodes[WEIGHT, j]
        norm += weight * (r * r + g * g + b * b)
        nodes[TARGET, j] = weight * (red * r + green * g + blue * b)
    return norm


@kernel
def prepare_lobes(base, strata, column, row, lobes, diffuse_moment):
    """Gather a footprint and widen its lobes by what lies inside their parts: (count, isotropic, mean colour, some)."""
    count, spread = gather_lobes(base, strata, STEP, column, row, lobes, diffuse_moment)
    red, green, blue, some = normalise_mixture(lobes, count)
    isotropic = base.isotropic
    if spread > _NARROW_SPREAD:
        widen_lobes(lobes, count, isotropic, base.widening)
        isotropic = False
    elif spread > 0.0 and isotropic:
        widen_round_lobes(lobes, count, base.widening)
    return count, isotropic, red, green, blue, some


@part
def recentred(strata, scale_x, scale_y):
    """The strata of a level with other scales, which put a footprint's centre where it is wanted."""
    return Strata(
        strata.x, strata.y, strata.weight_x, strata.weight_y, strata.jitter_x, strata.jitter_y, scale_x, scale_y,
        strata.seed, strata.merge, strata.light, strata.scatter,
    )  # fmt: skip


@kernel
def one_closed_form(moments, eightfold, feature, closed):
    """``closed`` <- the closed form of moments (MOMENTS,); ``all_features`` takes eight at a time, here equal ones."""
    for k in range(MOMENTS):
        for j in range(EIGHT):
            eightfold[k * EIGHT + j] = moments[k]
    all_features(eightfold, EIGHT, feature, closed)


@kernel
def add_closed_form(lobes, count, closed):
    """Add the closed form of ``one_closed_form`` as the defensive lobe, so that nodes stand where it shines."""
    add_defensive_lobe(
        lobes, count, DEFENSIVE_SHARE, -closed[0] / closed[2 * EIGHT], -closed[EIGHT] / closed[2 * EIGHT],
        min(closed[LOG_TENSOR * EIGHT], 0.0), min(closed[(LOG_TENSOR + 1) * EIGHT], 0.0),
        closed[(LOG_TENSOR + 2) * EIGHT],
    )  # fmt: skip


@kernel
def tabulate_rows(
    base, strata, columns, rows, scale_x, scale_y, points, lobes, nodes, out, norm, colour, moments, tabulate_kernel,
    source_log_normalisation,
):  # fmt: skip
    """Fill a table for texels (columns[i], rows[i]); scales (n,) put each footprint's centre where it should be."""
    eightfold, feature, closed = np.zeros(MOMENTS * EIGHT), np.zeros(FEATURES * EIGHT), np.zeros(CLOSED * EIGHT)
    diffuse_moment = np.zeros(DIFFUSE_MOMENT)
    for i in range(columns.size):
        here = recentred(strata, scale_x[i], scale_y[i])
        count, isotropic, red, green, blue, _ = prepare_lobes(base, here, columns[i], rows[i], lobes, diffuse_moment)
        lobe_moments(lobes, count, isotropic, moments[i])
        one_closed_form(moments[i], eightfold, feature, closed)
        add_closed_form(lobes, count, closed)
        normalise_shapes(lobes, count, base.has_shape, source_log_normalisation)
        frame_lobes(lobes, count, isotropic)
        place_nodes(lobes, count, points, EXPONENT, nodes)
        tabulate_kernel(lobes, count, isotropic, base.grey, nodes)
        weigh_nodes(nodes)
        red, green, blue = max(red, 1e-9), max(green, 1e-9), max(blue, 1e-9)
        colour[i] = math.sqrt(red * red + green * green + blue * blue)
        norm[i] = aim_at_colour(nodes, red / colour[i], green / colour[i], blue / colour[i])
        for k in range(NODES):
            out[i, 0, k], out[i, 1, k], out[i, 2, k] = nodes[H_X, k], nodes[H_Y, k], nodes[H_Z, k]
            out[i, 3, k], out[i, 4, k] = nodes[WEIGHT, k], nodes[TARGET, k]


@cache
def _tabulating_kernel() -> Any:
    """``tabulate_rows`` compiled for function-typed arguments: it reaches the disk cache."""
    index, line, square = np.zeros(1, np.int64), np.zeros(1), np.zeros((1, 1))
    single = np.zeros((1, 1), np.float32)
    data = (
        example_base(), example_strata(), index, index, line, line, lattice(1), square, single,
        np.zeros((1, 1, 1), np.float32), line, line, square,
    )  # fmt: skip
    tabulate_rows.compile((*map(numba_type, data), tabulate_type(types.float32), log_normalisation_type))
    tabulate_rows.disable_compile()
    return tabulate_rows


@cache
def _error_kernel() -> Any:
    """``error_rows``, likewise."""
    line, square = np.zeros(1), np.zeros((1, 1))
    data = (
        np.zeros((1, 1, 1), np.float32), np.zeros(1, np.int64), line, square, 0.0, line, square, line, line,
    )  # fmt: skip
    error_rows.compile((*map(numba_type, data), moments_type(types.float32), log_normalisation_type))
    error_rows.disable_compile()
    return error_rows


def tabulate(
    base: Base, strata: Strata, x: NDArray, y: NDArray, room: int, kernels: ModelKernels | None = None,
    moments: NDArray | None = None,
) -> Table:  # fmt: skip
    """The table of ``tabulated`` without the texels that reflect nothing."""
    table, fine = tabulated(base, strata, x, y, room, kernels, moments)
    return table if fine.all() else table.rows(fine)


def tabulated(
    base: Base, strata: Strata, x: NDArray, y: NDArray, room: int, kernels: ModelKernels | None = None,
    moments: NDArray | None = None,
) -> tuple[Table, NDArray]:  # fmt: skip
    """Footprints with the strata of a level, centred at (x[i], y[i]) base texels (texel 0 is centred at 0.5).

    ``kernels``: of the base's model; ``moments`` (n, MOMENTS): in place of those of the gathered lobes. Returns the
    table, and which of its texels reflect anything.
    """
    kernels = kernels or model_kernels("ggx", "ggx")
    texels = len(x)
    columns, rows = np.arange(texels, dtype=np.int64) % 65536, np.arange(texels, dtype=np.int64) // 65536
    table = Table(
        np.zeros((texels, len(_ROWS), NODES), np.float32), np.zeros(texels), np.zeros(texels),
        np.zeros((texels, MOMENTS)),
    )  # fmt: skip
    # centre = (column + 1/2) scale - 1/2 in ``gather_lobes``: the scale that puts it where we want it.
    _tabulating_kernel()(
        base, strata, columns, rows, np.asarray(x) / (columns + 0.5), np.asarray(y) / (rows + 0.5), lattice(NODES),
        np.zeros((room, LOBE_COLUMNS)), np.zeros((NODE_ROWS, NODES), np.float32), *table, kernels.tabulate,
        kernels.source_log_normalisation,
    )  # fmt: skip
    if moments is not None:
        table.moments[:] = moments
    fine = (table.norm > 1e-12) & np.isfinite(table.nodes).all(axis=(1, 2)) & np.isfinite(table.moments).all(axis=1)
    return table, fine


@kernel
def error_rows(tables, index, norm, theta, log_low, error, gradient, scale, weight, moments_kernel, log_normalisation):
    """Relative squared error of lobes theta (n, 5) at the best scale against texels ``index`` of a table.

    ``gradient`` (n, 5) by theta, walls of the domain included; ``scale`` (n,) the best scale along the filtered colour;
    ``weight`` (n,) <D,D> / <T,T>: the error grows by weight (k - scale)^2 at another scale k.
    """
    nodes, setting, work = np.zeros((NODE_ROWS, NODES), np.float32), np.zeros(SETTINGS), np.zeros(48)
    full, slope = np.zeros(6), np.zeros(6)
    setting[LOG_LOW] = log_low
    for i in range(index.size):
        t = index[i]
        for k in range(NODES):
            nodes[H_X, k], nodes[H_Y, k], nodes[H_Z, k] = tables[t, 0, k], tables[t, 1, k], tables[t, 2, k]
            nodes[WEIGHT, k], nodes[TARGET, k] = tables[t, 3, k], tables[t, 4, k]
        setting[SCALE] = 1.0 / norm[t]
        for p in range(5):
            full[p] = theta[i, p]
        error[i] = 1.0 + evaluate(full, nodes, setting, moments_kernel, log_normalisation, slope, work)
        scale[i] = work[0] / max(work[1], 1e-30)
        weight[i] = work[1] / norm[t]
        for p in range(5):
            gradient[i, p] = slope[p]


class Errors(NamedTuple):
    """What ``error_rows`` fills."""

    error: NDArray
    gradient: NDArray
    scale: NDArray
    weight: NDArray


def errors_of(table: Table, index: NDArray, theta: NDArray, model: str = "ggx") -> Errors:
    """Errors and gradients of lobes theta (n, 5) at rows ``index`` (n,) of a table."""
    kernels = model_kernels("ggx", model)
    texels = len(index)
    found = Errors(np.zeros(texels), np.zeros((texels, 5)), np.zeros(texels), np.zeros(texels))
    _error_kernel()(
        table.nodes, index, table.norm, np.ascontiguousarray(theta), 4.0 * math.log(DEFAULT_MIN_ROUGHNESS), *found,
        kernels.moments, kernels.log_normalisation,
    )  # fmt: skip
    return found
