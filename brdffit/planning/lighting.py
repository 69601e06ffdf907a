"""Pairs of directions to viewer and light, drawn from a scene's cameras and lights, for errors over random pairs.

The measure is that of pictures: a direction of view counts by the pixels that see the surface from there, a direction
of light by the luminance that a surface facing it receives. Cosines are left to the terms of the BRDF.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import LUMINANCE
from brdffit.comparison.surroundings import read_environment
from brdffit.errors import InputError
from brdffit.planning.description import PROCEDURAL, Light, SceneFile, Surface
from brdffit.planning.reach import GRAZING, shown_turn
from brdffit.render.environment import Environment
from brdffit.render.lights import Lights
from brdffit.render.scenes import into_frame

#: Number of directions that represent an environment: the pixels of a map of 256 x 128.
_ENVIRONMENT_DIRECTIONS = 1 << 15

# Pairs are drawn anew until both directions are above the horizon. If none is in this many draws, no light reaches it.
_DRAWS, _ROUNDS = 4096, 8
# For highlights: pairs that are drawn for all texels; how many of them each texel chooses from (choosing from all would
# take longer, and choosing from the same ones would give all texels the same error); share of the chance that follows
# the highlights, and their least width.
_POOL, _WINDOW, _FOLLOW, _LEAST_WIDTH = 1 << 17, 1 << 14, 0.5, 0.01


def directions(
    scene: SceneFile,
    surface: Surface,
    texels: int,
    pairs: int,
    seed: int = 0,
    highlights: tuple[NDArray, NDArray] | None = None,
    luminance: NDArray | None = None,
) -> tuple[NDArray, NDArray, NDArray]:
    """Random pairs of directions at some texels of a surface.

    View: a camera (all are equally likely), a tilt within its range (as often as pixels see it, by projected solid
    angle) and any azimuth. Light: one of the lights or the environment, drawn by luminance, and a direction within its
    size. A curved surface turns the frame of both at random, as far as the camera sees it turn. Pairs below the horizon
    of the frame are drawn anew.

    Args:
        scene: as ``read_scene`` gives it.
        surface: one of the scene's.
        texels: how many.
        pairs: at each texel.
        seed: same seed, same directions.
        highlights: the K lobes of each texel that are compared: normals (texels, K, 3) and widths alpha (texels, K).
            Half of the pairs are then chosen so that their half vectors lie in these lobes, with smaller weights in
            return: small lights hardly ever hit a sharp lobe by chance, and a few dozen such pairs tell as much as
            thousands of others.
        luminance: (sources,) of the lights in order, then of the environment, to use instead of their own (see
            ``sizes.LightSize``).

    Returns:
        view and light (texels, pairs, 3), float64 unit vectors in the tangent space of the mean plane (where a surface
        is curved: of the plane that touches it); weight (texels, pairs) float64, whose sum at a texel is 1.

    Raises:
        InputError: when the environment cannot be read, or no light reaches what the cameras see.
    """
    random, sources = np.random.default_rng(seed), _Sources(scene, luminance)
    wanted, rounds = texels * pairs if highlights is None else _POOL, 0
    found: list[NDArray] = []
    while sum(map(len, found)) < wanted:
        if rounds >= _ROUNDS and not any(map(len, found)):
            raise InputError(
                f"No light of the scene reaches '{surface.name or surface.set}' where the cameras see it: expected one "
                "above its horizon (the third number of `direction` above 0), or an environment that is not black."
            )
        found.append(_draw(scene, surface, sources, max(wanted, _DRAWS), random))
        rounds += 1
    both = np.concatenate(found)[:wanted]
    if highlights is None:
        both, weight = both.reshape(texels, pairs, 2, 3), np.full((texels, pairs), 1.0 / pairs)
    else:
        chosen, weight = _choose(both, pairs, *highlights, random)
        both = both[chosen]
    return both[:, :, 0].copy(), both[:, :, 1].copy(), weight


def _choose(
    pool: NDArray, pairs: int, normal: NDArray, width: NDArray, random: np.random.Generator
) -> tuple[NDArray, NDArray]:
    """Which pairs of a pool (N, 2, 3) n texels take, and their weights: both (n, pairs).

    A pair's chance is half uniform and half in proportion to GGX lobes at its half vector; its weight is the inverse.
    """
    half = pool.sum(axis=1)
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    square = np.square(np.maximum(width, _LEAST_WIDTH, dtype=np.float64))
    first = random.integers(len(pool) - _WINDOW + 1, size=len(normal))
    start = random.random(len(normal))
    chosen, weight = np.empty((len(normal), pairs), np.int64), np.empty((len(normal), pairs))
    for i, lobes in enumerate(normal.astype(np.float64)):
        cosine = np.maximum(lobes @ half[first[i] : first[i] + _WINDOW].T, 0.0)
        lobe = 1.0 / np.square(1.0 - np.square(cosine) * (1.0 - square[i, :, None]))
        chance = (1.0 - _FOLLOW) + _FOLLOW * (lobe / lobe.mean(axis=1, keepdims=True)).mean(axis=0)
        sums = np.cumsum(chance)
        # Systematic sampling, evenly spaced from a random start: each pair as often as its chance says, to within one.
        at = np.searchsorted(sums, (np.arange(pairs) + start[i]) / pairs * sums[-1], side="right")
        at = np.minimum(at, _WINDOW - 1)
        chosen[i], weight[i] = first[i] + at, 1.0 / chance[at]
    return chosen, weight / weight.sum(axis=1, keepdims=True)


@cache
def _surroundings(environment: str) -> tuple[NDArray, float]:
    """Directions (n, 3) drawn from an environment by luminance, and the integral of its luminance."""
    found = read_environment(None if environment == PROCEDURAL else environment)
    return found.samples(_ENVIRONMENT_DIRECTIONS)[0], float(LUMINANCE @ found.total())


def lights_of(scene: SceneFile) -> Lights | None:
    """The lights of a scene for the renderer, with their sizes; None if there are none."""
    if not scene.lights:
        return None
    radius = np.radians([0.5 * each.size for each in scene.lights])
    direction, irradiance = (np.array([getattr(each, name) for each in scene.lights]) for name in ("direction", "rgb"))
    return Lights(direction, irradiance, radius)


def environment_of(scene: SceneFile) -> Environment | None:
    """The environment of a scene; None if it has none.

    Raises:
        InputError: when it cannot be read.
    """
    if scene.environment is None:
        return None
    return read_environment(None if scene.environment == PROCEDURAL else scene.environment)


class _Sources:
    """The sources of light of a scene, with their shares of the luminance."""

    def __init__(self, scene: SceneFile, shining: NDArray | None = None) -> None:
        self.lights: tuple[Light, ...] = scene.lights
        self.around: NDArray | None = None
        luminance = [float(np.dot(LUMINANCE, light.rgb)) for light in scene.lights]
        if scene.environment is not None:
            self.around, total_around = _surroundings(scene.environment)
            luminance.append(total_around)
        luminance = luminance if shining is None else list(shining)
        total = sum(luminance)
        if total <= 0.0:
            raise InputError("The lights of the scene are black: expected an `irradiance` above 0.")
        self.share = np.array(luminance) / total

    def draw(self, count: int, random: np.random.Generator) -> NDArray:
        """(count, 3) directions."""
        which = random.choice(len(self.share), count, p=self.share)
        u = random.random((2, count))
        out = np.empty((count, 3))
        for i, light in enumerate(self.lights):
            mine = which == i
            axis = np.array(light.direction) / np.linalg.norm(light.direction)
            # Uniform over the solid angle of a cap: its height is uniform.
            height = 1.0 - (1.0 - math.cos(math.radians(0.5 * light.size))) * u[0, mine]
            out[mine] = _about(axis, height, 2.0 * math.pi * u[1, mine]) if light.size else axis
        if self.around is not None:
            mine = which == len(self.lights)
            out[mine] = self.around[random.integers(len(self.around), size=int(mine.sum()))]
        return out


def _draw(scene: SceneFile, surface: Surface, sources: _Sources, count: int, random: np.random.Generator) -> NDArray:
    """At most ``count`` pairs (m, 2, 3), view and light: those above the horizon."""
    which = random.integers(len(scene.cameras), size=count)
    u = random.random((5, count))
    tilts = np.array([camera.tilts for camera in scene.cameras])
    low, high = np.square(np.sin(np.radians(tilts[which]))).T
    view = _polar(np.sqrt(1.0 - (low + (high - low) * u[0])), 2.0 * math.pi * u[1])
    light = sources.draw(count, random)
    least = 0.0
    if surface.radius is not None:
        turn = np.empty(count)
        for i, camera in enumerate(scene.cameras):
            mine = which == i
            near, far = camera.distances
            turn[mine] = shown_turn(camera, near * (far / near) ** u[2, mine], surface.radius)
        normal = _polar(np.sqrt(1.0 - np.square(np.sin(np.radians(turn))) * u[3]), 2.0 * math.pi * u[4])
        view, light = into_frame(view, normal), into_frame(light, normal)
        least = math.cos(math.radians(max(GRAZING, float(tilts.max()))))
    seen = (view[:, 2] > least) & (light[:, 2] > 0.0)
    return np.stack([view[seen], light[seen]], axis=1)


def _polar(height: NDArray, azimuth: NDArray) -> NDArray:
    """(n, 3) unit vectors of this z."""
    across = np.sqrt(np.maximum(1.0 - height * height, 0.0))
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), height], axis=-1)


def _about(axis: NDArray, height: NDArray, azimuth: NDArray) -> NDArray:
    """(n, 3) unit vectors whose component along a unit ``axis`` is ``height``."""
    side = np.cross(axis, (1.0, 0.0, 0.0) if abs(axis[0]) < 0.6 else (0.0, 1.0, 0.0))
    side /= np.linalg.norm(side)
    frame = np.stack([side, np.cross(axis, side), axis])
    return _polar(height, azimuth) @ frame
