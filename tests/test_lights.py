"""Lights with a size: how they blur a lobe, the error over all sizes and its gradient, and lobes that they merge."""

import math

import numpy as np
import pytest
from lobe_oracle import lobe, log_tensor_of, normal_of_slopes, slope_rule

from brdffit.errors import InputError
from brdffit.fitting.batch import diffuse_under_sky, model_kernels, own_fresnel
from brdffit.fitting.losses import add_squares, balance_of, set_diffuse_error, weigh_as_seen
from brdffit.fitting.method import NonlinearFit
from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample
from brdffit.fitting.scoring import aim, share_out, target_norm
from brdffit.halfangle.albedo import diffuse_fresnel
from brdffit.halfangle.apparent_lobe import DIFFUSE_MOMENT
from brdffit.halfangle.closed_forms import MOMENTS, XX, XY, YY, take_from_tensor
from brdffit.halfangle.lights import (
    EVALUATION,
    LOBE_BLUR,
    POINT,
    SHARE,
    Table,
    evaluate_table,
    sizes_of,
    table_of,
)
from brdffit.halfangle.merging import make_cells, merge_lobes
from brdffit.halfangle.objective import BOUNDED, DIFFUSE_FORM, FREE, HOLDS, SETTINGS
from brdffit.halfangle.quadrature import (
    ALPHA_SQUARED,
    BLUE,
    GAIN,
    GREEN,
    LOBE_COLUMNS,
    MEASURE,
    MIXTURE,
    NODE_ROWS,
    RED,
    SPECULAR,
    SPREAD,
    WEIGHT,
    lattice,
)
from brdffit.models import get_model
from brdffit.models.microfacet import brdf
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf

MODELS = ("ggx", "beckmann", "generalised-beckmann", "blinn-phong", "ashikhmin-shirley")
#: Relative squared error of a lobe's blur by a disc replaced by the wider lobe, by R / alpha: about what the best width
#: leaves of GGX (0.0015, 0.014, 0.06), and less for a Gaussian peak, whose tail ends as the disc's does.
REPLACED = {0.5: 0.004, 1.0: 0.025, 2.0: 0.08}


def blur_error(model, blur, ratio, alpha=0.02):
    """Relative squared error of a wider lobe in place of a sharp lobe averaged over a disc of half vectors."""
    radius, up, k = ratio * alpha, np.array([0.0, 0.0, 1.0]), np.arange(400)
    h, dh = slope_rule(up, log_tensor_of(alpha + radius, alpha + radius), 160, 4)
    r, angle = radius * np.sqrt((k + 0.5) / len(k)), 2.399963229728653 * k
    centres = zip(r * np.cos(angle), r * np.sin(angle), strict=True)
    blurred = np.mean([lobe(model, h, normal_of_slopes(*at), log_tensor_of(alpha, alpha)) for at in centres], axis=0)
    wide = math.sqrt(alpha**2 + blur * radius**2)
    replaced = lobe(model, h, up, log_tensor_of(wide, wide))
    return np.sum(dh * (blurred - replaced) ** 2) / np.sum(dh * blurred**2)


@pytest.mark.parametrize("model", MODELS)
def test_a_blurred_lobe_is_a_wider_one(model):
    """The blur of each model against a brute-force average over the disc; no other constant does much better."""
    ours = get_model(model).blur
    found = {ratio: blur_error(model, ours, ratio) for ratio in REPLACED}
    assert all(found[ratio] < bound for ratio, bound in REPLACED.items()), found
    # One number stands for small lights, where variances add, and for large ones, which are flatter than any lobe.
    others = [sum(blur_error(model, factor * ours, ratio) for ratio in REPLACED) for factor in (0.8, 0.9, 1.1, 1.25)]
    assert sum(found.values()) < 1.2 * min(others)


