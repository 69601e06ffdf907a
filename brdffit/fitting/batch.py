"""The compiled loop over texels, and the kernels that it needs for one pair of source and target model."""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import kernel, numba_type, specialise, types
from brdffit.fitting.bfgs import make_space
from brdffit.fitting.chain import Chain, compile_footprints, footprints_of
from brdffit.fitting.scoring import EVALUATIONS, FILTERED, REPORT, RESIDUAL
from brdffit.fitting.search import Scratch, Search
from brdffit.fitting.shortcuts import WORK
from brdffit.fitting.status import FALLBACK
from brdffit.fitting.texel import GUARDS, fit_texel
from brdffit.halfangle import objective, quadrature
from brdffit.halfangle.albedo import diffuse_fresnel
from brdffit.halfangle.apparent_lobe import DIFFUSE_MOMENT, Base, Strata, example_base, example_strata
from brdffit.halfangle.closed_forms import MOMENTS, STARTS
from brdffit.halfangle.footprints import Footprints, no_footprints
from brdffit.halfangle.lights import POINT, Table, table_of
from brdffit.halfangle.merging import make_cells
from brdffit.halfangle.objective import FREE
from brdffit.halfangle.quadrature import lattice
from brdffit.halfangle.response import NO_RESPONSE

#: Quadrature rules of a level, from few nodes to many.
TIERS = 3
# Factor of the side of a cell on levels of a chain.
_LARGER_CELLS = 1.5


class Output(NamedTuple):
    """Arrays of n texels that the loop fills, one row a texel; fields as in ``Svbrdf`` and ``Level``, flattened."""

    normal: NDArray
    log_roughness: NDArray
    specular: NDArray
    diffuse: NDArray
    shape: NDArray
    status: NDArray
    residual: NDArray
    evaluations: NDArray


class LevelRules(NamedTuple):
    """How a level is sampled.

    ``strata`` of its footprints; ``room`` for lobes; ``lights``: sizes of light as in ``lights.Table``; ``points``: the
    rules, from few nodes to many, each with one point set for every size of light; ``chain``: how its footprints are
    merged from those of finer levels, where that is possible.
    """

    strata: Strata
    room: int
    lights: NDArray
    points: tuple[tuple[NDArray, ...], ...]
    chain: Chain | None = None


@kernel
def diffuse_scale(moment, channel, n_x, n_y, n_z, exponent):
    """Diffuse albedo d of one channel with d (n.l) nearest to sum_i w_i d_i (n_i.l) in L2 over light directions.

    d = g' G n / n' G n with g = sum_i w_i d_i n_i and G = E[l l'], which is diagonal: with equal entries for uniform l
    (exponent 1), with (1, 1, 2) / 4 for cosine-distributed l. The horizon of each n_i is ignored: it has no closed form
    and matters only for lights below that horizon.
    """
    up = 2.0 if exponent == 3 else 1.0
    g_x, g_y, g_z = moment[3 * channel], moment[3 * channel + 1], moment[3 * channel + 2]
    return max((g_x * n_x + g_y * n_y + up * g_z * n_z) / (n_x * n_x + n_y * n_y + up * n_z * n_z), 0.0)


@kernel
def diffuse_under_sky(moment, channel, n_z):
    """Diffuse albedo of one channel with which the level reflects as much of an even sky as its base texels do.

    A normal n receives (1 + n_z) / 2 of the sky, so d = sum_i w_i d_i (1 + n_iz) / (1 + n_z). Under a point light the
    fit depends on sum_i w_i d_i n_i, which is shorter than the mean albedo where normals differ; under a sky their
    spread hardly matters.
    """
    return max((moment[9 + channel] + moment[3 * channel + 2]) / (1.0 + n_z), 0.0)


@kernel
def own_fresnel(moment, channel, n_z):
    """``diffuse_fresnel`` of the level's normal, by which the moments of a channel hold too much of it.

    A normal that leans more than the bumps' mean is not made up for: its diffuse colour would exceed all of theirs.
    """
    g_x, g_y, g_z = moment[3 * channel], moment[3 * channel + 1], moment[3 * channel + 2]
    length = math.sqrt(g_x * g_x + g_y * g_y + g_z * g_z)
    mean = g_z / length if length > 0.0 else 1.0
    return max(diffuse_fresnel(max(n_z, mean)), 1e-3)


