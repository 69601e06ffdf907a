"""A truth that is no SVBRDF is drawn point by point; an SVBRDF that hides behind ``reflect`` gives its own picture."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from export_support import random_svbrdf

from brdffit.appearance import Truth, bilinear
from brdffit.comparison.compare import compare
from brdffit.comparison.options import CompareOptions
from brdffit.errors import InputError
from brdffit.models.microfacet import brdf
from brdffit.render import lights, scenes
from brdffit.render.environment import procedural_environment
from brdffit.render.pairs import pair_errors
from brdffit.render.reference import render_halves
from brdffit.render.terms import LOBE_ONLY
from brdffit.roughness import log_tensor_from_perceptual, perceptual_from_log_tensor

SIZE = (16, 16)
STUDIO = procedural_environment(64)


class Hidden:
    """An SVBRDF of isotropic lobes as a truth, interpolated as the reference does; ``noise``: of a random grey."""

    def __init__(self, base, noise=0.0):
        self.base, self.noise, self.asked = base, noise, 0
        rough = perceptual_from_log_tensor(base.log_roughness)[..., None]
        self.image = np.concatenate([base.normal, rough, base.specular, base.diffuse], axis=-1).astype(np.float64)

    @property
    def size(self):
        return self.base.size

    def reflect(self, position, view, light, seed):
        assert (light[:, 2] > 0.0).all() and position.shape == (len(view), 2)
        self.asked += len(position)
        texel = bilinear(self.image, position, self.base.wrap)
        normal = texel[:, :3] / np.linalg.norm(texel[:, :3], axis=1, keepdims=True)
        alpha_squared = np.repeat(texel[:, 3:4] ** 4, 3, axis=1) * [1.0, 1.0, 0.0]
        found = brdf(normal, alpha_squared, texel[:, 4:7], texel[:, 7:10], view, light, model=self.base.model)
        return found * (1.0 + self.noise * np.random.default_rng(seed).standard_normal((len(view), 1)))


def material(slope=0.3, **extra):
    base = random_svbrdf(SIZE, slope=slope, seed=5)
    return base.replace(log_roughness=log_tensor_from_perceptual(np.full(SIZE, 0.5, np.float32)), **extra)


LIGHT = {
    "small lights": {"lights": lights.few()},
    "lamps": {"lights": lights.lamps()},
    "environment": {"environment": STUDIO},
    "lights and environment": {"lights": lights.lamps(), "environment": STUDIO},
}


def assert_same_picture(found, expected):
    """Equal within five standard deviations of what both say of their noise, in the mean over pixels and in each."""
    difference = np.float64(found.radiance) - expected.radiance
    variance = np.float64(found.squared_error) + expected.squared_error
    total = np.abs(difference.sum(axis=(0, 1)))
    assert (total < 5.0 * np.sqrt(variance.sum(axis=(0, 1))) + 2e-3 * expected.radiance.sum(axis=(0, 1))).all()
    assert np.square(difference).sum() < 2.0 * variance.sum() + 1e-5 * np.square(expected.radiance).sum()


@pytest.mark.parametrize(
    ("light", "pixel_filter"), [*((light, "box") for light in LIGHT), ("small lights", "mitchell")]
)
def test_a_hidden_svbrdf_gives_its_own_picture(light, pixel_filter):
    base = material()
    scene = scenes.sphere(SIZE, 1, (12, 12))
    given = {**LIGHT[light], "pixel_filter": pixel_filter, "samples": 512}
    assert_same_picture(render_halves(Hidden(base), scene, **given), render_halves(base, scene, **given))


@pytest.mark.parametrize("light", ["small lights", "environment"])
def test_noise_of_a_truth_itself_is_seen_by_the_halves(light):
    """A truth that is random gives its mean, and the picture's own error holds its noise."""
    base = material()
    scene = scenes.plane(SIZE, 2, (8, 8))
    given = {**LIGHT[light], "samples": 256}
    noisy = render_halves(Hidden(base, noise=2.0), scene, **given)
    assert_same_picture(noisy, render_halves(base, scene, **{**given, "samples": 16384}))
    plain = render_halves(Hidden(base), scene, **given)
    assert noisy.noise_db < plain.noise_db - 3.0


def test_the_picture_does_not_depend_on_threads_and_presets_ask_as_their_noise_wants():
    scene = scenes.plane(SIZE, 2, (8, 8))
    one, three = (render_halves(Hidden(material()), scene, samples=64, threads=n).halves for n in (1, 3))
    np.testing.assert_array_equal(one, three)
    drawn = {preset: Hidden(material(0.6)) for preset in ("draft", "fine")}
    noise = {preset: render_halves(truth, scene, samples=preset).noise_db for preset, truth in drawn.items()}
    assert noise["draft"] > 20.0 and noise["fine"] > noise["draft"] + 6.0
    assert drawn["fine"].asked > 4 * drawn["draft"].asked


def test_pairs_of_a_hidden_svbrdf_are_its_own():
    base = material()
    level = random_svbrdf((4, 4), slope=0.1, seed=3)
    columns, rows = np.array([0, 3, 2]), np.array([1, 3, 0])
    expected = pair_errors(base, [level, material()], columns, rows, 4096, samples=1024, size=None)
    found = pair_errors(Hidden(base), [level, material()], columns, rows, 4096, samples=32)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one.sum(axis=-1), other.sum(axis=-1), rtol=0.05)


def test_what_a_truth_cannot_do_is_said():
    truth = Hidden(material())
    assert isinstance(truth, Truth)
    with pytest.raises(InputError, match="without some terms"):
        render_halves(truth, scenes.plane(SIZE, 0, (2, 2)), terms=LOBE_ONLY)
    with pytest.raises(InputError, match="without some terms"):
        pair_errors(truth, [material()], np.array([0]), np.array([0]), terms=LOBE_ONLY)
    with pytest.raises(InputError, match="made for a base"):
        render_halves(truth, scenes.plane((8, 8), 0, (2, 2)))


@pytest.mark.slow
def test_a_comparison_with_another_truth():
    """Its figures are those against the maps, if the truth is the maps; half-angle figures stay as they are."""
    base = material()
    ask = CompareOptions.of(methods=["naive,lean"], quick=True, keep_level_0=True)
    ask = CompareOptions(**{**vars(ask), "pixels": 32, "frames": 4, "pairs": 512})
    # A copy of the maps is another truth too, and is drawn by the compiled loops, in the same views.
    plain, hidden = (
        compare([base], dataclasses.replace(ask, truth=truth))[0].sets[0]
        for truth in (lambda read: read.svbrdf.replace(), lambda read: Hidden(read.svbrdf))
    )
    assert any("Hidden" in note for note in hidden.notes) and not any("Hidden" in note for note in plain.notes)
    for one, other in zip(plain.methods, hidden.methods, strict=True):
        for k, level in enumerate(one.levels):
            assert other.levels[k].half_angle_snr_db == level.half_angle_snr_db
            assert other.levels[k].pair_snr_db == pytest.approx(level.pair_snr_db, abs=1.0)
    for one, other in zip(plain.views, hidden.views, strict=True):
        assert one.key == other.key
        for shot, again in zip(one.shots, other.shots, strict=True):
            if shot.figures is not None and shot.figures.snr_db < 25.0:
                assert again.figures.snr_db == pytest.approx(shot.figures.snr_db, abs=1.5)
