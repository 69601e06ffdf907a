"""The sizes of the lights of a scene, for the fit's ``lights`` option and the measure of a plan.

A lamp has a size of its own. An environment is decomposed into lights: its luminance is cut into slabs, each between
two values of luminance, and in each slab every connected patch of sky is a light as bright as the slab is thick:
L = sum_k min(max(L - t_k, 0), t_(k+1) - t_k). A sun in a sky becomes a small disc with the luminance that the sun adds,
and a wide light for the sky.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from brdffit.colour import LUMINANCE
from brdffit.comparison.surroundings import read_environment
from brdffit.errors import InputError
from brdffit.planning.description import PROCEDURAL, SceneFile, Surface
from brdffit.render.environment import Environment

#: Most sizes of light that are distinguished in a scene: as many as the fit's default has, so the fit takes no longer.
MOST_SIZES = 3
#: Slabs of an environment's luminance, each with the same part of its light; rows to which a picture is reduced.
_SLABS, _ROWS = 12, 1024
#: Radius in degrees below which sizes count as equal: a fifth of the sun's.
_LEAST_RADIUS = 0.05


class LightSize(NamedTuple):
    """Lights of one angular radius.

    Attributes:
        radius: degrees; 0: points.
        luminance: of each source of the scene (its lights in order, then its environment) that shines at this size:
            (sources,), the irradiance of a surface that faces it.
    """

    radius: float
    luminance: NDArray


def light_sizes(scene: SceneFile, surface: Surface) -> list[LightSize]:
    """Sizes of the lights that shine on a surface, at most ``MOST_SIZES``, ascending.

    The nearest sizes are merged (Ward 1963, by the logarithm of the radius, weighted by luminance).

    Raises:
        InputError: when the environment cannot be read, or there is no light.
    """
    sources = len(scene.lights) + (scene.environment is not None)
    found: list[LightSize] = []

    def add(radius: float, source: int, luminance: float) -> None:
        if luminance > 0.0:
            found.append(LightSize(radius, luminance * np.eye(sources)[source]))

    for i, light in enumerate(scene.lights):
        add(0.5 * light.size, i, float(np.dot(LUMINANCE, light.rgb)))
    if scene.environment is not None:
        for radius, luminance in _sizes_around(scene.environment, surface.radius is None):
            add(radius, sources - 1, luminance)
    if not found:
        raise InputError(
            "The lights of the scene are black: expected an `irradiance` above 0, or an environment that is not black "
            f"where '{surface.name or surface.set}' faces it."
        )
    return _merged(found)


def lights_option(sizes: Sequence[LightSize]) -> str:
    """The fit's ``lights`` for these sizes: "point", or radii in degrees with shares."""
    if all(each.radius == 0.0 for each in sizes):
        return "point"
    # A share that would be written as 0 is raised to the smallest that can be written.
    shares = np.maximum(shares_of(sizes), 0.001)
    return ",".join(f"{each.radius:.3g}:{share:.3f}" for each, share in zip(sizes, shares, strict=True))


def shares_of(sizes: Sequence[LightSize]) -> NDArray:
    """Share (S,) of each size in all the light, by luminance."""
    luminance = np.array([each.luminance.sum() for each in sizes])
    return luminance / luminance.sum()


def environment_sizes(environment: Environment, front: bool) -> list[tuple[float, float]]:
    """(radius in degrees, luminance) of the lights into which an environment is decomposed.

    Args:
        environment: around the surface.
        front: whether only the part before the surface counts, at z > 0.
    """
    luminance, solid_angle, z = _small(environment)
    if front:
        luminance = np.where(z > 0.0, luminance, 0.0)
    edges = _slab_edges(luminance, solid_angle)
    found = []
    for low, high in zip(edges[:-1], edges[1:], strict=True):
        patches, count = ndimage.label(luminance > low, ndimage.generate_binary_structure(2, 2))
        which = np.arange(1, count + 1)
        area = ndimage.sum_labels(solid_angle, patches, which)
        power = ndimage.sum_labels((np.minimum(luminance, high) - low) * solid_angle, patches, which)
        # A cap of radius r has the solid angle 2 pi (1 - cos r).
        radius = np.degrees(np.arccos(np.maximum(1.0 - area / (2.0 * math.pi), 0.0)))
        found += list(zip(radius.tolist(), power.tolist(), strict=True))
    return found


