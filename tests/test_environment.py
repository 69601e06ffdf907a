"""Laws of environment lighting: known totals, the white furnace, agreement of its sampling with brute force."""

from __future__ import annotations

import numpy as np
import pytest
import shading_oracle as shading

from brdffit.render import scenes
from brdffit.render.environment import Environment, procedural_environment
from brdffit.render.lights import Lights
from brdffit.render.pictures import render_appearance
from brdffit.render.reference import render_halves, render_reference
from brdffit.render.terms import Terms
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf

STUDIO = procedural_environment(64)
#: 1024 pairs of directions under multiple importance sampling.
SAMPLED = 0.02


def flat(roughness, specular=1.0, diffuse=0.0):
    size = (2, 2)
    normal = np.broadcast_to(np.array([0, 0, 1], np.float32), (*size, 3)).copy()
    log = log_tensor_from_perceptual(np.full(size, roughness, np.float32))
    return Svbrdf(normal, log, np.full((*size, 3), specular, np.float32), np.full((*size, 3), diffuse, np.float32))


def pixel_directions(environment):
    """Directions (H, W, 3) of the pixels' centres and their solid angles (H, W)."""
    height, width = environment.radiance.shape[:2]
    elevation = (0.5 - (np.arange(height) + 0.5) / height) * np.pi
    azimuth = ((np.arange(width) + 0.5) / width * 2.0 - 1.0) * np.pi
    elevation, azimuth = np.meshgrid(elevation, azimuth, indexing="ij")
    level = np.cos(elevation)
    direction = np.stack([level * np.sin(azimuth), np.sin(elevation), -level * np.cos(azimuth)], axis=-1)
    return direction, np.broadcast_to(environment.solid_angle[:, None], (height, width))


def turned(angle):
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([(cos, 0.0, sin), (0.0, 1.0, 0.0), (-sin, 0.0, cos)])


def test_solid_angles_fill_the_sphere_and_the_density_integrates_to_one():
    assert STUDIO.solid_angle.sum() * STUDIO.radiance.shape[1] == pytest.approx(4 * np.pi)
    assert (STUDIO.solid_angle @ STUDIO.density).sum() == pytest.approx(1.0)


def test_samples_lie_in_their_pixels_and_integrate_to_the_total():
    direction, at = STUDIO.samples(8192)
    height, width = STUDIO.radiance.shape[:2]
    row = (0.5 - np.arcsin(direction[:, 1]) / np.pi) * height
    column = (np.arctan2(direction[:, 0], -direction[:, 2]) / (2 * np.pi) + 0.5) * width
    assert (np.abs(row - 0.5 - at[:, 0]) <= 0.5 + 1e-6).all()
    assert (np.abs(column - 0.5 - at[:, 1]) <= 0.5 + 1e-6).all()
    estimate = (STUDIO.radiance[tuple(at.T)] / STUDIO.density[tuple(at.T)][:, None]).mean(axis=0)
    np.testing.assert_allclose(estimate, STUDIO.total(), rtol=0.01)
    # A function that is not the radiance: the mean height of where the light comes from.
    pixels, solid = pixel_directions(STUDIO)
    expected = np.einsum("hw,hw,hwc->c", pixels[..., 1], solid, STUDIO.radiance)
    weight = STUDIO.radiance[tuple(at.T)] / STUDIO.density[tuple(at.T)][:, None]
    np.testing.assert_allclose((weight * direction[:, 1:2]).mean(axis=0), expected, atol=0.01 * STUDIO.total().max())


