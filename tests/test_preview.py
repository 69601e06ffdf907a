"""The lit ball and the preview: right where a pyramid must be right, the same whatever is left out of a large base."""

from __future__ import annotations

import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
from export_support import averaged_pyramid, random_svbrdf

from brdffit.appearance import LobePyramid
from brdffit.library import thumbnail
from brdffit.methods import Baked
from brdffit.models import beckmann, get_model
from brdffit.render import _packing, ball, preview
from brdffit.render.ball import Part, lit_balls, reference_balls
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf, level_sizes

BALL = 48
#: Samples of a constant material differ by rounding only.
SAME = 1e-3


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
    level = lit_balls(averaged_pyramid(base), [mip_level], BALL, **options)[0]
    return level.mean(axis=0), reference_balls(base, [mip_level], BALL, **options)[0].mean(axis=0)


@pytest.mark.parametrize("mip_level", [0, 1, 3])
@pytest.mark.parametrize("size", [(32, 32), (20, 37)])
@pytest.mark.parametrize("model", ["ggx", "beckmann"])
def test_a_constant_material_is_its_own_reference(mip_level, size, model):
    level, reference = both(constant(size, model=model), mip_level)
    assert level.max() > 0.0
    np.testing.assert_allclose(reference, level, rtol=SAME, atol=SAME)


def test_a_matt_flat_material_of_many_colours_is_right_when_averaged():
    """Light that is reflected without a lobe or a bump is linear in the albedo, so naive MIPs are exact for it."""
    size = (32, 32)
    base = random_svbrdf(size)
    base = base.replace(
        normal=np.broadcast_to(np.float32([0, 0, 1]), (*size, 3)).copy(), specular=np.zeros((*size, 3), np.float32)
    )
    level, reference = both(base, 3)
    error = (reference - level)[level > 0.0]
    assert np.abs(error).mean() < 0.02 * level[level > 0.0].mean()
    # Sixteen footprints of 128 samples each repeat over the ball.
    assert abs(error.mean()) < 1e-2 * level[level > 0.0].mean()


def test_bumps_widen_the_highlight_of_the_reference_but_not_of_naive_mips():
    level, reference = both(bumpy(), 3)
    assert level.max() > 2 * reference.max()


def test_a_ball_does_not_depend_on_threads():
    base = bumpy((32, 48))
    for one, two in zip(both(base, 2, threads=1), both(base, 2, threads=3), strict=True):
        np.testing.assert_array_equal(one, two)


@pytest.mark.parametrize("wrap", ["tile", "clamp"])
def test_a_part_of_a_large_base_is_lit_as_the_whole_is(monkeypatch, wrap):
    """What a ball shows is the same whether the rest of the base is looked at or not."""
    base = bumpy((192, 256)).replace(wrap=wrap)
    pyramid = averaged_pyramid(base)
    monkeypatch.setattr(ball, "MOST_TEXELS", 128)
    part = Part.of(base.size, 3)
    assert part == Part(8, (128, 128), (144, 144))
    whole = part._replace(size=base.size)
    for mip_level in (1, 3):
        np.testing.assert_allclose(
            lit_balls(pyramid, [mip_level], BALL, part),
            lit_balls(pyramid, [mip_level], BALL, whole),
            rtol=1e-4,
            atol=1e-5,
        )
        one, two = (reference_balls(base, [mip_level], BALL, each)[0].mean(axis=0) for each in (part, whole))
        # The jitter of the samples is one of the footprint, so it is the same too.
        np.testing.assert_allclose(one, two, rtol=1e-4, atol=1e-5)


def test_a_base_whose_levels_are_no_halves_is_taken_whole():
    assert Part.of((1025, 4096), 5) == Part(0, (1025, 4096), (1025, 4096))
    assert Part.of((512, 512), 5) == Part(0, (512, 512), (512, 512))


def test_a_model_of_somebody_else_is_drawn_by_its_own_profile(monkeypatch):
    """Beckmann's profile under a name that nobody knows gives Beckmann's ball."""
    foreign = SimpleNamespace(**(vars(beckmann.MODEL) | {"name": "foreign", "default_shape": 0.0}))
    monkeypatch.setattr(_packing, "get_model", lambda name: foreign if name == "foreign" else get_model(name))
    balls = {
        model: both(constant(model=model), 1) for model in ("foreign", "beckmann", "ggx")
    }  # fmt: skip
    for one, two in zip(balls["foreign"], balls["beckmann"], strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-6)
    assert np.abs(balls["foreign"][0] - balls["ggx"][0]).max() > 0.05 * balls["ggx"][0].max()


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


def test_an_appearance_that_is_no_pyramid_is_shown_too():
    base = constant()
    pyramid = LobePyramid([level.svbrdf for level in averaged_pyramid(base).levels])
    names = ("base_size", "look_up", "evaluate", "sample", "pdf")
    other = SimpleNamespace(**{name: getattr(pyramid, name) for name in names})
    picture = preview.make_preview(base, pyramid, other, name="other", ball=BALL)
    one, two = (lit_balls(each, [1], BALL)[0].mean(axis=0) for each in (pyramid, other))
    assert picture.shape[0] > 3 * BALL
    # Its lamps are discs of which few directions are drawn, not widened lobes.
    assert np.abs(one - two).mean() < 0.12 * one.mean()


def test_figures_say_what_is_the_same():
    halves = reference_balls(bumpy(), [3], BALL)[0]
    shown = np.clip(halves.mean(axis=0), 0.0, 1.0)
    assert preview._figures(halves, halves[::-1], shown, shown)[1] == "displayed 0.0% off, FLIP 0.000"


@pytest.mark.parametrize("text", ["a", "A rather long name of a method that does not fit"])
def test_captions_fit(text):
    assert preview._fitting(text, 400).getlength(text) <= 400
    assert preview._fitting("a", 400).size == 24


def test_a_thumbnail_of_two_balls():
    base = bumpy()
    picture = thumbnail.make_thumbnail(base, Baked.of_lobes(averaged_pyramid(base)))
    assert picture.shape == (thumbnail.BALL, 2 * thumbnail.BALL + 8, 3) and picture.dtype == np.uint8
    assert picture.max() > 150


def test_memory_does_not_grow_with_the_base():
    """Of a large base a part is looked at: what is allocated stays near that of a base as large as the part."""

    def peak(size):
        flat = np.zeros(3, np.float32)
        colour = np.full(3, 0.5, np.float32)
        arrays = {"normal": np.float32([0, 0, 1]), "log_roughness": flat - 4, "specular": colour, "diffuse": flat}
        # Broadcast: the base itself takes no memory.
        base = Svbrdf(**{name: np.broadcast_to(array, (*size, 3)) for name, array in arrays.items()})
        assert level_sizes(size)[5] == (size[0] // 32, size[1] // 32)
        tracemalloc.start()
        reference_balls(base, [5], 16, threads=1)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    assert peak((4096, 4096)) < 1.2 * peak((1088, 1088))
