"""Laws of the half-angle reduction: density, four dimensions against two, frames, the objective and its gradient."""

import math

import numpy as np
import pytest
from lobe_oracle import (
    MODELS,
    disc_grid,
    draw_half_vectors,
    half_angle_weight,
    lobe,
    log_tensor_of,
    normal_of_slopes,
    shortest_rotation,
    tensor,
)

from brdffit._jit import numba_type, specialise, types
from brdffit.fitting.batch import model_kernels
from brdffit.halfangle import objective
from brdffit.halfangle.apparent_lobe import base_of
from brdffit.halfangle.density import DENSITY_EXPONENTS, half_angle_density
from brdffit.halfangle.frame import eigen_log, lobe_frame, tangent_frame
from brdffit.halfangle.measure import measure_lobes
from brdffit.halfangle.objective import TARGET
from brdffit.halfangle.quadrature import NODE_ROWS, WEIGHT
from brdffit.models import get_model
from brdffit.roughness import log_from_tensor, log_tensor_from_perceptual, tensor_from_log
from brdffit.svbrdf import Svbrdf

#: float64 arithmetic through a few operations.
DOUBLE = 1e-12
#: Monte Carlo error bars: five of them are never reached by chance in a run of a few dozen comparisons.
SIGMAS = 5.0

models = pytest.mark.parametrize("model", MODELS)
densities = pytest.mark.parametrize("density", ["uniform", "cosine"])
widths = pytest.mark.parametrize("width", [32, 64])


# Density


@densities
def test_density_integrates_to_one(density):
    # 2 pi int w(z) dz: Gauss-Legendre is exact for a polynomial.
    x, weight = np.polynomial.legendre.leggauss(8)
    w = [half_angle_density(z, DENSITY_EXPONENTS[density]) for z in 0.5 * (x + 1)]
    assert 2 * math.pi * np.sum(0.5 * weight * w) == pytest.approx(1.0, abs=DOUBLE)
    assert half_angle_density(-0.1, DENSITY_EXPONENTS[density]) == 0.0


@densities
def test_density_is_that_of_half_vectors(density):
    count, bins = 1_000_000, 24
    h = draw_half_vectors(np.random.default_rng(5), count, density)
    edges = np.linspace(0, 1, bins + 1)
    found, _ = np.histogram(h[:, 2], edges)
    x, weight = np.polynomial.legendre.leggauss(8)
    for k in range(bins):
        z = edges[k] + (x + 1) / (2 * bins)
        w = [half_angle_density(each, DENSITY_EXPONENTS[density]) for each in z]
        expected = 2 * math.pi * np.sum(weight / (2 * bins) * w)
        assert abs(found[k] / count - expected) < SIGMAS * math.sqrt(expected / count)


@densities
@pytest.mark.parametrize("target, fitted", [("ggx", "ggx"), ("ggx", "beckmann"), ("blinn-phong", "ashikhmin-shirley")])
def test_four_dimensional_error_is_the_two_dimensional_one(density, target, fitted):
    """int int (T(h(l,v)) - F(h(l,v)))^2 p(l) p(v) dl dv = int (T - F)^2 w(h) dh, the program's own rule included."""
    first = (normal_of_slopes(0.2, -0.1), log_tensor_of(0.4, 0.4), np.array([0.9, 0.6, 0.3]))
    second = (
        normal_of_slopes(-0.1, 0.3),
        log_tensor_of(0.5, 0.35, 0.0 if fitted == "blinn-phong" else 0.4),
        np.full(3, 0.5),
    )

    def squared(h):
        difference = first[2] * lobe(target, h, *first[:2])[:, None] - second[2] * lobe(fitted, h, *second[:2])[:, None]
        return np.sum(difference**2, axis=1)

    samples = squared(draw_half_vectors(np.random.default_rng(6), 2_000_000, density))
    error_bar = samples.std() / math.sqrt(len(samples))
    h, dh = disc_grid(0.005)
    grid = np.sum(squared(h) * half_angle_weight(h, density) * dh)
    assert abs(samples.mean() - grid) < SIGMAS * error_bar

    constant = np.ones((1, 1, 3), np.float32)
    base = base_of(
        Svbrdf(
            normal=(constant * first[0]).astype(np.float32),
            log_roughness=(constant * first[1]).astype(np.float32),
            specular=(constant * first[2]).astype(np.float32),
            diffuse=0 * constant,
            model=target,
        )
    )
    n = second[0]
    theta = np.array([-n[0] / n[2], -n[1] / n[2], *second[1], 0.0])[None, None]
    nowhere = np.zeros(1, np.int64)
    found = measure_lobes(
        base, (1, 1), (1, 1), theta, second[2][None, None], nowhere, nowhere, pixel_filter="box",
        exponent=DENSITY_EXPONENTS[density], kernels=model_kernels(target, fitted),
    )  # fmt: skip
    norm = np.sum(first[2] ** 2) * np.sum(lobe(target, h, *first[:2]) ** 2 * half_angle_weight(h, density) * dh)
    # 4096 low-discrepancy nodes: about 1/N of the norm; the grid has 1e-4.
    assert found.error[0, 0] == pytest.approx(grid / norm, rel=5e-3, abs=1e-3 * grid / norm)


