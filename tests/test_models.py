"""Laws of the lobe models: normalisation, limits, derivatives, and the polynomials they are made of."""

import math

import numpy as np
import pytest
from lobe_oracle import MODELS, lobe, log_tensor_of, log_tensor_scale, normal_of_slopes, slope_rule
from scipy import special

from brdffit.errors import UnknownNameError
from brdffit.fitting.batch import model_kernels
from brdffit.halfangle.quadrature import NODE_ROWS
from brdffit.models import get_model, model_names
from brdffit.models.ashikhmin_shirley import log_quotient
from brdffit.models.elementary import exp_negative, log_positive

ALPHAS = [0.002, 0.01, 0.1, 0.5, 1.0]
#: The polynomial exp and log of float64 kernels are good to 2e-7, and an exponent of 80 multiplies log's error.
POLYNOMIAL = 2e-6
#: Rounding of a handful of float32 operations on q and C near 1.
SINGLE = 2e-6
#: A float32 half vector knows n.h to 6e-8; a lobe of alpha 0.002 turns an angle of 6e-8 into 3e-5 of its width.
NODE_POSITION = 2e-3
#: exp of less than -32 is 0: 1e-14, times C^-3 and the exponent of what it is multiplied with at C = 0.05.
FADED = 1e-8

models = pytest.mark.parametrize("model", MODELS)


def shapes_of(model):
    return get_model(model).shape_bounds or (0.0,)


def kernel_values(model, h, slopes, log_tensor, shape, width=64):
    """D(h) by the program's kernel."""
    kernels = model_kernels(model, model, width)
    real = np.float64 if width == 64 else np.float32
    nodes = np.zeros((NODE_ROWS, len(h)), real)
    nodes[:3] = h.T
    values = np.zeros(len(h), real)
    kernels.values.disable_compile()
    theta = np.array([*slopes, *log_tensor, shape], dtype=np.float64)
    kernels.values(theta, nodes, kernels.log_normalisation, values, np.zeros(16))
    return values


def test_models_are_found_by_name_and_the_default_comes_first():
    assert sorted(model_names()) == sorted(MODELS)
    assert model_names()[0] == "ggx"
    with pytest.raises(UnknownNameError, match="did you mean 'ggx'"):
        get_model("gxx")


@models
@pytest.mark.parametrize("alpha", ALPHAS)
def test_projected_area_is_one(model, alpha):
    for shape in shapes_of(model):
        for slopes in ((0.0, 0.0), (0.6, -1.1)):
            log_tensor = log_tensor_of(alpha, alpha)
            normal = normal_of_slopes(*slopes)
            h, weight = slope_rule(normal, log_tensor)
            values = kernel_values(model, h, slopes, log_tensor, shape)
            assert np.sum(weight * values * (h @ normal)) == pytest.approx(1.0, abs=POLYNOMIAL)


@pytest.mark.parametrize("model", [name for name in MODELS if name != "blinn-phong"])
@pytest.mark.parametrize("ratio", [3.0, 30.0, 1000.0])
def test_projected_area_is_one_however_anisotropic(model, ratio):
    for major in (1.0, 0.3):
        log_tensor = log_tensor_of(major, major / ratio, 0.7)
        normal = normal_of_slopes(0.4, 0.2)
        h, weight = slope_rule(normal, log_tensor)
        for shape in shapes_of(model):
            values = kernel_values(model, h, (0.4, 0.2), log_tensor, shape)
            # An alpha of 3e-4 leaves sums of float64 cosines 1e-9 of its width; that is not what limits.
            assert np.sum(weight * values * (h @ normal)) == pytest.approx(1.0, abs=POLYNOMIAL)


