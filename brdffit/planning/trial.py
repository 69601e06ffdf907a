"""Contribution and cost of an effect, measured on a small random sample of texels and directions.

The figure is that of a picture: the squared error of the radiance that the scene's cameras see under the scene's
lights, over the square of the true radiance, pooled over the texels of a level and averaged over the levels that are
reached. Under lights of an angular radius all lobes are widened, the true ones too (see ``brdffit.halfangle.lights``),
and the squares for several sizes are averaged by their shares of the light. Configurations are compared with the truth
on the same texels and pairs of directions, so that most of the sampling noise cancels in their differences; the
remaining noise is estimated by resampling texels (Efron's bootstrap).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.fitting.averaging import averaged_levels
from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample
from brdffit.halfangle.measure import random_texels
from brdffit.machine import core_count
from brdffit.models import get_model
from brdffit.planning.effects import Setup
from brdffit.render.pairs import pair_errors
from brdffit.render.terms import Terms
from brdffit.roughness import log_from_tensor, tensor_from_log
from brdffit.svbrdf import Svbrdf, level_sizes

#: Relative squared error that is invisible: a contrast of one percent, about the eye's threshold (40 dB).
UNSEEN = 1e-4
#: Sampled texels of levels 0 and 1 (coarser levels, whose texels take longer, have fewer, down to the least), pairs of
#: light and viewer at each, samples of a footprint, and levels of a surface that are measured.
TEXELS, LEAST_TEXELS, PAIRS, FOOTPRINT, LEVELS = 192, 32, 256, 1024, 4
#: Least seconds of a timed fit, repeats of which the shortest counts, fewest and most texels.
_TIMED, _REPEATS, _FEW_TEXELS, _MOST_TEXELS = 0.02, 2, 8, 8192
_RESAMPLED = 200

#: (view, light, weight), as ``lighting.directions`` returns them; ``Draw`` takes texels, pairs, a seed and highlights.
Directions = tuple[NDArray, NDArray, NDArray]
Draw = Callable[[int, int, int, tuple[NDArray, NDArray] | None], Directions]


class Shining(NamedTuple):
    """Lights of one angular radius (degrees), their share of all light, and a function that draws pairs under them."""

    radius: float
    share: float
    draw: Draw


class Errors(NamedTuple):
    """For each measured level: squared errors (M, n) of M versions, and squares (n,) of the reference."""

    error: list[NDArray]
    reference: list[NDArray]


class Loss(NamedTuple):
    """dB by which one version is worse than another, and the standard error of that."""

    db: float
    error: float

    @property
    def at_most(self) -> float:
        """The loss in dB with two standard errors added, never below 0."""
        return max(self.db + 2.0 * self.error, 0.0)


class Sample:
    """Texels of the levels that a surface's cameras reach, with directions.

    Args:
        base: everything that the set holds.
        options: of the bake; trials may change the fields that effects set.
        reach: first and last level.
        lights: of the scene, by size.
        seed: of texels and directions.
        texels: of levels 0 and 1; coarser levels have fewer.
    """

    def __init__(
        self, base: Svbrdf, options: FitOptions, reach: tuple[int, int], lights: Sequence[Shining], seed: int = 0,
        texels: int = TEXELS, threads: int | None = None,
    ) -> None:  # fmt: skip
        self.base, self.options, self.reach, self.lights, self.seed = base, options, reach, lights, seed
        self.threads = threads
        self.sizes = level_sizes(base.size)
        self.levels = sorted({round(level) for level in np.linspace(*reach, LEVELS)})
        self.texels = {k: random_texels(self.sizes[k], _count(texels, k), self._seed(k)) for k in self.levels}
        self._highlights: list[tuple[NDArray, NDArray]] | None = None
        self._bases: dict[tuple[str, ...], LevelSample] = {}
        self._widened: dict[float, Svbrdf] = {}

    def _seed(self, level: int) -> int:
        return 1000 * (self.seed + 1) + level

    def versions(self, setup: Setup) -> list[Svbrdf]:
        """The sampled texels of each level as (n, 1) images, fitted with this setup."""
        return [self._version(level, setup) for level in self.levels]

    def picked(self, levels: Sequence[Svbrdf]) -> list[Svbrdf]:
        """The sampled texels of a pyramid that was baked."""
        return [_picked(levels[level], *self.texels[level]) for level in self.levels]

    def aim(self, version: Sequence[Svbrdf]) -> None:
        """From now on draw half of the pairs in highlights of these lobes and of the base texels at their centres."""
        self._highlights = []
        for level, fitted in zip(self.levels, version, strict=True):
            columns, rows = self.texels[level]
            height, width = self.sizes[level]
            at = (
                (2 * columns + 1) * self.base.size[1] // (2 * width),
                (2 * rows + 1) * self.base.size[0] // (2 * height),
            )
            both = fitted, _picked(self.base, *at)
            normals = np.concatenate([each.normal for each in both], axis=1)
            log_alpha = np.concatenate([each.log_roughness[..., :2].mean(axis=-1) for each in both], axis=1)
            self._highlights.append((normals, np.exp(0.5 * log_alpha)))

    def errors(
        self, versions: Sequence[Sequence[Svbrdf]], terms: Terms | None = None, lights: Sequence[Shining] | None = None
    ) -> Errors:
        """Squared errors of M versions (each a list over the levels) against everything that the base holds."""
        lights = lights or self.lights
        found = Errors([], [])
        for i, level in enumerate(self.levels):
            columns, rows = self.texels[level]
            error, reference = np.zeros((len(versions), len(columns))), np.zeros(len(columns))
            for shining in lights:
                seen, square = pair_errors(
                    self._base_under(shining.radius), [_widened(version[i], shining.radius) for version in versions],
                    columns, rows, terms=terms or Terms(), samples=FOOTPRINT, size=self.sizes[level],
                    threads=self.threads, directions=self._directions(shining, i, len(columns), len(lights)),
                )  # fmt: skip
                error += shining.share * seen
                reference += shining.share * square
            found.error.append(error)
            found.reference.append(reference)
        return found

    def _directions(self, shining: Shining, i: int, texels: int, sizes: int) -> Directions:
        """Pairs at the texels of the i-th level; their number is divided among the sizes of light."""
        highlights = None
        if self._highlights is not None:
            normal, width = self._highlights[i]
            blur = get_model(self.base.model).blur * math.radians(0.5 * shining.radius) ** 2
            highlights = normal, np.sqrt(np.square(width) + blur)
        return shining.draw(texels, max(PAIRS // sizes, 1), self._seed(self.levels[i]), highlights)

    def _base_under(self, radius: float) -> Svbrdf:
        if radius not in self._widened:
            self._widened[radius] = _widened(self.base, radius)
        return self._widened[radius]

    def seconds(self, setups: Sequence[Setup]) -> list[float]:
        """Seconds for all levels of a pyramid with each setup on an idle machine, estimated from some texels.

        Processor time is divided by the number of threads; setups take turns and the shortest of several runs counts,
        so that other load on the machine matters little.
        """
        first, last = self.reach
        # The finest levels have most texels; on coarser ones the cost of a texel changes slowly.
        timed_levels = sorted({min(first + k, last) for k in range(3)} | {(first + last + 2) // 2, last})
        per_texel = np.array([self._seconds_a_texel(level, setups) for level in timed_levels])
        reached = range(self.reach[0], self.reach[1] + 1)
        rest = [size for k, size in enumerate(self.sizes) if k not in reached]
        target = get_model(self.options.model)
        around = timed(lambda: list(averaged_levels(self.base, rest, self.options, target)), 1)
        total = []
        for m, setup in enumerate(setups):
            # Between timed levels the logarithm of a texel's cost is interpolated linearly.
            cost = np.exp(np.interp(reached, timed_levels, np.log(np.maximum(per_texel[:, m], 1e-9))))
            counts = [0 if _is_kept(k, setup) else math.prod(self.sizes[k]) for k in reached]
            total.append(float(cost @ counts) + around)
        return total

    def _seconds_a_texel(self, level: int, setups: Sequence[Setup]) -> list[float]:
        texels, threads = math.prod(self.sizes[level]), self.threads or core_count()
        many = random_texels(self.sizes[level], min(texels, _MOST_TEXELS), self._seed(level) + 500)
        runs: list[_Run | None] = []
        pilots = []
        for setup in setups:
            if _is_kept(level, setup):
                runs.append(None)
                pilots.append(0.0)
                continue
            # On one thread: starting others costs much for a few texels, and nothing for a whole level.
            sample = self._level_sample(level, setup.unread, many).on_threads(1)
            start = time.process_time()
            settings = sample.settings(setup.options)
            pilots.append(time.process_time() - start)
            # Averages are made before timing: a bake averages whole levels, which costs next to nothing.
            sample.averages(setup.options)
            runs.append(_Run(sample, setup.options, settings))
        shortest = [math.inf] * len(setups)
        for _ in range(_REPEATS):
            for m, run in enumerate(runs):
                shortest[m] = min(shortest[m], 0.0 if run is None else run.seconds_a_texel())
        # A level pays for its pilot fits once.
        return [a / threads + b / texels for a, b in zip(shortest, pilots, strict=True)]

    def _version(self, level: int, setup: Setup) -> Svbrdf:
        if _is_kept(level, setup):
            return _picked(self.base.without(setup.unread), *self.texels[level])
        sample = self._level_sample(level, setup.unread, self.texels[level])
        _, output = sample.fit(setup.options)
        arrays = {name: getattr(output, name)[:, None] for name in ("normal", "log_roughness", "specular", "diffuse")}
        shape = output.shape[:, None] if sample.target.shape_bounds else None
        return Svbrdf(**arrays, model=sample.target.name, wrap=self.base.wrap, shape=shape)

    def _level_sample(self, level: int, unread: tuple[str, ...], texels: tuple[NDArray, NDArray]) -> LevelSample:
        if unread not in self._bases:
            self._bases[unread] = LevelSample(
                self.base.without(unread), level, *texels, self.options, threads=self.threads
            )
        return self._bases[unread].at(level, *texels)


def snr_db(found: Errors, version: int) -> float:
    """SNR in dB of one version over the measured levels; ``UNSEEN`` is added to the error, so it is at most 40."""
    return -10.0 * math.log10(float(_pooled(found, version, None)) + UNSEEN)


def loss(found: Errors, version: int, than: int = 0, of: Errors | None = None) -> Loss:
    """Loss of ``version`` against version ``than``, with its standard error over samples of texels of this size.

    ``of``: errors that hold ``than``, measured on the same texels; None: ``found``.
    """
    of = found if of is None else of
    random = np.random.default_rng(0)
    drawn = [random.integers(0, len(r), (_RESAMPLED, len(r))) for r in found.reference]
    one, other = (np.log10(_pooled(each, m, drawn) + UNSEEN) for each, m in ((of, than), (found, version)))
    return Loss(snr_db(of, than) - snr_db(found, version), float(np.std(10.0 * (other - one))))


def _pooled(found: Errors, version: int, texels: list[NDArray] | None) -> NDArray:
    """Squared error over squared reference of each level, averaged over levels; (R,) for R resamplings of texels."""
    shares = []
    for i, (e, r) in enumerate(zip(found.error, found.reference, strict=True)):
        own, square = e[version], r
        if texels is not None:
            own, square = own[texels[i]], square[texels[i]]
        shares.append(np.maximum(own.sum(axis=-1), 0.0) / np.maximum(square.sum(axis=-1), 1e-30))
    return np.mean(shares, axis=0)


def _count(texels: int, level: int) -> int:
    return max(texels >> max(level - 1, 0), LEAST_TEXELS)


def _is_kept(level: int, setup: Setup) -> bool:
    return level == 0 and setup.options.keep_level_0


def _picked(level: Svbrdf, columns: NDArray, rows: NDArray) -> Svbrdf:
    """Some texels as an (n, 1) image."""
    arrays = {name: array[rows, columns][:, None] for name, array in level.arrays().items()}
    return Svbrdf(**arrays, model=level.model, wrap=level.wrap)


class _Run:
    """Texels of a level that are fitted repeatedly to find the cost of one."""

    def __init__(self, sample: LevelSample, options: FitOptions, settings: Any) -> None:
        def fit(count: int) -> float:
            few = sample.subset(count)
            return timed(lambda: few.fit(options, settings=settings), 1)

        self._fit = fit
        self._few, self._many = min(_FEW_TEXELS, len(sample)), min(4 * _FEW_TEXELS, len(sample))
        while self._many < len(sample) and fit(self._many) < _TIMED:
            self._many = min(4 * self._many, len(sample))

    def seconds_a_texel(self) -> float:
        """Processor seconds of one texel; with enough texels, without the constant cost of a call."""
        if self._many < 2 * self._few:
            return self._fit(self._many) / self._many
        return max(self._fit(self._many) - self._fit(self._few), 0.0) / (self._many - self._few)


def _widened(svbrdf: Svbrdf, radius: float) -> Svbrdf:
    """The lobes as lights of this angular radius in degrees show them."""
    if radius == 0.0:
        return svbrdf
    square = get_model(svbrdf.model).blur * math.radians(0.5 * radius) ** 2
    tensor = tensor_from_log(svbrdf.log_roughness) + np.array([square, square, 0.0], np.float32)
    return svbrdf.replace(log_roughness=log_from_tensor(tensor))


def timed(work: Callable[[], object], threads: int | None) -> float:
    """Processor seconds of ``work`` divided by the number of threads (None: all cores), never 0."""
    start = time.process_time()
    work()
    return max(time.process_time() - start, 1e-6) / (threads or core_count())
