"""What is written: EXR chains, pictures of each preset, and the conversions of each engine's conventions."""

from __future__ import annotations

import numpy as np
import OpenImageIO as oiio
import pytest
from export_support import averaged_pyramid, random_svbrdf
from hypothesis import given, settings
from hypothesis import strategies as st

from brdffit.colour import decode_srgb, encode_srgb
from brdffit.errors import OutputError, UnknownNameError
from brdffit.export.channels import (
    GODOT_RANGE,
    Channels,
    alphas_from_gltf,
    anisotropy_direction,
    decode,
    tangent_above,
)
from brdffit.export.factors import gltf_strength_from_alphas
from brdffit.export.manifest import build_manifest
from brdffit.export.metallic import base_color_and_metallic
from brdffit.export.pictures import Drawing, dominant_direction, full_chain, quantise
from brdffit.export.presets import PRESETS, get_preset
from brdffit.export.writing import write_baked
from brdffit.files.image_io import read_image, read_mip_exr
from brdffit.methods import Baked
from brdffit.roughness import log_from_tensor, tensor_from_log
from brdffit.svbrdf import level_sizes
from brdffit.textures.conversion import DIELECTRIC_F0

#: Single precision, through a square root or a matrix logarithm.
SINGLE = 2e-5
CHANNELS = {"normal": "X Y Z", "roughness": "XX YY XY", "specular": "R G B", "diffuse": "R G B", "shape": "Y"}


def write(pyramid, folder, **changes):
    return write_baked(
        Baked.of_lobes(pyramid),
        folder,
        name="set",
        manifest=build_manifest(Baked.of_lobes(pyramid), name="set"),
        **changes,
    )


