"""Opacity weighs every map in every level and method, and what lies under no surface has no part in anything."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from pictures import bumps, encoded, write_image

from brdffit import bake
from brdffit.colour import decode_srgb
from brdffit.errors import InputError
from brdffit.footprint import filter_channels, get_pixel_filter
from brdffit.methods import lobe_method_names
from brdffit.roughness import perceptual_from_log_tensor
from brdffit.svbrdf import LEAST_WEIGHT, Svbrdf
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.coverage import looks_like_coverage
from brdffit.textures.reading import read_texture_set

SIZE = 32
HEIGHT, NORMAL = bumps(SIZE, SIZE, slope=0.1)
X, Y = np.meshgrid((np.arange(SIZE) + 0.5) / SIZE - 0.5, (np.arange(SIZE) + 0.5) / SIZE - 0.5)
LEAF = np.hypot(X, 1.6 * Y) < 0.4
#: Green and roughness of the leaf, as stored.
GREEN, ROUGH = np.array([60, 140, 40]) / 255.0, 102 / 255.0
#: What texels without surface weigh, against all of the leaf's.
LEAST = 3.0 * LEAST_WEIGHT


def leaf_maps(junk: int = 0) -> dict:
    """A leaf cut out of black, or of random colours."""
    rng = np.random.default_rng(junk)
    beyond = rng.random((SIZE, SIZE, 3)) if junk else np.zeros((SIZE, SIZE, 3))
    colour = np.where(LEAF[..., None], GREEN, beyond)
    rough = np.where(LEAF, ROUGH, beyond[..., 0])
    normal = np.where(LEAF[..., None], encoding_of(NORMAL), encoded(NORMAL)[::-1] if junk else [0.5, 0.5, 1.0])
    return {
        "Leaf_Color__png": np.dstack([colour, LEAF]),
        "Leaf_Roughness__png": rough,
        "Leaf_NormalGL__png": (normal, "uint16"),
    }


def encoding_of(normal: np.ndarray) -> np.ndarray:
    return encoded(normal)


def read(folder: Path, **options) -> tuple:
    texture_set = read_texture_set(folder, **options)
    return texture_set, to_svbrdf(texture_set)


def test_alpha_is_read_as_opacity_and_what_lies_beyond_is_filled(make_folder) -> None:
    texture_set, svbrdf = read(make_folder(**leaf_maps()))
    np.testing.assert_array_equal(svbrdf.opacity, LEAF)
    assert (svbrdf.alpha, svbrdf.cutoff) == ("mask", 0.5)
    np.testing.assert_allclose(svbrdf.diffuse, np.broadcast_to(decode_srgb(GREEN), (SIZE, SIZE, 3)), rtol=1e-5)
    np.testing.assert_allclose(perceptual_from_log_tensor(svbrdf.log_roughness), ROUGH, rtol=1e-5)
    assert any("Opacity weighs every map" in note for note in texture_set.notes)


@pytest.mark.parametrize("method", [name for name in lobe_method_names() if name != "height"])
def test_a_leafs_green_is_green_at_all_levels(make_folder, method: str) -> None:
    """It was 0.078 for 0.263: black beyond the leaf counted as leaf."""
    pyramid = bake(make_folder(**leaf_maps()), method=method).lobes
    for level in pyramid.levels:
        green = level.svbrdf.diffuse[..., 1]
        np.testing.assert_allclose(green, decode_srgb(GREEN)[1], rtol=0.03)
        assert level.svbrdf.opacity is not None


@pytest.mark.parametrize("method", ["naive", "vmf", "lean", "bfgs"])
def test_what_lies_beyond_has_no_part_in_any_level(make_folder, method: str) -> None:
    one, other = (bake(make_folder(f"set{junk}", **leaf_maps(junk)), method=method).lobes for junk in (1, 2))
    for level, same in zip(one.levels, other.levels, strict=True):
        for name, array in level.svbrdf.arrays().items():
            np.testing.assert_array_equal(array, same.svbrdf.arrays()[name], err_msg=name)


def half_and_half(opacity: np.ndarray) -> Svbrdf:
    """A rough red half and a glossy green one, of different opacity."""
    rng = np.random.default_rng(0)
    left = X < 0.0
    colour = np.where(left[..., None], [0.6, 0.1, 0.1], [0.1, 0.5, 0.1]).astype(np.float32)
    rough = np.where(left, 0.7, 0.3)
    log = np.zeros((SIZE, SIZE, 3), np.float32)
    log[..., 0] = log[..., 1] = 4.0 * np.log(rough)
    normal = NORMAL + 0.05 * rng.standard_normal(NORMAL.shape)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    return Svbrdf(normal.astype(np.float32), log, 0.3 * colour, colour, opacity=opacity.astype(np.float32))


@pytest.mark.parametrize("pixel_filter", ["box", "gaussian"])
def test_averages_are_weighted_by_opacity(pixel_filter: str) -> None:
    """Against sum f a x / sum f a, written out."""
    opacity = np.where(X < 0.0, 0.25, 1.0) * (0.5 + 0.5 * np.cos(9 * Y) ** 2)
    svbrdf = half_and_half(opacity)
    pyramid = bake(svbrdf, method="naive", pixel_filter=pixel_filter).lobes
    for level in pyramid.levels:
        size = level.svbrdf.size

        def filtered(image: np.ndarray, size: tuple[int, int] = size) -> np.ndarray:
            return filter_channels(image.astype(np.float32), size, get_pixel_filter(pixel_filter), "tile")

        share = filtered(opacity[..., None])
        for name in ("diffuse", "specular"):
            expected = filtered(getattr(svbrdf, name) * opacity[..., None]) / share
            np.testing.assert_allclose(getattr(level.svbrdf, name), expected, rtol=LEAST, atol=LEAST)
        rough = perceptual_from_log_tensor(svbrdf.log_roughness)[..., None]
        np.testing.assert_allclose(
            perceptual_from_log_tensor(level.svbrdf.log_roughness),
            (filtered(rough * opacity[..., None]) / share)[..., 0],
            rtol=LEAST,
        )
        np.testing.assert_allclose(level.svbrdf.opacity, share[..., 0], atol=1e-6)


def test_a_half_of_little_opacity_hardly_moves_the_fitted_lobe() -> None:
    """Only the glossy half is there: the fit of the whole is that of this half alone."""
    there = half_and_half(np.where(X < 0.0, 0.0, 1.0))
    alone = there.replace(
        **{
            name: np.where((X < 0)[(...,) + (None,) * (a.ndim - 2)], a[:, ::-1], a)
            for name, a in there.arrays().items()
        }
    ).replace(opacity=None)
    ours = bake(there, quality="standard").lobes.levels[-1].svbrdf
    theirs = bake(alone, quality="standard").lobes.levels[-1].svbrdf
    np.testing.assert_allclose(ours.specular, theirs.specular, rtol=0.03)
    np.testing.assert_allclose(ours.log_roughness, theirs.log_roughness, atol=0.1)


def test_weights_are_undone_exactly() -> None:
    svbrdf = half_and_half(np.clip(1.2 * (X + 0.5), 0.0, 1.0))
    again = svbrdf.weighted().unweighted()
    for name, array in svbrdf.arrays().items():
        np.testing.assert_allclose(again.arrays()[name], array, rtol=1e-5, atol=1e-6)
    assert svbrdf.replace(opacity=None).weighted().opacity is None
    np.testing.assert_array_equal(svbrdf.over_black().diffuse, svbrdf.diffuse * svbrdf.opacity[..., None])


def test_gutters_of_an_atlas_weigh_nothing(make_folder) -> None:
    """(0, 0, 0) was read as a normal on the horizon, and black roughness as a mirror: 69 degrees off at the edges."""
    there = (np.abs(X) < 0.4)[..., None]
    colour = np.where(there, GREEN, 0.0)
    folder = make_folder(
        a_Color__png=colour, a_NormalGL__png=np.where(there, encoded(NORMAL), 0.0),
        a_Roughness__png=np.where(there[..., 0], ROUGH, 0.0),
    )  # fmt: skip
    texture_set, svbrdf = read(folder)
    assert any("black in every map" in note for note in texture_set.notes)
    assert svbrdf.normal[..., 2].min() > 0.9
    assert svbrdf.alpha == ""
    level = bake(folder, method="vmf").lobes.levels[-1].svbrdf
    np.testing.assert_allclose(level.diffuse[0, 0], decode_srgb(GREEN), rtol=0.01)
    assert level.normal[0, 0, 2] > 0.99


def test_black_paint_without_a_black_normal_is_no_gutter(make_folder) -> None:
    colour = np.where(X[..., None] < 0, 0.0, GREEN)
    folder = make_folder(a_Color__png=colour, a_NormalGL__png=encoded(NORMAL), a_Roughness__png=np.zeros((SIZE, SIZE)))
    assert read(folder)[1].opacity is None


def test_a_surface_that_is_nowhere_is_refused(make_folder) -> None:
    folder = make_folder(a_NormalGL__png=encoded(NORMAL), a_Opacity__png=np.zeros(NORMAL.shape[:2]))
    with pytest.raises(InputError, match=r"a_Opacity\.png' is 0 everywhere as opacity, expected some surface"):
        to_svbrdf(read_texture_set(folder))


def test_an_alpha_that_is_no_cut_out_is_named_and_not_used(make_folder) -> None:
    smooth = 0.2 + 0.6 * np.random.default_rng(0).random((SIZE, SIZE))
    folder = make_folder(
        a_Color__png=np.dstack([np.broadcast_to(GREEN, (SIZE, SIZE, 3)), smooth]), a_NormalGL__png=encoded(NORMAL)
    )
    texture_set, svbrdf = read(folder)
    assert svbrdf.opacity is None
    assert any("does not look like a cut-out" in note for note in texture_set.notes)
    assert looks_like_coverage(LEAF.astype(np.float32)) and not looks_like_coverage(smooth.astype(np.float32))


@pytest.mark.parametrize(("mode", "alpha"), [("OPAQUE", None), ("MASK", "mask"), ("BLEND", "blend")])
def test_gltf_alpha_modes(tmp_path: Path, mode: str, alpha: str | None) -> None:
    maps = leaf_maps()
    write_image(tmp_path / "c.png", maps["Leaf_Color__png"])
    write_image(tmp_path / "n.png", *maps["Leaf_NormalGL__png"])
    material = {
        "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "normalTexture": {"index": 1}, "alphaMode": mode,
        "alphaCutoff": 0.3,
    }  # fmt: skip
    document = {
        "asset": {"version": "2.0"}, "images": [{"uri": "c.png"}, {"uri": "n.png"}],
        "textures": [{"source": 0}, {"source": 1}], "materials": [material],
    }  # fmt: skip
    (tmp_path / "leaf.gltf").write_text(json.dumps(document))
    _, svbrdf = read(tmp_path / "leaf.gltf")
    assert (svbrdf.opacity is None) == (alpha is None)
    if alpha is not None:
        np.testing.assert_array_equal(svbrdf.opacity, LEAF)
        assert (svbrdf.alpha, svbrdf.cutoff) == (alpha, 0.3 if alpha == "mask" else 0.5)