def test_lights_are_read_by_name_and_by_degrees():
    assert np.array_equal(sizes_of("point", 0.5, 0.74), POINT)
    found = sizes_of("10, 2:3", 0.5, 0.74)
    assert found.shape == (2, 3) and found[:, SHARE].tolist() == [0.75, 0.25]
    # A light of radius r moves the half vector by r / 2.
    assert found[1, LOBE_BLUR] == pytest.approx(0.74 * math.radians(5.0) ** 2)
    assert sizes_of("sun,mixed", 0.5, 0.5)[:, SHARE].sum() == pytest.approx(1.0)
    for wrong in ("moon", "-1", "91", "2:0", "1,2,3,4,5,6,7"):
        with pytest.raises(InputError, match="light"):
            sizes_of(wrong, 0.5, 0.5)


def some_table(lights, nodes=300, seed=3):
    """A table of three lobes and white weights, shared out."""
    table = table_of([lattice(nodes)] * len(lights), lights)
    rng = np.random.default_rng(seed)
    for s in range(len(lights)):
        of = table.nodes[NODE_ROWS * table.first[s] : NODE_ROWS * table.first[s + 1]].reshape(NODE_ROWS, nodes)
        h = normal_of_slopes(*rng.normal(0, 0.4, (2, nodes)))
        of[:3] = h.T
        of[WEIGHT] = rng.uniform(0.5, 1.5, nodes) / nodes
        wide = lights[s, LOBE_BLUR]
        for row, (x, alpha) in {RED: (0.2, 0.3), GREEN: (-0.1, 0.2), BLUE: (0.0, 0.4)}.items():
            width = math.sqrt(alpha**2 + wide)
            of[row] = lobe("ggx", h, normal_of_slopes(x, 0.1), log_tensor_of(width, width))
    share_out(table)
    return table


def setting_for(table, kind, energy=0.0, bounds=(0.9, 1.1), diffuse=(0.0,) * DIFFUSE_FORM):
    setting = np.array([kind, 0.0, -12.0, 0.0, 0.0, 0.0, *bounds, energy, *diffuse])
    assert len(setting) == SETTINGS
    aim(table, np.array([0.6, 0.5, 0.4]), target_norm(table), setting)
    return setting


def value_of(theta, table, setting, model="ggx"):
    kernels, gradient = model_kernels(model, model), np.zeros(6)
    value = evaluate_table(
        theta, table, setting, kernels.moments, kernels.log_normalisation, gradient, np.zeros(EVALUATION)
    )
    return value, gradient


@pytest.mark.parametrize("model", ["ggx", "beckmann", "generalised-beckmann"])
@pytest.mark.parametrize("kind", [FREE, HOLDS, BOUNDED, "energy"])
def test_gradient_over_all_sizes_is_the_derivative(model, kind):
    table = some_table(sizes_of("1,10,40:2", 0.74, 0.74))
    diffuse = (0.5, 0.3, 0.6, 0.1, -0.2, 0.05)
    wide = (BOUNDED, 0.7, (0.0, 1e30)) if kind == "energy" else (kind,)
    setting = setting_for(table, *wide, diffuse=diffuse)
    step = 8e-3  # of float32 sums, as in test_halfangle
    for theta in (
        (0.1, -0.2, -2.0, -1.5, 0.3, 0.0),
        (0.2, 0.1, -1.7, -1.7, 0.0, 0.0),
        (0.1, 0.1, -1.0, -5.0, 1.5, 0.0),
    ):
        theta = np.array(theta)
        _, gradient = value_of(theta, table, setting, model)
        for p in range(6 if get_model(model).shape_bounds else 5):
            offset = np.zeros(6)
            offset[p] = step
            difference = [value_of(theta + k * offset, table, setting, model)[0] for k in (-2, -1, 1, 2)]
            central = (difference[0] - 8 * difference[1] + 8 * difference[2] - difference[3]) / (12 * step)
            assert gradient[p] == pytest.approx(central, abs=5e-3 * np.abs(gradient).max() + 2e-3), (theta, p)


