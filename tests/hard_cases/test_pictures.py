"""Pictures of the cases are drawn, for every shape of footprint."""

import pytest

from hard_cases.catalogue import CASES
from hard_cases.pictures import draw


@pytest.mark.parametrize("name", ["mirror on spread normals", "no specular", "one texel", "shapes at both bounds"])
def test_a_case_is_drawn(name, tmp_path):
    (case,) = [each for each in CASES if each.name == name]
    draw(case, case.models[0], tmp_path / "case.png")
    assert (tmp_path / "case.png").stat().st_size > 5000
