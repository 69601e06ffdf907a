"""Texture sets from folders: conventions, encodings, and every bad input with its sentence."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from pictures import bumps, encoded, write_image

from brdffit.errors import InputError, UnknownNameError
from brdffit.roughness import perceptual_from_log_tensor
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.reading import read_texture_set

HEIGHT, NORMAL = bumps()
#: Normals read from 8 bits: half a code, 1/255, on each axis, and what bringing them to length adds.
EIGHT_BITS = 0.006


def read(path: Path, **options):
    texture_set = read_texture_set(path, **options)
    return texture_set, to_svbrdf(texture_set)


def roughness_of(svbrdf) -> np.ndarray:
    return perceptual_from_log_tensor(svbrdf.log_roughness)


# Normals


@pytest.mark.parametrize(
    ("suffix", "kind", "tolerance"),
    [("png", "uint8", EIGHT_BITS), ("png", "uint16", 5e-5), ("exr", "half", 1e-3), ("exr", "float", 1e-6)],
)
def test_bit_depths_agree(make_folder, suffix: str, kind: str, tolerance: float) -> None:
    _, svbrdf = read(make_folder(**{f"a_NormalGL__{suffix}": (encoded(NORMAL), kind)}))
    np.testing.assert_allclose(svbrdf.normal, NORMAL, atol=tolerance)


def test_signed_float_normals_are_taken_as_they_are(make_folder) -> None:
    _, svbrdf = read(make_folder(a_NormalGL__exr=(NORMAL, "float")))
    np.testing.assert_allclose(svbrdf.normal, NORMAL, atol=1e-6)


def test_directx_is_opengl_with_y_flipped(make_folder) -> None:
    _, gl = read(make_folder("gl", a_NormalGL__png=(encoded(NORMAL), "uint16")))
    _, dx = read(make_folder("dx", a_NormalDX__png=(encoded(NORMAL, "dx"), "uint16")))
    np.testing.assert_allclose(gl.normal, dx.normal, atol=2.1 / 65535)  # a half rounds to the even code
    given_set, given = read(make_folder("given", a_NormalGL__png=(encoded(NORMAL, "dx"), "uint16")), normal_y="dx")
    assert given_set.normal_y_source == "given"
    np.testing.assert_array_equal(given.normal, dx.normal)


@pytest.mark.parametrize("normal_y", ["gl", "dx"])
def test_the_height_tells_the_normals_y(make_folder, normal_y: str) -> None:
    grey = (HEIGHT - HEIGHT.min()) / np.ptp(HEIGHT)
    folder = make_folder(normal__png=encoded(NORMAL, normal_y), height__png=(grey, "uint16"))
    texture_set, svbrdf = read(folder)
    assert (texture_set.normal_y, texture_set.normal_y_source) == (normal_y, "height")
    assert any("agree with the height map" in note for note in texture_set.notes)
    np.testing.assert_allclose(svbrdf.normal, NORMAL, atol=EIGHT_BITS)


@pytest.mark.parametrize("normal_y", ["gl", "dx"])
def test_an_inverted_height_says_nothing_against_the_normals(make_folder, normal_y: str) -> None:
    """A depth map (white is deep) beside unmarked normals: x disagrees as well, so the height is inverted."""
    depth = (HEIGHT.max() - HEIGHT) / np.ptp(HEIGHT)
    folder = make_folder(normal__png=(encoded(NORMAL, normal_y), "uint16"), depth__png=(depth, "uint16"))
    texture_set, svbrdf = read(folder)
    assert texture_set.normal_y == normal_y
    np.testing.assert_allclose(svbrdf.normal, NORMAL, atol=EIGHT_BITS)
    assert any("is inverted, white is deep" in note for note in texture_set.notes)
    np.testing.assert_allclose(svbrdf.height - svbrdf.height.mean(), HEIGHT - HEIGHT.mean(), atol=0.03 * np.ptp(HEIGHT))


def test_what_is_measured_outweighs_a_guess_by_names(make_folder) -> None:
    """X_COL, X_NRM are words of the older CC0Textures (DirectX), and of Poliigon (OpenGL)."""
    colour = np.random.default_rng(0).random((48, 64, 3))
    texture_set = read_texture_set(make_folder(X_NRM__png=(encoded(NORMAL), "uint16"), X_COL__png=colour))
    assert (texture_set.normal_y, texture_set.normal_y_source) == ("gl", "slopes")
    (note,) = [note for note in texture_set.notes if "contradicts itself" in note]
    assert "convention speaks for DirectX (-Y) with 0.50" in note


def test_the_name_of_a_normal_map_that_is_given_tells_its_y(make_folder) -> None:
    folder = make_folder(a_NormalGL__png=encoded(NORMAL), other_NormalDX__png=encoded(NORMAL, "dx"))
    texture_set, svbrdf = read(folder, roles={"normal": "other_NormalDX.png"})
    assert (texture_set.normal_y, texture_set.normal_y_source) == ("dx", "name")
    np.testing.assert_allclose(svbrdf.normal, NORMAL, atol=EIGHT_BITS)
    with pytest.raises(InputError, match="is one channel, expected a whole picture"):
        read_texture_set(folder, roles={"normal": "a_NormalGL.png:R"})


def test_one_channel_of_a_picture_is_a_grey_colour(make_folder) -> None:
    colour = np.random.default_rng(0).random((48, 64, 3))
    folder = make_folder(a_NormalGL__png=encoded(NORMAL), a_Color__exr=(colour, "float"))
    _, svbrdf = read(folder, roles={"base_color": "a_Color.exr:G"})
    np.testing.assert_allclose(svbrdf.diffuse, np.repeat(colour[..., 1:2], 3, axis=2), atol=1e-6)


def test_floats_of_eight_bits_are_told(make_folder) -> None:
    rough = np.full((48, 64), 128.0)
    texture_set, svbrdf = read(make_folder(a_NormalGL__png=encoded(NORMAL), a_Roughness__exr=(rough, "float")))
    assert (roughness_of(svbrdf) == 1.0).all()
    assert any("goes from 128 to 128 as roughness, expected 0 to 1" in note for note in texture_set.notes)
    with pytest.raises(InputError, match=r"holds numbers up to 255, expected normals in \[-1, 1\] or \[0, 1\]"):
        read(make_folder("wide", a_NormalGL__exr=(255.0 * encoded(NORMAL) / encoded(NORMAL).max(), "float")))


def test_a_colour_above_one_is_told(make_folder) -> None:
    colour = np.full((48, 64, 3), 0.5)
    colour[3, 5] = 3.0
    texture_set, svbrdf = read(make_folder(a_NormalGL__png=encoded(NORMAL), a_Color__exr=(colour, "float")))
    assert svbrdf.diffuse.max() == 3.0
    assert any("reaches 3 as base_color, expected at most 1" in note for note in texture_set.notes)


def test_a_name_that_its_slopes_contradict_is_said_where_it_is_baked(make_folder) -> None:
    texture_set, _ = read(make_folder(a_NormalGL__png=(encoded(NORMAL, "dx"), "uint16")))
    assert texture_set.normal_y == "gl"
    assert any("its slopes' curl speaks against it" in note for note in texture_set.notes)
    texture_set, _ = read(make_folder("right", a_NormalGL__png=(encoded(NORMAL), "uint16")))
    assert not any("curl" in note for note in texture_set.notes)


@pytest.mark.parametrize("normal_y", ["gl", "dx"])
def test_the_slopes_alone_tell_the_normals_y(make_folder, normal_y: str) -> None:
    texture_set = read_texture_set(make_folder(normal__png=(encoded(NORMAL, normal_y), "uint16")))
    assert (texture_set.normal_y, texture_set.normal_y_source) == (normal_y, "slopes")


def test_where_nothing_tells_opengl_is_assumed_and_said(make_folder) -> None:
    texture_set = read_texture_set(make_folder(normal__png=np.full((4, 4, 3), [0.5, 0.5, 1.0])))
    assert (texture_set.normal_y, texture_set.normal_y_source) == ("gl", "assumed")
    assert any("OpenGL (+Y) is assumed; give normal-y" in note for note in texture_set.notes)


def test_a_flat_two_channel_map_and_a_flat_signed_one_are_flat(make_folder) -> None:
    for name, flat in (("a", ([0.5, 0.5, 0.0], "uint8")), ("b", ([0.5, 0.5], "uint16")), ("c", ([0, 0, 1], "float"))):
        value, kind = flat
        pixels = np.broadcast_to(np.array(value, np.float32), (4, 4, len(value)))
        suffix = "exr" if kind == "float" else "png"
        _, svbrdf = read(make_folder(name, **{f"a_NormalGL__{suffix}": (pixels, kind)}))
        np.testing.assert_array_equal(svbrdf.normal, np.broadcast_to([0, 0, 1], (4, 4, 3)))


@pytest.mark.parametrize("blue", [None, 0.0, 0.5, 1.0])
def test_two_channel_normals_get_their_z_back(make_folder, blue: float | None) -> None:
    stored = encoded(NORMAL)[:, :, :2]
    if blue is not None:
        stored = np.concatenate([stored, np.full_like(stored[:, :, :1], blue)], axis=2)
    texture_set, svbrdf = read(make_folder(a_NormalGL__png=(stored, "uint16")))
    np.testing.assert_allclose(svbrdf.normal, NORMAL, atol=5e-5)
    assert any("z is rebuilt" in note for note in texture_set.notes)


def test_two_channels_in_a_lossy_file_get_their_z_back(make_folder) -> None:
    """A blue of 255 that a JPEG has roughened once counted as z: slopes a third too flat."""
    stored = encoded(NORMAL)
    stored[..., 2] = 1.0
    texture_set, svbrdf = read(make_folder(a_NormalGL__jpg=(stored, "uint8")))
    slope, expected = (n[..., :2] / n[..., 2:] for n in (svbrdf.normal, NORMAL))
    assert slope.std() == pytest.approx(expected.std(), rel=0.02)
    assert any("z is rebuilt" in note for note in texture_set.notes)


def test_a_lossy_map_with_a_blue_of_its_own_keeps_it(make_folder) -> None:
    texture_set, _ = read(make_folder(a_NormalGL__jpg=(encoded(NORMAL), "uint8")))
    assert not any("z is rebuilt" in note for note in texture_set.notes)


@pytest.mark.parametrize("red", [0.0, 1.0])
def test_x_in_alpha_is_read(make_folder, red: float) -> None:
    """DXT5nm, as games store it: x in alpha, y in green, red a constant."""
    xy = encoded(NORMAL)
    stored = np.dstack([np.full_like(xy[..., 0], red), xy[..., 1], np.full_like(xy[..., 0], red), xy[..., 0]])
    texture_set, svbrdf = read(make_folder(a_NormalGL__png=(stored, "uint16")))
    np.testing.assert_allclose(svbrdf.normal, NORMAL, atol=5e-5)
    assert any("holds x in alpha" in note for note in texture_set.notes)


def test_a_grey_specular_map_beside_roughness_is_a_level(make_folder) -> None:
    flat, grey = np.full((4, 4, 3), [0.5, 0.5, 1.0]), np.full((4, 4), 128 / 255)
    rough = np.random.default_rng(0).random((4, 4))
    _, svbrdf = read(make_folder(a_NormalGL__png=flat, a_Specular__png=grey, a_Roughness__png=rough))
    np.testing.assert_allclose(svbrdf.specular, 0.08 * 128 / 255, rtol=1e-5)
    colour = np.random.default_rng(1).random((4, 4, 3))
    _, svbrdf = read(make_folder("b", a_NormalGL__png=flat, a_Specular__png=colour, a_Gloss__png=rough))
    assert svbrdf.specular.max() > 0.1


def test_a_height_in_metres_has_its_own_range(make_folder) -> None:
    """Values from 2.3 to 2.34: the default span is of what is there, and is told."""
    metres = 2.3 + 0.04 * (HEIGHT - HEIGHT.min()) / np.ptp(HEIGHT)
    texture_set, svbrdf = read(make_folder(a_Height__exr=(metres, "float")))
    assert np.ptp(svbrdf.height) == pytest.approx(0.02 * 64, rel=1e-3)
    assert any("values go from 2.3 to 2.34" in note for note in texture_set.notes)


def test_a_constant_map_has_no_proportions(make_folder) -> None:
    stand_in = np.full((4, 4), 0.4)
    colour = np.random.default_rng(0).random((32, 64, 3))
    _, svbrdf = read(
        make_folder(
            a_NormalGL__png=np.full((32, 64, 3), [0.5, 0.5, 1.0]), a_Color__png=colour, a_Roughness__png=stand_in
        )
    )
    np.testing.assert_allclose(roughness_of(svbrdf), 0.4, atol=1e-6)
    assert svbrdf.size == (32, 64)


def test_what_is_not_read_is_listed(make_folder) -> None:
    folder = make_folder(a_NormalGL__png=encoded(NORMAL), a_other__png=encoded(NORMAL))
    (folder / "a.ktx2").write_bytes(b"x")
    (folder / "a.sbsar").write_bytes(b"x")
    (folder / "notes.txt").write_text("x")
    assert read_texture_set(folder).ignored == ["a_other.png", "a.ktx2", "a.sbsar"]


def test_a_file_whose_name_is_not_utf8_is_named_and_the_others_go_on(make_folder) -> None:
    folder = make_folder(a_NormalGL__png=encoded(NORMAL))
    Path(os.fsdecode(os.fsencode(folder) + b"/caf\xe9_Color.png")).write_bytes(b"x")
    texture_set, _ = read(folder)
    (note,) = [note for note in texture_set.notes if "UTF-8" in note]
    note.encode("utf-8")


def test_short_normals_are_normalised(make_folder) -> None:
    length = np.linspace(0.4, 1.0, NORMAL.shape[1])[None, :, None]
    _, svbrdf = read(make_folder(a_NormalGL__png=(encoded(NORMAL * length), "uint16")))
    np.testing.assert_allclose(svbrdf.normal, NORMAL, atol=2e-4)


def test_zero_vectors_and_normals_below_the_horizon_are_mended_and_counted(make_folder) -> None:
    normal = NORMAL.copy()
    normal[0, :5] = 0.0
    normal[1, :7] = (0.8, 0.0, -0.6)
    texture_set, svbrdf = read(make_folder(a_NormalGL__exr=(encoded(normal), "float")))
    np.testing.assert_array_equal(svbrdf.normal[0, :5], np.broadcast_to([0, 0, 1], (5, 3)))
    assert svbrdf.normal[..., 2].min() > 0.0
    assert any("has 5 vectors of no length in 3072 texels" in note for note in texture_set.notes)
    assert any("has 7 normals at or below the horizon in 3072 texels" in note for note in texture_set.notes)


def test_an_all_zero_normal_map_is_flat(make_folder) -> None:
    _, svbrdf = read(make_folder(a_NormalGL__png=np.full((4, 4, 3), 127.0 / 255.0)))
    np.testing.assert_array_equal(svbrdf.normal, np.broadcast_to([0, 0, 1], (4, 4, 3)))


def test_eight_bits_kept_in_sixteen_have_the_noise_floor_of_eight(make_folder) -> None:
    codes = np.broadcast_to([127, 127, 255], (32, 32, 3)) + np.random.default_rng(0).integers(0, 2, (32, 32, 3))
    folder = make_folder(a_NormalGL__png=(codes.clip(0, 255) / 255.0, "uint16"))
    _, svbrdf = read(folder, denoise_normals=True)
    np.testing.assert_array_equal(svbrdf.normal[:, :, :2], 0.0)


@pytest.mark.parametrize("kind", ["uint8", "uint16"])
def test_the_normal_map_as_stored_is_the_truth(make_folder, kind: str) -> None:
    """Decoded as an engine decodes it: no texel is moved by its neighbours."""
    top = {"uint8": 255, "uint16": 65535}[kind]
    codes = np.rint(encoded(NORMAL) * top)
    _, svbrdf = read(make_folder(a_NormalGL__png=(codes / top, kind)))
    vectors = 2.0 * codes / top - 1.0
    np.testing.assert_allclose(svbrdf.normal, vectors / np.linalg.norm(vectors, axis=2, keepdims=True), atol=1e-6)


def test_a_height_map_alone_gives_the_normals(make_folder) -> None:
    span = float(np.ptp(HEIGHT))
    folder = make_folder(a_Height__exr=((HEIGHT - HEIGHT.min()) / span, "float"))
    texture_set, svbrdf = read(folder, height_scale=span)
    np.testing.assert_allclose(svbrdf.normal, NORMAL, atol=5e-3)  # central differences
    np.testing.assert_allclose(np.ptp(svbrdf.height), span, rtol=1e-5)
    assert any("made from the slopes of the height map" in note for note in texture_set.notes)


def test_a_height_maps_scale_is_taken_from_the_normals(make_folder) -> None:
    span = float(np.ptp(HEIGHT))
    grey = ((HEIGHT - HEIGHT.min()) / span, "uint16")
    _, svbrdf = read(make_folder(a_Height__png=grey, a_NormalGL__png=(encoded(NORMAL), "uint16")))
    assert np.ptp(svbrdf.height) == pytest.approx(span, rel=0.02)


def test_a_height_maps_default_scale_is_said(make_folder) -> None:
    texture_set, svbrdf = read(make_folder(a_Height__png=(np.linspace(0, 1, 64)[None].repeat(32, 0), "uint16")))
    assert np.ptp(svbrdf.height) == pytest.approx(0.02 * 64)
    assert any("is taken to span 1.3 texels" in note for note in texture_set.notes)


# Roughness, colours, packing


def test_gloss_is_one_minus_roughness(make_folder) -> None:
    rough = np.linspace(0.1, 1.0, 16)[None].repeat(8, 0)
    flat = np.full((8, 16, 3), [0.5, 0.5, 1.0])
    _, a = read(make_folder("a", a_NormalGL__png=flat, a_Roughness__exr=(rough, "float")))
    _, b = read(make_folder("b", a_NormalGL__png=flat, a_Gloss__exr=(1.0 - rough, "float")))
    np.testing.assert_allclose(roughness_of(a), rough, rtol=1e-5)
    np.testing.assert_allclose(roughness_of(b), rough, rtol=1e-5)


def test_the_roughness_floor_is_applied_and_counted(make_folder) -> None:
    rough = np.array([[0.0, 0.02, 0.1, 0.5]])
    folder = make_folder(a_NormalGL__png=np.full((1, 4, 3), [0.5, 0.5, 1.0]), a_Roughness__exr=(rough, "float"))
    texture_set = read_texture_set(folder)
    svbrdf = to_svbrdf(texture_set, min_roughness=0.08)
    np.testing.assert_allclose(roughness_of(svbrdf), [[0.08, 0.08, 0.1, 0.5]], rtol=1e-5)
    assert any("floor of 0.08 raised 2 of 4 texels" in note for note in texture_set.notes)
    with pytest.raises(InputError, match="roughness floor is 0"):
        to_svbrdf(texture_set, min_roughness=0.0)


def test_the_metallic_workflow(make_folder) -> None:
    flat = np.full((1, 3, 3), [0.5, 0.5, 1.0])
    base = np.array([[[1.0, 0.5, 0.0]] * 3])
    _, svbrdf = read(
        make_folder(
            a_NormalGL__png=flat, a_Color__exr=(base, "float"), a_Metallic__exr=(np.array([[0.0, 0.5, 1.0]]), "float")
        )
    )
    np.testing.assert_allclose(svbrdf.specular[0], [[0.04] * 3, [0.52, 0.27, 0.02], [1.0, 0.5, 0.0]], atol=1e-6)
    np.testing.assert_allclose(svbrdf.diffuse[0], [[1.0, 0.5, 0.0], [0.5, 0.25, 0.0], [0.0] * 3], atol=1e-6)


def test_the_specular_workflow(make_folder) -> None:
    flat = np.full((1, 1, 3), [0.5, 0.5, 1.0])
    colours = {"a_Diffuse__png": np.array([[[0.5, 0.0, 1.0]]]), "a_Specular__png": np.array([[[1.0, 0.5, 0.0]]])}
    _, svbrdf = read(make_folder(a_NormalGL__png=flat, **colours))
    half = ((128 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(svbrdf.specular[0, 0], [1.0, half, 0.0], atol=1e-6)
    np.testing.assert_allclose(svbrdf.diffuse[0, 0], [half, 0.0, 1.0], atol=1e-6)


def test_missing_maps_are_assumed_and_said(make_folder) -> None:
    texture_set, svbrdf = read(make_folder(a_NormalGL__png=encoded(NORMAL)))
    np.testing.assert_allclose(svbrdf.diffuse, 0.5)
    np.testing.assert_allclose(svbrdf.specular, 0.04)
    np.testing.assert_allclose(roughness_of(svbrdf), 0.5, rtol=1e-6)
    assert any("grey of 0.5" in note for note in texture_set.notes)
    assert any("roughness of 0.5 is assumed" in note for note in texture_set.notes)


def test_packed_channels_are_those_of_separate_maps(make_folder) -> None:
    rng = np.random.default_rng(1)
    ao, rough, metal = rng.random((3, 8, 8))
    flat = np.full((8, 8, 3), [0.5, 0.5, 1.0])
    _, apart = read(make_folder("a", m_NormalGL__png=flat, m_AO__png=ao, m_Roughness__png=rough, m_Metallic__png=metal))
    for word, order in (("ORM", (ao, rough, metal)), ("arm", (ao, rough, metal)), ("RMA", (rough, metal, ao))):
        _, packed = read(make_folder(word, **{"m_NormalGL__png": flat, f"m_{word}__png": np.stack(order, 2)}))
        for name, array in apart.arrays().items():
            np.testing.assert_array_equal(packed.arrays()[name], array, err_msg=f"{word} {name}")


@pytest.mark.parametrize(("count", "channel"), [(3, "A"), (1, "G"), (1, "B"), (2, "G"), (2, "B"), (1, "A")])
def test_a_channel_that_a_file_does_not_have_is_refused(make_folder, count: int, channel: str) -> None:
    """It was another channel's values without a word: blue for the alpha of RGB, alpha for the blue of grey."""
    flat = np.full((4, 4, 3), [0.5, 0.5, 1.0])
    folder = make_folder(a_NormalGL__png=flat, other__png=np.random.default_rng(3).random((4, 4, count)))
    texture_set = read_texture_set(folder, roles={"roughness": f"other.png:{channel}"})
    with pytest.raises(InputError, match=rf"other.png' has the channels .*, expected {channel} among them, for its ro"):
        to_svbrdf(texture_set)


