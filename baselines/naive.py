"""Plain averages: every channel is averaged by itself and the normal is made unit length again.

Perceptual roughness is averaged as stored (R' = E[R]), colours linearly. The spread of the normals is lost.
"""

from __future__ import annotations

from collections.abc import Mapping

from numpy.typing import NDArray

from baselines._filtering import (
    FilteringMethod,
    LevelContext,
    log_tensor_of,
    mean_alpha_squared,
    roughness_channels,
    unit_normal_and_length,
)
from brdffit.svbrdf import Svbrdf


class Naive(FilteringMethod):
    """Average every channel, renormalise the normal."""

    name = "naive"
    summary = "average every channel, renormalise the normal: what most texture tools do"

    def channels(self, svbrdf: Svbrdf, notes: list[str]) -> dict[str, NDArray]:
        """Normals and perceptual roughness."""
        return {"normal": svbrdf.normal, "roughness": roughness_channels(svbrdf)}

    def finish(self, filtered: Mapping[str, NDArray], context: LevelContext) -> tuple[NDArray, NDArray]:
        """n' = E[n] / |E[n]|, R' = E[R]."""
        normal, _ = unit_normal_and_length(filtered["normal"])
        roughness = filtered["roughness"]
        return normal, log_tensor_of(mean_alpha_squared(roughness, context), roughness, context)