def albedo(roughness, view_cosine, terms, n=600):
    """Directional albedo of a flat surface by a midpoint rule in half-angle space around the mirror direction."""
    u, v = (np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n
    # Lights by their own polar angle: sin theta dtheta dphi.
    theta, phi = np.meshgrid(0.5 * np.pi * u, 2 * np.pi * v, indexing="ij")
    light = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    view = np.array([np.sqrt(1 - view_cosine**2), 0.0, view_cosine])
    square = roughness**4
    tensor, white, black = np.array([square, square, 0.0]), np.ones(3), np.zeros(3)
    value = shading.brdf(light, view, np.array([0.0, 0.0, 1.0]), tensor, white, black)[..., 0]
    return float((value * np.sin(theta)).sum() * 0.5 * np.pi / n * 2 * np.pi / n)


@pytest.mark.parametrize("roughness", [0.05, 0.4, 0.7, 1.0])
def test_the_white_furnace(roughness):
    """Under a sky of radiance 1 a white surface sends back at most 1; what masking takes away, by brute force."""
    sky, base = Environment(np.ones((16, 32, 3))), flat(roughness)
    scene = scenes.sphere(base.size, 0, (9, 9))
    pictures = [
        render_reference(base, scene, environment=sky, samples=4096),
        render_appearance([base], scene, environment=sky),
    ]
    for at in [(4, 4), (4, 7), (2, 3)]:
        expected = albedo(roughness, float(scene.view[at][2]), Terms()) if roughness > 0.1 else None
        for picture in pictures:
            assert picture[at].max() <= 1.0 + SAMPLED
            if expected is None:
                # A mirror gives back everything.
                assert picture[at] == pytest.approx(1.0, abs=SAMPLED)
            else:
                assert picture[at] == pytest.approx(expected, abs=SAMPLED)


@pytest.mark.parametrize("roughness", [0.12, 0.5])
@pytest.mark.parametrize("angle", [0.0, 1.1])
def test_the_studio_by_brute_force(roughness, angle):
    """Every pixel of the environment as a directional light, in NumPy."""
    studio, base = procedural_environment(96).rotated(angle), flat(roughness, 0.6, 0.5)
    scene = scenes.plane(base.size, 0, (2, 2))
    direction, solid = pixel_directions(studio)
    light = direction.reshape(-1, 3) @ turned(angle).T
    frame, view = scene.frame[0, 1].astype(float), scene.view[0, 1].astype(float)
    square = roughness**4
    brdf = shading.brdf(
        light @ frame.T, view, np.array([0.0, 0.0, 1.0]), np.array([square, square, 0.0]), np.full(3, 0.6),
        np.full(3, 0.5),
    )  # fmt: skip
    expected = np.einsum("nc,n,nc->c", brdf, solid.ravel(), studio.radiance.reshape(-1, 3))
    reference = render_reference(base, scene, environment=studio, samples=16384)[0, 1]
    # Nine harmonics are good to 3% of the diffuse part under small lamps; pixels are wider than the narrow lobe's node.
    np.testing.assert_allclose(reference, expected, rtol=0.05)
    np.testing.assert_allclose(render_appearance([base], scene, environment=studio)[0, 1], reference, rtol=0.05)


def test_diffuse_light_is_the_cosine_filtered_environment_above_the_plane():
    """Nine harmonics against the sum over pixels, for planes and normals around theirs; exact for the plane's own."""
    pixels, solid = pixel_directions(STUDIO)
    random = np.random.default_rng(0)
    up = random.normal(size=(20, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    tilted = up + 0.5 * random.normal(size=up.shape)
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    c = STUDIO.harmonics(up, fresnel=True)
    above = np.einsum("hwk,nk->nhw", pixels, up) > 0.0
    for normals, bound in ((up, 0.01), (tilted, 0.12)):
        x, y, z = normals.T
        basis = np.stack([np.ones(20), x, y, z, x * y, y * z, x * z, x * x - y * y, 3 * z * z - 1])
        cosine = np.maximum(np.einsum("hwk,nk->nhw", pixels, normals), 0.0) * above
        largest = np.einsum("nhw,hw,hwc->nc", cosine, solid, STUDIO.radiance).max() / np.pi
        for k, kernel in enumerate([cosine, cosine * (1.0 - cosine) ** 5]):
            exact = np.einsum("nhw,hw,hwc->nc", kernel, solid, STUDIO.radiance) / np.pi
            found = np.einsum("bn,nbc->nc", basis, c[:, k])
            # Tilted: degree 2 leaves 3% of the brightest under a single lamp, more where the plane cuts the light.
            assert np.abs(found - exact).max() < bound * largest


@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.2])
def test_a_tilted_bump_sees_half_a_sky(tilt):
    """Under a sky of radiance 1 a white matt bump tilted by t on a plane sends back (1 + cos t) / 2: the plane hides
    the rest."""
    base = flat(0.5, 0.0, 1.0)
    base.normal[:] = np.array([np.sin(tilt), 0.0, np.cos(tilt)], np.float32)
    sky, scene = Environment(np.ones((64, 128, 3))), scenes.plane(base.size, 0, (2, 2))
    terms = Terms(fresnel=False)
    pictures = [
        render_reference(base, scene, environment=sky, terms=terms, samples=1024),
        render_appearance([base], scene, environment=sky, terms=terms),
    ]
    for picture in pictures:
        np.testing.assert_allclose(picture, 0.5 * (1.0 + np.cos(tilt)), rtol=2e-3)


@pytest.mark.parametrize("light", ["environment", "lamps"])
def test_light_from_below_the_plane_lights_no_bump(light):
    """A bump that leans to the light sees nothing of it where the plane hides it, whatever the light is."""
    base = flat(0.6, 0.5, 0.5)
    base.normal[:] = np.array([0.8, 0.0, 0.6], np.float32)
    scene = scenes.plane(base.size, 0, (2, 2))
    below = np.array([np.cos(-0.2), 0.0, np.sin(-0.2)])
    lamp = Lights(below, np.ones(3), np.array([0.1]))
    if light == "environment":
        direction, _ = pixel_directions(STUDIO)
        disc = np.where((direction @ below)[..., None] > np.cos(0.1), 100.0, 0.0)
        given = {"environment": Environment(np.repeat(disc, 3, axis=-1))}
    else:
        given = {"lights": lamp}
    assert not render_reference(base, scene, **given, samples=1024).any()
    assert render_appearance([base], scene, **given).max() < 1e-6


def test_environments_add_to_lights_and_halves_know_their_noise():
    base = flat(0.3, 0.5, 0.5)
    scene = scenes.plane(base.size, 0, (4, 4))
    from brdffit.render import lights

    both = render_reference(base, scene, lights.few(), environment=STUDIO, samples=1024)
    apart = [render_reference(base, scene, lights.few(), samples=1024)]
    apart.append(render_reference(base, scene, environment=STUDIO, samples=1024))
    np.testing.assert_allclose(both, apart[0] + apart[1], rtol=1e-5)
    assert render_halves(base, scene, environment=STUDIO, samples=4096).noise_db > 25.0


def test_what_is_no_environment_is_refused():
    with pytest.raises(ValueError, match="expected"):
        Environment(np.ones((4, 8)))
    with pytest.raises(ValueError, match="negative or not finite"):
        Environment(-np.ones((4, 8, 3)))
