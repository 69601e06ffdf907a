"""The trade-off as a picture: accuracy over time, with the Pareto front."""

from __future__ import annotations

import math
from pathlib import Path

from brdffit.tradeoff.record import Point, Tradeoff

_STYLES = {
    "method": ("#6b7280", "s"),
    "preset": ("#b3005e", "D"),
    "tolerance": ("#d9730d", "^"),
    "nodes": ("#1f6fb5", "o"),
    "setting": ("#0899ad", "v"),
    "model": ("#7c5cbf", "P"),
    "lobe": ("#5b8c15", "X"),
    "loss": ("#8a5a1a", "*"),
    "float": ("#333333", "p"),
    "oracle": ("#000000", "H"),
}
#: Groups whose points are named in the whole picture, and in the close-up.
_NAMED, _NAMED_CLOSE = ("method", "oracle"), ("preset", "tolerance", "nodes", "lobe", "float")
#: What the close-up shows below the best, in dB.
_CLOSE = 1.6


def draw(tradeoff: Tradeoff, folder: Path) -> list[Path]:
    """Write tradeoff.svg and tradeoff.png: for each set half-angle SNR and rendered SNR over seconds per megatexel."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    sets = list(dict.fromkeys(point.set for point in tradeoff.points))
    with pyplot.rc_context({"font.size": 8, "svg.fonttype": "none", "axes.spines.top": False,
                            "axes.spines.right": False, "svg.hashsalt": "brdffit"}):  # fmt: skip
        figure, axes = pyplot.subplots(len(sets), 3, figsize=(16.0, 4.6 * len(sets)), squeeze=False)
        for row, name in zip(axes, sets, strict=True):
            own = [point for point in tradeoff.points if point.set == name]
            _panel(row[0], own, "snr_db", f"{name}: half-angle SNR of the lobe (dB)", _NAMED)
            _close_up(row[1], [point for point in own if point.group != "method"])
            _panel(row[2], own, "rendered_db", "SNR of radiance over pairs of light and viewer (dB)", _NAMED)
        handles, labels = axes[0][0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="lower center", ncols=len(_STYLES), frameon=False)
        figure.tight_layout(rect=(0, 0.12 / len(sets) / 1.4, 1, 1))
        written = []
        for suffix in ("svg", "png"):
            path = folder / f"tradeoff.{suffix}"
            figure.savefig(path, dpi=130, metadata={"Date": None} if suffix == "svg" else None)
            written.append(path)
        pyplot.close(figure)
    return written


def _close_up(axis, fits: list[Point]) -> None:  # type: ignore[no-untyped-def]
    """Draw the best fits; the oracle, whose time lies far outside, as a line."""
    reached = max(point.snr_db for point in fits if point.group != "oracle")
    close = [point for point in fits if point.snr_db >= reached - _CLOSE and point.group != "oracle"]
    for point in fits:
        if point.group == "oracle":
            seconds = f"oracle, {point.seconds_per_megatexel:,.0f} s"
            axis.axhline(point.snr_db, color=_STYLES["oracle"][0], linewidth=0.8, linestyle="--", zorder=1)
            axis.annotate(seconds, (1.0, point.snr_db), xycoords=("axes fraction", "data"), xytext=(-2, 2),
                          textcoords="offset points", ha="right", va="bottom", fontsize=7)  # fmt: skip
    _panel(axis, close, "snr_db", "the fits close up", _NAMED_CLOSE)


def _panel(axis, points: list[Point], figure: str, title: str, named: tuple[str, ...]) -> None:  # type: ignore[no-untyped-def]
    shown = [point for point in points if getattr(point, figure) is not None]
    front = sorted((point for point in shown if point.front), key=lambda each: each.seconds_per_megatexel)
    axis.plot([p.seconds_per_megatexel for p in front], [getattr(p, figure) for p in front], color="#bbbbbb", zorder=1,
              linewidth=1.2)  # fmt: skip
    for group, (colour, marker) in _STYLES.items():
        own = [point for point in shown if point.group == group]
        axis.scatter([p.seconds_per_megatexel for p in own], [getattr(p, figure) for p in own], s=30, color=colour,
                     marker=marker, label=group, zorder=2, edgecolors="white", linewidths=0.5)  # fmt: skip
    taken: list[tuple[float, float]] = []
    low = min((getattr(p, figure) for p in shown), default=0.0)
    high = max((getattr(p, figure) for p in shown), default=1.0)
    axis.set_xscale("log")
    times = [point.seconds_per_megatexel for point in shown] or [1.0]
    decades = max(math.log10(max(times) / min(times)), 0.1)
    axis.set_xlim(0.8 * min(times), max(times) * 10 ** (0.28 * decades))
    for point in sorted(shown, key=lambda each: -getattr(each, figure)):
        if point.group in named or (point.group, point.name) == ("preset", "standard"):
            _label(axis, point, getattr(point, figure), taken, (high - low) or 1.0, decades)
    axis.set_xlabel("seconds per megatexel of the base, levels 0 to 5")
    axis.set_title(title, loc="left")
    axis.grid(alpha=0.25, linewidth=0.5)


def _label(axis, point: Point, value: float, taken: list[tuple[float, float]], span: float, decades: float) -> None:  # type: ignore[no-untyped-def]
    """Write the name of a point, moved down past names that are there already."""
    x, y = math.log10(max(point.seconds_per_megatexel, 1e-9)), value
    while any(abs(x - other_x) < 0.22 * decades and abs(y - other_y) < 0.037 * span for other_x, other_y in taken):
        y -= 0.038 * span
    taken.append((x, y))
    colour = _STYLES[point.group][0]
    leader = {"arrowstyle": "-", "color": colour, "linewidth": 0.4, "shrinkA": 0.0, "shrinkB": 2.0}
    axis.annotate(point.name, (point.seconds_per_megatexel, value), xytext=(10 ** (x + 0.02 * decades), y), fontsize=7,
                  color=colour, va="center", zorder=3, arrowprops=leader if y < value else None)  # fmt: skip
