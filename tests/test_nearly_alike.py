"""Footprints whose lobes nearly agree under the smallest light take LEAN's lobe, as good as a lobe searched for."""

import numpy as np
import pytest
from lobe_oracle import normal_of_slopes

from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample
from brdffit.fitting.status import FLAT
from brdffit.halfangle.measure import random_texels
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf
from brdffit.tradeoff.seen import Rule, errors


def waves(alpha, slope, ratio, diffuse):
    """Waves of normals along one diagonal, of width and colour along the other."""
    y, x = np.mgrid[:32, :32] * 2 * np.pi / 16
    lean, wide = slope * np.sin(x + y), ratio ** (0.25 * np.sin(x - y))
    colour = 0.5 + 0.3 * np.stack([np.cos(x + y), np.sin(x + y), 0 * x], -1)
    return Svbrdf(
        normal=normal_of_slopes(0.2 + lean, 0.5 * lean).astype(np.float32),
        log_roughness=log_tensor_from_perceptual((np.sqrt(alpha) * wide).astype(np.float32)),
        specular=colour.astype(np.float32), diffuse=(diffuse * colour[..., ::-1]).astype(np.float32),
    )  # fmt: skip


@pytest.mark.parametrize("quality", ["draft", "standard", "fine"])
@pytest.mark.parametrize("alpha", [0.002, 0.1, 0.5])
@pytest.mark.parametrize("diffuse", [0.0, 0.6])
def test_a_search_would_gain_less_than_what_is_negligible(quality, alpha, diffuse):
    """Against a search by the same rules that may not take the shortcut, on a dense rule of its own."""
    flat = 0
    for turned in (0.02, 0.2, 0.6):
        # In widths under the smallest light, which adds about 0.015 to alpha.
        base = waves(alpha, turned * (alpha + 0.015), 1.2, diffuse)
        sample = LevelSample(base, 1, *random_texels((16, 16), 48, seed=0), FitOptions(quality=quality), threads=1)
        rules, search = sample.settings()
        taken, output = sample.fit(settings=(rules, search))
        searched, other = sample.fit(settings=(rules, search._replace(negligible=-1.0)))
        error = errors(sample, [taken, searched], Rule(1024, (32, 32)))[0]
        # A footprint of one lobe, or one merged lobe, is never searched.
        short = (output.status == FLAT) & (other.status != FLAT)
        flat += short.sum()
        assert (error[0] - error[1])[short].max(initial=0.0) < search.negligible
    assert 0 < flat < 3 * 48
