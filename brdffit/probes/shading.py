"""Shading by a filtered probe as engines do, by the split sum (Karis 2013; Lagarde and de Rousiers 2014, section 4.9).

    lobe:     T(n.v, r) K(R, lod(r))    R the view mirrored in the normal, K the levels read trilinearly, and
                                        T = specular A + rim B, (A, B) scale and bias of the DFG table
    diffuse:  diffuse (1 - specular) (1 - rim/21) (1 - rim w(n.v)) E(n)

E is irradiance over pi. The diffuse part of ``models.microfacet`` carries (1 - rim w(n.l)) as well, with Schlick's
weight w(c) = (1 - c)^5, which E leaves out: its mean under the cosine takes its place, 2 integral (1 - c)^5 c dc =
1/21. ``rim`` fades out the rise of Fresnel's reflectance to 1 where a surface reflects less than 2%. Under a uniform
environment the result is exact for isotropic GGX lobes above their own horizon. A probe ignores the horizon of a
textured plane, anisotropy, and lobes other than GGX.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from brdffit.machine import core_count
from brdffit.models.microfacet import LEAST_REFLECTANCE
from brdffit.probes.cubemap import look_up, look_up_trilinear
from brdffit.probes.curves import Curve, get_curve
from brdffit.probes.filtering import (
    IRRADIANCE_SIZE,
    LARGEST_SOURCE,
    FilterOptions,
    LevelRequest,
    filter_levels,
    level_requests,
)
from brdffit.probes.presets import get_probe_preset
from brdffit.probes.reading import Surroundings, as_cube
from brdffit.probes.split_sum import dfg_table

#: Mean of Schlick's weight under the cosine.
MEAN_SCHLICK = 1.0 / 21.0


@dataclass(frozen=True)
class ProbeLight:
    """The probe of an environment as an engine holds it.

    Attributes:
        preset: name of the engine.
        curve: roughness curve of the engine.
        levels: (6, n, n, 3) filtered radiance, level 0 first, in world axes.
        irradiance: (6, 32, 32, 3) irradiance over pi.
        dfg: (64, 64, 2) scale and bias over roughness (rows) and n.v (columns), see ``split_sum.dfg_table``.
    """

    preset: str
    curve: Curve
    levels: list[NDArray]
    irradiance: NDArray
    dfg: NDArray

    @classmethod
    def of(cls, radiance: NDArray, preset: str, tolerance: float = 0.005, threads: int | None = None) -> ProbeLight:
        """The probe of a lat-long picture (H, W, 3), middle column along -Z, as ``brdffit probe --for`` filters it.

        Values are not rounded to the format of the preset.

        Raises:
            UnknownNameError: when there is no such preset.
        """
        engine, threads = get_probe_preset(preset), threads or core_count()
        curve = get_curve(engine.curve, engine.levels, engine.size)
        surroundings = Surroundings(Path(), "latlong", np.ascontiguousarray(radiance, np.float32))
        size = max(min(surroundings.natural_size, LARGEST_SOURCE), engine.size)
        source = as_cube(surroundings, size, threads=threads)
        requests = [*level_requests(curve, engine.size, size), LevelRequest(0, IRRADIANCE_SIZE, 1.0, 1.0)]
        made = filter_levels(source, requests, FilterOptions(tolerance=tolerance, threads=threads))
        *levels, irradiance = (each.radiance for each in made)
        return cls(preset, curve, levels, irradiance, dfg_table())

    def reflected(
        self, normal: NDArray, view: NDArray, roughness: NDArray, specular: NDArray, diffuse: NDArray
    ) -> NDArray:
        """(n, 3) float64 radiance towards the viewer; 0 where a normal faces away from it.

        Args:
            normal, view: (n, 3) unit vectors in world axes.
            roughness: (n,) perceptual.
            specular, diffuse: (n, 3) linear colours.
        """
        cosine = np.einsum("ni,ni->n", normal, view)
        mirrored = 2.0 * cosine[:, None] * normal - view
        rim = np.clip(specular.max(axis=1) / LEAST_REFLECTANCE, 0.0, 1.0)[:, None]
        scale, bias = self._scale_and_bias(cosine, roughness).T[..., None]
        around = look_up_trilinear(self.levels, mirrored, self.curve.level(roughness))
        lobe = (specular * (scale + (1.0 - rim) * bias) + rim * bias) * around
        facing = 1.0 - rim * np.power(1.0 - np.clip(cosine, 0.0, 1.0), 5)[:, None]
        matt = diffuse * (1.0 - specular) * (1.0 - rim * MEAN_SCHLICK) * facing * look_up(self.irradiance, normal)
        return np.where(cosine[:, None] > 0.0, lobe + matt, 0.0)

    def _scale_and_bias(self, cosine: NDArray, roughness: NDArray) -> NDArray:
        """(n, 2) scale and bias, read bilinearly and clamped at the border of the table."""
        at = [each * len(self.dfg) - 0.5 for each in (roughness, cosine)]
        read = [map_coordinates(self.dfg[..., k], at, np.float64, order=1, mode="nearest") for k in (0, 1)]
        return np.stack(read, axis=-1)
