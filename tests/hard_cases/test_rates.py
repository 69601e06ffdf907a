"""How often the rare branches of the fit are taken on real sets: counted, and rare indeed.

The sets lie beside the checkout, not in it; without them everything here is skipped.
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample
from brdffit.fitting.status import FALLBACK, ITERATION_LIMIT, PRECISION_LIMIT, REFINED, STATUSES
from brdffit.halfangle.measure import random_texels
from brdffit.svbrdf import level_sizes
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.reading import read_texture_set

MATERIALS = Path(__file__).parents[3] / "shared" / "materials"
SETS = sorted(path.name for path in MATERIALS.iterdir() if path.is_dir()) if MATERIALS.is_dir() else []
#: Side of the crop; texels of each of its levels.
CROP, TEXELS = 256, 1024
#: Largest share of a set's texels that may end so, by quality.
RATES = {
    "standard": {FALLBACK: 0.0, ITERATION_LIMIT: 2e-3, PRECISION_LIMIT: 0.02, REFINED: 0.4},
    "draft": {FALLBACK: 2e-3, ITERATION_LIMIT: 0.02, PRECISION_LIMIT: 0.02, REFINED: 0.4},
}

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not SETS, reason="no real texture sets in ../shared/materials")]


@cache
def crop(name):
    base = to_svbrdf(read_texture_set(MATERIALS / name))
    return base.replace(**{key: np.ascontiguousarray(array[:CROP, :CROP]) for key, array in base.arrays().items()})


@pytest.mark.parametrize("quality", RATES)
@pytest.mark.parametrize("name", SETS or ["none"])
def test_rare_branches_are_rare(name, quality, capsys):
    base = crop(name)
    counts = np.zeros(len(STATUSES), int)
    for level, size in enumerate(level_sizes(base.size, 6)):
        sample = LevelSample(
            base, level, *random_texels(size, TEXELS, level), FitOptions(lights="point", quality=quality), threads=2
        )
        _, output = sample.fit()
        counts += np.bincount(output.status, minlength=len(STATUSES))
    named = {name: int(count) for (name, _), count in zip(STATUSES, counts, strict=True) if count}
    with capsys.disabled():
        sys.stdout.write(f"\n{name}, {quality}: {counts.sum()} texels, {named}\n")
    for status, rate in RATES[quality].items():
        assert counts[status] <= rate * counts.sum(), named