@models
@pytest.mark.parametrize("width, tolerance", [(64, POLYNOMIAL), (32, NODE_POSITION)])
def test_kernels_agree_with_the_papers(model, width, tolerance):
    rng = np.random.default_rng(1)
    for alpha in ALPHAS:
        angle, ratio = (0.0, 1.0) if get_model(model).isotropic else (rng.uniform(0, 3), 4.0)
        log_tensor = log_tensor_of(alpha, alpha / ratio, angle)
        slopes = rng.normal(0, 0.5, 2)
        normal = normal_of_slopes(*slopes)
        h, _ = slope_rule(normal, log_tensor, 90, 7)
        for shape in shapes_of(model):
            expected = lobe(model, h, normal, log_tensor, shape)
            found = kernel_values(model, h, slopes, log_tensor, shape, width)
            # Relative to the peak; a kernel goes on below the lobe's own horizon, the papers' lobe does not.
            above = h @ normal > 2e-3
            np.testing.assert_allclose(found[above], expected[above], atol=tolerance * expected.max(), rtol=0)


@pytest.mark.parametrize("exponent", [1.0, 2.0, 100.0, 1e5])
def test_ashikhmin_shirley_with_equal_exponents_is_blinn_phong(exponent):
    alpha = math.sqrt(2 / (exponent + 2))
    log_tensor = log_tensor_of(alpha, alpha)
    assert 2 / log_tensor_scale(log_tensor) - 2 == pytest.approx(exponent)
    cos = np.linspace(0.01, 1.0, 300) ** (1 / max(exponent, 1))
    h = np.stack([np.sqrt(1 - cos**2), 0 * cos, cos], axis=-1)
    expected = (exponent + 2) / (2 * math.pi) * cos**exponent
    for model in ("ashikhmin-shirley", "blinn-phong"):
        found = kernel_values(model, h, (0.0, 0.0), log_tensor, 0.0)
        np.testing.assert_allclose(found, expected, atol=POLYNOMIAL * expected.max())


def test_generalised_beckmann_at_one_is_beckmann():
    generalised, beckmann = get_model("generalised-beckmann"), get_model("beckmann")
    for q, C in np.random.default_rng(2).random((200, 2)):
        assert generalised.profile(q, C, 0.0) == pytest.approx(
            beckmann.profile(q, C, 0.0), rel=POLYNOMIAL * 80, abs=1e-9
        )
    assert generalised.log_normalisation(0.0)[0] == pytest.approx(0.0, abs=1e-12)


def test_ashikhmin_shirley_where_the_exponent_is_zero_over_zero():
    # (n.h) -> 1: L tends to -1 and its slope to 1/2; the oracle is log1p, which has no such trouble.
    v = np.concatenate([[0.0], np.logspace(-12, math.log10(0.999), 400), [0.0999999, 0.1, 0.1000001]])
    for each in v:
        quotient, slope = log_quotient(1.0 - each)
        back = 1.0 - (1.0 - each)
        expected = np.log1p(-back) / back if back > 0 else -1.0
        assert quotient == pytest.approx(expected, rel=3e-7)
        series = -sum(-k / (k + 1) * back ** (k - 1) for k in range(1, 400)) if back < 0.5 else None
        exact = series if series is not None else (1 / (1 - back) + expected) / back
        # Its series, in 1 - C < 0.1, drops 6/7 v^5 < 9e-6.
        assert slope == pytest.approx(exact, rel=2e-5)
    assert get_model("ashikhmin-shirley").profile(np.float32(0), np.float32(1), np.float32(0)) == 1.0


def analytic_profile(model, q, C, s):
    """The profiles in numpy, good for complex arguments."""
    if model == "ggx":
        return (q + C) ** -2
    if model == "beckmann":
        return np.exp(-q / C) / C**2
    if model == "generalised-beckmann":
        return np.exp(-np.exp(np.exp(s) * np.log(q / C))) / C**2
    return np.exp(q * np.log(C) / (1 - C)) / C


