"""Directions of a scene: where they lie, and how often."""

import math

import numpy as np
import pytest

from brdffit.colour import LUMINANCE
from brdffit.errors import InputError
from brdffit.planning.description import PROCEDURAL, Camera, Light, SceneFile, Surface
from brdffit.planning.lighting import directions
from brdffit.planning.reach import GRAZING
from brdffit.render.environment import procedural_environment
from brdffit.render.pairs import _directions, pair_errors
from brdffit.render.terms import LOBE_ONLY
from brdffit.svbrdf import Svbrdf

FLAT = Surface(set="flat")
LAMPS = (
    Light(direction=(0.0, 0.0, 2.0), irradiance=3.0),
    Light(direction=(1.0, 0.0, 1.0), irradiance=(0.0, 1.0, 0.0)),
    Light(direction=(-0.5, 0.5, 1.0), irradiance=0.5, size=20.0),
)
TEXELS, PAIRS = 40, 500
#: Five standard errors of a share of 1/2 among so many.
CHANCE = 5.0 * 0.5 / math.sqrt(TEXELS * PAIRS)


def scene(surface=FLAT, lights=LAMPS, **others):
    return SceneFile(surfaces=(surface,), lights=lights, **others)


def draw(scene_file, seed=0, texels=TEXELS):
    return directions(scene_file, scene_file.surfaces[0], texels, PAIRS, seed)


def near(light, one, degrees=1e-4):
    axis = np.array(one.direction) / np.linalg.norm(one.direction)
    return light @ axis >= math.cos(math.radians(degrees))


SCENES = {
    "lamps": scene(),
    "room": scene(lights=(), environment=PROCEDURAL),
    "both": scene(environment=PROCEDURAL),
    "ball": scene(Surface(set="ball", radius=0.1), environment=PROCEDURAL),
    "grazing": scene(cameras=(Camera(tilt=(85.0, 89.0)),)),
    "low": scene(lights=(Light(direction=(1.0, 0.0, 0.0), size=40.0),)),
}


@pytest.mark.parametrize("name", SCENES)
def test_directions_are_unit_vectors_above_the_horizon(name):
    view, light, weight = draw(SCENES[name])
    for each in (view, light):
        assert each.shape == (TEXELS, PAIRS, 3) and each.dtype == np.float64 and each.flags.c_contiguous
        np.testing.assert_allclose(np.linalg.norm(each, axis=-1), 1.0, atol=1e-12)
        assert (each[..., 2] > 0.0).all()
    np.testing.assert_allclose(weight, 1.0 / PAIRS)


def test_a_seed_stands_for_its_directions():
    one, same, other = (draw(SCENES["ball"], seed)[:2] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert (np.abs(np.array(one) - np.array(other)).max(axis=-1) > 0.0).all()


def test_a_light_without_size_is_exactly_its_direction():
    _, light, _ = draw(scene(lights=LAMPS[1:2]))
    np.testing.assert_array_equal(light, np.broadcast_to(np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0), light.shape))


def test_each_light_is_drawn_as_its_luminance():
    _, light, _ = draw(scene())
    luminance = np.array([3.0, LUMINANCE[1], 0.5])
    shares = [near(light, one, 10.0 + 1e-4).mean() for one in LAMPS]
    np.testing.assert_allclose(shares, luminance / luminance.sum(), atol=CHANCE)
    assert sum(shares) == pytest.approx(1.0)


def test_lights_and_surroundings_share_by_luminance():
    """Of the surroundings only what is above the horizon is drawn."""
    _, light, _ = draw(SCENES["both"])
    environment = procedural_environment()
    pixels, at = environment.samples(1 << 14)
    above = float(LUMINANCE @ environment.total()) * (pixels[:, 2] > 0.0).mean()
    lamps = 3.5 + float(LUMINANCE[1])
    # A pixel of the surroundings comes as near to a point light by chance alone.
    share = near(light, LAMPS[0]).mean() / (3.0 / lamps)
    assert share == pytest.approx(lamps / (lamps + above), abs=2.0 * CHANCE)


