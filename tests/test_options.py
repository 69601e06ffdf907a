"""Options of methods: their names, their values, and what is said of those that cannot be."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import pytest

from brdffit.errors import UnknownNameError
from brdffit.fitting.options import FitOptions
from brdffit.methods import get_method, method_names
from brdffit.options import (
    BakeOptions,
    LobeOptions,
    OptionError,
    changed_options,
    described,
    flat,
    known_options,
    make_options,
    merged,
    option,
    parse_settings,
    refuse_unknown,
)


@dataclass(frozen=True)
class OwnOptions(BakeOptions):
    """Of a method that bakes no lobes."""

    group: ClassVar[str] = "own"

    threshold: float = option(0.5, "where it stops", least=0.0, most=1.0)
    sizes: tuple[int, ...] = option((1, 2), "several of them")


@pytest.mark.parametrize("name", method_names())
def test_every_option_is_described_and_admits_its_default(name):
    kind = get_method(name).options
    for each in described(kind).values():
        assert each.says and each.values
        assert make_options(kind, {each.full_name: each.default}, name) == kind()


def test_text_is_read_as_the_type_of_the_option():
    found = make_options(
        FitOptions,
        {"levels": "3", "keep_level_0": "yes", "fit.tolerance": "0.5", "fit.reach": "1,4", "fit.loss": "l1"},
        "bfgs",
    )
    assert found == FitOptions(levels=3, keep_level_0=True, tolerance=0.5, reach=(1, 4), loss="l1")
    assert make_options(FitOptions, {"levels": "none", "fit.reach": "none"}, "bfgs") == FitOptions()
    assert make_options(OwnOptions, {"own.sizes": "3,4,5", "own.threshold": 1}, "own").sizes == (3, 4, 5)


def test_a_name_may_stand_without_its_group_and_with_dashes():
    assert make_options(FitOptions, {"loss": "l1"}, "bfgs") == make_options(FitOptions, {"fit.loss": "l1"}, "bfgs")
    assert make_options(LobeOptions, {"min-roughness": 0.2}, "lean").min_roughness == 0.2


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"fit.los": "l1"}, "did you mean 'fit.loss'"),
        ({"los": "l1"}, "did you mean 'fit.loss'"),
        ({"own.loss": "l1"}, "no option 'own.loss'"),
        ({"level": 1}, "did you mean 'levels'"),
        ({"fit.loss": "l3"}, "did you mean 'l2'"),
        ({"levels": 0}, "at least 1"),
        ({"levels": 1.5}, "whole number"),
        ({"levels": "many"}, "whole number"),
        ({"min_roughness": 0.0}, "above 0 and at most 1"),
        ({"fit.tolerance": math.nan}, "above 0"),
        ({"keep_level_0": "perhaps"}, "true or false"),
        ({"fit.tolerance": "inf"}, "above 0"),
        ({"fit.reach": "1"}, "a,b"),
        ({"fit.lights": "banana"}, "'fit.lights': 'banana' is no light"),
        ({"fit.lights": "91"}, "a radius of 0 to 90 degrees"),
        ({"fit.reach": "none of them"}, "a,b"),
        ({"loss": "l1", "fit.loss": "l2"}, "given twice"),
        ({"model": "ggy"}, "did you mean 'ggx'"),
    ],
)
def test_what_cannot_be_is_told_in_one_sentence(given, told):
    with pytest.raises(OptionError, match=told) as found:
        make_options(FitOptions, given, "'bfgs'")
    assert isinstance(found.value, UnknownNameError) and "\n" not in str(found.value)


def test_several_methods_share_what_they_know():
    given = {"fit.loss": "l1", "threshold": 0.25, "levels": 2}
    assert known_options(OwnOptions, given) == {"threshold": 0.25, "levels": 2}
    refuse_unknown({"own": OwnOptions, "bfgs": FitOptions}, given)
    with pytest.raises(OptionError, match=r"fit\.loss"):
        refuse_unknown({"own": OwnOptions, "lean": LobeOptions}, given)


def test_later_options_win_however_they_are_spelled():
    assert merged({"fit.loss": "l1", "levels": 2}, {"loss": "l2"}) == {"levels": 2, "loss": "l2"}
    assert merged({"fit.loss": "l1"}, {"own.loss": 3}) == {"fit.loss": "l1", "own.loss": 3}


def test_tables_and_pairs_are_flat_names():
    assert dict(flat({"levels": 2, "fit": {"loss": "l1", "reach": [0, 1]}})) == {
        "levels": 2, "fit.loss": "l1", "fit.reach": [0, 1],
    }  # fmt: skip
    assert parse_settings(["fit.loss=l1", "levels = 3"]) == {"fit.loss": "l1", "levels": "3"}
    for wrong in (["loss"], ["=l1"], ["loss="], ["a=1", "a=2"]):
        with pytest.raises(OptionError):
            parse_settings(wrong)


def test_only_what_differs_is_recorded():
    assert changed_options(FitOptions(loss="l1", threads=3)) == {"loss": "l1"}
