"""Others' programs load what we write: three.js, PlayCanvas and Filament show our own levels, one colour each."""

import json
import shutil

import numpy as np
import pytest
from container_support import node
from export_support import averaged_pyramid, random_svbrdf

from brdffit.export.factors import Factors
from brdffit.export.manifest import build_manifest
from brdffit.export.presets import PRESETS
from brdffit.export.writing import write_baked
from brdffit.methods import Baked
from brdffit.svbrdf import level_sizes

#: What a reader may be off, in codes of 255: blocks and their transcoding.
CODES = 6
SIZE = (64, 64)


def coloured_levels():
    """A pyramid of metal whose levels have one colour, one normal and one lobe each, no two levels alike."""
    pyramid = averaged_pyramid(random_svbrdf(SIZE), lobe="anisotropic")
    random = np.random.default_rng(3)
    for level in pyramid.levels:
        slope = random.uniform(-0.05, 0.05, 2)
        normal = np.array([*slope, 1.0]) / np.sqrt(1.0 + slope @ slope)
        mean = 4.0 * np.log(random.uniform(0.3, 0.6))
        log = np.array([mean + 0.3, mean - 0.3, random.uniform(-0.2, 0.2)])
        flat = {
            "normal": normal, "log_roughness": log, "specular": random.uniform(0.2, 0.9, 3), "diffuse": np.zeros(3)
        }  # fmt: skip
        level.svbrdf = level.svbrdf.replace(
            **{name: np.broadcast_to(np.float32(value), (*level.svbrdf.size, 3)).copy() for name, value in flat.items()}
        )
    return pyramid


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    """What three.js reads of the presets `gltf` and `three`, and the levels that were written."""
    if shutil.which("chromium") is None:
        pytest.skip("Chromium is not installed")
    pytest.importorskip("alktx2", reason="the extra [basis] is not installed")
    pyramid, folder = coloured_levels(), tmp_path_factory.mktemp("clients")
    baked, factors = Baked.of_lobes(pyramid), Factors()
    samples = folder / "samples"
    samples.mkdir()
    for name in ("gltf", "three"):
        record = write_baked(baked, folder / name, name="set", preset=name, manifest=build_manifest(baked, name="set"))
        if name == "gltf":
            factors = Factors(**record["factors"])
        for file in (folder / name / name).iterdir():
            shutil.copy(file, samples)
    files = ["set.glb", *(f"set_{picture.role}.ktx2" for picture in PRESETS["three"].pictures)]
    result = node("browser.mjs", samples, "three.html", "files=" + ",".join(files))
    assert result.returncode == 0, result.stderr
    found = json.loads(result.stdout)
    assert "error" not in found and not found["console"], found
    result = node("browser.mjs", samples, "playcanvas.html", "file=set.glb")
    assert result.returncode == 0, result.stderr
    found["playcanvas"] = json.loads(result.stdout)
    result = node("browser.mjs", samples, "filament.html", "file=set.glb")
    assert result.returncode == 0, result.stderr
    found["filament"] = json.loads(result.stdout)
    return found, [level.svbrdf for level in pyramid.levels], factors


def assert_levels(texture, expected):
    """``expected``: (levels, channels) in [0, 1]."""
    assert texture["error"] == 0
    assert len(texture["levels"]) == len(level_sizes(SIZE)) == len(expected)
    codes = np.array(texture["levels"], float)[:, : np.shape(expected)[1]]
    np.testing.assert_allclose(codes, 255.0 * np.asarray(expected), atol=CODES)


def normals_of(levels, scale):
    normal = np.array([level.normal[0, 0] for level in levels]) / [scale, scale, 1.0]
    return 0.5 + 0.5 * normal / np.linalg.norm(normal, axis=1, keepdims=True)


def test_three_shows_our_levels_of_a_glb(seen):
    found, levels, factors = seen
    glb = found["set.glb"]
    assert glb["type"] == "MeshPhysicalMaterial"
    # The material multiplies what its pictures were divided by.
    assert glb["normalScale"] == pytest.approx(factors.normal)
    assert glb["roughness"] == pytest.approx(factors.roughness)
    assert glb["anisotropy"] == pytest.approx(factors.strength)
    assert glb["map"]["srgb"] and not glb["normalMap"]["srgb"]
    # Sampled, an sRGB texture is linear.
    assert_levels(glb["map"], [level.specular[0, 0] for level in levels])
    assert_levels(glb["normalMap"], normals_of(levels, factors.normal))


def test_three_shows_our_levels_of_ktx2_files(seen):
    found, levels, _ = seen
    assert_levels(found["set_baseColor.ktx2"], [level.specular[0, 0] for level in levels])
    assert_levels(found["set_normal.ktx2"], normals_of(levels, 1.0)[:, :2])
    packed = np.array(found["set_occlusionRoughnessMetallic.ktx2"]["levels"], float)
    assert (np.abs(packed[:, [0, 2]] - 255.0) <= CODES).all()


def test_playcanvas_shows_our_levels_of_a_glb(seen):
    found, levels, factors = seen
    shown = found["playcanvas"]
    assert "error" not in shown and not shown["console"], shown
    assert shown["anisotropy"] == pytest.approx(factors.strength)
    for name, expected in (
        ("diffuseMap", [level.specular[0, 0] for level in levels]), ("normalMap", normals_of(levels, factors.normal)),
    ):  # fmt: skip
        assert_levels({"error": 0, **shown[name]}, expected)


def test_filament_shows_our_levels_of_a_glb(seen):
    found, levels, factors = seen
    shown = found["filament"]
    assert "error" not in shown and not shown["console"], shown
    textures = shown["textures"]
    assert len(textures) == 4  # base colour, normal, occlusion with roughness and metallic, anisotropy
    # It tells no names, and transcodes in any order: each map is one of its textures.
    for expected in ([level.specular[0, 0] for level in levels], normals_of(levels, factors.normal)):
        wanted = 255.0 * np.asarray(expected)
        apart = [np.abs(np.array(each["levels"], float)[:, :3] - wanted).max() for each in textures]
        assert min(apart) <= CODES
