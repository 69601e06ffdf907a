"""What a glTF material says beside its maps (factors, samplers, transforms, extensions): read, refused or named."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pictures import bumps, encoded, write_image

from brdffit.errors import InputError, UnknownNameError
from brdffit.roughness import perceptual_from_log_tensor, tensor_from_log
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.frames import IDENTITY, Frame, common_frame, gltf_frame, read_through
from brdffit.textures.gltf import gltf_material_names
from brdffit.textures.reading import read_texture_set

SIZE = 16
HEIGHT, NORMAL = bumps(SIZE, SIZE)
RNG = np.random.default_rng(0)
COLOR, ORM = RNG.random((2, SIZE, SIZE, 3))
#: Half a code of 8 bits.
HALF_A_CODE = 0.5 / 255.0 + 1e-6


def base_material(**more) -> dict:
    material = {
        "name": "wall",
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1}},
        "normalTexture": {"index": 2},
    }
    return material | more


@pytest.fixture
def write(tmp_path: Path):
    """Write a .gltf beside its three pictures; returns its path."""
    write_image(tmp_path / "c.png", COLOR)
    write_image(tmp_path / "orm.png", ORM)
    write_image(tmp_path / "n.png", encoded(NORMAL), "uint16")

    def make(*materials: dict, samplers: tuple[dict, ...] = (), **more) -> Path:
        document = {
            "asset": {"version": "2.0"},
            "images": [{"uri": name} for name in ("c.png", "orm.png", "n.png")],
            "textures": [
                {"source": k} | ({"sampler": min(k, len(samplers) - 1)} if samplers else {}) for k in range(3)
            ],
            "samplers": list(samplers),
            "materials": list(materials) or [base_material()],
        }
        path = tmp_path / "scene.gltf"
        path.write_text(json.dumps(document | more))
        return path

    return make


def read(path: Path, **options):
    texture_set = read_texture_set(path, **options)
    return texture_set, to_svbrdf(texture_set, min_roughness=0.001)


def transformed(texture: dict, **transform) -> dict:
    return texture | {"extensions": {"KHR_texture_transform": transform}}


# Extensions


def test_a_required_extension_that_is_not_known_is_refused(write) -> None:
    with pytest.raises(InputError, match="requires ACME_secret_bsdf, which is not read here"):
        read(write(extensionsRequired=["ACME_secret_bsdf"]))
    read(write(extensionsRequired=["KHR_texture_transform", "KHR_draco_mesh_compression"]))


def test_another_version_is_refused(write) -> None:
    with pytest.raises(InputError, match=r"version 1\.0, expected 2\.0"):
        read(write(asset={"version": "1.0"}))


def test_the_index_of_refraction_and_the_specular_extension_give_f0(write) -> None:
    extensions = {
        "KHR_materials_ior": {"ior": 1.8},
        "KHR_materials_specular": {"specularFactor": 0.5, "specularColorFactor": [1.0, 0.5, 0.0]},
    }
    material = base_material(extensions=extensions)
    material["pbrMetallicRoughness"] |= {"metallicFactor": 0.0}
    _, svbrdf = read(write(material))
    f0 = (0.8 / 2.8) ** 2 * 0.5 * np.array([1.0, 0.5, 0.0])
    np.testing.assert_allclose(svbrdf.specular, np.broadcast_to(f0, svbrdf.specular.shape), rtol=1e-5)


def test_anisotropy_is_that_of_the_extension(write) -> None:
    """alpha_b = r^2, alpha_t = mix(alpha_b, 1, strength^2), t turned counter-clockwise from +x."""
    material = base_material(
        extensions={"KHR_materials_anisotropy": {"anisotropyStrength": 0.6, "anisotropyRotation": np.pi / 6}}
    )
    _, svbrdf = read(write(material))
    across = np.square(np.maximum(np.rint(ORM[..., 1] * 255) / 255, 0.001))
    along = across + (1 - across) * 0.36
    t = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
    expected = (along**2)[..., None, None] * np.outer(t, t)
    expected += (across**2)[..., None, None] * (np.eye(2) - np.outer(t, t))
    found = tensor_from_log(svbrdf.log_roughness)
    for channel, (i, j) in enumerate(((0, 0), (1, 1), (0, 1))):
        np.testing.assert_allclose(found[..., channel], expected[..., i, j], rtol=2e-4, atol=1e-6)


def test_what_is_left_out_is_named(write) -> None:
    extensions = {"KHR_materials_clearcoat": {}, "KHR_materials_sheen": {}, "ACME_dust": {}}
    texture_set, _ = read(write(base_material(extensions=extensions, emissiveFactor=[1, 0, 0])))
    (note,) = [note for note in texture_set.notes if "left out" in note]
    assert all(word in note for word in ("clearcoat", "sheen", "ACME_dust", "emission"))


# Materials


def test_a_material_can_be_named_and_one_that_no_mesh_uses_is_not_read(write) -> None:
    unused, plain = base_material(name="spare"), {"name": "plain", "pbrMetallicRoughness": {"roughnessFactor": 0.3}}
    used = base_material(name="wall")
    meshes = [{"primitives": [{"material": 2}, {"material": 1}]}]
    path = write(unused, plain, used, meshes=meshes)
    texture_set, _ = read(path)
    (note,) = [note for note in texture_set.notes if "materials" in note]
    assert "'wall' is read" in note and "spare" in note and "--material" in note
    assert gltf_material_names(path) == ["plain", "wall"]
    assert read(path, material="spare")[0].maps.keys() == texture_set.maps.keys()
    with pytest.raises(UnknownNameError, match="did you mean 'wall'"):
        read_texture_set(path, material="wal")


# Samplers and coordinates


@pytest.mark.parametrize(("code", "wrap"), [(10497, "tile"), (33071, "clamp")])
def test_the_wrap_is_the_samplers_unless_it_is_given(write, code: int, wrap: str) -> None:
    path = write(samplers=({"wrapS": code, "wrapT": code},))
    assert read_texture_set(path).wrap == wrap
    assert read_texture_set(path, wrap="tile").wrap == "tile"


@pytest.mark.parametrize(
    "samplers",
    [({"wrapS": 33648, "wrapT": 33648},), ({"wrapS": 33071, "wrapT": 10497},), ({}, {"wrapS": 33071, "wrapT": 33071})],
)
def test_a_mirrored_or_mixed_sampler_is_refused_unless_the_wrap_is_given(write, samplers) -> None:
    path = write(samplers=samplers)
    with pytest.raises(InputError, match=r"samplers of .* give --wrap"):
        read_texture_set(path)
    assert read_texture_set(path, wrap="clamp").wrap == "clamp"


def test_maps_in_other_texture_coordinates_are_refused(write) -> None:
    with pytest.raises(InputError, match=r"normal in set 1.*, expected one set for all"):
        read(write(base_material(normalTexture={"index": 2, "texCoord": 1})))
    everywhere = base_material(normalTexture={"index": 2, "texCoord": 1})
    for name in ("baseColorTexture", "metallicRoughnessTexture"):
        everywhere["pbrMetallicRoughness"][name] |= {"texCoord": 1}
    read(write(everywhere))


# Texture transforms


def test_a_map_that_is_scaled_repeats_under_the_others(write) -> None:
    _, plain = read(write())
    texture_set, svbrdf = read(write(base_material(normalTexture=transformed({"index": 2}, scale=[4, 4]))))
    assert svbrdf.size == (4 * SIZE, 4 * SIZE)
    np.testing.assert_array_equal(svbrdf.normal, np.tile(plain.normal, (4, 4, 1)))
    assert any("Texture transforms differ: normal" in note for note in texture_set.notes)


def test_a_transform_that_all_maps_share_stays_outside(write) -> None:
    _, plain = read(write())
    material = base_material(normalTexture=transformed({"index": 2}, scale=[4, 4], rotation=0.3))
    for name in ("baseColorTexture", "metallicRoughnessTexture"):
        texture = material["pbrMetallicRoughness"][name]
        material["pbrMetallicRoughness"][name] = transformed(texture, scale=[4, 4], rotation=0.3)
    texture_set, svbrdf = read(write(material))
    for name, array in plain.arrays().items():
        np.testing.assert_array_equal(svbrdf.arrays()[name], array)
    assert any("stays with the renderer" in note for note in texture_set.notes)


def test_a_map_that_is_offset_is_read_where_it_lies(write) -> None:
    _, plain = read(write())
    material = base_material()
    texture = material["pbrMetallicRoughness"]["baseColorTexture"]
    material["pbrMetallicRoughness"]["baseColorTexture"] = transformed(texture, offset=[0.25, 0.5])
    _, svbrdf = read(write(material))
    np.testing.assert_allclose(svbrdf.diffuse, _metal_mixed(np.roll(COLOR, (-8, -4), (0, 1))), atol=0.02)
    np.testing.assert_array_equal(svbrdf.normal, plain.normal)


def _metal_mixed(colour: np.ndarray) -> np.ndarray:
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    return linear * (1.0 - ORM[..., 2:])


def test_a_quarter_turn_of_the_normal_map_takes_its_bumps_along(write) -> None:
    """The height under the turned map, differentiated, gives the normals that are read."""
    material = base_material(normalTexture=transformed({"index": 2}, rotation=np.pi / 2, scale=[2, 2]))
    _, svbrdf = read(write(material))
    frame = gltf_frame([0, 0], np.pi / 2, [2, 2])
    height = read_through(frame, HEIGHT[..., None].astype(np.float32))[..., 0]
    up = np.roll(height, 1, 0) - np.roll(height, -1, 0)
    across = np.roll(height, -1, 1) - np.roll(height, 1, 1)
    slope = -svbrdf.normal[..., :2] / svbrdf.normal[..., 2:]
    for axis, gradient in enumerate((across, up)):
        assert np.corrcoef(gradient.ravel(), slope[..., axis].ravel())[0, 1] > 0.98


@pytest.mark.parametrize("transform", [{"scale": [1.5, 1.5]}, {"rotation": 0.4}, {"scale": [0.0, 1.0]}])
def test_a_map_that_does_not_tile_with_the_others_is_refused(write, transform) -> None:
    with pytest.raises(InputError, match=r"do not tile together"):
        read(write(base_material(normalTexture=transformed({"index": 2}, **transform))))


def test_the_common_frame_is_that_of_the_slowest_map() -> None:
    half, four = gltf_frame([0.1, 0.2], 0.0, [0.5, 0.5]), gltf_frame([0, 0], 0.0, [4, 4])
    assert common_frame([four, IDENTITY, half]) == half
    assert common_frame([IDENTITY, gltf_frame([0, 0], 0.0, [1.5, 1])]) is None
    for frame in (half, four, gltf_frame([0.3, 0.1], 0.7, [2, 3])):
        back = frame.inverse()
        assert back is not None
        np.testing.assert_allclose(frame.after(back).arrays[0], np.eye(2), atol=1e-12)
        np.testing.assert_allclose(frame.flipped().flipped().arrays[0], frame.arrays[0], atol=1e-12)
    assert Frame.of(np.eye(2), np.zeros(2)) == IDENTITY


def test_normal_scale_and_roughness_factor_apply(write) -> None:
    material = base_material(normalTexture={"index": 2, "scale": 0.25})
    material["pbrMetallicRoughness"]["roughnessFactor"] = 0.5
    _, svbrdf = read(write(material))
    slope = svbrdf.normal[..., :2] / svbrdf.normal[..., 2:]
    np.testing.assert_allclose(slope, 0.25 * NORMAL[..., :2] / NORMAL[..., 2:], atol=1e-3)
    rough = perceptual_from_log_tensor(svbrdf.log_roughness)
    np.testing.assert_allclose(rough, np.maximum(0.5 * ORM[..., 1], 0.001), atol=HALF_A_CODE)


def test_a_grey_picture_stands_for_rgb_and_missing_alpha_is_one(write, tmp_path: Path) -> None:
    grey = RNG.random((SIZE, SIZE))
    write_image(tmp_path / "orm.png", grey)
    extensions = {"KHR_materials_pbrSpecularGlossiness": {"specularGlossinessTexture": {"index": 0}}}
    _, svbrdf = read(write(base_material(occlusionTexture={"index": 1})))
    np.testing.assert_allclose(perceptual_from_log_tensor(svbrdf.log_roughness), grey, atol=0.003)
    _, svbrdf = read(write(base_material(extensions=extensions)))
    np.testing.assert_allclose(perceptual_from_log_tensor(svbrdf.log_roughness), 0.001, rtol=1e-3)


def test_a_folder_of_a_scene_and_its_pictures_has_the_scenes_scale(write, tmp_path: Path) -> None:
    """The folder's names once won over the file's factors: slopes four times too steep."""
    write(base_material(normalTexture={"index": 2, "scale": 0.25}))
    for name, new in (("c.png", "Wall_Color.png"), ("orm.png", "Wall_ORM.png"), ("n.png", "Wall_NormalGL.png")):
        (tmp_path / name).rename(tmp_path / new)
        scene = tmp_path / "scene.gltf"
        scene.write_text(scene.read_text().replace(f'"{name}"', f'"{new}"'))
    _, svbrdf = read(tmp_path)
    slope = svbrdf.normal[..., :2] / svbrdf.normal[..., 2:]
    np.testing.assert_allclose(slope, 0.25 * NORMAL[..., :2] / NORMAL[..., 2:], atol=1e-3)
