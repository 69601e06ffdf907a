"""Roles from file names, convention by convention."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from brdffit.textures.naming import old_cc0textures, packed_roles, roles_from_names
from brdffit.textures.reading import read_texture_set

CONVENTIONS = {
    "ambientCG": {
        "Ice002_1K-JPG_Color.jpg": ["base_color"],
        "Ice002_1K-JPG_NormalGL.jpg": ["normal"],
        "Ice002_1K-JPG_NormalDX.jpg": [],
        "Ice002_1K-JPG_Roughness.jpg": ["roughness"],
        "Ice002_1K-JPG_Displacement.jpg": ["height"],
        "Ice002_1K-JPG_Metalness.jpg": ["metallic"],
        "Ice002_1K-JPG_AmbientOcclusion.jpg": ["ao"],
        "Ice002_1K-JPG.png": [],
    },
    "Poly Haven": {
        "rusty_metal_05_diff_2k.jpg": ["base_color"],
        "rusty_metal_05_nor_gl_2k.exr": ["normal"],
        "rusty_metal_05_disp_2k.png": ["height"],
        "rusty_metal_05_arm_2k.jpg": ["ao:R", "roughness:G", "metallic:B"],
    },
    "Unreal": {
        "T_Rock_D.png": ["base_color"],
        "T_Rock_N.png": ["normal"],
        "T_Rock_ORM.png": ["ao:R", "roughness:G", "metallic:B"],
    },
    "Substance": {
        "door_BaseColor.tif": ["base_color"],
        "door_Normal.tif": ["normal"],
        "door_Roughness.tif": ["roughness"],
        "door_Metallic.tif": ["metallic"],
        "door_Height.tif": ["height"],
    },
    "bare": {
        "albedo.jpg": ["base_color"],
        "normal.jpg": ["normal"],
        "roughness.jpg": ["roughness"],
        "displacement.jpg": ["height"],
        "readme_picture.jpg": [],
    },
    "older CC0Textures": {
        "Metal10_col.jpg": ["base_color"],
        "Metal10_nrm.jpg": ["normal"],
        "Metal10_rgh.jpg": ["roughness"],
        "Metal10_met.jpg": ["metallic"],
        "Metal10_disp.jpg": ["height"],
    },
    "glTF names": {
        "Chair_occlusionRoughnessMetallic.png": ["ao:R", "roughness:G", "metallic:B"],
        "Chair_normal.png": ["normal"],
        "Chair_baseColor.png": ["base_color"],
    },
    "FlightHelmet": {"Helmet_LeatherPartsMat_OcclusionRoughMetal.png": ["ao:R", "roughness:G", "metallic:B"]},
    "metallicRoughness": {"Chair_metallicRoughness.png": ["roughness:G", "metallic:B"]},
    "Unity": {
        "Wood_BaseMap.png": [],
        "Wood_MaskMap.png": ["metallic:R", "ao:G", "gloss:A"],
        "Wood_NormalMap.png": ["normal"],
    },
    "gloss": {"tin_gloss.png": ["gloss"], "tin_specular.png": ["specular"], "tin_diffuse.png": ["base_color"]},
    "RMA": {"crate_RMA.png": ["roughness:R", "metallic:G", "ao:B"]},
    "words anywhere": {
        "Wood_4096x4096_Normal_PNG_8K_OpenGL.png": ["normal"],
        "2k_wood_base-color_16bit.png": ["base_color"],
        "wood.roughness.2048.png": ["roughness"],
    },
    "role first": {"normal_brick.png": ["normal"], "albedo-brick.jpg": ["base_color"]},
    "depth": {"sand_depth.png": ["height"], "sand_normal.png": ["normal"]},
    "a metal's preview is no metallic map": {"MetalPlates006.png": [], "MetalPlates006_NormalDX.png": ["normal"]},
    "rough metal is not packed": {"rusty_metal_05_rough.jpg": ["roughness"]},
    "Poliigon": {
        "Bricks_COL_VAR1_3K.jpg": ["base_color"],
        "Bricks_COL_VAR2_3K.jpg": [],
        "Bricks_GLOSS_3K.jpg": ["gloss"],
        "Bricks_NRM_3K.jpg": ["normal"],
        "Bricks_REFL_3K.jpg": ["specular"],
        "Bricks_DISP_3K.jpg": ["height"],
    },
    "a preview bears the common stem": {
        "Brushed_Metal.png": [],
        "Brushed_Metal_Color.png": ["base_color"],
        "Brushed_Metal_NormalGL.png": ["normal"],
        "Brushed_Metal_Roughness.png": ["roughness"],
    },
    "a workflow's word is no role": {
        "Iron_COL_4K_METALNESS.png": ["base_color"],
        "Iron_NRM_4K_METALNESS.png": ["normal"],
        "Iron_ROUGHNESS_4K_METALNESS.png": ["roughness"],
        "Iron_METALNESS_4K_METALNESS.png": ["metallic"],
        "Iron_AO_4K.png": ["ao"],
    },
    "MetalRough": {"A_MetalRough.png": ["roughness:G", "metallic:B"], "A_Normal.png": ["normal"]},
    "metalnessRoughness": {"A_metalnessRoughness.png": ["roughness:G", "metallic:B"], "A_Normal.png": ["normal"]},
    "MRAO": {"A_MRAO.png": ["metallic:R", "roughness:G", "ao:B"], "A_Normal.png": ["normal"]},
    "RMAO": {"A_RMAO.png": ["roughness:R", "metallic:G", "ao:B"], "A_Normal.png": ["normal"]},
    "ORDp": {"A_ORDp.png": ["ao:R", "roughness:G", "height:B"], "A_N.png": ["normal"]},
    "ARD": {"A_ARD.png": ["ao:R", "roughness:G", "height:B"], "A_Normal.png": ["normal"]},
    "Unity's": {"A_MetallicGlossMap.png": ["metallic:R", "gloss:A"], "A_Normal.png": ["normal"]},
    "Unity's specular": {"A_SpecularSmoothness.png": ["specular", "gloss:A"], "A_Normal.png": ["normal"]},
    "other layers": {
        "A_EmissiveColor.png": [],
        "A_SheenColor.png": [],
        "A_ID_Color.png": [],
        "A_ClearcoatRoughness.png": [],
        "A_Normal.png": ["normal"],
        "A_Roughness.png": ["roughness"],
    },
    "mesh maps": {
        "A_Normal.png": ["normal"],
        "A_bent_normals.png": [],
        "A_world_space_normals.png": [],
        "A_DetailNormal.png": [],
        "A_curvature.png": [],
        "A_Roughness.png": ["roughness"],
    },
    "a material's own word is no layer": {
        "Coat_Color.png": ["base_color"],
        "Coat_Normal.png": ["normal"],
        "Coat_Roughness.png": ["roughness"],
    },
    "two resolutions": {
        "A_1K_Normal.png": [],
        "A_4K_Normal.png": ["normal"],
        "A_1K_Color.png": [],
        "A_4K_Color.png": ["base_color"],
    },
    "a copy": {"Wood_Normal.png": ["normal"], "Wood_Roughness.png": ["roughness"], "Wood_Roughness(1).png": []},
    "opacity": {"Leaf_Opacity.png": ["opacity"], "Leaf_Normal.png": ["normal"]},
}


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_roles_by_convention(convention: str) -> None:
    expected = CONVENTIONS[convention]
    named = roles_from_names(expected)
    found: dict[str, list[str]] = {file: [] for file in expected}
    for role, choice in named.maps.items():
        found[choice.file].append(f"{role}:{choice.channel}" if choice.channel else role)
    assert {file: sorted(roles) for file, roles in found.items()} == {f: sorted(r) for f, r in expected.items()}
    assert named.ignored == sorted(file for file, roles in expected.items() if not roles)


@pytest.mark.parametrize(
    ("file", "normal_y"),
    [
        ("a_NormalGL.png", "gl"),
        ("a_NormalDX.png", "dx"),
        ("a_nor_gl_1k.jpg", "gl"),
        ("a_nor_dx_1k.jpg", "dx"),
        ("a_normal-gl.png", "gl"),
        ("a_Normal_DirectX.png", "dx"),
        ("a_normal_opengl_2k.png", "gl"),
        ("a_Normal.png", ""),
    ],
)
def test_the_name_says_the_normals_y(file: str, normal_y: str) -> None:
    assert roles_from_names([file]).maps["normal"].normal_y == normal_y


def test_gl_is_taken_where_both_exist() -> None:
    named = roles_from_names(["a_NormalDX.png", "a_NormalGL.png"])
    assert named.maps["normal"].file == "a_NormalGL.png"
    assert named.ignored == ["a_NormalDX.png"]


def test_single_letters_need_company() -> None:
    assert not roles_from_names(["wood_N.png"]).maps
    assert not roles_from_names(["wood_N.png", "stone_D.png"]).maps
    assert set(roles_from_names(["wood_N.png", "wood_R.png"]).maps) == {"normal", "roughness"}


def test_a_second_role_needs_an_alpha_channel() -> None:
    files = ["rock_alb_ht.png", "rock_nrm_rgh.png"]
    packed = roles_from_names(files, alpha=files).maps
    assert {role: (found.file, found.channel) for role, found in packed.items()} == {
        "base_color": ("rock_alb_ht.png", ""),
        "height": ("rock_alb_ht.png", "A"),
        "normal": ("rock_nrm_rgh.png", ""),
        "roughness": ("rock_nrm_rgh.png", "A"),
    }
    assert set(roles_from_names(files).maps) == {"height", "roughness"}


def test_older_cc0textures_are_known_by_their_words() -> None:
    assert old_cc0textures(roles_from_names(["M_nrm.jpg", "M_col.jpg"]))
    assert old_cc0textures(roles_from_names(["M_Normal.jpg", "M_var1.jpg"]))
    assert not old_cc0textures(roles_from_names(["M_normal.jpg", "M_col.jpg"]))
    assert not old_cc0textures(roles_from_names(["M_nrm_rgh.png", "M_alb_ht.png"], ["M_nrm_rgh.png", "M_alb_ht.png"]))


def test_an_imperfection_map_is_roughness_and_said_to_be_assumed() -> None:
    named = roles_from_names(["S_1K_Normal.jpg", "S_1K_var1.jpg", "S_1K_var2.jpg"])
    assert named.maps["roughness"].file == "S_1K_var1.jpg"
    assert any("'S_1K_var1.jpg' is taken as roughness" in note for note in named.notes)


def test_materials_that_claim_one_role_are_rivals() -> None:
    assert roles_from_names(["oak_normal.png", "elm_normal.png"]).rivals == {
        "normal": ["elm_normal.png", "oak_normal.png"]
    }
    assert not roles_from_names(["oak_normal.png", "oak_normal.exr", "oak_color.png"]).rivals


@pytest.mark.parametrize(("word", "roles"), [("ORM", "arm"), ("arm", "arm"), ("RMA", "rma"), ("mra", "mra")])
def test_packings_by_letters(word: str, roles: str) -> None:
    letters = {"ao": "a", "roughness": "r", "metallic": "m"}
    assert "".join(letters[role] for role in packed_roles(word) or ()) == roles


def test_what_looks_packed_is_named() -> None:
    named = roles_from_names(["A_Normal.png", "A_MRH.png", "A_grain.png", "B_ogre.png"])
    assert [note for note in named.notes if "looks like a packing" in note] == [
        "'A_MRH.png' looks like a packing of several maps and is not used: name what it holds, as in "
        "--role orm=A_MRH.png, or one channel, as in --role roughness=A_MRH.png:G."
    ]


def test_layers_previews_and_rivals_are_said() -> None:
    named = roles_from_names(["A_Normal.png", "A_SheenColor.png", "A_EmissiveColor.png"])
    assert "left out: A_EmissiveColor.png, A_SheenColor.png" in named.notes[-1]
    named = roles_from_names(["Brushed_Metal.png", "Brushed_Metal_Color.png", "Brushed_Metal_Normal.png"])
    assert any("'Brushed_Metal.png' bears the name of the whole set" in note for note in named.notes)


def test_real_sets_are_found_as_they_are(real_sets: Path) -> None:
    words = {"basecolor": "base_color", "normal": "normal", "roughness": "roughness", "metallic": "metallic"}
    words |= {"height": "height", "ao": "ao"}
    packed = {
        "orm-packed": ["ao", "roughness", "metallic"],
        "basecolor+height-packed": ["base_color", "height"],
        "normal+roughness-packed": ["normal", "roughness"],
    }
    wrong = []
    for material in json.loads((real_sets / "materials.json").read_text()):
        expected = {}
        for file in material["files"]:
            roles = packed.get(file["role"], [words[file["role"]]] if file["role"] in words else [])
            expected |= {role: file["file"] for role in roles}
        texture_set = read_texture_set(real_sets / material["name"])
        found = {role: named.path.name for role, named in texture_set.maps.items()}
        if found != expected or texture_set.normal_y != material["normal_y"].lower():
            wrong.append((material["name"], found, texture_set.normal_y, texture_set.normal_y_source))
    assert not wrong