def test_surroundings_are_drawn_as_their_luminance():
    """Mean direction of the drawn light against the integral over the pixels of the upper half."""
    _, light, _ = draw(SCENES["room"])
    studio = procedural_environment(128)
    rows, columns = np.indices(studio.radiance.shape[:2]) + 0.5
    elevation, azimuth = (0.5 - rows / 128) * math.pi, (columns / 128 - 1.0) * math.pi
    pixel = np.stack(
        [np.cos(elevation) * np.sin(azimuth), np.sin(elevation), -np.cos(elevation) * np.cos(azimuth)], axis=-1
    )
    mass = (studio.radiance @ LUMINANCE) * studio.solid_angle[:, None] * (pixel[..., 2] > 0.0)
    expected = np.einsum("hw,hwc->c", mass, pixel) / mass.sum()
    # Lamps are some pixels wide: two sizes of the picture differ by a percent.
    np.testing.assert_allclose(light.reshape(-1, 3).mean(axis=0), expected, atol=2.0 * CHANCE + 0.01)


def test_a_light_of_some_size_is_a_disc():
    """Uniform over the cap: its height above the rim is as likely as another, and no azimuth is preferred."""
    lamp = Light(direction=(0.3, -0.2, 1.0), size=50.0)
    _, light, _ = draw(scene(lights=(lamp,)))
    axis = np.array(lamp.direction) / np.linalg.norm(lamp.direction)
    low = math.cos(math.radians(25.0))
    height = (light.reshape(-1, 3) @ axis - low) / (1.0 - low)
    assert (height >= -1e-12).all() and (height <= 1.0 + 1e-12).all()
    quantiles = np.quantile(height, [0.1, 0.5, 0.9])
    np.testing.assert_allclose(quantiles, [0.1, 0.5, 0.9], atol=CHANCE)
    mean = light.reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(mean, axis * 0.5 * (1.0 + low), atol=CHANCE * math.sin(math.radians(25.0)))