# Frames


def test_tangent_frame_is_the_shortest_rotation():
    rng = np.random.default_rng(7)
    normals = [normal_of_slopes(*slopes) for slopes in rng.normal(0, 2, (100, 2))]
    normals += [normal_of_slopes(*slopes) for slopes in rng.normal(0, 1e-9, (20, 2))]
    normals += [np.array([0.0, 0.0, 1.0]), normal_of_slopes(1e6, -1e5)]
    for n in normals:
        frame = np.array([*tangent_frame(*n), *n]).reshape(3, 3)
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=DOUBLE)
        assert np.linalg.det(frame) == pytest.approx(1.0)
        np.testing.assert_allclose(frame.T, shortest_rotation(n), atol=1e-9)


def test_eigen_log_builds_the_tensor_again():
    rng = np.random.default_rng(8)
    cases = [*rng.normal(0, 4, (200, 3)), (1.0, 1.0, 0.0), (-3.0, -3.0, 1e-14), (2.0, -5.0, 0.0), (-5.0, 2.0, 0.0)]
    cases += [(-3.0, -3.0 + d, c) for d in (1e-13, -1e-8, 1e-4) for c in (0.0, 1e-9, -1e-5)]
    for a, b, c in cases:
        l1, l2, cos, sin = eigen_log(a, b, c)
        assert l1 >= l2 and cos * cos + sin * sin == pytest.approx(1.0)
        back = (l1 * cos**2 + l2 * sin**2, l1 * sin**2 + l2 * cos**2, (l1 - l2) * cos * sin)
        np.testing.assert_allclose(back, (a, b, c), atol=1e-11)


def test_lobe_frame_measures_the_quadratic_form():
    rng = np.random.default_rng(9)
    for _ in range(50):
        n, log_tensor = normal_of_slopes(*rng.normal(0, 1, 2)), rng.normal(-3, 2, 3)
        frame = np.zeros(9)
        lobe_frame(*n, *log_tensor, frame)
        h = normal_of_slopes(*rng.normal(0, 1, 2))
        x = (h @ shortest_rotation(n))[:2]
        q = np.sum((frame.reshape(3, 3)[:2] @ h) ** 2)
        assert q == pytest.approx(x @ np.linalg.inv(tensor(log_tensor)) @ x, rel=1e-9)


# The roughness tensor and its logarithm


@pytest.mark.parametrize("ratio", [1.0, 1.001, 10.0, 1e3, 1e4])
@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_tensor_and_logarithm_round_trip(ratio, real):
    rng = np.random.default_rng(10)
    angle = np.concatenate([rng.uniform(0, math.pi, 500), [0, math.pi / 2, math.pi / 4]])
    alpha2 = np.exp(rng.uniform(-12, 0, len(angle)))
    log_tensor = np.array(
        [log_tensor_of(math.sqrt(m), math.sqrt(m / ratio), f) for m, f in zip(alpha2, angle, strict=True)]
    )
    log_tensor = log_tensor.astype(real)
    sigma = tensor_from_log(log_tensor)
    assert sigma.dtype == real
    expected = np.array([tensor(each.astype(float))[[0, 1, 0], [0, 1, 1]] for each in log_tensor])
    # Entries to rounding: log entries up to 20 are known to 20 eps, exp makes that relative.
    eps = np.finfo(real).eps
    assert (np.abs(sigma - expected) <= 200 * eps * expected.max(axis=1, keepdims=True)).all()
    np.testing.assert_allclose(sigma[:, :2], expected[:, :2], rtol=200 * eps * math.sqrt(ratio))
    # Determinant of rounded entries: eps times the anisotropy.
    np.testing.assert_allclose(log_from_tensor(sigma), log_tensor, atol=60 * eps * ratio + 40 * eps)


