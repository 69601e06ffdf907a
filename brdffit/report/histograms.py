"""Histograms of differences over sets, as Kemppinen et al. 2023, fig. 5: of the fit, and of each learned method."""

from __future__ import annotations

import numpy as np

from brdffit.report.plots import figure_of_axes, svg_of
from brdffit.report.records import Comparison
from brdffit.report.summary import DISTANCES, differences, fit_name

#: Methods that were trained: each is compared with all the others.
TRAINED = ("learned", "latent", "mipnet")
_COLOURS = {"near": "#f2a65a", "mid": "#c8553d", "far": "#4a1942"}


def all_histograms(comparison: Comparison) -> list[str]:
    """SVG drawings: how much closer the fit is than each other method, then each learned method likewise."""
    there = [info.name for info in comparison.methods]
    names = dict.fromkeys([fit_name(comparison), *(name for name in TRAINED if name in there)])
    return [drawing for name in names if (drawing := difference_histograms(comparison, name))]


def difference_histograms(comparison: Comparison, ours: str) -> str:
    """How much better a method's pictures are than those of each other method, by distance; "" where none compare."""
    others = [info.name for info in comparison.methods if info.name != ours]
    found = {name: differences(comparison, name, ours) for name in others}
    found = {name: each for name, each in found.items() if any(each.values())}
    if not found:
        return ""
    every = [value for each in found.values() for values in each.values() for value in values]
    step = max(1.0, round((max(every) - min(every)) / 24.0))
    low, high = step * np.floor(min(*every, 0.0) / step), step * np.ceil((max(*every, 0.0) + 1e-9) / step)
    bins = np.arange(low, high + 1.5 * step, step)
    columns = min(4, len(found))
    rows = -(-len(found) // columns)
    with figure_of_axes((rows, columns), (10.4, 1.9 * rows + 0.3), sharex=True, sharey=True) as (figure, axes):
        for axis, (name, each) in zip(axes, found.items(), strict=False):
            values = [each[distance] for distance in DISTANCES]
            axis.hist(values, bins=bins, stacked=True, color=[_COLOURS[d] for d in DISTANCES],
                      label=list(DISTANCES))  # fmt: skip
            axis.axvline(0.0, color="#111827", linewidth=1.0)
            axis.set_title(f"{ours} less {name}", loc="left")
            axis.yaxis.get_major_locator().set_params(integer=True)
        for axis in axes[len(found) :]:
            axis.set_visible(False)
        figure.supxlabel(f"difference of SNR (dB); right of the line {ours} is closer to the truth", fontsize=9)
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", frameon=False)
        return svg_of(figure)
