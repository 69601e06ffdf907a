"""What is a set of a library, where it is written, and by which options it is baked."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from library_support import write_maps

from brdffit.errors import InputError, UnknownNameError
from brdffit.files.image_io import write_png
from brdffit.library.bake import open_set
from brdffit.library.discovery import find_sets
from brdffit.library.run import run_library
from brdffit.library.settings import read_settings, split_options
from brdffit.library.task import Found, Task
from brdffit.pipeline import bake_to_folder


def keys(root, **more):
    return [found.key for found in find_sets(root, **more)]


def maps_of(found, **reading):
    """File and channel by role, as a worker would read them."""
    settings = {"roles": None, "normal_y": "gl", "wrap": "tile", "height_scale": None, "denoise_normals": False}
    task = Task(found, "", settings | reading, "naive", "plain", 8, "good", {}, "")
    return {role: named.path.name + named.channel for role, named in open_set(task).maps.items()}


def test_sets_of_all_conventions_are_found_where_they_lie(tmp_path):
    write_maps(tmp_path / "metal" / "plates", names="Metal012_1K_{}.jpg".replace(".jpg", ".png"))
    write_maps(tmp_path / "wood", names="{}.png", roles=("normal", "albedo", "roughness"))
    write_maps(tmp_path / "wood" / "deeper" / "oak", names="oak_{}_2k.png", roles=("nor_gl", "diff", "rough"))
    write_maps(tmp_path / "unreal", names="T_Rock_{}.png", roles=("N", "D"))
    (tmp_path / "empty").mkdir()
    (tmp_path / "README.txt").write_text("no texture")
    assert keys(tmp_path) == ["metal/plates", "unreal", "wood", "wood.deeper.oak"]


def test_a_set_within_a_set_is_written_beside_it(tmp_path):
    """A set's folder is replaced as a whole: nothing may lie in it."""
    write_maps(tmp_path / "a" / "oak")
    write_maps(tmp_path / "a" / "oak" / "old")
    write_maps(tmp_path / "a" / "oaken")
    found = keys(tmp_path)
    assert found == ["a/oak", "a/oak.old", "a/oaken"]
    assert not [one for one in found for other in found if one.startswith(other + "/")]


def test_the_root_may_be_a_set_itself(tmp_path):
    write_maps(tmp_path / "lib")
    write_maps(tmp_path / "lib" / "more")
    assert keys(tmp_path / "lib") == ["lib", "more"]


def test_several_materials_in_one_folder_keep_to_their_own_maps(tmp_path):
    write_maps(tmp_path / "mixed", names="Brick_{}.png", roles=("Normal", "Color", "Roughness", "AO"))
    write_maps(tmp_path / "mixed", names="Wood_1K_{}.png", roles=("Normal", "Color", "Roughness"))
    write_maps(tmp_path / "mixed", names="T_Tile_{}.png", roles=("N", "D"))
    write_png(tmp_path / "mixed" / "overview.png", np.zeros((4, 4, 3), np.uint8))
    found = {each.key: maps_of(each) for each in find_sets(tmp_path)}
    assert found == {
        "mixed/Brick": {
            "base_color": "Brick_Color.png", "normal": "Brick_Normal.png", "roughness": "Brick_Roughness.png",
            "ao": "Brick_AO.png",
        },
        "mixed/T_Tile": {"base_color": "T_Tile_D.png", "normal": "T_Tile_N.png"},
        "mixed/Wood_1K": {
            "base_color": "Wood_1K_Color.png", "normal": "Wood_1K_Normal.png", "roughness": "Wood_1K_Roughness.png",
        },
    }  # fmt: skip


def test_a_material_of_a_mixed_folder_without_a_surface_is_named(tmp_path):
    write_maps(tmp_path / "mixed", names="A_{}.png")
    write_maps(tmp_path / "mixed", names="B_{}.png")
    write_maps(tmp_path / "mixed", names="C_{}.png", roles=("Color", "Roughness"))
    *_, bad = find_sets(tmp_path)
    assert bad.key == "mixed/C"
    with pytest.raises(InputError, match=r"no normal map and no height map for 'C'.*C_Color.png"):
        maps_of(bad)


def test_two_maps_that_claim_one_role_are_no_two_materials(tmp_path):
    """One normal map, colours of two names: the reader's own sentence tells what to do, as for a single bake."""
    write_maps(tmp_path / "set", names="A_{}.png")
    write_maps(tmp_path / "set", names="B_{}.png", roles=("Color",))
    (found,) = find_sets(tmp_path)
    with pytest.raises(InputError, match="more than one material"):
        maps_of(found)


