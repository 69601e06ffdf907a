"""The method ``learned``: a closed form from the moments of footprints, corrected by a network.

Texels whose features lie outside the range of the training data are fitted instead.
"""

from __future__ import annotations

import dataclasses
import math
import os
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.fitting.batch import Output, fit_texels, fitting_kernel, make_output, model_kernels
from brdffit.fitting.method import search_settings
from brdffit.fitting.options import QUALITIES, FitOptions
from brdffit.fitting.presets import get_quality
from brdffit.fitting.rules import level_rules
from brdffit.fitting.status import CLOSED_FORM, KEPT, NO_SPECULAR
from brdffit.footprint import filter_channels, get_pixel_filter
from brdffit.halfangle.apparent_lobe import base_of
from brdffit.halfangle.density import DENSITY_EXPONENTS
from brdffit.halfangle.lights import sizes_of
from brdffit.learned import asked
from brdffit.learned.asked import check_asked, tiny_base, told_of, weights_path
from brdffit.learned.kernels.displayed import LIGHTS
from brdffit.learned.kernels.footprints import empty_tiles
from brdffit.learned.kernels.gathering import gather_tiles
from brdffit.learned.kernels.saying import say_rows
from brdffit.learned.network import SHIPPED as LEARNED
from brdffit.learned.network import load_network
from brdffit.methods import Level, LobeMethod, Material, Progress, Pyramid
from brdffit.models import get_model
from brdffit.options import LobeOptions, option
from brdffit.svbrdf import Svbrdf, level_sizes

MODEL = "ggx"
#: Texels of a strip of rows, and texels to fit, that a worker takes at once.
_TEXELS_PER_PIECE, _FITS_PER_PIECE = 32768, 512


@dataclass(frozen=True)
class LearnedOptions(LobeOptions):
    """Options of the method ``learned``."""

    group: ClassVar[str] = "learned"

    specular: str = option(
        "bounded",
        "scale of the lobe: the network's, within 0.92 to 1.09 of the filtered colour, or held at it",
        names=("bounded", "held"),
    )
    quality: str = option("standard", "of the fit of texels unlike all training", names=QUALITIES)
    weights: str = option(asked.SHIPPED, "a file of `brdffit learn learned`, or those shipped")


def _fit_options(options: LearnedOptions) -> FitOptions:
    """The options of the fit, under the lights that the network was trained for."""
    ours = dataclasses.asdict(options)
    same = {each.name: ours[each.name] for each in dataclasses.fields(FitOptions) if each.name in ours}
    return FitOptions(**{"lights": LIGHTS, **same})


class Learned(LobeMethod):
    """A closed form, corrected by a network; texels unlike the training data are fitted."""

    name = "learned"
    summary = "closed form and a network's correction of it; texels unlike all training are fitted"
    options = LearnedOptions

    def prepare(self, material: Material, options: LearnedOptions) -> None:
        """Compile, and read the weights.

        Raises:
            InputError: for a file that holds no weights of this method.
        """
        fitting_kernel(32)
        model_kernels(MODEL, MODEL)
        self.bake_lobes(tiny_base(), dataclasses.replace(options, model=MODEL, levels=None))

    def trained(self, options: LearnedOptions) -> str:
        """How its weights were made."""
        return told_of(load_network(weights_path(options.weights, LEARNED))[1])

    def bake_lobes(self, svbrdf: Svbrdf, options: LearnedOptions, progress: Progress | None = None) -> Pyramid:
        """Predict every level from the moments of its footprints.

        Raises:
            InputError: for another lobe model than the weights', or numbers that are not finite.
            UnknownNameError: for an unknown model, pixel filter or quality.
        """
        notes = check_asked(self.name, svbrdf, options, (MODEL,))
        pyramid = Pyramid(self.name, options, [], notes)
        with ThreadPoolExecutor(options.threads or os.cpu_count()) as pool:
            fitted = _Bake(svbrdf, options, pool, progress).levels(pyramid.levels)
        texels = sum(math.prod(level.svbrdf.size) for level in pyramid.levels)
        if fitted:
            pyramid.notes.append(
                f"{fitted} of {texels} texels ({100.0 * fitted / texels:.1f}%) are unlike what the network was trained "
                "on; they were fitted."
            )
        return pyramid


