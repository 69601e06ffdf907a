"""Laws of the baselines: constants, limits, symmetries, definiteness, hard cases; LEAN against sampled lobes."""

import itertools

import numpy as np
import pytest

from baselines.lean import MAX_SLOPE
from brdffit.errors import InputError
from brdffit.fitting.options import FitOptions
from brdffit.methods import Method, get_method, lobe_method_names
from brdffit.roughness import log_tensor_from_perceptual, perceptual_from_log_tensor, tensor_from_log
from brdffit.svbrdf import Svbrdf, level_sizes

BASELINES = [name for name in lobe_method_names() if type(get_method(name)).__module__.startswith("baselines.")]
#: Those that widen the lobe by the spread of normals, in alpha^2 and without a cap.
WIDENING = ["toksvig", "vmf", "lean"]

#: A normal or perceptual roughness after sums in single precision.
CONSTANT = 1e-5
#: Symmetries: the same numbers summed in another order, then a fourth root.
REORDERED = 2e-5

baselines = pytest.mark.parametrize("name", BASELINES)


def bake(name, svbrdf, **options):
    return get_method(name).bake_lobes(svbrdf, FitOptions(**options))


def unit(x, y, z=1.0):
    vector = np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(np.float64)
    return (vector / np.linalg.norm(vector, axis=-1, keepdims=True)).astype(np.float32)


def constant_svbrdf(size=(12, 20), normal=(0.3, -0.4, 0.8), log_tensor=(-4.0, -3.0, 0.4), **fields):
    def colour(value):
        return np.full((*size, 3), value, dtype=np.float32)

    return Svbrdf(
        normal=np.broadcast_to(unit(*map(np.float64, normal)), (*size, 3)).copy(),
        log_roughness=np.broadcast_to(np.float32(log_tensor), (*size, 3)).copy(),
        specular=colour([0.9, 0.5, 0.1]),
        diffuse=colour([0.0, 0.2, 0.7]),
        occlusion=np.full(size, 0.6, dtype=np.float32),
        height=np.full(size, 2.5, dtype=np.float32),
        **fields,
    )


def random_svbrdf(size=(16, 16), spread=0.3, seed=0, anisotropic=True):
    rng = np.random.default_rng(seed)
    slope = rng.normal(0, spread, (*size, 2))
    log_tensor = rng.uniform(-8, -2, (*size, 1)) + rng.normal(0, 0.5 * anisotropic, (*size, 3)) * [1, 1, 1]
    log_tensor[..., 2] -= log_tensor[..., 2].mean() if anisotropic else log_tensor[..., 2]
    if not anisotropic:
        log_tensor[..., 1] = log_tensor[..., 0]
    return Svbrdf(
        normal=unit(-slope[..., 0], -slope[..., 1]),
        log_roughness=log_tensor.astype(np.float32),
        specular=rng.random((*size, 3), dtype=np.float32),
        diffuse=rng.random((*size, 3), dtype=np.float32),
        height=rng.normal(0, 1, size).astype(np.float32),
    )


def slopes_svbrdf(slope, roughness):
    """Normals of slopes (H, W, 2), one isotropic roughness."""
    size = slope.shape[:2]
    grey = np.full((*size, 3), 0.5, dtype=np.float32)
    return Svbrdf(
        normal=unit(-slope[..., 0], -slope[..., 1]),
        log_roughness=log_tensor_from_perceptual(np.full(size, roughness, dtype=np.float32)),
        specular=grey,
        diffuse=grey,
    )


def assert_sane(pyramid, svbrdf, min_roughness=FitOptions.min_roughness):
    """Right sizes and model, finite, unit normals, tensors positive definite and within their bounds."""
    assert [level.svbrdf.size for level in pyramid.levels] == level_sizes(svbrdf.size)
    for level in pyramid.levels:
        assert level.svbrdf.is_finite() and level.seconds >= 0
        assert level.svbrdf.model == pyramid.options.model and level.svbrdf.wrap == svbrdf.wrap
        assert all(array.dtype == np.float32 for array in level.svbrdf.arrays().values())
        np.testing.assert_allclose(np.linalg.norm(level.svbrdf.normal, axis=-1), 1, atol=1e-6)
        xx, yy, xy = np.moveaxis(tensor_from_log(level.svbrdf.log_roughness.astype(np.float64)), -1, 0)
        assert (xx > 0).all() and (xx * yy > xy * xy).all()
        minor = 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)
        major = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
        assert minor.min() > min_roughness**4 * (1 - 1e-3) and major.max() < 1 + 1e-5


