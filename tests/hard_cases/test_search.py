"""A search for violations: random footprints of every kind that a texture may hold, through the same laws.

The quick search keeps away from a known weakness, so that others are seen; the slow one has it in, and counts.
"""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lobe_oracle import MODELS
from test_fitting import surface

from brdffit.doctor import MISTAKEN_BY, MISTAKEN_TIMES
from brdffit.fitting.options import FitOptions
from brdffit.fitting.status import FALLBACK, ITERATION_LIMIT, NO_SPECULAR, PRECISION_LIMIT, REFINED, STATUSES
from brdffit.models import get_model
from brdffit.roughness import eigenvalues_of_log
from brdffit.svbrdf import Svbrdf
from brdffit.textures import encoding
from hard_cases.catalogue import FLOOR, NEEDLES, sample_level
from hard_cases.closed_form import measure_beside_start

#: What the rule of a fit and of the measure may differ by where nothing is hard.
RULES = 5e-3
#: One footprint in so many may be worse than its start, or than the fit believes: needles, seen by two rules. With the
#: known weakness in (roughness that changes more between two texels than two samples can tell) it is more of them.
RARE, RARE_WILD = 100, 50
DENSE = {"nodes": 2048, "samples": (16, 32)}


@st.composite
def bases(draw, wild: bool) -> tuple[Svbrdf, FitOptions]:
    """A base of 16 texels with random normals, roughness, colours; and options of a bake."""
    model = draw(st.sampled_from(MODELS))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size = (4, 4)
    spread = draw(st.sampled_from([0.0, 1e-3, 0.01, 0.1, 0.3, 0.7]))
    tilt = draw(st.sampled_from([0.0, 0.5, 3.0] if wild else [0.0, 0.5]))
    slopes = rng.normal(0, 1, (*size, 2)) * spread + tilt * rng.normal(0, 1, 2)
    sharpest = draw(st.sampled_from([FLOOR, 0.01, 0.05, 0.2, 0.6]))
    widest = draw(st.sampled_from([1.0, 1.5, 10.0, 500.0] if wild else [1.0, 1.5, 5.0]))
    base = surface(size, slopes=slopes, model=model)
    alpha = np.minimum(sharpest * widest ** rng.random(size), 0.95 if wild else 0.6)
    base.log_roughness[..., :2] = 2.0 * np.log(alpha)[..., None]
    if draw(st.booleans()) and not get_model(model).isotropic:
        # Along one axis down to the floor, along the other up to 1.
        wide = rng.random(size) * -2.0 * np.log(alpha) * 0.5
        base.log_roughness[..., 0] += wide
        base.log_roughness[..., 1] -= np.minimum(wide, 2.0 * np.log(alpha / FLOOR))
    dark = draw(st.sampled_from([0.0, 0.5, 0.95]))
    colours = rng.random((*size, 3)) if draw(st.booleans()) else np.repeat(rng.random((*size, 1)), 3, axis=2)
    base.specular[:] = colours * (rng.random((*size, 1)) >= dark) * 10.0 ** draw(st.integers(-4, 2))
    if get_model(model).shape_bounds and draw(st.booleans()):
        low, _, high = get_model(model).shape_bounds
        base = base.replace(shape=rng.uniform(low, high, size).astype(np.float32))
    options = FitOptions(
        lights="point",
        model=model,
        pixel_filter=draw(st.sampled_from(["box", "box", "gaussian", "mitchell"])),
        specular=draw(st.sampled_from(["free", "free", "held"])),
    )
    return base.replace(normal=encoding.unit_normals(base.normal)[0]), options


class Tally:
    """What a search has seen."""

    def __init__(self) -> None:
        self.footprints = self.worse = self.mistaken = 0
        self.worst = 0.0
        self.statuses = np.zeros(len(STATUSES), int)

    def __str__(self) -> str:
        named = {name: int(count) for (name, _), count in zip(STATUSES, self.statuses, strict=True) if count}
        return (
            f"{self.footprints} random footprints, {self.worse} worse than their start (by {self.worst:.3f}), "
            f"{self.mistaken} worse than the fit believes: {named}"
        )


def check(base: Svbrdf, options: FitOptions, tally: Tally) -> None:
    """Finite, within bounds, and no worse than the start but for rare needles; noted in the tally."""
    sample = sample_level(base, 1, options)
    lobes, output = sample.fit()
    for array in output:
        assert np.isfinite(array).all()
    major, minor = eigenvalues_of_log(output.log_roughness)
    assert major.max() <= 1 + 1e-4 and minor.min() >= options.min_roughness**4 * (1 - 1e-4)
    assert (output.normal[:, 2] > 0).all() and (output.specular >= 0).all()
    (error,), start = measure_beside_start(sample, [lobes], **DENSE)
    assert np.isfinite(error).all()
    excess = error - start * (1 + NEEDLES) - RULES
    tally.footprints += len(sample)
    tally.statuses += np.bincount(output.status, minlength=len(STATUSES))
    tally.worse += int((excess > 0).sum())
    own = output.residual.astype(np.float64)
    tally.mistaken += int((error > MISTAKEN_TIMES * own + MISTAKEN_BY)[output.status != NO_SPECULAR].sum())
    tally.worst = max(tally.worst, float(excess.max()))


def search(examples: int, wild: bool) -> Tally:
    tally = Tally()

    @settings(max_examples=examples, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True,
              database=None)  # fmt: skip
    @given(bases(wild))
    def tried(drawn):
        check(*drawn, tally)

    tried()
    return tally


def judge(tally: Tally, rare: int) -> None:
    assert tally.worse * rare <= tally.footprints, str(tally)
    assert tally.mistaken * rare <= tally.footprints, str(tally)
    assert not tally.statuses[ITERATION_LIMIT] * RARE > tally.footprints, str(tally)
    assert not tally.statuses[FALLBACK] * RARE > tally.footprints, str(tally)
    assert not tally.statuses[PRECISION_LIMIT] * 10 > tally.footprints, str(tally)
    assert tally.statuses[REFINED] > 0


def test_random_footprints():
    tally = search(40, wild=False)
    assert tally.footprints >= 160
    judge(tally, RARE)


@pytest.mark.slow
def test_thousands_of_random_footprints(capsys):
    tally = search(1500, wild=True)
    with capsys.disabled():
        sys.stdout.write(f"\n{tally}\n")
    assert tally.footprints >= 6000
    judge(tally, RARE_WILD)
