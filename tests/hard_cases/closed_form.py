"""The closed-form start of each texel of a sample, made as the fit makes it, and how good it is at its best scale."""

from __future__ import annotations

import numpy as np

from brdffit.fitting.bfgs import FREE_ANISOTROPY
from brdffit.fitting.method import search_settings
from brdffit.fitting.presets import quality_of
from brdffit.fitting.rules import level_rules
from brdffit.fitting.sampling import LevelSample, Lobes
from brdffit.footprint import get_pixel_filter
from brdffit.halfangle.apparent_lobe import DIFFUSE_MOMENT, gather_lobes, normalise_mixture
from brdffit.halfangle.closed_forms import LEAN, STARTS, closed_forms
from brdffit.halfangle.quadrature import LOBE_COLUMNS


def closed_form_start(sample: LevelSample) -> Lobes:
    """LEAN's lobe in the frame of the mean normal, within the bounds of the fit, with the filtered colour."""
    options, quality = sample.options, quality_of(sample.options)
    pixel_filter = get_pixel_filter(options.pixel_filter)
    rules = level_rules(pixel_filter, sample.base_size, sample.size, sample.mip_level, quality)
    search = search_settings(options, quality, sample.base, sample.source, sample.target)
    theta, scale = np.zeros((len(sample), 6)), np.zeros((len(sample), 3))
    lobes, starts = np.zeros((rules.room, LOBE_COLUMNS)), np.zeros((STARTS, 6))
    for i, (column, row) in enumerate(zip(sample.columns, sample.rows, strict=True)):
        count, _ = gather_lobes(sample.base, rules.strata, search.step, column, row, lobes, np.zeros(DIFFUSE_MOMENT))
        *colour, some = normalise_mixture(lobes, count)
        closed_forms(lobes, count, sample.base.isotropic, starts, search.free & FREE_ANISOTROPY == 0)
        theta[i] = _within(starts[LEAN], search)
        scale[i] = np.maximum(colour, 0.0) if some else 0.0
    return Lobes(theta, scale)


def _within(theta, search):
    theta = theta.copy()
    values, vectors = np.linalg.eigh([[theta[2], theta[4]], [theta[4], theta[3]]])
    log_tensor = (vectors * np.clip(values, search.log_low, search.log_high)) @ vectors.T
    theta[2:5] = log_tensor[0, 0], log_tensor[1, 1], log_tensor[0, 1]
    theta[5] = np.clip(theta[5], search.shape_low, search.shape_high)
    return theta


def measure_beside_start(sample: LevelSample, found: list[Lobes], **rule) -> tuple[np.ndarray, np.ndarray]:
    """Errors (M, n) of lobes by the dense measure, and the start's (n,) with the best common scale if scales are free.

    The error is a parabola in a common factor of the scale, so three values tell its minimum.
    """
    start = closed_form_start(sample)
    versions = [start, *(Lobes(start.theta, factor * start.scale) for factor in (0.0, 2.0)), *found]
    one, none, two, *errors = sample.measure(versions, **rule).error
    if sample.options.specular == "free":
        curvature = 0.5 * (two + none) - one
        slope = one - none - curvature
        flat = curvature <= 0.0
        one = np.where(flat, one, np.minimum(one, none - slope**2 / (4.0 * np.where(flat, 1.0, curvature))))
    return np.array(errors), one
