"""The shipped sets: the same bytes each time, tileable, and what their recipes promise."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from brdffit.errors import InputError, OutputError, UnknownNameError
from brdffit.files.image_io import read_image
from brdffit.roughness import perceptual_from_log_tensor
from brdffit.svbrdf import Svbrdf
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.procedural import ON_DEMAND, RECIPES, SETS, main, make_set, read_recipe
from brdffit.textures.reading import read_texture_set
from brdffit.textures.texture_set import TextureSet

SIZE = 128


@pytest.fixture(scope="module", params=SETS)
def made(request, tmp_path_factory) -> tuple[str, TextureSet, Svbrdf]:
    folder = make_set(request.param, tmp_path_factory.mktemp("sets") / request.param, SIZE)
    recipe, _ = read_recipe(RECIPES / f"{request.param}.toml")
    texture_set = read_texture_set(folder, wrap=recipe.wrap)
    return request.param, texture_set, to_svbrdf(texture_set)


def test_a_set_reads_back_by_its_names(made) -> None:
    name, texture_set, svbrdf = made
    assert texture_set.name == name
    assert {"base_color", "normal", "roughness"} <= texture_set.maps.keys()
    assert (texture_set.normal_y, texture_set.normal_y_source) == ("gl", "name")
    assert texture_set.maps["normal"].info.bits == 16
    assert texture_set.ignored == []
    assert svbrdf.is_finite()
    assert svbrdf.size == (SIZE, SIZE)


def test_the_same_recipe_gives_the_same_bytes(made, tmp_path: Path) -> None:
    name, texture_set, _ = made
    make_set(name, tmp_path, SIZE)
    for path, _ in texture_set.inputs:
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), path.name
    assert len(list(tmp_path.iterdir())) == len(texture_set.inputs), "a temporary file was left"


def test_large_sets_are_made_where_they_are_named(tmp_path: Path) -> None:
    (name,) = ON_DEMAND
    assert read_recipe(RECIPES / f"{name}.toml")[0].size == 4096
    first, second = (make_set(name, tmp_path / str(k), SIZE) for k in range(2))
    (height,) = first.glob("*_Height.png")
    assert height.read_bytes() == (second / height.name).read_bytes()
    pixels = read_image(height).pixels
    assert pixels.shape == (SIZE, SIZE, 1) and float(pixels.max()) == 1.0 and float(pixels.min()) == 0.0
    # It tiles, and strokes run along x more than along y.
    across, down = (np.abs(np.diff(pixels, axis=axis)).mean() for axis in (1, 0))
    assert across < 0.8 * down
    assert np.abs(pixels[0] - pixels[-1]).mean() < 2.0 * down


def test_a_tiling_set_has_no_seam(made) -> None:
    name, texture_set, _ = made
    if texture_set.wrap == "clamp":
        pytest.skip("the record does not tile")
    for role, named in texture_set.maps.items():
        pixels = read_image(named.path).pixels.astype(np.float64)
        for axis in (0, 1):
            inner = np.square(np.diff(pixels, axis=axis)).mean(axis=tuple({0, 1, 2} - {axis}))
            seam = np.square(np.take(pixels, 0, axis) - np.take(pixels, -1, axis)).mean()
            # The step across the seam is one among those inside.
            assert seam <= inner.max() + 1e-9, (name, role, axis)


def test_the_normals_belong_to_the_height(made, tmp_path: Path) -> None:
    name, texture_set, svbrdf = made
    if svbrdf.height is None:
        pytest.skip(f"{name} has no height map")
    height = texture_set.maps["height"].path
    shutil.copy(height, tmp_path)
    alone = to_svbrdf(read_texture_set(tmp_path, wrap=texture_set.wrap, height_scale=float(np.ptp(svbrdf.height))))
    # The scale is a regression over blocks; sharp ridges bend it by a few per cent.
    apart = (alone.normal - svbrdf.normal).std() / svbrdf.normal[..., :2].std()
    assert apart < 0.1


def test_each_set_is_what_it_is_for(made) -> None:
    name, _, svbrdf = made
    slope = svbrdf.normal[..., :2] / svbrdf.normal[..., 2:]
    roughness = perceptual_from_log_tensor(svbrdf.log_roughness)
    metal = bool((svbrdf.diffuse.max() == 0.0) and svbrdf.specular.min() > 0.2)
    if name == "brushed-metal":
        assert metal
        assert slope[..., 1].std() > 4.0 * slope[..., 0].std()
    elif name == "hammered-metal":
        assert metal
        assert 0.1 < roughness.mean() < 0.3
        assert slope.std() > 0.05
    elif name == "grooved-record":
        # Anisotropy that turns: grooves lie across x beside the hole and across y above it.
        middle, off = SIZE // 2, SIZE // 6
        beside, above = slope[middle - 8 : middle + 8, 8:off], slope[8:off, middle - 8 : middle + 8]
        assert beside[..., 0].std() > 3.0 * beside[..., 1].std()
        assert above[..., 1].std() > 3.0 * above[..., 0].std()
    elif name == "glossy-tiles":
        # Dark glaze is smooth, pale grout is rough.
        assert np.corrcoef(svbrdf.diffuse.mean(2).ravel(), roughness.ravel())[0, 1] > 0.9
    elif name == "glass-panes":
        # At least four fifths at the floor; bevels far steeper than panes; dust and frames beside them.
        assert 0.75 < np.mean(roughness < 0.0451) < 0.9
        assert roughness.max() > 0.5
        flat = np.hypot(slope[..., 0], slope[..., 1])
        assert 0.05 < np.mean(flat > 0.15) < 0.3 and np.median(flat) < 0.03
    elif name == "leaf-litter":
        # A good part of it is not there, and what is there is green or brown, never black.
        assert 0.3 < svbrdf.opacity.mean() < 0.7 and svbrdf.alpha == "mask"
        assert svbrdf.diffuse.max(axis=2).min() > 0.03
        assert 0.05 < slope.std() < 0.6
    elif name == "plaster-wall":
        assert not np.ptp(svbrdf.diffuse, axis=(0, 1)).any() and svbrdf.specular.max() < 0.05
        assert roughness.min() > 0.8
        assert 0.01 < slope.std() < 0.1
    elif name == "rocky-terrain":
        assert slope.std() > 0.4
        assert roughness.min() > 0.5
        assert svbrdf.diffuse.std(axis=(0, 1)).min() > 0.05 and roughness.std() > 0.05
    elif name in ("cliff", "insulation-foam", "pebbles", "turtle-shell", "woven-fabric"):
        # Deep enough that they hide and shade themselves, and steep.
        assert svbrdf.height is not None and 0.04 < np.ptp(svbrdf.height) / SIZE < 0.16
        assert 0.3 < slope.std() < 1.2
        assert svbrdf.diffuse.std(axis=(0, 1)).max() > 0.04
    else:
        assert metal
        assert roughness.mean() < 0.1
        assert slope.std() > 0.05


def test_what_cannot_be_made_is_told(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'glossy-tiles'"):
        make_set("glossy-tile", tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="could not be written"):
        make_set("glossy-tiles", tmp_path / "file" / "set", 8)
    (tmp_path / "bad.toml").write_text((RECIPES / "bumpy-mirror.toml").read_text().replace("slope =", "slop ="))
    with pytest.raises(InputError, match=r"bad\.toml' is not as expected: .*slop"):
        read_recipe(tmp_path / "bad.toml")


def test_a_failed_write_keeps_what_was_there(tmp_path: Path, monkeypatch) -> None:
    make_set("bumpy-mirror", tmp_path, 16)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def full(path: Path, pixels: np.ndarray) -> None:
        Path(path).write_bytes(b"half")
        raise OutputError(f"'{path}' could not be written.")

    monkeypatch.setattr("brdffit.textures.procedural.write_png", full)
    with pytest.raises(OutputError):
        make_set("bumpy-mirror", tmp_path, 32)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_the_command_writes_named_sets(tmp_path: Path) -> None:
    told: list[str] = []
    assert main([str(tmp_path), "bumpy-mirror"], told.append) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["bumpy-mirror"]
    assert main([str(tmp_path), "bumpy"], told.append) == 2
    assert main([], told.append) == 2
    assert "There is no procedural set 'bumpy'" in told[0]
    assert told[1].startswith("usage:")