def test_roughness_in_the_normals_alpha_and_height_in_the_colours(make_folder) -> None:
    rough = np.linspace(0.0, 1.0, 64)[None].repeat(48, 0)
    grey = (HEIGHT - HEIGHT.min()) / np.ptp(HEIGHT)
    colour = np.random.default_rng(2).random((48, 64, 3))
    folder = make_folder(r_nrm_rgh__png=np.dstack([encoded(NORMAL), rough]), r_alb_ht__png=np.dstack([colour, grey]))
    _, svbrdf = read(folder)
    # Alpha of zero too: premultiplied reading would darken the normals and the colours.
    np.testing.assert_allclose(svbrdf.normal, NORMAL, atol=EIGHT_BITS)
    np.testing.assert_allclose(roughness_of(svbrdf), np.maximum(rough, 0.045), atol=0.003)
    assert svbrdf.height is not None


def test_an_explicit_map_of_roles_wins_over_names(make_folder) -> None:
    flat = np.full((4, 4, 3), [0.5, 0.5, 1.0])
    stack = np.dstack([np.full((4, 4), 0.2), np.full((4, 4), 0.6), np.full((4, 4), 0.9)])
    folder = make_folder(picture__png=flat, a_Roughness__png=stack[:, :, :1], other__png=stack)
    texture_set, svbrdf = read(folder, roles={"normal": "picture.png", "roughness": "other.png:B"})
    np.testing.assert_allclose(roughness_of(svbrdf), 0.9, atol=0.003)
    assert texture_set.ignored == ["a_Roughness.png"]
    _, svbrdf = read(folder, roles={"normal": "picture.png", "orm": "other.png"})
    np.testing.assert_allclose(roughness_of(svbrdf), 0.6, atol=0.003)
    np.testing.assert_allclose(svbrdf.occlusion, 0.2, atol=0.003)
    with pytest.raises(UnknownNameError, match="did you mean 'roughness'"):
        read_texture_set(folder, roles={"roughnes": "other.png"})