def test_a_view_counts_as_the_pixels_that_have_it():
    """All tilts together are the cosine distribution; a range is cut out of it."""
    view, _, _ = draw(scene(cameras=(Camera(tilt=(20.0, 50.0)),)))
    sine_squared = 1.0 - np.square(view[..., 2])
    low, high = (math.sin(math.radians(tilt)) ** 2 for tilt in (20.0, 50.0))
    assert sine_squared.min() >= low - 1e-12 and sine_squared.max() <= high + 1e-12
    np.testing.assert_allclose(
        np.quantile((sine_squared - low) / (high - low), [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=CHANCE
    )
    np.testing.assert_allclose(view[..., :2].mean(axis=(0, 1)), 0.0, atol=CHANCE)
    cosine, _ = _directions(np.random.default_rng(0), TEXELS, PAIRS)
    view, _, _ = draw(scene(cameras=(Camera(tilt=(0.0, 89.999)),)))
    quantiles = [np.quantile(each[..., 2], [0.1, 0.3, 0.5, 0.7, 0.9]) for each in (view, cosine)]
    np.testing.assert_allclose(*quantiles, atol=2.0 * CHANCE)


def test_cameras_count_alike():
    two = (Camera(tilt=10.0, distance=(1.0, 100.0)), Camera(tilt=70.0))
    view, _, _ = draw(scene(cameras=two))
    assert near(view, Light(direction=(0.0, 0.0, 1.0)), 11.0).mean() == pytest.approx(0.5, abs=CHANCE)


def test_a_curved_surface_is_seen_up_to_grazing_and_lit_from_all_sides():
    front = (Camera(tilt=0.0),)
    view, light, _ = draw(scene(Surface(set="ball", radius=0.01), LAMPS[:1], cameras=front))
    # One light in the camera's own direction: both stay one, wherever the ball has turned.
    np.testing.assert_allclose(view, light, atol=1e-12)
    tilt = np.degrees(np.arccos(view[..., 2]))
    assert GRAZING - 1.0 < tilt.max() <= GRAZING
    almost, _, _ = draw(scene(Surface(set="ball", radius=1e7), LAMPS[:1], cameras=front))
    np.testing.assert_allclose(almost[..., 2], 1.0, atol=1e-6)
    # A light beside the ball reaches its side, which a flat surface has not.
    beside = (Light(direction=(1.0, 0.0, -0.1)),)
    view, light, _ = draw(scene(Surface(set="ball", radius=0.01), beside, cameras=front))
    np.testing.assert_allclose((view * light).sum(axis=-1), -0.1 / math.hypot(1.0, 0.1), atol=1e-12)


def test_from_afar_more_of_a_curved_surface_is_seen():
    ball, overhead = Surface(set="ball", radius=1.0), LAMPS[:1]
    tilts = []
    for distance in (0.1, (0.1, 50.0), 50.0):
        eye = Camera(distance=distance, tilt=0.0, field_of_view=20.0)
        tilts.append(np.degrees(np.arccos(draw(scene(ball, overhead, cameras=(eye,)))[0][..., 2])))
    near, both, far = tilts
    assert near.max() < 3.0 and far.max() > GRAZING - 1.0
    assert (both < 3.0).mean() > 0.1 and both.max() > GRAZING - 1.0


@pytest.mark.parametrize("name", ["lamps", "ball"])
def test_highlights_that_are_looked_for_change_no_mean(name):
    """Two lobes a texel: chosen pairs scatter less about the mean of a sharp one, and about that of anything else as
    half as many would at most, or a quarter."""
    texels, few = 24, 64
    normal = np.tile(np.array([[(0.0, 0.0, 1.0), (0.1, 0.2, 0.97)]]), (texels, 1, 1))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    width = np.full((texels, 2), 0.05)

    def means(pairs, seed, highlights):
        """Means at each texel of the square of a lobe (of the second normal) and of a smooth function."""
        view, light, weight = directions(SCENES[name], SCENES[name].surfaces[0], texels, pairs, seed, highlights)
        half = (view + light) / np.linalg.norm(view + light, axis=-1, keepdims=True)
        lobe = 1.0 / np.square(1.0 - np.square(half @ normal[0, 1]) * (1.0 - 0.05**2))
        return [(weight * each).sum(axis=1) for each in (np.square(lobe), view[..., 0] + light[..., 2])]

    expected = [float(each.mean()) for each in means(4000, 0, None)]
    plain, chosen = means(few, 1, None), means(few, 1, (normal, width))
    scatter = [(each.std(), other.std()) for each, other in zip(plain, chosen, strict=True)]
    assert scatter[0][1] < 0.4 * scatter[0][0]  # worth six times as many pairs
    assert scatter[1][1] < 2.0 * scatter[1][0]
    for found, mean, (_, spread) in zip(chosen, expected, scatter, strict=True):
        # The pool is one for all texels: it scatters too, by some percent of a sharp lobe.
        assert found.mean() == pytest.approx(mean, abs=5.0 * spread / math.sqrt(texels), rel=0.1)


def test_no_light_is_told():
    behind = scene(lights=(Light(direction=(0.0, 1.0, -0.1)),))
    with pytest.raises(InputError, match="No light of the scene reaches 'flat'"):
        draw(behind)
    with pytest.raises(InputError, match="The lights of the scene are black"):
        draw(scene(lights=(Light(direction=(0.0, 0.0, 1.0), irradiance=0.0),)))
    with pytest.raises(InputError, match=r"none\.hdr"):
        draw(scene(environment="none.hdr"))


def test_pairs_take_given_directions():
    """Those that it would draw itself give what it gives itself; the scale of the weights says nothing."""
    random = np.random.default_rng(4)
    normal = random.normal(0.0, 0.2, (8, 8, 3)).astype(np.float32)
    normal[..., 2] = 1.0
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    log_roughness = np.zeros((8, 8, 3), np.float32)
    log_roughness[..., :2] = 2.0 * math.log(0.3)
    base = Svbrdf(normal, log_roughness, np.full((8, 8, 3), 0.5, np.float32), np.zeros((8, 8, 3), np.float32))
    level = Svbrdf(*(np.ascontiguousarray(each[::4, ::4]) for each in (
        base.normal, base.log_roughness, base.specular, base.diffuse)))  # fmt: skip

    def errors(**directions):
        return np.vstack(pair_errors(base, [level], [0, 1], [1, 1], 32, 5, LOBE_ONLY, samples=64, **directions))

    view, light = _directions(np.random.default_rng(5), 2, 32)
    for scale in (1.0, 7.0):
        given = errors(directions=(view, light, np.full((2, 32), scale)))
        np.testing.assert_allclose(given, errors(), rtol=1e-12)
    # A pair of no weight is not there.
    weight = np.ones((2, 32))
    weight[:, 16:] = 0.0
    alone = errors(directions=(view[:, :16], light[:, :16], weight[:, :16]))
    np.testing.assert_allclose(errors(directions=(view, light, weight)), alone, rtol=1e-12)
    assert (np.abs(alone / errors() - 1.0) > 1e-3).all()
