"""Refinement of whole levels for the lobes that a renderer interpolates between texels and between levels.

A texel is fitted at its own centre, but a renderer interpolates (Baker asks for levels that are optimal under bilinear
reconstruction, Kemppinen et al. 2023 for a trilinear loss). Refinement starts from the fitted texels and moves them
together so that the mean error of the *interpolated* lobe falls: at texel centres, between two texels, between four,
and, where a coarser level follows, at the same points halfway to that level (there F is the lobe of the mean of both
levels' values, and T belongs to the footprint of intermediate size). Centres count as much as other points: without
them a level is sharpened until the points between are right, and every pixel that meets a texel centre is wrong.

The error of a point is relative to its own <T,T>, as in a level's SNR, so that dark or rough parts of a texture count
as much as bright and sharp ones.

Levels are refined from the coarsest to the finest, each against the coarser level as refined before. A level is cut
into tiles. Each tile is searched by L-BFGS-B (Byrd et al. 1995) over all points that its texels touch, with everything
outside held, and keeps the result only if the error of those points falls; so a level's error never rises. Tiles of one
colour share no points and are searched in parallel; colours follow each other, so the result does not depend on the
threads.
"""

from __future__ import annotations

import math
import os
import time
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from brdffit.fitting.batch import LevelRules, ModelKernels
from brdffit.fitting.bfgs import FREE_ANISOTROPY, FREE_NORMAL
from brdffit.fitting.interpolation import PARAMETERS, chain, channels_of, eigen, interpolation_kernel
from brdffit.fitting.search import Search
from brdffit.fitting.tiles import (
    Points,
    axis_points,
    bilinear,
    coloured_tiles,
    parameters_of,
    sample_points,
    tables_kernel,
)
from brdffit.halfangle.apparent_lobe import Base
from brdffit.halfangle.closed_forms import STEEPEST_SLOPE
from brdffit.halfangle.measure import snr
from brdffit.halfangle.objective import HOLDS, WALL
from brdffit.halfangle.quadrature import LOBE_COLUMNS, NODE_ROWS, lattice
from brdffit.methods import Pyramid
from brdffit.svbrdf import Svbrdf

_ITERATIONS, _TOLERANCE = 30, 1e-3
# Mean relative squared error below which a tile is left as it is: 60 dB, near the resolution of float32 sums.
_NEGLIGIBLE = 1e-6


class Refined(NamedTuple):
    """A refined level, and the relative squared errors (n,) at its sample points before and after."""

    svbrdf: Svbrdf
    before: NDArray
    after: NDArray


def refine_pyramid(
    pyramid: Pyramid, base: Base, rules: list[LevelRules], search: Search, kernels: ModelKernels, first: int = 0
) -> None:
    """Refine the levels of a fitted pyramid in place, from the coarsest to ``first``, and add a note of the gain.

    Args:
        rules: sampling of each level, as it was fitted. Others as in ``refine_level``.
    """
    told = []
    for mip_level in reversed(range(first, len(pyramid))):
        level = pyramid[mip_level]
        if max(level.svbrdf.size) == 1:
            continue
        start = time.perf_counter()
        follows = mip_level + 1 < len(pyramid)
        coarser = (rules[mip_level + 1], pyramid[mip_level + 1].svbrdf) if follows else ()
        points = sample_points(rules[mip_level], level.svbrdf.size, *coarser)
        rule = lattice(sum(each.shape[1] for each in rules[mip_level].points[0]))
        refined = refine_level(level.svbrdf, base, points, rule, search, kernels, pyramid.options.threads)
        level.svbrdf = refined.svbrdf
        level.seconds += time.perf_counter() - start
        told.append(f"level {mip_level} from {snr(refined.before):.1f} to {snr(refined.after):.1f} dB")
    if told:
        pyramid.notes.append(f"Refined for what a renderer interpolates: {', '.join(reversed(told))}.")