# Sizes


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (13, 1), (5, 7)])
@pytest.mark.parametrize("wrap", ["tile", "clamp"])
def test_any_size_is_read(make_folder, size: tuple[int, int], wrap: str) -> None:
    rng = np.random.default_rng(3)
    normal = encoded(np.dstack([rng.uniform(-0.3, 0.3, (*size, 2)), np.ones(size)]))
    folder = make_folder(a_NormalGL__png=normal, a_Roughness__png=rng.random(size), a_Height__png=rng.random(size))
    _, svbrdf = read(folder, wrap=wrap)
    assert svbrdf.size == size
    assert svbrdf.is_finite()
    assert svbrdf.wrap == wrap


def test_a_height_alone_of_one_texel_is_flat(make_folder) -> None:
    _, svbrdf = read(make_folder(a_Height__png=np.full((1, 1), 0.7)))
    np.testing.assert_allclose(svbrdf.normal, [[[0, 0, 1]]])


def test_mixed_sizes_are_brought_to_the_largest_and_said(make_folder) -> None:
    small = np.full((12, 16, 3), 0.5)
    folder = make_folder(a_NormalGL__png=encoded(NORMAL), a_Color__png=small, a_Roughness__png=np.full((1, 1), 0.3))
    texture_set, svbrdf = read(folder)
    assert svbrdf.size == (48, 64)
    np.testing.assert_allclose(roughness_of(svbrdf), 0.3, atol=0.003)
    assert any("16x12, 1x1, 64x48" in note and "brought to 64x48" in note for note in texture_set.notes)