@baselines
def test_is_a_method_with_a_one_line_summary(name):
    method = get_method(name)
    assert isinstance(method, Method)
    assert method.name == name and method.summary and "\n" not in method.summary


@baselines
@pytest.mark.parametrize("pixel_filter, wrap", [*itertools.product(["box", "gaussian", "mitchell"], ["tile", "clamp"])])
def test_constant_material_is_returned_at_every_level(name, pixel_filter, wrap):
    # Flat for the two that change normals by design.
    normal = (0, 0, 1) if name in ("flatten", "height") else (0.3, -0.4, 0.8)
    base = constant_svbrdf(normal=normal, wrap=wrap)
    pyramid = bake(name, base, pixel_filter=pixel_filter)
    assert_sane(pyramid, base)
    for level in pyramid.levels:
        for field, array in level.svbrdf.arrays().items():
            expected = np.broadcast_to(getattr(base, field)[0, 0], array.shape)
            np.testing.assert_allclose(array, expected, atol=CONSTANT, err_msg=field)


@pytest.mark.parametrize("name", ["naive", "toksvig", "vmf", "lean", "filament", "godot"])
@pytest.mark.parametrize("normal", [(0, 0, 1), (0.3, -0.4, 0.8), (0.9, 0.1, 0.3)])
def test_a_flat_mirror_stays_as_glossy_as_authored(name, normal):
    """Rounding of the mean normal's length must not pass for a spread of normals."""
    roughness = FitOptions.min_roughness
    base = constant_svbrdf((64, 64), normal, log_tensor_from_perceptual(np.float32(roughness)))
    for level in bake(name, base).levels:
        np.testing.assert_allclose(perceptual_from_log_tensor(level.svbrdf.log_roughness), roughness, atol=CONSTANT)
        np.testing.assert_allclose(
            level.svbrdf.normal, np.broadcast_to(unit(*normal), level.svbrdf.normal.shape), atol=CONSTANT
        )


@baselines
def test_colours_and_occlusion_are_averaged_linearly(name):
    base = random_svbrdf()
    base = base.replace(occlusion=np.random.default_rng(1).random(base.size, dtype=np.float32))
    level = bake(name, base)[-1].svbrdf
    for field in ("specular", "diffuse", "occlusion"):
        np.testing.assert_allclose(getattr(level, field)[0, 0], getattr(base, field).mean(axis=(0, 1)), atol=1e-6)


@baselines
@pytest.mark.parametrize("keep", [False, True])
def test_level_0_is_filtered_unless_kept_or_left_by_the_tool(name, keep):
    base = random_svbrdf()
    level = bake(name, base, keep_level_0=keep)[0].svbrdf
    kept = keep or name in ("filament", "godot")
    assert np.array_equal(level.diffuse, base.diffuse) == kept
    assert np.array_equal(level.normal, base.normal) == kept
    assert np.array_equal(level.log_roughness, base.log_roughness) == kept


