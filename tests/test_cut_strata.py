"""Strata that are cut into samples stay within the texels that they lie between."""

import numpy as np
import pytest

from brdffit.fitting.batch import make_workplace
from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample
from brdffit.halfangle.apparent_lobe import gather_lobes
from brdffit.halfangle.quadrature import ALPHA_SQUARED
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