@cache
def _sizes_around(name: str, front: bool) -> list[tuple[float, float]]:
    return environment_sizes(read_environment(None if name == PROCEDURAL else name), front)


def _small(environment: Environment) -> tuple[NDArray, NDArray, NDArray]:
    """Luminance, solid angle and z of an environment's pixels at a reduced size, (h, w) each.

    Columns begin behind the surface, so that no light before the surface is cut by the border.
    """
    luminance = environment.radiance.astype(np.float64) @ LUMINANCE.astype(np.float64)
    height, width = luminance.shape
    mass = luminance * environment.solid_angle[:, None]
    step = max(height // _ROWS, 1)
    rows, columns = np.arange(0, height, step), np.arange(0, width, step)
    angle = np.add.reduceat(np.broadcast_to(environment.solid_angle[:, None], mass.shape), rows, axis=0)
    angle = np.add.reduceat(angle, columns, axis=1)
    mass = np.add.reduceat(np.add.reduceat(mass, rows, axis=0), columns, axis=1)
    azimuth = (np.minimum(columns + 0.5 * step, width) / width * 2.0 - 1.0) * math.pi + environment.rotation
    elevation = (0.5 - np.minimum(rows + 0.5 * step, height) / height) * math.pi
    z = -np.cos(elevation)[:, None] * np.cos(azimuth)
    behind = int(np.argmin(z[len(z) // 2]))
    return tuple(np.roll(each, -behind, axis=1) for each in (mass / angle, angle, z))  # type: ignore[return-value]


def _slab_edges(luminance: NDArray, solid_angle: NDArray) -> NDArray:
    """Ascending values of luminance from 0 to its greatest; the slabs between them hold equal parts of the light."""
    order = np.argsort(luminance, axis=None)
    value, area = luminance.ravel()[order], solid_angle.ravel()[order]
    # Light below a value t: int min(L, t) dw, which rises by the area above t.
    above = area.sum() - np.concatenate([[0.0], np.cumsum(area)[:-1]])
    below = np.cumsum(above * np.diff(value, prepend=0.0))
    if below[-1] <= 0.0:
        return np.zeros(1)
    return np.unique(np.concatenate([[0.0], np.interp(np.linspace(0.0, below[-1], _SLABS + 1)[1:], below, value)]))


def _merged(sizes: Sequence[LightSize]) -> list[LightSize]:
    sizes = sorted(sizes, key=lambda each: each.radius)
    radius = np.log(np.maximum([each.radius for each in sizes], _LEAST_RADIUS))
    luminance = np.array([each.luminance for each in sizes])
    points = sizes[0].radius == 0.0
    while len(radius) > 1:
        weight = luminance.sum(axis=1)
        costs = weight[:-1] * weight[1:] / (weight[:-1] + weight[1:]) * np.square(np.diff(radius))
        i = int(np.argmin(costs))
        if len(radius) <= MOST_SIZES and costs[i] > 0.0:
            break
        radius[i] = np.average(radius[i : i + 2], weights=weight[i : i + 2])
        luminance[i] += luminance[i + 1]
        radius, luminance = np.delete(radius, i + 1), np.delete(luminance, i + 1, axis=0)
    found = np.exp(radius)
    # If there was a point light, the smallest size is a point, unless larger lights were merged into it.
    found[0] = 0.0 if points and found[0] <= _LEAST_RADIUS * (1.0 + 1e-9) else found[0]
    return [LightSize(float(r), each) for r, each in zip(found, luminance, strict=True)]
