"""A result without lobes goes the whole road: bake, compare and library; what needs lobes is left out, and said."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from click.testing import CliRunner
from library_support import write_maps
from matt_method import MattOptions

from brdffit import bake
from brdffit.cli import main
from brdffit.comparison.compare import compare
from brdffit.comparison.options import CompareOptions
from brdffit.files.image_io import read_image, read_mip_exr
from brdffit.pipeline import bake_to_folder
from brdffit.report.records import read_records
from brdffit.report.writing import write_report

MATT = "matt_method:Matt"


@pytest.fixture
def folder(tmp_path):
    return write_maps(tmp_path / "in" / "wall", size=16)


def test_a_bake_writes_what_holds_it_and_draws_it(folder, tmp_path):
    report = bake_to_folder(folder, tmp_path / "out", method=MATT, gain=0.5)
    files = sorted(path.relative_to(report.folder).as_posix() for path in report.folder.rglob("*"))
    assert files == ["colour.exr", "manifest.json", "preview.png"]
    manifest = json.loads((report.folder / "manifest.json").read_text())
    assert manifest["model"] is None and manifest["options"]["gain"] == 0.5 and manifest["pictures"] == {}
    assert [(level["width"], level["height"]) for level in manifest["levels"]] == [(16 >> k, 16 >> k) for k in range(5)]
    assert not any("snr_db" in level for level in manifest["levels"]) and "It is matt." in manifest["notes"]
    stored = read_mip_exr(report.folder / "colour.exr", ("R", "G", "B"))
    whole = stored[0].mean(axis=(0, 1))
    np.testing.assert_allclose(stored[-1][0, 0], whole, rtol=1e-4)
    assert float(read_image(report.folder / "preview.png").pixels.std()) > 0.05
    assert bake(folder, method=MATT).options == MattOptions()


def test_the_command_bakes_and_prints_it(folder, tmp_path):
    result = CliRunner().invoke(
        main, ["bake", str(folder), "-o", str(tmp_path), "--method", MATT, "--set", "matt.gain=2"]
    )
    assert result.exit_code == 0, result.output
    assert "It is matt." in result.output
    engine = CliRunner().invoke(main, ["bake", str(folder), "-o", str(tmp_path), "--method", MATT, "--preset", "unity"])
    assert "there are none for the preset 'unity'" in engine.output and ".meta" not in engine.output
    refused = CliRunner().invoke(main, ["bake", str(folder), "--method", MATT, "--model", "beckmann"])
    assert refused.exit_code == 2 and "no option 'model'" in refused.output


def test_it_is_compared_with_the_others(folder, tmp_path):
    ask = CompareOptions(methods=("naive", MATT), pixels=12, frames=4, texels=4, pairs=16, lobes=2, samples="draft")
    comparison, pictures, _ = compare([folder], ask)
    (result,) = comparison.sets
    naive, matt = result.methods
    assert naive.maps and naive.levels[0].half_angle_snr_db is not None
    assert not matt.maps and all(level.half_angle_snr_db is None for level in matt.levels)
    assert any("no lobes" in note for note in matt.notes)
    for view in result.views:
        assert MATT in {shot.method for shot in view.shots}
    page = write_report(comparison, pictures, tmp_path / "report")
    assert page.exists() and read_records(page.with_name("records.json")) is not None


def test_a_library_holds_it(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([os.path.dirname(__file__), os.environ.get("PYTHONPATH", "")]))
    arguments = ["library", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--method", MATT, "--workers", "1"]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    assert (tmp_path / "out" / "wall" / "colour.exr").exists() and (tmp_path / "out" / "index.html").exists()


def test_records_of_levels_that_are_seen_can_be_read_again(folder, tmp_path):
    """What a scene asks for, the first and last level, is several numbers; records hold one value each."""
    ask = CompareOptions(methods=("naive",), pixels=12, frames=4, texels=4, pairs=16, lobes=2, samples="draft",
              options={"fit.reach": (1, 2)})  # fmt: skip
    page = write_report(*compare([folder], ask)[:2], tmp_path / "report")
    assert read_records(page.with_name("records.json")).options["reach"] == "1,2"
