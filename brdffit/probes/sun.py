"""Find the compact lamp that dominates an environment, which an engine should draw as a light of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import LUMINANCE
from brdffit.probes.cubemap import directions, mean_radiance, solid_angles

#: Least luminance of the lamp's texels over the largest, their largest distance from it in degrees, and the lamp's
#: least share of the environment's energy.
_PART, _REACH, _SHARE = 0.05, 6.0, 0.05


@dataclass(frozen=True)
class Sun:
    """A compact lamp.

    Attributes:
        direction: unit vector towards it.
        radiance: mean over its disc, RGB.
        irradiance: on a plane that faces it, RGB.
        radius_degrees: angular radius of a disc of the same solid angle.
        share: share of the environment's energy, by luminance.
    """

    direction: tuple[float, float, float]
    radiance: tuple[float, float, float]
    irradiance: tuple[float, float, float]
    radius_degrees: float
    share: float


def find_sun(cube: NDArray) -> Sun | None:
    """The brightest compact lamp of a cube map (6, n, n, 3), if it holds more than 5% of the energy; else None."""
    n = cube.shape[1]
    at, angle = directions(n).reshape(-1, 3), np.tile(solid_angles(n).ravel(), 6)
    radiance = cube.reshape(-1, 3).astype(np.float64)
    luminance = radiance @ LUMINANCE
    brightest = int(luminance.argmax())
    near = at @ at[brightest] > np.cos(np.radians(_REACH))
    chosen = near & (luminance > _PART * luminance[brightest])
    flux = (radiance[chosen] * angle[chosen, None]).sum(axis=0)
    whole = float(mean_radiance(cube) @ LUMINANCE) * 4.0 * np.pi
    share = float(flux @ LUMINANCE) / whole if whole > 0.0 else 0.0
    size = float(angle[chosen].sum())
    # A bright sky is no lamp: the share of energy must be at least 20 times the share of the sphere.
    if share < _SHARE or share < 20.0 * size / (4.0 * np.pi):
        return None
    centre = (at[chosen] * (luminance * angle)[chosen, None]).sum(axis=0)
    centre /= np.linalg.norm(centre)
    radius = float(np.degrees(np.arccos(1.0 - size / (2.0 * np.pi))))
    triple = [tuple(float(f"{each:.6g}") for each in values) for values in (centre, flux / size, flux)]
    return Sun(triple[0], triple[1], triple[2], round(radius, 3), round(share, 4))  # type: ignore[arg-type]
