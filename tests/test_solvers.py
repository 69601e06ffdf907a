"""The oracle: never worse than what it is given, the same by two optimisers, on a rule that can be trusted."""

import numpy as np
import pytest

from brdffit.fitting.batch import model_kernels
from brdffit.fitting.method import search_settings
from brdffit.fitting.options import FitOptions
from brdffit.fitting.presets import get_quality
from brdffit.fitting.solvers import ORACLE_NODES, Problem, oracle, solve_nlopt, solve_scipy
from brdffit.halfangle.apparent_lobe import base_of
from brdffit.halfangle.measure import DENSE_SAMPLES, dense_strata, measure_lobes, snr
from brdffit.halfangle.quadrature import lattice
from brdffit.models import get_model
from brdffit.svbrdf import Svbrdf

SIZE, LEVEL = (16, 16), (4, 4)
COLUMNS, ROWS = np.array([0, 1, 2, 3]), np.array([0, 2, 1, 3])

#: Two optimisers at one minimum, in dB: what float32 sums of the error leave open.
SOLVERS_AGREE = 0.01
#: A rule is trusted when twice its nodes and samples change the figure by less than this, in dB.
RULE_TRUSTED = 0.05


def search(**options):
    """The settings of a standard fit of a GGX base."""
    ggx = get_model("ggx")
    return search_settings(FitOptions(lights="point", **options), get_quality("standard"), base_of(bumpy()), ggx, ggx)


def bumpy(spread=0.15, roughness=0.3, seed=3):
    """A coloured base with smooth bumps of this spread of slopes; spread 0 is flat and of one colour."""
    random = np.random.default_rng(seed)
    frequency = np.hypot(*np.meshgrid(*[np.fft.fftfreq(16)] * 2))
    spectrum = np.fft.fft2(random.normal(size=(2, *SIZE))) * np.exp(-20.0 * frequency)
    slopes = np.moveaxis(np.fft.ifft2(spectrum).real, 0, 2)
    slopes = spread * slopes / slopes.std() + (0.1, -0.05)
    normal = np.concatenate([-slopes, np.ones((*SIZE, 1))], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    log_roughness = np.zeros((*SIZE, 3), np.float32)
    log_roughness[..., :2] = 4.0 * np.log(roughness)
    specular = np.tile(np.array([0.9, 0.6, 0.2], np.float32), (*SIZE, 1))
    if spread:
        # Colour that goes with the slope: the best scale is not of the mean colour.
        specular[slopes[..., 0] > 0.1] = 0.1, 0.2, 0.8
    return Svbrdf(normal.astype(np.float32), log_roughness, specular, np.zeros_like(specular))


@pytest.fixture(scope="module")
def kernels():
    return model_kernels("ggx", "ggx")


def ask(svbrdf, kernels, **options):
    options = {"search": search(), "nodes": 1024, "samples": (16, 32)} | options
    return oracle(base_of(svbrdf), SIZE, LEVEL, COLUMNS, ROWS, kernels=kernels, **options)


def decibel(error):
    return -10.0 * np.log10(np.maximum(error, 1e-12))


@pytest.mark.parametrize("roughness", [0.5, 0.15])
def test_two_optimisers_find_one_minimum(kernels, roughness):
    svbrdf = bumpy(roughness=roughness)
    by_nlopt, by_scipy = (ask(svbrdf, kernels, solvers=(name,)) for name in ("nlopt", "scipy"))
    assert decibel(by_nlopt.error) == pytest.approx(decibel(by_scipy.error), abs=SOLVERS_AGREE)
    assert decibel(by_nlopt.error).max() < 40.0  # not so easy that anything would do


def test_never_worse_than_what_it_is_given(kernels):
    """Given lobes, good and bad, are beaten or kept, by the oracle's rule exactly and by the measuring rule nearly."""
    svbrdf = bumpy(roughness=0.1)
    good = ask(svbrdf, kernels, nodes=4096)
    bad = good.theta + np.random.default_rng(1).normal(0.0, 0.3, good.theta.shape) * (1, 1, 1, 1, 1, 0)
    again = ask(svbrdf, kernels, given=np.stack([bad, good.theta]), nodes=4096)
    assert (again.error <= good.error + 1e-7).all()
    lobes, scales = np.stack([bad, again.theta]), np.stack([again.scale, again.scale])
    measured = measure_lobes(base_of(svbrdf), SIZE, LEVEL, lobes, scales, COLUMNS, ROWS, pixel_filter="box", exponent=3,
                             kernels=kernels)  # fmt: skip
    assert snr(measured.error[1]) > snr(measured.error[0])
    assert snr(measured.error[1]) == pytest.approx(snr(again.error), abs=0.1)


def test_a_flat_base_is_recovered(kernels):
    svbrdf = bumpy(spread=0.0)
    found = ask(svbrdf, kernels)
    expected = np.array([0.1, -0.05, 4.0 * np.log(0.3), 4.0 * np.log(0.3), 0.0, 0.0])
    assert found.theta == pytest.approx(np.tile(expected, (4, 1)), abs=2e-3)
    assert found.scale == pytest.approx(np.tile([0.9, 0.6, 0.2], (4, 1)), rel=2e-3)


def test_an_isotropic_search_stays_isotropic(kernels):
    found = ask(bumpy(), kernels, search=search(lobe="isotropic", normal="mean"))
    assert found.theta[:, 2] == pytest.approx(found.theta[:, 3])
    assert found.theta[:, 4] == pytest.approx(np.zeros(4))


def test_the_result_does_not_depend_on_threads(kernels):
    one, two = (ask(bumpy(), kernels, threads=threads) for threads in (1, 2))
    assert np.array_equal(one.theta, two.theta)


@pytest.mark.parametrize("roughness", [0.4, 0.1])
def test_the_rule_of_the_oracle_can_be_trusted(kernels, roughness):
    """Twice the nodes and strata change the SNR of a fixed lobe by less than the figure that is read from it."""
    base = base_of(bumpy(roughness=roughness))
    lobes = ask(bumpy(roughness=roughness), kernels).theta
    figures = []
    for factor in (1, 2):
        samples = tuple(factor * count for count in DENSE_SAMPLES)
        strata = dense_strata(SIZE, LEVEL, "box", samples)
        problem = Problem(strata, lattice(factor * ORACLE_NODES, (0.71, 0.411, 0.093)), search(), kernels)
        errors = []
        for theta, column, row in zip(lobes, COLUMNS, ROWS, strict=True):
            problem.set_footprint(base, column, row)
            errors.append(problem.settle(theta)[0])
        figures.append(snr(np.array(errors)))
    assert figures[0] == pytest.approx(figures[1], abs=RULE_TRUSTED)


def test_gradients_reach_the_optimisers_in_their_own_coordinates(kernels):
    """Both solvers lower the objective from a start that is far off, and end where the scaled gradient vanishes."""
    problem = Problem(dense_strata(SIZE, LEVEL, "box", (16, 32)), lattice(1024), search(), kernels)
    starts = problem.set_footprint(base_of(bumpy()), 1, 2)
    start = starts[0] + np.array([0.2, -0.1, 1.0, -1.0, 0.3, 0.0])
    before = problem.value(start)
    for solve in (solve_nlopt, solve_scipy):
        end = solve(problem, start)
        columns, _ = problem.scaled(end)
        assert problem.value(end) < before
        assert np.abs(problem.gradient @ columns).max() < 2e-3
