"""Laws of lamps that have a size: their table, the limit of a point, a disc by brute force, mirrors of discs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from brdffit.render import lights as light_sets
from brdffit.render import scenes
from brdffit.render.lights import Lights
from brdffit.render.pictures import render_appearance, render_appearance_halves
from brdffit.render.reference import render_halves, render_reference
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf

LAMPS = Lights(
    np.array([(0.3, 0.2, 1.0), (-0.4, 0.1, 0.8)]), np.array([(1.0, 0.8, 0.5), (0.3, 0.6, 0.9)]), np.array([0.2, 0.05])
)


def flat(roughness, specular=0.6, diffuse=0.3):
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), (2, 2, 3)).copy()
    log = log_tensor_from_perceptual(np.full((2, 2), roughness, np.float32))
    return Svbrdf(normal, log, np.full((2, 2, 3), specular, np.float32), np.full((2, 2, 3), diffuse, np.float32))


def test_the_table_of_lamps_integrates_to_their_irradiance():
    direction, radiance, density = LAMPS.table[2:5].T, LAMPS.table[5:8].T, LAMPS.table[8]
    assert (density > 0.0).all()
    for middle, irradiance, radius in zip(LAMPS.direction, LAMPS.irradiance, LAMPS.radius, strict=True):
        cosine = direction @ middle
        inside = (cosine > math.cos(radius) - 1e-6).astype(float)
        found = (radiance * (inside * cosine / density)[:, None]).mean(axis=0)
        np.testing.assert_allclose(found, irradiance, rtol=3e-3)


def test_a_number_holds_for_all_and_bad_radii_are_refused():
    assert LAMPS.sized(0.01).radius.tolist() == [0.01, 0.01]
    assert light_sets.few().radius.tolist() == [0.0] * 4
    with pytest.raises(ValueError, match="angular radius"):
        LAMPS.sized(2.0)
    with pytest.raises(ValueError, match="angular radius"):
        LAMPS.sized(-0.1)


@pytest.mark.parametrize("roughness", [0.3, 0.6])
def test_the_smaller_a_lamp_the_nearer_to_a_point(roughness):
    base = flat(roughness)
    scene = scenes.plane(base.size, 0, (6, 6))
    point = render_appearance([base], scene, LAMPS.sized(0.0))
    for draw in (
        lambda lights: render_appearance([base], scene, lights),
        lambda lights: render_reference(base, scene, lights, samples=4096),
    ):
        np.testing.assert_allclose(draw(LAMPS.sized(0.0047)), point, rtol=4e-3)


@pytest.mark.parametrize("roughness", [0.15, 0.3, 0.7])
def test_a_lamp_is_the_mean_of_points_in_its_disc(roughness):
    base = flat(roughness)
    scene = scenes.plane(base.size, 0, (6, 6))
    count = 100_000
    middle = LAMPS.direction[0].astype(float)
    across = np.linalg.svd(middle[None])[2][1:]
    # A sunflower: even over the disc, and no noise.
    cosine = 1.0 - (np.arange(count) + 0.5) / count * (1.0 - math.cos(0.2))
    angle = np.pi * (3.0 - math.sqrt(5.0)) * np.arange(count)
    sine = np.sqrt(1.0 - cosine**2)
    points = cosine[:, None] * middle + sine[:, None] * (
        np.cos(angle)[:, None] * across[0] + np.sin(angle)[:, None] * across[1]
    )
    # Even radiance: each point stands for the same radiance times solid angle.
    each = LAMPS.irradiance[0] / (math.pi * math.sin(0.2) ** 2) * 2.0 * math.pi * (1.0 - math.cos(0.2)) / count
    expected = render_appearance([base], scene, Lights(points, np.broadcast_to(each, (count, 3))))
    lamp = Lights(LAMPS.direction[:1], LAMPS.irradiance[:1], LAMPS.radius[:1])
    scale = expected.max()
    np.testing.assert_allclose(render_appearance([base], scene, lamp), expected, atol=0.015 * scale)
    np.testing.assert_allclose(render_reference(base, scene, lamp, samples=8192), expected, atol=0.01 * scale)


def test_a_mirror_shows_the_disc_and_its_radiance():
    """Where a perfect mirror sees a lamp it sends back the lamp's radiance, times its Fresnel term."""
    base = flat(0.05, specular=1.0, diffuse=0.0)
    scene = scenes.sphere(base.size, 0, (96, 96))
    lamp = Lights(np.array([(0.0, 0.0, 1.0)]), np.ones((1, 3)), np.array([0.3]))
    picture = render_appearance([base], scene, lamp)
    assert picture[48, 48] == pytest.approx(1.0 / (math.pi * math.sin(0.3) ** 2), rel=0.02)
    # A normal tilted by t mirrors the view into 2 t.
    mirrored = 2.0 * np.arccos(np.clip(scene.view[..., 2], -1.0, 1.0))
    assert not picture[(mirrored > 0.4) & (scene.coverage > 0)].max() > 0.05
    assert picture[mirrored < 0.25].min() > 0.9 * picture[48, 48, 0]


def test_halves_of_reference_and_picture_are_independent():
    """Their products estimate the error of a picture without the noise of either: here there is none."""
    base = flat(0.2)
    scene = scenes.plane(base.size, 0, (24, 24))
    reference = render_halves(base, scene, LAMPS, samples=1024)
    halves = render_appearance_halves([base], scene, LAMPS)
    own = np.sum(np.square(halves[0] - halves[1]), dtype=np.float64)
    error = np.sum((halves[0] - reference.halves[0]) * (halves[1] - reference.halves[1]), dtype=np.float64)
    assert own > 0.0
    assert abs(error) < 0.15 * own