def refine_level(
    level: Svbrdf, base: Base, points: list[Points], rule: NDArray, search: Search, kernels: ModelKernels,
    threads: int | None = None,
) -> Refined:  # fmt: skip
    """Move the texels of a level so that the error at its sample points falls.

    Args:
        level: the fitted level.
        base: what it was fitted to.
        points: see ``sample_points``.
        rule: point set (3, N) of the half-angle integral at each point, see ``quadrature.lattice``.
        search: free parameters, bounds of the roughness and density of half vectors, as in the fit. Shapes are held.
        kernels: of the pair of models.
        threads: None takes all cores. The result does not depend on it.
    """
    texels = _Texels(level, base, points, rule, search, kernels)
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        for tiles in coloured_tiles(level.size, level.wrap == "tile"):
            waiting = [pool.submit(texels.refine, tile) for tile in tiles]
            try:
                for each in waiting:
                    each.result()
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
    before, after = texels.before.ravel(), texels.after.ravel()
    if np.array_equal(texels.theta, texels.start):
        return Refined(level, before, after)
    theta = texels.theta.reshape(*level.size, PARAMETERS)
    slopes = np.concatenate([-theta[..., 0:2], np.ones((*level.size, 1))], axis=2)
    refined = level.replace(
        normal=(slopes / np.linalg.norm(slopes, axis=2, keepdims=True)).astype(np.float32),
        log_roughness=theta[..., 2:5].astype(np.float32),
        specular=theta[..., 5:8].astype(np.float32),
    )
    # Texels that did not move keep their exact values.
    still = np.all(texels.theta == texels.start, axis=1).reshape(level.size)
    for new, old in ((refined.normal, level.normal), (refined.specular, level.specular)):
        new[still] = old[still]
    return Refined(refined, before, after)