def test_one_size_told_twice_is_one_size():
    one, theta = some_table(np.array([[0.01, 0.01, 1.0]])), np.array([0.1, 0.0, -2.0, -1.5, 0.2, 0.0])
    twice = table_of([lattice(300)] * 2, np.array([[0.01, 0.01, 0.5], [0.01, 0.01, 0.5]]))
    for s in range(2):
        twice.nodes[NODE_ROWS * 300 * s : NODE_ROWS * 300 * (s + 1)] = one.nodes
    share_out(twice)
    for kind in (FREE, HOLDS, BOUNDED):
        a, slope = value_of(theta, one, setting_for(one, kind))
        b, other = value_of(theta, twice, setting_for(twice, kind))
        assert a == pytest.approx(b, abs=2e-5)
        np.testing.assert_allclose(slope, other, atol=2e-5)


def test_a_light_without_size_is_a_point():
    table = some_table(POINT)
    small = Table(*table[:4], np.array([[1e-14, 1e-14, 1.0]]))
    theta = np.array([0.1, 0.0, -2.0, -1.5, 0.2, 0.0])
    value, gradient = value_of(theta, table, setting_for(table, FREE))
    other, slope = value_of(theta, small, setting_for(small, FREE))
    assert value == pytest.approx(other, abs=1e-9)
    np.testing.assert_allclose(gradient, slope, atol=1e-9)


def some_lobes(count, spread, alpha, seed=5):
    rng = np.random.default_rng(seed)
    lobes = np.zeros((count + 1, LOBE_COLUMNS))
    lobes[:count, :3] = normal_of_slopes(*rng.normal(0, spread, (2, count)))
    lobes[:count, ALPHA_SQUARED] = alpha**2 * rng.uniform(0.5, 2.0, count)
    lobes[:count, MIXTURE] = rng.uniform(0.5, 1.5, count)
    lobes[:count, MIXTURE] /= lobes[:count, MIXTURE].sum()
    lobes[:count, SPECULAR : SPECULAR + 3] = 0.5 * lobes[:count, MIXTURE, None]
    lobes[:count, GAIN] = 1.0
    return lobes


@pytest.mark.parametrize("spread, alpha", [(0.02, 0.002), (0.2, 0.002), (0.5, 0.1)])
def test_merged_lobes_keep_energy_and_moments(spread, alpha):
    lobes = some_lobes(2000, spread, alpha)
    normals, shares = lobes[:2000, :3].copy(), lobes[:2000, MIXTURE].copy()
    count, _ = merge_lobes(lobes, 2000, 0.03**2, 0.7, make_cells(2001))
    assert count < 2000
    merged, weight = lobes[:count], lobes[:count, MIXTURE]
    assert weight.sum() == pytest.approx(1.0) and merged[:, SPECULAR].sum() == pytest.approx(0.5)
    np.testing.assert_allclose(weight @ merged[:, :3], shares @ normals, atol=2e-3)
    # Twice the covariance of the normals: between the cells, and what each holds.
    before = 2.0 * np.trace(np.cov(normals[:, :2].T, aweights=shares, bias=True))
    between = 2.0 * np.trace(np.cov(merged[:, :2].T, aweights=weight, bias=True))
    within = weight @ (merged[:, SPREAD] + merged[:, SPREAD + 1])
    assert between + within == pytest.approx(before, rel=0.05 + spread**2)


def surface(size, spread, roughness, seed=2):
    rng = np.random.default_rng(seed)
    normal = normal_of_slopes(*rng.normal(0, spread, (2, size * size))).reshape(size, size, 3).astype(np.float32)
    grey = np.full((size, size, 3), 0.5, np.float32)
    rough = np.full((size, size), roughness, np.float32)
    return Svbrdf(normal=normal, log_roughness=log_tensor_from_perceptual(rough), specular=grey, diffuse=0.2 * grey)


