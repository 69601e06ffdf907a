"""The Pareto front in time and accuracy, the price of each dB along it, and the settings that it suggests."""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec

from brdffit.halfangle.measure import PERFECT_DB
from brdffit.tradeoff.candidates import SETTING
from brdffit.tradeoff.record import Choice, Point

#: A candidate must gain this much (dB) over a faster one to be on the front: less is noise of the sample.
WORTH = 0.005


def with_front(points: Sequence[Point]) -> list[Point]:
    """The points of one set with ``front`` and ``price`` filled in, in the same order."""
    best, last = float("-inf"), None
    found: dict[int, float | None] = {}
    for point in sorted(points, key=lambda each: (each.seconds_per_megatexel, -each.snr_db)):
        if point.snr_db > best + WORTH:
            price = None
            if last is not None:
                price = (point.seconds_per_megatexel - last.seconds_per_megatexel) / (point.snr_db - last.snr_db)
            found[id(point)] = price
            best, last = point.snr_db, point
    return [msgspec.structs.replace(point, front=id(point) in found, price=found.get(id(point))) for point in points]


#: What each preset may lose to the best candidate, in dB.
ALLOWED = {"draft": 0.5, "standard": 0.1, "fine": 0.02}


def choices(points: Sequence[Point]) -> list[Choice]:
    """For each preset the cheapest setting that loses no more than ``ALLOWED`` over all sets, and the preset itself.

    If none stays within that, the setting that loses least is taken.
    """
    sets: dict[str, list[Point]] = {}
    for point in points:
        sets.setdefault(point.set, []).append(point)
    figures: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for own in sets.values():
        best = max(_seen_db(point) for point in own)
        usual = next((point.seconds_per_megatexel for point in own if _is(point, "preset", "standard")), None)
        if usual is None:
            continue
        for point in own:
            cost = math.log(point.seconds_per_megatexel / usual)
            figures.setdefault((point.group, point.name), []).append((cost, best - _seen_db(point)))
    found = {key: _summary(each) for key, each in figures.items() if len(each) == len(sets)}
    chosen = []
    for preset, allowed in ALLOWED.items():
        settings = {name: each for (group, name), each in found.items() if group == SETTING}
        if settings and ("preset", preset) in found:
            within = {name: each for name, each in settings.items() if each[1] <= allowed}
            among, figure = (within, 0) if within else (settings, 1)
            name = min(among, key=lambda each: among[each][figure])
            chosen.append(Choice(preset, allowed, name, *settings[name], *found["preset", preset]))
    return chosen


def _summary(figures: Sequence[tuple[float, float]]) -> tuple[float, float, float]:
    """(cost, mean dB behind, worst dB behind) of (log cost, dB behind) of each set."""
    return (
        math.exp(sum(cost for cost, _ in figures) / len(figures)),
        sum(behind for _, behind in figures) / len(figures),
        max(behind for _, behind in figures),
    )


def _seen_db(point: Point) -> float:
    return sum(min(decibels, PERFECT_DB) for decibels in point.levels_db) / len(point.levels_db)


def _is(point: Point, group: str, name: str) -> bool:
    return (point.group, point.name) == (group, name)