def test_a_smaller_height_keeps_its_slopes(make_folder) -> None:
    height, normal = bumps(96, 128)
    span = float(np.ptp(height))
    grey = ((height - height.min()) / span).reshape(48, 2, 64, 2).mean((1, 3))
    folder = make_folder(a_Height__exr=(grey, "float"), a_Color__png=np.full((96, 128, 3), 0.5))
    _, svbrdf = read(folder, height_scale=span)
    np.testing.assert_allclose(svbrdf.normal, normal, atol=0.02)  # bilinear between texels twice as large


# What cannot be used


def test_a_missing_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"nowhere' does not exist, expected a folder of textures or a \.gltf"):
        read_texture_set(tmp_path / "nowhere")


def test_an_empty_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds nothing, expected a folder of textures"):
        read_texture_set(tmp_path)


def test_a_folder_without_images_is_told(tmp_path: Path) -> None:
    (tmp_path / "readme.txt").write_text("no images")
    with pytest.raises(InputError, match="holds 1 files, none of them an image"):
        read_texture_set(tmp_path)


def test_a_folder_of_folders_is_told_what_bakes_it(tmp_path: Path) -> None:
    (tmp_path / "oak").mkdir()
    with pytest.raises(InputError, match="holds folders alone \\(oak\\).*`brdffit library`"):
        read_texture_set(tmp_path)