class _Fresh(NamedTuple):
    """A level that is being made: what is said of its texels, which of them are strange, which reflect anything."""

    size: tuple[int, int]
    output: Output
    strange: NDArray
    some: NDArray

    @classmethod
    def of(cls, size: tuple[int, int]) -> _Fresh:
        """An empty level (height, width)."""
        texels = math.prod(size)
        return cls(size, make_output(texels), np.zeros(texels, np.bool_), np.zeros(texels, np.bool_))

    @property
    def flat(self) -> tuple[NDArray, ...]:
        """The images as ``say_rows`` takes them."""
        images = self.output.normal, self.output.log_roughness, self.output.specular, self.output.diffuse
        return *(image.reshape(-1) for image in images), self.strange, self.some


def _rows_of_strip(width: int) -> int:
    """Rows of a level that a worker takes at once: a power of two, at least 2."""
    return 1 << max(1, (_TEXELS_PER_PIECE // width).bit_length() - 1)


class _Bake:
    """The state of one bake. Levels are made from fine to coarse, since coarse footprints sum up finer ones."""

    def __init__(self, svbrdf: Svbrdf, options: LearnedOptions, pool: Executor, progress: Progress | None) -> None:
        self.svbrdf, self.options, self.pool, self.progress = svbrdf, options, pool, progress
        self.base, self.filter = base_of(svbrdf), get_pixel_filter(options.pixel_filter)
        network, _ = load_network(weights_path(options.weights, LEARNED))
        up = 2.0 if DENSITY_EXPONENTS[options.density] == 3 else 1.0
        low = 4.0 * math.log(options.min_roughness)
        self.said = network.said(low, options.lobe == "isotropic", options.specular != "held", up)

    def levels(self, levels: list[Level]) -> int:
        """Append all levels; returns how many texels were fitted."""
        sizes = level_sizes(self.svbrdf.size, self.options.levels)
        box = self.options.pixel_filter == "box"
        nested = [box and a == (2 * b[0], 2 * b[1]) for a, b in pairwise(sizes)] + [False]
        fitted, first, tiles = 0, 0, np.zeros(0)
        known = box  # whether the sums of the next level come from the base (level 0) or from ``tiles``
        while first < len(sizes):
            started = time.perf_counter()
            strip = _rows_of_strip(sizes[first][1])
            count = 1
            while known and nested[first + count - 1] and strip >> count >= 2:
                count += 1
            chain = sizes[first : first + count]
            goes_on = nested[first + count - 1]
            pooled = empty_tiles(sizes[first + count]) if goes_on else np.zeros(0)
            made = [_Fresh.of(size) for size in chain]
            self.say(first, chain, strip, tiles, known, pooled, made)
            seconds = time.perf_counter() - started
            for mip_level, fresh in enumerate(made, first):
                began = time.perf_counter()
                level, strange = self.level(mip_level, fresh)
                fitted += strange
                # Levels that are made together share their time by texels.
                share = math.prod(fresh.size) / sum(math.prod(size) for size in chain)
                level.seconds = seconds * share + time.perf_counter() - began
                levels.append(level)
            first, tiles, known = first + count, pooled, goes_on
        return fitted

    def say(
        self, first: int, sizes: Sequence[tuple[int, int]], strip: int, tiles: NDArray, known: bool, pooled: NDArray,
        made: Sequence[_Fresh],
    ) -> None:  # fmt: skip
        """Fill ``made`` with what the network says of levels ``first`` and on, each half the size of the one before.

        A worker takes a strip of rows through all of them, so that sums of footprints stay in the processor's cache.

        Args:
            first: number of the first of the levels.
            sizes: (height, width) of the levels.
            strip: rows of the first level that are worked on at once.
            tiles: sums of the first level's footprints, unless it is level 0 or they are not ``known``.
            known: whether these sums need not be gathered from the base.
            pooled: receives the sums of the level after these, unless it is empty.
            made: the levels.
        """
        gathered = None if known else level_rules(self.filter, self.svbrdf.size, sizes[0], first, get_quality("draft"))
        own = threading.local()

        def between() -> list[NDArray]:
            """Tiles of this worker for the levels after the first."""
            if not hasattr(own, "tiles"):
                own.tiles = [empty_tiles((strip >> k, size[1])) for k, size in enumerate(sizes) if k]
            return own.tiles

        def work(row: int) -> None:
            source, begin = tiles, 0
            if gathered is not None:
                rows = min(strip, sizes[0][0] - row)
                source = gather_tiles(self.base, gathered.strata, gathered.room, row, rows, sizes[0][1])
                begin = row
            targets = [*between(), pooled]
            for k, (height, width) in enumerate(sizes):
                at, target = row >> k, targets[k]
                rows = min(strip >> k, height - at)
                to = row >> (k + 1) if k + 1 < len(sizes) else 0
                say_rows(self.base, source, begin, at, rows, width, self.said, target, to, *made[k].flat)
                source, begin = target, to
                if self.progress is not None:
                    self.progress(first + k, (at + rows) * width, height * width)

        for _ in self.pool.map(work, range(0, sizes[0][0], strip)):
            pass

    def level(self, mip_level: int, made: _Fresh) -> tuple[Level, int]:
        """One level and the number of its texels that were fitted."""
        if mip_level == 0 and self.options.keep_level_0:
            return Level(self.svbrdf.replace(height=None), status=np.full(made.size, KEPT, np.uint8)), 0
        made.output.status[:] = np.where(made.some, CLOSED_FORM, NO_SPECULAR)
        index = np.flatnonzero(made.strange)
        if len(index):
            self._fit(mip_level, made.size, index, made.output)
        image = _image_of(made.output, made.size, self.svbrdf, self.options)
        return Level(image, made.output.status.reshape(made.size)), len(index)

    def _fit(self, mip_level: int, size: tuple[int, int], index: NDArray, output: Output) -> None:
        """Fit the texels ``index`` (flat indices) of a level and write them to ``output``."""
        quality, model = get_quality(self.options.quality), get_model(MODEL)
        lights = sizes_of(LIGHTS, model.blur, model.blur)
        rules = level_rules(self.filter, self.svbrdf.size, size, mip_level, quality, lights=lights)
        search = search_settings(_fit_options(self.options), quality, self.base, model, model)

        def work(first: int) -> None:
            part = index[first : first + _FITS_PER_PIECE]
            fresh = make_output(len(part))
            columns, rows = part % size[1], part // size[1]
            fit_texels(self.base, rules, columns, rows, search, fresh, model_kernels(MODEL, MODEL))
            for mine, theirs in zip(output, fresh, strict=True):
                mine[part] = theirs

        for _ in self.pool.map(work, range(0, len(index), _FITS_PER_PIECE)):
            pass


def _image_of(output: Output, size: tuple[int, int], svbrdf: Svbrdf, options: LobeOptions) -> Svbrdf:
    """The level (height, width) of flat outputs, with averaged occlusion."""
    occlusion = svbrdf.occlusion
    if occlusion is not None:
        chosen = get_pixel_filter(options.pixel_filter)
        occlusion = np.clip(filter_channels(occlusion[..., None], size, chosen, svbrdf.wrap)[..., 0], 0.0, 1.0)
    return Svbrdf(
        normal=output.normal.reshape(*size, 3), log_roughness=output.log_roughness.reshape(*size, 3),
        specular=output.specular.reshape(*size, 3), diffuse=output.diffuse.reshape(*size, 3), model=MODEL,
        wrap=svbrdf.wrap, occlusion=occlusion,
    )  # fmt: skip
