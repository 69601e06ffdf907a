"""Violations that are known, each with its reason: tests of them must fail, and say so when they no longer do."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from lobe_oracle import MODELS

from hard_cases.catalogue import PAIRS, QUICK, Case

_OPTIMA = "optima up to a third of the error apart: which one is found depends on where the nodes stand"
_RESEARCHED = (
    "a texel that misses most of its target is searched again from its peaks: on needles the fit's nodes prefer a lobe "
    "that a denser rule finds a seventh worse than the start (0.71 against 0.62 of the target)"
)
_STRATA = "two samples a texel, cut where normals turn but not where roughness jumps: the sharpest lobe is never seen"

_STREAK = (
    "normals between two sharp texels form a streak; the lobe found follows it and shines beyond its ends, where "
    "the fit takes the target for brighter than it is (test_mirrors counts them)"
)
_STEEP = "as above, between normals at or near the horizon"
_DARK = "at levels 0 and 1 the dark beside a lobe weighs more, where few nodes stand (losses.BALANCED)"

_JUMPS = "roughness that jumps from texel to texel"
KNOWN: dict[tuple[str, str, str], str] = {
    ("turned", "horizon beside upright", "ggx"): _OPTIMA,
    ("turned", "steep valley", "blinn-phong"): _OPTIMA,
    ("start", "negative weights on needles", "blinn-phong"): _RESEARCHED,
    ("seen: believed", "steep beside upright", "ggx"): _STEEP,
    **{(law, "two needles far apart", "ggx"): _STREAK for law in ("seen: believed", "seen: turned")},
    **{(law, "grooves of needles", "ggx"): _STREAK for law in ("seen: believed", "seen: turned")},
    ("seen: continuous", "two channels", "ggx"): _DARK,
    **{("seen: turned", case, "ggx"): _DARK for case in ("steep valley", "all steep")},
    **{("seen: continuous", case, "ggx"): _STREAK for case in ("two needles far apart", "grooves of needles")},
    **{
        (law, case, "ggx"): _STEEP
        for law in ("seen: continuous", "seen: turned")
        for case in ("steep beside upright", "horizon beside upright")
    },
    ("seen: continuous", "steep valley", "ggx"): _STEEP,
    **{("believed", _JUMPS, model): _STRATA for model in MODELS},
}


def pairs_of(
    law: str, holds_for: Callable[[Case], bool] = lambda case: True, slow: bool = False
) -> pytest.MarkDecorator:
    """Parameters (case, model) of a law: known violations are marked, and most models are left to the slow tests."""
    parameters = []
    for case, model in PAIRS:
        if not holds_for(case):
            continue
        reason = KNOWN.get((law, case.name, model))
        marks = [pytest.mark.xfail(strict=True, reason=reason)] if reason else []
        if slow or (case.name, model) not in QUICK:
            marks.append(pytest.mark.slow)
        parameters.append(pytest.param(case, model, marks=marks, id=f"{case.name.replace(' ', '-')}-{model}"))
    return pytest.mark.parametrize("case, model", parameters)
