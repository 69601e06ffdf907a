"""The table of `brdffit learn judge`: half-angle SNR of methods on sets, level by level, by the dense rule."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from brdffit.fitting.batch import fit_texels, make_output, model_kernels
from brdffit.fitting.method import search_settings
from brdffit.fitting.options import FitOptions
from brdffit.fitting.presets import get_quality
from brdffit.fitting.rules import level_rules
from brdffit.footprint import get_pixel_filter
from brdffit.halfangle.apparent_lobe import base_of
from brdffit.halfangle.density import DENSITY_EXPONENTS
from brdffit.halfangle.measure import lobe_parameters, measure_lobes, random_texels, snr
from brdffit.learned.data import read_set
from brdffit.learned.variants import stretched
from brdffit.methods import DEFAULT, LobeMethod, Material, get_method, with_options
from brdffit.models import get_model
from brdffit.svbrdf import Svbrdf, level_sizes

#: Levels of the table.
LEVELS = (1, 2, 3, 4, 5)
_NODES, _SAMPLES = 2048, (16, 64)


@dataclass(frozen=True)
class Row:
    """One method on one set.

    Attributes:
        source, method: names.
        snr: SNR in dB of the mean error, for each level.
        seconds: of the bake; None where single texels were fitted instead.
        notes: of the bake.
    """

    source: str
    method: str
    snr: list[float]
    seconds: float | None
    notes: list[str]

    @property
    def mean(self) -> float:
        """Mean SNR over the levels, in dB."""
        return float(np.mean(self.snr))


def judge(
    sources: Sequence[Path], methods: Sequence[str], texels: int = 48, model: str = "ggx", anisotropy: float = 1.0
) -> Iterator[list[Row]]:
    """The rows of each set in turn: half-angle SNR of every method on the same random texels, with the scale it gave.

    A whole fit takes a minute a set, so the default method fits only the texels that are measured, and for point lights
    as the networks were trained.

    Args:
        sources: texture sets.
        methods: names of methods of lobes.
        texels: random texels of each level.
        model: lobe model of the levels.
        anisotropy: ratio of the alphas that the lobes of the sets are stretched to, in a direction that turns; 1 leaves
            the sets as they are.
    """
    for source in sources:
        svbrdf = read_set(source)
        if anisotropy != 1.0:
            svbrdf = stretched(svbrdf, anisotropy)
        levels = [level for level in LEVELS if level < len(level_sizes(svbrdf.size))]
        judged = [random_texels(level_sizes(svbrdf.size)[level], texels, seed=level) for level in levels]
        rows, theta, scale = [], [], []
        seconds: float | None
        notes: list[str]
        for name in methods:
            if name == DEFAULT:
                lobes, seconds, notes = (
                    [_fitted(svbrdf, k, *at, model) for k, at in zip(levels, judged, strict=True)],
                    None,
                    [],
                )
            else:
                lobes, seconds, notes = _baked(svbrdf, name, levels, judged, model)
            theta.append([each[0] for each in lobes])
            scale.append([each[1] for each in lobes])
            rows.append(Row(Path(source).name, name, [], seconds, notes))
        base, kernels = base_of(svbrdf), model_kernels("ggx", model)
        for i, (level, (columns, lines)) in enumerate(zip(levels, judged, strict=True)):
            found = measure_lobes(
                base, svbrdf.size, level_sizes(svbrdf.size)[level], np.stack([each[i] for each in theta]),
                np.stack([each[i] for each in scale]), columns, lines, pixel_filter="box",
                exponent=DENSITY_EXPONENTS["cosine"], kernels=kernels, nodes=_NODES, samples=_SAMPLES,
            )  # fmt: skip
            for row, error in zip(rows, found.error, strict=True):
                row.snr.append(snr(error))
        yield rows


def _fitted(svbrdf: Svbrdf, level: int, columns: NDArray, rows: NDArray, model: str) -> tuple[NDArray, NDArray]:
    """Lobes (n, 6) and scales (n, 3) of single texels, fitted for point lights, which the networks were trained for."""
    quality, target, base = get_quality("standard"), get_model(model), base_of(svbrdf)
    rules = level_rules(get_pixel_filter("box"), svbrdf.size, level_sizes(svbrdf.size)[level], level, quality)
    search = search_settings(FitOptions(lights="point", model=model), quality, base, get_model("ggx"), target)
    output = make_output(len(columns))
    fit_texels(base, rules, columns, rows, search, output, model_kernels("ggx", model))
    theta = np.zeros((len(columns), 6))
    theta[:, :2] = -output.normal[:, :2] / output.normal[:, 2:]
    theta[:, 2:5], theta[:, 5] = output.log_roughness, output.shape
    return theta, output.specular.astype(np.float64)


def _baked(
    svbrdf: Svbrdf, name: str, levels: Sequence[int], judged: Sequence[tuple[NDArray, NDArray]], model: str
) -> tuple[list[tuple[NDArray, NDArray]], float, list[str]]:
    method = get_method(name)
    assert isinstance(method, LobeMethod)
    options = with_options(method.options(), {"model": model})
    method.prepare(Material(svbrdf), options)
    started = time.perf_counter()
    pyramid = method.bake_lobes(svbrdf, options)
    seconds = time.perf_counter() - started
    found = []
    for level, (columns, rows) in zip(levels, judged, strict=True):
        lobes = pyramid[level].svbrdf
        found.append((lobe_parameters(lobes, columns, rows), lobes.specular[rows, columns].astype(np.float64)))
    return found, seconds, pyramid.notes


def mean_rows(tables: Sequence[Sequence[Row]]) -> list[Row]:
    """One row for each method: the mean over the sets that have all levels."""
    by_method: dict[str, list[Row]] = {}
    for table in tables:
        for row in table:
            by_method.setdefault(row.method, []).append(row)
    means = []
    for method, rows in by_method.items():
        whole = [row.snr for row in rows if len(row.snr) == len(LEVELS)]
        means.append(Row("mean", method, list(np.mean(whole, axis=0)) if whole else [], None, []))
    return means
