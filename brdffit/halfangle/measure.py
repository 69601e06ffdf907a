"""Error of the lobes of any pyramid's texels against the truth, by a dense rule of its own.

The figure of merit of a level is SNR = -10 log10 of the mean over texels of

    e = sum_c <(T_c - rho_c D)^2> / sum_c <T_c^2>,     < . > the integral over h with the half-angle density.

The rule has more nodes than any preset uses and other nodes and jitter than the fit. Fine quality takes more samples of
large footprints. Lobes end at their own horizon.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import kernel, numba_type, types
from brdffit.footprint import get_pixel_filter
from brdffit.halfangle.apparent_lobe import (
    DIFFUSE_MOMENT,
    Base,
    Strata,
    example_base,
    example_strata,
    gather_lobes,
    normalise_mixture,
    strata,
)
from brdffit.halfangle.closed_forms import DEFENSIVE_SHARE, LEAN, STARTS, closed_forms, light_lobes, widen_lobes
from brdffit.halfangle.objective import PARAMETERS, lobe_values_type, log_normalisation_type
from brdffit.halfangle.quadrature import (
    BLUE,
    GREEN,
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
from brdffit.methods import Level
from brdffit.svbrdf import Svbrdf

#: Nodes of the dense rule; least and most samples of a footprint along one axis.
DENSE_NODES = 4096
DENSE_SAMPLES = (32, 128)
#: Lobe widths that the normal may turn from one sample to the next; room for cut strata, as a multiple of the samples.
DENSE_STEP, DENSE_ROOM = 0.7, 3
#: Where ``target_table`` leaves the closed forms in its work array.
STARTS_AT = 9 + DIFFUSE_MOMENT

#: SNR in dB above which levels count as equally good: a relative squared error below 1e-5 is invisible, and near the
#: resolution of single-precision sums.
PERFECT_DB = 50.0

# A mean spread of normals inside the strata below this, in units of the lobe's width, is ignored.
_NARROW_SPREAD = 0.002

_SHIFT = (0.25, 0.137, 0.719)


class Measured(NamedTuple):
    """Relative squared error of each texel, and its energy: sum of rho over that of the filtered colour's channels."""

    error: NDArray
    energy: NDArray


def snr(error: NDArray) -> float:
    """-10 log10 of the mean relative squared error, in dB; infinite if the error is 0."""
    mean = float(np.mean(error)) if np.size(error) else 0.0
    return math.inf if mean <= 0.0 else -10.0 * math.log10(mean)


def dense_strata(
    base_size: tuple[int, int], level_size: tuple[int, int], pixel_filter: str, samples: tuple[int, int] = DENSE_SAMPLES
) -> Strata:
    """Strata of the dense rule: at least four samples along each axis of a base texel, and between ``samples[0]`` and
    ``samples[1]`` along an axis of the footprint, but two a texel where ``samples[1]`` allows between one and two.

    So strata end on texel centres, as bilinear patches do: one across a centre that is cut into parts is moved into one
    patch, and at the rim of a footprint that counted the texels beyond it 16/9 times.
    """
    chosen = get_pixel_filter(pixel_filter)
    width = 2.0 * chosen.radius * max(base_size[0] / level_size[0], base_size[1] / level_size[1])
    per_texel = max(4, 2 * math.ceil(0.5 * samples[0] / width))
    most = max(samples[1], math.ceil(2.0 * width)) if samples[1] > width else samples[1]
    return strata(chosen, base_size, level_size, per_texel, most, seed=20231)


@kernel
def target_table(base, strata, points, column, row, exponent, light, lobes, nodes, work, tabulate_kernel,
                 source_log_normalisation):  # fmt: skip
    """Place the nodes of one footprint, fill its table and weights; returns (mean colour r, g, b, <T,T>).

    ``light``: alpha^2 that a light of some size adds to every lobe (0: a point). Where nothing is reflected T is 0, and
    the returned <T,T> is that of the same lobes in white, so that relative errors are defined.
    """
    moment, starts = work[9:STARTS_AT], work[STARTS_AT : STARTS_AT + STARTS * PARAMETERS].reshape(STARTS, PARAMETERS)
    count, spread = gather_lobes(base, strata, DENSE_STEP, column, row, lobes, moment)
    red, green, blue, some = normalise_mixture(lobes, count)
    isotropic = base.isotropic
    if spread > _NARROW_SPREAD:
        widen_lobes(lobes, count, isotropic, base.widening, light, base.averages)
        isotropic = False
    else:
        light_lobes(lobes, 0, count, isotropic, light)
    closed_forms(lobes, count, isotropic, starts, False)
    add_defensive_lobe(
        lobes, count, DEFENSIVE_SHARE, starts[LEAN, 0], starts[LEAN, 1], min(starts[LEAN, 2], 0.0),
        min(starts[LEAN, 3], 0.0), starts[LEAN, 4],
    )  # fmt: skip
    frame_lobes(lobes, count, isotropic)
    place_nodes(lobes, count, points, exponent, nodes)
    normalise_shapes(lobes, count, base.has_shape, source_log_normalisation)
    tabulate_kernel(lobes, count, isotropic, base.grey, nodes)
    weigh_nodes(nodes)
    norm = 0.0
    for j in range(nodes.shape[1]):
        norm += nodes[WEIGHT, j] * (nodes[RED, j] ** 2 + nodes[GREEN, j] ** 2 + nodes[BLUE, j] ** 2)
    if not some:
        nodes[RED : BLUE + 1] = 0.0
    return red, green, blue, norm


