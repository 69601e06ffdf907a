"""Pictures lit through a filtered probe, as engines do it: they show what probe and split sum add to the error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import LobePyramid, Lookups
from brdffit.probes.shading import ProbeLight
from brdffit.render.environment import Environment
from brdffit.render.lighting import Pixels
from brdffit.render.scenes import Scene, level_of_detail
from brdffit.roughness import perceptual_from_alpha_squared
from brdffit.svbrdf import Svbrdf


def picture_through_probe(
    levels: Sequence[Svbrdf], scene: Scene, light: ProbeLight, environment: Environment
) -> NDArray:
    """Linear radiance (h, w, 3) float32 of a pyramid of lobes.

    Engines use one isotropic GGX lobe a pixel: an anisotropic lobe counts with the geometric mean of its two alphas.

    Args:
        levels: MIP levels from level 0 down.
        scene: what the camera sees.
        light: the probe of ``environment``, which tells how it is turned.
    """
    pyramid, pixels = LobePyramid(levels), Pixels(scene)
    at = pixels.rows, pixels.columns
    detail = np.asarray(level_of_detail(scene), np.float64)[at]
    axes = np.ascontiguousarray(scene.axes[at], np.float64)
    lobes = pyramid.look_up(Lookups(pixels.centre, axes, detail, pixels.view))
    tensor = lobes.tensor.astype(np.float64)
    determinant = np.maximum(tensor[:, 0] * tensor[:, 1] - np.square(tensor[:, 2]), 1e-30)
    # Rows of a frame are the world's axes as the surroundings have them, in tangent space.
    to_world = environment.turned(pixels.frame)
    normal, view = (np.einsum("nij,ni->nj", to_world, each.astype(np.float64)) for each in (lobes.normal, pixels.view))
    roughness = perceptual_from_alpha_squared(np.sqrt(determinant))
    picture = np.zeros((*scene.pixels, 3), np.float32)
    picture[at] = light.reflected(normal, view, roughness, lobes.specular, lobes.diffuse)
    return picture
