"""A large height map becomes a small set: bands give what all of the map gives, in little memory, or a sentence."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from brdffit import reduction
from brdffit.cli import main
from brdffit.errors import InputError, UnknownNameError
from brdffit.files.image_io import read_image, read_mip_exr, write_mip_exr, write_png
from brdffit.files.image_rows import ImageRows
from brdffit.methods import Material, get_method
from brdffit.pipeline import bake_options
from brdffit.reduction import bake_levels_from, reduce_set
from brdffit.roughness import eigenvalues_of_log
from brdffit.textures import rows
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.procedural import make_set
from brdffit.textures.resampled_rows import ResampledRows
from brdffit.textures.rows import LargeSet, open_large

SIZE = 128
READING = {"height_scale": 5.0}


@pytest.fixture(scope="module")
def strokes(tmp_path_factory):
    return make_set("brushed-strokes-4k", tmp_path_factory.mktemp("sets") / "strokes", SIZE)


def small_bands(monkeypatch, level=2, texels=SIZE * 32):
    monkeypatch.setattr(rows, "BAND_TEXELS", texels)
    return level


def height_file(folder, size=(64, 64), seed=3):
    pixels = np.random.default_rng(seed).integers(0, 65536, size).astype(np.uint16)
    path = folder / "Scratches_Height.png"
    write_png(path, pixels)
    return path


@pytest.mark.parametrize("wrap", ["tile", "clamp"])
@pytest.mark.parametrize(("method", "given"), [("bfgs", {}), ("lean", {"pixel_filter": "gaussian"})])
def test_bands_are_what_all_of_the_map_is(strokes, monkeypatch, wrap, method, given):
    level = small_bands(monkeypatch)
    chosen = get_method(method)
    options = bake_options(chosen, None, given)
    with LargeSet(open_large(strokes, {**READING, "wrap": wrap}), level, options.min_roughness) as large:
        assert len(large.bands) == 4
        banded = reduce_set(large, chosen, options, None).lobes
    whole = Material(to_svbrdf(open_large(strokes, {**READING, "wrap": wrap}), min_roughness=options.min_roughness))
    reach = {"reach": (level, level)} if method == "bfgs" else {}
    expected = chosen.bake(whole, bake_options(chosen, None, {**given, "levels": level + 1, **reach})).lobes
    assert banded.size == (SIZE >> level, SIZE >> level) and banded.wrap == wrap
    for name, array in expected[level].svbrdf.arrays().items():
        if name != "height":
            # Averages are sums whose order goes around the border; what is fitted is the same to the bit.
            limit = 0.0 if method == "bfgs" else 2e-6
            assert float(np.abs(getattr(banded, name) - array).max()) <= limit, name


def test_strokes_become_anisotropic_roughness(strokes, tmp_path):
    report = bake_levels_from(strokes, tmp_path, 2, preview=False, **READING)
    manifest = json.loads((tmp_path / "strokes" / "manifest.json").read_text())
    figures = manifest["levels_from"]
    assert figures["level"] == 2 and figures["size"] == [SIZE, SIZE]
    assert figures["snr_db"] > figures["averaged_snr_db"] + 3.0
    assert {each["role"] for each in manifest["inputs"]} >= {"height", "base_color", "roughness", "metallic"}
    normal = read_mip_exr(tmp_path / "strokes" / "normal.exr", ("X", "Y", "Z"))
    assert normal[0].shape == (SIZE // 4, SIZE // 4, 3)
    across, along = eigenvalues_of_log(report.baked.lobes[0].svbrdf.log_roughness)
    assert float(np.median(across / along)) > 2.0
    assert any("memory predicted" in note for note in report.notes)


def test_a_picture_shows_fit_beside_averaged_and_truth(strokes, tmp_path):
    bake_levels_from(strokes, tmp_path, 1, method="lean", **READING)
    assert read_image(tmp_path / "strokes" / "preview.png").width > 400


def test_a_height_file_is_a_set_and_its_unknown_scale_is_told(tmp_path):
    report = bake_levels_from(height_file(tmp_path), tmp_path / "out", 2, method="lean", preview=False)
    assert report.folder.name == "Scratches_Height"
    assert any(
        "is taken to span 1.3 texels (2% of the longer side); give height-scale" in each for each in report.notes
    )
    assert any("no roughness or gloss map" in each for each in report.notes)


@pytest.mark.parametrize("suffix", ["png", "exr"])
def test_rows_are_those_of_the_picture(tmp_path, suffix):
    path = tmp_path / f"height.{suffix}"
    if suffix == "png":
        write_png(path, np.random.default_rng(0).integers(0, 65536, (70, 40, 2)).astype(np.uint16))
    else:
        sizes = [(70, 130), (35, 65), (17, 32), (8, 16), (4, 8), (2, 4), (1, 2), (1, 1)]
        write_mip_exr(path, [np.random.default_rng(1).random((*size, 1), np.float32) for size in sizes], ["Y"])
    whole = read_image(path).pixels
    with ImageRows(path) as file:
        # Forward and back again, across the borders of tiles.
        for first, last in ((0, 7), (60, 70), (3, 66), (69, 70)):
            assert np.array_equal(file.read(first, last), whole[first:last])


def test_a_band_tells_a_channel_as_the_whole_does(tmp_path, monkeypatch):
    level = small_bands(monkeypatch, texels=64 * 16)
    pixels = np.repeat(np.random.default_rng(5).integers(0, 65536, (64, 64, 1)), 3, axis=2).astype(np.uint16)
    pixels[:3, :, 1] //= 2
    write_png(tmp_path / "Some_Height.png", pixels)
    with LargeSet(open_large(tmp_path, READING), level, 0.05) as large:
        banded, before = large.lobes(32, 48)
    whole = to_svbrdf(open_large(tmp_path, READING), min_roughness=0.05)
    assert np.array_equal(banded.normal[before : before + 16], whole.normal[32:48])


@pytest.mark.parametrize(("apart", "told"), [(2, False), (90, True)], ids=["rounding", "other colours"])
def test_a_large_set_takes_the_channel_and_the_range_that_the_whole_does(tmp_path, monkeypatch, apart, told):
    """Channels that differ by rounding, as a JPEG's do, are one quantity; the others' range does not count."""
    level = small_bands(monkeypatch, texels=64 * 16)
    pixels = np.repeat(np.random.default_rng(6).integers(100, 121, (64, 64, 1)), 3, axis=2)
    pixels[:3] += np.array([-apart // 2, 0, apart])
    write_png(tmp_path / "Some_Height.png", pixels.astype(np.uint8))
    texture_set = open_large(tmp_path, {})
    with LargeSet(texture_set, level, 0.05) as large:
        banded = [large.lobes(first, last) for first, last in ((0, 16), (32, 48))]
    assert any("differ" in note for note in texture_set.notes) == told
    whole = to_svbrdf(open_large(tmp_path, {}), min_roughness=0.05)
    for (lobes, before), first in zip(banded, (0, 32), strict=True):
        assert np.array_equal(lobes.normal[before : before + 16], whole.normal[first : first + 16])


def test_levels_that_there_are_not_are_refused(tmp_path):
    path = height_file(tmp_path)
    found = CliRunner().invoke(main, ["bake", str(path), "-o", str(tmp_path / "out"), "--levels-from", "7"])
    assert found.exit_code == 1 and "levels cannot be taken from 7 on, expected 1 to 6" in found.output, found.output
    assert not (tmp_path / "out").exists()


def exr_levels(pixels):
    """Levels of an EXR whose level 0 has the pixels (h, w)."""
    levels = [pixels[:, :, None].astype(np.float32)]
    while max(levels[-1].shape[:2]) > 1:
        height, width = (max(length // 2, 1) for length in levels[-1].shape[:2])
        levels.append(np.zeros((height, width, 1), np.float32))
    return levels


@pytest.mark.parametrize("tile", [True, False])
def test_resampled_rows_hold_constants_lines_and_ranges(tmp_path, tile):
    row, column = np.indices((60, 75))
    for k, pixels in enumerate([np.full((60, 75), 0.3), 2.0 * row - 3.0 * column, np.sin(7.0 * row + column**2)]):
        path = tmp_path / f"{k}.exr"
        write_mip_exr(path, exr_levels(pixels), ["Y"])
        with ImageRows(path) as file:
            resampled = ResampledRows(file, (64, 72), tile)
            found = resampled.read(0, 64)[:, :, 0]
            pieces = [resampled.read(first, last)[:, :, 0] for first, last in ((0, 1), (1, 40), (40, 64))]
        assert np.array_equal(found, np.concatenate(pieces))
        assert pixels.min() - 1e-6 <= found.min() and found.max() <= pixels.max() + 1e-6
        if k == 1:
            y, x = np.indices((64, 72)) + 0.5
            line = 2.0 * (y * 60 / 64 - 0.5) - 3.0 * (x * 75 / 72 - 0.5)
            assert np.abs(found - line)[3:-3, 3:-3].max() < 1e-4
        if k == 0:
            assert np.ptp(found) < 1e-7


@pytest.mark.parametrize("wrap", ["tile", "clamp"])
def test_slopes_stay_where_sides_are_resampled(tmp_path, monkeypatch, wrap):
    """Of waves along both axes, each side changed by another factor: in the middle, and across the border of a tile."""
    level = small_bands(monkeypatch, level=3, texels=64 * 16)
    height, width = 60, 75
    row, column = np.indices((height, width)) + 0.5
    pixels = 0.5 + 0.25 * np.sin(2.0 * np.pi * column / width) + 0.25 * np.cos(2.0 * np.pi * row / height)
    write_mip_exr(tmp_path / "waves_height.exr", exr_levels(pixels), ["Y"])
    with LargeSet(open_large(tmp_path, {"height_scale": 8.0, "wrap": wrap}), level, 0.05) as large:
        assert large.base == (64, 72) and large.size == (8, 9) and len(large.bands) == 8
        bands = [large.lobes(first << level, last << level) for first, last in large.bands]
        found = np.concatenate([
            each.normal[before : before + 8] for each, before in bands
        ])  # fmt: skip
    y, x = np.indices((64, 72)) + 0.5
    across = 2.0 * np.cos(2.0 * np.pi * x / 72) * 2.0 * np.pi / width
    down = -2.0 * np.sin(2.0 * np.pi * y / 64) * 2.0 * np.pi / height
    expected = np.stack([-across, down, np.ones_like(across)], axis=2)
    expected /= np.linalg.norm(expected, axis=2, keepdims=True)
    wrong = np.abs(found - expected).max(axis=2)
    # Differences of neighbours are smaller than derivatives by (2 pi / 64)^2 / 6, 0.002 of them.
    assert (wrong if wrap == "tile" else wrong[3:-3, 3:-3]).max() < 1e-3


def test_sides_that_are_no_multiples_are_resampled_and_told(tmp_path):
    path = height_file(tmp_path, (60, 67))
    report = bake_levels_from(path, tmp_path / "out", 3, method="lean", preview=False)
    told = "Sides must be multiples of 8: 67x60 texels are resampled to 64x64, with the slopes that they have."
    assert told in report.notes
    assert report.baked.lobes[0].svbrdf.size == (8, 8)
    assert report.manifest["levels_from"]["size"] == [67, 60]


def test_sets_that_cannot_be_read_in_rows_are_refused(tmp_path):
    folder = make_set("hammered-metal", tmp_path / "hammered-metal", 32)
    with pytest.raises(InputError, match="has a normal map.*give the height map's file instead"):
        bake_levels_from(folder, tmp_path / "out", 1)
    flat = tmp_path / "flat"
    make_set("plaster-wall", flat, 32)
    (height,) = flat.glob("*Height*")
    height.unlink()
    with pytest.raises(InputError, match="has no height map"):
        bake_levels_from(flat, tmp_path / "out", 1)
    mixed = tmp_path / "mixed"
    mixed.mkdir()
    height_file(mixed)
    write_png(mixed / "Scratches_Roughness.png", np.full((32, 32), 90, np.uint8) + np.arange(32, dtype=np.uint8))
    with pytest.raises(InputError, match="is 32x32, expected 64x64 as the largest map"):
        bake_levels_from(mixed, tmp_path / "out", 1)
    with pytest.raises(InputError, match="expected 1 or more"):
        bake_levels_from(mixed, tmp_path / "out", 0)
    with pytest.raises(UnknownNameError):
        bake_levels_from(mixed, tmp_path / "out", 1, method="nothing")


def test_a_damaged_height_leaves_nothing(tmp_path):
    path = height_file(tmp_path)
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match="truncated or damaged"):
        bake_levels_from(path, tmp_path / "out", 2, preview=False)
    assert not (tmp_path / "out").exists()
    bad = np.ones((8, 8, 1), np.float32)
    bad[5, 5] = np.nan
    write_mip_exr(tmp_path / "x_height.exr", [bad, *(np.ones((k, k, 1), np.float32) for k in (4, 2, 1))], ["Y"])
    with pytest.raises(InputError, match="holds NaN or infinity in rows 0 to 8"):
        bake_levels_from(tmp_path / "x_height.exr", tmp_path / "out", 1, preview=False)


def test_what_memory_does_not_hold_is_refused_before_the_run(strokes, tmp_path, monkeypatch):
    monkeypatch.setattr(reduction, "free_memory", lambda: 100 << 20)
    monkeypatch.setattr(reduction, "BYTES_PER_TEXEL", 12000)
    with pytest.raises(InputError, match=r"128x128 texels become 32x32 in about 0.26 GiB.* 0.10 GiB are free"):
        bake_levels_from(strokes, tmp_path, 2, **READING)


_MEASURE = """
import sys
from pathlib import Path
from brdffit.methods import get_method
from brdffit.pipeline import bake_options
from brdffit.reduction import bake_levels_from, predicted_memory
from brdffit.textures import rows
from brdffit.textures.rows import LargeSet, open_large

