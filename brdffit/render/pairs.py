"""The papers' error: squared error of radiance over random pairs of light and viewer, at some texels of a level.

Unlike the half-angle error it takes the whole BRDF, or the terms that are switched on. With the lobe alone and
cosine-distributed directions both errors are equal, computed in two ways.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import Truth
from brdffit.errors import InputError
from brdffit.footprint import get_pixel_filter
from brdffit.methods import one_of
from brdffit.models import get_model
from brdffit.models.microfacet import brdf
from brdffit.render import _kernels
from brdffit.render._footprints import Budget, Rule, footprint_keys, run_in_threads, sample_count, strata_rule
from brdffit.render._packing import pack_base, pair_loop, shading_kernels
from brdffit.render.points import points_in_strata
from brdffit.render.terms import Terms
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf

#: Samples of a footprint, by preset: pairs of directions share them, so they may be many.
SAMPLES = {"draft": 2048, "standard": 16384, "fine": 131072}
#: The same of a truth that is no SVBRDF: every pair takes points of its own.
POINTS = {"draft": 32, "standard": 256, "fine": 2048}


def pair_errors(
    truth: Svbrdf | Truth,
    levels: Sequence[Svbrdf],
    columns: NDArray,
    rows: NDArray,
    pairs: int = 256,
    seed: int = 0,
    terms: Terms = Terms(),  # noqa: B008
    pixel_filter: str = "box",
    samples: int | str | None = None,
    threads: int | None = None,
    size: tuple[int, int] | None = None,
    directions: tuple[NDArray, NDArray, NDArray] | None = None,
) -> tuple[NDArray, NDArray]:
    """Mean squared error of M versions of one level at n texels, over random pairs of light and viewer.

    l and v are independent and cosine-distributed about the plane's normal, or as ``directions`` say. The truth is
    estimated twice, independently, and the error is the mean of (M - A)(M - B): its own noise adds nothing on average
    (so a single texel's error may come out slightly negative; read means over texels).

    Args:
        truth: the full-resolution SVBRDF, or any ``Truth``.
        levels: M versions of one level, all of one size and one lobe model.
        columns, rows: (n,) integer texels of the level.
        pairs: how many pairs at each texel.
        seed: of the pairs; every version sees the same ones.
        terms: terms of the BRDF that are lit, all of them if the truth is no SVBRDF; radiance is of a light of
            irradiance 1 (facing it).
        pixel_filter: of the truth.
        samples: of a footprint: "draft", "standard", "fine" or their number.
        threads: worker threads; the result does not depend on it.
        size: (height, width) of the level where ``levels`` hold these texels alone, as (n, 1) images in their order.
        directions: view (n, Q, 3), light (n, Q, 3) and weight (n, Q) of Q pairs at each texel instead of random ones:
            unit vectors in the tangent space of the mean plane; the weights count relative to their sum at a texel.
            ``pairs`` and ``seed`` then say nothing.

    Returns:
        (M, n) float64 squared errors, the sum over colour channels; (n,) float64 squared reference. The SNR over a
        level is 10 log10 (sum of reference / sum of errors), or -10 log10 of the mean of their quotients, which is
        ``halfangle.measure.snr``.
    """
    if not isinstance(samples, int):
        presets = SAMPLES if isinstance(truth, Svbrdf) else POINTS
        samples = presets[one_of("number of samples", samples or "standard", tuple(presets))]
    budget = Budget.of(samples)
    columns, rows = np.asarray(columns, np.int64), np.asarray(rows, np.int64)
    lobes_at = (columns, rows) if size is None else (np.zeros(len(columns), np.int64), np.arange(len(columns)))
    size = size or levels[0].size
    scale = truth.size[1] / size[1], truth.size[0] / size[0]
    place = np.zeros((len(columns), 6))
    place[:, 0], place[:, 1] = (columns + 0.5) * scale[0], (rows + 0.5) * scale[1]
    place[:, 2], place[:, 5] = scale
    key = footprint_keys(place)
    rule = strata_rule(get_pixel_filter(pixel_filter), *sample_count(place[:1], budget)[0].tolist())
    if directions is None:
        view, light = _directions(np.random.default_rng(seed), len(columns), pairs)
        weight = np.full(view.shape[:2], 1.0 / pairs)
    else:
        view, light, weight = (np.ascontiguousarray(each, np.float64) for each in directions)
        weight = weight / weight.sum(axis=1, keepdims=True)
    if not isinstance(truth, Svbrdf):
        if terms != Terms():
            raise InputError("Only an SVBRDF can be rendered without some terms of its BRDF.")
        return _errors_by_points(truth, levels, lobes_at, place, key, rule, view, light, weight)
    packed, loop, model = pack_base(truth), pair_loop(), get_model(levels[0].model)
    lobes = _lobes(levels, lobes_at[0], lobes_at[1], model.log_normalisation)
    error, square = np.zeros((len(levels), len(columns))), np.zeros(len(columns))
    log_normalisation, shade = shading_kernels(truth.model, terms)
    other_shade = shading_kernels(model.name, terms)[1]

    def work(i: int) -> int:
        part = slice(i, i + 1)
        found = np.zeros((len(levels), 1))
        loop(
            packed.texels, packed.levels[0], packed.roughness_kind, packed.has_shape, packed.tile, place[part],
            key[part], view[part], light[part], weight[part], *rule, lobes[part], found, square[part],
            log_normalisation, shade, other_shade,
        )  # fmt: skip
        error[:, part] = found
        return 1

    run_in_threads(work, [(i,) for i in range(len(columns))], threads, None, len(columns))
    return error, square


def _errors_by_points(
    truth: Truth, levels: Sequence[Svbrdf], at: tuple[NDArray, NDArray], place: NDArray, key: NDArray, rule: Rule,
    view: NDArray, light: NDArray, weight: NDArray,
) -> tuple[NDArray, NDArray]:  # fmt: skip
    """``pair_errors`` of any truth: each pair looks at points of its own, one in each stratum of the footprint."""
    error, square = np.zeros((len(levels), len(key))), np.zeros(len(key))
    strata = np.outer(rule.weight_y, rule.weight_x).ravel()
    pairs = view.shape[1]
    white = np.ones((pairs * len(strata), 3))
    for i in range(len(key)):
        halves = np.zeros((2, pairs, 3))
        for half in (0, 1):
            points = points_in_strata(
                truth, np.broadcast_to(place[i], (pairs, 6)), key[i] + 65537 * np.arange(pairs), view[i], rule,
                np.arange(len(strata)), half, np.random.default_rng([i, half]),
            )  # fmt: skip
            reflected = points.reflected(np.repeat(light[i], len(strata), axis=0), white)
            halves[half] = np.einsum("s,psc->pc", strata, reflected.reshape(pairs, -1, 3))
        square[i] = weight[i] @ (halves[0] * halves[1]).sum(axis=1)
        for m, level in enumerate(levels):
            lobe = _radiance_of_lobe(level, at[0][i], at[1][i], view[i], light[i])
            error[m, i] = weight[i] @ ((lobe - halves[0]) * (lobe - halves[1])).sum(axis=1)
    return error, square


def _radiance_of_lobe(level: Svbrdf, column: int, row: int, view: NDArray, light: NDArray) -> NDArray:
    """(Q, 3) that one texel sends to ``view`` (Q, 3) under a light of irradiance 1 from ``light`` (Q, 3)."""
    arrays = level.normal, tensor_from_log(level.log_roughness), level.specular, level.diffuse
    normal, tensor, specular, diffuse = (np.broadcast_to(each[row, column], (len(view), 3)) for each in arrays)
    shape = None if level.shape is None else np.full(len(view), level.shape[row, column], np.float32)
    return brdf(normal, tensor, specular, diffuse, view, light, model=level.model, shape=shape).astype(np.float64)


def _directions(random: np.random.Generator, texels: int, pairs: int) -> tuple[NDArray, NDArray]:
    """(view, light), each (n, Q, 3) float64, cosine-distributed."""
    u = random.random((2, texels, pairs, 2))
    radius, angle = np.sqrt(u[..., 0]), 2.0 * math.pi * u[..., 1]
    both = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - u[..., 0])], axis=-1)
    return both[0], both[1]


def _lobes(levels: Sequence[Svbrdf], columns: NDArray, rows: NDArray, log_normalisation) -> NDArray:  # type: ignore[no-untyped-def]
    """Blocks (n, M, BLOCK_ROWS, 1) float32 of the lobes of M levels at n texels."""
    default = get_model(levels[0].model).default_shape
    out = np.zeros((len(columns), len(levels), _kernels.BLOCK_ROWS, 1), np.float32)
    for m, level in enumerate(levels):
        texels = np.zeros((len(columns), _kernels.PACKED), np.float32)
        for place, array in (
            (_kernels.P_NORMAL, level.normal), (_kernels.P_ROUGHNESS, level.log_roughness),
            (_kernels.P_SPECULAR, level.specular), (_kernels.P_DIFFUSE, level.diffuse),
        ):  # fmt: skip
            texels[:, place : place + 3] = array[rows, columns]
        texels[:, _kernels.P_SHAPE] = default if level.shape is None else level.shape[rows, columns]
        scale = np.array([math.exp(log_normalisation(float(s))[0]) for s in texels[:, _kernels.P_SHAPE]])
        block = np.zeros((_kernels.BLOCK_ROWS, len(columns)), np.float32)
        _kernels.place_samples(texels, len(columns), _kernels.LOG_TENSOR, 0.0, np.ones(len(columns)), scale, block)
        out[:, m, :, 0] = block.T
    return out
