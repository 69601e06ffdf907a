"""Independent optimisers on the same objective, and the oracle: the best that a single lobe can do for each texel.

The oracle shows how far the fit stays from the best lobe, so it spends time that the fit cannot: one dense rule for
every texel (with a point set and jitter of its own, different from those of the fit and of the measure), many starts,
and two independent optimisers, NLopt's LD_LBFGS (Nocedal 1980) and SciPy's L-BFGS-B (Byrd et al. 1995).

Both search in scaled coordinates, theta = start + P z with P P' the inverse Hessian that our own search starts from,
and inside a box: without bounds LD_LBFGS sometimes stalls and reports success.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, NamedTuple

import nlopt
import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from brdffit._jit import numba_type, types
from brdffit.fitting.batch import ModelKernels
from brdffit.fitting.bfgs import FREE_ANISOTROPY, directions_of, first_inverse
from brdffit.fitting.scoring import REPORT, RESIDUAL, TARGET_NORM, aim, settle_scale, share_out, target_norm
from brdffit.fitting.search import Search
from brdffit.halfangle import objective, quadrature
from brdffit.halfangle.apparent_lobe import Base, Strata
from brdffit.halfangle.closed_forms import PEAK, STARTS, STEEPEST_SLOPE
from brdffit.halfangle.lights import BASE_BLUR, EVALUATION, POINT, evaluate_table, table_of
from brdffit.halfangle.measure import DENSE_ROOM, DENSE_SAMPLES, STARTS_AT, dense_strata, target_table
from brdffit.halfangle.objective import FREE, HELD, LOG_LOW, PARAMETERS, SETTINGS, SHAPE_HIGH
from brdffit.halfangle.quadrature import BLUE, GREEN, H_X, H_Y, H_Z, LOBE_COLUMNS, NODE_ROWS, RED, WEIGHT, lattice

ORACLE_NODES = 4096
_SHIFT, _SEED = (0.71, 0.411, 0.093), 77003
_RANDOM_STARTS = 4
_AIMS = 4
# The objective is a float32 sum of about -1: a smaller change is rounding.
_RESOLUTION = 1e-7
_MOST_EVALUATIONS = 400


class OracleFit(NamedTuple):
    """theta (n, 6), scale (n, 3), relative squared error by the oracle's own rule (n,), objective evaluations (n,)."""

    theta: NDArray
    scale: NDArray
    error: NDArray
    evaluations: NDArray