@pytest.mark.parametrize("loss", ["l2", "seen", "displayed", "balanced"])
@pytest.mark.parametrize("roughness", [0.045, 0.4])
def test_merging_changes_little(loss, roughness):
    """Fits of merged lobes against fits of the same lobes, hardly merged."""
    options = FitOptions(lights="2,10,40", loss=loss, threads=1)
    columns, rows = np.indices((4, 4)).reshape(2, -1)
    sample = LevelSample(surface(32, 0.2, roughness), 3, columns, rows, options)
    rules, search = sample.settings()
    rules = rules._replace(chain=rules.chain._replace(most=(1 << 16, 1 << 16)))
    _, merged = sample.fit(settings=(rules, search))
    _, whole = sample.fit(settings=(rules, search._replace(cell=0.01)))
    # A tenth of log alpha^2 is 0.15 * 0.01 of the error: see brdffit.fitting.bfgs.
    assert np.abs(merged.log_roughness - whole.log_roughness).mean() < 0.1
    assert np.abs(merged.specular / whole.specular - 1.0).mean() < 0.03


def test_a_balanced_error_is_the_mean_of_the_displayed_and_the_squared_one():
    """(E + w S) / (1 + w), each relative to its own norm of the target, for any other lobe on the same nodes."""
    rng = np.random.default_rng(5)
    nodes = np.zeros((NODE_ROWS, 64), np.float32)
    nodes[[RED, GREEN, BLUE]], nodes[MEASURE] = rng.exponential(1.0, (3, 64)), rng.uniform(0.1, 1.0, 64)
    other = rng.exponential(1.0, (3, 64)).astype(np.float32)

    def error():
        target = nodes[[RED, GREEN, BLUE]]
        return (nodes[WEIGHT] * (target - other) ** 2).sum() / (nodes[WEIGHT] * target**2).sum()

    nodes[WEIGHT] = nodes[MEASURE]
    squared = error()
    weigh_as_seen(nodes, np.zeros(DIFFUSE_MOMENT), True)
    displayed = error()
    assert displayed != pytest.approx(squared, rel=0.1)
    add_squares(nodes, 0.4)
    assert error() == pytest.approx((displayed + 0.4 * squared) / 1.4, rel=1e-5)


@pytest.mark.parametrize(
    "loss, level, dark, squares",
    [("balanced", 1, 0.2, 0.0), ("balanced", 3, 0.5, 0.4), ("balanced", 7, 0.5, 0.6), ("displayed", 1, 0.5, 0.0)],
)
def test_squares_count_from_afar_and_glow_near_by(loss, level, dark, squares):
    assert balance_of(loss, level) == pytest.approx((dark, squares))


@pytest.mark.parametrize("specular, least, most", [("bounded", 0.9, 1.1), ("held", 0.9999, 1.0001)])
def test_energy_is_kept(specular, least, most):
    base = surface(32, 0.3, 0.045)
    pyramid = NonlinearFit().bake_lobes(base, FitOptions(lights="mixed", loss="seen", specular=specular, threads=1))
    for level in pyramid.levels:
        assert least <= float(level.svbrdf.specular.mean() / base.specular.mean()) <= most


def test_an_even_sky_sees_as_much_of_the_diffuse_colour():
    """Irradiance of many normals under a sky that is even above the plane, by brute force, against one normal's."""
    rng = np.random.default_rng(4)
    normal, albedo = normal_of_slopes(*rng.normal(0.1, 0.5, (2, 40))).reshape(40, 3), rng.uniform(0.1, 0.9, 40)
    light = rng.normal(size=(400_000, 3))
    light = light[light[:, 2] > 0.0] / np.linalg.norm(light[light[:, 2] > 0.0], axis=1, keepdims=True)
    many = np.mean([d * np.maximum(light @ n, 0.0).mean() for n, d in zip(normal, albedo, strict=True)])
    moment = np.concatenate([np.tile((albedo[:, None] * normal).mean(axis=0), 3), np.full(3, albedo.mean())])
    one = normal[7]
    found = diffuse_under_sky(moment, 1, one[2]) * np.maximum(light @ one, 0.0).mean()
    assert found == pytest.approx(many, rel=0.01)


