"""The trade-off as a picture: accuracy over time, with the Pareto front."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from brdffit.tradeoff.record import Point, Tradeoff

#: Colour and marker of each group that is shown by name; all others are dots.
_STYLES = {
    "method": ("#4b5563", "s"),
    "preset": ("#b3005e", "D"),
    "lights": ("#5b8c15", "X"),
    "loss": ("#1f6fb5", "v"),
    "energy": ("#7c5cbf", "P"),
    "lobe": ("#d9730d", "^"),
}
_OTHER = "#c3c8cf"
#: Names in the legend.
_LEGEND = {
    "method": "closed forms and averages", "preset": "the fit: presets", "lights": "the fit for other lights",
    "loss": "the fit by other losses", "energy": "the fit, energy weighed in", "lobe": "the fit, lobe or scale reduced",
}  # fmt: skip
_X = "seconds per megatexel, levels 0 to 5"
_Y = "accuracy on a screen (dB, higher is better)"
#: What the close-up shows below the best, in dB.
_CLOSE = 3.0


def draw(tradeoff: Tradeoff, folder: Path) -> list[Path]:
    """Write tradeoff.svg and tradeoff.png: one row a set, everything on the left and the fits close up on the right."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    sets = list(dict.fromkeys(point.set for point in tradeoff.points))
    with pyplot.rc_context({"font.size": 9, "svg.fonttype": "none", "axes.spines.top": False,
                            "axes.spines.right": False, "svg.hashsalt": "brdffit"}):  # fmt: skip
        figure, axes = pyplot.subplots(len(sets), 2, figsize=(13.0, 5.0 * len(sets)), squeeze=False)
        for row, name in zip(axes, sets, strict=True):
            own = [point for point in tradeoff.points if point.set == name and point.group != "oracle"]
            best = [point for point in tradeoff.points if point.set == name and point.group == "oracle"]
            reached = max(point.snr_db for point in [*own, *best])
            _panel(row[0], own, best, f"{name}: what accuracy costs", ("method", "preset"))
            close = [point for point in own if point.group != "method" and point.snr_db >= reached - _CLOSE]
            _panel(row[1], close, best, "the fits close up", tuple(_STYLES))
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="lower center", ncols=(len(handles) + 1) // 2, frameon=False)
        figure.tight_layout(rect=(0, 0.1 / len(sets), 1, 1))
        written = []
        for suffix in ("svg", "png"):
            path = folder / f"tradeoff.{suffix}"
            figure.savefig(path, dpi=130, metadata={"Date": None} if suffix == "svg" else None)
            written.append(path)
        pyplot.close(figure)
    return written


def _panel(axis: Any, points: Sequence[Point], best: Sequence[Point], title: str, named: tuple[str, ...]) -> None:
    """One panel: all points, the front as a line, the best possible lobe as a dashed one, and some points' names."""
    front = sorted((point for point in points if point.front), key=lambda each: each.seconds_per_megatexel)
    axis.plot([p.seconds_per_megatexel for p in front], [p.snr_db for p in front], color=_OTHER, zorder=1)
    others = [point for point in points if point.group not in _STYLES]
    axis.scatter([p.seconds_per_megatexel for p in others], [p.snr_db for p in others], s=9, color=_OTHER,
                 label="the fit: other nodes, models, tolerances", zorder=1)  # fmt: skip
    for group, (colour, marker) in _STYLES.items():
        own = [point for point in points if point.group == group]
        size = 70 if group == "preset" else 34
        axis.scatter([p.seconds_per_megatexel for p in own], [p.snr_db for p in own], s=size, color=colour,
                     marker=marker, label=_LEGEND[group], zorder=3, edgecolors="white", linewidths=0.5)  # fmt: skip
    times = [point.seconds_per_megatexel for point in points] or [1.0]
    decades = max(math.log10(max(times) / min(times)), 0.1)
    axis.set_xscale("log")
    axis.set_xlim(min(times) / 10 ** (0.12 * decades), max(times) * 10 ** (0.32 * decades))
    for point in best:
        axis.axhline(point.snr_db, color="#000000", linewidth=0.8, linestyle="--", zorder=1)
        axis.annotate(f"the best lobe there is ({point.seconds_per_megatexel:,.0f} s)", (1.0, point.snr_db),
                      xycoords=("axes fraction", "data"), xytext=(-2, 2), textcoords="offset points", ha="right",
                      va="bottom", fontsize=8)  # fmt: skip
    heights = [point.snr_db for point in (*points, *best)] or [0.0]
    taken: list[tuple[float, float]] = []
    shown = [point for point in points if point.group in named]
    for point in sorted(shown, key=lambda each: (each.group != "preset", -each.snr_db)):
        _label(axis, point, taken, (max(heights) - min(heights)) or 1.0, decades)
    axis.set_xlabel(_X)
    axis.set_ylabel(_Y)
    axis.set_title(title, loc="left", fontweight="bold")
    axis.grid(alpha=0.25, linewidth=0.5)


def _label(axis: Any, point: Point, taken: list[tuple[float, float]], span: float, decades: float) -> None:
    """Write a point's name: of a preset on its left, of others on the right, moved down past names that are there."""
    x, y = math.log10(max(point.seconds_per_megatexel, 1e-9)), point.snr_db
    preset = point.group == "preset"
    while not preset and any(
        abs(x - other_x) < 0.25 * decades and abs(y - other_y) < 0.04 * span for other_x, other_y in taken
    ):
        y -= 0.01 * span
    if not preset:
        taken.append((x, y))
    colour = _STYLES[point.group][0]
    leader = {"arrowstyle": "-", "color": colour, "linewidth": 0.4, "shrinkA": 0.0, "shrinkB": 2.0}
    axis.annotate(
        point.name, (point.seconds_per_megatexel, point.snr_db),
        xytext=(10 ** (x + (-0.025 if preset else 0.025) * decades), y), ha="right" if preset else "left",
        fontsize=10 if preset else 8, fontweight="bold" if preset else "normal", color=colour, va="center", zorder=4,
        arrowprops=leader if y < point.snr_db else None,
    )  # fmt: skip