@kernel
def fit_rows(
    base, strata, columns, rows, search, scratch, rules, footprints, output,
    tabulate_kernel, moments_kernel, values_kernel, log_normalisation, source_log_normalisation,
):  # fmt: skip
    """Fit the texels (columns[i], rows[i]) of a level and write each into row i of the outputs.

    A texel whose search fails or whose result is not finite gets its closed-form start and the status FALLBACK.
    """
    theta, report = scratch.theta, scratch.report
    for i in range(columns.size):
        status = fit_texel(
            base, strata, columns[i], rows[i], search, scratch, rules, footprints, i,
            tabulate_kernel, moments_kernel, values_kernel, log_normalisation, source_log_normalisation,
        )  # fmt: skip
        total = 0.0
        for p in range(6):
            total += theta[p]
        if not math.isfinite(total + report[0] + report[1] + report[2]):
            status = FALLBACK
        if status == FALLBACK:
            for p in range(6):
                theta[p] = scratch.best[p]
            for k in range(3):
                report[k] = report[FILTERED + k]
        inverse = 1.0 / math.sqrt(1.0 + theta[0] * theta[0] + theta[1] * theta[1])
        n_x, n_y, n_z = -theta[0] * inverse, -theta[1] * inverse, inverse
        output.normal[i, 0], output.normal[i, 1], output.normal[i, 2] = n_x, n_y, n_z
        for k in range(3):
            output.log_roughness[i, k] = theta[2 + k]
            output.specular[i, k] = report[k]
            if base.has_diffuse:
                diffuse = diffuse_scale(scratch.moment, k, n_x, n_y, n_z, search.exponent)
                if search.sky > 0.0:
                    diffuse += search.sky * (diffuse_under_sky(scratch.moment, k, n_z) - diffuse)
                if strata.light > 0.0:
                    diffuse /= own_fresnel(scratch.moment, k, n_z)
                output.diffuse[i, k] = diffuse
        output.shape[i] = theta[5]
        output.status[i] = status
        output.residual[i] = report[RESIDUAL]
        output.evaluations[i] = min(report[EVALUATIONS], 65535)


class ModelKernels(NamedTuple):
    """Kernels of one pair of models, in the order ``fit_rows`` takes them."""

    tabulate: Any
    moments: Any
    values: Any
    log_normalisation: Any
    source_log_normalisation: Any


@cache
def model_kernels(
    source: str, target: str, float_width: int = 32, *, horizon: bool = True, turns: bool = True, stretches: bool = True
) -> ModelKernels:
    """Specialise the loops for a source and a target model, with sums in float32 or float64.

    Args:
        source, target: names of the models of the base and of the fitted level.
        float_width: 32 or 64.
        horizon: whether lobes end at their own horizon.
        turns, stretches: False for searches that hold the normal, or keep the lobe isotropic. A switch that is off
            removes its code from the kernels.
    """
    from brdffit.models import get_model

    source_model, target_model = get_model(source), get_model(target)
    kernels = ModelKernels(
        tabulate=_tabulate(source, float_width, horizon),
        moments=_moments(target, float_width, horizon, turns, stretches),
        values=_values(target, float_width, horizon),
        log_normalisation=target_model.log_normalisation,
        source_log_normalisation=source_model.log_normalisation,
    )
    _compile(kernels.log_normalisation, (types.float64,))
    _compile(kernels.source_log_normalisation, (types.float64,))
    return kernels


@cache
def _tabulate(model: str, float_width: int, horizon: bool) -> Any:
    made = _specialised(quadrature.tabulate, model, float_width, "profile", HORIZON=horizon)
    _compile(made, quadrature.tabulate_type(_floats(float_width)).signature.args)
    return made


@cache
def _moments(model: str, float_width: int, horizon: bool, turns: bool, stretches: bool) -> Any:
    switches = {"HORIZON": horizon, "TURNS": turns, "STRETCHES": stretches}
    made = _specialised(objective.moments, model, float_width, "profile_gradient", **switches)
    _compile(made, objective.moments_type(_floats(float_width)).signature.args)
    return made


@cache
def _values(model: str, float_width: int, horizon: bool) -> Any:
    made = _specialised(objective.lobe_values, model, float_width, "profile", HORIZON=horizon)
    _compile(made, objective.lobe_values_type(_floats(float_width)).signature.args)
    return made


def _specialised(template: Any, model: str, float_width: int, function: str, **switches: bool) -> Any:
    """``template`` with a model's function bound, and without the code of the switches that are off."""
    from brdffit.models import get_model

    real = np.float32 if float_width == 32 else np.float64
    off = [name for name, on in switches.items() if not on]
    suffix = "_".join(["", model.replace("-", "_"), str(float_width), *(f"no_{name.lower()}" for name in off)])
    bindings = {function: getattr(get_model(model), function), "real": real, **dict.fromkeys(off, False)}
    return specialise(template, suffix, **bindings)


def _floats(float_width: int) -> Any:
    return types.float32 if float_width == 32 else types.float64


def _compile(dispatcher: Any, arguments: tuple[Any, ...]) -> None:
    """Compile (or load) one signature, so that the function can be passed as a value of Numba's function type."""
    if arguments not in dispatcher.overloads:
        dispatcher.compile(arguments)


