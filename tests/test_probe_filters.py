"""Laws of the filters of a probe: the lobe, brute force, the tree, harmonics, importance sampling, bright texels."""

import numpy as np
import pytest
from probes_support import exact_level, lamps, relative_l1
from scipy.integrate import quad
from scipy.special import sph_harm_y
from test_probe_cubemap import SYMMETRIES

from brdffit.errors import InputError
from brdffit.probes.cubemap import directions, halved, mean_radiance, resized, solid_angles
from brdffit.probes.curves import CURVES, get_curve
from brdffit.probes.direct import add_bright, filtered_exactly, packed_source, split_bright
from brdffit.probes.downsampling import ColourPyramid
from brdffit.probes.filtering import ENERGY, FilterOptions, LevelRequest, filter_levels, level_requests, with_energy
from brdffit.probes.harmonics import (
    evaluated,
    filtered_by_harmonics,
    irradiance_nine,
    nine_basis,
    truncation_error,
    zonal_coefficients,
)
from brdffit.probes.importance import filtered_by_importance, preimage_errors
from brdffit.probes.lobe import half_width, is_narrow, lobe, lobe_integral
from brdffit.probes.reading import Surroundings, as_cube, reoriented
from brdffit.probes.seams import edge_steps, seam_ratios
from brdffit.probes.table_fit import chosen_texels
from brdffit.probes.tables import Goal
from brdffit.probes.tree import Tree, tau_for, texel_sums
from brdffit.render.environment import procedural_environment

ALPHAS = get_curve("activision", 7, 128).alphas()


@pytest.mark.parametrize("alpha", [0.003, 0.05, 0.4, 0.97, 0.9999, 1.0])
def test_the_integral_of_the_lobe(alpha):
    # In s with 1 - cos = s^4, which spreads the peak out.
    numeric = quad(lambda s: 8.0 * np.pi * s**3 * float(lobe(np.float64(s**4), alpha)), 0.0, 1.0, limit=200)[0]
    assert lobe_integral(alpha) == pytest.approx(numeric, rel=1e-7)


def test_half_width_and_narrow_lobes():
    alpha = 0.01
    assert lobe(np.array(1.0 - np.cos(half_width(alpha))), alpha) == pytest.approx(
        0.5 * lobe(np.zeros(()), alpha), rel=1e-3
    )
    # A texel of 64 is 1/32 wide in u; twice 1.287 alpha is as much at alpha = 0.0121.
    assert is_narrow(0.012, 64) and not is_narrow(0.0122, 64)


@pytest.mark.parametrize("name", CURVES)
@pytest.mark.parametrize("levels, size", [(7, 128), (5, 256), (9, 256)])
def test_curves_rise_and_are_inverted_by_their_level(name, levels, size):
    curve = get_curve(name, levels, size)
    steps = np.arange(levels, dtype=float)
    roughness = curve.roughness(steps)
    assert np.all(np.diff(roughness) >= 0.0) and 0.0 <= roughness[0] and roughness[-1] <= 1.0 + 1e-12
    below = roughness < 1.0
    np.testing.assert_allclose(curve.level(roughness)[below], steps[below], atol=1e-6)


def test_the_published_roughness_of_the_levels():
    np.testing.assert_allclose(ALPHAS, [0.00276, 0.00781, 0.02209, 0.06244, 0.17541, 0.47140, 1.0], rtol=2e-3)


def test_a_curve_may_be_a_list_and_a_wrong_one_is_refused():
    assert get_curve("0,0.3,1", 3, 128).alphas() == pytest.approx([0.0, 0.09, 1.0])
    for wrong in ("0,0.3", "0,0.8,0.5", "steep"):
        with pytest.raises(InputError):
            get_curve(wrong, 3, 128)


@pytest.mark.parametrize("order, printed", [(3, 0.1227), (5, 0.0593), (7, 0.0358), (9, 0.0243), (11, 0.0177)])
def test_harmonics_lose_what_table_3_prints(order, printed):
    assert round(truncation_error(order), 4) == printed


