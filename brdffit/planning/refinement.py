"""Contribution and cost of the refinement for interpolation, tried on small crops since it moves whole levels."""

from __future__ import annotations

import dataclasses
import math
import time

import numpy as np

from brdffit.fitting.options import FitOptions
from brdffit.machine import core_count
from brdffit.methods import DEFAULT, Material, get_method
from brdffit.planning.trial import UNSEEN, Loss
from brdffit.render.lights import Lights
from brdffit.render.pictures import render_appearance
from brdffit.render.reference import render_halves
from brdffit.render.scenes import plane
from brdffit.svbrdf import Svbrdf, level_sizes

#: Crops, their side in texels of the finest level that is reached, and the picture's side in pixels.
_CROPS, _SIDE, _PIXELS = 3, 16, 20


def try_refinement(
    base: Svbrdf, options: FitOptions, reach: tuple[int, int], lights: Lights | None, seed: int
) -> tuple[Loss, float]:
    """Loss without refinement, between texels and halfway between the two finest levels; seconds that it costs.

    Args:
        base: the set. options: of the bake, everything else on. reach: first and last level.
        lights: of the scene; None: a few small ones. seed: of the crops.
    """
    level = min(reach[0], len(level_sizes(base.size)) - 2)
    if level < 0:
        return Loss(0.0, 0.0), 0.0
    random = np.random.default_rng(seed)
    side = [min(size, _SIDE << level) for size in base.size]
    losses, seconds = [], []
    for _ in range(_CROPS):
        crop = _crop(base, side, random)
        shift = random.random(2)
        scene = plane(crop.size, level + 0.5, (_PIXELS, _PIXELS), shift=(float(shift[0]), float(shift[1])))
        truth = render_halves(crop, scene, lights, samples="draft").halves.astype(np.float64)
        error, took = [], []
        for refine in (True, False):
            asked = dataclasses.replace(
                options, refine=refine, tolerance=None, levels=level + 2, reach=(level, level + 1), keep_level_0=False
            )
            start = time.process_time()
            baked = get_method(DEFAULT).bake(Material(crop), asked)
            took.append((time.process_time() - start) / (options.threads or core_count()))
            picture = render_appearance(baked.appearance, scene, lights).astype(np.float64)
            error.append(float(np.sum((picture - truth[0]) * (picture - truth[1]))))
        square = max(float(np.sum(truth[0] * truth[1])), 1e-30)
        with_it, without = (max(each / square, 0.0) + UNSEEN for each in error)
        losses.append(10.0 * math.log10(without / with_it))
        texels = sum(math.prod(size) for size in level_sizes(crop.size, level + 2)[level:])
        seconds.append(max(took[0] - took[1], 0.0) / texels)
    reached = sum(math.prod(size) for size in level_sizes(base.size)[reach[0] : reach[1] + 1])
    return Loss(float(np.mean(losses)), float(np.std(losses)) / math.sqrt(_CROPS)), float(np.median(seconds)) * reached


def _crop(base: Svbrdf, side: list[int], random: np.random.Generator) -> Svbrdf:
    """A random part of this (height, width), its border clamped."""
    at = [int(random.integers(0, size - length + 1)) for size, length in zip(base.size, side, strict=True)]
    cut = tuple(slice(begin, begin + length) for begin, length in zip(at, side, strict=True))
    arrays = {name: np.ascontiguousarray(array[cut]) for name, array in base.arrays().items()}
    return base.replace(**arrays, wrap="clamp")