def test_each_udim_tile_is_a_set(tmp_path):
    for tile in (1001, 1002, 1011):
        write_maps(tmp_path / "hero", names="Hero_{}." + f"{tile}.png")
    found = find_sets(tmp_path)
    assert [each.key for each in found] == ["hero/Hero.1001", "hero/Hero.1002", "hero/Hero.1011"]
    assert [each.udim for each in found] == [1001, 1002, 1011]
    assert maps_of(found[1]) == {
        "base_color": "Hero_Color.1002.png", "normal": "Hero_NormalGL.1002.png", "roughness": "Hero_Roughness.1002.png"
    }  # fmt: skip
    assert read_settings(None, tmp_path).of(found[0], {})["wrap"] == "clamp"
    assert read_settings(None, tmp_path).of(found[0], {"wrap": "tile"})["wrap"] == "tile"


def test_tiles_counted_from_one_and_numbers_anywhere(tmp_path):
    for tile in ("u1_v1", "u2_v1", "u1_v2"):
        write_maps(tmp_path / "one", names="Hero_{}_" + f"{tile}.png")
    for tile in (1001, 1002):
        write_maps(tmp_path / "two", names=f"Hero.{tile}." + "{}.png")
    found = find_sets(tmp_path)
    assert [each.udim for each in found] == [1001, 1002, 1011, 1001, 1002]
    assert maps_of(found[1])["normal"] == "Hero_NormalGL_u2_v1.png"
    assert maps_of(found[4])["normal"] == "Hero.1002.NormalGL.png"


def test_a_map_without_a_tile_serves_all_of_them(tmp_path):
    for tile in (1001, 1002):
        write_maps(tmp_path / "hero", names="Hero_{}." + f"{tile}.png", roles=("Color", "NormalGL"))
    write_maps(tmp_path / "hero", names="Hero_{}.png", roles=("Roughness",))
    found = find_sets(tmp_path)
    assert [each.udim for each in found] == [1001, 1002]
    assert all(maps_of(each)["roughness"] == "Hero_Roughness.png" for each in found)


def test_each_material_that_a_mesh_uses_is_a_set(tmp_path):
    """Four materials, one of them unused, one without maps: two sets, and their pictures are none of their own."""
    folder = tmp_path / "helmet"
    for name in ("Glass", "Metal", "Spare"):
        write_maps(folder, names=name + "_{}.png", roles=("NormalGL",))
    document = {
        "asset": {"version": "2.0"},
        "materials": [
            {"name": "Glass", "normalTexture": {"index": 0}}, {"name": "Spare", "normalTexture": {"index": 2}},
            {"name": "Metal/old", "normalTexture": {"index": 1}}, {"name": "Plain"},
        ],
        "textures": [{"source": 0}, {"source": 1}, {"source": 2}],
        "images": [{"uri": f"{name}_NormalGL.png"} for name in ("Glass", "Metal", "Spare")],
        "meshes": [{"primitives": [{"material": 0}, {"material": 2}, {"material": 3}]}],
    }  # fmt: skip
    (folder / "Helmet.gltf").write_text(json.dumps(document))
    found = find_sets(tmp_path)
    sets = {each.key: each.material for each in found if each.material}
    assert sets == {"helmet/Glass": "Glass", "helmet/Metal-old": "Metal/old"}
    assert [maps_of(each)["normal"] for each in found if each.material] == ["Glass_NormalGL.png", "Metal_NormalGL.png"]
    assert not [each for each in found if not each.material and each.files and "Glass_NormalGL.png" in each.files]


def test_tiles_of_two_materials(tmp_path):
    for name in ("Head", "Body"):
        for tile in (1001, 1002):
            write_maps(tmp_path / "hero", names=name + "_{}" + f"_{tile}.png")
    found = ["hero/Body.1001", "hero/Body.1002", "hero/Head.1001", "hero/Head.1002"]
    assert keys(tmp_path) == found


def test_a_resolution_after_an_underscore_is_no_tile(tmp_path):
    write_maps(tmp_path / "rock", names="Rock_{}_1024.png")
    assert keys(tmp_path) == ["rock"]


def test_a_gltf_and_its_textures_are_one_set(tmp_path):
    write_maps(tmp_path / "helmet" / "textures", names="Helmet_{}.png")
    material = {
        "materials": [{"normalTexture": {"index": 0}, "pbrMetallicRoughness": {"baseColorTexture": {"index": 1}}}],
        "textures": [{"source": 0}, {"source": 1}],
        "images": [{"uri": "textures/Helmet_NormalGL.png"}, {"uri": "textures/Helmet_Color.png"}],
    }
    (tmp_path / "helmet" / "Helmet.gltf").write_text(json.dumps(material))
    assert keys(tmp_path) == ["helmet", "helmet.textures"]  # the roughness map is another's: nothing is lost
    (tmp_path / "helmet" / "textures" / "Helmet_Roughness.png").unlink()
    assert keys(tmp_path) == ["helmet"]
    (tmp_path / "helmet" / "Second.gltf").write_text(json.dumps(material))
    assert keys(tmp_path) == ["helmet/Helmet", "helmet/Second"]


