"""Training queries of a neural material (position, level, light and view), and their targets.

A target is pi times the radiance under a light that gives a surface facing it an irradiance of 1. A white diffuse
surface that faces the light then has the value 1, and targets stay bounded at grazing light. The paper learns M, the
radiance for an irradiance of 1 on the plane; it is larger by one over the light's cosine.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from brdffit.microgeometry.queries import QuerySource
from brdffit.neural.kernels.dense import ROWS
from brdffit.neural.kernels.material import QUERY

#: Radius of the disc of projected directions that are learned: up to 78.5 degrees from the normal.
RADIUS = 0.98
#: Standard deviation of the filter at level 0, in texels of level 0; it doubles with each level.
SIGMA = 0.5
#: Share of queries whose light is near the mirror direction of the view, and its standard deviation on the disc.
_MIRRORED, _NEAR = 0.3, 0.15
#: Finer levels hold more texels and get more queries: level = last * u^this, u uniform.
_TOWARDS_FINE = 1.5
#: Queries of a batch for each texel of level 0, along an axis.
_ACROSS = 2


def batch_of(size: tuple[int, int], rng: np.random.Generator) -> NDArray:
    """One batch of queries (n, QUERY) float32, four or more for each texel of level 0, in the order of rows.

    Positions are jittered within a grid of n cells: stratification lowers the noise of the gradient, and queries that
    follow each other read neighbouring memory.
    """
    rows, columns = (max(_ACROSS * length, math.isqrt(ROWS)) for length in size)
    row, column = np.divmod(np.arange(rows * columns), columns)
    queries = random_queries(rows * columns, size, rng)
    queries[:, 0] = (column + rng.random(len(column))) * (size[1] / columns)
    queries[:, 1] = (row + rng.random(len(row))) * (size[0] / rows)
    return queries


def random_queries(count: int, size: tuple[int, int], rng: np.random.Generator, level: float | None = None) -> NDArray:
    """``count`` random queries (count, QUERY) float32 on a tile of ``size`` texels, of one level or of all."""
    queries = np.zeros((count, QUERY), np.float32)
    queries[:, :2] = rng.random((count, 2)) * size[::-1]
    last = max(size).bit_length() - 1
    queries[:, 2] = last * rng.random(count) ** _TOWARDS_FINE if level is None else level
    view = on_disc(rng.random((count, 2)))
    light = on_disc(rng.random((count, 2)))
    near = rng.random(count) < _MIRRORED
    light[near] = within_disc(-view[near] + _NEAR * rng.standard_normal((int(near.sum()), 2)))
    queries[:, 3:5], queries[:, 5:7] = light, view
    return queries


def on_disc(u: NDArray) -> NDArray:
    """Points (n, 2) evenly on the disc of ``RADIUS``, from (n, 2) numbers in [0, 1)."""
    radius, angle = RADIUS * np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def within_disc(points: NDArray) -> NDArray:
    """Points (n, 2), of which those outside the disc of ``RADIUS`` are moved to its edge."""
    length = np.linalg.norm(points, axis=1, keepdims=True)
    return points * np.minimum(1.0, RADIUS / np.maximum(length, 1e-9))


def directions(queries: NDArray) -> tuple[NDArray, NDArray]:
    """Unit vectors (n, 3) float64 to light and viewer, of queries (n, QUERY)."""
    found = []
    for first in (3, 5):
        xy = queries[:, first : first + 2].astype(np.float64)
        found.append(np.concatenate([xy, np.sqrt(1.0 - np.square(xy).sum(axis=1, keepdims=True))], axis=1))
    return found[0], found[1]


class Answers:
    """A query source, with queries in texels of the neural material.

    Args:
        source: answers queries of a tile of any size.
        size: (height, width) of level 0 of the neural material, which covers the same tile.
        on_plane: answer with pi M, as in the paper, instead of pi M times the light's cosine.
    """

    def __init__(self, source: QuerySource, size: tuple[int, int], on_plane: bool = False) -> None:
        self.source, self.on_plane = source, on_plane
        #: Texels of the source for one of the neural material, (across, down).
        self.scale = np.array(source.size[::-1], float) / np.array(size[::-1], float)

    def to(self, queries: NDArray, seed: int, samples: int = 1) -> NDArray:
        """(n, 3) float32 answers to queries (n, QUERY): means of ``samples`` estimates."""
        light, view = directions(queries)
        position = queries[:, :2].astype(np.float64) * self.scale
        sigma = SIGMA * np.exp2(queries[:, 2].astype(np.float64)) * math.sqrt(self.scale.prod())
        total = np.zeros((len(queries), 3), np.float32)
        for k in range(samples):
            total += self.source.query(position, sigma, light, view, seed + k)
        factor = math.pi / samples * (1.0 if self.on_plane else light[:, 2:])
        return np.ascontiguousarray(total * factor, np.float32)

    def twice(self, queries: NDArray, seed: int, samples: int) -> NDArray:
        """(2, n, 3) float32: two independent means, each of half of ``samples`` estimates."""
        half = max(samples // 2, 1)
        return np.stack([self.to(queries, seed, half), self.to(queries, seed + half, half)])


def error_of(found: NDArray, truths: NDArray) -> tuple[float, float]:
    """(mean squared error, mean square of the truth), both unbiased by the noise of the truth.

    With two independent estimates t_1 and t_2 of the truth t, E[(f - t_1)(f - t_2)] = (f - t)^2 and E[t_1 t_2] = t^2.
    An error below its own standard error is returned as that standard error, since so few samples cannot resolve it.

    Args:
        found: (n, 3) values to measure.
        truths: (2, n, 3), from ``Answers.twice``.
    """
    errors = ((found - truths[0]) * (found - truths[1])).astype(np.float64)
    return max(float(errors.mean()), float(errors.std()) / math.sqrt(errors.size)), float(
        np.mean(truths[0] * truths[1], dtype=np.float64)
    )