@cache
def fitting_kernel(float_width: int) -> Any:
    """``fit_rows`` for float32 or float64 sums, and what gathers its footprints.

    It takes the models' kernels as arguments of function type, so one compilation serves all models and can be cached
    on disk.
    """
    loop = fit_rows if float_width == 32 else specialise(fit_rows, "_64", real=np.float64)
    floats = types.float32 if float_width == 32 else types.float64
    data = [numba_type(value) for value in _example(float_width)]
    normalisation = objective.log_normalisation_type
    functions = [
        quadrature.tabulate_type(floats),
        objective.moments_type(floats),
        objective.lobe_values_type(floats),
        normalisation,
        normalisation,
    ]
    _compile(loop, (*data, *functions))
    loop.disable_compile()
    compile_footprints()
    return loop


def _example(float_width: int) -> tuple[Any, ...]:
    """Example arguments of ``fit_rows`` up to the functions; only their types are used."""
    base, level = example_base(), LevelRules(example_strata(), 1, POINT, ((lattice(2),),) * TIERS)
    search = Search(
        free=0, scale=FREE, scale_low=0.0, scale_high=0.0, energy=0.0, exponent=3, step=0.0, tolerance=0.0,
        iterations=0, log_low=0.0, log_high=0.0, shape_low=0.0, shape_high=0.0, same_model=True, trusted=0.0,
        negligible=0.0, crowd=0, floor=0.0, allowed=0.0, loss=0, dark=0.0, squares=0.0, within=0.0, sky=0.0,
        poor=0.0, rescaled=False, rendered=False, usual=0, cell=0.0, response=NO_RESPONSE,
    )  # fmt: skip
    indices = np.zeros(1, np.int64)
    place = make_workplace(level, float_width)
    return base, level.strata, indices, indices, search, *place, no_footprints(), make_output(1)


def make_workplace(
    level: LevelRules, float_width: int = 32, room: int | None = None
) -> tuple[Scratch, tuple[Table, ...]]:
    """The arrays of one worker; ``room``: most lobes of a footprint, if not that of the level's samples."""
    parameters, room = objective.PARAMETERS, (level.room if room is None else room) + 1 + GUARDS
    scratch = Scratch(
        lobes=np.zeros((len(level.lights), room, quadrature.LOBE_COLUMNS)),
        counts=np.zeros(len(level.lights), np.int64),
        cells=make_cells(room),
        space=make_space(),
        work=np.zeros(WORK),
        setting=np.zeros(objective.SETTINGS),
        theta=np.zeros(parameters),
        best=np.zeros(parameters),
        average=np.zeros(parameters),
        start=np.zeros(parameters),
        starts=np.zeros((STARTS, parameters)),
        colour=np.ones(3),
        moment=np.zeros(DIFFUSE_MOMENT),
        moments=np.zeros(MOMENTS),
        report=np.zeros(REPORT),
    )
    floats = np.float32 if float_width == 32 else np.float64
    return scratch, tuple(table_of(list(points), level.lights, floats) for points in level.points)


def make_output(texels: int) -> Output:
    """Output arrays of this many texels."""
    return Output(
        normal=np.zeros((texels, 3), np.float32),
        log_roughness=np.zeros((texels, 3), np.float32),
        specular=np.zeros((texels, 3), np.float32),
        diffuse=np.zeros((texels, 3), np.float32),
        shape=np.zeros(texels, np.float32),
        status=np.zeros(texels, np.uint8),
        residual=np.zeros(texels, np.float32),
        evaluations=np.zeros(texels, np.uint16),
    )


def cell_of(level: LevelRules, base: Base, search: Search) -> float:
    """Side of a cell of merged lobes on a level; 0 where lobes are not merged.

    Where a cell becomes the mean over its normals, not the nearest single lobe, and a footprint holds many, sides of
    1.5 instead of 1 change the displayed error by less than 0.05 dB and save a fifth of the time.
    """
    if not base.isotropic:
        return 0.0
    return search.cell * (_LARGER_CELLS if level.chain is not None and base.averages else 1.0)


def fit_texels(
    base: Base, level: LevelRules, columns: NDArray, rows: NDArray, search: Search, output: Output,
    kernels: ModelKernels, float_width: int = 32, footprints: Footprints | None = None,
) -> None:  # fmt: skip
    """Fit the texels (columns[i], rows[i]) of a level into ``output``. The loops release the GIL.

    ``footprints``: those of the texels where they are known; None: they are merged from finer levels if ``level`` has
    a chain, and gathered otherwise.
    """
    cell = cell_of(level, base, search)
    if footprints is None and level.chain is not None and cell > 0.0:
        footprints = footprints_of(base, level.chain, search.step, cell, columns, rows)
    scratch, rules = make_workplace(level, float_width, None if footprints is None else footprints.most)
    if footprints is None:
        footprints = no_footprints()
    loop, search = fitting_kernel(float_width), search._replace(cell=cell)
    loop(base, level.strata, columns, rows, search, scratch, rules, footprints, output, *kernels)
