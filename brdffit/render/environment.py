"""Light from all around: an equirectangular picture of radiance, how it is sampled, and the one that ships.

World axes: x to the right, y up, z towards the viewer. Row 0 is straight up; the middle column is straight ahead of the
camera (-z), a quarter to the right of it is the camera's right (+x).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Environment:
    """Radiance from all directions.

    Attributes:
        radiance: (H, W, 3) float32 linear RGB, equirectangular; constant inside a pixel.
        rotation: angle in radians by which the surroundings are turned about the y axis.
    """

    radiance: NDArray
    rotation: float = 0.0

    def __post_init__(self) -> None:
        radiance = np.ascontiguousarray(self.radiance, np.float32)
        if radiance.ndim != 3 or radiance.shape[2] != 3 or not radiance.size:
            raise ValueError(f"radiance has shape {radiance.shape}, expected (H, W, 3)")
        if not (np.isfinite(radiance).all() and (radiance >= 0.0).all()):
            raise ValueError("radiance holds numbers that are negative or not finite")
        object.__setattr__(self, "radiance", radiance)

    def rotated(self, angle: float) -> Environment:
        """The same surroundings, turned by ``angle`` more radians about the y axis (counter-clockwise from above)."""
        return Environment(self.radiance, self.rotation + angle)

    @cached_property
    def solid_angle(self) -> NDArray:
        """(H,) float64 solid angle of the pixels of each row; they sum to 4 pi over the picture."""
        height, width = self.radiance.shape[:2]
        edge = np.cos(np.linspace(0.0, math.pi, height + 1))
        return (edge[:-1] - edge[1:]) * (2.0 * math.pi / width)

    def total(self) -> NDArray:
        """(3,) float64 integral of the radiance over all directions."""
        return np.einsum("h,hwc->c", self.solid_angle, self.radiance.astype(np.float64))


def procedural_environment(height: int = 256) -> Environment:
    """The environment that ships: a studio with two soft boxes, four small bright lamps, and a floor that fades.

    ``height`` rows and twice as many columns.
    """
    row, column = np.meshgrid(np.arange(height) + 0.5, np.arange(2 * height) + 0.5, indexing="ij")
    elevation = (0.5 - row / height) * math.pi
    azimuth = (column / height - 1.0) * math.pi
    up = np.sin(elevation)[..., None]
    warm, cool = np.array([1.0, 0.93, 0.84]), np.array([0.84, 0.92, 1.0])
    # Walls grow a little brighter upwards; the floor is brightest below the camera.
    walls = 0.10 * cool * (0.6 + 0.8 * np.maximum(up, 0.0))
    floor = 0.16 * warm * np.square(np.maximum(-up, 0.0)) + 0.045
    radiance = np.where(up > 0.0, walls, floor)

    def box(at: tuple[float, float], size: tuple[float, float], colour: NDArray) -> None:
        """A soft box with rounded shoulders: centre and half size in degrees of azimuth and elevation."""
        x = np.abs((np.degrees(azimuth) - at[0] + 180.0) % 360.0 - 180.0) / size[0]
        y = np.abs(np.degrees(elevation) - at[1]) / size[1]
        inside = np.clip((1.0 - np.maximum(x, y)) * 12.0, 0.0, 1.0)
        radiance[...] += (inside * (1.0 - 0.3 * y * y))[..., None] * colour

    def lamp(at: tuple[float, float], radius: float, colour: NDArray) -> None:
        """A round lamp: centre in degrees of azimuth and elevation, radius in degrees."""
        to = np.radians(at)
        cosine = np.sin(elevation) * math.sin(to[1]) + np.cos(elevation) * math.cos(to[1]) * np.cos(azimuth - to[0])
        distance = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        inside = np.clip((radius - distance) * height / 180.0 + 0.5, 0.0, 1.0)
        radiance[...] += inside[..., None] * colour

    # Azimuth 0 is ahead of the camera, 180 behind it, where a surface that faces the camera looks.
    box((140.0, 35.0), (22.0, 18.0), 7.0 * warm)
    box((-120.0, 25.0), (9.0, 38.0), 5.0 * cool)
    box((0.0, 40.0), (50.0, 6.0), 4.0 * np.ones(3))
    lamp((-165.0, 52.0), 2.2, 260.0 * warm)
    lamp((165.0, -8.0), 1.5, 180.0 * cool)
    lamp((-150.0, 5.0), 1.2, 220.0 * np.array([1.0, 0.72, 0.45]))
    lamp((25.0, 22.0), 1.8, 160.0 * np.ones(3))
    return Environment(radiance)