def test_colours_alone_are_a_set_that_lacks_something_and_other_pictures_are_none(tmp_path):
    write_maps(tmp_path / "bad", roles=("Color", "Roughness"))
    write_png(tmp_path / "screenshot.png", np.zeros((4, 4, 3), np.uint8))
    assert keys(tmp_path) == ["bad"]


def test_outputs_hidden_folders_and_loops_are_passed_over(tmp_path):
    write_maps(tmp_path / "set")
    write_maps(tmp_path / ".cache" / "set")
    bake_to_folder(tmp_path / "set", tmp_path / "out", method="naive", levels=1, preview=False)
    assert (tmp_path / "out" / "set" / "manifest.json").is_file()
    os.symlink(tmp_path, tmp_path / "loop")
    assert keys(tmp_path) == ["set"]
    write_maps(tmp_path / "out" / "other")
    assert keys(tmp_path, output=tmp_path / "out") == ["set"]


def test_two_sets_for_one_place_are_refused(tmp_path):
    write_maps(tmp_path / "lib")
    write_maps(tmp_path / "lib" / "lib")
    with pytest.raises(InputError, match=r"both be written to 'lib', expected names that\s+differ"):
        keys(tmp_path / "lib")


def test_a_root_that_is_none(tmp_path):
    with pytest.raises(InputError, match="is no folder"):
        keys(tmp_path / "missing")
    assert keys(tmp_path) == []


SETTINGS = """
exclude = ["old", "*/trash"]

[options]
quality = "draft"
preset = "gltf"

[[sets]]
match = "metal/*"
quality = "fine"
roles = { normal = "bumps.png" }

[[sets]]
match = "metal/thin"
levels = 3

[[sets]]
match = "*/raw"
skip = true
"""


def test_settings_by_patterns(tmp_path):
    (tmp_path / "library.toml").write_text(SETTINGS)
    settings = read_settings(None, tmp_path)

    def of(key, **command_line):
        return settings.of(Found(key, tmp_path), command_line)

    assert of("wood") == {"quality": "draft", "preset": "gltf"}
    assert of("metal/plate")["quality"] == "fine" and of("metal/plate")["roles"] == {"normal": "bumps.png"}
    assert of("metal/thin") == of("metal/plate") | {"levels": 3}
    assert of("metal/thin", quality="standard")["quality"] == "standard"
    left_out = [key for key in ("old", "a/trash", "a/raw", "metal/thin") if settings.is_left_out(key)]
    assert left_out == ["old", "a/trash", "a/raw"]
    split = split_options(of("metal/thin"))
    assert split["preset"] == "gltf" and split["options"] == {"quality": "fine", "levels": 3}
    assert split["reading"]["roles"] == {"normal": "bumps.png"}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[options]\nqualty = 'draft'", r"no option 'qualty': did you mean 'fit\.quality'.*\$\.options"),
        ("[[sets]]\nmatch = '*'\nquality = 'best'", r"'fit\.quality' cannot be 'best'.*\$\.sets\[0\]"),
        ("[[sets]]\nquality = 'draft'", r"required field `match`"),
        ("[options]\nbits = 9", r"9.*\$\.bits.*\$\.options"),
        ("[options]\nfit.loss = 'l3'", r"'fit\.loss' cannot be 'l3'.*\$\.options"),
        ("[options]\nlevels = 0", r"'levels' is '0', expected a whole number at least 1.*\$\.options"),
        ("exclude = [", "not as expected"),
    ],
)
def test_settings_that_are_wrong_say_where(tmp_path, text, told):
    (tmp_path / "library.toml").write_text(text)
    with pytest.raises(InputError, match=f"library.toml.*{told}"):
        read_settings(None, tmp_path)


def test_settings_with_unknown_names_are_told_before_the_work(tmp_path):
    (tmp_path / "library.toml").write_text("[options]\nmethod = 'bgfs'")
    with pytest.raises(UnknownNameError, match="did you mean 'bfgs'"):
        read_settings(None, tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        read_settings(tmp_path / "none.toml", tmp_path)


def test_names_that_are_not_utf8_are_named_and_the_others_are_baked(tmp_path):
    """One Latin-1 name once ended a whole run."""
    root, output = tmp_path / "root", tmp_path / "out"
    write_maps(root / "good")
    write_maps(root / "bad")
    (root / "good" / os.fsdecode(b"caf\xe9.png")).write_bytes(b"x")
    (root / "bad").rename(root / os.fsdecode(b"caf\xe9"))
    summary = run_library(root, str(output), method="naive", workers=1)
    assert [outcome.key for outcome in summary.outcomes if outcome.error is None] == ["good"]
    failures = [*summary.failures, *summary.plan.failures]
    assert set(failures) == {os.fsdecode(b"caf\xe9")}
    assert (output / "good" / "manifest.json").is_file()
    json.loads((output / "library.json").read_text())
    assert not run_library(root, str(output), method="naive", workers=1).outcomes
