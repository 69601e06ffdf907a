"""Light through a filtered probe: a uniform environment is exact, a mirror is a look-up, axes are the world's."""

import numpy as np
import pytest

from brdffit.comparison.probe_lit import picture_through_probe
from brdffit.errors import UnknownNameError
from brdffit.export.presets import preset_names
from brdffit.probes.cubemap import look_up
from brdffit.probes.curves import get_curve
from brdffit.probes.presets import PRESETS, probe_of_materials
from brdffit.probes.shading import MEAN_SCHLICK, ProbeLight
from brdffit.render import scenes
from brdffit.render.environment import Environment
from brdffit.render.pictures import render_appearance
from brdffit.roughness import alpha_squared_from_perceptual, log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf

#: The table has 64 cells of n.v and of roughness, which is looked up bilinearly.
TABLE = 0.003
#: Directions of light that the exact picture takes leave so much noise in a mean over pixels.
NOISE = 0.004


def flat(roughness, specular, diffuse, size=8):
    """A plane of one lobe."""
    ones = np.ones((size, size, 1), np.float32)
    return Svbrdf(
        normal=ones * np.array([0.0, 0.0, 1.0], np.float32),
        log_roughness=log_tensor_from_perceptual(np.full((size, size), roughness, np.float32)),
        specular=ones * np.asarray(specular, np.float32), diffuse=ones * np.asarray(diffuse, np.float32),
        model="ggx", wrap="tile",
    )  # fmt: skip


@pytest.fixture(scope="module")
def uniform():
    radiance = np.full((32, 64, 3), 0.7, np.float32)
    return Environment(radiance), ProbeLight.of(radiance, "activision")


@pytest.fixture(scope="module")
def sided():
    """Brighter to the right (+x), and coloured above."""
    row, column = np.meshgrid(np.arange(64) + 0.5, np.arange(128) + 0.5, indexing="ij")
    elevation, azimuth = np.pi * (0.5 - row / 64), np.pi * (column / 64 - 1.0)
    x, y = np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    radiance = np.stack([1.0 + 0.8 * x, 1.0 + 0.8 * y, np.ones_like(x)], axis=-1).astype(np.float32)
    return Environment(radiance), ProbeLight.of(radiance, "activision")


def test_the_mean_of_fresnels_weight_under_the_cosine():
    node, weight = np.polynomial.legendre.leggauss(16)
    c = 0.5 * (node + 1.0)
    assert (0.5 * weight * 2.0 * (1.0 - c) ** 5 * c).sum() == pytest.approx(MEAN_SCHLICK, rel=1e-12)


# At 1 an engine errs by 2.5%: the last row of the table is that of roughness 63.5/64.
@pytest.mark.parametrize("roughness", [0.25, 0.6, 0.95])
@pytest.mark.parametrize(("specular", "diffuse"), [((0.9, 0.6, 0.3), (0, 0, 0)), ((0.04,) * 3, (0.5, 0.2, 0.8))])
def test_a_uniform_environment_is_lit_exactly(uniform, roughness, specular, diffuse):
    environment, light = uniform
    material, scene = [flat(roughness, specular, diffuse)], scenes.plane((8, 8), 0, (8, 8))
    exact = render_appearance(material, scene, environment=environment).astype(np.float64).mean(axis=(0, 1))
    found = picture_through_probe(material, scene, light, environment).astype(np.float64).mean(axis=(0, 1))
    np.testing.assert_allclose(found, exact, rtol=TABLE + NOISE)


def test_a_uniform_environment_seen_at_an_angle(uniform):
    environment, light = uniform
    material, scene = [flat(0.5, (1.0,) * 3, (0,) * 3)], scenes.tilted((8, 8), 0, (8, 8), 70.0)
    exact = render_appearance(material, scene, environment=environment).mean()
    assert picture_through_probe(material, scene, light, environment).mean() == pytest.approx(exact, rel=TABLE + NOISE)


def test_a_mirror_is_a_look_up(sided):
    _, light = sided
    normal = np.tile([0.0, 0.0, 1.0], (50, 1))
    view = np.random.default_rng(3).normal(size=(50, 3))
    view[:, 2] = np.abs(view[:, 2]) + 0.5
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    ones = np.ones((50, 3))
    found = light.reflected(normal, view, np.full(50, 1e-3), ones, 0.0 * ones)
    mirrored = view * np.array([-1.0, -1.0, 1.0])
    # Scale and bias of a white mirror sum to one.
    np.testing.assert_allclose(found, look_up(light.levels[0], mirrored), rtol=TABLE)


@pytest.mark.parametrize("turn", [0.0, 1.1])
def test_axes_are_those_of_the_world(sided, turn):
    environment, light = sided[0].rotated(turn), sided[1]
    material, scene = [flat(0.7, (1.0,) * 3, (0.3,) * 3, 16)], scenes.sphere((16, 16), 0, (24, 24))
    exact = render_appearance(material, scene, environment=environment)
    found = picture_through_probe(material, scene, light, environment)
    inside = scene.coverage == 1.0
    # Both bright and dim sides: what the split sum errs by at n.v of a sphere is below what a swapped axis would make.
    error = np.abs(found - exact)[inside].sum() / exact[inside].sum()
    assert error < 0.12
    wrong = picture_through_probe(material, scene, light, environment.rotated(np.pi / 2))
    assert np.abs(wrong - exact)[inside].sum() / exact[inside].sum() > 2.0 * error


def test_of_an_anisotropic_lobe_the_geometric_mean_is_looked_up(sided):
    environment, light = sided
    even = flat(0.4, (1.0,) * 3, (0,) * 3)
    stretched = np.zeros_like(even.log_roughness)
    stretched[..., 0], stretched[..., 1] = even.log_roughness[..., 0] + 1.0, even.log_roughness[..., 1] - 1.0
    pair = [
        picture_through_probe(
            [Svbrdf(even.normal, each, even.specular, even.diffuse, model="ggx", wrap="tile")],
            scenes.plane((8, 8), 0, (8, 8)), light, environment,
        )
        for each in (even.log_roughness, stretched)
    ]  # fmt: skip
    np.testing.assert_allclose(pair[0], pair[1], rtol=1e-4)


def test_an_engine_that_does_not_exist():
    with pytest.raises(UnknownNameError):
        ProbeLight.of(np.ones((4, 8, 3), np.float32), "quake")


@pytest.mark.parametrize("name", preset_names())
def test_manifests_of_materials_name_the_curve_of_probes(name):
    """A material and a probe for one engine agree on the level of a roughness: there is one function of it."""
    found = probe_of_materials(name)
    if name in ("godot", "blender", "ntc"):
        assert found is None
        return
    probe = PRESETS[found["preset"]]
    curve = get_curve(probe.curve, probe.levels, probe.size)
    assert found["curve"] == curve.name and found["lod"] == curve.formula
    # The printed line is what the function computes.
    roughness = np.linspace(0.2, 0.9, 8)
    line = curve.formula.split("=")[1].replace("^", "**")
    said = eval(line, {"r": roughness, "log2": np.log2})
    np.testing.assert_allclose(said, curve.level(roughness), rtol=1e-9)


def test_alphas_are_those_of_the_program():
    curve = get_curve("unity", 7, 256)
    roughness = curve.roughness(np.arange(7.0))
    np.testing.assert_allclose(np.square(curve.alphas()), alpha_squared_from_perceptual(roughness), rtol=1e-12)
