"""glTF and MaterialX as entry points: the same maps as in a folder give the same SVBRDF."""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from pictures import bumps, encoded, write_image

from brdffit.errors import InputError
from brdffit.roughness import perceptual_from_log_tensor
from brdffit.svbrdf import Svbrdf
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.reading import read_texture_set

HEIGHT, NORMAL = bumps(12, 16)
RNG = np.random.default_rng(0)
ORM = RNG.random((12, 16, 3))
COLOR = RNG.random((12, 16, 3))
MATERIAL = {
    "name": "wall",
    "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicRoughnessTexture": {"index": 1}},
    "normalTexture": {"index": 2},
    "occlusionTexture": {"index": 1},
}


@pytest.fixture
def maps(tmp_path: Path) -> dict[str, Path]:
    folder = tmp_path / "maps"
    return {
        "color": write_image(folder / "one.png", COLOR),
        "orm": write_image(folder / "two three.png", ORM),
        "normal": write_image(folder / "four.png", encoded(NORMAL), "uint16"),
    }


@pytest.fixture
def expected(maps: dict[str, Path]) -> Svbrdf:
    folder = maps["color"].parent
    roles = {"base_color": "one.png", "orm": "two three.png", "normal": "four.png"}
    return to_svbrdf(read_texture_set(folder, roles=roles, normal_y="gl"))


def document(images: list[dict], material: dict = MATERIAL, **more) -> dict:
    textures = [{"source": i} for i in range(len(images))]
    return {"asset": {"version": "2.0"}, "images": images, "textures": textures, "materials": [material], **more}


def same(one: Svbrdf, other: Svbrdf) -> None:
    assert one.arrays().keys() == other.arrays().keys()
    for name, array in one.arrays().items():
        np.testing.assert_array_equal(array, other.arrays()[name], err_msg=name)


def as_external(maps: dict[str, Path], folder: Path) -> Path:
    uris = [f"../maps/{path.name.replace(' ', '%20')}" for path in maps.values()]
    path = folder / "wall.gltf"
    path.write_text(json.dumps(document([{"uri": uri} for uri in uris])))
    return path


def as_data_uris(maps: dict[str, Path], folder: Path) -> Path:
    codes = [base64.b64encode(path.read_bytes()).decode() for path in maps.values()]
    path = folder / "wall.gltf"
    path.write_text(json.dumps(document([{"uri": f"data:image/png;base64,{code}"} for code in codes])))
    return path


def as_buffer(maps: dict[str, Path], folder: Path) -> Path:
    blobs = [path.read_bytes() for path in maps.values()]
    (folder / "wall.bin").write_bytes(b"".join(blobs))
    path = folder / "wall.gltf"
    path.write_text(json.dumps(_in_buffer(blobs, {"uri": "wall.bin", "byteLength": sum(map(len, blobs))})))
    return path


