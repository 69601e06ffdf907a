"""Directional lights and lamps. World axes: x to the right, y up, z towards the viewer."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import LUMINANCE
from brdffit.render.sampling import R2, lobe_rows

#: Directions in the table of lamps, see ``_environment_kernels``.
_TABLE = 1 << 15


@dataclass(frozen=True)
class Lights:
    """Lights infinitely far away: points, which give the hardest light, or discs of even radiance.

    Attributes:
        direction: (n, 3) float32 unit vectors to the lights' middles, in the world.
        irradiance: (n, 3) float32 linear RGB on a surface that faces the light.
        radius: (n,) float64 angular radius in radians, 0 for a point, pi / 2 for a half sky; one entry holds for all.
            (The sun: 0.0047. A softbox of 60 cm at 3 m: 0.1.)
    """

    direction: NDArray
    irradiance: NDArray
    radius: NDArray = dataclasses.field(default_factory=lambda: np.zeros(1))

    def __post_init__(self) -> None:
        direction = np.asarray(self.direction, np.float64).reshape(-1, 3)
        length = np.linalg.norm(direction, axis=1, keepdims=True)
        irradiance = np.asarray(self.irradiance, np.float32).reshape(-1, 3)
        if len(irradiance) != len(direction) or not len(direction) or not (length > 0.0).all():
            raise ValueError("direction and irradiance are (n, 3) with n > 0, and no direction is zero")
        radius = np.broadcast_to(np.asarray(self.radius, np.float64), len(direction))
        if not ((radius >= 0.0) & (radius <= 0.5 * math.pi)).all():
            raise ValueError("a light's angular radius is 0 to pi / 2")
        object.__setattr__(self, "direction", (direction / length).astype(np.float32))
        object.__setattr__(self, "irradiance", irradiance)
        object.__setattr__(self, "radius", radius)

    def __len__(self) -> int:
        return len(self.direction)

    def part(self, chosen: NDArray) -> Lights:
        """Some of the lights, by an array of booleans (n,) of which one at least is true."""
        return Lights(self.direction[chosen], self.irradiance[chosen], self.radius[chosen])

    def by_radius(self) -> Iterator[tuple[float, Lights]]:
        """The lights of each angular radius, points first."""
        for radius in np.unique(self.radius):
            yield float(radius), self.part(self.radius == radius)

    def sized(self, radius: float) -> Lights:
        """The same lights with another angular radius."""
        return Lights(self.direction, self.irradiance, np.array([radius]))

    @cached_property
    def discs(self) -> NDArray:
        """(n, 2, 4) float32 of lights that have a size, see ``_environment_kernels.light_of_lamps``.

        A disc of radiance L and radius r facing the surface gives an irradiance of pi L sin^2 r. Directions are drawn
        from a disc as often as its share of the light's luminance says, evenly over its solid angle.
        """
        found = np.empty((len(self), 2, 4), np.float32)
        found[:, 0, :3] = self.direction
        found[:, 0, 3] = np.square(2.0 * np.sin(0.5 * self.radius))
        found[:, 1, :3] = self.irradiance / (math.pi * np.square(np.sin(self.radius)))[:, None]
        found[:, 1, 3] = self._share / (4.0 * math.pi * np.square(np.sin(0.5 * self.radius)))
        return found

    @property
    def _share(self) -> NDArray:
        """(n,) of the samples that each light gets; a hundredth of them evenly, so that none is left out."""
        luminance = self.irradiance.astype(np.float64) @ LUMINANCE
        total = max(float(luminance.sum()), 1e-30)
        return 0.99 * luminance / total + 0.01 / len(self) if luminance.any() else np.full(len(self), 1.0 / len(self))

    @cached_property
    def table(self) -> NDArray:
        """(TABLE_ROWS, n) float32, the samples that the compiled loops use: see ``_environment_kernels``.

        Radiance and density are those of all discs that a direction lies in.
        """
        j = np.arange(_TABLE)
        u, angle = (0.5 + R2[0] * j) % 1.0, 2.0 * math.pi * ((0.5 + R2[1] * j) % 1.0)
        ends = np.cumsum(self._share)
        chosen = np.minimum(np.searchsorted(ends, u * ends[-1], side="right"), len(self) - 1)
        part = np.clip((u * ends[-1] - (ends - self._share)[chosen]) / self._share[chosen], 0.0, 1.0)
        # Even in the solid angle: sin^2 (t / 2) is even between 0 and sin^2 (r / 2), t the angle from the middle.
        half = np.sqrt(part) * np.sin(0.5 * self.radius[chosen])
        sine, cosine = 2.0 * half * np.sqrt(1.0 - half * half), 1.0 - 2.0 * half * half
        middle = self.direction.astype(np.float64)[chosen]
        # Any two axes across the middle will do (Duff et al. 2017).
        sign = np.where(middle[:, 2] < 0.0, -1.0, 1.0)
        a = -1.0 / (sign + middle[:, 2])
        b = middle[:, 0] * middle[:, 1] * a
        first = np.stack([1.0 + sign * middle[:, 0] ** 2 * a, sign * b, -sign * middle[:, 0]], axis=-1)
        second = np.stack([b, sign + middle[:, 1] ** 2 * a, -middle[:, 1]], axis=-1)
        across = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
        direction = cosine[:, None] * middle + sine[:, None] * across
        radiance, density = self.look_up(direction)
        own = self.discs[chosen, 1]
        # Rounding may leave a direction at the rim outside its own disc.
        outside = density <= 0.0
        radiance[outside], density[outside] = own[outside, :3], own[outside, 3]
        return np.stack([*lobe_rows(_TABLE), *direction.T, *radiance.T, density]).astype(np.float32)

    def look_up(self, direction: NDArray) -> tuple[NDArray, NDArray]:
        """Radiance (m, 3) and density (m,) of the table's samples in some directions (m, 3)."""
        discs = self.discs.astype(np.float64)
        # |d - c|^2 against the squared chord of the radius; d and c are rounded, so their lengths are not left out.
        square = np.square(direction).sum(axis=1)[:, None] + np.square(discs[:, 0, :3]).sum(axis=1)
        inside = np.float64(square - 2.0 * direction @ discs[:, 0, :3].T < discs[:, 0, 3])
        return inside @ discs[:, 1, :3], inside @ discs[:, 1, 3]


def few() -> Lights:
    """Four small lights: a warm key, a cool fill and a low one in front of a plane that faces the viewer, and one
    behind it, which a plane that runs to the horizon mirrors."""
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


def lamps() -> Lights:
    """The few small lights as lamps of finite size: softboxes of 6, 3 and 12 degrees radius, and one of 1.5 behind."""
    return Lights(few().direction, few().irradiance, np.radians([6.0, 3.0, 12.0, 1.5]))
