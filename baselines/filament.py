"""Filament's ``roughness-prefilter`` as shipped (tools/roughness-prefilter, Apache-2.0; read in its public source).

    R'^2 = E[R]^2 + min(1 / (2 kappa), 0.2^2),   kappa = (3 r - r^3) / (1 - r^2)

The von Mises-Fisher widening, but added to the square of *perceptual* roughness R, with a quarter of the constant that
is right for alpha^2, and capped. R is averaged as stored, the normal map gets ordinary MIP levels, colours are averaged
linearly, and level 0 is left as authored. (The tool averages square blocks of texels; here the user chooses the pixel
filter.)
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from baselines._filtering import LevelContext, log_tensor_of, mean_alpha_squared, unit_normal_and_length
from baselines.naive import Naive
from baselines.vmf import inverse_kappa
from brdffit.roughness import alpha_squared_from_perceptual, perceptual_from_alpha_squared


class Filament(Naive):
    """A capped von Mises-Fisher term in perceptual roughness."""

    name = "filament"
    summary = "R^2 + min(0.5/kappa, 0.04) in perceptual roughness, as Filament's roughness-prefilter ships it"
    leaves_level_0 = True
    #: Factor of 1 / kappa, and the most that is added to R^2.
    factor: ClassVar[float] = 0.5
    cap: ClassVar[float] = 0.2**2

    def finish(self, filtered: Mapping[str, NDArray], context: LevelContext) -> tuple[NDArray, NDArray]:
        """R'^2 = R^2 + min(factor / kappa, cap)."""
        normal, length = unit_normal_and_length(filtered["normal"])
        perceptual = perceptual_from_alpha_squared(mean_alpha_squared(filtered["roughness"], context))
        added = np.minimum(self.factor * inverse_kappa(length), self.cap)
        widened = alpha_squared_from_perceptual(np.sqrt(perceptual * perceptual + added))
        return normal, log_tensor_of(widened, filtered["roughness"], context)