def as_glb(maps: dict[str, Path], folder: Path) -> Path:
    blobs = [path.read_bytes() for path in maps.values()]
    text = json.dumps(_in_buffer(blobs, {"byteLength": sum(map(len, blobs))})).encode()
    text += b" " * (-len(text) % 4)
    binary = b"".join(blobs) + b"\0" * (-sum(map(len, blobs)) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path = folder / "wall.glb"
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


def _in_buffer(blobs: list[bytes], buffer: dict) -> dict:
    starts = np.cumsum([0, *map(len, blobs)])
    views = [{"buffer": 0, "byteOffset": int(s), "byteLength": len(b)} for s, b in zip(starts, blobs, strict=False)]
    images = [{"bufferView": i, "mimeType": "image/png"} for i in range(len(blobs))]
    return document(images, bufferViews=views, buffers=[buffer])


def as_materialx(maps: dict[str, Path], folder: Path) -> Path:
    path = folder / "wall.mtlx"
    path.write_text(
        f"""<?xml version="1.0"?>
<materialx version="1.38" fileprefix="../maps/">
  <nodegraph name="graph">
    <tiledimage name="orm" type="vector3">
      <input name="file" type="filename" value="{maps["orm"].name}"/>
    </tiledimage>
    <extract name="rough" type="float">
      <input name="in" type="vector3" nodename="orm"/><input name="index" type="integer" value="1"/>
    </extract>
    <separate3 name="apart" type="multioutput"><input name="in" type="vector3" nodename="orm"/></separate3>
    <image name="bumps" type="vector3"><input name="file" type="filename" value="{maps["normal"].name}"/></image>
    <normalmap name="turn" type="vector3"><input name="in" type="vector3" nodename="bumps"/></normalmap>
    <output name="rough_out" type="float" nodename="rough"/>
    <output name="normal_out" type="vector3" nodename="turn"/>
    <output name="metal_out" type="float" nodename="apart" output="outz"/>
    <output name="ao_out" type="float" nodename="apart" output="outx"/>
  </nodegraph>
  <image name="paint" type="color3"><input name="file" type="filename" value="{maps["color"].name}"/></image>
  <gltf_pbr name="shader" type="surfaceshader">
    <input name="base_color" type="color3" nodename="paint"/>
    <input name="roughness" type="float" nodegraph="graph" output="rough_out"/>
    <input name="metallic" type="float" nodegraph="graph" output="metal_out"/>
    <input name="normal" type="vector3" nodegraph="graph" output="normal_out"/>
    <input name="occlusion" type="float" nodegraph="graph" output="ao_out"/>
  </gltf_pbr>
</materialx>"""
    )
    return path


ENTRIES = (as_external, as_data_uris, as_buffer, as_glb, as_materialx)


@pytest.mark.parametrize("entry", ENTRIES)
def test_every_entry_point_gives_the_same_svbrdf(entry, maps, expected, tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    texture_set = read_texture_set(entry(maps, folder))
    assert texture_set.name == "wall"
    same(to_svbrdf(texture_set), expected)
    assert any(path.stem == "wall" for path, _ in texture_set.inputs)


def test_a_folder_with_one_scene_and_no_named_maps_is_read_through_it(maps, expected, tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    as_glb(maps, folder)
    texture_set = read_texture_set(folder)
    assert texture_set.name == "scene"
    same(to_svbrdf(texture_set), expected)


def test_a_folder_with_a_material_file_is_read_by_it(maps, expected, tmp_path: Path) -> None:
    """Pictures that the file does not use are listed; a file that cannot be read gives way to names, and is named."""
    folder = tmp_path / "scene"
    stray = write_image(folder / "brick_NormalGL.png", encoded(NORMAL))
    write_image(folder / "brick_Height.png", HEIGHT - HEIGHT.min())
    file = as_materialx(maps, folder)
    texture_set = read_texture_set(folder)
    assert texture_set.maps["normal"].path.resolve() == maps["normal"].resolve()
    assert texture_set.ignored == [stray.name]
    assert any("Maps and factors are those of 'wall.mtlx'" in note for note in texture_set.notes)
    assert any("'brick_Height.png' is not in 'wall.mtlx': it is read as height" in note for note in texture_set.notes)
    maps["normal"].unlink()
    texture_set = read_texture_set(folder)
    assert texture_set.maps["normal"].path == stray
    assert any("names files that are not there (four.png)" in note for note in texture_set.notes)
    file.write_text("<materialx")
    assert any("'wall.mtlx' is not read" in note for note in read_texture_set(folder).notes)


def test_factors_multiply_or_stand_for_maps(maps, tmp_path: Path) -> None:
    material = {
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.5, 0.25, 1.0, 1.0],
            "roughnessFactor": 0.4,
            "metallicFactor": 0.0,
        },
        "normalTexture": {"index": 2, "scale": 0.5},
    }
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps(document([{"uri": f"maps/{p.name}"} for p in maps.values()], material)))
    svbrdf = to_svbrdf(read_texture_set(path))
    np.testing.assert_allclose(svbrdf.diffuse, np.broadcast_to([0.5, 0.25, 1.0], (12, 16, 3)))
    np.testing.assert_allclose(svbrdf.specular, 0.04, atol=1e-7)
    np.testing.assert_allclose(perceptual_from_log_tensor(svbrdf.log_roughness), 0.4, rtol=1e-5)
    slope = svbrdf.normal[..., :2] / svbrdf.normal[..., 2:]
    np.testing.assert_allclose(slope, 0.5 * NORMAL[..., :2] / NORMAL[..., 2:], atol=2e-4)


