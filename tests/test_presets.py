"""Files of every preset: read back by others and by us, every level, on sizes that are no powers of two."""

import json
import struct

import numpy as np
import pytest
from container_support import node, read_dds, read_ktx2
from export_support import averaged_pyramid, random_svbrdf

from brdffit.export.decompression import decode_blocks
from brdffit.export.judging import degrees_between, signal_to_noise
from brdffit.export.manifest import build_manifest
from brdffit.export.presets import PRESETS
from brdffit.export.writing import write_baked
from brdffit.files.image_io import read_mip_exr
from brdffit.methods import Baked
from brdffit.svbrdf import level_sizes

SIZE = (24, 40)


def random_result(name):
    occlusion = np.random.default_rng(7).random(SIZE, dtype=np.float32)
    pyramid = averaged_pyramid(random_svbrdf(SIZE, slope=0.05, occlusion=occlusion), lobe=PRESETS[name].lobe)
    for level in pyramid.levels:
        level.svbrdf = level.svbrdf.replace(occlusion=np.full(level.svbrdf.size, 0.5, np.float32))
    return Baked.of_lobes(pyramid)


def write_preset(folder, name, **options):
    baked = random_result(name)
    return write_baked(baked, folder, name="set", preset=name, manifest=build_manifest(baked, name="set"), **options)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Folder and manifest of each preset, written once."""
    made = {}

    def write(name, **options):
        key = name, *options.items()
        if key not in made:
            if any(picture.pixels == "uastc" for picture in PRESETS[name].pictures):
                pytest.importorskip("alktx2", reason="the extra [basis] is not installed")
            folder = tmp_path_factory.mktemp("presets") / "set"
            made[key] = folder, write_preset(folder, name, **options)
        return made[key]

    return write


def glb_parts(data):
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    json_bytes, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    document = json.loads(data[20 : 20 + json_bytes])
    binary_bytes, kind = struct.unpack_from("<I4s", data, 20 + json_bytes)
    assert (kind, binary_bytes, len(data)) == (
        b"BIN\0",
        document["buffers"][0]["byteLength"],
        28 + json_bytes + binary_bytes,
    )
    return document, data[28 + json_bytes :]


@pytest.mark.parametrize("name", [name for name, preset in PRESETS.items() if preset.container in ("dds", "ktx2")])
@pytest.mark.parametrize("bits", [8, 16])
def test_containers_hold_every_level(written, name, bits):
    preset = PRESETS[name]
    if bits == 16 and name == "filament":
        pytest.skip("UASTC has 8 bits")
    folder, record = written(name, **({"bits": bits} if bits == 16 else {}))
    read = read_dds if preset.container == "dds" else read_ktx2
    for picture in preset.pictures:
        file = folder / name / f"set_{picture.role}.{preset.container}"
        pixels, size, levels = read(file.read_bytes())
        assert size == SIZE
        assert pixels.name == record["pictures"][picture.role]["pixels"]
        assert len(levels) == len(level_sizes(SIZE))
        assert pixels.srgb == (picture.srgb and bits == 8)
    assert record["files"].keys() >= {f"{name}/set_{picture.role}.{preset.container}" for picture in preset.pictures}


@pytest.mark.parametrize("name", PRESETS)
def test_what_is_stored_is_near_what_was_baked(written, name):
    """Smooth normals, but lobes turn at random from texel to texel: the hardest case for blocks."""
    _, record = written(name)
    for figures in record["stored"][:3]:
        assert figures["appearance_db"] > 10
        assert figures["normal_degrees"] < 3
    if PRESETS[name].container in ("png", "exr"):
        assert "compression_lobe_db" not in record["stored"][0]
        assert record["stored"][0]["normal_degrees"] < 0.3


def test_uncompressed_dds_is_exact_but_for_its_codes(written):
    _, record = written("unreal")
    for figures in record["stored"]:
        assert figures["compression_lobe_db"] == 99.0
        assert figures["compression_normal_degrees"] == 0.0
    assert all(value == 99.0 for value in record["pictures"]["ORM"]["psnr_db"])


def test_the_manifest_says_what_the_files_hold(written):
    """The figures of the manifest are those of the file on the disk, decoded here."""
    folder, record = written("godot")
    pixels, size, levels = read_dds((folder / "godot" / "set_orm.dds").read_bytes())
    seen = decode_blocks(pixels, size, levels[0])
    assert seen.shape == (*SIZE, 4)
    # Occlusion is the same everywhere.
    np.testing.assert_allclose(seen[..., 0], 0.5, atol=6 / 255)
    assert record["preset"]["note"]


def test_a_glb_holds_the_levels_and_names_its_extensions(written):
    folder, _ = written("gltf")
    document, binary = glb_parts((folder / "gltf" / "set.glb").read_bytes())
    assert document["extensionsRequired"] == ["KHR_texture_basisu"]
    used = ["KHR_materials_anisotropy", "KHR_materials_specular", "KHR_texture_basisu"]
    assert document["extensionsUsed"] == used
    assert [image["name"] for image in document["images"]] == [
        "set_baseColor", "set_normal", "set_occlusionRoughnessMetallic", "set_anisotropy",
        "set_specularColor",
    ]  # fmt: skip
    for image in document["images"]:
        view = document["bufferViews"][image["bufferView"]]
        assert view["byteOffset"] % 4 == 0
        pixels, size, levels = read_ktx2(binary[view["byteOffset"] :][: view["byteLength"]])
        assert (size, len(levels)) == (SIZE, 6)
        assert pixels.name == ("uastc_srgb" if image["name"].endswith("Color") else "uastc")


def test_the_gltf_validator_finds_no_error(written):
    folder, _ = written("gltf")
    result = node("validate.mjs", folder / "gltf" / "set.glb")
    report = json.loads(result.stdout)
    assert report["errors"] == 0, report
    # It knows neither image/ktx2 nor KHR_texture_basisu, so that images look unused to it.
    assert {code for code, *_ in report["messages"]} <= {
        "VALUE_NOT_IN_LIST", "UNSUPPORTED_EXTENSION", "IMAGE_UNRECOGNIZED_FORMAT", "UNUSED_OBJECT",
    }  # fmt: skip


def test_ktx_parse_reads_what_presets_write(written):
    files = [file for name in ("three", "filament") for file in sorted((written(name)[0] / name).glob("*.ktx2"))]
    result = node("parse.mjs", *files)
    assert result.returncode == 0, result.stdout + result.stderr


def test_unity_is_told_which_pictures_are_srgb(written):
    folder, _ = written("unity")
    said = {file.name: "sRGBTexture: 1" in file.read_text() for file in (folder / "unity").glob("*.meta")}
    assert said == {
        "set_BaseMap.dds.meta": True, "set_Normal.dds.meta": False, "set_MaskMap.dds.meta": False,
        "set_TangentMap.dds.meta": False, "set_AnisotropyMap.dds.meta": False,
    }  # fmt: skip
    identifiers = {file.read_text().split("guid: ")[1][:32] for file in (folder / "unity").glob("*.meta")}
    assert len(identifiers) == 5


def test_blender_gets_mip_mapped_exr_files(written):
    folder, _ = written("blender")
    for role in ("baseColor", "normal", "roughness", "metallic", "anisotropic", "direction"):
        levels = read_mip_exr(folder / "blender" / f"set_{role}.exr")
        assert [level.shape[:2] for level in levels] == level_sizes(SIZE)


def test_the_materialx_document_is_valid(written):
    materialx = pytest.importorskip("MaterialX", reason="MaterialX is not installed")
    folder, _ = written("blender")
    document = materialx.createDocument()
    materialx.readFromXmlFile(document, str(folder / "blender" / "set.mtlx"))
    library = materialx.createDocument()
    materialx.loadLibraries(materialx.getDefaultDataLibraryFolders(), materialx.getDefaultDataSearchPath(), library)
    document.setDataLibrary(library) if hasattr(document, "setDataLibrary") else document.importLibrary(library)
    valid, message = document.validate()
    assert valid, message
    files = {node.getInput("file").getValueString() for node in document.getNodeGraph("set_maps").getNodes("image")}
    assert files == {file.name for file in (folder / "blender").glob("*.exr")}


def test_the_usd_document_names_files_that_are_there(written):
    folder, _ = written("blender")
    text = (folder / "blender" / "set.usda").read_text()
    assert text.count("{") == text.count("}")
    named = {part.split("@")[0] for part in text.split("@./")[1:]}
    assert named == {f"set_{role}.exr" for role in ("baseColor", "normal", "roughness", "metallic")}
    for line in text.splitlines():
        if ".connect = <" in line:
            place, output = line.split(".connect = <")[1].rstrip(">").rsplit(".", 1)
            name = place.rsplit("/", 1)[1]
            block = text.split(f'def Shader "{name}"')[1].split("}")[0]
            assert output in block


def test_the_same_bytes_again(tmp_path, written):
    for name in ("three", "unity"):
        _, record = written(name)
        again = write_preset(tmp_path / name, name)
        assert again["stable_digest"] == record["stable_digest"]


def test_snr_knows_equal_lobes_and_follows_the_size_of_an_error():
    svbrdf = random_svbrdf((8, 8), lowest=0.4)
    assert signal_to_noise(svbrdf, svbrdf) == 99.0
    # An amplitude that is a tenth too high everywhere is 20 dB, whatever the lobe.
    louder = svbrdf.replace(specular=np.zeros_like(svbrdf.specular), diffuse=0.5 * np.ones_like(svbrdf.diffuse))
    quieter = louder.replace(diffuse=np.float32(0.45) * np.ones_like(svbrdf.diffuse))
    assert signal_to_noise(louder, quieter) == pytest.approx(20.0, abs=0.01)
    # Ten times the change of roughness loses 20 dB while the change is small.
    found = [
        signal_to_noise(svbrdf, svbrdf.replace(log_roughness=svbrdf.log_roughness + np.float32([d, d, 0])), True)
        for d in (0.003, 0.03)
    ]
    assert found[0] - found[1] == pytest.approx(20.0, abs=1.0)


def test_degrees_between_small_angles():
    angle = np.radians(np.array([0.0, 1e-3, 1.0, 90.0, 180.0]))
    one = np.tile([0.0, 0.0, 1.0], (5, 1))
    other = np.stack([np.sin(angle), np.zeros(5), np.cos(angle)], axis=-1)
    np.testing.assert_allclose(degrees_between(one, other), np.degrees(angle), rtol=1e-6)
