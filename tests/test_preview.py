"""The comparison picture: its reference knows nothing of pyramids, and agrees with them where they must be right."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from export_support import averaged_pyramid, random_svbrdf

from brdffit.render import lettering, preview, shading
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf, level_sizes

BALL = 48
#: Sub-samples of a constant material differ by rounding only.
SAME = 2e-4


def constant(size=(32, 32), **extra):
    one = random_svbrdf((1, 1), seed=2)
    return Svbrdf(**{name: np.broadcast_to(array, (*size, 3)).copy() for name, array in one.arrays().items()}, **extra)


def bumpy(size=(64, 64), slope=0.35, rough=0.15):
    base = random_svbrdf(size, slope=slope, seed=7)
    return base.replace(
        log_roughness=log_tensor_from_perceptual(np.full(size, rough, np.float32)),
        specular=np.full((*size, 3), 0.9, np.float32),
        diffuse=np.zeros((*size, 3), np.float32),
    )


def both(base, mip_level, **options):
    size = level_sizes(base.size)[mip_level]
    scene = preview._Scene(BALL)
    window = preview._window(base.size, size, BALL)
    level = averaged_pyramid(base)[mip_level].svbrdf
    profile = preview.profile_of(base.model)
    return (
        preview.light_level(level, window, scene, profile),
        preview.light_reference(base, size, window, scene, profile, **options),
    )


@pytest.mark.parametrize("mip_level", [0, 1, 3])
@pytest.mark.parametrize("size", [(32, 32), (20, 37)])
@pytest.mark.parametrize("model", ["ggx", "beckmann"])
def test_a_constant_material_is_its_own_reference(mip_level, size, model):
    level, reference = both(constant(size, model=model), mip_level)
    assert level.min() > 0.0
    np.testing.assert_allclose(reference, level, rtol=SAME, atol=SAME)


def test_a_matt_flat_material_of_many_colours_is_right_when_averaged():
    """Light that is reflected without a lobe or a bump is linear in the albedo, so naive MIPs are exact for it."""
    size = (32, 32)
    base = random_svbrdf(size)
    base = base.replace(
        normal=np.broadcast_to(np.float32([0, 0, 1]), (*size, 3)).copy(), specular=np.zeros((*size, 3), np.float32)
    )
    # At level 2 two samples stand for each texel side by side: they integrate a bilinear function exactly enough.
    level, reference = both(base, 2)
    np.testing.assert_allclose(reference, level, rtol=5e-3, atol=1e-3)


def test_bumps_widen_the_highlight_of_the_reference_but_not_of_naive_mips():
    level, reference = both(bumpy(), 3)
    assert level.max() > 3 * reference.max()
    # What the highlight loses, the rest of the ball gains.
    assert np.median(reference[:, 1]) > np.median(level[:, 1])


def test_the_reference_does_not_depend_on_threads_or_chunks(monkeypatch):
    base = bumpy((32, 48))
    _, one = both(base, 2, threads=1)
    _, two = both(base, 2, threads=3)
    np.testing.assert_array_equal(one, two)
    monkeypatch.setattr(preview, "_CHUNK", 700)
    _, chunked = both(base, 2)
    np.testing.assert_allclose(one, chunked, rtol=1e-5)


@pytest.mark.parametrize("wrap", ["tile", "clamp"])
def test_a_look_up_between_texels_is_bilinear_and_wraps(wrap):
    base = random_svbrdf((6, 8), wrap=wrap)
    rows, columns = (preview._neighbourhood(base, axis, base.size[axis]) for axis in (0, 1))
    packed = preview._packed(base)[rows][:, columns]
    samples = preview._bilinear(np.ascontiguousarray(packed), np.arange(48), 8, (1.0, 1.0), 2).reshape(6, 8, 2, 2, -1)
    mode = "wrap" if wrap == "tile" else "edge"
    padded = np.pad(preview._packed(base), ((1, 1), (1, 1), (0, 0)), mode=mode)
    # The sample at a quarter of texel (2, 3): 9/16 of it, 3/16 of two neighbours, 1/16 of the corner; same at a border.
    for y, x in ((2, 3), (0, 0), (5, 7)):
        near = padded[y : y + 3, x : x + 3]
        quarter = 9 * near[1, 1] + 3 * near[0, 1] + 3 * near[1, 0] + near[0, 0]
        np.testing.assert_allclose(samples[y, x, 0, 0], quarter / 16, rtol=1e-5, atol=1e-6)
        quarter = 9 * near[1, 1] + 3 * near[2, 1] + 3 * near[1, 2] + near[2, 2]
        np.testing.assert_allclose(samples[y, x, 1, 1], quarter / 16, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("size", [(64, 64), (13, 40), (1, 7), (1, 1)])
def test_the_picture_exists_for_any_size_and_is_the_same_twice(size):
    base = bumpy(size)
    pyramid = averaged_pyramid(base)
    picture = preview.make_preview(base, pyramid, pyramid, title="set", ball=BALL)
    assert picture.dtype == np.uint8 and picture.ndim == 3 and picture.shape[2] == 3
    np.testing.assert_array_equal(picture, preview.make_preview(base, pyramid, pyramid, title="set", ball=BALL))
    assert picture.max() > 200 and picture.min() < 40


def test_the_picture_shows_the_levels_that_there_are():
    base = bumpy()
    whole, short = averaged_pyramid(base), averaged_pyramid(base, levels=2)
    three = preview.make_preview(base, whole, whole, ball=BALL)
    one = preview.make_preview(base, whole, short, ball=BALL)
    assert three.shape[0] - one.shape[0] == 2 * (BALL + preview._CAPTION)


def test_a_lobe_with_a_shape_is_handed_its_shape():
    size = (16, 16)
    base = bumpy(size).replace(model="generalised-beckmann", shape=np.full(size, 0.5, np.float32))
    seen = []

    def profile(q, C, shape):
        seen.append(shape)
        return shading.beckmann_profile(q, C)

    pyramid = averaged_pyramid(base)
    preview.make_preview(base, pyramid, pyramid, ball=BALL, base_profile=profile, fit_profile=profile)
    assert seen and all(np.allclose(shape, 0.5) for shape in seen)


def test_memory_does_not_grow_with_the_base():
    """Of a large base a crop is looked at: what is allocated stays near that of a base as large as the crop."""

    def peak(size):
        flat = np.zeros(3, np.float32)
        colour = np.full(3, 0.5, np.float32)
        arrays = {"normal": np.float32([0, 0, 1]), "log_roughness": flat - 4, "specular": colour, "diffuse": flat}
        # Broadcast: the base itself takes no memory.
        base = Svbrdf(**{name: np.broadcast_to(array, (*size, 3)) for name, array in arrays.items()})
        scene = preview._Scene(16)
        level = level_sizes(size)[5]
        tracemalloc.start()
        preview.light_reference(base, level, preview._window(size, level, 16), scene, shading.ggx_profile, threads=1)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    assert peak((4096, 4096)) < 1.2 * peak((1024, 1024))


def test_letters_are_drawn_and_cut_off_at_the_border():
    picture = np.zeros((20, 40, 3), np.uint8)
    lettering.write(picture, "ab", (5, 5), 1, (9, 8, 7))
    assert {tuple(colour) for colour in picture.reshape(-1, 3)} == {(0, 0, 0), (9, 8, 7)}
    assert not picture[:5].any() and not picture[12:].any() and not picture[:, :5].any()
    assert not picture[:, 5 + lettering.width("ab", 1) :].any()
    lettering.write(picture, "WIDE WORDS", (15, 20), 3, (1, 2, 3))
    lettering.write(picture, "WIDE WORDS", (0, 20), 3, (1, 2, 3), centred=True)


def test_no_two_letters_look_alike():
    drawn = {}
    for letter in "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.,:-%/+()_":
        picture = np.zeros((7, 5, 3), np.uint8)
        lettering.write(picture, letter, (0, 0), 1, (1, 1, 1))
        drawn[letter] = picture.tobytes()
    assert len(set(drawn.values())) == len(drawn)