def test_specular_glossiness_is_read(maps, tmp_path: Path) -> None:
    spec = RNG.random((12, 16, 4))
    write_image(maps["color"].parent / "spec.png", spec)
    extension = {"specularGlossinessTexture": {"index": 3}, "diffuseTexture": {"index": 0}, "glossinessFactor": 0.5}
    material = {"extensions": {"KHR_materials_pbrSpecularGlossiness": extension}, "normalTexture": {"index": 2}}
    path = tmp_path / "a.gltf"
    names = [p.name for p in maps.values()] + ["spec.png"]
    path.write_text(json.dumps(document([{"uri": f"maps/{name}"} for name in names], material)))
    svbrdf = to_svbrdf(read_texture_set(path))
    gloss = np.rint(spec[..., 3] * 255) / 255
    np.testing.assert_allclose(perceptual_from_log_tensor(svbrdf.log_roughness), 1.0 - 0.5 * gloss, rtol=1e-5)
    assert np.corrcoef(svbrdf.specular[..., 0].ravel(), spec[..., 0].ravel())[0, 1] > 0.9


def test_the_material_with_a_normal_map_is_read_and_the_others_told(maps, tmp_path: Path) -> None:
    scene = document([{"uri": f"maps/{p.name}"} for p in maps.values()])
    scene["materials"].insert(0, {"name": "glass"})
    (tmp_path / "a.gltf").write_text(json.dumps(scene))
    texture_set = read_texture_set(tmp_path / "a.gltf")
    assert "normal" in texture_set.maps
    assert any("has 2 materials: 'wall' is read" in note for note in texture_set.notes)


def test_a_materialx_file_of_directx_normals(maps, tmp_path: Path) -> None:
    write_image(maps["normal"].parent / "w_NormalDX.png", encoded(NORMAL, "dx"), "uint16")
    maps["normal"] = maps["normal"].parent / "w_NormalDX.png"
    folder = tmp_path / "scene"
    folder.mkdir()
    texture_set = read_texture_set(as_materialx(maps, folder))
    assert texture_set.normal_y == "dx"
    np.testing.assert_allclose(to_svbrdf(texture_set).normal, NORMAL, atol=1e-4)


def _truncated_glb(maps, folder: Path) -> Path:
    path = as_glb(maps, folder)
    path.write_bytes(path.read_bytes()[:-500])
    return path


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.gltf", b"", r"is empty \(0 bytes\), expected a \.gltf file"),
        ("a.gltf", b"{", "is no glTF file: its JSON cannot be read"),
        ("a.gltf", b"[]", "is no glTF file"),
        ("a.gltf", b"{}", "has no materials, expected one with a normal texture"),
        (
            "a.gltf",
            json.dumps(document([])).encode(),
            "is a damaged glTF file: its material refers to something missing",
        ),
        ("a.gltf", json.dumps(document([{"uri": "x.png"}] * 3)).encode(), r"x\.png' does not exist"),
        ("a.gltf", json.dumps(document([{"uri": "data:,%%"}] * 3)).encode(), "data URI that is not base64"),
        (
            "a.gltf",
            json.dumps(document([{"mimeType": "image/ktx2", "uri": "x.ktx2"}] * 3)).encode(),
            "as KTX2, expected PNG",
        ),
        ("a.gltf", json.dumps(document([], {"name": "bare"})).encode(), "no normal map and no height map"),
        ("a.glb", b"glTF", "is truncated"),
        ("a.glb", struct.pack("<4sII", b"glTF", 1, 12), "of version 1, expected version 2"),
        ("a.mtlx", b"<materialx", "is no MaterialX file: its XML cannot be read"),
        ("a.mtlx", b"<svg/>", "has no <materialx> element, expected a MaterialX"),
        ("a.mtlx", b"<materialx/>", "has no surface shader of standard_surface"),
        ("a.mtlx", b"<!DOCTYPE a [<!ENTITY b 'c'>]><materialx/>", "declares a document type"),
    ],
)
def test_what_is_no_material_is_told(tmp_path: Path, name: str, content: bytes, sentence: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=sentence):
        read_texture_set(tmp_path / name)


def test_a_truncated_glb_is_told(maps, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"wall\.glb' is truncated"):
        read_texture_set(_truncated_glb(maps, tmp_path))