def test_a_link_that_leads_nowhere_is_no_file(make_folder) -> None:
    folder = make_folder(a_NormalGL__png=encoded(NORMAL))
    (folder / "a_Roughness.png").symlink_to("a_Roughness.png")
    assert set(read_texture_set(folder).maps) == {"normal"}


def test_a_single_map_is_told_its_folder(make_folder) -> None:
    folder = make_folder(a_NormalGL__png=encoded(NORMAL))
    with pytest.raises(InputError, match=f"give its folder, '{folder}'"):
        read_texture_set(folder / "a_NormalGL.png")


def test_a_material_needs_a_file_that_holds_it(make_folder) -> None:
    with pytest.raises(InputError, match=r"expected one that holds the material 'Oak'"):
        read_texture_set(make_folder(a_NormalGL__png=encoded(NORMAL)), material="Oak")


def test_a_file_of_another_kind_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.zip").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"a\.zip' is a file of another kind, expected a folder"):
        read_texture_set(tmp_path / "a.zip")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read every folder")
def test_an_unreadable_folder_is_told(tmp_path: Path) -> None:
    folder = tmp_path / "closed"
    folder.mkdir(mode=0)
    with pytest.raises(InputError, match="closed' cannot be read: Permission denied"):
        read_texture_set(folder)


