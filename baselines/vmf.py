"""Normals as a von Mises-Fisher distribution: Banerjee et al. 2005 for kappa, Neubelt & Pettineo 2013 for its use.

    kappa = (3 r - r^3) / (1 - r^2),   r = |E[n]|
    Sigma' = E[Sigma] + (2 / kappa) I      (isotropic: alpha'^2 = E[alpha^2] + 2 / kappa)

The sum is in alpha^2 (the constant is Karis's correction of Neubelt & Pettineo's 1 / kappa), not in perceptual
roughness. For normals whose slopes have a small variance s^2 in each axis, r = 1 - s^2 and kappa = 1 / s^2 to first
order, hence alpha'^2 = alpha^2 + 2 s^2: LEAN's answer for an isotropic spread. alpha^2 is averaged, as variances are;
colours are averaged linearly.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from baselines._filtering import (
    FilteringMethod,
    LevelContext,
    log_of_bounded_tensor,
    tensor_channels,
    unit_normal_and_length,
    with_three_channels,
)
from brdffit.svbrdf import Svbrdf


def inverse_kappa(length: NDArray) -> NDArray:
    """1 / kappa of the mean length r in [0, 1]: 0 at r = 1, large at r = 0."""
    length = np.maximum(length, 1e-6)
    return (1.0 - length * length) / (length * (3.0 - length * length))


class VonMisesFisher(FilteringMethod):
    """alpha^2 + 2 / kappa."""

    name = "vmf"
    summary = "alpha^2 + 2/kappa, normals as a von Mises-Fisher distribution (Neubelt & Pettineo 2013, Karis 2018)"

    def channels(self, svbrdf: Svbrdf, notes: list[str]) -> dict[str, NDArray]:
        """Normals and the roughness tensor."""
        return {"normal": svbrdf.normal, "tensor": tensor_channels(svbrdf)}

    def finish(self, filtered: Mapping[str, NDArray], context: LevelContext) -> tuple[NDArray, NDArray]:
        """Sigma' = E[Sigma] + 2 / kappa."""
        normal, length = unit_normal_and_length(filtered["normal"])
        tensor = with_three_channels(filtered["tensor"])
        tensor[..., :2] += 2.0 * inverse_kappa(length)[..., None]
        return normal, log_of_bounded_tensor(tensor, context)
