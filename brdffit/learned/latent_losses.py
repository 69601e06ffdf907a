"""The two losses of the method ``latent``: the exact half-angle objective, and the paper's, with one sample a pixel.

Both measure the lobes that trilinear filtering of a decoder's outputs gives at a crop's points. Half vectors of
cosine-distributed lights and viewers follow the half-angle density, so both measure the same error:

- ``exact``: log(e + floor), e the relative squared error of the lobe at its best scale, over the nodes of the point's
  own table. It needs no random numbers; the scale is learned separately, as in ``residual_training``.
- ``paper``: equation 5, |P - G|^2 / (|P|^2 + epsilon) over images of one scale and half vector. The denominator is not
  differentiated; G is one sample of the base within the footprint (Noise2Noise).
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import numba_type, types
from brdffit.fitting.batch import model_kernels
from brdffit.halfangle.objective import lobe_values_type, log_normalisation_type, moments_type
from brdffit.learned.asked import MOST_FACTOR
from brdffit.learned.crops import POINTS, TEXELS, Crop
from brdffit.learned.kernels.interpolation import (
    LIFTED,
    interpolate_rows,
    lift_rows,
    slopes_back,
    spread_rows,
)
from brdffit.learned.kernels.rendering import relative_rows
from brdffit.learned.kernels.tables import errors_of
from brdffit.learned.latent import LONGEST, OUTPUTS
from brdffit.roughness import DEFAULT_MIN_ROUGHNESS

LOSSES = ("exact", "paper")
#: Exact loss: the floor below which an error no longer counts relative to itself, and the longest gradient of a point.
FLOOR, _STEEPEST = 0.1, 3.0
#: The paper's loss: half vectors of a step, and epsilon of its denominator.
LIGHTS, _EPSILON = 64, 0.01


def exact_loss(said: NDArray, crop: Crop, model: str) -> tuple[float, NDArray]:
    """The exact loss of outputs (TEXELS, OUTPUTS) of a decoder of this model, averaged, and its gradient by them."""
    assert crop.table is not None
    points = len(crop.taps)
    whole, mean, theta = _interpolated(said, crop)
    found = errors_of(crop.table, np.arange(points), theta, model)
    fine = np.isfinite(found.error) & np.isfinite(found.gradient).all(axis=1)
    error = np.where(fine, np.maximum(found.error, 0.0), 1.0)
    weight = np.where(fine, 1.0 / (error + FLOOR), 0.0)
    by_mean = np.zeros((points, LIFTED))
    slopes_back(mean, np.where(fine[:, None], found.gradient, 0.0) * weight[:, None], _STEEPEST, by_mean)
    scale = crop.table.colour * np.exp(np.clip(mean[:, 6], -MOST_FACTOR, MOST_FACTOR))
    # Clipping turns the squared error into a linear one where the scale is far off.
    by_mean[:, 6] = np.where(fine, 2.0 * np.clip(found.weight * weight * (scale - found.scale) * scale, -1.0, 1.0), 0.0)
    return float(np.mean(np.log(error + FLOOR))), _spread(said, whole, crop, by_mean / points)


def rendering_loss(said: NDArray, crop: Crop, model: str, rng: np.random.Generator) -> tuple[float, NDArray]:
    """The paper's loss of outputs (TEXELS, OUTPUTS), its mean over images, and its gradient by them."""
    points = len(crop.taps)
    whole, mean, theta = _interpolated(said, crop)
    filtered = (crop.shares * crop.pooled_light[crop.taps]).sum(axis=1)
    scale = filtered * np.exp(np.clip(mean[:, 6], -MOST_FACTOR, MOST_FACTOR))
    by_theta, by_scale = np.zeros((points, 5)), np.zeros(points)
    offset = rng.random((points, LIGHTS, 2), dtype=np.float32) - np.float32(0.5)
    source, target = model_kernels(crop.model, crop.model), model_kernels("ggx", model)
    loss = _rendering_kernel()(
        theta, scale, half_vectors(LIGHTS, rng), POINTS, crop.normal, crop.tensor, crop.light, crop.x, crop.y,
        crop.size, offset, _EPSILON, 4.0 * math.log(DEFAULT_MIN_ROUGHNESS), by_theta, by_scale, target.moments,
        target.values, target.log_normalisation, source.values, source.source_log_normalisation,
    )  # fmt: skip
    fine = np.isfinite(by_theta).all(axis=1) & np.isfinite(by_scale)
    by_mean = np.zeros((points, LIFTED))
    slopes_back(mean, np.where(fine[:, None], by_theta, 0.0), np.inf, by_mean)
    by_mean[:, 6] = np.where(fine, by_scale, 0.0)
    return float(loss), _spread(said, whole, crop, by_mean / (points // POINTS))


def half_vectors(count: int, rng: np.random.Generator) -> NDArray:
    """(3, count) float32 half vectors of cosine-distributed lights and viewers."""
    u = rng.random((2, 2, count))
    radius, angle = np.sqrt(u[0]), 2.0 * math.pi * u[1]
    light, view = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - u[0])], axis=1)
    half = light + view
    return np.ascontiguousarray(half / np.linalg.norm(half, axis=0), np.float32)


def _interpolated(said: NDArray, crop: Crop) -> tuple[NDArray, NDArray, NDArray]:
    points = len(crop.taps)
    whole, mean, theta = np.empty((TEXELS, LIFTED)), np.empty((points, LIFTED)), np.empty((points, 5))
    lift_rows(said, LONGEST, whole)
    interpolate_rows(whole, crop.taps, crop.shares, mean, theta)
    return whole, mean, theta


def _spread(said: NDArray, whole: NDArray, crop: Crop, by_mean: NDArray) -> NDArray:
    by_said = np.empty((TEXELS, OUTPUTS))
    spread_rows(said, whole, crop.taps, crop.shares, by_mean, np.empty((TEXELS, LIFTED)), LONGEST, by_said)
    return by_said


@cache
def _rendering_kernel() -> Any:
    """``relative_rows``, compiled for function-typed arguments so that it can be cached on disk."""
    line, square, single = np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1), np.float32)
    image = np.zeros((1, 1, 3), np.float32)
    data = (
        square, line, single, 1, image, image, single, line, line, line, image, 0.0, 0.0, square, line,
    )  # fmt: skip
    floats, values, normalisation = types.float32, lobe_values_type(types.float32), log_normalisation_type
    functions = (moments_type(floats), values, normalisation, values, normalisation)
    relative_rows.compile((*map(numba_type, data), *functions))
    relative_rows.disable_compile()
    return relative_rows
