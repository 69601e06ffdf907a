"""Laws of the decoding: noise floor, unit normals, slopes, resampling."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pictures import bumps, write_image

from brdffit.colour import decode_srgb
from brdffit.files.image_io import read_image
from brdffit.textures import encoding
from brdffit.textures.noise_floor import code_noise, flat_as_flat, subtract_noise_floor

PNG = code_noise(8, False, "png")
#: Rounding of float32 in a component of at most 1, through some ten levels of a pyramid.
ROUNDING = 2e-6


def decoded(codes: np.ndarray, top: int = 255) -> np.ndarray:
    return (2.0 * codes / top - 1.0).astype(np.float32)


@pytest.mark.parametrize(("codes", "flat"), [((127, 128), True), ((128, 128), True), ((126, 128), False)])
def test_only_a_map_that_is_flat_throughout_is_made_exactly_flat(codes, flat) -> None:
    xy = np.broadcast_to(decoded(np.array(codes)), (4, 6, 2))
    assert (flat_as_flat(xy, PNG)[..., 0] == 0.0).all() == flat
    bumpy = xy.copy()
    bumpy[1, 2] += PNG.step
    np.testing.assert_array_equal(flat_as_flat(bumpy, PNG), bumpy)


@settings(deadline=None, max_examples=60)
@given(
    st.integers(1, 70),
    st.integers(1, 70),
    st.sampled_from(["tile", "clamp"]),
    st.sampled_from([(8, 255), (16, 65535)]),
    st.floats(0.0, 1.0),
    st.integers(1, 9),
    st.integers(0, 2**32 - 1),
)
def test_a_toggle_of_one_code_is_flat_at_every_scale(height, width, wrap, depth, share, grain, seed) -> None:
    bits, top = depth
    blotches = np.random.default_rng(seed).random((-(-height // grain), -(-width // grain), 2)) < share
    codes = top // 2 + np.repeat(np.repeat(blotches, grain, 0), grain, 1)[:height, :width]
    flat = subtract_noise_floor(decoded(codes, top), code_noise(bits, False, "png"), wrap)
    np.testing.assert_array_equal(flat, 0.0)


def test_a_toggle_away_from_zero_keeps_its_mean() -> None:
    codes = 200 + np.random.default_rng(1).integers(0, 2, (64, 64, 2))
    flat = subtract_noise_floor(decoded(codes), PNG, "tile")
    assert np.ptp(flat, axis=(0, 1)).max() <= ROUNDING
    mean = decoded(codes).mean((0, 1), dtype=np.float64)
    np.testing.assert_allclose(flat.mean((0, 1), dtype=np.float64), mean, atol=ROUNDING)


def test_a_jpeg_that_toggles_in_luma_and_chroma_is_flat(tmp_path: Path) -> None:
    codes = np.broadcast_to([127, 127, 255], (64, 64, 3)) + np.random.default_rng(2).integers(0, 2, (64, 64, 1))
    image = read_image(write_image(tmp_path / "a.jpg", codes.clip(0, 255) / 255.0, quality=100))
    xy = 2.0 * image.pixels[:, :, :2] - 1.0
    assert xy.std() > 0.3 * PNG.step, "the JPEG lost the toggle, the test shows nothing"
    flat = subtract_noise_floor(xy, code_noise(8, False, "jpeg"), "tile")
    assert np.ptp(flat, axis=(0, 1)).max() <= ROUNDING


def test_toggles_of_luma_and_chroma_are_flat_for_a_jpeg_only() -> None:
    luma, blue, red = np.random.default_rng(3).integers(0, 2, (3, 128, 128))
    codes = np.stack([127 + luma + 1.402 * red, 128 + luma - 0.344 * blue - 0.714 * red], axis=2)
    xy = decoded(np.rint(codes))
    flat = subtract_noise_floor(xy, code_noise(8, False, "jpeg"), "tile")
    assert np.ptp(flat, axis=(0, 1)).max() <= ROUNDING
    assert subtract_noise_floor(xy, PNG, "tile").std() > 0.1 * PNG.step


@pytest.mark.parametrize("codes_rms", [3.0, 10.0, 30.0])
def test_real_slopes_lose_a_quarter_code_squared(codes_rms: float) -> None:
    codes = np.rint(127.5 + np.random.default_rng(3).normal(0.0, codes_rms, (256, 256, 2)))
    xy = decoded(codes)
    kept = subtract_noise_floor(xy, PNG, "tile")
    lost = 1.0 - kept.var(axis=(0, 1), dtype=np.float64) / xy.var(axis=(0, 1), dtype=np.float64)
    # The budget of q^2 / 4 over the variance; 5% for the scatter of a finite sample.
    np.testing.assert_allclose(lost, 0.25 / codes_rms**2, rtol=0.05)
    mean = xy.mean((0, 1), dtype=np.float64)
    np.testing.assert_allclose(kept.mean((0, 1), dtype=np.float64), mean, atol=ROUNDING)


def test_the_noise_floor_is_odd_and_treats_both_axes_alike() -> None:
    xy = decoded(np.random.default_rng(4).integers(120, 136, (33, 50, 2)))
    kept = subtract_noise_floor(xy, PNG, "tile")
    np.testing.assert_allclose(subtract_noise_floor(-xy, PNG, "tile"), -kept, atol=ROUNDING)
    swapped = subtract_noise_floor(np.ascontiguousarray(xy.transpose(1, 0, 2)[:, :, ::-1]), PNG, "tile")
    np.testing.assert_allclose(swapped.transpose(1, 0, 2)[:, :, ::-1], kept, atol=ROUNDING)


def test_float_formats_have_no_noise_floor() -> None:
    xy = np.random.default_rng(5).normal(0.0, 1e-5, (8, 8, 2)).astype(np.float32)
    np.testing.assert_array_equal(subtract_noise_floor(xy, code_noise(32, True, "openexr"), "tile"), xy)
    np.testing.assert_array_equal(subtract_noise_floor(xy, code_noise(16, True, "openexr"), "tile"), xy)


def test_a_dent_in_a_dithering_plate_stays() -> None:
    codes = 127 + np.random.default_rng(6).integers(0, 2, (64, 64, 2))
    codes[20:28, 30:38, 0] += 40
    kept = subtract_noise_floor(decoded(codes), PNG, "tile")
    assert kept[20:28, 30:38, 0].mean() == pytest.approx(40 * PNG.step, rel=0.05)
    assert np.abs(kept[40:, :20]).max() < PNG.step


def test_unit_normals_are_unit_and_above_the_horizon() -> None:
    vectors = np.random.default_rng(7).normal(size=(40, 40, 3)).astype(np.float32)
    vectors[0, 0], vectors[0, 1], vectors[0, 2] = (0, 0, 0), (0, 0, -1), (0.3, -0.4, -0.5)
    normals, counts = encoding.unit_normals(vectors)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=2), 1.0, atol=1e-6)
    assert normals[:, :, 2].min() >= 0.999 * encoding.MIN_NORMAL_Z
    assert counts["zero"] == 1
    below = vectors[:, :, 2] < encoding.MIN_NORMAL_Z * np.linalg.norm(vectors, axis=2)
    assert counts["horizon"] == np.count_nonzero(below)
    np.testing.assert_array_equal(normals[0, :2], [[0, 0, 1], [0, 0, 1]])
    np.testing.assert_allclose(normals[0, 2, :2], np.array([0.6, -0.8]), atol=1e-4)  # its azimuth is kept


def test_normals_of_a_height_are_those_of_the_surface() -> None:
    height, normal = bumps(96, 128, 0.3)
    made = encoding.normals_from_gradient(encoding.height_gradient(height, "tile"))
    # Central differences are of second order: (2 pi / 96)^2 / 6 of the slope, and a little for the phase.
    np.testing.assert_allclose(made, normal, atol=2e-3)


def test_a_plane_has_one_slope_when_clamped() -> None:
    y, x = np.mgrid[0:7, 0:9]
    gradient = encoding.height_gradient(0.25 * x - 0.5 * y, "clamp")
    np.testing.assert_allclose(gradient, np.broadcast_to([0.25, 0.5], (7, 9, 2)))


@pytest.mark.parametrize("wrap", ["tile", "clamp"])
@pytest.mark.parametrize("size", [(8, 12), (13, 9), (40, 60)])
def test_enlarging_keeps_the_mean_and_the_range(wrap: str, size: tuple[int, int]) -> None:
    small = np.random.default_rng(8).random((4, 3, 2)).astype(np.float32)
    large = encoding.resample(small, size, wrap)
    assert large.shape == (*size, 2)
    assert small.min() - 1e-6 <= large.min() <= large.max() <= small.max() + 1e-6
    if size[0] % 4 == size[1] % 3 == 0 and wrap == "tile":
        np.testing.assert_allclose(large.mean((0, 1)), small.mean((0, 1)), rtol=1e-5)


def test_enlarging_commutes_with_a_shift_only_when_tiled() -> None:
    small = np.random.default_rng(9).random((4, 4)).astype(np.float32)
    for wrap, same in (("tile", True), ("clamp", False)):
        shifted = encoding.resample(np.roll(small, 1, 1), (8, 8), wrap)
        assert np.allclose(shifted, np.roll(encoding.resample(small, (8, 8), wrap), 2, 1), atol=1e-6) is same


def test_srgb_decoding_at_known_points() -> None:
    np.testing.assert_allclose(
        decode_srgb(np.array([0.0, 0.04045, 0.5, 1.0])), [0.0, 0.0031308, 0.2140411, 1.0], rtol=1e-4
    )


def test_the_channel_of_a_grey_map() -> None:
    colours = np.random.default_rng(10).random((4, 4, 3)).astype(np.float32)
    for role, index, letter in (("roughness", 1, "G"), ("metallic", 2, "B"), ("height", 0, "R")):
        values, taken = encoding.obvious_channel(colours, role)
        np.testing.assert_array_equal(values, colours[:, :, index])
        assert taken == letter
    grey = np.repeat(colours[:, :, :1], 3, axis=2)
    assert encoding.obvious_channel(grey, "roughness")[1] == ""


@pytest.mark.parametrize(
    ("channels", "asked", "index"),
    [
        ("RGB", "RGBA", (0, 1, 2, None)),
        ("RGBA", "RGBA", (0, 1, 2, 3)),
        ("Y", "RGBA", (0, None, None, None)),
        ("YA", "RGBA", (0, None, None, 1)),
        ("RG", "RGB", (0, 1, None)),
    ],
)
def test_a_channel_that_is_not_there_is_no_other_channel(channels: str, asked: str, index: tuple) -> None:
    assert tuple(encoding.channel_index(tuple(channels), each) for each in asked) == index


def test_a_format_of_rgba_pictures_spreads_grey_and_has_no_more_alpha_than_others() -> None:
    assert [encoding.channel_index(("Y",), each, as_rgba=True) for each in "RGBA"] == [0, 0, 0, None]
    assert [encoding.channel_index(("Y", "A"), each, as_rgba=True) for each in "RGBA"] == [0, 0, 0, 1]