def test_minor_axis_survives_single_precision():
    # exp(t) (cosh r - sinh r) would lose 1% of it at 1000:1.
    for ratio in (1e3, 1e6):
        for angle in (0.0, math.pi / 2):
            log_tensor = log_tensor_of(0.5, 0.5 / math.sqrt(ratio), angle).astype(np.float32)
            sigma = tensor_from_log(log_tensor)
            minor = sigma[1] if angle == 0.0 else sigma[0]
            assert minor == pytest.approx(0.25 / ratio, rel=1e-5)


def test_isotropic_tensors_have_no_zero_over_zero():
    log_tensor = log_tensor_from_perceptual(np.array([0.001, 0.045, 0.5, 1.0], np.float32))
    sigma = tensor_from_log(log_tensor)
    assert np.array_equal(sigma[:, 0], sigma[:, 1]) and not sigma[:, 2].any()
    back = log_from_tensor(sigma)
    np.testing.assert_allclose(back, log_tensor, rtol=1e-6, atol=1e-6)
    assert np.array_equal(back[:, 0], back[:, 1]) and not back[:, 2].any()


# The objective


def evaluator(width):
    """``objective.evaluate`` for this float type, compiled for function-typed kernels."""
    real, floats = (np.float32, types.float32) if width == 32 else (np.float64, types.float64)
    # A copy of its own: it is closed to other signatures below, which the solvers may still ask of the original.
    kernel = specialise(objective.evaluate, f"_test_{width}", real=real)
    line = numba_type(np.zeros(1))
    signature = (
        line, numba_type(np.zeros((NODE_ROWS, 1), real)), line, objective.moments_type(floats),
        objective.log_normalisation_type, line, line,
    )  # fmt: skip
    if signature not in kernel.overloads:
        kernel.compile(signature)
    kernel.disable_compile()
    return kernel


@pytest.fixture(scope="session")
def evaluators():
    return {width: evaluator(width) for width in (32, 64)}


def some_nodes(width, seed=11, count=400, target=None):
    """Nodes spread over the upper hemisphere, positive weights; a target of two lobes, and <T,T>."""
    rng = np.random.default_rng(seed)
    nodes = np.zeros((NODE_ROWS, count), np.float64)
    h = normal_of_slopes(*rng.normal(0, 0.5, (2, count)))
    nodes[:3] = h.T
    weight = rng.uniform(0.5, 1.5, count) / count
    if target is None:
        target = lobe("ggx", h, normal_of_slopes(0.3, 0.1), log_tensor_of(0.4, 0.2, 0.5))
        target = target + lobe("beckmann", h, normal_of_slopes(-0.2, 0.0), log_tensor_of(0.3, 0.3))
    nodes[WEIGHT], nodes[TARGET] = weight, weight * target
    return nodes.astype(np.float32 if width == 32 else np.float64), float(np.sum(weight * target**2))


def setting_of(held, norm, model, low=-12.0, high=0.0):
    rho2 = 0.7
    bounds = get_model(model).shape_bounds or (0.0, 0.0, 0.0)
    return np.array([float(held), rho2 / norm if held else 1 / norm, low, high, bounds[0], bounds[2]])


THETAS = {
    "plain": (0.1, -0.2, -2.0, -1.5, 0.3, 0.0),
    "isotropic": (0.2, 0.1, -1.7, -1.7, 0.0, 0.0),
    "nearly isotropic": (0.2, 0.1, -1.7, -1.7 + 1e-9, 1e-10, 0.0),
    "upright": (0.0, 0.0, -1.2, -2.2, 0.0, 0.0),
    "minor axis first": (0.1, 0.0, -3.0, -1.0, -0.2, 0.0),
    "near the horizon": (4.0, -2.5, -1.0, -1.2, 0.2, 0.0),
    "long and thin": (0.1, 0.1, -1.0, -5.0, 1.5, 0.0),
    "beyond the upper wall": (0.1, -0.1, 0.3, -0.5, 0.2, 0.0),
    "beyond the lower wall": (0.1, -0.1, -2.0, -3.4, 0.1, 0.0),
    "beyond the wall of the shape": (0.1, -0.1, -2.0, -1.5, 0.1, 1.2),
}


