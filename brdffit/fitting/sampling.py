"""Fit and measure a sample of a level's texels: for benchmarks, trade-offs and plans."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.fitting.batch import LevelRules, ModelKernels, Output, cell_of, fit_texels, make_output, model_kernels
from brdffit.fitting.chain import parts_of, unions
from brdffit.fitting.effects import Seen, complete, keep_energy, kernels_of, seen_by
from brdffit.fitting.method import level_search, search_settings
from brdffit.fitting.options import FitOptions
from brdffit.fitting.presets import Quality, quality_of
from brdffit.fitting.rules import level_rules
from brdffit.fitting.search import Search
from brdffit.footprint import filter_texels, get_pixel_filter
from brdffit.halfangle.apparent_lobe import Base, base_of
from brdffit.halfangle.density import DENSITY_EXPONENTS
from brdffit.halfangle.footprints import Footprints, joined
from brdffit.halfangle.lights import sizes_of
from brdffit.halfangle.measure import DENSE_NODES, DENSE_SAMPLES, Measured, measure_lobes
from brdffit.models import Model, get_model
from brdffit.svbrdf import Svbrdf, level_sizes

#: Pieces into which texels are divided, per thread.
_PIECES = 4


class Lobes(NamedTuple):
    """theta (n, 6) and scale (n, 3), float64, of one lobe a texel."""

    theta: NDArray
    scale: NDArray


class LevelSample:
    """Texels (columns[i], rows[i]) of one level of a base: fitted as in a whole bake, measured against the truth.

    Args:
        svbrdf: the base.
        mip_level: the level.
        columns, rows: (n,) int64.
        options: of the bake; ``fit`` may be given others. ``reach`` is ignored: a level outside it is fitted too.
        base: ``svbrdf`` packed for the kernels, where the caller has it already.
        threads: worker threads; None takes all cores.
    """

    def __init__(
        self, svbrdf: Svbrdf, mip_level: int, columns: NDArray, rows: NDArray, options: FitOptions | None = None,
        *, base: Base | None = None, threads: int | None = None,
    ) -> None:  # fmt: skip
        self.options = options or FitOptions()
        self.mip_level, self.columns, self.rows, self.threads = mip_level, columns, rows, threads or os.cpu_count() or 1
        self.source: Model = get_model(svbrdf.model)
        self.target: Model = get_model(self.options.model)
        self.base = base_of(svbrdf, self.source.default_shape) if base is None else base
        self.base_size, self.size = svbrdf.size, level_sizes(svbrdf.size, mip_level + 1)[mip_level]
        self._seen: dict[tuple[str, bool, bool], Seen] = {}
        self._averages: dict[tuple[str, str], NDArray] = {}
        self._parts: dict[object, Footprints] = {}

    def __len__(self) -> int:
        return len(self.columns)

    def kernels(self, float_width: int = 32) -> ModelKernels:
        """Kernels for the models of the base and of the level, with all effects on."""
        return model_kernels(self.source.name, self.target.name, float_width)

    def subset(self, count: int) -> LevelSample:
        """The first ``count`` texels."""
        few = copy.copy(self)
        few.columns, few.rows = self.columns[:count], self.rows[:count]
        few._averages = {name: average[:count] for name, average in self._averages.items()}
        few._parts = {key: parts.part(0, len(parts) // len(self) * count) for key, parts in self._parts.items()}
        return few

    def on_threads(self, threads: int) -> LevelSample:
        """The same texels, fitted and measured by this many threads."""
        other = copy.copy(self)
        other.threads = threads
        return other

    def at(self, mip_level: int, columns: NDArray, rows: NDArray) -> LevelSample:
        """Texels of another level of the same base. Arrays derived from the base are shared."""
        other = copy.copy(self)
        other.mip_level, other.columns, other.rows = mip_level, columns, rows
        other._averages, other._parts = {}, {}
        other.size = level_sizes(self.base_size, mip_level + 1)[mip_level]
        return other

    def seen(self, options: FitOptions | None = None) -> Seen:
        """What a fit under these options sees of the base; computed once for each choice of effects."""
        options = options or self.options
        effects = options.colour, options.correlation, options.coupling
        if effects not in self._seen:
            self._seen[effects] = seen_by(self.base, options)
        return self._seen[effects]

    def settings(self, options: FitOptions | None = None, quality: Quality | None = None) -> tuple[LevelRules, Search]:
        """How this level is sampled and searched. Under a tolerance this takes the fits of a few hundred texels."""
        options = options or self.options
        chosen = quality or quality_of(options)
        pixel_filter = get_pixel_filter(options.pixel_filter)
        lights = sizes_of(options.lights, self.source.blur, self.target.blur)
        rules = level_rules(pixel_filter, self.base_size, self.size, self.mip_level, chosen, lights=lights)
        search = search_settings(options, chosen, self.base, self.source, self.target)
        base, kernels = self.seen(options).base, kernels_of(options, self.source, self.target)
        return rules, level_search(search, options, base, rules, self.size, self.mip_level, kernels)

    def fit(
        self, options: FitOptions | None = None, quality: Quality | None = None, float_width: int = 32,
        settings: tuple[LevelRules, Search] | None = None,
    ) -> tuple[Lobes, Output]:  # fmt: skip
        """Fit these texels; returns their lobes and the full output of the fit.

        ``quality`` overrides the preset of the options. ``settings`` replaces the result of ``settings()``; effects
        follow the options in any case.
        """
        options = options or self.options
        rules, search = settings or self.settings(options, quality)
        seen, output = self.seen(options), make_output(len(self))
        kernels = kernels_of(options, self.source, self.target, float_width)

        parts, cell = self.parts(options, rules, search), cell_of(rules, seen.base, search)

        def work(part: slice) -> None:
            own = Output(*(array[part] for array in output))
            footprints = None
            if parts is not None and rules.chain is not None:
                many = len(parts) // len(self)
                footprints = unions(parts.part(many * part.start, many * part.stop), rules.chain, cell)
            fit_texels(
                seen.base, rules, self.columns[part], self.rows[part], search, own, kernels, float_width, footprints
            )

        self._in_parts(work)
        complete(output, seen, self.averages(options))
        exact = partial(self._average, self.base.specular, options.pixel_filter)
        keep_energy(output, self.base, rules, search, exact)
        normal = output.normal.astype(np.float64)
        theta = np.zeros((len(self), 6))
        theta[:, 0:2] = -normal[:, 0:2] / np.maximum(normal[:, 2:3], 1e-3)
        theta[:, 2:5], theta[:, 5] = output.log_roughness, output.shape
        return Lobes(theta, output.specular.astype(np.float64)), output

    def parts(self, options: FitOptions, rules: LevelRules, search: Search) -> Footprints | None:
        """The footprints of the level before that these texels' footprints consist of; None where these are gathered.

        In a whole bake the level before leaves them. Here they are gathered once, for the time of further fits to be
        that of a bake.
        """
        chain, cell = rules.chain, cell_of(rules, self.base, search)
        if chain is None or len(chain.sizes) == 1 or not cell > 0.0:
            return None
        key = (
            options.colour,
            options.correlation,
            options.coupling,
            search.step,
            cell,
            chain.strata[4:],
            chain[1:],
        )
        if key not in self._parts:
            base, bounds = self.seen(options).base, np.linspace(0, len(self), 4 * self.threads + 1).astype(int)

            def gather(k: int) -> Footprints:
                part = slice(bounds[k], bounds[k + 1])
                return parts_of(base, chain, search.step, cell, self.columns[part], self.rows[part])

            with ThreadPoolExecutor(self.threads) as pool:
                self._parts[key] = joined(list(pool.map(gather, range(4 * self.threads))))
        return self._parts[key]

    def best(self, given: list[Lobes]) -> Lobes:
        """The best lobes of these texels that ``brdffit.fitting.solvers.oracle`` finds, with a free scale.

        ``given``: lobes to start from as well, one a texel each; by the oracle's own rule the result is never worse
        than any of them. Effects that the options leave out are simulated all the same. Takes hundreds of times as long
        as the fit (``brdffit tradeoff``).
        """
        # Imported here: a bake does not need the oracle's two optimisation libraries.
        from brdffit.fitting.solvers import oracle

        search = search_settings(self.options, quality_of(self.options), self.base, self.source, self.target)
        found = oracle(
            self.base, self.base_size, self.size, self.columns, self.rows, search=search, kernels=self.kernels(),
            pixel_filter=self.options.pixel_filter, given=np.stack([lobes.theta for lobes in given]),
            threads=self.threads,
        )  # fmt: skip
        return Lobes(found.theta, found.scale)

    def averages(self, options: FitOptions) -> dict[str, NDArray]:
        """Averages (n, 3), by name, of the images that a fit under these options does not see.

        They are computed once and shared with subsets that are taken afterwards.
        """
        seen, pixel_filter = self.seen(options), options.pixel_filter
        for name in seen.averaged:
            if (name, pixel_filter) not in self._averages:
                self._averages[name, pixel_filter] = self._average(seen.averaged[name], pixel_filter)
        return {name: self._averages[name, pixel_filter] for name in seen.averaged}

    def _average(self, image: NDArray, pixel_filter: str) -> NDArray:
        wrap = "tile" if self.base.tile else "clamp"
        return filter_texels(image, self.size, get_pixel_filter(pixel_filter), wrap, self.columns, self.rows)

    def measure(
        self, versions: list[Lobes], nodes: int = DENSE_NODES, samples: tuple[int, int] = DENSE_SAMPLES
    ) -> Measured:
        """Error and energy (M, n) of M versions of the lobes, all measured against one table a texel."""
        theta, scale = (np.stack([pair[k] for pair in versions]) for k in range(2))
        error, energy = np.zeros(theta.shape[:2]), np.zeros(theta.shape[:2])

        def work(part: slice) -> None:
            error[:, part], energy[:, part] = measure_lobes(
                self.base, self.base_size, self.size, theta[:, part].copy(), scale[:, part].copy(), self.columns[part],
                self.rows[part], pixel_filter=self.options.pixel_filter,
                exponent=DENSITY_EXPONENTS[self.options.density], kernels=self.kernels(), nodes=nodes, samples=samples,
            )  # fmt: skip

        self._in_parts(work)
        return Measured(error, energy)

    def _in_parts(self, work: Callable[[slice], None]) -> None:
        """Run ``work`` on slices of the texels in threads (the loops release the GIL); the first texel alone, which may
        compile."""
        work(slice(0, 1))
        with ThreadPoolExecutor(self.threads) as pool:
            bounds = np.linspace(1, len(self), _PIECES * self.threads + 1).astype(int)
            parts = [slice(a, b) for a, b in zip(bounds[:-1], bounds[1:], strict=True) if b > a]
            list(pool.map(work, parts))
