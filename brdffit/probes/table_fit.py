"""Optimise a table (Manson and Sloan 2016, section 6): sampled starts, annealed L1, L-BFGS with adjoint gradients.

A level is searched in rounds. Many starts are optimised under a symmetry (``table_symmetry``) on few texels with a wide
smoothing; the best quarter continues with narrower ones; the best two are polished on more texels, then once more
without the symmetry. The smoothing e of |d| ~ sqrt(d^2 + e^2) is a fraction of the energy-weighted mean of B. The seed
decides everything. The error that is reported is measured on texels drawn by another seed, and on all of a small level.

``paper=True`` follows the paper instead: one importance-sampled start without symmetry, BFGS with gradients by
differences and golden-section line searches, on the L1 itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from brdffit.probes.lobe import half_angles
from brdffit.probes.table_symmetry import SYMMETRIES, fold, free_taps, orbits, unfold
from brdffit.probes.tables import BASE_SIZE, TERMS, Goal, texels_of

#: Smoothing as a fraction of the energy-weighted mean of B, and iterations, of each round.
_SEARCH = ((0.1, 80), (0.03, 80))
_DEEPEN = ((0.01, 120), (0.003, 120), (0.001, 150))
_POLISH = ((0.001, 200), (0.0003, 250))
#: Mean number of frames that a texel reads: on 36 of the 64 tiles of a face two frames overlap, on 28 three.
_FRAMES = 39.0 / 16.0
#: Texels that the reported error is measured on.
HELD_OUT = 384


@dataclass(frozen=True)
class TableRequest:
    """Size of a table and effort of its search.

    Attributes:
        taps: trilinear reads of each frame.
        terms: polynomials of the parameters, "const", "quadratic" or "quartic".
        starts: importance-sampled starts for each level.
        texels: texels that a search minimises the error of.
        seed: of starts and texels.
        paper: use the paper's own optimiser.
    """

    taps: int
    terms: str
    starts: int = 48
    texels: int = 32
    seed: int = 0
    paper: bool = False


class TableLevel(NamedTuple):
    """The table of one level and the record of its search.

    Attributes:
        table: (5, terms, 3 taps).
        size: texels along a face.
        error: mean L1 of the preimage on held-out texels.
        seconds: processor time.
        history: (seconds, error on the searched texels, name of the step) of each step.
    """

    table: NDArray
    size: int
    error: float
    seconds: float
    history: list[tuple[float, float, str]]


def importance_start(taps: int, count: int, alpha: float, rng: np.random.Generator) -> NDArray:
    """(5, 1, count) taps drawn from D, stratified and jittered.

    For v = n the direction l has the density D/4, so that each of M samples stands for the solid angle 4 / (M D), from
    which its level follows. M is the mean number of taps of a texel when a frame has ``taps`` of them.
    """
    u = (np.arange(count) + rng.random(count)) / count
    turn = 2.0 * np.pi * (np.arange(count) * 0.6180339887 + rng.random())
    all_taps = _FRAMES * taps
    # Within 45 degrees of the half vector from the normal, l is above the horizon.
    top = 1.0 / (1.0 + alpha * alpha)
    half, density = half_angles(u * top, alpha)
    cosine = np.cos(2.0 * half)
    angle = 4.0 * top / (all_taps * density)
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    level = 0.5 * np.log2(angle / (4.0 / BASE_SIZE**2)) + rng.uniform(-0.5, 0.5, count)
    weight = np.maximum(cosine, 0.05)
    rows = [sine * np.cos(turn), sine * np.sin(turn), np.maximum(cosine, 0.02), np.clip(level, 0.0, 6.5), weight]
    return np.stack(rows)[:, None, :]


def chosen_texels(n: int, symmetry: str, count: int, seed: int) -> tuple[NDArray, NDArray]:
    """At most ``count`` texels (T, 3: face, u, v) of a level of n^2, one for each orbit, and their weights (T,)."""
    texels, share = orbits(texels_of(n), symmetry)
    if len(texels) > count:
        rng = np.random.default_rng([seed, n])
        pick = rng.choice(len(texels), count, replace=False, p=share / share.sum())
        # They were drawn with probability proportional to their orbits, so their weights are equal.
        return np.ascontiguousarray(texels[pick]), np.ones(count)
    return np.ascontiguousarray(texels), share


def held_out_goal(n: int, alpha: float) -> Goal:
    """The texels that errors are reported on: all of a small level, else HELD_OUT of them, drawn by a fixed seed."""
    texels, _ = chosen_texels(n, "none", HELD_OUT, 987_654)
    return Goal.of(texels, alpha)


class LevelSearch:
    """The search for the table of one level.

    Args:
        n: texels along a face of the level.
        alpha: roughness alpha of its lobe; 1 for irradiance.
        request: taps, terms and effort.
        starts_from: additional starts, tables (5, at most as many terms, 3 taps).
        listener: called with a line for each step.
    """

    def __init__(
        self, n: int, alpha: float, request: TableRequest, starts_from: list[NDArray] | None = None,
        listener: Callable[[str], None] | None = None,
    ) -> None:  # fmt: skip
        self._n, self._alpha, self._request = n, alpha, request
        self._given = [self._with_terms(table) for table in starts_from or []]
        self._listener = listener or (lambda text: None)
        self._began = time.process_time()
        self._history: list[tuple[float, float, str]] = []
        self._best = np.inf

    def run(self) -> TableLevel:
        """Search, and measure the result on held-out texels."""
        best = self._as_the_paper() if self._request.paper else self._search()
        seconds = time.process_time() - self._began
        error = held_out_goal(self._n, self._alpha).error(best)
        return TableLevel(best, self._n, error, seconds, self._history)

    def _search(self) -> NDArray:
        request = self._request
        # While searching, rough lobes are compared on a base of half the size, in a quarter of the time.
        base = 1 if self._n <= 16 else 0
        kinds = ["mirror", "axes"] if request.taps % 2 == 0 else ["axes"]
        found: list[tuple[float, str, NDArray]] = []
        for symmetry in kinds:
            goal = self._goal(symmetry, request.texels, base)
            tries = []
            for start in range(request.starts // len(kinds)):
                rng = np.random.default_rng([request.seed, self._n, start, SYMMETRIES.index(symmetry)])
                free = importance_start(request.taps, free_taps(symmetry, request.taps), self._alpha, rng)
                tries.append(self._optimise(goal, self._with_terms(free), symmetry, _SEARCH))
                self._note(goal, tries[-1], symmetry, f"start {start} {symmetry}")
            tries.sort(key=lambda free: goal.error(unfold(free, symmetry)))
            for free in tries[: max(len(tries) // 4, 1)]:
                free = self._optimise(goal, free, symmetry, _DEEPEN)
                self._note(goal, free, symmetry, f"deepened {symmetry}")
                found.append((goal.error(unfold(free, symmetry)), symmetry, free))
        found.sort(key=lambda each: each[0])
        polished = [(symmetry, free) for _, symmetry, free in found[:2]]
        polished += [("none", table) for table in self._given]
        goal = self._goal("none", 3 * request.texels, 0)
        ends = []
        for symmetry, free in polished:
            if symmetry != "none":
                tied = self._goal(symmetry, 2 * request.texels, 0)
                free = self._optimise(tied, free, symmetry, _POLISH)
                ends.append(unfold(free, symmetry))
                self._note(goal, ends[-1], "none", f"polished {symmetry}")
            ends.append(self._optimise(goal, unfold(free, symmetry), "none", _POLISH))
            self._note(goal, ends[-1], "none", "freed")
        # Choose on other texels: without the symmetry a table may overfit those that were searched.
        judge = self._goal("none", 4 * request.texels, 0, seed=self._request.seed + 1)
        return min(ends, key=judge.error)

    def _goal(self, symmetry: str, count: int, base: int, seed: int | None = None) -> Goal:
        texels, share = chosen_texels(self._n, symmetry, count, self._request.seed if seed is None else seed)
        return Goal.of(texels, self._alpha, share, base)

    def _with_terms(self, free: NDArray) -> NDArray:
        out = np.zeros((5, TERMS[self._request.terms], free.shape[2]))
        out[:, : free.shape[1]] = free
        return out

    def _optimise(self, goal: Goal, free: NDArray, symmetry: str, rounds: tuple[tuple[float, int], ...]) -> NDArray:
        wanted = goal.wanted.astype(np.float64)
        scale = float(goal.shares @ np.einsum("qt,qt->q", wanted, wanted))
        shape = free.shape
        for fraction, iterations in rounds:

            def objective(x: NDArray, smoothing: float = fraction * scale) -> tuple[float, NDArray]:
                error, gradient = goal.error_and_gradient(unfold(x.reshape(shape), symmetry), smoothing)
                return error, fold(gradient, symmetry).ravel()

            options = {"maxcor": 30, "maxiter": iterations, "maxfun": 2 * iterations, "ftol": 1e-7, "gtol": 1e-10}
            free = minimize(objective, free.ravel(), jac=True, method="L-BFGS-B", options=options).x.reshape(shape)
        return free

    def _note(self, goal: Goal, free: NDArray, symmetry: str, what: str) -> None:
        error = goal.error(unfold(free, symmetry))
        self._best = min(self._best, error)
        seconds = time.process_time() - self._began
        self._history.append((round(seconds, 2), round(error, 5), what))
        self._listener(f"{self._n}x{self._n}: {what}: {error:.4f}, best {self._best:.4f}, {seconds:.0f} s")

    def _as_the_paper(self) -> NDArray:
        """The paper's optimiser: BFGS, golden-section line searches, gradients by forward differences, one start."""
        rng = np.random.default_rng([self._request.seed, self._n])
        start = importance_start(self._request.taps, 3 * self._request.taps, self._alpha, rng)
        table = self._with_terms(start)
        goal = self._goal("none", self._request.texels, 0)
        shape, x, size = table.shape, table.ravel(), table.size
        inverse, error, slope = np.eye(size), goal.error(table), np.zeros(size)

        def gradient(x: NDArray, at: float, step: float = 1e-5) -> NDArray:
            moved = (goal.error((x + step * unit).reshape(shape)) for unit in np.eye(size))
            return (np.fromiter(moved, np.float64, size) - at) / step

        slope = gradient(x, error)
        for iteration in range(60):
            way = -inverse @ slope

            def along(t: float, x: NDArray = x, way: NDArray = way) -> float:
                return goal.error((x + t * way).reshape(shape))

            reach = 2.0 * min(1.0, 0.5 / max(float(np.abs(way).max()), 1e-12))
            found = minimize_scalar(along, bracket=(0.0, 0.5 * reach), method="golden", options={"maxiter": 30})
            if found.fun >= error - 1e-7:
                break
            moved = x + found.x * way
            fresh = gradient(moved, found.fun)
            s, y = moved - x, fresh - slope
            if s @ y > 1e-12:
                rho = 1.0 / (s @ y)
                left = np.eye(size) - rho * np.outer(s, y)
                inverse = left @ inverse @ left.T + rho * np.outer(s, s)
            x, error, slope = moved, found.fun, fresh
            self._note(goal, x.reshape(shape), "none", f"iteration {iteration}")
        return x.reshape(shape)