class Problem:
    """The objective of one footprint after another, on arrays that are allocated once.

    Args:
        strata, points: the rule.
        search: free parameters, bounds and density, as in the fit; the scale is always free.
        kernels: of the pair of models.
        lights: sizes of light (S, 3), see ``brdffit.halfangle.lights.Table``; each has all points.
    """

    def __init__(
        self, strata: Strata, points: NDArray, search: Search, kernels: ModelKernels, lights: NDArray = POINT
    ) -> None:
        self.search, self.kernels, self.strata, self.points = search, kernels, strata, points
        self.table = table_of([points] * len(lights), lights)
        self.sizes = [
            self.table.nodes[NODE_ROWS * a : NODE_ROWS * b].reshape(NODE_ROWS, b - a)
            for a, b in zip(self.table.first[:-1], self.table.first[1:], strict=True)
        ]
        self.nodes, self.values = self.sizes[0], self.table.values[: points.shape[1]]
        self.lobes = np.zeros((DENSE_ROOM * strata.samples + 1, LOBE_COLUMNS))
        self.work, self.scratch, self.report = np.zeros(64), np.zeros(EVALUATION), np.zeros(REPORT)
        self.gradient, self.inverse = np.zeros(PARAMETERS), np.zeros((PARAMETERS, PARAMETERS))
        self.setting = np.zeros(SETTINGS)
        self.setting[LOG_LOW : SHAPE_HIGH + 1] = search.log_low, search.log_high, search.shape_low, search.shape_high
        self.evaluations = 0
        self._base: Base | None = None
        self._tabulate: Callable | None = None

    # Compiled for these very functions, which no cache keeps: seconds for each model, where they are called. Passing a
    # value of function type would cost 150 microseconds a call.
    @cached_property
    def _evaluate(self) -> Callable:
        return compiled(
            evaluate_table, (self.gradient, self.table, self.setting, self.kernels.moments,
                             self.kernels.log_normalisation, self.gradient, self.scratch),
        )  # fmt: skip

    @cached_property
    def _settle(self) -> Callable:
        return compiled(
            settle_scale, (self.gradient, self.table, self.setting, self.kernels.values,
                           self.kernels.log_normalisation, self.search.exponent, self.work, self.report),
        )  # fmt: skip

    def set_footprint(self, base: Base, column: int, row: int) -> NDArray:
        """Tabulate the target of one texel; returns its closed-form starts (STARTS, 6)."""
        if self._tabulate is None or base is not self._base:
            data = (base, self.strata, self.points, 0, 0, self.search.exponent, 0.0, self.lobes, self.nodes, self.work)
            functions = (quadrature.tabulate_type(types.float32), objective.log_normalisation_type)
            self._tabulate, self._base = compiled(target_table, data, functions), base
        for s, nodes in enumerate(self.sizes):
            red, green, blue, norm = self._tabulate(
                base, self.strata, self.points, int(column), int(row), self.search.exponent,
                float(self.table.lights[s, BASE_BLUR]), self.lobes, nodes, self.work, self.kernels.tabulate,
                self.kernels.source_log_normalisation,
            )  # fmt: skip
            if s == 0:
                starts = self.work[STARTS_AT : STARTS_AT + STARTS * PARAMETERS].reshape(STARTS, PARAMETERS).copy()
        share_out(self.table)
        self.report[TARGET_NORM] = norm if len(self.sizes) == 1 else target_norm(self.table)
        self.set_colour(np.array([red, green, blue]))
        smallest = float(self.table.lights[0, BASE_BLUR])
        if smallest > 0.0:
            # Starts are lobes before any light widens them.
            for start in starts:
                values, vectors = np.linalg.eigh([[start[2], start[4]], [start[4], start[3]]])
                values = np.log(np.maximum(np.exp(values) - smallest, math.exp(self.search.log_low)))
                tensor = (vectors * values) @ vectors.T
                start[2:5] = tensor[0, 0], tensor[1, 1], tensor[0, 1]
        top = int(np.argmax(np.where(self.nodes[WEIGHT] > 0.0, self.nodes[[RED, GREEN, BLUE]].sum(axis=0), 0.0)))
        h_x, h_y, h_z = self.nodes[[H_X, H_Y, H_Z], top]
        if h_z > 1.0 / STEEPEST_SLOPE:
            starts[PEAK, 0:2] = -h_x / h_z, -h_y / h_z
        return starts

    def set_colour(self, colour: NDArray) -> None:
        """Set the scalar target for the direction of a colour (white where the colour is black)."""
        colour = np.maximum(colour, 0.0)
        self.colour = colour if colour.sum() > 0.0 else np.ones(3)
        self.setting[HELD] = FREE
        aim(self.table, self.colour, self.report[TARGET_NORM], self.setting)

    def value(self, theta: NDArray) -> float:
        """Relative squared error - 1, with walls; infinite where it is not finite. Updates ``gradient`` (6,)."""
        self.evaluations += 1
        value = self._evaluate(
            theta, self.table, self.setting, self.kernels.moments, self.kernels.log_normalisation, self.gradient,
            self.scratch,
        )  # fmt: skip
        return value if math.isfinite(value) else math.inf

    def settle(self, theta: NDArray) -> tuple[float, NDArray]:
        """Relative squared error and best scale (3,) of a lobe that lies within its bounds."""
        self._settle(
            theta, self.table, self.setting, self.kernels.values, self.kernels.log_normalisation,
            self.search.exponent, self.work, self.report,
        )  # fmt: skip
        return float(self.report[RESIDUAL]), self.report[0:3].copy()

    def scaled(self, start: NDArray) -> tuple[NDArray, NDArray]:
        """Columns P (6, k) of the scaled coordinates around ``start``, and the bounds (k,) of |z|."""
        first_inverse(start, self.search.free, self.inverse)
        squares, directions = np.linalg.eigh(self.inverse)
        # Directions that are not free have eigenvalue 0; eigenvalues are in ascending order.
        held = PARAMETERS - directions_of(self.search.free)
        columns = directions[:, held:] * np.sqrt(squares[held:])
        reach = np.array([2.0 * STEEPEST_SLOPE, 2.0 * STEEPEST_SLOPE, 30.0, 30.0, 30.0, 30.0])
        with np.errstate(divide="ignore"):
            return columns, np.min(reach[:, None] / np.abs(columns), axis=0)

    def clamped(self, theta: NDArray) -> NDArray:
        """A copy with log eigenvalues and shape within their bounds, and isotropic where the search is."""
        theta = np.array(theta, dtype=np.float64)
        if not self.search.free & FREE_ANISOTROPY:
            theta[2:5] = 0.5 * (theta[2] + theta[3]), 0.5 * (theta[2] + theta[3]), 0.0
        eigenvalues, vectors = np.linalg.eigh([[theta[2], theta[4]], [theta[4], theta[3]]])
        low, high = self.search.log_low, self.search.log_high
        if eigenvalues[0] < low or eigenvalues[1] > high:
            tensor = (vectors * np.clip(eigenvalues, low, high)) @ vectors.T
            theta[2:5] = tensor[0, 0], tensor[1, 1], tensor[0, 1]
        theta[5] = np.clip(theta[5], self.search.shape_low, self.search.shape_high)
        return theta


