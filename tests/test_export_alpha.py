"""Alpha in the pictures of every preset, with as much of each level passing the test as of level 0."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest

from brdffit.export.beside import Alpha, materialx, usda
from brdffit.export.coverage import share_above, with_kept_coverage
from brdffit.export.presets import PRESETS, get_preset
from brdffit.files.image_io import read_image, read_mip_exr
from brdffit.pipeline import bake, bake_to_folder
from brdffit.textures.procedural import make_set

#: Share of texels by which a level may differ from level 0.
KEPT = 0.02


@pytest.fixture(scope="module")
def leaves(tmp_path_factory):
    return make_set("leaf-litter", tmp_path_factory.mktemp("sets") / "leaf-litter", 128)


def test_the_tested_share_is_kept(leaves):
    levels = [level.svbrdf for level in bake(leaves, method="lean").lobes.levels]
    kept = [share_above(level.opacity, level.cutoff) for level in with_kept_coverage(levels)]
    for level, share in zip(levels, kept, strict=True):
        assert abs(share - kept[0]) <= max(KEPT, 0.5 / level.opacity.size + 1e-9)


def test_thin_things_that_averaging_loses_are_kept(leaves):
    """Twigs: one texel in seven is there. At level 2 hardly any average passes the test."""
    base = bake(leaves, method="naive", levels=1).lobes.levels[0].svbrdf
    opacity = (np.random.default_rng(0).random(base.size) < 1.0 / 7.0).astype(np.float32)
    base = base.replace(opacity=opacity)
    levels = [base, *(level.svbrdf for level in bake(base, method="naive", keep_level_0=True).lobes.levels[1:6])]
    kept = [share_above(level.opacity, level.cutoff) for level in with_kept_coverage(levels)]
    assert share_above(levels[2].opacity, 0.5) < 0.01
    for level, share in zip(levels, kept, strict=True):
        assert abs(share - kept[0]) <= max(KEPT, 0.5 / level.opacity.size + 1e-9)


def test_opaque_and_blended_levels_stay_as_they_are(leaves):
    levels = [level.svbrdf for level in bake(leaves, method="naive", levels=3).lobes.levels]
    for changes in ({"opacity": None}, {"alpha": "blend"}, {"alpha": ""}):
        for level, same in zip(levels, with_kept_coverage([each.replace(**changes) for each in levels]), strict=True):
            assert same.opacity is None or np.array_equal(same.opacity, level.opacity)


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_stores_alpha_beside_its_colours(leaves, tmp_path, preset):
    if any(picture.pixels == "uastc" for picture in get_preset(preset).pictures):
        pytest.importorskip("alktx2")
    report = bake_to_folder(leaves, tmp_path, method="lean", preset=preset, preview=False)
    pictures = report.manifest["pictures"]
    assert sum("opacity" in each["channels"] for each in pictures.values()) == 1
    alpha = report.manifest["alpha"]
    assert (alpha["mode"], alpha["cutoff"]) == ("mask", 0.5)
    for size, share in zip((4.0**-k * 128**2 for k in range(8)), alpha["tested_share"], strict=True):
        assert abs(share - alpha["tested_share"][0]) <= max(KEPT, 0.5 / size + 1e-4)


def test_alpha_reads_back_from_pictures_and_masters(leaves, tmp_path):
    report = bake_to_folder(leaves, tmp_path, method="lean", preset="plain", preview=False)
    picture = read_image(report.folder / "mips" / "leaf-litter_diffuse.2.png")
    assert picture.channels == ("R", "G", "B", "A")
    share = float(np.mean(picture.pixels[..., 3] >= 0.5))
    assert share == pytest.approx(report.manifest["alpha"]["tested_share"][2], abs=1e-3)
    levels = read_mip_exr(report.folder / "opacity.exr")
    np.testing.assert_allclose(levels[-1], levels[0].mean(), atol=0.01)


def test_a_glb_says_that_it_is_a_mask(leaves, tmp_path):
    pytest.importorskip("alktx2")
    report = bake_to_folder(leaves, tmp_path, method="lean", preset="gltf", preview=False)
    data = next(report.folder.rglob("*.glb")).read_bytes()
    (length,) = struct.unpack_from("<I", data, 12)
    (material,) = json.loads(data[20 : 20 + length])["materials"]
    assert (material["alphaMode"], material["alphaCutoff"], material["doubleSided"]) == ("MASK", 0.5, True)


def test_documents_connect_alpha_to_opacity(leaves, tmp_path):
    folder = bake_to_folder(leaves, tmp_path, method="lean", preset="blender", preview=False).folder / "blender"
    text = (folder / "leaf-litter.usda").read_text()
    assert "float inputs:opacity.connect = </leaf_litter/baseColor.outputs:a>" in text
    assert "float inputs:opacityThreshold = 0.5" in text
    assert "float outputs:a" in text.split('def Shader "baseColor"')[1].split("}")[0]
    materialx = pytest.importorskip("MaterialX", reason="MaterialX is not installed")
    document, library = materialx.createDocument(), materialx.createDocument()
    materialx.readFromXmlFile(document, str(folder / "leaf-litter.mtlx"))
    materialx.loadLibraries(materialx.getDefaultDataLibraryFolders(), materialx.getDefaultDataSearchPath(), library)
    document.setDataLibrary(library) if hasattr(document, "setDataLibrary") else document.importLibrary(library)
    valid, message = document.validate()
    assert valid, message
    graph = document.getNodeGraph("leaf_litter_maps")
    assert graph.getOutput("opacity_out").getConnectedNode().getInput("in").getNodeName() == "cut"
    assert all(node.getNodeDef() is not None for node in graph.getNodes())


def test_a_document_of_what_is_blended_has_no_test():
    assert "opacityThreshold" not in usda("set", "tile", {"baseColor"}, Alpha(None))
    assert "ifgreatereq" not in materialx("set", "tile", {"baseColor"}, Alpha(None))
    assert "opacity" not in usda("set", "tile", set()) + materialx("set", "tile", set())