def test_toksvig_limits():
    slope = np.zeros((2, 2, 2))
    slope[..., 0] = [[0.2, -0.2], [0.2, -0.2]]
    length = 1 / np.sqrt(1 + 0.2**2)
    for roughness in (0.1, 0.5, 0.99):
        level = bake("toksvig", slopes_svbrdf(slope, roughness))[-1].svbrdf
        alpha_squared = np.exp(level.log_roughness[0, 0, 0].astype(np.float64))
        power, variance = 2 / roughness**4 - 2, (1 - length) / length
        # p' = p / (1 + V p), Toksvig's own form.
        assert 2 / alpha_squared - 2 == pytest.approx(power / (1 + variance * power), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("name", ["toksvig", "vmf", "lean"])
def test_normals_that_cancel_end_at_the_roughest_lobe(name):
    """r = 0 for opposite normals: alpha' = 1, and no NaN."""
    base = slopes_svbrdf(np.zeros((2, 2, 2)), 0.3)
    opposite = unit([[1, -1], [-1, 1]], [[0, 0], [0, 0]], [[0, 0], [0, 0]])
    level = bake(name, base.replace(normal=opposite))[-1].svbrdf
    major = tensor_from_log(level.log_roughness)[0, 0].max()
    assert major == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(level.normal[0, 0], [0, 0, 1], atol=1e-6)


@pytest.mark.parametrize("deviation", [0.01, 0.03])
def test_vmf_agrees_with_lean_for_a_small_isotropic_gaussian_spread(deviation):
    """Both widen alpha^2 by twice the variance of a slope: r = 1 - s^2, kappa = 1 / s^2."""
    slope = np.random.default_rng(2).normal(0, deviation, (64, 64, 2))
    slope -= slope.mean(axis=(0, 1))
    base = slopes_svbrdf(slope, 0.2)
    widened = {name: np.exp(bake(name, base, lobe="isotropic")[-1].svbrdf.log_roughness[0, 0, 0]) for name in WIDENING}
    expected = 0.2**4 + np.mean(slope**2) * 2
    assert widened["vmf"] == pytest.approx(expected, rel=2 * deviation)
    assert widened["lean"] == pytest.approx(widened["vmf"], rel=3 * deviation)
    assert widened["toksvig"] == pytest.approx(widened["vmf"], rel=3 * deviation)


def test_lean_is_exact_in_the_second_moments_of_beckmann_lobes_on_gaussian_slopes():
    """Oracle by sampling: slopes of microfacets are slope of texel + slope of lobe; alpha^2 is twice their variance."""
    rng = np.random.default_rng(3)
    factor = np.array([[0.1, 0.0], [0.05, 0.03]])
    slope = rng.normal(size=(64, 64, 2)) @ factor.T
    slope -= slope.mean(axis=(0, 1))
    alpha = 0.3**2
    level = bake("lean", slopes_svbrdf(slope, 0.3), model="beckmann")[-1].svbrdf
    facets = slope[:, :, None] + rng.normal(0, alpha / np.sqrt(2), (64, 64, 200, 2))
    covariance = np.cov(facets.reshape(-1, 2).T)
    xx, yy, xy = tensor_from_log(level.log_roughness)[0, 0]
    np.testing.assert_allclose([xx, yy, xy], 2 * covariance[[0, 1, 0], [0, 1, 1]], rtol=0.01, atol=1e-4)


@pytest.mark.parametrize("mean", [(0.6, 0.0), (0.5, -0.9), (-2.0, 1.0)])
def test_lean_carries_the_covariance_into_the_frame_of_the_mean_normal(mean):
    """Oracle: rotate the base normals by the shortest rotation of n to z and take their slopes there."""
    slope = np.array(mean) + np.random.default_rng(4).normal(0, 0.01, (32, 32, 2)) @ np.array([[1.0, 0.5], [0, 0.4]])
    base = slopes_svbrdf(slope, 0.1)
    level = bake("lean", base)[-1].svbrdf
    x, y, z = level.normal[0, 0].astype(np.float64)
    to_frame = np.array(
        [[1 - x * x / (1 + z), -x * y / (1 + z), -x], [-x * y / (1 + z), 1 - y * y / (1 + z), -y], [x, y, z]]
    )
    np.testing.assert_allclose(to_frame @ [x, y, z], [0, 0, 1], atol=1e-6)
    rotated = base.normal.reshape(-1, 3).astype(np.float64) @ to_frame.T
    covariance = np.cov((-rotated[:, :2] / rotated[:, 2:]).T, bias=True)
    expected = 0.1**4 * np.eye(2) + 2 * covariance
    xx, yy, xy = tensor_from_log(level.log_roughness.astype(np.float64))[0, 0]
    np.testing.assert_allclose([[xx, xy], [xy, yy]], expected, rtol=0.02, atol=1e-2 * expected.max())


def test_lean_made_isotropic_keeps_the_determinant():
    base = random_svbrdf(spread=0.1)
    free, held = (bake("lean", base, lobe=lobe) for lobe in ("anisotropic", "isotropic"))
    for a, b in zip(free.levels, held.levels, strict=True):
        np.testing.assert_array_equal(b.svbrdf.log_roughness[..., 0], b.svbrdf.log_roughness[..., 1])
        assert not b.svbrdf.log_roughness[..., 2].any()
        np.testing.assert_allclose(
            a.svbrdf.log_roughness[..., :2].sum(-1), b.svbrdf.log_roughness[..., :2].sum(-1), atol=1e-5
        )


def test_lean_says_how_many_slopes_it_cut():
    slope = np.zeros((4, 4, 2))
    slope[1, 2] = [0, -100 * MAX_SLOPE]
    pyramid = bake("lean", slopes_svbrdf(slope, 0.3))
    assert len(pyramid.notes) == 1 and pyramid.notes[0].startswith("1 of 16 base texels")
    assert -pyramid[-1].svbrdf.normal[0, 0, 1] / pyramid[-1].svbrdf.normal[0, 0, 2] == pytest.approx(-MAX_SLOPE / 16)
    assert not bake("lean", slopes_svbrdf(0 * slope, 0.3)).notes


@pytest.mark.parametrize("name, factor, cap", [("filament", 0.5, 0.04), ("godot", 0.75, 0.16)])
def test_shipped_formulas_add_to_perceptual_roughness_up_to_their_cap(name, factor, cap):
    for spread, roughness in itertools.product((0.1, 3.0), (0.2, 0.6)):
        slope = np.zeros((2, 2, 2))
        slope[..., 0] = [[spread, -spread], [-spread, spread]]
        length = 1 / np.sqrt(1 + spread**2)
        kappa = (3 * length - length**3) / (1 - length**2)
        level = bake(name, slopes_svbrdf(slope, roughness))[-1].svbrdf
        expected = np.sqrt(roughness**2 + min(factor / kappa, cap))
        assert perceptual_from_log_tensor(level.log_roughness)[0, 0] == pytest.approx(expected, rel=1e-4)


def test_flatten_fades_from_the_mean_normal_to_z_over_the_whole_chain():
    base = constant_svbrdf((8, 8))
    pyramid = bake("flatten", base)
    tilts = [np.hypot(*level.svbrdf.normal[0, 0, :2]) for level in pyramid.levels]
    np.testing.assert_allclose(pyramid[0].svbrdf.normal[0, 0], base.normal[0, 0], atol=CONSTANT)
    assert all(np.diff(tilts) < 0) and tilts[-1] == 0
    # A chain cut short is the beginning of the whole one.
    np.testing.assert_array_equal(bake("flatten", base, levels=2)[1].svbrdf.normal, pyramid[1].svbrdf.normal)


@pytest.mark.parametrize("size", [(32, 32), (21, 40)])
def test_height_gives_the_normals_of_a_plane_in_the_openGL_sense(size):
    """h = 0.5 x - 0.25 y_up: slopes (0.5, -0.25) wherever the clamped border does not reach."""
    rows, columns = np.indices(size)
    plane = constant_svbrdf(size, wrap="clamp").replace(height=(0.5 * columns + 0.25 * rows).astype(np.float32))
    for level in bake("height", plane).levels[:3]:
        inner = level.svbrdf.normal[2:-2, 2:-2]
        np.testing.assert_allclose(inner, np.broadcast_to(unit(-0.5, 0.25), inner.shape), atol=1e-5)


def test_height_without_a_height_map_says_what_to_give():
    with pytest.raises(InputError, match="needs? .*height|height map .* give one"):
        bake("height", constant_svbrdf().replace(height=None))


def mirrored(svbrdf):
    """Left becomes right: x components and the off-diagonal of the tensor change sign."""
    normal, log_tensor = svbrdf.normal[:, ::-1].copy(), svbrdf.log_roughness[:, ::-1].copy()
    normal[..., 0] *= -1
    log_tensor[..., 2] *= -1
    return flipped(svbrdf, lambda image: image[:, ::-1], normal, log_tensor)


def rotated(svbrdf):
    """A quarter turn counter-clockwise: (x, y) -> (-y, x), XX <-> YY, XY -> -XY."""
    normal, log_tensor = np.rot90(svbrdf.normal), np.rot90(svbrdf.log_roughness)
    normal = np.stack([-normal[..., 1], normal[..., 0], normal[..., 2]], axis=-1)
    log_tensor = np.stack([log_tensor[..., 1], log_tensor[..., 0], -log_tensor[..., 2]], axis=-1)
    return flipped(svbrdf, np.rot90, normal, log_tensor)


def flipped(svbrdf, turn, normal, log_tensor):
    rest = {
        name: np.ascontiguousarray(turn(image))
        for name, image in svbrdf.arrays().items()
        if name not in ("normal", "log_roughness")
    }
    return svbrdf.replace(normal=normal, log_roughness=log_tensor, **rest)


@baselines
@pytest.mark.parametrize("turn", [mirrored, rotated])
@pytest.mark.parametrize("size, pixel_filter", [((16, 16), "box"), ((12, 20), "mitchell"), ((13, 7), "gaussian")])
@pytest.mark.parametrize("anisotropic", [True, False])
def test_turning_the_texture_commutes_with_baking(name, turn, size, pixel_filter, anisotropic):
    base = random_svbrdf(size, anisotropic=anisotropic)
    first = bake(name, turn(base), pixel_filter=pixel_filter)
    second = bake(name, base, pixel_filter=pixel_filter)
    for a, b in zip(first.levels, second.levels, strict=True):
        b = turn(b.svbrdf)
        np.testing.assert_allclose(a.svbrdf.normal, b.normal, atol=REORDERED)
        np.testing.assert_allclose(
            tensor_from_log(a.svbrdf.log_roughness), tensor_from_log(b.log_roughness), atol=REORDERED
        )


@baselines
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (9, 1), (5, 3), (2, 16)])
@pytest.mark.parametrize("pixel_filter", ["box", "mitchell"])
@pytest.mark.parametrize("wrap", ["tile", "clamp"])
def test_hard_cases_stay_finite_and_positive_definite(name, size, pixel_filter, wrap):
    """Odd and degenerate sizes, black colours, mirrors beside rough texels, normals at the horizon and below it."""
    base = random_svbrdf(size, spread=1.0, seed=5)
    rng = np.random.default_rng(6)
    extreme = rng.choice(np.array([0.045, 1.0], dtype=np.float32), size)
    normal = base.normal.copy()
    normal[rng.random(size) < 0.3] = [1, 0, 0]
    normal[rng.random(size) < 0.3] = [0, -1, 0]
    normal[rng.random(size) < 0.1] = [0, 0, -1]
    hard = base.replace(
        normal=normal,
        log_roughness=log_tensor_from_perceptual(extreme),
        specular=np.zeros_like(base.specular),
        diffuse=np.where(rng.random((*size, 3)) < 0.5, 0, 100).astype(np.float32),
        wrap=wrap,
    )
    pyramid = bake(name, hard, pixel_filter=pixel_filter)
    assert_sane(pyramid, hard)
    assert all((level.svbrdf.diffuse >= 0).all() for level in pyramid.levels)


