"""A comparison with a traced height: maps against parallax and shadows, level by level, in records, table and page."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from brdffit.cli import main
from brdffit.comparison.compare import compare
from brdffit.comparison.options import CompareOptions
from brdffit.comparison.traced import METHODS, methods_of_table, traced_truth
from brdffit.errors import InputError
from brdffit.planning.run import traced_effects
from brdffit.planning.traced import OFF
from brdffit.report.page import render_page
from brdffit.report.records import LEVEL_GROUP
from brdffit.report.summary import level_table
from brdffit.report.writing import read_report
from brdffit.textures.procedural import make_set
from tests.test_microgeometry import bumps, material

ASK = dataclasses.replace(
    CompareOptions.of(methods=["naive", "lean"], quick=True),
    pixels=32,
    texels=4,
    pairs=16,
    lobes=1,
    lit=("small lights",),
)


def test_maps_are_held_against_the_height_level_by_level():
    deep, flat = material(bumps(32, 3.0), specular=0.0), material(np.zeros((32, 32)), specular=0.0)
    comparison, pictures, _ = compare([deep, flat], dataclasses.replace(ASK, truth=traced_truth))
    rows = [dict(level_table(result.views)) for result in comparison.sets]
    assert [set(each) for each in rows] == [{"naive", "lean"}] * 2
    assert len(rows[0]["lean"]) == 6
    for (mse, snr, flip), (none, best, _) in zip(rows[0]["lean"], rows[1]["lean"], strict=True):
        # A flat plane is shown by its maps; hills are not.
        assert abs(none) < 1e-4 and best > 30.0
        assert snr < best
        assert flip >= 0.0 and np.isfinite(mse)
    assert rows[0]["lean"][0][0] > 1.0
    views = [view for view in comparison.sets[0].views if view.group == LEVEL_GROUP]
    assert len(views) == 6 and all(shot.picture in pictures for shot in views[0].shots)
    assert "against the height traced as a surface" in render_page(comparison, pictures)


def test_a_set_without_a_height_is_refused():
    with pytest.raises(InputError, match="needs a height map"):
        compare([material(np.zeros((8, 8))).replace(height=None)], dataclasses.replace(ASK, truth=traced_truth))


def test_methods_of_the_table_stand_where_none_are_named():
    assert methods_of_table({"quality": "draft"}) == METHODS
    assert methods_of_table({"neural.file": "some.npz"}) == (*METHODS, "neural")


@pytest.mark.slow
def test_a_neural_material_from_a_file_is_a_method_of_the_table(tmp_path, monkeypatch):
    make_set("pebbles", tmp_path / "pebbles", 32)
    file, report = tmp_path / "pebbles.npz", tmp_path / "report"
    train = ["neural", "train", str(tmp_path / "pebbles"), "-o", str(file), "--size", "16", "--steps", "4"]
    assert CliRunner().invoke(main, train, catch_exceptions=False).exit_code == 0
    asked = ["compare", str(tmp_path / "pebbles"), "--truth", "microgeometry", "--quick", "-o", str(report)]
    asked += ["--methods", "lean,neural", "--set", f"neural.file={file}"]
    monkeypatch.setattr("sys.argv", ["brdffit", *asked])
    of = CompareOptions.of
    monkeypatch.setattr(
        CompareOptions,
        "of",
        lambda **given: dataclasses.replace(of(**given), pixels=32, frames=4, texels=4, pairs=16, lobes=1),
    )
    found = CliRunner().invoke(main, asked, catch_exceptions=False)
    assert found.exit_code == 0 and "traced, at 45 degrees" in found.output
    assert f"The neural material is that of '{file}'" in found.output
    comparison = read_report(report).comparison
    rows = dict(level_table(comparison.sets[0].views))
    assert list(rows) == ["lean", "neural"] and len(rows["neural"]) == 6
    assert all(np.isfinite(figures).all() for figures in rows["neural"])


def test_surfaces_of_a_scene_are_compared_with_what_their_plan_calls_for(tmp_path):
    plan = SimpleNamespace(
        options={}, unread=(), terms=(), environment=False,
        effects=[SimpleNamespace(name=name, on=name == "parallax") for name in (*OFF, "normals")],
    )  # fmt: skip
    effects = traced_effects(plan)
    assert effects is not None and effects.displacement and not effects.shadowing and effects.bounces == 0
    plan.effects = [SimpleNamespace(name=name, on=name == "normals") for name in (*OFF, "normals")]
    assert traced_effects(plan) is None