def test_zonal_coefficients_of_the_clamped_cosine():
    np.testing.assert_allclose(zonal_coefficients(1.0, 5), [1.0, 2.0 / 3.0, 0.25, 0.0, -1.0 / 24.0], atol=1e-9)
    assert zonal_coefficients(0.003, 3) == pytest.approx([1.0, 1.0, 1.0], abs=1e-3)


def test_nine_numbers_are_order_three():
    cube = lamps(32)
    normals = directions(8).reshape(-1, 3)
    nine = nine_basis(normals) @ irradiance_nine(cube)
    np.testing.assert_allclose(nine, filtered_by_harmonics(cube, normals, 1.0, 3), atol=2e-5 * nine.max())


def analysed_latlong(picture, order):
    """``harmonics.analysed`` of a lat-long picture (H, W, 3) of constant pixels, its middle column along -Z."""
    height, width = picture.shape[:2]
    edge = np.linspace(0.0, np.pi, height + 1)
    area = (np.cos(edge[:-1]) - np.cos(edge[1:])) * 2.0 * np.pi / width
    polar = 0.5 * (edge[:-1] + edge[1:])
    azimuth = (np.arange(width) + 0.5) / width * 2.0 * np.pi - np.pi
    out = np.zeros((order, order, 3), complex)
    for m in range(order):
        # The mean of exp(-i m azimuth) over a pixel is its value at the centre times sinc.
        turned = np.exp(-1j * m * azimuth) * np.sinc(m / width)
        rows = np.einsum("w,hwc->hc", turned, picture) * area[:, None]
        for degree in range(m, order):
            out[degree, m] = sph_harm_y(degree, m, polar, 0.0).real @ rows
    return out


@pytest.mark.slow
@pytest.mark.parametrize("alpha", ALPHAS[4:])
def test_an_independent_transform_agrees_with_brute_force(alpha):
    """From the lat-long picture itself, through no cube: orientation and lobe are right."""
    picture = procedural_environment(128).radiance
    source = packed_source(as_cube(Surroundings(None, "latlong", picture), 128))
    normals = directions(4).reshape(-1, 3)
    exact = filtered_exactly(source, normals, alpha)
    order = 64
    harmonic = evaluated(analysed_latlong(picture, order) * zonal_coefficients(alpha, order)[:, None, None], normals)
    # The cube map samples the lamps' rims 8x8 a texel.
    assert relative_l1(harmonic, exact) < 2e-3


@pytest.mark.parametrize("alpha", ALPHAS[2:])
def test_brute_force_keeps_constants_and_energy(alpha):
    assert np.ptp(exact_level(np.ones((6, 16, 16, 3)), 4, alpha)) < 1e-12
    cube = lamps(32)
    n = 32
    filtered = exact_level(cube, n, max(alpha, 0.06))
    np.testing.assert_allclose(mean_radiance(filtered), mean_radiance(cube), rtol=2e-3)


def test_the_brightest_direction_stays():
    cube = np.full((6, 32, 32, 3), 1e-3)
    cube[2, 5, 20] = 1e3
    level = exact_level(cube, 32, 0.1)
    assert np.unravel_index(level[..., 0].argmax(), level.shape[:3]) == (2, 5, 20)


@pytest.mark.parametrize("matrix", SYMMETRIES[::7])
def test_filters_follow_the_cube_when_it_is_turned(matrix):
    cube = lamps(16)
    turned = reoriented(cube, matrix)
    np.testing.assert_allclose(exact_level(turned, 8, 0.3), reoriented(exact_level(cube, 8, 0.3), matrix), rtol=1e-9)
    one, other = Tree(turned).level(8, 0.3, 1e-3), reoriented(Tree(cube).level(8, 0.3, 1e-3), matrix)
    assert relative_l1(one, other) < 2e-3


def test_the_tree_becomes_brute_force():
    cube = lamps(32)
    for alpha in (0.06, 0.4, 1.0):
        assert relative_l1(Tree(cube).level(8, alpha, 0.0), exact_level(cube, 8, alpha)) < 3e-6


