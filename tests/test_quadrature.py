"""The mixture rule against dense grids: broad, narrow, separated and mixed footprints; the measure against both."""

import math

import numpy as np
import pytest
from lobe_oracle import (
    apparent_lobe,
    box_footprint,
    disc_grid,
    half_angle_weight,
    lobe,
    log_tensor_of,
    normal_of_slopes,
)

from brdffit.fitting.batch import model_kernels
from brdffit.fitting.scoring import coverage
from brdffit.halfangle.apparent_lobe import base_of, normalise_mixture
from brdffit.halfangle.closed_forms import DEFENSIVE_SHARE, LEAN, STARTS, closed_forms
from brdffit.halfangle.measure import measure_lobes
from brdffit.halfangle.quadrature import (
    ALPHA_SQUARED,
    GAIN,
    GREEN,
    LOBE_COLUMNS,
    MIXTURE,
    NODE_ROWS,
    RED,
    SPECULAR,
    TENSOR,
    WEIGHT,
    add_defensive_lobe,
    frame_lobes,
    lattice,
    normalise_shapes,
    place_nodes,
    weigh_nodes,
)
from brdffit.roughness import log_tensor_from_perceptual, tensor_from_log
from brdffit.svbrdf import Svbrdf

#: Step of the dense grid on the projected hemisphere: a quarter of the narrowest alpha used, where the trapezoid rule
#: of a GGX peak has long converged (its error falls as exp(-2 pi alpha / step)).
STEP = 0.005
#: The error falls about as 1 / N; at 8192 it was below 0.6% for every footprint here and six shifts of the rule. (At
#: 512 the mixed one has 6%: a tenth of the nodes go to the needle that makes nearly all of <T,T>.)
NODES = 8192
RULE = 0.01

#: name: (normals as slopes, alphas, weights)
FOOTPRINTS = {
    "one lobe": ([(0.2, 0.1)], [0.3], [1.0]),
    "broad": ([(0.1, 0), (-0.1, 0.1), (0, -0.2), (0.2, 0.2)], [0.5, 0.6, 0.4, 0.7], [0.25] * 4),
    # Where shared nodes on the footprint's moments returned alpha of 5462: four needles on slopes of spread 0.1.
    "needles": ([(0.1, 0.1), (-0.1, 0.1), (0.1, -0.1), (-0.1, -0.1)], [0.03] * 4, [0.25] * 4),
    "separated": ([(0.6, 0), (-0.6, 0.1)], [0.05, 0.05], [0.7, 0.3]),
    "mixed": ([(0.0, 0.0), (0.3, 0.2)], [0.6, 0.02], [0.9, 0.1]),
    "steep": ([(2.5, 0), (-1.5, 1.0)], [0.2, 0.3], [0.5, 0.5]),
}
footprints = pytest.mark.parametrize("name", FOOTPRINTS)


def lobes_of(name, anisotropic=False):
    """The program's table of lobes, and how many: colours (1, 0.5, 0.2), mixture weights with the defensive lobe."""
    slopes, alphas, weights = FOOTPRINTS[name]
    count = len(alphas)
    lobes = np.zeros((count + 1, LOBE_COLUMNS))
    for i in range(count):
        lobes[i, :3] = normal_of_slopes(*slopes[i])
        if anisotropic:
            log_tensor = log_tensor_of(alphas[i], 0.6 * alphas[i], 0.4 + i)
            lobes[i, TENSOR : TENSOR + 3] = tensor_from_log(np.asarray(log_tensor))
        else:
            lobes[i, ALPHA_SQUARED] = alphas[i] ** 2
        lobes[i, SPECULAR : SPECULAR + 3] = np.multiply(weights[i], (1.0, 0.5, 0.2))
        lobes[i, MIXTURE], lobes[i, GAIN] = weights[i], 1.0
    return lobes, count


def table(name, model="ggx", shift=(0.5, 0.5, 0.5), anisotropic=False, nodes=NODES):
    """Nodes with directions, table and weights by the program's rule."""
    lobes, count = lobes_of(name, anisotropic)
    kernels = model_kernels(model, model)
    kernels.tabulate.disable_compile()
    normalise_mixture(lobes, count)
    starts = np.zeros((STARTS, 6))
    closed_forms(lobes, count, not anisotropic, starts, False)
    add_defensive_lobe(lobes, count, DEFENSIVE_SHARE, *starts[LEAN, :5])
    out = np.zeros((NODE_ROWS, nodes), np.float32)
    frame_lobes(lobes, count, not anisotropic)
    place_nodes(lobes, count, lattice(nodes, shift), 3, out)
    normalise_shapes(lobes, count, False, kernels.source_log_normalisation)
    kernels.tabulate(lobes, count, not anisotropic, False, out)
    weigh_nodes(out)
    return out.astype(float)