@pytest.mark.parametrize("n_z", [1.0, 0.9, 0.6, 0.3])
def test_fresnels_share_of_diffuse_light_is_that_of_the_renderer(n_z):
    """A tilted bump that faces the light, the viewer above: the diffuse part, by the difference of two colours."""
    normal, up = np.array([[np.sqrt(1.0 - n_z * n_z), 0.0, n_z]]), np.array([[0.0, 0.0, 1.0]])
    wide, specular = np.array([[0.5, 0.5, 0.0]]), np.full((1, 3), 0.04)
    with_diffuse, without = (brdf(normal, wide, specular, np.full((1, 3), d), up, normal) for d in (0.8, 0.0))
    rendered = float((with_diffuse - without)[0, 0]) / (0.8 * 0.96 / np.pi)
    assert diffuse_fresnel(n_z) == pytest.approx(rendered, rel=1e-4)


def test_own_fresnel_is_exact_for_one_normal_and_no_gain_for_one_that_leans():
    normal = normal_of_slopes(0.9, 0.4)
    moment = np.concatenate([np.tile(0.7 * normal, 3), np.full(3, 0.7)])
    assert own_fresnel(moment, 1, normal[2]) == pytest.approx(diffuse_fresnel(normal[2]))
    assert own_fresnel(moment, 1, 0.1) == own_fresnel(moment, 1, normal[2])
    assert own_fresnel(np.zeros(12), 1, 0.5) == 1.0


@pytest.mark.parametrize("lights", ["mixed", "point"])
def test_one_tilted_normal_keeps_its_albedo(lights):
    base = surface(8, 0.0, 0.09)
    base = base.replace(
        normal=np.broadcast_to(normal_of_slopes(1.2, -0.5), base.normal.shape).astype(np.float32).copy(),
        diffuse=np.full_like(base.diffuse, 0.3), specular=np.full_like(base.specular, 0.04),
    )  # fmt: skip
    for level in NonlinearFit().bake_lobes(base, FitOptions(lights=lights, threads=1)).levels:
        np.testing.assert_allclose(level.svbrdf.diffuse, 0.3, rtol=1e-4)


def test_ridges_reflect_as_much_diffuse_light_as_their_level():
    """Ridges of 60 degrees, 2 texels a side: between texels the normal is interpolated. The level's diffuse colour is
    three quarters of what a light above asks for, and one of what a sky does, each with the bumps' Fresnel factor."""
    base = surface(8, 0.0, 0.3)
    lean = np.where(np.arange(8) % 4 < 2, 1.0, -1.0)[None, :, None] * np.array([np.sqrt(0.75), 0.0, 0.0]) + [0, 0, 0.5]
    base = base.replace(
        normal=np.broadcast_to(lean, base.normal.shape).astype(np.float32).copy(),
        diffuse=np.full_like(base.diffuse, 0.3), specular=np.full_like(base.specular, 0.04),
    )  # fmt: skip
    last = NonlinearFit().bake_lobes(base, FitOptions(lights="mixed", threads=1)).levels[-1].svbrdf
    # Half of the way between texel centres joins two of one side, half goes across an edge.
    across = np.sqrt(0.75) * (1.0 - 2.0 * (np.arange(4096) + 0.5) / 4096)
    n_z = np.concatenate([np.full(4096, 0.5), 0.5 / np.hypot(across, 0.5)])
    share = 1.0 - (1.0 - n_z) ** 5
    expected = 0.3 * np.mean(share * (0.75 * n_z + 0.25 * (1.0 + n_z) / 2.0))
    assert float(last.normal[0, 0, 2]) > 0.999
    np.testing.assert_allclose(last.diffuse[0, 0], expected, rtol=5e-3)
    assert expected < 0.993 * 0.3 * np.mean(0.75 * n_z + 0.25 * (1.0 + n_z) / 2.0)


def cosine_distributed(rng, many):
    """Directions (many, 3), cosine-distributed about z."""
    radius, angle = np.sqrt(rng.random(many)), 2.0 * np.pi * rng.random(many)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - radius**2)], axis=1)


