"""Methods whose result is no pyramid of lobes: normal distributions, and lighting in texture space."""

from __future__ import annotations

import numpy as np
import pytest
from export_support import averaged_pyramid, random_svbrdf

from baselines.ndm import NormalDistributionMapping, moments_of
from baselines.texture_space import TextureSpace, TextureSpaceLighting, TextureSpaceOptions, stop_level
from brdffit.appearance import Appearance, LobePyramid, Lookups
from brdffit.footprint import filter_channels, get_pixel_filter
from brdffit.methods import Material, Method
from brdffit.options import BakeOptions
from brdffit.render import metrics, scenes
from brdffit.render.pictures import render_appearance, render_appearance_halves
from brdffit.render.reference import render_halves
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf


def bumpy(size=(32, 32), rough=0.4, slope=0.3, **extra):
    base = random_svbrdf(size, slope=slope, seed=5)
    return base.replace(log_roughness=log_tensor_from_perceptual(np.full(size, rough, np.float32)), **extra)


def lookups(count, detail, position=(7.3, 9.1), view=(0.2, 0.1, 0.97)):
    view = np.array(view) / np.linalg.norm(view)
    axes = np.broadcast_to(np.eye(2) * 2.0**detail, (count, 2, 2))
    return Lookups(
        np.broadcast_to(np.array(position), (count, 2)), axes, np.full(count, float(detail)),
        np.broadcast_to(view, (count, 3)),
    )  # fmt: skip


def distributions(base, **options):
    return NormalDistributionMapping().bake(Material(base), BakeOptions(**options))


def hemisphere(n=300):
    u = (np.arange(n) + 0.5) / n
    theta, phi = np.meshgrid(0.5 * np.pi * u**2, 2.0 * np.pi * u, indexing="ij")
    solid = np.sin(theta) * (np.pi * u)[:, None] / n * 2.0 * np.pi / n
    direction = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    return direction.reshape(-1, 3), solid.ravel()


def test_both_are_methods_and_appearances():
    for method in (NormalDistributionMapping(), TextureSpaceLighting()):
        assert isinstance(method, Method)
    baked = distributions(bumpy())
    assert baked.lobes is None and isinstance(baked.appearance, Appearance)
    assert [image.name for image in baked.images()] == ["mean-normal", "normal-moments", "specular", "diffuse"]
    assert baked.images()[1].rows(2, slice(0, 3)).shape == (3, 8, 6)


@pytest.mark.parametrize("detail", [0, 1.5, 3, 5])
@pytest.mark.parametrize("rough", [0.3, 0.8])
def test_the_distribution_of_normals_is_normalised(detail, rough):
    appearance = distributions(bumpy(rough=rough)).appearance
    half, solid = hemisphere()
    seen = appearance.look_up(lookups(1, detail))
    # Half vectors around the mean normal.
    x, y, z = seen.normal[0]
    k = 1.0 / (1.0 + z)
    frame = np.array([(1 - x * x * k, -x * y * k, -x), (-x * y * k, 1 - y * y * k, -y), (x, y, z)])
    off = half @ frame - seen.mean[0]
    density = np.exp(-0.5 * np.einsum("ni,ij,nj->n", off, seen.inverse[0], off) + seen.log_normalisation[0])
    assert float((density * half[:, 2] * solid).sum()) == pytest.approx(1.0, abs=0.01)


def test_moments_are_filtered_linearly():
    """Level 2 is the pixel filter's average of what level 0 stores, and nothing else is done to it."""
    base = bumpy()
    levels = distributions(base, keep_level_0=True).appearance.images
    np.testing.assert_array_equal(levels[0], moments_of(base))
    expected = filter_channels(levels[0], (8, 8), get_pixel_filter("box"), base.wrap)
    np.testing.assert_allclose(levels[2], expected, rtol=1e-4, atol=1e-5)


def test_a_single_normal_is_a_beckmann_lobe_to_first_order():
    size = (4, 4)
    flat = np.broadcast_to(np.float32([0, 0, 1]), (*size, 3)).copy()
    grey = np.full((*size, 3), 0.5, np.float32)
    log = log_tensor_from_perceptual(np.full(size, 0.35, np.float32))
    base = Svbrdf(flat, log, grey, grey, model="beckmann")
    scene = scenes.plane(size, 0, (24, 24))
    baked = distributions(base)
    assert not baked.notes
    lobe, gaussian = render_appearance([base], scene), render_appearance(baked.appearance, scene)
    assert metrics.snr_db(gaussian, lobe) > 30.0


def test_normals_on_a_ring_stay_off_the_middle():
    """Two facets that lean apart: their Gaussian is long one way and narrow the other, and its mean is between them."""
    size = (8, 8)
    lean = np.where((np.arange(8) % 2)[None, :, None], [[[0.4, 0.0, 0.9165]]], [[[-0.4, 0.0, 0.9165]]])
    normal = np.broadcast_to(lean, (*size, 3)).astype(np.float32).copy()
    base = bumpy(size, rough=0.3).replace(normal=normal)
    seen = distributions(base).appearance.look_up(lookups(1, 2))
    np.testing.assert_allclose(seen.normal[0], [0.0, 0.0, 1.0], atol=1e-3)
    assert seen.tensor[0, 0] > 2.0 * 0.4**2 > 20.0 * seen.tensor[0, 1]


def test_texture_space_is_the_fitted_maps_from_its_level_on():
    pyramid = LobePyramid([level.svbrdf for level in averaged_pyramid(bumpy()).levels])
    scene = scenes.plane((32, 32), 3, (16, 16))
    for stop in (0.0, 3.0):
        picture = render_appearance(TextureSpace(pyramid, stop, 2), scene)
        np.testing.assert_allclose(picture, render_appearance(pyramid, scene), rtol=2e-3, atol=1e-4)


def test_texture_space_is_the_truth_where_it_lights_every_texel():
    """Averaged lobes are far off on bumps; averaged light is not."""
    base = bumpy()
    pyramid = LobePyramid([base, *[level.svbrdf for level in averaged_pyramid(base).levels[1:]]])
    scene = scenes.plane(base.size, 3, (16, 16))
    reference = render_halves(base, scene, samples=4096)
    snr = {
        name: metrics.snr_db_of_halves(render_appearance_halves(drawn, scene), reference.halves)
        for name, drawn in {"maps": pyramid, "light": TextureSpace(pyramid, 9.0, 3)}.items()
    }
    # One point a texel; between texels the truth is bilinear.
    assert snr["light"] > snr["maps"] + 6.0


def test_the_level_where_light_varies_no_more():
    flat = random_svbrdf((32, 32), slope=0.0, seed=5)
    same = {name: np.broadcast_to(array[:1, :1], array.shape).copy() for name, array in flat.arrays().items()}
    for base, threshold, expected in ((flat.replace(**same), 0.05, 0), (bumpy(), 1e-6, 6)):
        level, seconds = stop_level(LobePyramid([base]), threshold)
        assert level == expected or (expected == 6 and level == 1)
        assert seconds > 0.0


@pytest.mark.slow
def test_texture_space_bakes_by_the_fit_and_says_what_it_costs():
    base = bumpy((16, 16))
    baked = TextureSpaceLighting().bake(Material(base), TextureSpaceOptions(quality="draft"))
    assert baked.lobes is None and baked.appearance.finer == 2
    np.testing.assert_array_equal(baked.appearance.levels[0].normal, base.normal)
    assert any("Lit texels are filtered down" in note for note in baked.notes)
    assert any("s for each light" in note for note in baked.notes)
    assert {"normal", "roughness"} <= {image.name for image in baked.images()}
