"""Any truth, evaluated point by point: for the reference and the pairs of directions where there is no SVBRDF.

Points lie in strata of a pixel's footprint, one in each, as in the compiled loops; a truth says what each reflects. A
light that has a size is sampled by multiple importance (Veach and Guibas 1995, balance heuristic): one direction of the
light and one of a broad lobe about the mirror direction of the plane, since a truth does not tell its own lobes.
Directional lights and directions of an environment below the plane light nothing, as everywhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import Truth
from brdffit.footprint import PixelFilter
from brdffit.models.microfacet import draw, drawn_density
from brdffit.render._environment_kernels import LIGHT_X, LIGHT_Z
from brdffit.render._footprints import (
    Budget,
    Progress,
    Rule,
    equal_samples,
    group_footprints,
    run_in_threads,
    strata_rule,
)
from brdffit.render.environment import Environment
from brdffit.render.lighting import Lit, Pixels
from brdffit.render.lights import Lights
from brdffit.render.scenes import Scene

#: Points that a truth evaluates at a time.
_POINTS = 1 << 16
#: The broad lobe: alpha of a GGX lobe about the plane's normal, and its share of the directions; the rest are
#: cosine-distributed.
_BROAD, _SHARE = 0.4, 0.6


class Points(NamedTuple):
    """Points of a truth, each seen from one direction.

    Attributes:
        truth: what is asked.
        position: (n, 2) float64, (column, row) in texels.
        view: (n, 3) float64 unit vectors in tangent space.
        uniform: (n, 5) float64 in [0, 1), random numbers for directions of light.
        seeds: gives each question a seed of its own.
    """

    truth: Truth
    position: NDArray
    view: NDArray
    uniform: NDArray
    seeds: np.random.Generator

    def reflected(self, light: NDArray, weight: NDArray) -> NDArray:
        """``weight`` (n, 3) times the BRDF times the cosine (n, 3) float64 under directions (n, 3).

        The truth is not asked where the light is below the plane or its weight is 0.
        """
        found = np.zeros((len(light), 3))
        rows = np.flatnonzero((light[:, 2] > 0.0) & weight.any(axis=1))
        if len(rows):
            seed = int(self.seeds.integers(1 << 31))
            answer = self.truth.reflect(self.position[rows], self.view[rows], light[rows], seed)
            found[rows] = weight[rows] * np.asarray(answer, np.float64)
        return found


def picture_of_points(
    truth: Truth,
    scene: Scene,
    lit: Lit,
    pixel_filter: PixelFilter,
    budget: Budget,
    threads: int | None,
    progress: Progress | None,
) -> NDArray:
    """Both halves (2, h, w, 3) float32 of the reference picture of a truth; independent, the same for any threads."""
    pixels = Pixels(scene)
    footprints = group_footprints(pixels.centre, pixels.axes, scene.base_size, tile=False)
    of = footprints.order
    pixels_of = np.diff(footprints.starts)
    place, key = np.repeat(footprints.place, pixels_of, axis=0), np.repeat(footprints.key, pixels_of)
    view, frame = pixels.view[of], pixels.frame[of]
    found = np.zeros((2, len(of), 3))

    def work(rule: Rule, part: slice) -> int:
        weight = np.outer(rule.weight_y, rule.weight_x).ravel()
        count = part.stop - part.start
        for half in (0, 1):
            # Seeded by what it draws, so that threads do not matter.
            seeds = np.random.default_rng([part.start, half])
            for first in range(0, len(weight), _POINTS):
                strata = np.arange(first, min(first + _POINTS, len(weight)))
                points = points_in_strata(truth, place[part], key[part], view[part], rule, strata, half, seeds)
                radiance = _radiance(points, np.repeat(frame[part], len(strata), axis=0), lit)
                found[half, part] += np.einsum("s,psc->pc", weight[strata], radiance.reshape(count, -1, 3))
        return count

    jobs = []
    for part, count in equal_samples(place, budget):
        rule = strata_rule(pixel_filter, *count)
        step = max(1, _POINTS // (len(rule.weight_x) * len(rule.weight_y)))
        jobs += [(rule, slice(i, min(i + step, part.stop))) for i in range(part.start, part.stop, step)]
    run_in_threads(work, jobs, threads, progress, len(of))
    halves = np.zeros((2, *scene.pixels, 3), np.float32)
    halves[:, pixels.rows[of], pixels.columns[of]] = found
    return halves


def directions_per_point(lit: Lit) -> int:
    """Most evaluations of a truth at each point."""
    points = 0 if lit.lights is None else int((lit.lights.radius == 0.0).sum())
    return points + (1 if lit.discs is not None else 0) + (2 if lit.environment is not None else 0)


def points_in_strata(
    truth: Truth, place: NDArray, key: NDArray, view: NDArray, rule: Rule, strata: NDArray, half: int,
    seeds: np.random.Generator,
) -> Points:  # fmt: skip
    """A point in each stratum of each of p footprints, one footprint's after another's."""
    row, column = np.divmod(strata, len(rule.weight_x))
    uniform = _hashed(np.repeat(key, len(strata)), np.tile(strata, len(key)), half, 7)
    jitter = uniform[:, :2].reshape(len(key), len(strata), 2)
    x = rule.x[column] + (rule.x[column + 1] - rule.x[column]) * jitter[..., 0]
    y = rule.y[row] + (rule.y[row + 1] - rule.y[row]) * jitter[..., 1]
    axes = place[:, None, 2:]
    position = place[:, None, :2] + axes[..., 0::2] * x[..., None] + axes[..., 1::2] * y[..., None]
    return Points(truth, position.reshape(-1, 2), np.repeat(view, len(strata), axis=0), uniform[:, 2:], seeds)


def _radiance(points: Points, frame: NDArray, lit: Lit) -> NDArray:
    """(n, 3) that each point sends to its viewer; ``frame`` (n, 3, 3) of the surface in the world."""
    found = np.zeros((len(frame), 3))
    for radius, lights in () if lit.lights is None else lit.lights.by_radius():
        if radius == 0.0:
            for direction, irradiance in zip(lights.direction, lights.irradiance, strict=True):
                found += points.reflected(
                    frame @ direction.astype(np.float64), np.broadcast_to(irradiance, (len(frame), 3))
                )
    if lit.discs is not None:
        found += _under_sized(points, frame, lit.discs)
    if lit.environment is not None:
        found += _under_sized(points, lit.environment.turned(frame), lit.environment)
    return found


def _under_sized(points: Points, frame: NDArray, light: Environment | Lights) -> NDArray:
    """(n, 3) radiance under light that has a size: f L / (p_l + p_b) for a direction of the light and a broad one."""
    count, u = len(frame), points.uniform
    table = light.table[LIGHT_X : LIGHT_Z + 1].T.astype(np.float64)
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0], np.float32), (count, 3))
    tensor = np.broadcast_to(np.array([_BROAD**2, _BROAD**2, 0.0], np.float32), (count, 3))
    share = np.full(count, _SHARE)
    of_light = np.einsum("nij,nj->ni", frame, table[(u[:, 0] * len(table)).astype(np.int64)])
    broad = draw(up, tensor, share, points.view, u[:, 1:3])
    found = np.zeros((count, 3))
    for direction in (of_light, broad):
        radiance, density = light.look_up(np.einsum("nji,nj->ni", frame, direction))
        density = density + drawn_density(up, tensor, share, points.view, direction)
        found += points.reflected(direction, radiance / np.maximum(density, 1e-20)[:, None])
    return found


def _hashed(key: NDArray, stratum: NDArray, half: int, count: int) -> NDArray:
    """(n, count) float64 in [0, 1): a hash of ``key`` (n,), ``stratum`` (n,) and ``half`` (splitmix64's finaliser).

    A pixel draws the same numbers wherever its footprint is the same, so that frames of a movement differ by what
    moves.
    """
    state = key.astype(np.uint64) * np.uint64(0xD1342543DE82EF95)
    state += stratum.astype(np.uint64) * np.uint64(0xAF251AF3B0F025B5)
    step = np.uint64(0x9E3779B97F4A7C15) * (np.arange(count, dtype=np.uint64) + np.uint64(1 + half * count))
    bits = state[:, None] + step
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    bits ^= bits >> np.uint64(31)
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53
