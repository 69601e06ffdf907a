"""What a GLB holds besides pictures: a specular colour where it is needed, and the geometry of a glTF that was read."""

import json
import struct
import sys

import numpy as np
import pytest
from container_support import node
from export_support import random_svbrdf

from brdffit import pipeline
from brdffit.errors import OutputError, UnknownNameError
from brdffit.export.compression import MissingEncoderError
from brdffit.export.factors import factors_of
from brdffit.export.geometry import geometry_of
from brdffit.export.metallic import MOST_TINT, reflectance, tinted
from brdffit.files.image_io import write_png
from brdffit.pipeline import bake_to_folder
from brdffit.textures.gltf_files import read_document, view_bytes


def colours(specular, diffuse):
    """A level with these colours, the same lobe and the same normal everywhere."""
    level = random_svbrdf((8, 8), lowest=0.5)
    flat = {"specular": specular, "diffuse": diffuse, "normal": [0, 0, 1], "log_roughness": [-2, -2, 0]}
    return level.replace(**{name: np.broadcast_to(np.float32(each), (8, 8, 3)).copy() for name, each in flat.items()})


def test_a_specular_colour_gives_any_colours_back():
    random = np.random.default_rng(0)
    specular, diffuse = random.uniform(0.0, 0.5, (500, 3)), random.uniform(0.05, 0.5, (500, 3))
    base, metallic, tint = tinted(specular, diffuse)
    assert (metallic < 0.9).mean() > 0.95  # others are metals, whose specular colour is their base colour's
    held = (metallic < 0.9) & (tint < MOST_TINT).all(axis=-1)
    assert held.mean() > 0.95
    np.testing.assert_allclose(reflectance(base, metallic, tint)[held], specular[held], atol=1e-6)
    np.testing.assert_allclose((base * (1.0 - metallic[:, None]))[held], diffuse[held], atol=1e-6)
    for values in (base, metallic, tint / MOST_TINT):
        assert 0.0 <= values.min() and values.max() <= 1.0


def test_colours_of_metallic_roughness_need_no_specular_colour():
    base, metallic = np.float32([0.8, 0.4, 0.1]), np.float32(0.3)
    level = colours(reflectance(base, metallic), base * (1.0 - metallic))
    assert factors_of([level]).specular is None
    assert factors_of([colours([0.12, 0.08, 0.05], [0.3, 0.3, 0.3])]).specular > 1.0


def written(tmp_path, source, **options):
    """The document and the binary chunk of a GLB that was baked of a source, and the report."""
    pytest.importorskip("alktx2", reason="the extra [basis] is not installed")
    report = bake_to_folder(source, tmp_path, method="naive", preset="gltf", preview=False, **options)
    (path,) = report.folder.rglob("*.glb")
    document, binary = read_document(path, path.read_bytes())
    return path, document, binary, report


def test_a_glb_has_the_specular_colour_that_it_needs(tmp_path):
    _, document, _, report = written(tmp_path, colours([0.12, 0.08, 0.05], [0.3, 0.3, 0.3]))
    said = document["materials"][0]["extensions"]["KHR_materials_specular"]
    assert said["specularColorFactor"] == [report.manifest["factors"]["specular"]] * 3
    assert document["images"][said["specularColorTexture"]["index"]]["name"].endswith("specularColor")
    assert "KHR_materials_specular" in document["extensionsUsed"]
    # The diffuse colour and F0 are kept to what codes and blocks can hold.
    assert report.manifest["stored"][0]["appearance_db"] > 25.0


def a_gltf(folder, changes=None):
    """A .gltf of two triangles, one under a node that is moved and wears the material, and one that does not."""
    folder.mkdir()
    write_png(folder / "normal.png", np.full((8, 8, 3), (128, 128, 255), np.uint8))
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    data = corners.tobytes() + np.array([[0, 0], [1, 0], [0, 1]], "<f4").tobytes()
    data += np.array([0, 1, 2], "<u2").tobytes()
    (folder / "set.bin").write_bytes(data)
    attributes = {"POSITION": 0, "TEXCOORD_1": 1, "TEXCOORD_0": 1}
    place = {"texCoord": 1, "extensions": {"KHR_texture_transform": {"scale": [2, 2]}}}
    document = {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_texture_transform"],
        "buffers": [{"uri": "set.bin", "byteLength": len(data)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36, "target": 34962},
            {"buffer": 0, "byteOffset": 36, "byteLength": 24, "target": 34962},
            {"buffer": 0, "byteOffset": 60, "byteLength": 6, "target": 34963},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]},
            {"name": "worn", "primitives": [{"attributes": attributes, "indices": 2, "material": 1}]},
        ],
        "nodes": [{"children": [1, 2], "translation": [1, 2, 3]}, {"mesh": 0}, {"mesh": 1, "scale": [2, 2, 2]}],
        "scenes": [{"nodes": [0]}],
        "images": [{"uri": "normal.png"}],
        "textures": [{"source": 0}],
        "materials": [{"name": "other"}, {"name": "bumps", "normalTexture": {"index": 0, **place}}],
    }
    for part, value in (changes or {}).items():
        document[part] = value
    (folder / "set.gltf").write_text(json.dumps(document))
    return folder / "set.gltf"


