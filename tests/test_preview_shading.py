"""Laws of the shader: normalisation, reciprocity, no more light out than in, and frames that are rotations."""

from __future__ import annotations

import numpy as np
import pytest
import shading_oracle as shading
from export_support import random_svbrdf

from brdffit.models import get_model, model_names
from brdffit.roughness import tensor_from_log

#: Midpoint rule of 400 x 400 directions on lobes of alpha 0.1 and above.
QUADRATURE = 5e-3
PROFILES = shading.PROFILES
#: The kernels' polynomial exponential and logarithm, in single precision.
KERNEL = 5e-5
TENSORS = {
    "isotropic": (0.09, 0.09, 0.0),
    "rough": (1.0, 1.0, 0.0),
    "sharp": (0.01, 0.01, 0.0),
    "anisotropic": (0.25, 0.04, 0.03),
}


def hemisphere(n=400):
    """Directions (n, n, 3) of a midpoint rule and their solid angles (n, n)."""
    # Polar angle squared in the parameter: nodes gather at the pole, where lobes are.
    u = (np.arange(n) + 0.5) / n
    theta, phi = 0.5 * np.pi * u**2, 2 * np.pi * u
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    solid = np.sin(theta) * (np.pi * u)[:, None] / n * 2 * np.pi / n
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1), solid


def unit(*vector):
    return np.array(vector, float) / np.linalg.norm(vector)


@pytest.mark.parametrize("profile", list(PROFILES))
@pytest.mark.parametrize("tensor", list(TENSORS))
def test_a_lobe_is_normalised_in_the_frame_of_its_normal(profile, tensor):
    half, solid = hemisphere()
    value = shading.distribution(half, np.array(TENSORS[tensor]), PROFILES[profile])
    assert (value * half[..., 2] * solid).sum() == pytest.approx(1.0, abs=QUADRATURE)


@pytest.mark.parametrize("name", model_names())
@pytest.mark.parametrize("shape", [-0.6, 0.0, 0.7])
def test_lobes_are_those_that_are_fitted(name, shape):
    """The picture's NumPy and the fit's kernel are two writings of one formula."""
    model, random = get_model(name), np.random.default_rng(1)
    shape = shape if model.shape_bounds else 0.0
    C = np.append(random.uniform(0.05, 1.0, 40), [1.0, 1.0 - 1e-6]).astype(np.float32)
    q = np.append(random.uniform(0.0, 4.0, 40), [0.3, 1e-4]).astype(np.float32)
    normalisation = np.exp(model.log_normalisation.py_func(shape)[0])
    fitted = [normalisation * model.profile(*pair, np.float32(shape)) for pair in zip(q, C, strict=True)]
    np.testing.assert_allclose(PROFILES[name](q, C, np.full(42, shape, np.float32)), fitted, rtol=KERNEL, atol=1e-6)


@pytest.mark.parametrize(
    "view", [unit(0, 0, 1), unit(0.5, 0.2, 0.8), unit(0.9, -0.3, 0.25)], ids=["above", "mid", "low"]
)
@pytest.mark.parametrize("tensor", list(TENSORS))
@pytest.mark.parametrize("profile", list(PROFILES))
def test_no_more_light_comes_out_than_falls_in(view, tensor, profile):
    light, solid = hemisphere()
    up = np.array([0.0, 0.0, 1.0])
    for specular, diffuse in ((1.0, 0.0), (0.04, 1.0), (0.5, 0.5)):
        reflected = shading.brdf(
            light,
            view,
            up,
            np.array(TENSORS[tensor]),
            np.full(3, specular),
            np.full(3, diffuse),
            profile=PROFILES[profile],
        )
        albedo = (reflected[..., 0] * solid).sum()
        assert 0.0 < albedo <= 1.0 + QUADRATURE
    # A mirror-like white surface loses next to nothing to masking: the law has a lower side too.
    if tensor == "sharp" and view[2] > 0.7:
        white = shading.brdf(
            light, view, up, np.array(TENSORS[tensor]), np.ones(3), np.zeros(3), profile=PROFILES[profile]
        )
        assert (white[..., 0] * solid).sum() > 0.97


