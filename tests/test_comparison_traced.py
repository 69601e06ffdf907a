"""A comparison with a traced height: maps against parallax and shadows, level by level, in records, table and page."""

import dataclasses

import numpy as np
import pytest

from brdffit.comparison.compare import compare
from brdffit.comparison.options import CompareOptions
from brdffit.comparison.traced import METHODS, traced_truth, with_truth
from brdffit.errors import InputError
from brdffit.report.page import render_page
from brdffit.report.records import LEVEL_GROUP
from brdffit.report.summary import level_table
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
    comparison, pictures = compare([deep, flat], ASK, truth=traced_truth)
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
        compare([material(np.zeros((8, 8))).replace(height=None)], ASK, truth=traced_truth)


def test_methods_of_the_table_stand_where_none_are_named():
    assert with_truth(CompareOptions()).methods == METHODS
    assert with_truth(ASK).methods == ("naive", "lean")