def test_a_glb_shows_the_geometry_that_was_read(tmp_path):
    path, document, binary, _ = written(tmp_path / "out", a_gltf(tmp_path / "in"))
    (mesh,) = document["meshes"]
    assert mesh["name"] == "worn"
    leaf, root = document["nodes"]
    assert (root["translation"], root["children"], leaf["scale"]) == ([1, 2, 3], [0], [2, 2, 2])
    assert document["scenes"] == [{"nodes": [1]}]
    (primitive,) = mesh["primitives"]
    accessor = document["accessors"][primitive["attributes"]["POSITION"]]
    corners = struct.unpack("<9f", view_bytes(path, document, binary, accessor["bufferView"]))
    assert corners == (0, 0, 0, 1, 0, 0, 0, 1, 0)
    reference = document["materials"][0]["normalTexture"]
    assert reference["texCoord"] == 1
    assert reference["extensions"]["KHR_texture_transform"]["scale"] == [2, 2]
    assert "KHR_texture_transform" in document["extensionsRequired"]
    result = node("validate.mjs", path)
    assert result.returncode == 0 and json.loads(result.stdout)["errors"] == 0, result.stdout


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}]}, "no mesh wears"),
        ({"scenes": [{"nodes": []}]}, "does not show"),
        ({"accessors": []}, "damaged"),
        ({"nodes": [{"mesh": 1, "children": [0]}]}, "damaged"),
        ({"bufferViews": [{"buffer": 0, "byteLength": 36, "extensions": {"EXT_meshopt_compression": {}}}]}, "compress"),
    ],
)
def test_a_rectangle_stands_for_geometry_that_cannot_be_copied(tmp_path, changes, why):
    geometry, said = geometry_of(a_gltf(tmp_path / "in", changes), 1)
    assert geometry is None and why in said


def test_why_a_rectangle_is_shown_is_noted(tmp_path):
    source = a_gltf(tmp_path / "in", {"accessors": []})
    _, document, _, report = written(tmp_path / "out", source)
    assert any("shows a rectangle" in note and "damaged" in note for note in report.notes)
    assert len(document["accessors"]) == 5


def test_a_listener_is_told_of_each_picture(tmp_path):
    class Listener:
        def __init__(self):
            self.phases = []

        def phase(self, name):
            self.phases.append(name)

        def __call__(self, *level):
            pass

    listener = Listener()
    report = bake_to_folder(colours([0.1] * 3, [0.3] * 3), tmp_path, method="naive", preview=False, progress=listener)
    pictures = 4 + len(report.manifest["pictures"])
    told = [name for name in listener.phases if name.endswith("written")]
    assert len(told) == pictures and told[-1] == f"measuring and writing: {pictures} of {pictures} pictures written"


def test_what_a_preset_lacks_is_told_before_the_bake(tmp_path, monkeypatch):
    """The encoder, by the extra that brings it; and sides that the format cannot hold."""

    def bakes(*args):
        raise AssertionError("baked")

    monkeypatch.setattr(pipeline, "run", bakes)
    odd = random_svbrdf((6, 10))
    for preset in ("gltf", "unity"):
        with pytest.raises(OutputError, match="multiples of 4 .* found 10x6"):
            bake_to_folder(odd, tmp_path / "out", preset=preset)
    monkeypatch.setitem(sys.modules, "alktx2", None)
    for preset in ("gltf", "filament"):
        with pytest.raises(MissingEncoderError, match=rf"'{preset}' needs .* pip install 'brdffit\[basis\]'"):
            bake_to_folder(odd, tmp_path / "out", preset=preset)
    with pytest.raises(UnknownNameError, match="did you mean 'gltf'"):
        bake_to_folder(odd, tmp_path / "out", preset="gltff")
    assert not (tmp_path / "out").exists()
