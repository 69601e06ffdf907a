"""Low-discrepancy numbers for the tables of directions of the compiled loops."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

#: Plastic number's reciprocals: the two-dimensional additive recurrence of lowest discrepancy known (Roberts 2018).
R2 = (0.7548776662466927, 0.5698402909980532)


def lobe_rows(count: int) -> tuple[NDArray, NDArray]:
    """r cos f and r sin f (count,) of slopes that follow a GGX lobe of alpha 1: r^2 = u / (1 - u).

    The lobe's far tail (r > 100) is left to the samples of the light.
    """
    j = np.arange(count)
    u, angle = (0.5 + R2[0] * j) % 1.0, 2.0 * math.pi * ((0.5 + R2[1] * j) % 1.0)
    r = np.sqrt(u / np.maximum(1.0 - u, 1e-4))
    return r * np.cos(angle), r * np.sin(angle)