def compiled(kernel: Any, data: tuple, functions: tuple = ()) -> Callable:
    """The compiled function for arguments like ``data`` (and ``functions`` of these types), without dispatch a call."""
    signature = (*map(numba_type, data), *functions)
    if signature not in kernel.overloads:
        # Saving to a cache that names functions of another process may fail; the function is compiled all the same.
        with contextlib.suppress(ReferenceError):
            kernel.compile(signature)
    return kernel.get_overload(signature)


def solve_nlopt(problem: Problem, start: NDArray) -> NDArray:
    """theta (6,) where NLopt's LD_LBFGS ends."""
    return descend_by_nlopt(problem, start, nlopt.LD_LBFGS)


def descend_by_nlopt(
    problem: Problem, start: NDArray, algorithm: int, most: int = _MOST_EVALUATIONS, reach: float = math.inf
) -> NDArray:
    """The best theta (6,) that an algorithm of NLopt visits within ``most`` evaluations and |z| <= ``reach``."""
    columns, limit = problem.scaled(start)
    limit = np.minimum(limit, reach)

    def objective_of(z: NDArray, gradient: NDArray) -> float:
        value = problem.value(start + columns @ z)
        if gradient.size:
            gradient[:] = problem.gradient @ columns
        if value < best[0]:
            best[0], best[1] = value, z.copy()
        return float(value)

    best: list[Any] = [math.inf, np.zeros(len(limit))]
    solver = nlopt.opt(algorithm, len(limit))
    solver.set_min_objective(objective_of)
    solver.set_lower_bounds(-limit)
    solver.set_upper_bounds(limit)
    solver.set_ftol_abs(_RESOLUTION)
    solver.set_maxeval(most)
    try:
        solver.optimize(np.zeros(len(limit)))
    except (nlopt.runtime_error, RuntimeError, ValueError):
        pass  # A line search that fails in rounding: ``best`` holds the result so far.
    return start + columns @ best[1]


def solve_scipy(problem: Problem, start: NDArray) -> NDArray:
    """theta (6,) where SciPy's L-BFGS-B ends."""
    columns, reach = problem.scaled(start)

    def objective_of(z: NDArray) -> tuple[float, NDArray]:
        value = problem.value(start + columns @ z)
        return min(value, 1e6), problem.gradient @ columns

    end = optimize.minimize(
        objective_of, np.zeros(len(reach)), jac=True, method="L-BFGS-B", bounds=list(zip(-reach, reach, strict=True)),
        options={"ftol": _RESOLUTION, "gtol": 1e-6, "maxfun": _MOST_EVALUATIONS},
    )  # fmt: skip
    return start + columns @ end.x


