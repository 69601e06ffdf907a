"""Means over sets of what the records hold: the tables of the page and of the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from brdffit.report.records import MOST_DB, Comparison, Figures, SetResult, View

#: What the summary's columns stand under, and the lighting of its pictures (None: pairs of light and viewer).
GROUPS: tuple[tuple[str, str | None], ...] = (
    ("light and viewer pairs", None),
    ("small lights", "small lights"),
    ("environment", "environment"),
)
DISTANCES = ("near", "mid", "far")


class Cell(NamedTuple):
    """A mean over ``sets`` sets; ``best`` where it is the first of its column among the methods that have all sets."""

    value: float | None
    sets: int
    best: bool


class Row(NamedTuple):
    """One method: its cells in the order of ``columns``, mean seconds of a bake, mean half-angle SNR over naive."""

    method: str
    cells: list[Cell]
    seconds: float | None
    gain: float | None


def columns() -> list[tuple[str, str]]:
    """(group, distance) of the summary's columns."""
    return [(group, distance) for group, _ in GROUPS for distance in DISTANCES]


def summary(comparison: Comparison) -> list[Row]:
    """SNR in dB of every method at near, mid and far, means over sets, in the order of the methods."""
    table = {
        name: [_values(comparison, name, lit, distance) for _, lit in GROUPS for distance in DISTANCES]
        for name in method_names(comparison)
    }
    best = [_best({name: values[i] for name, values in table.items()}, comparison) for i in range(len(columns()))]
    rows = []
    for name, values in table.items():
        cells = [Cell(_mean(each), len(each), name in best[i]) for i, each in enumerate(values)]
        rows.append(Row(name, cells, _mean(list(_seconds(comparison, name))), _gain(comparison, name)))
    return rows


def figure_of(view: View, method: str, figure: Callable[[Figures], float]) -> float | None:
    """One figure of one method's picture, or None."""
    for shot in view.shots:
        if shot.method == method and shot.figures is not None:
            return figure(shot.figures)
    return None


def view_of(result: SetResult, lit: str, distance: str) -> View | None:
    """The picture of a set from one distance under one lighting."""
    return next((view for view in result.views if view.lighting == lit and view.distance == distance), None)


def picture_snr(result: SetResult, method: str, lit: str, distance: str) -> float | None:
    """SNR in dB of a method's picture of a set."""
    view = view_of(result, lit, distance)
    return None if view is None else figure_of(view, method, lambda figures: figures.snr_db)


def differences(comparison: Comparison, other: str) -> dict[str, list[float]]:
    """SNR of the fit less that of another method, by distance, for each set and lighting (as Kemppinen, fig. 5)."""
    fit = fit_name(comparison)
    found: dict[str, list[float]] = {distance: [] for distance in DISTANCES}
    for result in comparison.sets:
        for _, lit in GROUPS[1:]:
            for distance in DISTANCES:
                ours, theirs = (picture_snr(result, name, lit or "", distance) for name in (fit, other))
                if ours is not None and theirs is not None:
                    found[distance].append(ours - theirs)
    return found


def fit_name(comparison: Comparison) -> str:
    """The method that the others are held against."""
    return next((info.name for info in comparison.methods if info.fit), comparison.methods[0].name)


def method_names(comparison: Comparison) -> list[str]:
    """Methods that baked at least one set, in the order of the tables."""
    able = {result.method for each in comparison.sets for result in each.methods}
    return [info.name for info in comparison.methods if info.name in able]


def _values(comparison: Comparison, method: str, lit: str | None, distance: str) -> list[float]:
    found = []
    for result in comparison.sets:
        if lit is not None:
            value = picture_snr(result, method, lit, distance)
        else:
            value = next(
                (
                    each.levels[result.distances[distance]].pair_snr_db
                    for each in result.methods
                    if each.method == method
                ),
                None,
            )
        if value is not None:
            found.append(value)
    return found


def _seconds(comparison: Comparison, method: str) -> Iterator[float]:
    for result in comparison.sets:
        yield from (each.seconds for each in result.methods if each.method == method)


def _gain(comparison: Comparison, method: str, base: str = "naive") -> float | None:
    """Mean over sets and distances of the half-angle SNR less that of the averaged maps."""
    found = []
    for result in comparison.sets:
        by_name = {each.method: each.levels for each in result.methods}
        if method not in by_name or base not in by_name:
            continue
        for level in result.distances.values():
            ours, theirs = (by_name[name][level].half_angle_snr_db for name in (method, base))
            if ours is not None and theirs is not None:
                found.append(ours - theirs)
    return _mean(found)


def _best(values: dict[str, list[float]], comparison: Comparison) -> set[str]:
    """Methods with the highest mean among those that have every set; none where nothing is right at all."""
    means = {name: _mean(each) for name, each in values.items() if len(each) == len(comparison.sets)}
    complete = {name: mean for name, mean in means.items() if mean is not None}
    return {name for name, mean in complete.items() if mean == max(complete.values()) and mean > -MOST_DB}


def _mean(values: list[float]) -> float | None:
    return sum(values) / len(values) if values else None