def test_the_tree_keeps_constants():
    np.testing.assert_allclose(Tree(np.full((6, 32, 32, 3), 0.25)).level(8, 0.2, 0.05), 0.25, rtol=1e-6)


@pytest.mark.parametrize("tolerance", [0.02, 0.005, 0.001])
def test_the_tree_stays_within_its_tolerance_and_takes_less(tolerance):
    cube = lamps(64)
    tree, errors, taken = Tree(cube), [], []
    for level in range(2, 7):
        n = max(64 >> level, 2)
        counts = np.zeros(6 * n * n, np.int64)
        normals = directions(n).reshape(-1, 3)
        sums = texel_sums(64, n, ALPHAS[level])
        filtered = tree.filtered(normals, ALPHAS[level], tau_for(tolerance), counts=counts, sums=sums)
        errors.append(relative_l1(filtered, exact_level(cube, n, ALPHAS[level]).reshape(-1, 3)))
        taken.append(counts.mean())
    assert np.mean(errors) <= 1.5 * tolerance
    assert max(taken) < 6 * 64**2 / 10


@pytest.mark.parametrize("tolerance", [0.02, 0.005])
def test_every_level_keeps_the_energy_of_its_source(tolerance):
    """The mean of a level is that of its source; 24 texels are too few to sample it by exact values."""
    cube = resized(lamps(32), 128)
    requests = level_requests(get_curve("quadratic", 6, 64), 64, 128)[:-1]
    levels = filter_levels(cube, requests, FilterOptions(tolerance=tolerance))
    assert max(abs(level.energy - 1.0) for level in levels) < 2e-3
    assert max(level.error for level in levels) <= 1.5 * tolerance


def test_bringing_to_the_mean_leaves_what_sampling_explains():
    cube = lamps(16)
    energy = float(mean_radiance(cube).sum())
    np.testing.assert_array_equal(with_energy(cube, energy * (1.0 + 0.5 * ENERGY)), cube)
    moved = with_energy(1.02 * cube, energy)
    assert float(mean_radiance(moved).sum()) / energy - 1.0 == pytest.approx(ENERGY, rel=1e-3)
    np.testing.assert_array_equal(with_energy(0.0 * cube, energy), 0.0 * cube)


@pytest.mark.parametrize("level", [4, 5, 6])
def test_light_of_a_node_is_seen_where_it_is(level):
    """One bright texel in nodes that are taken whole: K is taken in its direction, not in the middle of the node."""
    cube = np.full((6, 64, 64, 3), 1e-3, np.float32)
    cube[2, 13, 50] = 3000.0
    normals = directions(8).reshape(-1, 3)
    exact = exact_level(cube, 8, ALPHAS[level]).reshape(-1, 3)
    counts = np.zeros(len(normals), np.int64)
    found = Tree(cube).filtered(normals, ALPHAS[level], 0.1, counts=counts)
    assert counts.mean() < 200
    assert relative_l1(found, exact) < 1e-3


def test_what_the_tree_lacks_of_the_lobe_is_made_good():
    """Far from a lamp its tail is all there is: dark nodes that are taken whole must not make it brighter."""
    cube = np.full((6, 64, 64, 3), 1e-3, np.float32)
    cube[4, 30:33, 30:33] = 5000.0
    exact = exact_level(cube, 16, 0.06)
    found = Tree(cube).level(16, 0.06, tau_for(0.005))
    assert relative_l1(found, exact) < 5e-3
    assert abs(float((found - exact).sum() / exact.sum())) < 3e-3


@pytest.mark.parametrize(
    "source, n, alpha",
    [
        pytest.param(64, 32, 0.02, marks=pytest.mark.slow),
        (64, 16, 0.04),
        (32, 8, 0.03),
        (32, 1, 0.02),
    ],
)
def test_the_sum_of_a_narrow_lobe_over_texels(source, n, alpha):
    at, angle = directions(source).reshape(-1, 3), np.tile(solid_angles(source).ravel(), 6)
    normals = directions(n).reshape(-1, 3)
    plain = np.array([(lobe(0.5 * np.square(at - each).sum(axis=1), alpha) * angle).sum() for each in normals])
    np.testing.assert_allclose(texel_sums(source, n, alpha), plain, rtol=2e-3)
    assert np.ptp(plain) / plain.mean() > 1e-4 or n == 1