SOLVERS: dict[str, Callable[[Problem, NDArray], NDArray]] = {"nlopt": solve_nlopt, "scipy": solve_scipy}


def oracle(
    base: Base,
    base_size: tuple[int, int],
    level_size: tuple[int, int],
    columns: NDArray,
    rows: NDArray,
    *,
    search: Search,
    kernels: ModelKernels,
    pixel_filter: str = "box",
    lights: NDArray = POINT,
    given: NDArray | None = None,
    nodes: int = ORACLE_NODES,
    samples: tuple[int, int] = DENSE_SAMPLES,
    solvers: tuple[str, ...] = ("nlopt", "scipy"),
    threads: int = 2,
) -> OracleFit:
    """The best single lobes of n texels, scale free, that many starts and two optimisers can find.

    Args:
        base, base_size: of the set. level_size: (height, width). columns, rows: texels of the level, (n,) int64.
        search: free parameters, bounds and density exponent, as in the fit (its ``scale`` is ignored: it is free).
        lights: sizes of light, as ``Problem`` takes them.
        given: (M, n, 6) further lobes to start from; by the oracle's own rule the result is never worse than any.
        nodes, samples: of the dense rule. solvers: the first runs from all starts, the others from the two best ends.
        threads: the tables, most of the cost, release the GIL. The result does not depend on it.
    """
    strata = dense_strata(base_size, level_size, pixel_filter, samples)._replace(seed=_SEED)
    points = lattice(nodes, _SHIFT)
    count = len(columns)
    given = np.zeros((0, count, PARAMETERS)) if given is None else np.asarray(given, np.float64)
    found = OracleFit(np.zeros((count, PARAMETERS)), np.zeros((count, 3)), np.zeros(count), np.zeros(count, np.int64))

    def work(part: NDArray) -> None:
        problem = Problem(strata, points, search, kernels, lights)
        for i in part:
            problem.evaluations = 0
            starts = problem.set_footprint(base, columns[i], rows[i])
            noise = np.random.default_rng((_SEED, int(columns[i]), int(rows[i])))
            theta, scale, error = _best(problem, [*given[:, i], *starts], solvers, noise)
            found.theta[i], found.scale[i], found.error[i] = theta, scale, error
            found.evaluations[i] = problem.evaluations

    parts = [np.arange(first, count, threads) for first in range(threads)]
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, parts))
    return found


def _best(
    problem: Problem, starts: list[NDArray], solvers: tuple[str, ...], noise: np.random.Generator
) -> tuple[NDArray, NDArray, float]:
    """Best (theta, scale, error) from all starts and random neighbours, repeated until the target's colour settles."""
    starts = [problem.clamped(start) for start in starts]
    if not problem.report[TARGET_NORM] > 0.0:
        return starts[0], np.zeros(3), 0.0
    starts.sort(key=problem.value)
    for k in range(_RANDOM_STARTS):
        # Neighbours of the better half of the starts: turned by about a lobe's width, a few times wider or narrower.
        centre = starts[k % max(1, len(starts) // 2)]
        columns, _ = problem.scaled(centre)
        starts.append(problem.clamped(centre + columns @ noise.normal(0.0, 1.0, columns.shape[1])))
    first, *others = [SOLVERS[name] for name in solvers]
    ends = [*starts, *(first(problem, start) for start in starts)]
    ends = sorted((problem.clamped(end) for end in ends), key=problem.value)
    ends += [problem.clamped(solver(problem, start)) for solver in others for start in ends[:2]]
    theta = min(ends, key=lambda end: problem.settle(end)[0])
    error, scale = problem.settle(theta)
    for _ in range(_AIMS):
        colour = problem.colour
        if np.dot(scale, colour) ** 2 >= 0.99999 * np.dot(scale, scale) * np.dot(colour, colour):
            break
        problem.set_colour(scale)
        again = [problem.clamped(SOLVERS[name](problem, theta)) for name in solvers]
        closer = min(again, key=lambda end: problem.settle(end)[0])
        closer_error, closer_scale = problem.settle(closer)
        if not closer_error < error:
            break
        theta, error, scale = closer, closer_error, closer_scale
    return theta, scale, error