def dense(name, model="ggx", anisotropic=False):
    """(h, w dh, T) on the dense grid."""
    slopes, alphas, weights = FOOTPRINTS[name]
    h, dh = disc_grid(STEP)
    total = np.zeros(len(h))
    for i, alpha in enumerate(alphas):
        log_tensor = log_tensor_of(alpha, 0.6 * alpha if anisotropic else alpha, 0.4 + i)
        total += weights[i] * lobe(model, h, normal_of_slopes(*slopes[i]), log_tensor)
    return h, half_angle_weight(h) * dh, total


def fitted_lobes(name):
    """A few lobes that a fit might try: near the moments, on the first peak."""
    slopes, alphas, weights = FOOTPRINTS[name]
    mean = np.average(slopes, axis=0, weights=weights)
    spread = math.sqrt(np.average(np.square(alphas), weights=weights) + 2 * np.var(np.array(slopes), axis=0).sum())
    return [
        (normal_of_slopes(*mean), log_tensor_of(min(spread, 1), 0.7 * min(spread, 1), 0.3)),
        (normal_of_slopes(*slopes[0]), log_tensor_of(1.2 * alphas[0], alphas[0])),
    ]


@footprints
@pytest.mark.parametrize("anisotropic", [False, True], ids=["isotropic", "anisotropic"])
def test_rule_agrees_with_a_dense_grid(name, anisotropic):
    nodes = table(name, anisotropic=anisotropic)
    h, weight, target = dense(name, anisotropic=anisotropic)
    norm = np.sum(weight * target**2)
    # An anisotropic "mixed" has an axis of 0.012: 2.4 steps of the grid, still converged.
    assert np.sum(nodes[WEIGHT] * nodes[RED] ** 2) == pytest.approx(norm, rel=RULE)
    assert np.sum(nodes[WEIGHT] * nodes[RED]) == pytest.approx(np.sum(weight * target), rel=RULE)
    np.testing.assert_allclose(nodes[GREEN], 0.5 * nodes[RED], rtol=1e-5)
    for normal, log_tensor in fitted_lobes(name):
        d, at_nodes = lobe("ggx", h, normal, log_tensor), lobe("ggx", nodes[:3].T, normal, log_tensor)
        # Both lobes on one scale: what the objective sees is <T,D> / sqrt(<T,T> <D,D>).
        scale = math.sqrt(norm * np.sum(weight * d * d))
        cross = np.sum(nodes[WEIGHT] * nodes[RED] * at_nodes)
        assert cross == pytest.approx(np.sum(weight * target * d), abs=RULE * scale)
        assert np.sum(nodes[WEIGHT] * at_nodes**2) == pytest.approx(np.sum(weight * d * d), rel=3 * RULE)


@pytest.mark.parametrize("model", ["beckmann", "blinn-phong", "generalised-beckmann", "ashikhmin-shirley"])
@pytest.mark.parametrize("name", ["broad", "needles", "separated"])
def test_rule_serves_every_model(name, model):
    nodes = table(name, model)
    _, weight, target = dense(name, model)
    assert np.sum(nodes[WEIGHT] * nodes[RED] ** 2) == pytest.approx(np.sum(weight * target**2), rel=RULE)


@footprints
def test_table_is_the_apparent_lobe(name):
    nodes = table(name)
    slopes, alphas, weights = FOOTPRINTS[name]
    n = [normal_of_slopes(*each) for each in slopes]
    tensors = [log_tensor_of(alpha, alpha) for alpha in alphas]
    h = nodes[:3].T / np.linalg.norm(nodes[:3].T, axis=1, keepdims=True)
    expected = apparent_lobe("ggx", h, (weights, n, tensors, [np.array([1.0, 0.5, 0.2])] * len(n)))
    # A float32 node knows its place to 6e-8: 6e-8 / 0.02 of the sharpest lobe's width.
    np.testing.assert_allclose(nodes[RED], expected[:, 0], rtol=1e-4, atol=1e-6 * expected.max())


@footprints
def test_two_shifts_agree(name):
    sums = [np.sum(t[WEIGHT] * t[RED] ** 2) for t in (table(name), table(name, shift=(0.25, 0.137, 0.719)))]
    assert sums[0] == pytest.approx(sums[1], rel=RULE)


@footprints
def test_weights_are_a_measure(name):
    """Nodes stand above the horizon or weigh nothing; weights are finite, not negative, and bounded by 1 / density."""
    nodes = table(name, nodes=256)
    assert np.isfinite(nodes).all()
    assert (nodes[WEIGHT] >= 0).all() and not nodes[WEIGHT][nodes[2] <= 0].any()
    np.testing.assert_allclose(np.linalg.norm(nodes[:3], axis=0), 1.0, atol=1e-6)


