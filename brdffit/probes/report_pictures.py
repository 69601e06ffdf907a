"""Pictures of the comparison: error over time, point responses, and levels beside the exact ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from brdffit.files.image_io import write_png
from brdffit.probes.cubemap import latlong_directions, look_up
from brdffit.probes.curves import get_curve
from brdffit.probes.filtering import FilterOptions, filter_levels, level_requests
from brdffit.probes.picture import exposure_of, toned
from brdffit.probes.table_files import TableFile, load_table, shipped_tables
from brdffit.probes.tables import BASE_SIZE

_WIDTH, _GAP, _TITLE = 224, 6, 18


def draw_front(methods: list[dict[str, Any]], path: Path) -> None:
    """Plot the mean error of each method over its mean processor time, on logarithmic axes, as a PNG."""
    from matplotlib.figure import Figure

    figure = Figure((8.5, 5.0), dpi=110)
    axes = figure.subplots()
    kinds = {"tree": "C0", "ggx": "C1", "importance": "C2"}
    for name in dict.fromkeys(each["method"] for each in methods):
        rows = [each for each in methods if each["method"] == name]
        seconds = float(np.mean([each["seconds"] for each in rows]))
        if name == "brute force":
            axes.axvline(seconds, color="0.6", linestyle=":")
            axes.annotate("brute force", (seconds, 0.02), rotation=90, ha="right", color="0.4", fontsize=8)
            continue
        error = float(np.mean([each["error"] for each in rows]))
        colour = next(colour for kind, colour in kinds.items() if name.startswith(kind))
        axes.loglog(seconds, 100.0 * error, "o", color=colour, markerfacecolor="white" if "split" in name else colour)
        # Quadratic tables lie below and to the left of the constant ones of twice the taps.
        side, shift = ("right", (-6, -7)) if name.startswith("ggx-quadratic") else ("left", (6, 2))
        axes.annotate(name, (seconds, 100.0 * error), textcoords="offset points", xytext=shift, ha=side, fontsize=8)
    axes.margins(x=0.18)
    axes.set_xlabel("processor seconds for levels 1 to 6 of a cube of 128")
    axes.set_ylabel("error, % of radiance")
    axes.grid(True, which="both", alpha=0.2)
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
    tables = [load_table(name) for name in shipped_tables()]
    out += [(each.name, FilterOptions("table", tables=each.tables)) for each in tables if each.is_whole]
    return [*out, ("importance 32", FilterOptions("importance", samples=32))]


def draw_point_responses(path: Path) -> None:
    """Level 3 of a cube with one bright texel: in the middle of a face, on an edge, at a corner (figure 8)."""
    n, rows = BASE_SIZE, []
    for title, at in (("middle", (64, 64)), ("edge", (64, 127)), ("corner", (0, 127))):
        cube = np.zeros((6, n, n, 3), np.float32)
        cube[4, at[0], at[1]] = 1.0
        rows.append((f"one texel, {title}", _filtered(cube, 3), (4, at)))
    pictures = []
    for title, made, (_, at) in rows:
        peak = float(made[0][1].max())
        # A perspective view along the texel's direction shows the neighbouring faces too.
        u, v = (2 * at[1] + 1) / n - 1.0, 1.0 - (2 * at[0] + 1) / n
        view = _view(np.array([u, v, 1.0]), 0.7)
        pictures.append((title, [(name, toned(look_up(level, view) / peak, 2.0)) for name, level in made]))
    write_png(path, _sheet(pictures))


def draw_levels(cube: NDArray, path: Path, threads: int) -> None:
    """Draw levels 1, 3 and 5 of a cube map (6, 128, 128, 3) by each method, as lat-long pictures in one PNG."""
    at, exposure = latlong_directions(_WIDTH // 2), exposure_of(cube)
    rows = []
    for level in (1, 3, 5):
        made = _filtered(cube, level, threads)
        rows.append((f"level {level}", [(name, toned(look_up(each, at), exposure)) for name, each in made]))
    write_png(path, _sheet(rows))


def _filtered(cube: NDArray, level: int, threads: int = 1) -> list[tuple[str, NDArray]]:
    request = level_requests(get_curve("activision", 7, BASE_SIZE), BASE_SIZE, BASE_SIZE, keep_narrow=True)[level]
    return [
        (name, filter_levels(cube, [request], replace(options, threads=threads), measure=False)[0].radiance)
        for name, options in _methods()
    ]


def _view(ahead: NDArray, reach: float) -> NDArray:
    """(_WIDTH, _WIDTH, 3) directions of a perspective view along ``ahead``, to ``reach`` on the plane at distance 1."""
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross([0.0, 1.0, 0.0], ahead)
    right /= np.linalg.norm(right)
    up = np.cross(ahead, right)
    across = np.linspace(-reach, reach, _WIDTH)
    return ahead + across[None, :, None] * right - across[:, None, None] * up


def _sheet(rows: list[tuple[str, list[tuple[str, NDArray]]]]) -> NDArray:
    """Rows of captioned pictures."""
    columns = len(rows[0][1])
    height = sum(row[0][1].shape[0] + 2 * _TITLE for _, row in rows)
    canvas = Image.new("RGB", (columns * (_WIDTH + _GAP) + _GAP, height + _GAP), (24, 24, 24))
    draw, font, y = ImageDraw.Draw(canvas), ImageFont.load_default(12), 0
    for title, row in rows:
        draw.text((_GAP, y + 2), title, fill=(255, 255, 255), font=font)
        y += _TITLE
        for column, (name, pixels) in enumerate(row):
            x = _GAP + column * (_WIDTH + _GAP)
            draw.text((x, y + 2), name, fill=(170, 170, 170), font=font)
            canvas.paste(Image.fromarray(pixels), (x, y + _TITLE))
        y += _TITLE + row[0][1].shape[0]
    return np.asarray(canvas)
