"""Contribution of parallax, shadows and interreflection, effects that no map holds, to what a scene's cameras see.

The truth is traced with all three (``microgeometry``) and with each of them off, at points of the sampled texels'
footprints, for pairs of viewer and light drawn as for the rest of a plan. The loss of a picture without an effect is
the squared difference of the two,

    E[(A - a)(B - b)],    A and B two independent estimates with the effect, a and b two without it,

where A and a share their random numbers, so that they differ by the effect alone. It is added to the error of the maps'
lobes (``trial``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.microgeometry.heightfield import HeightField
from brdffit.microgeometry.tracer import Effects, Microgeometry
from brdffit.planning.trial import Errors, Loss, Sample, Shining, loss, timed
from brdffit.svbrdf import Svbrdf

#: Names of the effects, and the settings of the tracer without each.
OFF: dict[str, dict[str, Any]] = {
    "parallax": {"displacement": False},
    "shadowing": {"shadowing": False},
    "interreflection": {"bounces": 0},
}
#: The tracer with all of them on.
BOUNCES = 2
EVERYTHING = Effects(bounces=BOUNCES)
#: Sampled texels of a level, pairs of viewer and light at each (the fewest for lights of one size), and points of its
#: footprint for each half of a pair.
_TEXELS, _PAIRS, _LEAST_PAIRS, _POINTS = 48, 64, 16, 8
#: Points that are timed, points of a traced pixel, and pixels of the pictures of one set in a comparison.
_TIMED, _SAMPLES, _PIXELS = 20000, 64, 5 * 192 * 192
#: Bytes of a neural material for each base texel: two textures of 7 numbers, one of them a pyramid.
_NEURAL_BYTES = 4.0 * 7.0 * (1.0 + 4.0 / 3.0)
_NEURAL_WEIGHTS, _NEURAL_MINUTES, _NEURAL_SIDE = 3332, 10, 512


def effects_without(names: Sequence[str]) -> Effects:
    """The tracer's effects with some off."""
    changes: dict[str, Any] = {}
    for name in names:
        changes |= OFF.get(name, {})
    return replace(EVERYTHING, **changes)


def traced_losses(sample: Sample, found: Errors, names: Sequence[str]) -> tuple[dict[str, Loss], dict[str, float]]:
    """The loss without each named effect, and the seconds that it adds to a comparison's reference pictures.

    Args:
        sample: the texels and directions of a plan.
        found: errors of the lobes at them, with everything on.
        names: of the effects.

    Raises:
        InputError: when the set has no height map.
    """
    field, effects = HeightField.of(sample.base), [effects_without([name] if name else []) for name in ("", *names)]
    errors = Errors([], [])
    for i, level in enumerate(sample.levels):
        # The lobes' own relative error is added to both sides, so that a loss is judged beside it.
        of_lobes = np.maximum(found.error[i][0], 0.0).sum() / max(float(found.reference[i].sum()), 1e-30)
        lost, power = np.zeros((len(names), 1)), np.zeros(1)
        for shining in sample.lights:
            tracers = [Microgeometry(field, each, light_size=2.0 * shining.radius) for each in effects]
            squares = _squares(sample, tracers, level, shining)
            lost, power = lost + shining.share * squares[0], power + shining.share * squares[1]
        errors.error.append(np.concatenate([np.zeros((1, len(power))), lost]) + of_lobes * power)
        errors.reference.append(power)
    losses = {name: loss(errors, m + 1) for m, name in enumerate(names)}
    seconds = _seconds_a_point([Microgeometry(field, each, threads=sample.threads) for each in effects])
    return losses, {name: (seconds[0] - seconds[m + 1]) * _SAMPLES * _PIXELS for m, name in enumerate(names)}


def _squares(sample: Sample, tracers: Sequence[Microgeometry], level: int, shining: Shining) -> tuple[NDArray, NDArray]:
    """Squared differences (M, n) of all later tracers from the first, and the first one's squared radiance (n,)."""
    columns, rows = (each[:_TEXELS] for each in sample.texels[level])
    count, pairs = len(columns), max(_PAIRS // len(sample.lights), _LEAST_PAIRS)
    view, light, weight = shining.draw(count, pairs, 7919 + level, None)
    weight = weight / weight.sum(axis=1, keepdims=True)
    height, width = sample.sizes[level]
    scale = np.array([sample.base.size[1] / width, sample.base.size[0] / height])
    centre = (np.stack([columns, rows], axis=1) + 0.5) * scale
    random = np.random.default_rng(level)
    shape = (count, pairs, _POINTS)
    view, light = (np.broadcast_to(each[:, :, None], (*shape, 3)).reshape(-1, 3) for each in (view, light))
    halves = np.empty((2, len(tracers), count, pairs, 3))
    for half in range(2):
        spread = (random.random((*shape, 2)) - 0.5) * scale
        position = (centre[:, None, None] + spread).reshape(-1, 2)
        for m, tracer in enumerate(tracers):
            radiance = tracer.reflect(position, view, light, 2 * level + half)
            halves[half, m] = radiance.reshape(*shape, 3).mean(axis=2)
    one, other = halves[0, 0] - halves[0, 1:], halves[1, 0] - halves[1, 1:]
    lost = (weight[None, :, :, None] * one * other).sum(axis=(2, 3))
    power = (weight[:, :, None] * halves[0, 0] * halves[1, 0]).sum(axis=(1, 2))
    return lost, np.maximum(power, 0.0)


def _seconds_a_point(tracers: Sequence[Microgeometry]) -> list[float]:
    """Seconds of one sample with each tracer."""
    random = np.random.default_rng(0)
    position = random.random((_TIMED, 2)) * tracers[0].size[::-1]
    towards = random.standard_normal((2, _TIMED, 3))
    towards[..., 2] = np.abs(towards[..., 2]) + 0.2
    towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
    runs = [
        [timed(lambda each=each: each.reflect(position, *towards, 0), each.threads) for each in tracers]  # type: ignore[misc]
        for _ in range(2)
    ]
    return [min(run[m] for run in runs) / _TIMED for m in range(len(tracers))]


def seconds_a_picture(base: Svbrdf, names: Sequence[str], pixels: int, threads: int | None) -> float:
    """Seconds of a traced picture with some effects on."""
    off = [name for name in OFF if name not in names]
    tracer = Microgeometry(HeightField.of(base), effects_without(off), threads=threads)
    return _seconds_a_point([tracer])[0] * _SAMPLES * pixels


def what_maps_lack(
    losses: Mapping[str, Loss], on: Sequence[str], size: tuple[int, int], pixels: int, seconds: float
) -> list[str]:
    """Sentences of a plan on the traced effects that are on: what no map shows, and what it would cost to show it.

    Args:
        losses: measured. on: effects that the scene calls for.
        size: (height, width) of the set.
        pixels: of a picture of the scene. seconds: of tracing it.
    """
    called = [f"{name} ({losses[name].db:.1f} dB)" for name in on if name in losses]
    if not called:
        return []
    texels = min(math.prod(size), _NEURAL_SIDE**2)
    megabytes = (texels * _NEURAL_BYTES + 4 * _NEURAL_WEIGHTS) / 2**20
    return [
        f"No map shows {', '.join(called)}: whatever is baked looks flat there. A neural material shows it for some "
        f"{_NEURAL_MINUTES} minutes of training and {megabytes:.1f} MiB (brdffit neural train); the height traced as "
        f"it is takes about {seconds:.0f} s a picture of {pixels / 1e6:.1f} megapixels, {_SAMPLES} samples each."
    ]
