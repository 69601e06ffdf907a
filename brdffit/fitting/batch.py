"""The compiled loop over texels, and what it needs of the models: kernels for one pair of source and target model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import kernel, numba_type, specialise, types
from brdffit.fitting.bfgs import WORK
from brdffit.fitting.status import CONVERGED, FALLBACK, REFINED
from brdffit.fitting.texel import (
    DISAGREEMENT,
    EVALUATIONS,
    FILTERED,
    REPORT,
    RESIDUAL,
    TOO_COARSE,
    Search,
    Workplace,
    fit_texel,
)
from brdffit.halfangle import objective, quadrature
from brdffit.halfangle.apparent_lobe import Base, Strata
from brdffit.halfangle.closed_forms import STARTS
from brdffit.halfangle.quadrature import lattice
from brdffit.models import Model

#: How many rules a texel may go through.
TIERS = 4


class Output(NamedTuple):
    """Arrays of a level that the loop fills; shapes as in ``Svbrdf`` and ``Level``."""

    normal: NDArray
    log_roughness: NDArray
    specular: NDArray
    diffuse: NDArray
    shape: NDArray
    status: NDArray
    residual: NDArray
    evaluations: NDArray


@dataclass(frozen=True)
class Rule:
    """One quadrature rule: strata of the footprint and nodes of the half-angle integral."""

    strata: Strata
    points: NDArray


@kernel
def diffuse_scale(moment, channel, n_x, n_y, n_z, exponent):
    """Diffuse albedo of one channel that fits sum_i w_i d_i (n_i.l) by d (n.l) in L2 over the light directions.

    d = g' G n / n' G n with g = sum_i w_i d_i n_i and G = E[l l'], diagonal: equal entries for uniform l (exponent 1),
    (1, 1, 2) / 4 for cosine-distributed l. Horizon clipping of single normals is left out: it has no closed form and
    matters only where normals lean over further than the light.
    """
    up = 2.0 if exponent == 3 else 1.0
    g_x, g_y, g_z = moment[3 * channel], moment[3 * channel + 1], moment[3 * channel + 2]
    return max((g_x * n_x + g_y * n_y + up * g_z * n_z) / (n_x * n_x + n_y * n_y + up * n_z * n_z), 0.0)


@kernel
def fit_rows(
    base, rules, columns, rows, search, output,
    tabulate_kernel, moments_kernel, values_kernel, log_normalisation, source_log_normalisation,
):  # fmt: skip
    """Fit the texels (columns[i], rows[i]) of a level into row i of the outputs (flattened over texels).

    Rules go from coarse to fine. A texel moves on where the strata are too coarse for its lobes, or where the two
    halves of the rule disagree by more than ``search.trusted`` of the residual (up to ``search.last_doubt``); one whose
    search fails, or whose result is not finite, gets its closed-form start.
    """
    moment = np.zeros(9)
    report = np.zeros(REPORT)
    for i in range(columns.size):
        evaluations = 0.0
        status = TOO_COARSE
        tier = 0
        while True:
            status = fit_texel(
                base, rules[tier], columns[i], rows[i], search, tier, tier == len(rules) - 1, moment, report,
                tabulate_kernel, moments_kernel, values_kernel, log_normalisation, source_log_normalisation,
            )  # fmt: skip
            evaluations += report[EVALUATIONS]
            doubtful = report[DISAGREEMENT] > search.trusted * report[RESIDUAL] + search.negligible
            if status == TOO_COARSE or (doubtful and tier < search.last_doubt):
                tier += 1
            else:
                break
        if status == CONVERGED and tier > 0:
            status = REFINED
        theta, best = rules[tier].theta, rules[tier].best
        total = 0.0
        for p in range(6):
            total += theta[p]
        if not math.isfinite(total + report[0] + report[1] + report[2]):
            status = FALLBACK
        if status == FALLBACK:
            for p in range(6):
                theta[p] = best[p]
            for k in range(3):
                report[k] = report[FILTERED + k]
        inverse = 1.0 / math.sqrt(1.0 + theta[0] * theta[0] + theta[1] * theta[1])
        n_x, n_y, n_z = -theta[0] * inverse, -theta[1] * inverse, inverse
        output.normal[i, 0], output.normal[i, 1], output.normal[i, 2] = n_x, n_y, n_z
        for k in range(3):
            output.log_roughness[i, k] = theta[2 + k]
            output.specular[i, k] = report[k]
            if base.has_diffuse:
                output.diffuse[i, k] = diffuse_scale(moment, k, n_x, n_y, n_z, search.exponent)
        output.shape[i] = theta[5]
        output.status[i] = status
        output.residual[i] = report[RESIDUAL]
        output.evaluations[i] = min(evaluations, 65535)


class ModelKernels(NamedTuple):
    """Kernels of one pair of models, in the order ``fit_rows`` takes them."""

    tabulate: Any
    moments: Any
    values: Any
    log_normalisation: Any
    source_log_normalisation: Any


@cache
def model_kernels(source: str, target: str, float_width: int = 32) -> ModelKernels:
    """Specialise the loops for a source and a target model, in float32 or float64 sums."""
    from brdffit.models import get_model

    source_model, target_model = get_model(source), get_model(target)
    real = np.float32 if float_width == 32 else np.float64
    floats = types.float32 if float_width == 32 else types.float64
    read, write = _suffix(source_model, float_width), _suffix(target_model, float_width)
    kernels = ModelKernels(
        tabulate=specialise(quadrature.tabulate, read, profile=source_model.profile, real=real),
        moments=specialise(objective.moments, write, profile_gradient=target_model.profile_gradient, real=real),
        values=specialise(objective.lobe_values, write, profile=target_model.profile, real=real),
        log_normalisation=target_model.log_normalisation,
        source_log_normalisation=source_model.log_normalisation,
    )
    _compile(kernels.log_normalisation, (types.float64,))
    _compile(kernels.source_log_normalisation, (types.float64,))
    _compile(kernels.tabulate, quadrature.tabulate_type(floats).signature.args)
    _compile(kernels.moments, objective.moments_type(floats).signature.args)
    _compile(kernels.values, objective.lobe_values_type(floats).signature.args)
    return kernels


def _compile(dispatcher: Any, arguments: tuple[Any, ...]) -> None:
    """Compile (or load) one signature, so that the function can be handed over as a value of function type."""
    if arguments not in dispatcher.overloads:
        dispatcher.compile(arguments)


def _suffix(model: Model, float_width: int) -> str:
    return f"_{model.name.replace('-', '_')}_{float_width}"


@cache
def fitting_kernel(float_width: int = 32) -> Any:
    """``fit_rows`` for float32 or float64 sums.

    Compiled for function-typed arguments: one compilation for all models, and it reaches the disk cache.
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
    return loop


def _example(float_width: int) -> tuple[Any, ...]:
    """Arguments of ``fit_rows`` up to the functions, for their types alone."""
    image, plane, line = np.zeros((1, 1, 3), np.float32), np.zeros((1, 1), np.float32), np.zeros(1)
    rule = make_workplace(Rule(Strata(line, line, line, line, 0.0, 0.0, 1.0, 1.0, 0), lattice(1)), float_width)
    base = Base(image, plane, image, image, image, plane, 0.0, True, False, False, False, True)
    search = Search(0, False, 3, 0.0, 0, 0, 0.0, 0.0, 0.0, 0.0, True, 0.0, 0.0, 0.0, 0)
    indices = np.zeros(1, np.int64)
    return base, (rule,) * TIERS, indices, indices, search, make_output(1)


def make_workplace(rule: Rule, float_width: int = 32) -> Workplace:
    """A rule with the scratch arrays of one worker."""
    count, nodes = rule.strata.samples, rule.points.shape[1]
    real = np.float32 if float_width == 32 else np.float64
    return Workplace(
        strata=rule.strata,
        points=rule.points,
        lobes=np.zeros((count + 1, quadrature.LOBE_COLUMNS)),
        nodes=np.zeros((quadrature.NODE_ROWS, nodes), real),
        values=np.zeros(nodes, real),
        work=np.zeros(WORK),
        setting=np.zeros(6),
        theta=np.zeros(objective.PARAMETERS),
        best=np.zeros(objective.PARAMETERS),
        start=np.zeros(objective.PARAMETERS),
        starts=np.zeros((STARTS, objective.PARAMETERS)),
        colour=np.ones(3),
    )


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


def fit_texels(
    base: Base, rules: tuple[Rule, ...], columns: NDArray, rows: NDArray, search: Search, output: Output,
    kernels: ModelKernels, float_width: int = 32,
) -> None:  # fmt: skip
    """Fit texels (columns[i], rows[i]) into ``output`` by TIERS rules, from coarse to fine; releases the GIL."""
    places = tuple(make_workplace(rule, float_width) for rule in rules)
    fitting_kernel(float_width)(base, places, columns, rows, search, output, *kernels)
