"""The default fit, under lights with a size, over all cases of the catalogue.

The laws of ``test_laws`` measure by the half-angle error under point lights, which only a fit for point lights
minimises. Here the measure is the default fit's own: the error on a screen (``brdffit.tradeoff.seen``).
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from test_fitting import mirrored, quarter_turn, surface

from brdffit.doctor import MISTAKEN_BY, MISTAKEN_TIMES
from brdffit.fitting.options import FitOptions
from brdffit.fitting.status import FALLBACK, STATUSES
from brdffit.roughness import eigenvalues_of_log
from brdffit.svbrdf import Svbrdf
from brdffit.tradeoff.seen import Rule, errors
from hard_cases.catalogue import CASES, Case, sample_level
from hard_cases.known import KNOWN
from hard_cases.test_laws import UNSEEN, perturbed

#: The wall of a bounded scale, with what float32 rounds.
MOST_SCALE = 1.1 * (1.0 + 1e-4)
#: Nodes for each size of light and samples of the measure.
DENSE = Rule(1024, (16, 32))


def cases_of(law: str) -> pytest.MarkDecorator:
    """Parameters (case, model): each case once, by GGX unless it is another model's; known violations are marked."""
    parameters = []
    for case in CASES:
        model = (case.only or ("ggx",))[0]
        reason = KNOWN.get((law, case.name, model))
        marks = [pytest.mark.xfail(strict=True, reason=reason)] if reason else []
        parameters.append(pytest.param(case, model, marks=marks, id=case.name.replace(" ", "-")))
    return pytest.mark.parametrize("case, model", parameters)


def sample_of(case: Case, model: str, base: Svbrdf | None = None):
    return sample_level(base or case.make(model), case.level, FitOptions(model=model, **case.options))


@cache
def fitted(name: str, model: str):
    """(sample, lobes, output, errors) of a case; several laws ask for them."""
    (case,) = [each for each in CASES if each.name == name]
    sample = sample_of(case, model)
    lobes, output = sample.fit()
    return sample, lobes, output, errors(sample, [lobes], DENSE)[0][0]


@cases_of("seen: within bounds")
def test_lobes_are_finite_and_within_bounds(case, model):
    _, _, output, error = fitted(case.name, model)
    for array in (*output, error):
        assert np.isfinite(array).all()
    major, minor = eigenvalues_of_log(output.log_roughness)
    least = case.options.get("min_roughness", FitOptions().min_roughness)
    assert major.max() <= 1 + 1e-4 and minor.min() >= least**4 * (1 - 1e-4)
    np.testing.assert_allclose(np.linalg.norm(output.normal, axis=1), 1.0, atol=1e-5)
    assert (output.normal[:, 2] > 0).all() and (output.specular >= 0).all()
    assert (output.status < len(STATUSES)).all()
    # Normals below the horizon, which reading lifts, may leave a texel without an answer: it says so.
    assert case.unread or not (output.status == FALLBACK).any()
    if not case.options.keys() & {"pixel_filter", "specular"}:
        assert output.specular.max() <= MOST_SCALE * case.make(model).specular.max()


@cases_of("seen: believed")
def test_the_fit_knows_its_own_error(case, model):
    """What the fit reports as residual is what a dense rule measures: no lobe hides from its nodes."""
    _, _, output, error = fitted(case.name, model)
    assert case.unread or (error <= MISTAKEN_TIMES * output.residual + MISTAKEN_BY).all(), (output.residual, error)


@cases_of("seen: continuous")
def test_lobes_of_a_perturbed_base_serve_the_base_as_well(case, model):
    sample, lobes, _, error = fitted(case.name, model)
    others, _ = sample_of(case, model, perturbed(case.make(model))).fit()
    other = errors(sample, [others], DENSE)[0][0]
    near = np.abs(error - other) <= case.slack * np.maximum(error, other) + UNSEEN
    assert case.unread or near.all(), (error, other)


@pytest.mark.slow
@cases_of("seen: turned")
def test_a_turned_or_mirrored_texture_costs_the_same(case, model):
    """Nodes do not turn with the texture: errors are compared, and only as closely as two rules agree."""
    one, base = fitted(case.name, model)[3].mean(), case.make(model)
    for move, shape in ((quarter_turn, np.rot90), (mirrored, np.fliplr)):
        moved = move(base)
        if base.shape is not None:
            moved = moved.replace(shape=shape(base.shape).copy())
        sample = sample_of(case, model, moved)
        other = errors(sample, [sample.fit()[0]], DENSE)[0][0].mean()
        assert case.unread or abs(one - other) <= 2 * case.slack * max(one, other) + UNSEEN, (one, other)


@pytest.mark.parametrize("width, spread", [(0.03, 0.08), (0.03, 0.15)])
def test_a_search_on_smooth_bumps_of_a_mirror_ends_where_the_best_of_all_starts_does(width, spread):
    """The first step must not lead beyond the best lobe, to where the smallest light shows no difference: one in 16
    of these texels was more than this behind."""
    rng, frequency = np.random.default_rng(0), np.fft.fftfreq(64)
    smooth = np.exp(-0.5 * (frequency[:, None] ** 2 + frequency**2) / width**2)
    slopes = np.fft.ifft2(np.fft.fft2(rng.normal(size=(2, 64, 64))) * smooth).real
    slopes *= spread / slopes.std(axis=(1, 2), keepdims=True)
    base = surface((64, 64), slopes=np.moveaxis(slopes, 0, -1), alpha=0.0026)
    sample = sample_level(base, 2, FitOptions())
    rules, search = sample.settings()
    search = search._replace(within=0.0)  # what the search finds, not what is moved afterwards
    found, _ = sample.fit(settings=(rules, search))
    best, _ = sample.fit(settings=(rules, search._replace(poor=0.0)))
    one, other = errors(sample, [found, best], Rule(512, (16, 32)))[0]
    assert (one > other + 0.02).mean() <= 0.02
