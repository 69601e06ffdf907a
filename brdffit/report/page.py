"""Records to one self-contained HTML file: drawings, tables, and pictures to look at side by side."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from brdffit.report import plots
from brdffit.report.histograms import all_histograms
from brdffit.report.records import KEPT_SUFFIX, MOST_ANISOTROPY, MOST_DB, Comparison, SetResult, Shot, View
from brdffit.report.side_by_side import all_side_by_side
from brdffit.report.summary import (
    DISTANCES,
    fit_name,
    groups,
    level_table,
    method_names,
    overall,
    still_views,
    summary,
    through_probe,
)


def render_page(comparison: Comparison, pictures: Mapping[str, NDArray]) -> str:
    """The page: one HTML text that asks for nothing else.

    Args:
        comparison: the records.
        pictures: (h, w) or (h, w, 3) uint8 by the paths that the records name.
    """
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("brdffit.report"), autoescape=True, trim_blocks=True, lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )  # fmt: skip
    environment.filters.update(
        decibels=decibels, percent=percent, seconds=seconds, figure=figure, thousandths=thousandths
    )
    fit, rows = fit_name(comparison), summary(comparison)
    colours = plots.method_colours(comparison)
    return environment.get_template("page.html").render(
        comparison=comparison,
        fit=fit,
        colours=colours,
        groups=[group for group, _ in groups(comparison)],
        distances=DISTANCES,
        rows=rows,
        overall=overall(comparison),
        through_probe=through_probe(comparison),
        views=sum(len(still_views(result)) for result in comparison.sets),
        summaries={info.name: info.summary for info in comparison.methods},
        histograms=all_histograms(comparison),
        times=plots.time_and_gain(rows, colours, fit),
        sets=[
            {**_set(result, colours, fit), "side_by_side": _side_by_side(comparison, result, pictures)}
            for result in comparison.sets
        ],
        most_anisotropy=MOST_ANISOTROPY,
        data=_script_json(_data(comparison, pictures, colours, fit)),
    )


def decibels(value: float | None) -> str:
    """Decibels with one digit; what is capped is infinite."""
    if value is None:
        return "\u2013"
    if abs(value) >= MOST_DB:
        return "\u221e" if value > 0 else "\u2212\u221e"
    return f"{value:.1f}".replace("-", "\u2212")


def percent(value: float | None) -> str:
    """A share as a percentage."""
    return "\u2013" if value is None else f"{100.0 * value:.1f}%"


def seconds(value: float | None) -> str:
    """Seconds, more digits where they are few."""
    if value is None:
        return "\u2013"
    return f"{value:.2f}" if value < 10 else f"{value:.0f}"


def thousandths(value: float | None) -> str:
    """Three digits after the point."""
    return "\u2013" if value is None else f"{value:.3f}"


def figure(value: float | None) -> str:
    """Three significant digits."""
    return "\u2013" if value is None else f"{value:.3g}"


def _set(result: SetResult, colours: Mapping[str, str], fit: str) -> dict[str, Any]:
    """The values that the template needs for a set besides its record."""
    return {
        "record": result,
        "curves": plots.level_curves(result, colours, fit),
        "traced": level_table(result.views),
        "stills": [view for view in result.views if view.group != "motion"],
        "motions": [view for view in result.views if view.group == "motion"],
        "kept": _kept_rows(result, fit),
        "best": {view.key: _best_shots(view) for view in result.views},
        "best_levels": [_best_of_level(result, k) for k in range(result.maps_levels)],
    }


def _side_by_side(comparison: Comparison, result: SetResult, pictures: Mapping[str, NDArray]) -> list[tuple[str, str]]:
    """(lighting, data URL) of the set's methods side by side."""
    made = all_side_by_side(comparison, result, pictures)
    return [(lighting, plots.data_address(picture)) for lighting, picture in made]


def _kept_rows(result: SetResult, fit: str) -> list[tuple[View, Shot, Shot]]:
    """Views of level 0 with the fit's picture, filtered and as authored."""
    rows = []
    for view in result.views:
        shots = {shot.method: shot for shot in view.shots}
        if fit in shots and fit + KEPT_SUFFIX in shots:
            rows.append((view, shots[fit], shots[fit + KEPT_SUFFIX]))
    return rows


def _best_shots(view: View) -> dict[str, set[str]]:
    """Methods that are first in each figure of a view."""
    found: dict[str, set[str]] = {}
    signs = {"snr_db": 1, "relative_l2": -1, "flip_hdr": -1, "flip_ldr": -1, "ssim": 1}
    for name, sign in signs.items():
        values = {s.method: sign * getattr(s.figures, name) for s in view.shots if s.figures is not None}
        found[name] = {method for method, value in values.items() if value == max(values.values())}
    off = {s.method: abs(s.figures.energy_kept - 1.0) for s in view.shots if s.figures is not None}
    found["energy_kept"] = {method for method, value in off.items() if value == min(off.values())}
    moving = {s.method: abs(s.change - 1.0) for s in view.shots if s.change is not None}
    found["change"] = {method for method, value in moving.items() if value == min(moving.values())}
    return found


def _best_of_level(result: SetResult, level: int) -> dict[str, set[str]]:
    """Methods that are first at a level, by the lobe's figure and by that of the pairs."""
    found = {}
    for name in ("half_angle_snr_db", "pair_snr_db"):
        values = {each.method: getattr(each.levels[level], name) for each in result.methods if each.maps}
        known = {method: value for method, value in values.items() if value is not None}
        found[name] = {method for method, value in known.items() if value == max(known.values())}
    return found


def _data(
    comparison: Comparison, pictures: Mapping[str, NDArray], colours: Mapping[str, str], fit: str
) -> dict[str, Any]:
    """The data of the page's script: pictures as data URLs, lobes as numbers."""
    sets = []
    for result in comparison.sets:
        views = [
            {
                "key": view.key,
                "title": view.title,
                "motion": view.group == "motion",
                "reference": plots.data_address(pictures[view.reference]),
                "methods": {shot.method: plots.data_address(pictures[shot.picture]) for shot in view.shots},
                "captions": {shot.method: _caption(view, shot.method) for shot in view.shots},
            }
            for view in result.views
        ]
        lobes = [
            {
                "level": view.level, "column": view.column, "row": view.row, "u": view.u, "v": view.v,
                "extent": view.extent, "centre": view.centre, "axis": view.axis, "peak": view.peak,
                "heat": plots.lobe_pictures(view), "cuts": plots.lobe_cuts(view), "snr": view.snr_db,
            }
            for view in result.lobes
        ]  # fmt: skip
        maps = {
            each.method: plots.data_address(plots.map_picture(pictures[each.maps]))
            for each in result.methods
            if each.maps
        }
        overview = plots.data_address(pictures[result.overview])
        sets.append({"name": result.name, "views": views, "lobes": lobes, "maps": maps, "overview": overview})
    return {"fit": fit, "order": method_names(comparison), "colours": dict(colours), "sets": sets}


def _caption(view: View, method: str) -> str:
    """One line under a picture."""
    shot = next(shot for shot in view.shots if shot.method == method)
    if shot.figures is not None:
        return f"SNR {decibels(shot.figures.snr_db)} dB, FLIP {shot.figures.flip_ldr:.3f}"
    return "" if shot.change is None else f"changes {shot.change:.2f} times as much as the reference"


def _script_json(data: Mapping[str, Any]) -> str:
    """JSON that cannot end the script element it stands in."""
    return json.dumps(data, separators=(",", ":"), ensure_ascii=False).replace("</", "<\\/").replace("<!--", "<\\!--")
