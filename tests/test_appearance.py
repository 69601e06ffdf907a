"""Appearances that are no pyramid of lobes: the path in numpy against the compiled loops, and what it asks of them."""

from types import SimpleNamespace

import numpy as np
import pytest

from brdffit.appearance import Appearance, LobePyramid, Lookups, bilinear, trilinear
from brdffit.errors import InputError
from brdffit.render import scenes
from brdffit.render.environment import procedural_environment
from brdffit.render.pictures import render_appearance, render_appearance_halves
from brdffit.render.terms import LOBE_ONLY
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf


def some_levels(model="ggx", seed=3, size=16):
    """Random levels of a pyramid; nothing in them belongs together."""
    random = np.random.default_rng(seed)
    levels = []
    while size:
        normal = random.normal(0.0, 0.25, (size, size, 3)) + (0.0, 0.0, 1.0)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        log = log_tensor_from_perceptual(random.uniform(0.35, 0.8, (size, size)))
        log[..., 2] = random.uniform(-0.4, 0.4, (size, size))
        colours = random.uniform(0.0, 0.9, (2, size, size, 3))
        shape = random.uniform(-0.3, 0.3, (size, size)) if model == "generalised-beckmann" else None
        arrays = (np.asarray(each, np.float32) for each in (normal, log, *colours))
        levels.append(Svbrdf(*arrays, model=model, shape=None if shape is None else shape.astype(np.float32)))
        size //= 2
    return levels


def hidden(pyramid):
    """The same appearance, but no ``LobePyramid``, so that it is drawn by the path in numpy."""
    names = ("base_size", "look_up", "evaluate", "sample", "pdf")
    return SimpleNamespace(**{name: getattr(pyramid, name) for name in names})


def test_a_pyramid_of_lobes_is_an_appearance():
    assert isinstance(LobePyramid(some_levels()), Appearance)
    assert isinstance(hidden(LobePyramid(some_levels())), Appearance)


@pytest.mark.parametrize("model", ["ggx", "beckmann", "generalised-beckmann", "ashikhmin-shirley"])
def test_the_path_in_numpy_draws_lights_as_the_compiled_loops_do(model):
    pyramid = LobePyramid(some_levels(model))
    for scene in (scenes.slanted((16, 16), (24, 24)), scenes.sphere((16, 16), 1, (24, 24))):
        compiled, plain = render_appearance(pyramid, scene), render_appearance(hidden(pyramid), scene)
        np.testing.assert_allclose(plain, compiled, rtol=2e-3, atol=2e-4 * compiled.max())


def test_terms_can_be_left_out_of_lobes_alone():
    pyramid = LobePyramid(some_levels())
    scene = scenes.plane((16, 16), 1, (8, 8))
    assert render_appearance(pyramid, scene, terms=LOBE_ONLY).any()
    with pytest.raises(InputError, match="Only a pyramid of lobes"):
        render_appearance(hidden(pyramid), scene, terms=LOBE_ONLY)


def test_a_scene_of_another_size_is_refused():
    with pytest.raises(InputError, match=r"made for a base of \(32, 32\)"):
        render_appearance(hidden(LobePyramid(some_levels())), scenes.plane((32, 32), 1, (8, 8)))


def test_directions_are_drawn_with_the_density_that_is_told():
    """The mean of 1 / pdf over drawn directions is the measure of where they can fall, here a cap of light."""
    pyramid = LobePyramid(some_levels())
    random = np.random.default_rng(0)
    view = np.array([0.3, -0.2, 0.93]) / np.linalg.norm([0.3, -0.2, 0.93])
    count = 200_000
    lookups = Lookups(
        np.full((count, 2), 5.3), np.broadcast_to(np.eye(2), (count, 2, 2)), np.full(count, 1.4),
        np.broadcast_to(view, (count, 3)),
    )  # fmt: skip
    texels = pyramid.look_up(lookups)
    light = pyramid.sample(texels, lookups.view, random.random((count, 2)))
    np.testing.assert_allclose(np.linalg.norm(light, axis=1), 1.0, rtol=1e-5)
    density = pyramid.pdf(texels, lookups.view, light)
    for axis, cosine in (((0.0, 0.0, 1.0), 0.9), ((0.3, 0.4, 0.866), 0.95)):
        axis = np.asarray(axis) / np.linalg.norm(axis)
        inside = light @ axis > cosine
        cap = np.where(inside, 1.0 / np.maximum(density, 1e-9), 0.0)
        expected = 2.0 * np.pi * (1.0 - cosine)
        assert cap.mean() == pytest.approx(expected, abs=5.0 * cap.std() / np.sqrt(count))


def test_images_are_read_between_texels_and_levels():
    image = np.arange(12, dtype=np.float32).reshape(3, 4, 1)
    position = np.array([[0.5, 0.5], [1.0, 0.5], [0.0, 0.5], [2.5, 3.0]])
    np.testing.assert_allclose(bilinear(image, position, "tile")[:, 0], [0.0, 0.5, 1.5, 6.0])
    np.testing.assert_allclose(bilinear(image, position, "clamp")[:, 0], [0.0, 0.5, 0.0, 10.0])
    levels = [np.full((4, 4, 1), 2.0, np.float32), np.full((2, 2, 1), 6.0, np.float32)]
    detail = np.array([-3.0, 0.25, 1.0, 9.0])
    lookups = Lookups(np.zeros((4, 2)), np.zeros((4, 2, 2)), detail, np.zeros((4, 3)))
    np.testing.assert_allclose(trilinear(levels, lookups, (4, 4), "tile")[:, 0], [2.0, 3.0, 6.0, 6.0])


def test_the_path_in_numpy_draws_an_environment_as_the_compiled_loops_do():
    pyramid = LobePyramid(some_levels())
    scene, studio = scenes.sphere((16, 16), 1, (48, 48)), procedural_environment(64).rotated(0.7)
    compiled, plain = (render_appearance_halves(each, scene, environment=studio) for each in (pyramid, hidden(pyramid)))
    # The noise of either is independent of the other's: the product of the differences has the mean of their square.
    error = np.sum((plain[0] - compiled[0]) * (plain[1] - compiled[1]), dtype=np.float64)
    power = np.sum(compiled[0] * compiled[1], dtype=np.float64)
    assert error / power < 1e-3
    np.testing.assert_allclose(plain.sum(axis=(0, 1, 2)), compiled.sum(axis=(0, 1, 2)), rtol=0.02)