def test_errors_step_no_more_across_edges_than_beside_them():
    requests = [LevelRequest(level, 64 >> level, 0.0, ALPHAS[level]) for level in (2, 3)]
    for seed in range(2):
        ratios = seam_ratios(lamps(64, seed), requests, FilterOptions("tree", 0.005), turns=4)
        assert max(ratios.values()) < 1.2, ratios


@pytest.mark.parametrize("n", [1, 2, 8])
def test_steps_across_edges_are_told_from_those_beside_them(n):
    """What differs from face to face steps across edges alone; what is smooth steps alike."""
    faces = np.broadcast_to(np.arange(6.0)[:, None, None], (6, n, n))
    across, beside = edge_steps(faces)
    # Each of the twelve edges is seen from both sides. Opposite faces, which differ by one, share none: the steps are
    # those of all pairs of faces but three.
    pairs = sum(abs(a - b) for a in range(6) for b in range(a) if a // 2 != b // 2)
    assert across == pytest.approx(2 * n * pairs)
    assert beside == pytest.approx(0.0 if n > 1 else across)
    if n == 8:
        across, beside = edge_steps(directions(64) @ np.array([0.3, 0.5, 0.8]))
        assert across == pytest.approx(beside, rel=0.1)


def test_the_tree_takes_more_nodes_for_less_error():
    cube, normals = lamps(64), directions(8).reshape(-1, 3)
    exact, last = exact_level(cube, 8, 0.17).reshape(-1, 3), (0, np.inf)
    for tau in (0.1, 1e-2, 1e-3, 1e-5):
        counts = np.zeros(len(normals), np.int64)
        error = relative_l1(Tree(cube).filtered(normals, 0.17, tau, counts=counts), exact)
        assert counts.sum() >= last[0] and error <= last[1]
        last = counts.sum(), error


@pytest.mark.parametrize("count, printed", [(32, 0.4201), (64, 0.2976), (128, 0.2233)])
@pytest.mark.slow
def test_importance_sampling_errs_as_table_1_prints(count, printed):
    errors = []
    for level in range(1, 7):
        texels, shares = chosen_texels(128 >> level, "none", 96, 5)
        errors.append(preimage_errors(Goal.of(texels, ALPHAS[level], shares), ALPHAS[level], count).mean())
    assert np.mean(errors) == pytest.approx(printed, rel=0.02)


def test_importance_sampling_comes_to_the_exact_levels():
    cube = lamps(32, bright=3.0)
    exact = exact_level(cube, 8, 0.4)
    means = ColourPyramid.of(cube, box=True)
    few, many = (filtered_by_importance(means, 8, 0.4, count) for count in (16, 1024))
    assert relative_l1(many, exact) < 0.01
    assert relative_l1(many, exact) < 0.3 * relative_l1(few, exact)


def test_what_is_split_off_and_the_rest_are_the_whole():
    cube = lamps(32)
    rest, points = split_bright(cube, 10.0)
    assert 0 < points.shape[1] < 10
    energy = (points[3] * points[4:]).sum(axis=1) / (4.0 * np.pi)
    np.testing.assert_allclose(mean_radiance(rest) + energy, mean_radiance(cube), rtol=1e-6)
    level = add_bright(exact_level(rest, 8, 0.2).astype(np.float32), points, 0.2)
    assert relative_l1(level, exact_level(cube, 8, 0.2)) < 2e-3


def test_coarse_sources_err_little_where_lobes_are_wide():
    """A filtered level hardly depends on the resolution of its source: 0.6% at alpha = 0.47."""
    cube = lamps(64, bright=50.0)
    assert relative_l1(exact_level(halved(cube), 8, 0.47), exact_level(cube, 8, 0.47)) < 1e-2
