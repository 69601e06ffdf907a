"""Drawings of records: SVG by matplotlib, and pictures as data URLs."""

from __future__ import annotations

import base64
import io
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import OutputError
from brdffit.files.atomic import fresh_file
from brdffit.report.records import Comparison, LobeView, SetResult, unpack
from brdffit.report.summary import DISTANCES, GROUPS, Row, figure_of, fit_name, view_of

#: The fit first, then the others in their order; the colours differ in hue and in lightness.
_COLOURS = (
    "#b3005e",
    "#6b7280",
    "#0e8a6d",
    "#1f6fb5",
    "#d9730d",
    "#7c5cbf",
    "#5b8c15",
    "#8a5a1a",
    "#0899ad",
    "#333333",
)
_JPEG_QUALITY = 95
#: Lobes are shown by the square root of their value, so that their tails are seen.
_LOBE_POWER = 0.5


def method_colours(comparison: Comparison) -> dict[str, str]:
    """Colour of each method, the same on the whole page."""
    fit = fit_name(comparison)
    others = [info.name for info in comparison.methods if info.name != fit]
    return {fit: _COLOURS[0]} | {name: _COLOURS[1 + i % (len(_COLOURS) - 1)] for i, name in enumerate(others)}


def level_curves(result: SetResult, colours: Mapping[str, str], fit: str) -> str:
    """SNR of the lobe and of the whole BRDF over levels, and FLIP over distances: one SVG."""
    with figure_of_axes(3, (10.4, 3.1)) as (figure, axes):
        for each in result.methods:
            style = _style(each.method, colours, fit)
            levels = [level.level for level in each.levels]
            axes[0].plot(levels, [_number(level.half_angle_snr_db) for level in each.levels], **style)
            axes[1].plot(levels, [_number(level.pair_snr_db) for level in each.levels], **style)
            flips = [_mean_flip(result, each.method, distance) for distance in DISTANCES]
            axes[2].plot(range(len(DISTANCES)), flips, **style)
        for axis, title in zip(axes, ("lobe, half-angle SNR (dB)", "light and viewer pairs, SNR (dB)",
                                      "pictures, FLIP (lower is better)"), strict=True):  # fmt: skip
            axis.set_title(title, loc="left")
        for axis in axes[:2]:
            axis.set_xlabel("MIP level")
            axis.set_xticks(range(result.maps_levels))
        axes[2].set_xticks(range(len(DISTANCES)), DISTANCES)
        axes[2].set_ylim(bottom=0.0)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", frameon=False)
        return svg_of(figure)


def time_and_gain(rows: Sequence[Row], colours: Mapping[str, str], fit: str) -> str:
    """Seconds of a bake against half-angle SNR gained over averaged maps."""
    known = [row for row in rows if row.seconds and row.gain is not None]
    if not known:
        return ""
    with figure_of_axes(1, (7.4, 3.4)) as (figure, axes):
        axis = axes[0]
        for row in known:
            style = _style(row.method, colours, fit)
            axis.plot([row.seconds], [row.gain], marker="o", markersize=8, color=style["color"])
        axis.set_xscale("log")
        axis.set_xlabel("seconds a set (logarithmic)")
        axis.set_title("half-angle SNR gained over averaged maps (dB), mean of near, mid, far", loc="left")
        axis.margins(x=0.1, y=0.15)
        _label_apart(axis, [(row.method, row.seconds or 0.0, row.gain or 0.0) for row in known])
        return svg_of(figure)


def landscape_figure(landscape: Any, title: str) -> Any:
    """Figure of an error landscape, see ``brdffit.landscape.Landscape``: Baker's picture, with the optimiser's path."""
    import matplotlib
    from matplotlib.figure import Figure as MatplotlibFigure

    with matplotlib.rc_context(_STYLE):
        figure = MatplotlibFigure(figsize=(7.4, 5.2), layout="constrained")
        axis = figure.add_subplot()
        shown = np.log1p(landscape.error)
        # Rasterised in an SVG too: browsers add up the colours of its Gouraud-shaded triangles.
        image = axis.pcolormesh(
            landscape.roughness, landscape.angle, shown, cmap="viridis", shading="gouraud", rasterized=True
        )
        axis.contour(landscape.roughness, landscape.angle, shown, levels=14, colors="white", linewidths=0.5, alpha=0.6)
        path = landscape.path
        axis.plot(path[:, 0], path[:, 1], color="#ffffff", linewidth=2.6)
        axis.plot(path[:, 0], path[:, 1], color="#b3005e", linewidth=1.4, marker="o", markersize=3.5,
                  label=f"path of the search, {len(path) - 1} steps")  # fmt: skip
        axis.plot(*path[0], marker="s", markersize=8, color="#b3005e", markeredgecolor="white", linestyle="none",
                  label="start")  # fmt: skip
        axis.plot(*path[-1], marker="*", markersize=15, color="#b3005e", markeredgecolor="white", linestyle="none",
                  label="end")  # fmt: skip
        axis.set_xscale("log")
        axis.set_xlabel("alpha")
        axis.secondary_xaxis("top", functions=(_power, _alpha)).set_xlabel("power of a Blinn-Phong lobe as wide")
        axis.set_ylabel("lean of the normal from the end of the search (degrees)")
        figure.suptitle(title, x=0.01, ha="left")
        axis.legend(loc="best", fontsize=8)
        figure.colorbar(image, label="log(1 + relative squared error)")
        return figure


def check_picture(path: Path) -> str:
    """The kind of a picture's file, "svg" or "png"; OutputError for any other."""
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("svg", "png"):
        raise OutputError(f"'{path}' ends in '{path.suffix}', expected a picture that ends in .svg or .png.")
    return kind