def test_light_and_viewer_may_be_exchanged():
    random = np.random.default_rng(3)
    light, view = (shading.normalise(random.standard_normal((500, 3)) * [1, 1, 0.3] + [0, 0, 0.8]) for _ in range(2))
    base = random_svbrdf((500, 1))
    parameters = [
        array[:, 0].astype(float) for array in (tensor_from_log(base.log_roughness), base.specular, base.diffuse)
    ]
    normal = base.normal[:, 0].astype(float)
    forth = shading.brdf(light, view, normal, *parameters)
    back = shading.brdf(view, light, normal, *parameters)
    n_l, n_v = shading.dot(normal, light)[:, None], shading.dot(normal, view)[:, None]
    both = ((n_l > 0.01) & (n_v > 0.01))[:, 0]
    assert both.sum() > 200
    np.testing.assert_allclose((forth / n_l)[both], (back / n_v)[both], rtol=1e-5)
    assert (forth[(n_l < 0)[:, 0]] == 0).all() and (forth[(n_v < 0)[:, 0]] == 0).all()


def test_the_frame_is_a_rotation_that_takes_the_normal_to_z():
    normal = random_svbrdf((50, 1)).normal[:, 0].astype(float)
    vector = np.random.default_rng(4).standard_normal((50, 3))
    seen = shading.into_frame(vector, normal)
    np.testing.assert_allclose(shading.dot(seen, seen), shading.dot(vector, vector), rtol=1e-6)
    np.testing.assert_allclose(shading.into_frame(normal, normal), np.broadcast_to([0, 0, 1], (50, 3)), atol=1e-6)
    # The shortest: the axis, at right angles to z and n, stays as it is.
    axis = shading.normalise(np.cross([0.0, 0.0, 1.0], normal))
    np.testing.assert_allclose(shading.into_frame(axis, normal), axis, atol=1e-6)


def test_turning_everything_about_z_changes_nothing():
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    light, view, normal = unit(0.3, 0.4, 0.8), unit(-0.5, 0.1, 0.7), unit(0.2, -0.1, 1.0)
    sigma = np.array([[0.25, 0.03], [0.03, 0.04]])
    turned = turn[:2, :2] @ sigma @ turn[:2, :2].T
    colours = np.full(3, 0.6), np.full(3, 0.2)
    one = shading.brdf(light, view, normal, sigma[[0, 1, 0], [0, 1, 1]], *colours)
    other = shading.brdf(turn @ light, turn @ view, turn @ normal, turned[[0, 1, 0], [0, 1, 1]], *colours)
    np.testing.assert_allclose(one, other, rtol=1e-9)


def test_a_mirrored_light_gives_the_highlight():
    """The lobe is the brightest where the half vector is the normal, and a matt white surface is 1 / pi."""
    view, normal = unit(0.3, 0.0, 1.0), unit(0.0, 0.2, 1.0)
    mirrored = 2 * (view @ normal) * normal - view
    narrow = np.array([1e-4, 1e-4, 0.0])
    bright = shading.brdf(mirrored, view, normal, narrow, np.ones(3), np.zeros(3))[0]
    beside = shading.normalise(mirrored + [0.05, 0.0, 0.0])
    aside = shading.brdf(beside, view, normal, narrow, np.ones(3), np.zeros(3))[0]
    assert bright > 20 * aside
    matt = shading.brdf(normal, normal, normal, narrow, np.zeros(3), np.ones(3))
    np.testing.assert_allclose(matt, 1 / np.pi, rtol=1e-6)


def test_black_reflects_nothing_even_at_its_rim():
    low = unit(1.0, 0.0, 0.05)
    opposite = unit(-1.0, 0.0, 0.05)
    up = np.array([0.0, 0.0, 1.0])
    assert (shading.brdf(low, opposite, up, np.array([0.04, 0.04, 0.0]), np.zeros(3), np.zeros(3)) == 0).all()


def test_sharp_lobes_stay_finite_in_single_precision():
    light, _ = hemisphere(40)
    light = light.astype(np.float32)
    tiny = np.array([4e-6, 4e-6, 0.0], np.float32)
    out = shading.brdf(light, light[::-1], light[20, 20], tiny, np.ones(3, np.float32), np.ones(3, np.float32))
    assert out.dtype == np.float32 and np.isfinite(out).all() and (out >= 0).all()
