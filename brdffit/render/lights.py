"""Directional lights. World axes: x to the right, y up, z towards the viewer."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Lights:
    """Lights infinitely far away and infinitely small: the hardest that a texture can be lit with.

    Attributes:
        direction: (n, 3) float32 unit vectors to the lights, in the world.
        irradiance: (n, 3) float32 linear RGB on a surface that faces the light.
    """

    direction: NDArray
    irradiance: NDArray

    def __post_init__(self) -> None:
        direction = np.asarray(self.direction, np.float64).reshape(-1, 3)
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        irradiance = np.asarray(self.irradiance, np.float32).reshape(-1, 3)
        if len(irradiance) != len(direction) or not len(direction) or not (length > 0.0).all():
            raise ValueError("direction and irradiance are (n, 3) with n > 0, and no direction is zero")
        object.__setattr__(self, "direction", (direction / length).astype(np.float32))
        object.__setattr__(self, "irradiance", irradiance)

    def __len__(self) -> int:
        return len(self.direction)


def few() -> Lights:
    """Four small lights: a warm key, a cool fill and a low one before a plane that faces the viewer, and one behind it,
    which a plane that runs to the horizon mirrors."""
    return Lights(
        np.array([(-0.35, 0.45, 1.0), (0.75, 0.10, 0.80), (0.10, -0.60, 0.75), (0.05, 0.50, -0.85)]),
        np.array([(3.2, 3.0, 2.7), (1.3, 1.5, 1.8), (0.9, 0.8, 0.7), (2.6, 2.6, 2.8)]),
    )


def many(n: int, seed: int = 0) -> Lights:
    """``n`` white lights, cosine-distributed about the axis towards the viewer; irradiances sum to pi."""
    u = np.random.default_rng(seed).random((n, 2))
    radius, angle = np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
    direction = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - u[:, 0])], axis=-1)
    return Lights(direction, np.full((n, 3), math.pi / n))
