"""The error under lights with a size that the default fit minimises: measured densely, and its least.

The half-angle error of the fit (``brdffit.halfangle.lights``) weighted as a screen shows it, with a share of the
squared error from afar (``brdffit.fitting.losses``, BALANCED), by a rule with more nodes and other samples than any fit
has.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.fitting.losses import add_squares, balance_of, weigh_as_seen
from brdffit.fitting.method import search_settings
from brdffit.fitting.presets import quality_of
from brdffit.fitting.sampling import LevelSample, Lobes
from brdffit.fitting.scoring import TARGET_NORM, share_out, target_norm
from brdffit.fitting.solvers import Problem, solve_nlopt
from brdffit.halfangle.apparent_lobe import DIFFUSE_MOMENT
from brdffit.halfangle.lights import sizes_of
from brdffit.halfangle.measure import dense_strata
from brdffit.halfangle.objective import HELD, HOLDS
from brdffit.halfangle.quadrature import lattice

#: The lights that all are judged under: those of the default fit.
LIGHTS = "mixed"
_SHIFT, _MOMENT = (0.31, 0.617, 0.283), 9


class Rule(NamedTuple):
    """Nodes for each size of light, and least and most samples of a footprint along an axis."""

    nodes: int
    samples: tuple[int, int]


def errors(sample: LevelSample, versions: Sequence[Lobes], rule: Rule) -> tuple[NDArray, NDArray]:
    """Error, and scale over filtered colour, (M, n) each, of M versions of the lobes of n texels."""
    error, energy = np.zeros((2, len(versions), len(sample)))

    def measure(i: int, problem: Problem, _: NDArray) -> None:
        whole = problem.colour.sum()
        problem.setting[HELD] = HOLDS
        for m, version in enumerate(versions):
            problem.report[:3] = version.scale[i]
            error[m, i] = problem.settle(version.theta[i])[0]
            energy[m, i] = version.scale[i].sum() / whole

    energy[:] = 1.0
    _at_each_texel(sample, rule, measure)
    return error, energy


def best(sample: LevelSample, given: Sequence[Lobes], rule: Rule) -> Lobes:
    """The best lobes, with a free scale, that NLopt finds from given lobes and all closed forms."""
    found = Lobes(np.zeros((len(sample), 6)), np.zeros((len(sample), 3)))

    def search(i: int, problem: Problem, starts: NDArray) -> None:
        problem.set_colour(problem.colour)
        begins = [problem.clamped(start) for start in (*(lobes.theta[i] for lobes in given), *starts)]
        ends = [*begins, *(problem.clamped(solve_nlopt(problem, begin)) for begin in begins)]
        found.theta[i] = min(ends, key=lambda end: problem.settle(end)[0])
        _, found.scale[i] = problem.settle(found.theta[i])

    _at_each_texel(sample, rule, search)
    return found


def _at_each_texel(sample: LevelSample, rule: Rule, work: Callable[[int, Problem, NDArray], None]) -> None:
    """``work(i, problem, starts)`` for each texel that reflects anything, on threads (tables release the GIL)."""
    options = sample.options
    search = search_settings(options, quality_of(options), sample.base, sample.source, sample.target)
    strata = dense_strata(sample.base_size, sample.size, options.pixel_filter, rule.samples)
    lights = sizes_of(LIGHTS, sample.source.blur, sample.target.blur)
    dark, squares = balance_of("balanced", sample.mip_level)

    def run(texels: Iterator[int]) -> None:
        problem = Problem(strata, lattice(rule.nodes, _SHIFT), search, sample.kernels(), lights)
        for i in texels:
            starts = problem.set_footprint(sample.base, int(sample.columns[i]), int(sample.rows[i]))
            for nodes in problem.sizes:
                weigh_as_seen(nodes, problem.work[_MOMENT : _MOMENT + DIFFUSE_MOMENT], True, dark)
                if squares > 0.0:
                    add_squares(nodes, squares)
            share_out(problem.table)
            problem.report[TARGET_NORM] = norm = target_norm(problem.table)
            if norm > 0.0:
                work(i, problem, starts)

    with ThreadPoolExecutor(sample.threads) as pool:
        list(pool.map(run, [iter(range(k, len(sample), sample.threads)) for k in range(sample.threads)]))
