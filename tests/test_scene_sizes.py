"""Sizes of a scene's lights: lamps keep theirs, an environment is taken apart, and a bake is fitted for both."""

import math

import numpy as np
import pytest

from brdffit.colour import LUMINANCE
from brdffit.errors import InputError
from brdffit.halfangle.lights import SHARE, sizes_of
from brdffit.models import get_model
from brdffit.planning.description import PROCEDURAL, Light, SceneFile, Surface
from brdffit.planning.sizes import MOST_SIZES, environment_sizes, light_sizes, lights_option, shares_of
from brdffit.planning.trial import _widened
from brdffit.render.environment import Environment, procedural_environment
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.procedural import make_set
from brdffit.textures.reading import read_texture_set

FLAT, BALL = Surface(set="flat"), Surface(set="ball", radius=0.1)
SUN = Light(direction=(0.2, 0.3, 1.0), irradiance=3.0, size=0.54)
SKY = Light(direction=(0.0, 0.0, 1.0), irradiance=1.0, size=180.0)
POINT = Light(direction=(1.0, 0.0, 1.0))


def scene(*lights, **others):
    return SceneFile(surfaces=(FLAT,), lights=lights, **others)


def directions(height):
    """Pixels of an equirectangular picture, (height, 2 height, 3)."""
    elevation = (0.5 - (np.arange(height) + 0.5) / height) * math.pi
    azimuth = ((np.arange(2 * height) + 0.5) / height - 1.0) * math.pi
    elevation, azimuth = np.meshgrid(elevation, azimuth, indexing="ij")
    return np.stack(
        [np.cos(elevation) * np.sin(azimuth), np.sin(elevation), -np.cos(elevation) * np.cos(azimuth)], axis=-1
    )


def discs(*lamps, sky=0.0, height=256):
    """An environment of discs (direction, radius in degrees, radiance) before an even sky."""
    pixel, radiance = directions(height), np.full((height, 2 * height), sky)
    for direction, radius, bright in lamps:
        axis = np.array(direction) / np.linalg.norm(direction)
        radiance[pixel @ axis > math.cos(math.radians(radius))] += bright
    return Environment(np.repeat(radiance[..., None], 3, axis=2))


def test_lamps_keep_their_sizes_and_share_by_luminance():
    found = light_sizes(scene(SKY, SUN, POINT), FLAT)
    assert [each.radius for each in found] == pytest.approx([0.0, 0.27, 90.0])
    np.testing.assert_allclose(shares_of(found), [0.2, 0.6, 0.2], rtol=1e-6)
    # Which of the scene's lights they are.
    np.testing.assert_allclose(found[1].luminance, [0.0, 3.0, 0.0], rtol=1e-6)
    assert lights_option(found) == "0:0.200,0.27:0.600,90:0.200"


def test_points_alone_ask_for_the_error_of_the_papers():
    assert lights_option(light_sizes(scene(POINT, POINT), FLAT)) == "point"
    assert len(light_sizes(scene(POINT, POINT), FLAT)) == 1


def test_the_fit_reads_what_the_plan_writes():
    blur = get_model("ggx").blur
    for lights in ((SUN,), (SUN, SKY), (SUN, Light(direction=(0, 0, 1), irradiance=1e-9, size=20.0))):
        found = light_sizes(scene(*lights), FLAT)
        table = sizes_of(lights_option(found), blur, blur)
        np.testing.assert_allclose(table[:, SHARE], shares_of(found), atol=2e-3)


def test_many_sizes_become_few_and_no_light_is_lost():
    lamps = [Light(direction=(0, 0, 1), irradiance=1.0 + i, size=2.0 ** (i - 2)) for i in range(8)]
    found = light_sizes(scene(*lamps), FLAT)
    assert len(found) == MOST_SIZES
    np.testing.assert_allclose(sum(each.luminance for each in found), 1.0 + np.arange(8), rtol=1e-6)
    radii = [each.radius for each in found]
    assert radii == sorted(radii) and 0.125 < radii[0] and radii[-1] < 16.0


@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.3, 0.5, 0.6), (1.0, 0.2, 0.3)], ids=str)
def test_a_disc_is_found_at_its_size_wherever_it_stands(direction):
    """Also across the border of the picture, which lies straight before the surface."""
    ((radius, power),) = _together(environment_sizes(discs((direction, 8.0, 5.0)), front=True))
    assert radius == pytest.approx(8.0, rel=0.03)
    assert power == pytest.approx(5.0 * 2.0 * math.pi * (1.0 - math.cos(math.radians(8.0))), rel=0.05)


def test_a_sun_before_a_sky_is_a_disc_and_a_half_space():
    found = environment_sizes(discs(((0.2, 0.4, 1.0), 3.0, 400.0), sky=1.0), front=True)
    small = [(radius, power) for radius, power in found if radius < 20.0]
    wide = [(radius, power) for radius, power in found if radius >= 20.0]
    assert np.average([r for r, _ in small], weights=[p for _, p in small]) == pytest.approx(3.0, rel=0.06)
    assert [radius for radius, _ in wide] == pytest.approx([90.0] * len(wide), rel=0.02)
    # The sky goes on behind the sun.
    assert sum(power for _, power in wide) == pytest.approx(2.0 * math.pi, rel=0.12)


def test_two_lamps_apart_are_two_and_what_is_behind_counts_for_curved_surfaces_alone():
    one, other, behind = ((0.5, 0.0, 1.0), 6.0, 2.0), ((-0.5, 0.0, 1.0), 6.0, 2.0), ((0.0, 0.0, -1.0), 30.0, 2.0)
    around = discs(one, other, behind)
    front = environment_sizes(around, front=True)
    assert np.allclose([radius for radius, _ in front], 6.0, rtol=0.04)
    # It lies across the picture's border: two halves of a disc of 30 degrees.
    assert max(radius for radius, _ in environment_sizes(around, front=False)) > 20.0


def test_slabs_hold_all_the_light():
    environment = procedural_environment()
    total = float(LUMINANCE @ environment.total())
    found = environment_sizes(environment, front=False)
    assert sum(power for _, power in found) == pytest.approx(total, rel=1e-3)
    sizes = light_sizes(scene(environment=PROCEDURAL), FLAT)
    assert 1 < len(sizes) <= MOST_SIZES


def test_darkness_is_refused():
    with pytest.raises(InputError, match="black"):
        light_sizes(scene(Light(direction=(0, 0, 1), irradiance=0.0)), FLAT)


def test_lobes_are_seen_as_wide_as_their_lights(tmp_path):
    """A lobe under a light of radius r is wider by blur (r / 2)^2 along each of its axes."""
    base = to_svbrdf(read_texture_set(make_set("brushed-metal", tmp_path / "set", 16)))
    seen = _widened(base, 10.0)
    added = get_model(base.model).blur * math.radians(5.0) ** 2

    def eigenvalues(svbrdf):
        a, b, c = np.moveaxis(svbrdf.log_roughness.astype(np.float64), -1, 0)
        return np.exp(np.linalg.eigvalsh(np.stack([np.stack([a, c], -1), np.stack([c, b], -1)], -2)))

    np.testing.assert_allclose(eigenvalues(seen), eigenvalues(base) + added, rtol=1e-4)
    assert _widened(base, 0.0) is base


def _together(found):
    """Slabs of one disc as one light; pixels at its rim may be darker."""
    radius, power = np.array(found).T
    assert np.ptp(radius) < 1.5
    return [(np.average(radius, weights=power), power.sum())]
