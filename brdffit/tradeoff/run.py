"""Measure every candidate on the same texels: seconds, and the error on a screen."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import BrdffitError
from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample, Lobes
from brdffit.halfangle.apparent_lobe import Base, base_of
from brdffit.halfangle.measure import lobe_parameters, random_texels, snr
from brdffit.machine import core_count
from brdffit.methods import Material, get_method
from brdffit.models import get_model
from brdffit.svbrdf import Svbrdf, level_sizes
from brdffit.tradeoff import seen
from brdffit.tradeoff.candidates import FIT, ORACLE, Candidate, candidates
from brdffit.tradeoff.front import with_front
from brdffit.tradeoff.record import Point, Solver
from brdffit.tradeoff.solvers import SOLVER_LEVELS, race

#: tell(what is done now)
Tell = Callable[[str], object]
#: (columns, rows) of each level.
Texels = Sequence[tuple[NDArray, NDArray]]


@dataclass(frozen=True)
class Size:
    """Size of the sample: texels of levels 0 to 5 that are timed, and how many of them are measured; texels that are
    raced; rule of the truth; timed repeats."""

    timed: tuple[int, ...] = (8192, 8192, 2048, 512, 128, 64)
    texels: tuple[int, ...] = (512, 512, 384, 192, 96, 64)
    raced: int = 24
    rule: seen.Rule = seen.Rule(1024, (16, 64))
    repeats: int = 2


QUICK = Size((4096, 2048, 512, 96, 32, 16), (96, 96, 64, 32, 16, 16), raced=6, rule=seen.Rule(640, (16, 48)))
_SEED = 77


def measure_set(name: str, svbrdf: Svbrdf, size: Size, tell: Tell) -> tuple[list[Point], list[Solver]]:
    """Points of every candidate and of every optimiser on one set; a cut-out is composited over black."""
    svbrdf = svbrdf.over_black()
    points = measure_candidates(name, svbrdf, size, tell, candidates())
    tell(f"{name}: optimisers")
    base, texels = base_of(svbrdf, get_model(svbrdf.model).default_shape), _texels_of(svbrdf, size)
    raced = [LevelSample(svbrdf, k, *texels[k], base=base).subset(size.raced) for k in SOLVER_LEVELS if k < len(texels)]
    return points, race(name, raced)


def measure_candidates(name: str, svbrdf: Svbrdf, size: Size, tell: Tell, chosen: Sequence[Candidate]) -> list[Point]:
    """Points of these candidates on one set that has no cut-outs; the oracle starts from presets that come before."""
    base, texels = base_of(svbrdf, get_model(svbrdf.model).default_shape), _texels_of(svbrdf, size)
    tried: list[_Tried] = []
    measured = [(c[:n], r[:n]) for (c, r), n in zip(texels, size.texels, strict=False)]
    for candidate in chosen:
        tell(f"{name}: {candidate.group}, {candidate.name}")
        try:
            if candidate.method == ORACLE:
                tried.append(_ask_oracle(candidate, svbrdf, base, measured, tried, size))
            elif candidate.method == FIT:
                tried.append(_fit(candidate, svbrdf, base, texels, size))
            else:
                tried.append(_bake(candidate, svbrdf, texels, size))
        except BrdffitError as error:
            # Some methods need maps, such as heights, that not every set has.
            tell(f"{name}: {candidate.name} is left out. {error}")
    tell(f"{name}: measuring")
    _measure(tried, svbrdf, base, measured, size)
    return with_front([each.point(name) for each in tried])


def _texels_of(svbrdf: Svbrdf, size: Size) -> Texels:
    sizes = level_sizes(svbrdf.size, len(size.timed))
    return [random_texels(each, size.timed[k], seed=_SEED + k) for k, each in enumerate(sizes)]


@dataclass
class _Tried:
    """Results of one candidate: lobes of each level's texels, seconds a texel of the base, figures of each level."""

    candidate: Candidate
    seconds: float
    lobes: list[Lobes]
    decibels: list[float] = field(default_factory=list)
    energy: list[float] = field(default_factory=list)

    def point(self, name: str) -> Point:
        return Point(
            set=name,
            group=self.candidate.group,
            name=self.candidate.name,
            seconds_per_megatexel=self.seconds * 1e6,
            snr_db=float(np.mean(self.decibels)),
            energy=float(np.mean(self.energy)),
            levels_db=self.decibels,
        )

    def add(self, lobes: Lobes, sample: LevelSample, seconds: float) -> None:
        """Add a level whose fit takes this many seconds a texel of the level."""
        self.lobes.append(lobes)
        self.seconds += seconds * math.prod(sample.size) / math.prod(sample.base_size)