folder, out, small = sys.argv[1:]
def memory(kind):
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(kind))
    return int(line.split()[1]) * 1024
rows.BAND_TEXELS = 1 << 19
bake_levels_from(small, out, 3, height_scale=5.0, quality="draft")
# What compiling took is forgotten: the peak begins anew at what is held now.
Path("/proc/self/clear_refs").write_text("5")
before = memory("VmRSS")
with LargeSet(open_large(folder, {}), 3, 0.05) as large:
    predicted = predicted_memory(large)
bake_levels_from(folder, out, 3, height_scale=5.0, quality="draft")
print(predicted, memory("VmHWM") - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the peak can be reset on Linux alone")
def test_memory_stays_within_what_was_predicted(strokes, tmp_path):
    pixels = np.random.default_rng(1).integers(0, 65536, (2048, 2048)).astype(np.uint16)
    write_png(tmp_path / "Large_Height.png", pixels)
    command = [sys.executable, "-c", _MEASURE, str(tmp_path / "Large_Height.png"), str(tmp_path / "out"), str(strokes)]
    found = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parent.parent)
    predicted, grown = map(int, found.stdout.split())
    # All of it at once takes 240 bytes a texel (library.pool).
    assert 0.3 * predicted < grown < predicted < 2048 * 2048 * 240, (predicted, grown)