def test_error_falls_with_nodes():
    _, weight, target = dense("needles")
    norm = np.sum(weight * target**2)
    errors = [abs(np.sum(t[WEIGHT] * t[RED] ** 2) / norm - 1) for t in (table("needles", nodes=n) for n in (64, 8192))]
    assert errors[1] < 2e-3 and errors[0] < 0.1


def small_base(alpha, spread, seed=0):
    rng = np.random.default_rng(seed)
    slopes = rng.normal(0, spread, (4, 4, 2))
    normal = normal_of_slopes(slopes[..., 0], slopes[..., 1]).astype(np.float32)
    roughness = np.sqrt(alpha * rng.uniform(0.8, 1.2, (4, 4))).astype(np.float32)
    return Svbrdf(
        normal=normal,
        log_roughness=log_tensor_from_perceptual(roughness),
        specular=rng.uniform(0.2, 1.0, (4, 4, 3)).astype(np.float32),
        diffuse=np.zeros((4, 4, 3), np.float32),
    )


@pytest.mark.parametrize("alpha, spread", [(0.4, 0.2), (0.06, 0.06), (0.1, 0.4)])
def test_measure_agrees_with_brute_force(alpha, spread):
    svbrdf = small_base(alpha, spread)
    # A fifth of the narrowest lobe, more samples where normals turn faster than lobes are wide: 0.02 dB of its own.
    h, dh = disc_grid(min(alpha / 5, 0.02))
    weight = half_angle_weight(h) * dh
    row, column = 1, 0
    footprint = box_footprint(svbrdf, (2, 2), row, column, samples=40 if spread > 2 * alpha else 24)
    target = apparent_lobe("ggx", h, footprint)
    mean = np.average(footprint[1], axis=0)
    alpha_fit = math.sqrt(alpha**2 + 2 * spread**2 / 3)
    theta = np.array(
        [-mean[0] / mean[2] + 0.02, -mean[1] / mean[2], *log_tensor_of(alpha_fit, 0.7 * alpha_fit, 0.5), 0.0]
    )
    scale = footprint[3].mean(axis=0) * np.array([1.0, 0.9, 1.1])
    d = lobe("ggx", h, normal_of_slopes(theta[0], theta[1]), theta[2:5])
    expected = np.sum(weight[:, None] * (target - scale * d[:, None]) ** 2) / np.sum(weight[:, None] * target**2)
    found = measure_lobes(
        base_of(svbrdf), (4, 4), (2, 2), theta[None, None], scale[None, None], np.array([column]), np.array([row]),
        pixel_filter="box", exponent=3, kernels=model_kernels("ggx", "ggx"),
    )  # fmt: skip
    # The house's resolution: 0.05 dB.
    assert 10 * abs(math.log10(found.error[0, 0] / expected)) < 0.05
    assert found.energy[0, 0] == pytest.approx(np.sum(scale) / footprint[3].mean(axis=0).sum(), rel=1e-3)


def test_nothing_reflected_and_nothing_claimed_is_no_error():
    svbrdf = small_base(0.3, 0.2)
    svbrdf.specular[:] = 0.0
    theta = np.array([0.0, 0.0, -2.0, -2.0, 0.0, 0.0])
    scale = np.stack([np.zeros((1, 3)), np.ones((1, 3))])
    found = measure_lobes(
        base_of(svbrdf), (4, 4), (2, 2), np.stack([theta[None]] * 2), scale, np.zeros(1, int), np.zeros(1, int),
        pixel_filter="box", exponent=3, kernels=model_kernels("ggx", "ggx"),
    )  # fmt: skip
    assert found.error[0, 0] == 0.0
    assert found.error[1, 0] > 0.5  # a phantom highlight of full strength


@footprints
def test_nodes_see_the_lobes_that_they_were_drawn_from_and_no_others(name):
    """Coverage is 1 where nodes stand and far from it for a needle where none do, though they see half of its mass."""
    # One rule of 320 nodes knows a lobe between two needles, which a quarter of its nodes reach, to a quarter or so.
    shifts = [(0.5, 0.5, 0.5), (0.25, 0.137, 0.719), (0.5, 0.1, 0.9), (0.5, 0.9, 0.3), (0.5, 0.3, 0.1)]
    rules = [table(name, nodes=320, shift=shift).astype(np.float32) for shift in shifts]

    def seen(normal, log_tensor, rules):
        theta = np.array([-normal[0] / normal[2], -normal[1] / normal[2], *log_tensor, 0.0])
        return np.mean([coverage(theta, nodes, 3, np.zeros(16)) for nodes in rules])

    for normal, log_tensor in fitted_lobes(name):
        assert seen(normal, log_tensor, rules) == pytest.approx(1.0, abs=0.15)
    assert abs(seen(normal_of_slopes(-1.6, 1.4), log_tensor_of(0.01, 0.01), rules[:1]) - 1.0) > 0.5
