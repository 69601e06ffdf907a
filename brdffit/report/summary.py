"""Means of the records over sets: the tables of the page and of the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from brdffit.report.records import (
    KEPT_SUFFIX,
    LEVEL_GROUP,
    MOST_DB,
    PROBE_LIGHTING,
    Comparison,
    Figures,
    SetResult,
    View,
)

#: Headings of the summary's columns, and the lighting of their pictures (None: pairs of light and viewer).
GROUPS: tuple[tuple[str, str | None], ...] = (
    ("light and viewer pairs", None),
    ("small lights", "small lights"),
    ("lamps", "lamps"),
    ("environment", "environment"),
    ("through a probe", PROBE_LIGHTING),
)
DISTANCES = ("near", "mid", "far")


class Cell(NamedTuple):
    """A mean over ``sets`` sets; ``best`` where it is the first of its column among the methods that have all sets."""

    value: float | None
    sets: int
    best: bool


class Row(NamedTuple):
    """One method: cells in the order of ``groups``, near to far in each; seconds of a bake; gain over averaged maps."""

    method: str
    cells: list[Cell]
    seconds: float | None
    gain: float | None


class Overall(NamedTuple):
    """One method over all still views.

    Attributes:
        method: its name.
        views: how many views it is in.
        snr_db, flip, ssim: means.
        energy: least and most share of the reference's radiance that a view keeps.
        firsts: in how many views it is first in SNR, FLIP and SSIM; ties count for all.
        worst: the view with the least SNR, as "set, view", and that SNR in dB.
        seconds: mean of a bake, without its preparation.
        best: which of "snr_db", "flip" and "ssim" it is first in, and "snr_firsts", "flip_firsts", "ssim_firsts".
    """

    method: str
    views: int
    snr_db: float | None
    flip: float | None
    ssim: float | None
    energy: tuple[float, float] | None
    firsts: tuple[int, int, int]
    worst: tuple[str, float] | None
    seconds: float | None
    best: frozenset[str]


#: Figures in which methods are ranked, view by view: record's field, and 1 where more is better.
RANKED = (("snr_db", 1), ("flip_ldr", -1), ("ssim", 1))


def overall(comparison: Comparison) -> list[Overall]:
    """Every method over all still views of all sets but those through a probe, in the order of the methods."""
    names = method_names(comparison)
    views = [(result, view) for result in comparison.sets for view in still_views(result) if _shots(view)]
    firsts = {name: [0, 0, 0] for name in names}
    for _, view in views:
        for i, (field, sign) in enumerate(RANKED):
            values = {name: sign * getattr(figures, field) for name, figures in _shots(view).items()}
            for name, value in values.items():
                firsts[name][i] += value == max(values.values())
    rows = []
    for name in names:
        seen = [(result, view, _shots(view)[name]) for result, view in views if name in _shots(view)]
        worst = min(seen, key=lambda each: each[2].snr_db, default=None)
        energy = [figures.energy_kept for _, _, figures in seen]
        rows.append(
            Overall(
                method=name,
                views=len(seen),
                snr_db=_mean([figures.snr_db for _, _, figures in seen]),
                flip=_mean([figures.flip_ldr for _, _, figures in seen]),
                ssim=_mean([figures.ssim for _, _, figures in seen]),
                energy=(min(energy), max(energy)) if energy else None,
                firsts=(firsts[name][0], firsts[name][1], firsts[name][2]),
                worst=(f"{worst[0].name}, {worst[1].key}", worst[2].snr_db) if worst else None,
                seconds=_mean(list(_seconds(comparison, name))),
                best=frozenset(),
            )
        )
    return _marked(rows, len(views))


def still_views(result: SetResult) -> list[View]:
    """Views of a set that methods are ranked by: all but moving ones and those through a probe."""
    return [view for view in result.views if view.group != "motion" and view.lighting != PROBE_LIGHTING]


class ThroughProbe(NamedTuple):
    """The error that a filtered probe adds to a method, over views of the environment that are drawn both ways.

    Attributes:
        method: its name.
        views: how many.
        exact_db, probe_db: mean SNR in dB under the environment itself, and through the probe.
        exact_error, probe_error: mean relative L2 of the same.
    """

    method: str
    views: int
    exact_db: float
    probe_db: float
    exact_error: float
    probe_error: float


def through_probe(comparison: Comparison) -> list[ThroughProbe]:
    """The error that the probe adds to each method; [] where nothing was drawn through one."""
    rows = []
    for name in method_names(comparison):
        pairs = []
        for result in comparison.sets:
            exact = {view.key: _shots(view) for view in result.views}
            for view in result.views:
                here, there = _shots(view), exact.get(view.key.removesuffix("-probe"), {})
                if view.lighting == PROBE_LIGHTING and name in here and name in there:
                    pairs.append((there[name], here[name]))
        if pairs:
            columns = [
                _mean([getattr(pair[which], field) for pair in pairs]) or 0.0
                for field in ("snr_db", "relative_l2")
                for which in (0, 1)
            ]
            rows.append(ThroughProbe(name, len(pairs), *columns))
    return rows


def _shots(view: View) -> dict[str, Figures]:
    """Figures by method of a still view; the fit with level 0 as authored is no method of its own."""
    return {
        shot.method: shot.figures
        for shot in view.shots
        if shot.figures is not None and not shot.method.endswith(KEPT_SUFFIX)
    }


def _marked(rows: list[Overall], views: int) -> list[Overall]:
    """The same rows with ``best`` filled in; only methods that are in every view compete."""
    whole = [row for row in rows if row.views == views and views]
    best: dict[str, set[str]] = {row.method: set() for row in rows}
    for name, sign in (("snr_db", 1), ("flip", -1), ("ssim", 1)):
        values = {row.method: sign * getattr(row, name) for row in whole}
        for method, value in values.items():
            if value == max(values.values()):
                best[method].add(name)
    for i, name in enumerate(("snr_firsts", "flip_firsts", "ssim_firsts")):
        for row in whole:
            if row.firsts[i] == max(each.firsts[i] for each in whole):
                best[row.method].add(name)
    return [row._replace(best=frozenset(best[row.method])) for row in rows]


def groups(comparison: Comparison) -> list[tuple[str, str | None]]:
    """The groups of ``GROUPS`` that the comparison has pictures of, and the pairs of light and viewer."""
    seen = {view.lighting for result in comparison.sets for view in result.views}
    return [(group, lit) for group, lit in GROUPS if lit is None or lit in seen]


def summary(comparison: Comparison) -> list[Row]:
    """SNR in dB of every method at near, mid and far, means over sets, in the order of the methods."""
    table = {
        name: [_values(comparison, name, lit, distance) for _, lit in groups(comparison) for distance in DISTANCES]
        for name in method_names(comparison)
    }
    columns = next(iter(table.values()), [])
    best = [_best({name: values[i] for name, values in table.items()}, comparison) for i in range(len(columns))]
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


def differences(comparison: Comparison, other: str, ours: str | None = None) -> dict[str, list[float]]:
    """SNR of a method, the fit unless another is named, less that of another, by distance, for each set and lighting
    (as Kemppinen et al. 2023, fig. 5)."""
    ours = ours or fit_name(comparison)
    found: dict[str, list[float]] = {distance: [] for distance in DISTANCES}
    for result in comparison.sets:
        for lit in (lit for _, lit in groups(comparison)[1:] if lit != PROBE_LIGHTING):
            for distance in DISTANCES:
                here, there = (picture_snr(result, name, lit or "", distance) for name in (ours, other))
                if here is not None and there is not None:
                    found[distance].append(here - there)
    return found


def fit_name(comparison: Comparison) -> str:
    """The method that the others are compared with."""
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


def level_table(views: Sequence[View]) -> list[tuple[str, list[tuple[float, float, float]]]]:
    """(method, (MSE x 10^3, SNR in dB, FLIP) of each level) of a set's views, as the paper's Table 3."""
    found: dict[str, list[tuple[float, float, float]]] = {}
    for view in (each for each in views if each.group == LEVEL_GROUP):
        for shot in view.shots:
            if shot.figures is not None and shot.figures.mse is not None:
                figures = shot.figures
                found.setdefault(shot.method, []).append((1e3 * shot.figures.mse, figures.snr_db, figures.flip_ldr))
    return list(found.items())