def through_texture_system(path, mip_level, channels):
    """What a renderer sees at the middle of a texture when it asks for one MIP level, or None with its complaint."""
    system = oiio.TextureSystem()
    spec = oiio.ImageBuf(str(path), 0, mip_level).spec()
    options = oiio.TextureOpt()
    options.interpmode = oiio.InterpMode.Closest
    options.mipmode = oiio.MipMode.OneLevel
    level_0 = oiio.ImageBuf(str(path)).spec()
    # A footprint of one texel of that level; slightly less, so that rounding picks no coarser one.
    across, down = 2.0**mip_level / level_0.width * 0.999, 2.0**mip_level / level_0.height * 0.999
    s, t = (spec.width // 2 + 0.5) / spec.width, (spec.height // 2 + 0.5) / spec.height
    seen = system.texture(str(path), options, s, t, across, 0.0, 0.0, down, channels)
    return np.array(seen), system.geterror()


@pytest.mark.parametrize("size", [(64, 64), (24, 40), (17, 5), (1, 9), (1, 1)])
def test_every_level_of_every_exr_comes_back_as_it_was(tmp_path, size):
    pyramid = averaged_pyramid(random_svbrdf(size, shape=np.full(size, 0.5, np.float32), model="generalised-beckmann"))
    write(pyramid, tmp_path / "set")
    for name, channels in CHANNELS.items():
        levels = read_mip_exr(tmp_path / "set" / f"{name}.exr", channels.split())
        assert [level.shape[:2] for level in levels] == level_sizes(size)
        for got, level in zip(levels, pyramid.levels, strict=True):
            svbrdf = level.svbrdf
            expected = {
                "roughness": lambda s=svbrdf: tensor_from_log(s.log_roughness),
                "shape": lambda s=svbrdf: s.shape[..., None],
            }.get(name, lambda s=svbrdf, n=name: getattr(s, n))()
            np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize("levels", [None, 2])
def test_a_texture_system_reads_every_level(tmp_path, levels):
    size = (48, 80)
    pyramid = averaged_pyramid(random_svbrdf(size), levels)
    record = write(pyramid, tmp_path / "set")
    assert record["filled_levels"] == list(range(len(pyramid), len(level_sizes(size))))
    for name in ("normal", "roughness", "specular", "diffuse"):
        path = tmp_path / "set" / f"{name}.exr"
        stored = read_mip_exr(path)
        for mip_level, (height, width) in enumerate(level_sizes(size)):
            seen, complaint = through_texture_system(path, mip_level, 3)
            assert not complaint
            # The texture system takes channels in the file's own (sorted) order.
            np.testing.assert_allclose(seen, stored[mip_level][height // 2, width // 2], atol=1e-5)


def test_levels_that_a_short_pyramid_lacks_are_averages_of_its_last(tmp_path):
    pyramid = averaged_pyramid(random_svbrdf((32, 32)), levels=2)
    write(pyramid, tmp_path / "set")
    last = pyramid[1].svbrdf
    specular = read_mip_exr(tmp_path / "set" / "specular.exr", "RGB")
    np.testing.assert_allclose(specular[-1][0, 0], last.specular.mean(axis=(0, 1)), rtol=1e-5)
    normals = read_mip_exr(tmp_path / "set" / "normal.exr", "XYZ")
    for level in normals:
        np.testing.assert_allclose(np.linalg.norm(level, axis=-1), 1.0, atol=1e-5)
    tensors = read_mip_exr(tmp_path / "set" / "roughness.exr", ["XX", "YY", "XY"])
    for level in tensors:
        assert (level[..., 0] * level[..., 1] > np.square(level[..., 2])).all()
    assert not (tmp_path / "set" / "mips" / "set_normal.2.png").exists()


OF_PNG = [name for name, preset in PRESETS.items() if preset.container == "png"]


@pytest.mark.parametrize("name", OF_PNG)
@pytest.mark.parametrize("bits", [8, 16])
def test_a_preset_of_png_files_writes_its_pictures_for_every_level(tmp_path, name, bits):
    preset = get_preset(name)
    pyramid = averaged_pyramid(random_svbrdf((6, 10)), lobe=preset.lobe)
    write(pyramid, tmp_path / "set", preset=name, bits=bits)
    pictures = [picture for picture in preset.pictures if picture.needs != "occlusion"]
    expected = {f"set_{picture.role}.{k}.png" for picture in pictures for k in range(len(pyramid))}
    assert {path.name for path in (tmp_path / "set" / "mips").iterdir()} == expected
    drawing = Drawing([level.svbrdf for level in pyramid.levels], preset)
    for picture in pictures:
        codes, _ = drawing.draw(picture, picture.srgb, bits)
        for k, level in enumerate(codes):
            image = read_image(tmp_path / "set" / "mips" / f"set_{picture.role}.{k}.png")
            assert image.bits == bits
            # Alpha must not have been multiplied in, nor colours converted.
            np.testing.assert_array_equal(np.round(image.pixels * (2**bits - 1)), level)


def test_isotropic_bakes_have_no_anisotropy_pictures(tmp_path):
    write(averaged_pyramid(random_svbrdf((4, 4)), lobe="isotropic"), tmp_path / "set", preset="three")
    assert not list((tmp_path / "set").rglob("*anisotropy*"))


def test_occlusion_is_written_where_there_is_some(tmp_path):
    pyramid = averaged_pyramid(random_svbrdf((4, 4)))
    for level in pyramid.levels:
        level.svbrdf = level.svbrdf.replace(occlusion=np.full(level.svbrdf.size, 0.2, np.float32))
    write(pyramid, tmp_path / "set")
    pixels = read_image(tmp_path / "set" / "mips" / "set_occlusion.0.png").pixels
    np.testing.assert_array_equal(np.round(255 * pixels), 51)


@pytest.mark.parametrize(
    ("preset", "role", "channels"),
    [
        ("gltf", "occlusionRoughnessMetallic", ["occlusion", "gltf_roughness", "metallic"]),
        ("unreal", "ORM", ["occlusion", "mean_roughness", "metallic", "mean_anisotropy"]),
        ("godot", "orm", ["occlusion", "roughness", "metallic"]),
        ("unity", "MaskMap", ["metallic", "occlusion", "one", "mean_smoothness"]),
    ],
)
def test_packed_channels_hold_what_the_engine_reads(preset, role, channels):
    svbrdf = random_svbrdf((5, 7), occlusion=np.random.default_rng(5).random((5, 7), dtype=np.float32))
    picture = next(picture for picture in get_preset(preset).pictures if picture.role == role)
    (codes,), _ = Drawing([svbrdf], PRESETS["plain"]).draw(picture, picture.srgb, 16)
    # By hand: what each name means, apart from `Channels`.
    _, metallic = base_color_and_metallic(svbrdf.specular, svbrdf.diffuse)
    tensor = tensor_from_log(svbrdf.log_roughness).astype(np.float64)
    roughness = (tensor[..., 0] * tensor[..., 1] - tensor[..., 2] ** 2) ** 0.125
    matrices = np.stack([tensor[..., [0, 2]], tensor[..., [2, 1]]], axis=-2)
    minor, major = np.moveaxis(np.sqrt(np.linalg.eigvalsh(matrices)), -1, 0)
    by_name = {
        "occlusion": svbrdf.occlusion,
        "metallic": metallic,
        "roughness": roughness,
        "mean_roughness": np.sqrt((major + minor) / 2),
        "mean_smoothness": 1 - np.sqrt((major + minor) / 2),
        "mean_anisotropy": (major - minor) / (major + minor),
        "gltf_roughness": np.sqrt(minor),
        "one": np.ones((5, 7)),
    }
    for index, name in enumerate(channels):
        np.testing.assert_allclose(codes[..., index] / 65535.0, by_name[name], atol=2e-5)


def test_directx_and_opengl_normals_differ_by_the_sign_of_y():
    svbrdf = random_svbrdf((9, 9))
    gl, dx = Channels(svbrdf, "gl"), Channels(svbrdf, "dx")
    np.testing.assert_allclose(2 * gl["normal_y"] - 1, -(2 * dx["normal_y"] - 1), atol=1e-6)
    np.testing.assert_array_equal(gl["normal_x"], dx["normal_x"])
    np.testing.assert_allclose(2 * gl["tangent_y"] - 1, -(2 * dx["tangent_y"] - 1), atol=1e-6)
    assert {name for name, preset in PRESETS.items() if preset.normal_y == "dx"} == {"unreal"}


def test_metallic_roughness_presets_hold_the_specular():
    assert {name for name, preset in PRESETS.items() if preset.specular == "free"} == {"plain", "ntc"}


@pytest.mark.parametrize("name", PRESETS)
def test_the_svbrdf_comes_back_from_the_channels_of_every_preset(name):
    """`decode` is the inverse of `Channels`, but for single precision and ratios of alphas that an engine has not."""
    preset = get_preset(name)
    svbrdf = random_svbrdf((16, 16), slope=0.4)
    channels = Channels(svbrdf, preset.normal_y, dominant_direction(svbrdf))
    names = {channel for picture in preset.pictures for channel in picture.channels}
    back = decode({channel: channels[channel] for channel in names}, preset.normal_y)
    np.testing.assert_allclose(back.normal, svbrdf.normal, atol=1e-4)
    np.testing.assert_allclose(
        tensor_from_log(back.log_roughness), tensor_from_log(svbrdf.log_roughness), rtol=4e-3, atol=2e-5
    )
    np.testing.assert_allclose(back.specular, svbrdf.specular, atol=2e-4)
    np.testing.assert_allclose(back.diffuse, svbrdf.diffuse, atol=2e-4)


def test_directions_are_as_long_as_the_lobe_is_anisotropic():
    svbrdf = random_svbrdf((16, 16))
    plain = Channels(svbrdf)
    strongest = float(plain["gltf_strength"].max())
    channels = Channels(svbrdf, strongest=strongest)
    direction = np.stack([2 * channels["direction_x"] - 1, 2 * channels["direction_y"] - 1], axis=-1)
    length = np.linalg.norm(direction, axis=-1)
    np.testing.assert_allclose(length, plain["gltf_strength"] / strongest, atol=SINGLE)
    assert length.max() == pytest.approx(1.0, abs=SINGLE)


def test_a_pyramid_that_stops_early_is_continued_to_one_texel():
    pyramid = averaged_pyramid(random_svbrdf((12, 20)), levels=2)
    levels = full_chain([level.svbrdf for level in pyramid.levels])
    assert [level.size for level in levels] == level_sizes((12, 20))
    last = pyramid[1].svbrdf
    np.testing.assert_allclose(levels[-1].diffuse[0, 0], last.diffuse.mean(axis=(0, 1)), rtol=0.3)
    for level in levels:
        np.testing.assert_allclose(np.linalg.norm(level.normal, axis=-1), 1.0, atol=1e-5)
        assert level.is_finite()


def test_what_a_preset_cannot_store_is_told_before_the_work(tmp_path):
    pytest.importorskip("alktx2", reason="the extra [basis] is not installed")
    with pytest.raises(OutputError, match="multiples of 4 .* found 10x6"):
        write(averaged_pyramid(random_svbrdf((6, 10))), tmp_path / "set", preset="gltf")
    with pytest.raises(OutputError, match="multiples of 4 .* found 10x6"):
        write(averaged_pyramid(random_svbrdf((6, 10))), tmp_path / "set", preset="unity")
    with pytest.raises(OutputError, match="8 bits a channel, not 16"):
        write(averaged_pyramid(random_svbrdf((8, 8))), tmp_path / "set", preset="gltf", bits=16)
    with pytest.raises(UnknownNameError, match="did you mean 'best'"):
        write(averaged_pyramid(random_svbrdf((8, 8))), tmp_path / "set", preset="three", compress="bst")
    assert not list(tmp_path.iterdir())


@settings(deadline=None, max_examples=200)
@given(st.tuples(*[st.floats(0, 1)] * 3), st.floats(0, 1))
def test_base_color_and_metallic_explain_the_colours_they_came_from(base_color, metallic):
    base = np.array(base_color, np.float32)
    m = np.float32(metallic)
    specular, diffuse = DIELECTRIC_F0 * (1 - m) + base * m, base * (1 - m)
    got, got_m = base_color_and_metallic(specular[None], diffuse[None])
    # The tie towards dielectrics may cost 1e-4 of reflectance, far below one code.
    np.testing.assert_allclose(DIELECTRIC_F0 * (1 - got_m[0]) + got[0] * got_m[0], specular, atol=2e-4)
    np.testing.assert_allclose(got[0] * (1 - got_m[0]), diffuse, atol=2e-4)


def test_base_color_and_metallic_come_back_on_a_grid():
    grid = np.linspace(0.05, 1.0, 20, dtype=np.float32)
    base, m = np.meshgrid(grid, np.linspace(0, 1, 21, dtype=np.float32))
    base = base[..., None] * np.array([1.0, 0.9, 0.85], np.float32)
    m = m[..., None]
    got, got_m = base_color_and_metallic(DIELECTRIC_F0 * (1 - m) + base * m, base * (1 - m))
    bright = base.min(axis=-1) > DIELECTRIC_F0 + 0.005  # darker metals look like dielectrics
    np.testing.assert_allclose(got_m[bright], m[..., 0][bright], atol=1e-3)
    np.testing.assert_allclose(got[bright], base[bright], atol=1e-3)


def test_any_colour_gives_a_finite_base_color_and_metallic():
    values = np.array([0.0, 1e-8, 0.02, 0.04, 0.5, 1.0, 3.0], np.float32)
    specular, diffuse = np.meshgrid(values, values)
    got, got_m = base_color_and_metallic(specular[..., None].repeat(3, -1), diffuse[..., None].repeat(3, -1))
    assert np.isfinite(got).all() and np.isfinite(got_m).all()
    assert got.min() >= 0 and got.max() <= 1 and got_m.min() >= 0 and got_m.max() <= 1
    black = base_color_and_metallic(np.full((1, 3), 0.04, np.float32), np.zeros((1, 3), np.float32))
    assert black[1][0] == pytest.approx(0.0, abs=1e-6)


@settings(deadline=None, max_examples=100)
@given(st.floats(0.05, 1.0), st.floats(0.0, 1.0))
def test_gltf_anisotropy_comes_back(minor, share):
    major = minor + (1 - minor) * share
    strength = gltf_strength_from_alphas(np.float64(major), np.float64(minor))
    np.testing.assert_allclose(alphas_from_gltf(np.sqrt(minor), strength), (major, minor), atol=1e-9)


@pytest.mark.parametrize("preset", ["gltf", "godot", "plain"])
def test_the_tensor_comes_back_from_the_pictures_of_a_preset(preset):
    """Decode direction, roughness and strength as the engine does and build Sigma from them."""
    svbrdf = random_svbrdf((16, 16), slope=0.4)
    channels = Channels(svbrdf, "gl", dominant_direction(svbrdf))
    direction = np.stack([2 * channels["direction_x"] - 1, 2 * channels["direction_y"] - 1], axis=-1)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    if preset == "gltf":
        major, minor = alphas_from_gltf(channels["gltf_roughness"], channels["gltf_strength"])
    else:
        ratio = 1 - (GODOT_RANGE * channels["godot_strength"] if preset == "godot" else channels["ratio_strength"])
        major, minor = channels["roughness"] ** 2 / np.sqrt(ratio), channels["roughness"] ** 2 * np.sqrt(ratio)
    tangent = tangent_above(svbrdf.normal, direction)
    # Back into the frame of the normal, by the rotation written out as a matrix.
    n = svbrdf.normal.astype(np.float64)
    x, y, z = np.moveaxis(n, -1, 0)
    k = 1 / (1 + z)
    rows = [[1 - x * x * k, -x * y * k, -x], [-x * y * k, 1 - y * y * k, -y]]
    e = np.stack([sum(r * tangent[..., i] for i, r in enumerate(row)) for row in rows], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(e, axis=-1), 1.0, atol=1e-4)
    outer = np.stack([e[..., 0] ** 2, e[..., 1] ** 2, e[..., 0] * e[..., 1]], axis=-1)
    unit = np.array([1.0, 1.0, 0.0])
    tensor = (major**2)[..., None] * outer + (minor**2)[..., None] * (unit - outer)
    np.testing.assert_allclose(tensor, tensor_from_log(svbrdf.log_roughness), rtol=2e-3, atol=2e-5)


def test_directions_lie_in_one_half_plane_whatever_the_level():
    svbrdf = random_svbrdf((16, 16))
    towards = dominant_direction(svbrdf)
    channels = Channels(svbrdf, "gl", towards)
    assert (
        (2 * channels["direction_x"] - 1) * towards[0] + (2 * channels["direction_y"] - 1) * towards[1] >= -1e-6
    ).all()


def test_the_direction_is_the_one_of_larger_roughness():
    flat = np.array([0.0, 0.0, 1.0], np.float32)
    for angle in np.linspace(0, np.pi, 7):
        e = np.array([np.cos(angle), np.sin(angle)])
        tensor = 0.09 * np.outer(e, e) + 0.01 * (np.eye(2) - np.outer(e, e))
        log = log_from_tensor(np.array([tensor[0, 0], tensor[1, 1], tensor[0, 1]]))
        assert abs(anisotropy_direction(flat, log) @ e) == pytest.approx(1.0, abs=1e-6)


def test_srgb_comes_back_at_every_code():
    codes = np.arange(65536) / 65535.0
    np.testing.assert_array_equal(quantise(encode_srgb(decode_srgb(codes)), 16), np.arange(65536))
    codes = np.arange(256) / 255.0
    np.testing.assert_array_equal(quantise(encode_srgb(decode_srgb(codes)), 8), np.arange(256))


def test_values_beyond_the_picture_are_clipped_and_counted(tmp_path):
    base = random_svbrdf((4, 4))
    pyramid = averaged_pyramid(base)
    pyramid[0].svbrdf.specular[0, 0] = 1.5
    record = write(pyramid, tmp_path / "set")
    assert record["pictures"]["specular"]["clipped_values"] == [3, 0, 0]
    assert record["stored"][0]["appearance_db"] < record["stored"][1]["appearance_db"]
    assert quantise(np.array([-1.0, 2.0]), 8).tolist() == [0, 255]


def test_an_unknown_preset_is_told_with_the_nearest(tmp_path):
    with pytest.raises(UnknownNameError, match="did you mean 'unreal'"):
        write(averaged_pyramid(random_svbrdf((2, 2))), tmp_path / "set", preset="unreel")
    assert not list(tmp_path.iterdir())
