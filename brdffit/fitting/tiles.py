"""Sample points of a level, between its texels and halfway to the next level, with their tables; tiles of texels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import kernel, numba_type, types
from brdffit.fitting.batch import LevelRules
from brdffit.fitting.interpolation import CHANNELS, PARAMETERS, channels_of
from brdffit.halfangle.apparent_lobe import Strata, example_base, example_strata
from brdffit.halfangle.closed_forms import STEEPEST_SLOPE
from brdffit.halfangle.measure import target_table
from brdffit.halfangle.objective import log_normalisation_type
from brdffit.halfangle.quadrature import lattice, tabulate_type
from brdffit.models import get_model
from brdffit.svbrdf import Svbrdf

#: Approximate side of a tile in texels.
TILE = 16


class Points(NamedTuple):
    """One kind of sample points of a level.

    ``strata`` of their footprints, on a grid of half texels whose even points are texel centres; ``room`` for lobes;
    ``coarser``: channels (h, w, 10) of the coarser level that a renderer mixes in by half there, or None.
    """

    strata: Strata
    room: int
    coarser: NDArray | None


def sample_points(
    rules: LevelRules, size: tuple[int, int], coarser_rules: LevelRules | None = None, coarser: Svbrdf | None = None
) -> list[Points]:
    """Sample points of a level of ``size``: on the level and, if the next coarser one is given, halfway to it."""
    # Refinement compares lobes under point lights, which show the noise of scattered samples.
    here = rules.strata._replace(scatter=False)
    # Point 2 k of the halved grid is the centre of texel k: (2 k + 1/2) scale / 2 + scale / 4.
    halved = here._replace(
        x=here.x + 0.25 * here.scale_x, y=here.y + 0.25 * here.scale_y, scale_x=0.5 * here.scale_x,
        scale_y=0.5 * here.scale_y,
    )  # fmt: skip
    points = [Points(halved, rules.room, None)]
    if coarser is not None and coarser_rules is not None:
        there = coarser_rules.strata
        # A footprint halfway has the geometric mean of both scales.
        y, x = math.sqrt(here.scale_y / there.scale_y), math.sqrt(here.scale_x / there.scale_x)
        between = halved._replace(
            x=x * there.x + 0.25 * here.scale_x, y=y * there.y + 0.25 * here.scale_y, weight_x=there.weight_x,
            weight_y=there.weight_y, jitter_x=x * there.jitter_x, jitter_y=y * there.jitter_y, seed=there.seed,
        )  # fmt: skip
        channels = channels_of(*parameters_of(coarser)).reshape(*coarser.size, -1)
        points.append(Points(between, coarser_rules.room, channels))
    return points


def parameters_of(level: Svbrdf) -> tuple[NDArray, NDArray]:
    """theta (H W, 8) float64 and shape (H W,) of a level's texels, row by row."""
    normal = level.normal.reshape(-1, 3).astype(np.float64)
    theta = np.empty((len(normal), PARAMETERS))
    theta[:, 0:2] = -normal[:, 0:2] / np.maximum(normal[:, 2:3], 1.0 / (2.0 * STEEPEST_SLOPE))
    theta[:, 2:5] = level.log_roughness.reshape(-1, 3)
    theta[:, 5:8] = level.specular.reshape(-1, 3)
    shape = get_model(level.model).default_shape
    return theta, np.full(len(theta), shape) if level.shape is None else level.shape.reshape(-1).astype(np.float64)


def coloured_tiles(size: tuple[int, int], wraps: bool) -> Iterator[list[tuple[range, range]]]:
    """Yield lists of tiles (rows, columns); those of a list share no sample points, all lists cover the level once."""
    axes = []
    for length in size:
        count = max(1, round(length / TILE))
        edges = [length * i // count for i in range(count + 1)]
        colours: list[list[range]] = [[], [], []]
        for i in range(count):
            # Around a ring of an odd number of tiles the last one needs a third colour.
            last_of_ring = wraps and i == count - 1 and count % 2 == 1 and count > 1
            colours[2 if last_of_ring else i % 2].append(range(edges[i], edges[i + 1]))
        axes.append([colour for colour in colours if colour])
    for rows in axes[0]:
        for columns in axes[1]:
            yield [(y, x) for y in rows for x in columns]


def axis_points(part: range, length: int, wraps: bool) -> tuple[NDArray, NDArray, NDArray]:
    """Points (n,) of an axis that the texels of ``part`` touch, in half texels from the centre of the first texel; the
    texels (n, 2) between which each point lies, and their weights (n, 2)."""
    points = np.arange(2 * part.start - 1, 2 * part.stop)
    points = np.unique(points % (2 * length)) if wraps else points[(points >= 0) & (points < 2 * length - 1)]
    return points, *_between(0.5 * points, length, wraps)


def _between(position: NDArray, length: int, wraps: bool) -> tuple[NDArray, NDArray]:
    """Texels (n, 2) that positions (texel k at k) lie between, and their weights (n, 2)."""
    first = np.floor(position)
    part = position - first
    texels = np.stack([first, first + 1], axis=1).astype(np.int64)
    texels = texels % length if wraps else np.clip(texels, 0, length - 1)
    return texels, np.stack([1.0 - part, part], axis=1)


def bilinear(channels: NDArray, rows: NDArray, columns: NDArray, size: tuple[int, int], wraps: bool) -> NDArray:
    """Values (n, 10) of a coarser level's channels at points given in half texels of the level of ``size``."""
    height, width = channels.shape[:2]
    j, down = _between((0.5 * rows + 0.5) * height / size[0] - 0.5, height, wraps)
    i, across = _between((0.5 * columns + 0.5) * width / size[1] - 0.5, width, wraps)
    value = np.zeros((len(rows), CHANNELS))
    for a, b in ((0, 0), (0, 1), (1, 0), (1, 1)):
        value += (down[:, a] * across[:, b])[:, None] * channels[j[:, a], i[:, b]]
    return value


@kernel
def _tables(base, strata, points, columns, rows, exponent, lobes, nodes, norm, tabulate_kernel,
            source_log_normalisation):  # fmt: skip
    """Tables of the footprints (columns[i], rows[i]) into ``nodes`` (n, NODE_ROWS, N), and their <T,T>."""
    work = np.zeros(64)
    for i in range(columns.size):
        _, _, _, norm[i] = target_table(
            base, strata, points, columns[i], rows[i], exponent, 0.0, lobes, nodes[i], work, tabulate_kernel,
            source_log_normalisation,
        )  # fmt: skip


@cache
def tables_kernel() -> Any:
    """``_tables``, compiled once for all models: their kernels are arguments of function type."""
    index, line = np.zeros(1, np.int64), np.zeros(1)
    nodes = np.zeros((1, 1, 1), np.float32)
    data = (example_base(), example_strata(), lattice(1), index, index, 3, np.zeros((1, 1)), nodes, line)
    _tables.compile((*map(numba_type, data), tabulate_type(types.float32), log_normalisation_type))
    _tables.disable_compile()
    return _tables
