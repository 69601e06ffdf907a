"""The nonlinear fit as a method: every texel of every level is fitted to the base under its pixel filter."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import partial

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.fitting.averaging import averaged_levels
from brdffit.fitting.batch import (
    LevelRules,
    ModelKernels,
    Output,
    cell_of,
    fit_texels,
    fitting_kernel,
    make_output,
    model_kernels,
)
from brdffit.fitting.bfgs import FREE_ANISOTROPY, FREE_NORMAL, FREE_SHAPE
from brdffit.fitting.chain import Chain, footprints_of, unions
from brdffit.fitting.effects import UNBOUNDED, Seen, complete, keep_energy, kernels_of, reached, seen_by
from brdffit.fitting.losses import DARK, DISPLAYED, LOSS_CODES, balance_of, loss_of
from brdffit.fitting.near_lean import within_of
from brdffit.fitting.options import SPECULARS, FitOptions
from brdffit.fitting.presets import Quality, quality_of
from brdffit.fitting.refine import refine_pyramid
from brdffit.fitting.rules import continued_by, level_rules
from brdffit.fitting.search import Search
from brdffit.fitting.status import KEPT, NOT_REACHED, doubts
from brdffit.footprint import PixelFilter, filter_channels, get_pixel_filter, iter_pyramid
from brdffit.halfangle.apparent_lobe import Base, base_of
from brdffit.halfangle.density import DENSITY_EXPONENTS
from brdffit.halfangle.footprints import Footprints, joined
from brdffit.halfangle.lights import sizes_of
from brdffit.halfangle.measure import PERFECT_DB, random_texels
from brdffit.halfangle.objective import BOUNDED, FREE, HOLDS
from brdffit.halfangle.response import NO_RESPONSE, response_of
from brdffit.methods import Level, LobeMethod, Material, Progress, Pyramid, one_of
from brdffit.models import Model, get_model
from brdffit.svbrdf import Svbrdf, level_sizes

# A piece of work should take a fraction of a second, so that interrupts are handled and the progress bar moves.
_TEXELS_PER_PIECE = 16384
_LEAST_PIECES = 32
# Texels fitted to estimate a level's mean error, and the fewest texels of a level for which that pays.
_PILOT_TEXELS, _LEAST_TEXELS = 256, 4096
# The largest share of its error that a search under a tolerance may leave.
_LAXEST = 1e-2
# Least and greatest bounded scale, in units of the filtered colour.
_BOUNDS = (0.91, 1.09)
# Where lights have a size the diffuse colour is fitted to point lights and, with this share, to an even sky.
_SKY = 0.25
# Relative squared errors (8 dB, and 4 dB of the displayed loss, whose errors are larger) above which the best lobe may
# not have been found and further starts are tried. With 0.15 for the displayed loss too, they would gain 0.05 dB for a
# third of all evaluations.
_POOR, _POOR_DISPLAYED = 0.15, 0.4


class NonlinearFit(LobeMethod):
    """Fits one lobe for each texel and level to the average of all base lobes under the pixel filter."""

    name = "bfgs"
    summary = "nonlinear fit of the lobe to the filtered lobes, by BFGS on the half-angle error integral (default)"

    options = FitOptions

    def prepare(self, material: Material, options: FitOptions) -> None:
        """Compile the kernels of a bake or load them from the cache, so that fitting is timed without it."""
        source, target = get_model(material.svbrdf.model), get_model(options.model)
        fitting_kernel(32)
        model_kernels(source.name, target.name)
        kernels_of(options, source, target)

    def bake_lobes(self, svbrdf: Svbrdf, options: FitOptions, progress: Progress | None = None) -> Pyramid:
        """Fit every level from the base.

        Raises:
            UnknownNameError: for an unknown model, pixel filter, quality, or kind of fit.
            InputError: when the base holds a number that is not finite, or the reach is no range of levels.
        """
        target, source = get_model(options.model), get_model(svbrdf.model)
        pixel_filter, quality = get_pixel_filter(options.pixel_filter), quality_of(options)
        if not svbrdf.is_finite():
            raise InputError("The SVBRDF holds numbers that are not finite; every texel must be a finite number.")
        # Compiled before the threads start, or several threads would compile at once.
        fitting_kernel(32)
        kernels = kernels_of(options, source, target)
        base = base_of(svbrdf, source.default_shape)
        seen = seen_by(base, options)
        search = search_settings(options, quality, base, source, target)
        lights = sizes_of(options.lights, source.blur, target.blur)
        sizes = level_sizes(svbrdf.size, options.levels)
        fitted = reached(options.reach, len(sizes))
        kept = 1 if options.keep_level_0 else 0
        authored = kept if source.name == target.name else 0
        searched = [size for k, size in enumerate(sizes) if k >= authored and k in fitted]
        plain = averaged_levels(svbrdf, [size for size in sizes[authored:] if size not in searched], options, target)
        averages = _averages(seen, svbrdf.wrap, searched, pixel_filter, point=kept > authored and 0 in fitted)
        pyramid = Pyramid(self.name, options, [])
        level_samplings = [
            level_rules(pixel_filter, svbrdf.size, size, k, quality, point=k < kept, lights=lights)
            for k, size in enumerate(sizes)
        ]
        footprints = None
        for mip_level, size in enumerate(sizes):
            start = time.perf_counter()
            rules = level_samplings[mip_level]
            coarser = continued_by(level_samplings[mip_level : mip_level + 2])
            known, footprints = footprints, None
            if mip_level < authored:
                level = Level(svbrdf.replace(height=None), status=np.full(size, KEPT, np.uint8))
            elif mip_level not in fitted:
                level = Level(next(plain), status=np.full(size, NOT_REACHED, np.uint8))
            else:
                own = level_search(search, options, seen.base, rules, size, mip_level, kernels)
                output, footprints = _fit_level(
                    seen.base, rules, size, own, kernels, options.threads, mip_level, progress, known, coarser
                )
                complete(output, seen, next(averages))
                keep_energy(output, base, rules, own, partial(_average_of, base, size, pixel_filter))
                level = _level(output, size, svbrdf, target, pixel_filter)
            level.seconds = time.perf_counter() - start
            pyramid.levels.append(level)
        if options.refine:
            # Levels that no pixel reads are not refined. The target of refinement is the whole base, with effects that
            # the fit leaves out; only the horizon of base lobes follows the options, for the kernels hold it.
            read = Pyramid(self.name, options, pyramid.levels[: fitted[-1] + 1])
            refine_pyramid(read, base, level_samplings, search, kernels, first=max(kept, fitted[0]))
            pyramid.notes += read.notes
            if options.lights != "point":
                pyramid.notes.append(
                    "Levels were refined in l2 under point lights, whatever lights they were fitted for."
                )
        if len(searched) < len(sizes) - authored:
            levels = f"level {fitted[0]}" if len(fitted) == 1 else f"levels {fitted[0]} to {fitted[-1]}"
            pyramid.notes.append(f"Pixels read {levels} alone; the others are averaged, not fitted.")
        pyramid.notes += doubts([level.status for level in pyramid.levels if level.status is not None])
        return pyramid


def _averages(
    seen: Seen, wrap: str, sizes: list[tuple[int, int]], pixel_filter: PixelFilter, point: bool
) -> Iterator[dict[str, NDArray]]:
    """Yield the averages that ``complete`` needs for each level, as (texels, 3) by name.

    ``point``: the first level is the base itself and is not filtered.
    """
    images = seen.averaged
    pyramids = {name: iter_pyramid(image, sizes[point:], pixel_filter, wrap) for name, image in images.items()}
    for k in range(len(sizes)):
        level = images if point and k == 0 else {name: next(pyramid) for name, pyramid in pyramids.items()}
        yield {name: image.reshape(-1, 3) for name, image in level.items()}


def _average_of(base: Base, size: tuple[int, int], pixel_filter: PixelFilter) -> NDArray:
    """The specular colour of each texel of a level, (n, 3), filtered exactly."""
    return filter_channels(base.specular, size, pixel_filter, "tile" if base.tile else "clamp").reshape(-1, 3)


def search_settings(options: FitOptions, quality: Quality, base: Base, source: Model, target: Model) -> Search:
    """Settings of the search that options ask for.

    Raises:
        UnknownNameError: for an unknown normal, lobe, density, specular or loss.
    """
    free = FREE_NORMAL if one_of("normal", options.normal, ("free", "mean")) == "free" else 0
    if one_of("lobe", options.lobe, ("anisotropic", "isotropic")) == "anisotropic" and not target.isotropic:
        free |= FREE_ANISOTROPY
    low, default, high = target.shape_bounds or (0.0, 0.0, 0.0)
    if target.shape_bounds:
        free |= FREE_SHAPE
    one_of("density", options.density, tuple(DENSITY_EXPONENTS))
    point, specular = options.lights == "point", one_of("specular", options.specular, SPECULARS)
    kind = {"free": FREE, "held": HOLDS, "bounded": BOUNDED, "auto": FREE if point else BOUNDED}[specular]
    low_scale, high_scale = _BOUNDS if kind == BOUNDED else (0.0, UNBOUNDED)
    if kind == FREE and options.energy > 0.0:
        kind = BOUNDED
    loss = LOSS_CODES[loss_of(options.loss, options.lights)]
    sharpest = float(base.perceptual.min()) if base.isotropic else options.min_roughness
    return Search(
        free=free,
        scale=kind,
        scale_low=low_scale,
        scale_high=high_scale,
        energy=options.energy,
        exponent=DENSITY_EXPONENTS[options.density],
        step=quality.step,
        tolerance=quality.tolerance,
        iterations=quality.iterations,
        log_low=4.0 * math.log(min(options.min_roughness, sharpest)),
        log_high=0.0,
        shape_low=low,
        shape_high=high,
        same_model=source.name == target.name,
        trusted=quality.trusted,
        negligible=quality.negligible,
        crowd=2,
        floor=0.0,
        allowed=0.0,
        loss=loss,
        dark=DARK,
        squares=0.0,
        within=0.0,
        sky=0.0 if point else _SKY,
        poor=_POOR_DISPLAYED if loss == DISPLAYED else _POOR,
        rescaled=loss == DISPLAYED,
        rendered=kind == BOUNDED and not point,
        usual=0 if options.tolerance is None else 1,
        cell=0.0 if point else quality.merge,
        response=NO_RESPONSE,
    )


def level_search(
    search: Search, options: FitOptions, base: Base, rules: LevelRules, size: tuple[int, int], mip_level: int,
    kernels: ModelKernels,
) -> Search:  # fmt: skip
    """``search`` for one level: its loss, and under ``options.tolerance`` how much error shortcuts may add to a texel.

    A level's SNR is that of the mean of its texels' errors, and a tolerance in dB lets that mean grow by a share
    t = 10^(dB/10) - 1. The error of the closed form rises with the eighth power of how much lobes differ, so few texels
    come near the most that it may add to one of them, 3 t times the mean error (``benchmarks --only tolerance``
    measures the result). Few nodes may add t / 3 of the mean error and an early stop t / 8 of the texel's own, since
    every texel pays for these. The mean error is taken from random texels fitted without shortcuts, which does not pay
    on a small level; it counts as that of ``PERFECT_DB`` at least.
    """
    loss = loss_of(options.loss, options.lights)
    dark, squares = balance_of(loss, mip_level)
    search = search._replace(dark=dark, squares=squares, within=within_of(loss, mip_level))
    if options.tolerance is None:
        return search
    share = 10.0 ** (0.1 * options.tolerance) - 1.0
    # A start too wide for its target lies on a plateau of the error, where a lax search would stop.
    search = search._replace(tolerance=min(share / 8.0, _LAXEST))
    if size[0] * size[1] < _LEAST_TEXELS:
        return search
    columns, rows = random_texels(size, _PILOT_TEXELS, seed=mip_level)
    pilot = make_output(len(columns))
    fit_texels(base, rules, columns, rows, search, pilot, kernels)
    spare = share * max(float(pilot.residual.mean()), 10.0 ** (-0.1 * PERFECT_DB))
    search = search._replace(floor=spare / 3.0)
    # The closed form's table is of l2 under point lights.
    l2 = options.lights == "point" and search.loss == LOSS_CODES["l2"]
    if not (l2 and search.same_model) or search.free & FREE_SHAPE or base.has_shape:
        return search
    response = response_of(
        kernels.values, kernels.log_normalisation, search.exponent, turns=bool(search.free & FREE_NORMAL),
        stretches=bool(search.free & FREE_ANISOTROPY), held=search.scale == HOLDS,
    )  # fmt: skip
    return search._replace(allowed=3.0 * spare, response=response)


def _fit_level(
    base: Base, rules: LevelRules, size: tuple[int, int], search: Search, kernels: ModelKernels,
    threads: int | None, mip_level: int, progress: Progress | None, known: Footprints | None, coarser: Chain | None,
) -> tuple[Output, Footprints | None]:  # fmt: skip
    """Fit all texels of a level in pieces, on threads (the loop releases the GIL).

    Texels are independent, so the result does not depend on the pieces or the threads. ``known``: the level's
    footprints, where the level before left them; ``coarser``: the chain of the next level, where its footprints are
    unions of these; then they are returned too.
    """
    texels, cell = size[0] * size[1], cell_of(rules, base, search)
    output = make_output(texels)
    if not cell > 0.0:
        coarser = None
    piece = max(1, min(_TEXELS_PER_PIECE, math.ceil(texels / _LEAST_PIECES)))
    if coarser is not None:
        # Whole pixels of the next level. Its footprints are made piece by piece: those of a level are many.
        rows = coarser.parts[0] * size[1]
        piece = math.ceil(min(piece, _TEXELS_PER_PIECE // 4) / rows) * rows
    found: dict[int, Footprints] = {}

    def work(first: int) -> int:
        last = min(first + piece, texels)
        columns, rows = np.arange(first, last) % size[1], np.arange(first, last) // size[1]
        own = None if known is None else known.part(first, last)
        if own is None and coarser is not None:
            own = footprints_of(base, coarser.before(), search.step, cell, columns, rows)
        part = Output(*(array[first:last] for array in output))
        fit_texels(base, rules, columns, rows, search, part, kernels, footprints=own)
        if own is not None and coarser is not None:
            found[first] = unions(own, coarser, cell, rows=True)
        return len(columns)

    done = 0
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        waiting: set[Future[int]] = {pool.submit(work, first) for first in range(0, texels, piece)}
        try:
            while waiting:
                finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                done += sum(future.result() for future in finished)
                if progress is not None:
                    progress(mip_level, done, texels)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return output, joined([found.pop(first) for first in sorted(found)]) if found else None


def _level(output: Output, size: tuple[int, int], base: Svbrdf, target: Model, pixel_filter: PixelFilter) -> Level:
    """The filled arrays as a level; occlusion and opacity are averaged."""

    def image(array: NDArray) -> NDArray:
        return array.reshape(*size, *array.shape[1:])

    occlusion, opacity = base.averaged_scalars(lambda array: filter_channels(array, size, pixel_filter, base.wrap))
    svbrdf = Svbrdf(
        normal=image(output.normal),
        log_roughness=image(output.log_roughness),
        specular=image(output.specular),
        diffuse=image(output.diffuse),
        model=target.name,
        wrap=base.wrap,
        shape=image(output.shape) if target.shape_bounds else None,
        occlusion=occlusion,
        opacity=opacity,
        alpha=base.alpha,
        cutoff=base.cutoff,
    )
    return Level(svbrdf, image(output.status), image(output.residual), image(output.evaluations))