@kernel
def measure_rows(base, strata, points, columns, rows, exponent, theta, scale, error, energy,
                 tabulate_kernel, values_kernel, log_normalisation, source_log_normalisation):  # fmt: skip
    """Write error and energy (M, n) of the lobes theta (M, n, 6) with scale (M, n, 3) at n texels."""
    count = strata.x.size * strata.y.size
    lobes = np.zeros((DENSE_ROOM * count + 1, LOBE_COLUMNS))
    nodes = np.zeros((NODE_ROWS, points.shape[1]), np.float32)
    values = np.zeros(points.shape[1], np.float32)
    work = np.zeros(64)
    for i in range(columns.size):
        red, green, blue, norm = target_table(
            base, strata, points, columns[i], rows[i], exponent, 0.0, lobes, nodes, work, tabulate_kernel,
            source_log_normalisation,
        )  # fmt: skip
        for m in range(theta.shape[0]):
            values_kernel(theta[m, i], nodes, log_normalisation, values, work)
            t = theta[m, i]
            inverse = 1.0 / math.sqrt(1.0 + t[0] * t[0] + t[1] * t[1])
            n_x, n_y, n_z = -t[0] * inverse, -t[1] * inverse, inverse
            total = 0.0
            for j in range(nodes.shape[1]):
                above = n_x * nodes[0, j] + n_y * nodes[1, j] + n_z * nodes[2, j] > 0.0
                d = values[j] if above else 0.0
                r = nodes[RED, j] - scale[m, i, 0] * d
                g = nodes[GREEN, j] - scale[m, i, 1] * d
                b = nodes[BLUE, j] - scale[m, i, 2] * d
                total += nodes[WEIGHT, j] * (r * r + g * g + b * b)
            error[m, i] = total / norm if norm > 0.0 else 0.0
            mean = red + green + blue
            energy[m, i] = (scale[m, i, 0] + scale[m, i, 1] + scale[m, i, 2]) / mean if mean > 0.0 else 1.0


@cache
def _measuring_kernel() -> Any:
    """``measure_rows``, compiled once for all models (their kernels are arguments of function type), cached on disk."""
    index, triple, figures = np.zeros(1, np.int64), np.zeros((1, 1, 1)), np.zeros((1, 1))
    data = (example_base(), example_strata(), lattice(1), index, index, 3, triple, triple, figures, figures)
    functions = (tabulate_type(types.float32), lobe_values_type(types.float32), *(log_normalisation_type,) * 2)
    measure_rows.compile((*map(numba_type, data), *functions))
    measure_rows.disable_compile()
    return measure_rows


def lobe_parameters(svbrdf: Svbrdf, columns: NDArray, rows: NDArray, default_shape: float = 0.0) -> NDArray:
    """theta (n, 6) float64 of texels: slopes of the normal, log roughness tensor, shape."""
    normal = svbrdf.normal[rows, columns].astype(np.float64)
    theta = np.zeros((len(rows), 6))
    theta[:, 0:2] = -normal[:, 0:2] / np.maximum(normal[:, 2:3], 1e-3)
    theta[:, 2:5] = svbrdf.log_roughness[rows, columns]
    theta[:, 5] = default_shape if svbrdf.shape is None else svbrdf.shape[rows, columns]
    return theta


def random_texels(size: tuple[int, int], count: int, seed: int) -> tuple[NDArray, NDArray]:
    """(columns, rows) of ``count`` random texels of a level of ``size`` (height, width), or of all if there are fewer;
    int64."""
    height, width = size
    if height * width <= count:
        flat = np.arange(height * width)
    else:
        flat = np.random.default_rng(seed).choice(height * width, size=count, replace=False)
    return (flat % width).astype(np.int64), (flat // width).astype(np.int64)


def measure(base: Base, base_size: tuple[int, int], levels: list[Level] | list[Svbrdf], columns: NDArray, rows: NDArray,
            *, pixel_filter: str, exponent: int, kernels, default_shape: float = 0.0, nodes: int = DENSE_NODES,
            samples: tuple[int, int] = DENSE_SAMPLES) -> Measured:  # fmt: skip
    """Measure M versions of one level (of one lobe model) at n texels against the truth; arrays (M, n)."""
    versions = [level.svbrdf if isinstance(level, Level) else level for level in levels]
    theta = np.stack([lobe_parameters(v, columns, rows, default_shape) for v in versions])
    scale = np.stack([v.specular[rows, columns].astype(np.float64) for v in versions])
    return measure_lobes(base, base_size, versions[0].size, theta, scale, columns, rows, pixel_filter=pixel_filter,
                         exponent=exponent, kernels=kernels, nodes=nodes, samples=samples)  # fmt: skip


def measure_lobes(base: Base, base_size: tuple[int, int], level_size: tuple[int, int], theta: NDArray, scale: NDArray,
                  columns: NDArray, rows: NDArray, *, pixel_filter: str, exponent: int, kernels,
                  nodes: int = DENSE_NODES, samples: tuple[int, int] = DENSE_SAMPLES) -> Measured:  # fmt: skip
    """As ``measure``, of lobes given by theta (M, n, 6) and scale (M, n, 3)."""
    error = np.zeros(theta.shape[:2])
    energy = np.zeros(theta.shape[:2])
    rule = dense_strata(base_size, level_size, pixel_filter, samples)
    _measuring_kernel()(base, rule, lattice(nodes, _SHIFT), columns, rows, exponent, theta, scale, error, energy,
                 kernels.tabulate, kernels.values, kernels.log_normalisation,
                 kernels.source_log_normalisation)  # fmt: skip
    return Measured(error, energy)