@baselines
@pytest.mark.parametrize("angle", [0.0, 0.5])
def test_anisotropy_of_nearly_a_thousand_to_one_survives(name, angle):
    """The minor axis may be a difference of single-precision numbers near 1: a tenth of its alpha^2 may go."""
    axis = np.log(2e-3**2)
    c, s = np.cos(angle), np.sin(angle)
    base = constant_svbrdf(normal=(0, 0, 1), log_tensor=(axis * s * s, axis * c * c, -axis * s * c))
    pyramid = bake(name, base, min_roughness=0.04)
    assert_sane(pyramid, base, 0.04)
    np.testing.assert_allclose(pyramid[2].svbrdf.log_roughness, base.log_roughness[::4, ::4], atol=0.1)


@baselines
def test_shape_is_averaged_or_given_its_default_and_never_left_out(name):
    default = bake(name, constant_svbrdf(), model="generalised-beckmann").levels
    assert all(level.svbrdf.shape.shape == level.svbrdf.size and not level.svbrdf.shape.any() for level in default)
    shape = np.random.default_rng(7).random((12, 20), dtype=np.float32)
    base = constant_svbrdf(model="generalised-beckmann", shape=shape)
    level = bake(name, base, model="generalised-beckmann")[-1].svbrdf
    assert level.shape[0, 0] == pytest.approx(shape.mean(), rel=1e-5)
    assert bake(name, base, model="ggx")[-1].svbrdf.shape is None


@baselines
def test_a_model_of_one_roughness_gets_isotropic_levels(name):
    pyramid = bake(name, random_svbrdf(), model="blinn-phong")
    for level in pyramid.levels[1:]:
        assert not level.svbrdf.log_roughness[..., 2].any()
        np.testing.assert_array_equal(level.svbrdf.log_roughness[..., 0], level.svbrdf.log_roughness[..., 1])


@baselines
def test_result_does_not_depend_on_threads_and_progress_counts_every_texel(name):
    base, seen = random_svbrdf((300, 130)), []
    one = get_method(name).bake_lobes(base, FitOptions(threads=1), lambda *report: seen.append(report))
    three = bake(name, base, threads=3)
    for a, b in zip(one.levels, three.levels, strict=True):
        assert all(np.array_equal(image, b.svbrdf.arrays()[field]) for field, image in a.svbrdf.arrays().items())
    assert seen == [(k, h * w, h * w) for k, (h, w) in enumerate(level_sizes(base.size))]


def test_the_base_is_not_written_to():
    base = random_svbrdf()
    before = {name: array.copy() for name, array in base.arrays().items()}
    for name in BASELINES:
        bake(name, base)
    assert all(np.array_equal(before[name], array) for name, array in base.arrays().items())
