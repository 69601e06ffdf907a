"""What an engine looks up: its error, the fit for it, and the page that compares all methods."""

import json

import numpy as np
import pytest
from probes_support import lamps, latlong, write_exr

from brdffit.probes.compare import compare_to_folder
from brdffit.probes.cubemap import directions, look_up_trilinear
from brdffit.probes.curves import get_curve
from brdffit.probes.filtering import FilterOptions, filter_levels, level_requests
from brdffit.probes.lookup import _bilinear, fitted_to_lookup, lookup_errors, random_directions
from brdffit.probes.tree import Tree


def made(cube, curve):
    requests = level_requests(curve, cube.shape[1], cube.shape[1])
    return [each.radiance for each in filter_levels(cube, requests, FilterOptions(tolerance=0.002), measure=False)]


def test_the_rows_of_the_fit_are_what_a_shader_reads():
    cube = lamps(16).astype(np.float64)
    at = np.concatenate([random_directions(300, 0), directions(16)[:, :2, :2].reshape(-1, 3) + 0.01])
    read = _bilinear(at, 16) @ cube.reshape(-1, 3)
    np.testing.assert_allclose(read, look_up_trilinear([cube], at, np.zeros(len(at))), rtol=1e-9)


def test_a_constant_is_looked_up_without_error_and_stays():
    curve = get_curve("quadratic", 4, 32)
    cube = np.full((6, 32, 32, 3), 0.4, np.float32)
    levels = made(cube, curve)
    assert lookup_errors(Tree(cube), levels, curve, count=50).max() < 1e-5
    fitted, before, after = fitted_to_lookup(cube, levels, curve)
    assert max(before, after) < 1e-5
    np.testing.assert_allclose(np.concatenate([level.ravel() for level in fitted]), 0.4, rtol=1e-5)


def test_fitted_levels_are_read_better_by_a_fifth():
    curve = get_curve("quadratic", 5, 32)
    cube = lamps(32, bright=60.0)
    levels = made(cube, curve)
    fitted, before, after = fitted_to_lookup(cube, levels, curve)
    assert after < 0.8 * before
    np.testing.assert_array_equal(fitted[0], levels[0])
    assert all(level.min() >= 0.0 for level in fitted)


@pytest.mark.slow
def test_the_page_compares_everything(tmp_path):
    picture = latlong(64)
    # Bright enough that the lamp is what a table errs by.
    picture[20, 40] = 20000.0
    write_exr(tmp_path / "room.exr", picture)
    page = compare_to_folder([tmp_path / "room.exr"], tmp_path / "report", True, 1, lambda line: None)
    assert {each.name for each in page.parent.iterdir()} == {
        "index.html", "records.json", "front.png", "points.png", "levels-room.png", "searches.png",
    }  # fmt: skip
    records = json.loads((page.parent / "records.json").read_text())
    error = {each["method"]: each["error"] for each in records["methods"]}
    assert error["tree 0.005"] < 0.005 and error["tree 0.001"] < 0.001
    # What Manson and Sloan name as an extension: bright texels apart.
    assert error["ggx-const-8, split 10"] < 0.5 * error["ggx-const-8"]
    harmonics = {each["order"]: round(each["error"], 4) for each in records["preimages"]["harmonics"]}
    assert harmonics == {3: 0.1227, 5: 0.0593, 7: 0.0358, 9: 0.0243, 11: 0.0177}
    text = page.read_text()
    assert "0.1111" in text and "importance 1024" in text and "split sum" in text
