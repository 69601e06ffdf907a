"""Judging a result: its figures against the dense rule, its preview, and the averaged maps beside it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.fitting.batch import model_kernels
from brdffit.fitting.status import NOT_REACHED
from brdffit.halfangle.apparent_lobe import base_of
from brdffit.halfangle.density import DENSITY_EXPONENTS
from brdffit.halfangle.measure import measure, random_texels, snr
from brdffit.methods import Baked, Material, Pyramid, get_method, with_options
from brdffit.models import get_model
from brdffit.options import BakeOptions, LobeOptions
from brdffit.render.preview import make_preview
from brdffit.svbrdf import Svbrdf

#: How the figures of the manifest are measured: random texels of a level (all, where it has fewer), nodes of the rule,
#: and samples of a footprint along an axis. These are at least the third number; a level's texels share the fourth,
#: which gives 64 texels 48 along an axis, and the last levels, where few texels hold much, more.
_REPORT_TEXELS, _REPORT_NODES, _REPORT_SAMPLES, _SHARED_SAMPLES = 64, 512, 16, 64 * 48**2


def assess(material: Material, baked: Baked, only: Collection[int] | None = None) -> list[dict[str, Any]]:
    """One dictionary a level: ``snr_db``, ``energy_kept``, ``measured_texels``, at random texels against a dense rule.

    It is empty for levels that no pixel reads or that are not among ``only``, and for a result without lobes.
    """
    if baked.lobes is None:
        return [{} for _ in baked.sizes]
    svbrdf, pyramid = material.svbrdf.weighted(), baked.lobes
    source, target = get_model(svbrdf.model), get_model(pyramid.model)
    kernels = model_kernels(source.name, target.name)
    base = base_of(svbrdf, source.default_shape)
    figures: list[dict[str, Any]] = []
    for mip_level, level in enumerate(pyramid.levels):
        unread = level.status is not None and (level.status == NOT_REACHED).all()
        if unread or (only is not None and mip_level not in only):
            figures.append({})
            continue
        columns, rows = random_texels(level.svbrdf.size, _REPORT_TEXELS, seed=mip_level)
        found = measure(
            base, svbrdf.size, [dataclasses.replace(level, svbrdf=level.svbrdf.weighted())], columns, rows,
            pixel_filter=pyramid.options.pixel_filter, exponent=DENSITY_EXPONENTS[pyramid.options.density],
            kernels=kernels, default_shape=target.default_shape, nodes=_REPORT_NODES,
            samples=(_REPORT_SAMPLES, math.isqrt(_SHARED_SAMPLES // len(columns))),
        )  # fmt: skip
        # Rounded well above the noise of the sums, so that manifests agree to the byte.
        figures.append({
            "snr_db": round(min(snr(found.error), 99.0), 2), "energy_kept": round(float(found.energy.mean()), 4),
            "measured_texels": len(columns),
        })  # fmt: skip
    return figures


def draw_preview(material: Material, baked: Baked, title: str) -> NDArray:
    """The picture of a result beside averaged maps and the reference, see ``make_preview``."""
    averaged = baked.lobes if baked.method == "naive" else None
    averaged = averaged or averaged_levels(material, baked.options)
    return make_preview(
        material.svbrdf.over_black(), averaged, baked.appearance, title=title, name=baked.method,
        threads=baked.options.threads,
    )  # fmt: skip


def averaged_levels(material: Material, options: BakeOptions) -> Pyramid:
    """Averaged channels under the same options, as far as the method ``naive`` has them."""
    naive = get_method("naive")
    averaged = naive.bake(material, with_options(naive.options(), dataclasses.asdict(options))).lobes
    assert averaged is not None
    return averaged


def warm_up(options: LobeOptions, preview: bool = True) -> None:
    """Compile, or load, what measures lobes and draws their preview, on a material of few texels.

    It needs no file of the set, so that it runs while the set is read.
    """
    flat = np.zeros((2, 2, 3), np.float32)
    few = Material(Svbrdf(flat + np.array([0, 0, 1], np.float32), flat - 3.0, flat + 0.5, flat + 0.5))
    averaged = averaged_levels(few, dataclasses.replace(options, levels=None))
    assess(few, Baked.of_lobes(averaged))
    if preview:
        make_preview(few.svbrdf, averaged, averaged, ball=2, threads=1)
