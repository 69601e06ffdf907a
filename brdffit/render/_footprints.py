"""Footprints of pixels on the base: which pixels share one, how it is cut into strata, and threads for the work."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.footprint import PixelFilter
from brdffit.machine import core_count

#: progress(done, total) in pixels.
Progress = Callable[[int, int], None]


class Budget(NamedTuple):
    """Samples of a footprint: the least, those for each base texel of its area, and the most."""

    least: float
    per_texel: float
    most: float

    def times(self, factor: float, floor: int) -> Budget:
        """All three times ``factor``; the least and the most are not below ``floor``."""
        least, per_texel, most = self.least * factor, self.per_texel * factor, self.most * factor
        return Budget(max(least, floor), per_texel, max(most, floor))

    @classmethod
    def of(cls, samples: int) -> Budget:
        """The same number for every footprint."""
        return cls(samples, 0.0, samples)


# A piece of work takes a fraction of a second, so that the bar moves and an interrupt is heard.
_LEAST_PIECES = 64
PIXELS_PER_PIECE = 4096


class Footprints(NamedTuple):
    """Distinct footprints (G, 6): centre and axes; pixels in their order, and where each one's begin; jitter keys."""

    place: NDArray
    order: NDArray
    starts: NDArray
    key: NDArray


def group_footprints(centre: NDArray, axes: NDArray, base_size: tuple[int, int], tile: bool) -> Footprints:
    """Group pixels by footprint; where the texture repeats, footprints a period apart are one."""
    if tile:
        centre = centre % np.array(base_size[::-1], np.float64)
    place = np.concatenate([centre, axes.reshape(-1, 4)], axis=1)
    # Large footprints first, equal ones together. Positions that differ by rounding alone count as equal.
    rounded = np.round(place * 4096.0).astype(np.int64)
    area = np.round(_area(rounded))
    order = np.lexsort((*rounded.T[:2], *rounded.T[2:], -area))
    sorted_ = rounded[order]
    fresh = np.ones(len(order), bool)
    fresh[1:] = (sorted_[1:] != sorted_[:-1]).any(axis=1)
    first = np.flatnonzero(fresh)
    place = place[order][first]
    return Footprints(place, order, np.append(first, len(order)), footprint_keys(place))


def footprint_keys(place: NDArray) -> NDArray:
    """A key (G,) int64 of each footprint (G, 6), from where it lies and how large it is, for the hash of the jitter."""
    rounded = np.round(place * 4096.0).astype(np.int64).astype(np.uint64)
    mixed = (rounded * np.array([1, 65599, 3, 5, 7, 11], np.uint64)).sum(axis=1)
    return ((mixed * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(33)).astype(np.int64)


def _area(place: NDArray) -> NDArray:
    """Areas (G,) of footprints (G, 6)."""
    return np.abs(place[:, 2] * 1.0 * place[:, 5] - place[:, 3] * 1.0 * place[:, 4])


def sample_count(place: NDArray, budget: Budget) -> NDArray:
    """Strata (across, down) (G, 2) of one half of each footprint's samples."""
    wanted = np.clip(_area(place) * budget.per_texel, budget.least, budget.most)
    # Per axis in proportion to the footprint's length, rounded to powers of the square root of 2: few different rules.
    axes = place[:, 2:].reshape(-1, 2, 2)
    length = np.maximum(np.linalg.norm(axes, axis=1), 1e-9)
    ratio = np.clip(np.sqrt(length[:, 0] / length[:, 1]), 1.0 / 16.0, 16.0)
    side = np.sqrt(np.maximum(wanted / 2.0, 1.0))
    exact = np.log2(np.stack([side * ratio, side / ratio], axis=1))
    return np.maximum(np.round(2.0 ** (np.round(exact * 2.0) / 2.0)), 1).astype(np.int64)


def equal_samples(place: NDArray, budget: Budget) -> list[tuple[slice, tuple[int, int]]]:
    """Runs of footprints that take the same number of samples."""
    count = sample_count(place, budget)
    edges = np.flatnonzero((count[1:] != count[:-1]).any(axis=1)) + 1
    bounds = [0, *edges.tolist(), len(place)]
    return [(slice(a, b), (int(count[a, 0]), int(count[a, 1]))) for a, b in zip(bounds[:-1], bounds[1:], strict=True)]


class Rule(NamedTuple):
    """Strata of a pixel: lower ends (n + 1) in pixels from its centre, and weights (n) that sum to 1, of each axis."""

    x: NDArray
    y: NDArray
    weight_x: NDArray
    weight_y: NDArray


def strata_rule(pixel_filter: PixelFilter, across: int, down: int) -> Rule:
    """Strata of equal width; a stratum's weight is the filter's integral over it."""
    nodes, node_weights = np.polynomial.legendre.leggauss(4)
    axes = []
    for count in (across, down):
        # The strata of a filter that is wider than a pixel are as narrow as those of the box.
        count = math.ceil(count * 2.0 * pixel_filter.radius)
        ends = np.linspace(-pixel_filter.radius, pixel_filter.radius, count + 1)
        middle, half = 0.5 * (ends[1:] + ends[:-1]), 0.5 * np.diff(ends)
        weight = (pixel_filter.weight(middle[:, None] + half[:, None] * nodes) * node_weights).sum(axis=1)
        axes.append((ends, weight / weight.sum()))
    (x, weight_x), (y, weight_y) = axes
    return Rule(x, y, weight_x, weight_y)


def pieces(starts: NDArray, part: slice) -> list[slice]:
    """Cut a run of footprints into pieces of about equally many pixels, at most 1 / `_LEAST_PIECES` of them all."""
    step = max(1, min(PIXELS_PER_PIECE, math.ceil(int(starts[-1]) / _LEAST_PIECES)))
    cuts = np.searchsorted(starts, np.arange(starts[part.start], starts[part.stop], step), side="left")
    bounds = np.unique(np.clip(np.append(cuts, part.stop), part.start, part.stop))
    return [slice(int(a), int(b)) for a, b in zip(bounds[:-1], bounds[1:], strict=True)]


def run_in_threads(
    work: Callable[..., int], jobs: Sequence[tuple], threads: int | None, progress: Progress | None, total: int
) -> None:
    """Run jobs on threads (the loops release the GIL); each returns how many pixels it did."""
    done = 0
    with ThreadPoolExecutor(threads or core_count()) as pool:
        waiting: set[Future[int]] = {pool.submit(work, *job) for job in jobs}
        try:
            while waiting:
                finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                done += sum(future.result() for future in finished)
                if progress is not None:
                    progress(done, total)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