class _Texels:
    """All texels of a level while tiles of them are searched."""

    def __init__(
        self, level: Svbrdf, base: Base, points: list[Points], rule: NDArray, search: Search, kernels: ModelKernels
    ) -> None:
        self.size, self.wraps = level.size, level.wrap == "tile"
        self.base, self.points, self.rule, self.search, self.kernels = base, points, rule, search, kernels
        self.theta, self.shape = parameters_of(level)
        self.start = self.theta.copy()
        self.tabulate, self.errors = tables_kernel(), interpolation_kernel(level.model)
        # Every tile that touches a point records its error: the first one "before", the last one "after".
        grid = [2 * length if self.wraps else 2 * length - 1 for length in self.size]
        self.before = np.full((len(points), *grid), np.nan)
        self.after = self.before.copy()

    def refine(self, tile: tuple[range, range]) -> None:
        """Search one tile; only its own texels are written, and only if the error falls."""
        block = self.block(tile)
        theta = self.theta[block.texels]
        start = block.total(theta)
        fresh = np.isnan(self.before[block.places])
        self.before[block.places] = np.where(fresh, block.errors, self.before[block.places])
        self.after[block.places] = block.errors
        if not (math.isfinite(start) and start > _NEGLIGIBLE * len(block.errors)):
            return
        # Judge the rounded values, for these are stored.
        theta[block.core] = block.search(theta[block.core], start).astype(np.float32)
        if block.total(theta) < start:
            self.theta[block.texels[block.core]] = theta[block.core]
            self.after[block.places] = block.errors

    def block(self, tile: tuple[range, range]) -> Block:
        """The points that a tile's texels touch, with their tables."""
        (rows, row_corners, row_parts), (columns, column_corners, column_parts) = (
            axis_points(part, length, self.wraps) for part, length in zip(tile, self.size, strict=True)
        )
        width = self.size[1]
        grid = np.meshgrid(np.arange(len(rows)), np.arange(len(columns)), indexing="ij")
        y, x = grid[0].ravel(), grid[1].ravel()
        corners = np.stack([row_corners[y, k // 2] * width + column_corners[x, k % 2] for k in range(4)], axis=1)
        weights = np.stack([row_parts[y, k // 2] * column_parts[x, k % 2] for k in range(4)], axis=1)
        own = (np.array(tile[0])[:, None] * width + np.array(tile[1])).ravel()
        texels = np.unique(np.concatenate([own, corners.ravel()]))
        parts, places = [], []
        for index, kind in enumerate(self.points):
            nodes = np.zeros((len(y), NODE_ROWS, self.rule.shape[1]), np.float32)
            norm = np.zeros(len(y))
            lobes = np.zeros((max(kind.room, 2 * kind.strata.samples) + 1, LOBE_COLUMNS))
            self.tabulate(
                self.base, kind.strata, self.rule, columns[x], rows[y], self.search.exponent, lobes, nodes, norm,
                self.kernels.tabulate, self.kernels.source_log_normalisation,
            )  # fmt: skip
            share = 1.0 if kind.coarser is None else 0.5
            fixed = np.zeros((len(y), 10))
            if kind.coarser is not None:
                fixed = 0.5 * bilinear(kind.coarser, rows[y], columns[x], self.size, self.wraps)
            parts.append((nodes, norm, np.searchsorted(texels, corners), share * weights, fixed))
            places.append(np.stack([np.full_like(y, index), rows[y], columns[x]]))
        joined = [np.concatenate(each) for each in zip(*parts, strict=True)]
        return Block(self, texels, np.searchsorted(texels, own), tuple(np.concatenate(places, axis=1)), *joined)


class Block:
    """The error of a tile's points as a function of its texels (``core``); the texels around them are held."""

    def __init__(
        self, level: _Texels, texels: NDArray, core: NDArray, places: tuple[NDArray, ...], nodes: NDArray,
        norm: NDArray, corners: NDArray, weights: NDArray, fixed: NDArray,
    ) -> None:  # fmt: skip
        self.texels, self.core, self.places = texels, core, places
        self.errors, self._gradient = np.zeros(len(norm)), np.zeros((len(texels), 9))
        self._tables = nodes, norm, corners, weights, fixed
        self._kernel, self._log_normalisation, self._search = (
            level.errors, level.kernels.log_normalisation, level.search
        )  # fmt: skip
        self.held, self._shape = level.theta[texels], level.shape[texels]

    def total(self, theta: NDArray) -> float:
        """Sum of the points' relative squared errors for all texels (n, 8); infinite where it is not finite."""
        self._kernel(
            *self._tables, channels_of(theta, self._shape), self._log_normalisation, self.errors, self._gradient
        )
        value = float(self.errors.sum())
        return value if math.isfinite(value) else math.inf

    def value(self, core: NDArray) -> tuple[float, NDArray]:
        """Error, with walls at the bounds of the roughness, and its gradient by the tile's own texels (n, 8)."""
        theta = self.held.copy()
        theta[self.core] = core
        value = self.total(theta)
        gradient = chain(core, self._gradient[self.core])
        logs, _, _, (cos, sin) = eigen(core)
        low, high = self._search.log_low, self._search.log_high
        outside = np.maximum(logs - high, 0.0) - np.maximum(low - logs, 0.0)
        first, second = 2.0 * WALL * outside.T
        gradient[:, 2] += first * cos * cos + second * sin * sin
        gradient[:, 3] += first * sin * sin + second * cos * cos
        gradient[:, 4] += 2.0 * cos * sin * (first - second)
        return value + WALL * float(np.square(outside).sum()), gradient

    def search(self, start: NDArray, scale: float) -> NDArray:
        """Parameters (n, 8) of the tile's own texels where L-BFGS-B ends, inside their bounds."""
        columns = _columns(self._search)
        unit = np.ones_like(start)
        # Changes of about the same effect: the normal by a lobe's width, alpha^2 by a factor e, the colour by itself.
        unit[:, 0:2] = np.exp(0.25 * (start[:, 2:3] + start[:, 3:4])) * (1.0 + np.square(start[:, 0:2]).sum(1))[:, None]
        unit[:, 5:8] = np.maximum(start[:, 5:8].max(axis=1, keepdims=True), 1e-4)

        def at(z: NDArray) -> NDArray:
            return start + unit * (z.reshape(len(start), -1) @ columns)

        def objective(z: NDArray) -> tuple[float, NDArray]:
            value, gradient = self.value(at(z))
            if not math.isfinite(value):
                return 1e6, np.zeros_like(z)
            return value / scale, ((gradient * unit) @ columns.T).ravel() / scale

        low, high = np.full(start.shape, -np.inf), np.full(start.shape, np.inf)
        high[:, 0:2] = np.maximum(STEEPEST_SLOPE - np.abs(start[:, 0:2]), 0.0) / unit[:, 0:2]
        low[:, 0:2], low[:, 5:8] = -high[:, 0:2], -start[:, 5:8] / unit[:, 5:8]
        moved = columns.argmax(axis=1)
        bounds = optimize.Bounds(low[:, moved].ravel(), high[:, moved].ravel())
        end = optimize.minimize(
            objective, np.zeros(len(start) * len(columns)), jac=True, method="L-BFGS-B", bounds=bounds,
            options={"ftol": _TOLERANCE, "gtol": 0.0, "maxiter": _ITERATIONS, "maxcor": 8},
        )  # fmt: skip
        return _clamped(at(end.x), self._search)


def _columns(search: Search) -> NDArray:
    """Directions (k, 8) in which the parameters of a texel may move."""
    identity = np.eye(PARAMETERS)
    free = [identity[0:2]] if search.free & FREE_NORMAL else []
    free.append(identity[2:5] if search.free & FREE_ANISOTROPY else identity[2:3] + identity[3:4])
    return np.concatenate(free if search.scale == HOLDS else [*free, identity[5:8]])


def _clamped(theta: NDArray, search: Search) -> NDArray:
    """A copy of (n, 8) with log eigenvalues within their bounds; texels inside the bounds keep their exact values."""
    logs, _, _, (cos, sin) = eigen(theta)
    inside = np.clip(logs, search.log_low, search.log_high)
    out = theta.copy()
    outside = np.any(inside != logs, axis=1)
    (l1, l2), cos, sin = inside[outside].T, cos[outside], sin[outside]
    out[outside, 2] = cos * cos * l1 + sin * sin * l2
    out[outside, 3] = sin * sin * l1 + cos * cos * l2
    out[outside, 4] = cos * sin * (l1 - l2)
    return out