@models
@widths
@pytest.mark.parametrize("held", [False, True], ids=["free", "held"])
def test_gradient_is_the_derivative(evaluators, model, width, held):
    kernels = model_kernels(model, model, width)
    nodes, norm = some_nodes(width)
    setting = setting_of(held, norm, model, low=-3.2 if model != "blinn-phong" else -12.0)
    # f64 differences see the polynomials' 1e-7 as noise, so steps are long; f32 sums of 400 terms know 1e-6 of 1.
    step, relative, absolute = (1e-3, 2e-4, 1e-4) if width == 64 else (8e-3, 5e-3, 2e-3)
    for name, start in THETAS.items():
        theta = np.array(start)
        if get_model(model).shape_bounds is None:
            theta[5] = 0.0

        def value(at):
            gradient = np.zeros(6)
            found = evaluators[width](
                at, nodes, setting, kernels.moments, kernels.log_normalisation, gradient, np.zeros(48)
            )
            return found, gradient

        _, gradient = value(theta)
        for p in range(6 if get_model(model).shape_bounds else 5):
            if abs(theta[5]) > 1 and p == 5 and width == 32:
                continue  # the wall's own curvature drowns float32 differences
            offset = np.zeros(6)
            offset[p] = step
            difference = [value(theta + k * offset)[0] for k in (-2, -1, 1, 2)]
            central = (difference[0] - 8 * difference[1] + 8 * difference[2] - difference[3]) / (12 * step)
            scale = np.abs(gradient).max()
            assert gradient[p] == pytest.approx(central, abs=relative * scale + absolute), (name, p)


@models
@widths
def test_relative_error_is_between_zero_and_one(evaluators, model, width):
    """Cauchy-Schwarz: value = e - 1 with e in [0, 1] for a free scale, whatever the nodes; e >= 0 for a held one."""
    kernels = model_kernels(model, model, width)
    rng = np.random.default_rng(12)
    rounding = 2e-6 if width == 32 else 1e-12
    for trial in range(60):
        target = rng.normal(0, 1, 60) ** 3
        nodes, norm = some_nodes(width, seed=trial, count=60, target=target)
        theta = np.array([*rng.normal(0, 1, 2), 0.0, 0.0, 0.0, 0.0])
        a, b = rng.uniform(-11, -0.1, 2)
        theta[2:4] = (a, a) if get_model(model).isotropic else (a, b)
        for held in (False, True):
            setting = setting_of(held, norm, model)
            if held:
                # rho.T / |rho|^2 with one channel: S = T / rho.
                nodes = nodes.copy()
                nodes[TARGET] /= math.sqrt(0.7)
            value = evaluators[width](
                theta, nodes, setting, kernels.moments, kernels.log_normalisation, np.zeros(6), np.zeros(48)
            )
            assert value >= -1 - rounding
            if not held:
                assert value <= 0


@models
def test_own_lobe_is_found_exactly(evaluators, model):
    """A target that is a lobe of the model: e = 0 and the gradient vanishes, on any nodes."""
    kernels = model_kernels(model, model, 64)
    theta = np.array([0.15, -0.1, -1.4, -1.4 if get_model(model).isotropic else -2.0, 0.0, 0.0])
    nodes, _ = some_nodes(64)
    values = np.zeros(nodes.shape[1])
    kernels.values.disable_compile()
    kernels.values(theta, nodes, kernels.log_normalisation, values, np.zeros(16))
    nodes[TARGET] = nodes[WEIGHT] * values
    gradient = np.zeros(6)
    setting = setting_of(False, np.sum(nodes[WEIGHT] * values**2), model)
    value = evaluators[64](theta, nodes, setting, kernels.moments, kernels.log_normalisation, gradient, np.zeros(48))
    assert value == pytest.approx(-1.0, abs=1e-12)
    np.testing.assert_allclose(gradient, 0.0, atol=1e-9)