def save_landscape(landscape: Any, title: str, path: str | os.PathLike[str]) -> None:
    """Write ``landscape_figure`` as .svg or .png, in full or not at all.

    Raises:
        OutputError: for another suffix, or when the file cannot be written.
    """
    path = Path(path)
    kind = check_picture(path)
    with fresh_file(path) as fresh:
        landscape_figure(landscape, title).savefig(fresh, format=kind, dpi=150)


def _power(alpha: Any) -> Any:
    """Blinn-Phong power of an alpha, 2 / alpha^2 (less 2 for wide lobes, which a logarithmic axis cannot show)."""
    return 2.0 / np.square(np.maximum(alpha, 1e-9))


def _alpha(power: Any) -> Any:
    return np.sqrt(2.0 / np.maximum(power, 1e-9))


def data_address(picture: NDArray, lossless: bool = False) -> str:
    """A picture (h, w) or (h, w, 3) uint8 as a data URL: JPEG without chroma subsampling, or PNG."""
    from PIL import Image

    buffer = io.BytesIO()
    if lossless:
        Image.fromarray(picture).save(buffer, "PNG", optimize=True)
    else:
        Image.fromarray(picture).save(buffer, "JPEG", quality=_JPEG_QUALITY, subsampling=0, optimize=True)
    kind = "png" if lossless else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(buffer.getvalue()).decode()}"


def coloured(grey: NDArray, colour_map: str) -> NDArray:
    """(h, w, 3) uint8 of a picture (h, w) uint8 through one of matplotlib's colour maps."""
    import matplotlib

    table = matplotlib.colormaps[colour_map](np.arange(256), bytes=True)
    return table[grey][..., :3]


def map_picture(strip: NDArray) -> NDArray:
    """A strip of maps in colour: roughness above, anisotropy below."""
    half = strip.shape[0] // 2
    return np.concatenate([coloured(strip[:half], "gray"), coloured(strip[half:], "cividis")])


def lobe_pictures(view: LobeView) -> dict[str, str]:
    """Heat maps of a texel's lobes, all on the scale of the apparent lobe's peak, as data URLs."""
    pictures = {}
    for name, data in view.grids.items():
        values = np.clip(unpack(data, (view.side, view.side)), 0.0, 1.0) ** _LOBE_POWER
        pictures[name] = data_address(coloured(np.round(255.0 * values).astype(np.uint8), "magma"), lossless=True)
    return pictures


def lobe_cuts(view: LobeView) -> dict[str, list[list[float]]]:
    """Cuts of a texel's lobes, along and across, rounded for the page."""
    return {
        name: [[round(float(value), 3) for value in line] for line in unpack(data, (2, view.side))]
        for name, data in view.cuts.items()
    }


#: Style of all drawings. Text stays text: files are small, and it can be searched and read aloud.
_STYLE: Any = {
    "svg.fonttype": "none", "svg.hashsalt": "brdffit", "font.family": "sans-serif", "font.size": 9,
    "font.sans-serif": ["Helvetica", "Arial", "DejaVu Sans", "sans-serif"], "axes.titlesize": 9,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.color": "#e5e7eb",
    "axes.axisbelow": True, "axes.edgecolor": "#6b7280", "legend.fontsize": 9,
}  # fmt: skip


@contextmanager
def figure_of_axes(
    axes: int | tuple[int, int], size: tuple[float, float], **settings: Any
) -> Iterator[tuple[Any, NDArray]]:
    """A figure without a screen, and its axes as a flat array."""
    import matplotlib
    from matplotlib.figure import Figure as MatplotlibFigure

    rows, columns = axes if isinstance(axes, tuple) else (1, axes)
    with matplotlib.rc_context(_STYLE):
        figure = MatplotlibFigure(figsize=size, layout="constrained")
        yield figure, figure.subplots(rows, columns, squeeze=False, **settings).ravel()


def svg_of(figure: Any) -> str:
    """The figure as an inline element: scaled by the page, without a date and without the head of a file."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    element = buffer.getvalue()
    element = element[element.index("<svg") :]
    width = 96.0 * figure.get_size_inches()[0]
    head = re.sub(r' (width|height)="[^"]*"', "", element[: element.index(">")])
    return f'{head} style="max-width: {width:.0f}px"{element[element.index(">") :]}'


def _style(method: str, colours: Mapping[str, str], fit: str) -> dict[str, Any]:
    ours = method == fit
    return {
        "label": method, "color": colours.get(method, "#333333"), "linewidth": 2.4 if ours else 1.2,
        "zorder": 5 if ours else 2, "marker": "o", "markersize": 4 if ours else 2.5,
    }  # fmt: skip


def _label_apart(axis: Any, points: Sequence[tuple[str, float, float]]) -> None:
    """Names in a column at the right, at the height of their points but never overlapping, each with a thin line."""
    low, high = axis.get_ylim()
    step, last = 0.075 * (high - low), -np.inf
    for name, x, y in sorted(points, key=lambda point: point[2]):
        last = max(y, last + step)
        axis.annotate(
            name, (x, y), xytext=(1.03, last), textcoords=axis.get_yaxis_transform(), va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": "#b8c0ca", "linewidth": 0.7, "shrinkA": 1, "shrinkB": 5},
        )  # fmt: skip


def _mean_flip(result: SetResult, method: str, distance: str) -> float:
    found = []
    for _, lit in GROUPS[1:]:
        view = view_of(result, lit or "", distance)
        value = None if view is None else figure_of(view, method, lambda figures: figures.flip_ldr)
        if value is not None:
            found.append(value)
    return sum(found) / len(found) if found else float("nan")


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
