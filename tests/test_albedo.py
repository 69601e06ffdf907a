"""What a lobe reflects of an even sky as it is rendered, and the bounded scale that follows it."""

import math

import numpy as np
import pytest

from brdffit.fitting.method import NonlinearFit
from brdffit.fitting.options import FitOptions
from brdffit.halfangle.albedo import albedo_at, albedo_of, albedo_of_lobes
from brdffit.halfangle.quadrature import ALPHA_SQUARED, LOBE_COLUMNS, SPECULAR, SPREAD
from brdffit.models.microfacet import brdf
from brdffit.svbrdf import Svbrdf


def cosine_directions(rng, count):
    u = rng.random((count, 2))
    radius, angle = np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - u[:, 0])], axis=-1)


def seen_under_a_sky(rng, alpha, normal, count, view=None):
    """Mean of the BRDF times n.l by brute force, lights even above the plane: a check that draws from no lobe.

    The BRDF of a white lobe without Fresnel's growth is that of specular 1.
    """
    light = rng.normal(size=(count, 3))
    light[:, 2] = np.abs(light[:, 2])
    light /= np.linalg.norm(light, axis=1, keepdims=True)
    viewer = cosine_directions(rng, count) if view is None else np.tile(view, (count, 1))
    tensor = np.tile([alpha**2, alpha**2, 0.0], (count, 1))
    found = brdf(np.tile(normal, (count, 1)), tensor, np.ones((count, 3)), np.zeros((count, 3)), viewer, light)
    return 2.0 * math.pi * float(found[:, 0].mean())


def leaning(degrees):
    return np.array([math.sin(math.radians(degrees)), 0.0, math.cos(math.radians(degrees))])


@pytest.mark.parametrize("alpha", [0.25, 0.6, 0.94])
@pytest.mark.parametrize("degrees", [0.0, 25.0, 50.0, 70.0])
def test_albedo_is_that_of_the_renderers_lobe(alpha, degrees):
    expected = seen_under_a_sky(np.random.default_rng(1), alpha, leaning(degrees), 400_000)
    assert albedo_at(alpha**2, math.cos(math.radians(degrees))) == pytest.approx(expected, abs=0.012)


def test_a_mirror_sends_back_the_squared_cosine():
    """The mean over viewers of whether the mirrored direction lies above the plane."""
    rng = np.random.default_rng(2)
    view = cosine_directions(rng, 200_000)
    for degrees in (0.0, 20.0, 45.0, 75.0):
        normal = leaning(degrees)
        towards = view @ normal
        above = (towards > 0.0) & (2.0 * towards * normal[2] - view[:, 2] > 0.0)
        assert above.mean() == pytest.approx(normal[2] ** 2, abs=0.005)
        assert albedo_at(0.0, normal[2]) == pytest.approx(normal[2] ** 2, abs=0.005)


@pytest.mark.parametrize("degrees", [80.0, 90.0, 100.0, 120.0])
def test_a_viewer_below_the_horizon_sees_a_bounded_lobe(degrees):
    """(n.v + sqrt(n.v^2 + S^2)) / S at most, less what goes below the horizon of n; and nothing jumps at n.v = 0."""
    alpha, n, rng = 0.5, np.array([0.0, 0.0, 1.0]), np.random.default_rng(4)
    light = rng.normal(size=(400_000, 3))
    light[:, 2] = np.abs(light[:, 2])
    light /= np.linalg.norm(light, axis=1, keepdims=True)
    many = (len(light), 1)

    def reflected(angle):
        lobe = np.tile(n, many), np.tile([alpha**2, alpha**2, 0.0], many), np.ones_like(light), np.zeros_like(light)
        return 2.0 * math.pi * float(brdf(*lobe, np.tile(leaning(angle), many), light)[:, 0].mean())

    down, shadow = math.cos(math.radians(degrees)), alpha * math.sin(math.radians(degrees))
    bound = 1.0 if down > 0.0 else (down + math.hypot(down, shadow)) / shadow
    found = reflected(degrees)
    assert 0.55 * bound < found <= 1.01 * bound
    assert reflected(degrees + 0.01) == pytest.approx(found, rel=0.002)


@pytest.mark.parametrize("square, slope", [(4e-6, 0.0), (0.09, 0.4), (0.5, 1.0)])
def test_one_lobe_alone_needs_no_correction(square, slope):
    lobes = np.zeros((2, LOBE_COLUMNS))
    lobes[0, :3] = np.array([-slope, 0.0, 1.0]) / math.hypot(slope, 1.0)
    lobes[0, ALPHA_SQUARED], lobes[0, SPECULAR : SPECULAR + 3] = square, (0.1, 0.2, 0.3)
    theta = np.array([slope, 0.0, math.log(square), math.log(square), 0.0, 0.0])
    assert albedo_of_lobes(lobes, 1, True) == pytest.approx(albedo_of(theta), rel=1e-9)
    lobes[0, SPREAD : SPREAD + 2] = 0.2
    assert albedo_of_lobes(lobes, 1, True) < albedo_of(theta)
    assert albedo_of_lobes(lobes, 0, True) == 0.0


def rough_ground(alpha, spread, size=16, seed=3):
    rng = np.random.default_rng(seed)
    slopes = rng.normal(0.0, spread, (size, size, 2))
    normal = np.concatenate([-slopes, np.ones((size, size, 1))], axis=-1)
    log_roughness = np.zeros((size, size, 3), np.float32)
    log_roughness[..., :2] = 2.0 * math.log(alpha)
    return Svbrdf(
        normal=(normal / np.linalg.norm(normal, axis=-1, keepdims=True)).astype(np.float32),
        log_roughness=log_roughness,
        specular=np.full((size, size, 3), 0.04, np.float32),
        diffuse=np.zeros((size, size, 3), np.float32),
    )


def interpolated(normal, rng, count):
    """Unit normals (count, 3) at random places between texels, which repeat."""
    size = len(normal)
    cell, part = rng.integers(0, size, (count, 2)), rng.random((count, 2))
    found = np.zeros((count, 3))
    for down in range(2):
        for right in range(2):
            weight = np.abs(1 - down - part[:, 0]) * np.abs(1 - right - part[:, 1])
            found += weight[:, None] * normal[(cell[:, 0] + down) % size, (cell[:, 1] + right) % size]
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def test_rough_ground_keeps_its_light_as_it_is_rendered():
    """Bumps are shaded each for itself; the lobe that stands for all sends as much of a sky to all viewers."""
    base = rough_ground(0.25, 0.35)
    last = NonlinearFit().bake_lobes(base, FitOptions(threads=1)).levels[-1].svbrdf
    rng = np.random.default_rng(5)
    many = np.mean([seen_under_a_sky(rng, 0.25, n, 4000) for n in interpolated(base.normal, rng, 400)])
    a, b, _ = last.log_roughness[0, 0]
    one = seen_under_a_sky(rng, math.exp(0.25 * float(a + b)), last.normal[0, 0].astype(float), 400_000)
    scale = float(last.specular[0, 0].mean()) / 0.04
    assert 0.9 <= scale <= 1.1
    assert scale * one == pytest.approx(many, rel=0.03)


def test_a_scale_that_is_held_or_free_is_left_alone():
    base = rough_ground(0.25, 0.35)
    held = NonlinearFit().bake_lobes(base, FitOptions(threads=1, specular="held")).levels[-1].svbrdf
    np.testing.assert_allclose(held.specular, 0.04, rtol=1e-4)