def test_no_normal_and_no_height_is_told(make_folder) -> None:
    folder = make_folder(a_Color__png=np.full((4, 4, 3), 0.5), odd__png=np.full((4, 4, 3), 0.5))
    with pytest.raises(InputError, match=r"no normal map and no height map \(found: a_Color.png \(base_color\)\)"):
        read_texture_set(folder)


def test_maps_of_other_proportions_are_told(make_folder) -> None:
    folder = make_folder(a_NormalGL__png=encoded(NORMAL), a_Color__png=np.random.default_rng(0).random((64, 64, 3)))
    with pytest.raises(
        InputError, match="cannot belong together: 'a_NormalGL.png' is 64x48 where the largest map is 64x64"
    ):
        read_texture_set(folder)


def test_maps_that_differ_by_rounding_belong_together(make_folder) -> None:
    folder = make_folder(a_NormalGL__png=np.full((101, 75, 3), [0.5, 0.5, 1.0]), a_Color__png=np.full((50, 37, 3), 0.5))
    assert to_svbrdf(read_texture_set(folder)).size == (101, 75)


def test_two_materials_in_one_folder_are_told(make_folder) -> None:
    folder = make_folder(oak_NormalGL__png=encoded(NORMAL), elm_NormalGL__png=encoded(NORMAL))
    with pytest.raises(InputError, match="more than one material"):
        read_texture_set(folder)
    assert read_texture_set(folder, roles={"normal": "oak_NormalGL.png"}).maps["normal"].path.name == "oak_NormalGL.png"


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_a_truncated_map_is_told(make_folder, suffix: str) -> None:
    folder = make_folder(**{f"a_NormalGL__{suffix}": encoded(NORMAL), "a_Color__png": np.full((48, 64, 3), 0.5)})
    path = folder / f"a_NormalGL.{suffix}"
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])
    with pytest.raises(InputError, match=r"a_NormalGL\..*' is truncated or damaged .* expected 64x48 pixels"):
        to_svbrdf(read_texture_set(folder))


