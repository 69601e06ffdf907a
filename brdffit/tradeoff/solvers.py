"""Optimisers on one objective with one table a texel: the time of each, and its distance from the best result."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import nlopt
import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from brdffit.fitting.bfgs import make_space, minimise
from brdffit.fitting.method import search_settings
from brdffit.fitting.presets import get_quality
from brdffit.fitting.rules import level_rules
from brdffit.fitting.sampling import LevelSample
from brdffit.fitting.solvers import Problem, compiled, descend_by_nlopt, solve_nlopt, solve_scipy
from brdffit.footprint import get_pixel_filter
from brdffit.halfangle.closed_forms import LEAN
from brdffit.halfangle.quadrature import BLUE, RED, WEIGHT, lattice
from brdffit.tradeoff.record import Solver

#: Levels whose texels are used, and nodes of the common table.
SOLVER_LEVELS = (1, 3)
_NODES = 320
#: Evaluations of the global search, and its range in search steps.
_GLOBAL_EVALUATIONS, _GLOBAL_REACH = 1500, 4.0
#: Relative squared error of the start below which a texel is skipped: there is nothing left to optimise.
_STEPS_OF_DIFFERENCE = 1e-5

Solve = Callable[[Problem, NDArray], NDArray]

_COMPILED: dict[int, Callable] = {}


def solve_ours(problem: Problem, start: NDArray) -> NDArray:
    """theta (6,) where the compiled BFGS of the bake ends."""
    search, kernels = problem.search, problem.kernels
    theta, space = start.copy(), make_space()
    value = problem.value(theta)
    space.gradient[:] = problem.gradient
    arguments = (
        theta, float(value), search.free, problem.table, problem.setting, kernels.moments, kernels.log_normalisation,
        search.tolerance, 0.0, search.iterations, search.rescaled, space, math.inf,
    )  # fmt: skip
    # Compiled and looked up once: typing the arguments takes far longer than the search.
    run = _COMPILED.get(id(kernels.moments)) or _COMPILED.setdefault(id(kernels.moments), compiled(minimise, arguments))
    _, evaluations, _ = run(*arguments)
    problem.evaluations += evaluations
    return theta


def solve_slsqp(problem: Problem, start: NDArray) -> NDArray:
    """theta (6,) where NLopt's sequential quadratic programming ends."""
    return descend_by_nlopt(problem, start, nlopt.LD_SLSQP)


def solve_global(problem: Problem, start: NDArray) -> NDArray:
    """theta (6,) of NLopt's controlled random search, then SLSQP from where it ends."""
    nlopt.srand(1)
    return solve_slsqp(problem, descend_by_nlopt(problem, start, nlopt.GN_CRS2_LM, _GLOBAL_EVALUATIONS, _GLOBAL_REACH))


def solve_scipy_bfgs(problem: Problem, start: NDArray) -> NDArray:
    """theta (6,) where SciPy's BFGS ends."""
    columns, _ = problem.scaled(start)

    def objective(z: NDArray) -> tuple[float, NDArray]:
        value = problem.value(start + columns @ z)
        return min(value, 1e6), problem.gradient @ columns

    end = optimize.minimize(objective, np.zeros(columns.shape[1]), jac=True, method="BFGS", options={"gtol": 1e-6})
    return start + columns @ end.x


def solve_least_squares(problem: Problem, start: NDArray) -> NDArray:
    """theta (6,) where Levenberg and Marquardt's damped Gauss-Newton steps end (SciPy's least_squares).

    Its residuals are those of the lobe at its best scale (variable projection). Their derivatives are finite
    differences, since the kernels give only the derivatives of the sum.
    """
    columns, _ = problem.scaled(start)
    root = np.sqrt(problem.nodes[WEIGHT].astype(np.float64))
    target = problem.nodes[RED : BLUE + 1].astype(np.float64)

    def residuals(z: NDArray) -> NDArray:
        _, scale = problem.settle(problem.clamped(start + columns @ (z - 1.0)))
        problem.evaluations += 1
        return (root * (target - scale[:, None] * problem.values)).ravel() / norm

    norm = math.sqrt(max(float(np.sum(root**2 * target**2)), 1e-30))
    # Difference steps are relative to the variables, which lie around 1 so that steps exceed the noise of float32 sums.
    end = optimize.least_squares(residuals, np.ones(columns.shape[1]), method="lm", diff_step=1e-3, ftol=1e-7)
    return start + columns @ (end.x - 1.0)


SOLVERS: dict[str, Solve] = {
    "ours: BFGS, compiled": solve_ours,
    "NLopt LD_LBFGS, bounded": solve_nlopt,
    "NLopt LD_SLSQP": solve_slsqp,
    "NLopt CRS2, then SLSQP": solve_global,
    "SciPy L-BFGS-B": solve_scipy,
    "SciPy BFGS": solve_scipy_bfgs,
    "SciPy least_squares (LM)": solve_least_squares,
}


def race(name: str, samples: Sequence[LevelSample]) -> list[Solver]:
    """Every optimiser on every texel of the samples, from the same closed-form start on the same table."""
    spent = dict.fromkeys(SOLVERS, 0.0)
    evaluations = dict.fromkeys(SOLVERS, 0)
    errors: dict[str, list[float]] = {solver: [] for solver in SOLVERS}
    for sample in samples:
        quality = get_quality("standard")
        rules = level_rules(
            get_pixel_filter(sample.options.pixel_filter), sample.base_size, sample.size, sample.mip_level, quality
        )
        search = search_settings(sample.options, quality, sample.base, sample.source, sample.target)
        problem = Problem(rules.strata, lattice(_NODES), search, sample.kernels())
        for column, row in zip(sample.columns, sample.rows, strict=True):
            start = problem.clamped(problem.set_footprint(sample.base, int(column), int(row))[LEAN])
            if problem.settle(start)[0] < _STEPS_OF_DIFFERENCE:
                continue
            if not errors[next(iter(SOLVERS))]:
                solve_ours(problem, start)  # compiles
            for solver, solve in SOLVERS.items():
                problem.evaluations = 0
                begin = time.perf_counter()
                end = problem.clamped(solve(problem, start))
                spent[solver] += time.perf_counter() - begin
                evaluations[solver] += problem.evaluations
                errors[solver].append(min(problem.settle(end)[0], problem.settle(start)[0]))
    found = np.array(list(errors.values()))
    count = found.shape[1]
    if count == 0:
        return []
    best = np.maximum(found.min(axis=0), 1e-12)
    return [
        Solver(
            set=name,
            name=solver,
            milliseconds=1e3 * spent[solver] / count,
            behind_db=10.0 * math.log10(float(found[k].mean() / best.mean())),
            worst_db=10.0 * math.log10(float(np.max(found[k] / best))),
            evaluations=evaluations[solver] / count,
        )
        for k, solver in enumerate(SOLVERS)
    ]
