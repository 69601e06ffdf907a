"""Strata that are cut into samples stay within the texels that they lie between, and strata see all between them."""

import numpy as np
import pytest
from lobe_oracle import box_footprint
from test_fitting import surface

from brdffit.fitting.batch import make_workplace
from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample
from brdffit.halfangle.apparent_lobe import gather_lobes
from brdffit.halfangle.quadrature import ALPHA_SQUARED, MIXTURE, SPREAD
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf


@pytest.mark.parametrize("level", [2, 4, 6])
def test_no_lobe_is_sharper_than_the_sharpest_texel(level):
    """Normals and roughness leap from texel to texel; at level 6 of 64 texels a stratum is as wide as a texel."""
    random = np.random.default_rng(3)
    size = (64, 64)
    slope = 0.6 * random.standard_normal((*size, 2))
    normal = np.concatenate([slope, np.ones((*size, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    roughness = np.where(random.random(size) < 0.5, 0.05, 1.0).astype(np.float32)
    colour = np.full((*size, 3), 0.04, np.float32)
    base = Svbrdf(normal.astype(np.float32), log_tensor_from_perceptual(roughness), colour, 0.0 * colour)
    sample = LevelSample(base, level, np.array([0]), np.array([0]), FitOptions())
    rules, search = sample.settings(FitOptions())
    scratch, _ = make_workplace(rules)
    count, _ = gather_lobes(
        sample.base, rules.strata, search.step, 0, 0, scratch.lobes[0][: len(scratch.lobes[0]) - 4], scratch.moment
    )
    alpha_squared = scratch.lobes[0][:count, ALPHA_SQUARED]
    assert np.isfinite(alpha_squared).all()
    assert alpha_squared.min() > 0.999 * 0.05**4 and alpha_squared.max() < 1.001


@pytest.mark.parametrize("quality", ["draft", "standard"])
@pytest.mark.parametrize("level", [2, 4, 6])
def test_normals_spread_as_the_interpolated_map_has_them(level, quality):
    """Interpolation leaves 4/9 of the variance of independent texels: strata that stand on texel centres see all of it.

    Draft has strata as wide as a texel at level 4, standard at level 6. The variance of n samples errs by about
    sqrt(2 / n) of itself, and parts that a sample stands for hold up to a tenth.
    """
    base = surface((128, 128), alpha=0.3, spread=0.2)
    sample = LevelSample(base, level, np.array([0]), np.array([0]), FitOptions(quality=quality))
    rules, search = sample.settings()
    scratch, _ = make_workplace(rules)
    count, _ = gather_lobes(sample.base, rules.strata, search.step, 0, 0, scratch.lobes[0], scratch.moment)
    found, weights = scratch.lobes[0][:count, :3], scratch.lobes[0][:count, MIXTURE]
    _, normals, _, _ = box_footprint(base, sample.size, 0, 0, samples=8 * 2**level)
    spread = (weights @ (found[:, :2] - weights @ found[:, :2]) ** 2).sum()
    assert spread == pytest.approx(normals[:, :2].var(axis=0).sum(), rel=0.1 + 3 * (2 / count) ** 0.5)


@pytest.mark.parametrize("level", [3, 4, 5])
def test_scattered_samples_see_all_normals_and_stand_for_few(level):
    """Mirrors whose normals leap: no stratum is cut, no sample is widened by more than ``step`` widths along an axis,
    and together they see the normals of the map."""
    base = surface((128, 128), alpha=0.03, spread=0.2)
    sample = LevelSample(base, level, np.array([0]), np.array([0]), FitOptions())
    rules, search = sample.settings()
    assert rules.strata.scatter and not sample.settings(FitOptions(lights="point"))[0].strata.scatter
    scratch, _ = make_workplace(rules)
    count, _ = gather_lobes(sample.base, rules.strata, search.step, 0, 0, scratch.lobes[0], scratch.moment)
    assert count <= rules.strata.samples
    lobes = scratch.lobes[0][:count]
    # Twice the variance step^2 / 12 of an even spread along each axis, in widths under the smallest light; interpolated
    # normals are shorter than 1, so that they turn a little more.
    widest = search.step**2 / 3 * (lobes[:, ALPHA_SQUARED] + rules.strata.light)
    assert (lobes[:, SPREAD] + lobes[:, SPREAD + 1] <= 1.2 * widest).all()
    found, weights = lobes[:, :3], lobes[:, MIXTURE]
    assert weights.sum() == pytest.approx(1.0)
    _, normals, _, _ = box_footprint(base, sample.size, 0, 0, samples=8 * 2**level)
    spread = (weights @ (found[:, :2] - weights @ found[:, :2]) ** 2).sum()
    assert spread == pytest.approx(normals[:, :2].var(axis=0).sum(), rel=3 * (2 / count) ** 0.5)


def test_parts_of_a_wide_turn_turn_alike():
    """Mirrors at 56 degrees to either side: between texels the normal turns three times as fast in the middle as at the
    ends. No part turns by more than ``step`` widths, and the parts together have the normals of the map."""
    slopes = np.zeros((8, 8, 2))
    slopes[:, ::2, 0], slopes[:, 1::2, 0] = 1.5, -1.5
    base = surface((8, 8), slopes=slopes, alpha=0.004)
    sample = LevelSample(base, 1, np.array([1]), np.array([1]), FitOptions())
    rules, search = sample.settings()
    scratch, _ = make_workplace(rules)
    count, _ = gather_lobes(sample.base, rules.strata, search.step, 1, 1, scratch.lobes[0], scratch.moment)
    lobes = scratch.lobes[0][:count]
    weights = lobes[:, MIXTURE]
    assert weights.sum() == pytest.approx(1.0)
    widest = search.step**2 / 6 * (lobes[:, ALPHA_SQUARED] + rules.strata.light)
    assert (lobes[:, SPREAD] + lobes[:, SPREAD + 1] <= 1.02 * widest).all()
    _, normals, _, _ = box_footprint(base, sample.size, 1, 1, samples=400)
    for bound in (0.1, 0.3, 0.6):
        share = (np.abs(normals[:, 0]) < bound).mean()
        assert weights[np.abs(lobes[:, 0]) < bound].sum() == pytest.approx(share, abs=0.02)
