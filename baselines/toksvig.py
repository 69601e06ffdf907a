"""Toksvig 2005, "Mipmapping Normal Maps", in the alpha^2 form that Unreal's composite textures use.

With r = |E[n]| and V = (1 - r) / r, Toksvig's power is p' = p / (1 + V p). Put p = 2 / alpha^2 - 2:

    B = 2 V (alpha^2 - 1),    alpha'^2 = (B - alpha^2) / (B - 1).

As in Unreal, alpha^2 is that of the averaged perceptual roughness; colours are averaged linearly.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from baselines._filtering import LevelContext, log_tensor_of, mean_alpha_squared, unit_normal_and_length
from baselines.naive import Naive


class Toksvig(Naive):
    """Roughness from the length of the mean normal."""

    name = "toksvig"
    summary = "roughness widened by the length of the mean normal (Toksvig 2005; Unreal's composite textures)"

    def finish(self, filtered: Mapping[str, NDArray], context: LevelContext) -> tuple[NDArray, NDArray]:
        """alpha'^2 = (B - alpha^2) / (B - 1), numerator and denominator multiplied by r, which may be 0."""
        normal, length = unit_normal_and_length(filtered["normal"])
        alpha_squared = np.minimum(mean_alpha_squared(filtered["roughness"], context), 1.0)
        minus_b = 2.0 * (1.0 - length) * (1.0 - alpha_squared)
        # 0 / 0 only where r = 0 and alpha = 1: any r > 0 gives the limit 1 there.
        length = np.maximum(length, 1e-6)
        widened = (length * alpha_squared + minus_b) / (length + minus_b)
        return normal, log_tensor_of(widened, filtered["roughness"], context)
