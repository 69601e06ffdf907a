"""Pictures of the comparison: error over time, point responses, and levels beside the exact ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.probes.cubemap import directions, latlong_directions, look_up
from brdffit.probes.curves import get_curve
from brdffit.probes.filtering import FilterOptions, filter_levels, level_requests
from brdffit.probes.picture import DIM, Sheet, exposure_of, toned
from brdffit.probes.table_files import TableFile, load_table
from brdffit.probes.tables import BASE_SIZE

_WIDTH, _GAP, _TITLE = 224, 6, 18


def draw_front(methods: list[dict[str, Any]], path: Path) -> None:
    """Plot the mean error of each method over its mean processor time, on logarithmic axes, as a PNG."""
    from matplotlib.figure import Figure

    families: dict[str, list[tuple[float, float, str]]] = {}
    for name in dict.fromkeys(each["method"] for each in methods):
        rows = [each for each in methods if each["method"] == name]
        seconds, error = (float(np.mean([each[key] for each in rows])) for key in ("seconds", "error"))
        # "ggx-const-8, split 10" is the 8 of "ggx-const, split 10".
        base, comma, split = name.partition(", ")
        family = base.rstrip("0123456789.").rstrip(" -")
        families.setdefault(family + comma + split, []).append((seconds, 100.0 * error, base[len(family) + 1 :]))
    figure = Figure((8.5, 5.0), dpi=110)
    axes, colours = figure.subplots(), {"tree": "C0", "ggx-const": "C1", "ggx-quadratic": "C3", "importance": "C2"}
    for label, points in families.items():
        if label == "brute force":
            axes.axvline(points[0][0], color="0.6", linestyle=":", label=label)
            continue
        family, _, split = label.partition(", ")
        (line,) = axes.loglog([point[0] for point in points], [point[1] for point in points], "o-", label=label)
        line.set(color=colours[family], linestyle="--" if split else "-")
        line.set_markerfacecolor("white" if split else colours[family])
        for seconds, error, number in points:
            axes.annotate(number, (seconds, error), textcoords="offset points", xytext=(5, 4), fontsize=8)
    axes.set_xlabel("processor seconds for levels 1 to 6 of a cube of 128")
    axes.set_ylabel("error, % of radiance")
    axes.grid(True, which="both", alpha=0.2)
    axes.legend(fontsize=8, title="with tolerance, taps or samples", title_fontsize=8)
    figure.tight_layout()
    figure.savefig(path)


def draw_histories(tables: Sequence[TableFile], path: Path) -> None:
    """Plot for each table and level the best error on searched texels over time, and the held-out error at the end."""
    from matplotlib.figure import Figure

    columns = min(len(tables), 3)
    rows = (len(tables) + columns - 1) // columns
    figure = Figure((11.0, 2.9 * rows) if columns > 1 else (7.0, 4.5), dpi=100)
    all_axes = figure.subplots(rows, columns, squeeze=False)
    for axes, table in zip(all_axes.flat, tables, strict=False):
        for number, level in sorted(table.levels.items()):
            seconds, errors, steps = zip(*level.history, strict=True)
            # Later steps measure on other texels, so their errors are not comparable.
            searched = [k for k, step in enumerate(steps) if step.startswith(("start", "deepened"))]
            line = axes.step(
                [seconds[k] for k in searched],
                np.minimum.accumulate([errors[k] for k in searched]),
                where="post",
                label=f"level {number}",
            )[0]
            axes.plot(level.seconds, level.error, "o", color=line.get_color(), markersize=4)
        axes.set_title(table.name, fontsize=9)
        axes.set_xscale("log")
        axes.xaxis.set_minor_formatter("")
        axes.grid(True, alpha=0.2)
        axes.legend(fontsize=6)
    for axes in all_axes.flat[len(tables) :]:
        axes.axis("off")
    figure.supxlabel("processor seconds", fontsize=9)
    figure.supylabel("L1 of the preimage", fontsize=9)
    figure.tight_layout()
    figure.savefig(path)


def _methods() -> list[tuple[str, FilterOptions]]:
    out = [("exact", FilterOptions("tree", 1e-4)), ("tree 0.01", FilterOptions("tree", 0.01))]
    # More than five pictures in a row could not be read on the page.
    tables = [load_table(name) for name in ("ggx-const-8", "ggx-quadratic-8")]
    out += [(each.name, FilterOptions("table", tables=each.tables)) for each in tables]
    return [*out, ("importance 32", FilterOptions("importance", samples=32))]


def draw_point_responses(path: Path) -> None:
    """Level 3 of a cube with one bright texel: in the middle of a face, on an edge, at a corner (figure 8)."""
    n, rows = BASE_SIZE, []
    for title, row, column in (("middle", 64, 64), ("edge", 64, 127), ("corner", 0, 127)):
        cube = np.zeros((6, n, n, 3), np.float32)
        cube[4, row, column] = 1.0
        made = _filtered(cube, 3)
        # A perspective view along the texel's direction shows the neighbouring faces too.
        view = _view(directions(n)[4, row, column], 0.7)
        peak = float(made[0][1].max())
        pictures = [(name, toned(look_up(level, view) / peak, 2.0)) for name, level in made]
        rows.append((f"one texel, {title}", pictures))
    _write_sheet(rows, path)


def draw_levels(cube: NDArray, path: Path, threads: int) -> None:
    """Draw levels 1, 3 and 5 of a cube map (6, 128, 128, 3) by each method, as lat-long pictures in one PNG."""
    at, exposure = latlong_directions(_WIDTH // 2), exposure_of(cube)
    rows = []
    for level in (1, 3, 5):
        made = _filtered(cube, level, threads)
        rows.append((f"level {level}", [(name, toned(look_up(each, at), exposure)) for name, each in made]))
    _write_sheet(rows, path)


def _filtered(cube: NDArray, level: int, threads: int = 1) -> list[tuple[str, NDArray]]:
    request = level_requests(get_curve("activision", 7, BASE_SIZE), BASE_SIZE, BASE_SIZE, keep_narrow=True)[level]
    return [
        (name, filter_levels(cube, [request], replace(options, threads=threads), measure=False)[0].radiance)
        for name, options in _methods()
    ]


def _view(ahead: NDArray, reach: float) -> NDArray:
    """(_WIDTH, _WIDTH, 3) directions of a view along the unit vector ``ahead``, to ``reach`` on the plane at 1."""
    right = np.cross([0.0, 1.0, 0.0], ahead)
    right /= np.linalg.norm(right)
    up = np.cross(ahead, right)
    across = np.linspace(-reach, reach, _WIDTH)
    return ahead + across[None, :, None] * right - across[:, None, None] * up


def _write_sheet(rows: list[tuple[str, list[tuple[str, NDArray]]]], path: Path) -> None:
    """Rows of captioned pictures, as a PNG."""
    heights = [row[0][1].shape[0] + 2 * _TITLE for _, row in rows]
    sheet, y = Sheet(len(rows[0][1]) * (_WIDTH + _GAP) + _GAP, sum(heights) + _GAP), 0
    for (title, row), height in zip(rows, heights, strict=True):
        sheet.text(_GAP, y + 2, title)
        for column, (name, pixels) in enumerate(row):
            x = _GAP + column * (_WIDTH + _GAP)
            sheet.text(x, y + _TITLE + 2, name, DIM)
            sheet.put(x, y + 2 * _TITLE, pixels)
        y += height
    sheet.write(path)
