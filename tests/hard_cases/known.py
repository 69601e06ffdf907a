"""Violations that are known, each with its reason: tests of them must fail, and say so when they no longer do."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from hard_cases.catalogue import PAIRS, QUICK, Case

_UNCUT = "the fitted lobe is not cut at its own horizon (n.h > 0): its mirror image serves what a shader never shows"
_ROOM = "512 samples on 4x4 texels of needles, 320 nodes: the rule's two halves agree on a lobe that the truth refuses"

KNOWN: dict[tuple[str, str, str], str] = {
    ("start", "steep valley", "ggx"): _UNCUT,
    ("start", "steep valley", "blinn-phong"): _UNCUT,
    ("start", "steep valley", "ashikhmin-shirley"): _UNCUT,
    ("start", "negative weights on needles", "generalised-beckmann"): _ROOM,
    ("turned", "grooves of needles", "ggx"): _UNCUT,
    ("turned", "steep valley", "ggx"): _UNCUT,
    ("turned", "steep valley", "blinn-phong"): _UNCUT,
    ("turned", "two channels", "generalised-beckmann"): _UNCUT,
    ("turned", "steep beside upright", "ggx"): _UNCUT,
    ("turned", "horizon beside upright", "ggx"): _UNCUT,
    ("turned", "roughness one", "ggx"): _UNCUT,
    ("continuous", "steep valley", "ashikhmin-shirley"): _UNCUT,
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