def test_diffuse_light_that_a_leaning_normal_misses():
    """The error form against light of bumps and of one normal, drawn from random lights and viewers."""
    rng = np.random.default_rng(5)
    moment = np.concatenate([0.5 * normal_of_slopes(0.05, -0.1), 0.2 * normal_of_slopes(-0.1, 0.0), np.zeros(6)])
    light, viewer = cosine_distributed(rng, 400_000), cosine_distributed(rng, 400_000)
    table, form = some_table(sizes_of("2,40", 0.74, 0.74)), np.zeros(DIFFUSE_FORM)
    set_diffuse_error(table, moment, 1.0, form)
    weight = sum(table.nodes[NODE_ROWS * a : NODE_ROWS * b].reshape(NODE_ROWS, -1)[WEIGHT].sum()
                 for a, b in zip(table.first[:-1], table.first[1:], strict=True))  # fmt: skip
    xx, yy, zz, xy, xz, yz = form
    for n in (normal_of_slopes(0.2, 0.1), normal_of_slopes(-0.1, 0.3)):
        missed = 0.0
        for g in (moment[:3], moment[3:6]):
            short = (light @ (g - (g @ n) * n)) * 4.0 / math.pi * viewer[:, 2]
            missed += np.mean(short**2)
        found = n @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ n
        # A missing vector that is not quite across the normal of the texture sees a little more light.
        assert found == pytest.approx(weight * missed, rel=0.1)
    set_diffuse_error(table, moment, 0.0, form)
    assert not form.any()


def test_a_bright_bevel_does_not_take_the_normal_from_the_diffuse_light():
    """Half of a footprint is glossy and leans: the lobe leans beyond the mean normal only where nothing is diffuse."""
    size, lean = 8, normal_of_slopes(-0.5, 0.0)
    half = np.zeros((size, size), bool)
    half[:, ::2] = True
    normal = np.where(half[..., None], lean, np.array([0.0, 0.0, 1.0])).astype(np.float32)
    rough = log_tensor_from_perceptual(np.where(half, 0.5, 0.9).astype(np.float32))
    colour = np.full((size, size, 3), 0.04, np.float32)
    mean = normal.mean(axis=(0, 1)) / np.linalg.norm(normal.mean(axis=(0, 1)))
    beyond = []
    for albedo in (0.5, 0.0):
        diffuse = np.full((size, size, 3), albedo, np.float32)
        base = Svbrdf(normal=normal, log_roughness=rough, specular=colour, diffuse=diffuse)
        found = NonlinearFit().bake_lobes(base, FitOptions(threads=1)).levels[-1].svbrdf.normal[0, 0]
        beyond.append(float(found[0] - mean[0]))
    assert beyond[1] > 0.06 and abs(beyond[0]) < beyond[1] / 3.0, beyond


@pytest.mark.parametrize("turn", [0.0, 0.6])
def test_a_light_is_taken_from_a_tensor_whatever_its_axes(turn):
    """Eigenvalues lose the square and stay above the least, so that the start is a lobe (it once was none)."""
    c, s = math.cos(turn), math.sin(turn)
    axes = np.array([[c, -s], [s, c]])
    for wide, narrow in ((0.5, 0.02), (0.5, 0.4), (0.015, 0.01), (0.3, 0.3)):
        tensor = axes @ np.diag([wide, narrow]) @ axes.T
        moments = np.zeros(MOMENTS)
        moments[XX], moments[YY], moments[XY] = tensor[0, 0], tensor[1, 1], tensor[0, 1]
        take_from_tensor(moments, 0.018, 1e-4)
        found = np.array([[moments[XX], moments[XY]], [moments[XY], moments[YY]]])
        expected = axes @ np.diag([max(wide - 0.018, 1e-4), max(narrow - 0.018, 1e-4)]) @ axes.T
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_mirror_stays_as_sharp_as_the_lights_let_it():
    """Normals that dither within the smallest light widen no lobe, since only its tail would show it."""
    for spread, low, high in ((0.003, 0.0, 0.7), (0.05, 2.0, 12.0)):
        base = surface(32, spread, 0.045)
        level = NonlinearFit().bake_lobes(base, FitOptions(lights="mixed", threads=1)).levels[1].svbrdf
        wider = 0.5 * (level.log_roughness[..., 0] + level.log_roughness[..., 1]) - 4.0 * math.log(0.045)
        assert low <= float(wider.mean()) <= high, (spread, float(wider.mean()))