def _bake(candidate: Candidate, svbrdf: Svbrdf, texels: Texels, size: Size) -> _Tried:
    """Bake the whole pyramid of a closed form: its cost is that of images, not of single texels."""
    method = get_method(candidate.method)
    options = method.options(levels=len(texels))
    took = []
    for _ in range(size.repeats + 1):
        start = time.perf_counter()
        pyramid = method.bake(Material(svbrdf), options).lobes
        took.append(time.perf_counter() - start)
    assert pyramid is not None  # `candidates` names methods with lobes alone
    versions = [(pyramid[k].svbrdf, at) for k, at in enumerate(texels)]
    lobes = [Lobes(lobe_parameters(v, *at), v.specular[at[1], at[0]].astype(np.float64)) for v, at in versions]
    return _Tried(candidate, min(took) / math.prod(svbrdf.size), lobes)


def _fit(candidate: Candidate, svbrdf: Svbrdf, base: Base, texels: Texels, size: Size) -> _Tried:
    tried = _Tried(candidate, 0.0, [])
    for mip_level, at in enumerate(texels):
        sample = LevelSample(svbrdf, mip_level, *at, candidate.options, base=base)
        tried.add(*_timed(sample, candidate, size.repeats))
    return tried


def _ask_oracle(
    candidate: Candidate, svbrdf: Svbrdf, base: Base, texels: Texels, others: Sequence[_Tried], size: Size
) -> _Tried:
    """The oracle: the best lobes that an optimiser finds from many starts, those of the presets among them."""
    tried = _Tried(candidate, 0.0, [])
    presets = [each for each in others if each.candidate.group == "preset"]
    for mip_level, at in enumerate(texels):
        sample = LevelSample(svbrdf, mip_level, *at, candidate.options, base=base)
        given = [Lobes(*(array[: len(sample)] for array in each.lobes[mip_level])) for each in presets]
        start = time.process_time()
        best = seen.best(sample, given, size.rule)
        tried.add(best, sample, _per_texel(start, sample))
    return tried


def _measure(tried: Sequence[_Tried], svbrdf: Svbrdf, base: Base, texels: Texels, size: Size) -> None:
    """Measure all candidates of a lobe model against the same truth at each texel."""
    for model in dict.fromkeys(each.candidate.options.model for each in tried):
        own = [each for each in tried if each.candidate.options.model == model]
        for mip_level, at in enumerate(texels):
            sample = LevelSample(svbrdf, mip_level, *at, FitOptions(model=model), base=base)
            lobes = [Lobes(*(array[: len(at[0])] for array in each.lobes[mip_level])) for each in own]
            error, energy = seen.errors(sample, lobes, size.rule)
            for k, each in enumerate(own):
                each.decibels.append(min(snr(error[k]), 99.0))
                each.energy.append(float(energy[k].mean()))


def _timed(sample: LevelSample, candidate: Candidate, repeats: int) -> tuple[Lobes, LevelSample, float]:
    """Lobes of a sample and the least of a few measured times; a first run, which compiles, is not timed."""
    settings = sample.settings(candidate.options, candidate.quality)
    sample.subset(1).fit(float_width=candidate.float_width, settings=settings)
    took = []
    for _ in range(repeats):
        start = time.process_time()
        lobes, _ = sample.fit(float_width=candidate.float_width, settings=settings)
        took.append(_per_texel(start, sample))
    return lobes, sample, min(took)


def _per_texel(start: float, sample: LevelSample) -> float:
    """Processor seconds a texel since ``start``, divided by the number of cores."""
    return (time.process_time() - start) / core_count() / len(sample)