def test_an_empty_map_and_one_of_another_kind_are_told(make_folder) -> None:
    folder = make_folder(a_NormalGL__png=encoded(NORMAL))
    (folder / "a_Roughness.png").touch()
    with pytest.raises(InputError, match=r"a_Roughness\.png' is empty \(0 bytes\)"):
        read_texture_set(folder)
    (folder / "a_Roughness.png").write_text("text")
    with pytest.raises(InputError, match=r"a_Roughness\.png' is not an image"):
        read_texture_set(folder)


def test_a_file_named_by_a_role_that_is_missing_is_told(make_folder) -> None:
    with pytest.raises(InputError, match=r"none\.png' does not exist"):
        read_texture_set(make_folder(a_NormalGL__png=encoded(NORMAL)), roles={"roughness": "none.png"})


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("role", ["NormalGL", "Roughness", "Color"])
def test_nan_and_infinity_are_told_with_their_count(make_folder, role: str, bad: float) -> None:
    files = {"NormalGL": encoded(NORMAL), "Roughness": np.full((48, 64, 1), 0.5), "Color": np.full((48, 64, 3), 0.5)}
    files[role] = files[role].copy()
    files[role][3, :5, 0] = bad
    folder = make_folder(**{f"a_{name}__exr": (pixels, "float") for name, pixels in files.items()})
    with pytest.raises(InputError, match=rf"a_{role}\.exr' holds NaN or infinity in 5 of 3072 texels"):
        to_svbrdf(read_texture_set(folder))