@models
@pytest.mark.parametrize("real, tolerance", [(np.float64, 1e-4), (np.float32, 2e-4)])
def test_profile_gradient_is_the_derivative(model, real, tolerance):
    # Complex steps have no cancellation. What limits is the series of dL/dC (2e-5 of it) times q up to 8.
    kernel = get_model(model).profile_gradient
    rng = np.random.default_rng(3)
    step = 1e-30
    for _ in range(300):
        q, C = float(real(rng.uniform(1e-3, 8))), float(real(rng.uniform(0.05, 0.98)))
        s = float(real(rng.uniform(*get_model(model).shape_bounds[::2]))) if get_model(model).shape_bounds else 0.0
        value, by_q, by_C, by_s = kernel(real(q), real(C), real(s))
        exact = [analytic_profile(model, q + 0j, C, s).real]
        exact += [analytic_profile(model, q + step * 1j, C, s).imag / step]
        exact += [analytic_profile(model, q, C + step * 1j, s).imag / step]
        exact += [np.imag(analytic_profile(model, q + 0j, C, s + step * 1j)) / step]
        if model != "generalised-beckmann":
            exact[3] = 0.0
        scale = max(map(abs, exact))
        np.testing.assert_allclose([value, by_q, by_C, by_s], exact, rtol=tolerance, atol=tolerance * scale + FADED)
        # The same formula in another order: q L up to 80 rounds to 80 * 6e-8 in float32.
        assert value == pytest.approx(get_model(model).profile(real(q), real(C), real(s)), rel=3e-5)


def test_generalised_beckmann_at_its_centre():
    # x^p at x = 0 is 0: the peak is neither cut nor infinite in any shape, nor is its gradient.
    model = get_model("generalised-beckmann")
    for s in model.shape_bounds:
        for q in (0.0, 1e-38, 1e-12):
            found = model.profile_gradient(np.float32(q), np.float32(1), np.float32(s))
            assert np.isfinite(found).all()
            assert found[0] == pytest.approx(math.exp(-(q ** math.exp(s))), rel=SINGLE)


def test_log_normalisation_of_generalised_beckmann():
    kernel = get_model("generalised-beckmann").log_normalisation
    for s in np.linspace(math.log(0.2), math.log(5), 101):
        value, slope = kernel(s)
        inverse = math.exp(-s)
        assert value == pytest.approx(-special.gammaln(1 + inverse), abs=1e-12)
        # The docstring's promise for digamma.
        assert slope == pytest.approx(special.digamma(1 + inverse) * inverse, abs=1e-9)


@pytest.mark.parametrize("real, tolerance", [(np.float64, 5e-6), (np.float32, 1e-5)])
def test_exp_negative(real, tolerance):
    # k ln 2 rounds to 32 * 6e-8 in float32: the error grows in proportion to the exponent.
    for x in np.concatenate([np.linspace(-31.9, 0, 4001), -np.logspace(-9, 0, 200)]).astype(real):
        assert exp_negative(x) == pytest.approx(math.exp(x), rel=tolerance, abs=0.0)
    for x in (-32.0, -32.001, -1e4, -1e30, -math.inf):
        assert exp_negative(real(x)) == 0.0
    assert exp_negative(real(0.0)) == 1.0
    near = real(-1.5)
    assert exp_negative(near) == pytest.approx(math.exp(near), rel=2e-7)


@pytest.mark.parametrize("real", [np.float64, np.float32])
def test_log_positive(real):
    for x in np.concatenate([np.logspace(-37, 37, 3001), 1 + np.linspace(-0.3, 0.45, 2001)]).astype(real):
        assert log_positive(x) == pytest.approx(math.log(x), rel=3e-7, abs=3e-7 * max(abs(float(x) - 1), 1e-30))
    assert log_positive(real(1.0)) == 0.0


@models
def test_profiles_are_finite_at_the_ends_of_their_range(model):
    chosen = get_model(model)
    for shape in chosen.shape_bounds or (0.0,):
        for q in (0.0, 1e-30, 1.0, 1e8, 1e12):
            for C in (0.0, 1e-12, 0.5, 1.0):
                if model == "ggx" and q + C < 1e-9:
                    continue  # q >= (1 - C) / alpha^2 with alpha <= 1: q and C never vanish together
                found = chosen.profile_gradient(np.float32(q), np.float32(C), np.float32(shape))
                assert np.isfinite(found).all(), (q, C, shape, found)