PICTURES = {
    "a colour picture": np.random.default_rng(5).random((32, 32, 3)) * [0.9, 0.6, 0.3],
    "a grey picture": np.random.default_rng(6).random((32, 32, 1)).repeat(3, 2),
    "white": np.ones((32, 32, 3)) - 0.1 * np.random.default_rng(7).random((32, 32, 3)),
    "an object-space map": encoded(np.random.default_rng(8).normal(size=(32, 32, 3)).clip(-1, 1)),
}


@pytest.mark.parametrize("picture", PICTURES)
def test_what_is_no_normal_map_is_told(make_folder, picture: str) -> None:
    folder = make_folder(a_NormalGL__png=PICTURES[picture])
    with pytest.raises(InputError, match=r"is not a tangent-space normal map: its mean vector is .* expected one near"):
        to_svbrdf(read_texture_set(folder))


def test_a_normal_map_of_one_channel_is_told(make_folder) -> None:
    with pytest.raises(InputError, match="has one channel, expected a normal map"):
        to_svbrdf(read_texture_set(make_folder(normal__png=np.full((4, 4), 0.5))))


@pytest.mark.parametrize(("how", "power"), [("decoded as", 2.2), ("encoded as", 1 / 2.2)])
@pytest.mark.parametrize("channels", [2, 3])
def test_a_normal_map_through_srgb_is_told(make_folder, how: str, power: float, channels: int) -> None:
    folder = make_folder(a_NormalGL__png=encoded(NORMAL)[:, :, :channels] ** power)
    with pytest.raises(InputError, match=f"looks like a normal map that was {how} sRGB"):
        to_svbrdf(read_texture_set(folder))


def test_unknown_options_are_told(make_folder) -> None:
    folder = make_folder(a_NormalGL__png=encoded(NORMAL))
    with pytest.raises(UnknownNameError, match="no normal Y 'opengl'"):
        read_texture_set(folder, normal_y="opengl")
    with pytest.raises(UnknownNameError, match="no wrap mode 'repeat'"):
        read_texture_set(folder, wrap="repeat")
    with pytest.raises(InputError, match="height scale is -1.0, expected a positive"):
        read_texture_set(folder, height_scale=-1.0)


# Bookkeeping


def test_name_inputs_and_ignored_files(make_folder) -> None:
    folder = make_folder(
        "rock", a_NormalGL__png=encoded(NORMAL), a_NormalDX__png=encoded(NORMAL, "dx"), odd__png=encoded(NORMAL)
    )
    write_image(folder / ".a_Color.part.png", encoded(NORMAL))  # what another program is writing is no map
    texture_set = read_texture_set(f"{folder}/")
    assert texture_set.name == "rock"
    assert texture_set.ignored == ["a_NormalDX.png", "odd.png"]
    [(path, digest)] = texture_set.inputs
    assert path.name == "a_NormalGL.png"
    assert len(digest) == 64
    write_image(path, encoded(NORMAL, "dx"))
    assert texture_set.inputs[0][1] != digest


def test_the_flat_chrome_stays_flat(real_sets: Path) -> None:
    """Its normal map only dithers: flat where that is asked to be taken for noise."""
    svbrdf = to_svbrdf(read_texture_set(real_sets / "chrome-049a-flat-control", denoise_normals=True))
    np.testing.assert_array_equal(svbrdf.normal, np.broadcast_to([0, 0, 1], svbrdf.normal.shape))


@pytest.mark.slow
def test_every_real_set_is_read_without_a_nan(real_sets: Path) -> None:
    for folder in sorted(path for path in real_sets.iterdir() if path.is_dir()):
        if folder.name == "brushed-metal-metal10":
            continue  # 2048x2048: slow, and no case of its own
        svbrdf = to_svbrdf(read_texture_set(folder))
        assert svbrdf.is_finite(), folder.name
        assert svbrdf.normal[..., 2].min() > 0.0, folder.name
        assert float(svbrdf.normal[..., 2].mean()) > 0.8, folder.name
