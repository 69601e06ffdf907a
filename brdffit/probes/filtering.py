"""The levels of a probe by any of the methods, each with its measured error.

The error of a level is the relative L1 of radiance, sum |a - b| / sum b, against brute force in float64 over the same
source, on texels drawn from the level (all of a small one).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.probes.cubemap import directions, mean_radiance, resized, solid_angles
from brdffit.probes.curves import Curve
from brdffit.probes.direct import add_bright, filtered_exactly, packed_source, split_bright
from brdffit.probes.harmonics import filtered_by_harmonics
from brdffit.probes.importance import filtered_by_importance
from brdffit.probes.lobe import is_narrow
from brdffit.probes.tables import BASE_SIZE, filtered_by_table
from brdffit.probes.tree import Tree, tau_for

METHODS = ("tree", "brute", "table", "importance", "sh")
#: Texels of a level that are held against brute force.
MEASURED = 64
#: A mirror's lobe where level 0 is filtered.
_LEAST_ALPHA = 1e-3
#: Relative difference of the mean of a level from that of the source that sampling by texels explains.
ENERGY = 1e-3
#: How often a level is filtered anew when it missed the tolerance.
_TRIES = 4


@dataclass(frozen=True)
class LevelRequest:
    """One level that is wanted.

    Attributes:
        level: its number.
        n: texels along a face.
        roughness: perceptual roughness that a shader looks up there.
        alpha: of the lobe; 0 for a copy of the source.
        points: a texel is the mean of points^2 lobes around directions within it, for lobes that are narrower than it.
    """

    level: int
    n: int
    roughness: float
    alpha: float
    points: int = 1


@dataclass(frozen=True)
class FilteredLevel:
    """A level that was filtered.

    Attributes:
        request: what was asked for.
        radiance: (6, n, n, 3) float32.
        seconds: processor time of filtering, all threads.
        error: relative L1 against brute force on sampled texels; 0 for a copy; None if not measured.
        bias: sum over the sampled texels against that of brute force, less one; None if not measured.
        energy: mean radiance over that of the source, of the three channels' sum. Few texels sample even an exact level
            by halves of a percent.
        tau: threshold of the tree, if that is how it was made.
    """

    request: LevelRequest
    radiance: NDArray
    seconds: float
    error: float | None
    bias: float | None
    energy: float
    tau: float | None = None


def level_requests(
    curve: Curve, size: int, source_size: int, copy_first: bool = True, keep_narrow: bool = False
) -> list[LevelRequest]:
    """The levels of a curve on a cube of ``size``: half the size each, never below 1.

    Args:
        curve: roughness of the levels.
        size: texels along a face of level 0.
        source_size: texels along a face of what is filtered.
        copy_first: level 0 is the source itself, a mirror.
        keep_narrow: do not average lobes that are narrower than a texel over it.
    """
    out = []
    roughness = curve.roughness(np.arange(curve.levels, dtype=np.float64))
    for level, alpha in enumerate(curve.alphas()):
        n = max(size >> level, 1)
        stored = 0.0 if level == 0 and copy_first else max(alpha, _LEAST_ALPHA)
        # No more points than the source has texels there: a lobe around one of those is about that texel.
        fits = not keep_narrow and stored > 0.0 and is_narrow(stored, n)
        points = min(max(source_size // n, 1), 2) if fits else 1
        out.append(LevelRequest(level, n, float(roughness[level]), stored, points))
    return out


#: Makes a level; a threshold for the tree.
_Make = Callable[[LevelRequest, float | None], NDArray]


def sampled_texels(n: int, count: int = MEASURED, seed: int = 0) -> NDArray:
    """Flat indices of at most ``count`` texels of a level of n^2, no two the same."""
    total = 6 * n * n
    if total <= count:
        return np.arange(total)
    return np.sort(np.random.default_rng([seed, n]).choice(total, count, replace=False))


def points_of(n: int, points: int) -> tuple[NDArray, NDArray]:
    """(6 n^2, points^2, 3) directions within each texel, and their shares of its solid angle."""
    shape = (6, n, points, n, points)
    at = directions(n * points).reshape(*shape, 3).transpose(0, 1, 3, 2, 4, 5).reshape(6 * n * n, points**2, 3)
    whole = np.broadcast_to(solid_angles(n * points), (6, n * points, n * points)).reshape(shape)
    share = whole.transpose(0, 1, 3, 2, 4).reshape(6 * n * n, points**2)
    return at, share / share.sum(axis=1, keepdims=True)


class Exact:
    """Some texels of a level by brute force over a ``packed_source``; a level is held against them."""

    def __init__(self, source: NDArray, request: LevelRequest, threads: int = 1, count: int = MEASURED) -> None:
        self._chosen, points = sampled_texels(request.n, count), request.points
        at, share = points_of(request.n, points)
        exact = filtered_exactly(source, at[self._chosen].reshape(-1, 3), request.alpha, threads)
        self._radiance = (exact.reshape(-1, points**2, 3) * share[self._chosen][..., None]).sum(axis=1)

    def error_and_bias(self, level: NDArray) -> tuple[float, float]:
        """Relative L1 of a level (6, n, n, 3) on these texels, and the sum of differences over the same sum."""
        total = float(np.abs(self._radiance).sum())
        difference = level.reshape(-1, 3)[self._chosen] - self._radiance
        scale = 1.0 / total if total > 0.0 else 1.0
        return float(np.abs(difference).sum()) * scale, float(difference.sum()) * scale


def with_energy(level: NDArray, energy: float) -> NDArray:
    """A filtered level (6, n, n, 3) whose mean is brought to within ENERGY of ``energy``, the source's mean.

    The mean over the sphere of a filtered environment is its own mean, for K has unit integral in l as in n. That of
    texel values differs a little even where they are exact, since they sample the sphere: so much is left.
    """
    found = float(mean_radiance(level).sum())
    if found <= 0.0 or energy <= 0.0:
        return level
    excess = found / energy - 1.0
    return level * np.float32((1.0 + np.clip(excess, -ENERGY, ENERGY)) / (1.0 + excess))


@dataclass(frozen=True)
class FilterOptions:
    """How levels are filtered.

    Attributes:
        method: one of METHODS.
        tolerance: wanted relative L1 of each level (the tree).
        split: bright texels above this times the mean are taken out and added exactly; None for none. (Not the tree,
            which opens them anyway.)
        samples: of importance sampling.
        order: of harmonics.
        tables: of each level, for ``table``.
        threads: workers; no result depends on them.
    """

    method: str = "tree"
    tolerance: float = 0.01
    split: float | None = None
    samples: int = 1024
    order: int = 11
    tables: Sequence[NDArray | None] = ()
    threads: int = 1


def filter_levels(
    cube: NDArray, requests: Sequence[LevelRequest], options: FilterOptions, measure: bool = True
) -> list[FilteredLevel]:
    """Filter a cube map (6, N, N, 3), N a power of two and at least the largest n, into the levels asked for.

    Raises:
        InputError: when the method cannot make a level.
    """
    source = packed_source(cube)
    energy = float(mean_radiance(cube).sum())
    make = _maker(cube, source, options)
    out = []
    for request in requests:
        if request.alpha == 0.0:
            level = FilteredLevel(request, resized(cube, request.n).astype(np.float32), 0.0, 0.0, 0.0, 1.0)
        else:
            level = _filtered(make, request, tau_for(options.tolerance) if options.method == "tree" else None)
            # A level that is not measured keeps its mean: that of exact values may differ where texels are few.
            if measure:
                level = _checked(level, Exact(source, request, options.threads), make, options, energy)
        kept = float(mean_radiance(level.radiance).sum()) / energy if energy > 0.0 else 1.0
        out.append(replace(level, energy=kept))
    return out


def _filtered(make: _Make, request: LevelRequest, tau: float | None) -> FilteredLevel:
    """One level as the method makes it, not measured."""
    began = time.process_time()
    radiance = make(request, tau).astype(np.float32)
    return FilteredLevel(request, radiance, time.process_time() - began, None, None, 1.0, tau)


def _checked(
    level: FilteredLevel, exact: Exact, make: _Make, options: FilterOptions, energy: float
) -> FilteredLevel:  # fmt: skip
    """A level with its measured error; the tree's is filtered anew, more finely, where it misses the tolerance.

    The tree's levels are brought to the source's mean, but where that costs the tolerance: lobes that fall between
    texels have another.
    """
    error, bias = exact.error_and_bias(level.radiance)
    for attempt in range(_TRIES if level.tau else 0):
        kept = with_energy(level.radiance, energy)
        kept_error, kept_bias = exact.error_and_bias(kept)
        if kept_error <= max(error, options.tolerance):
            level, error, bias = replace(level, radiance=kept), kept_error, kept_bias
        if error <= options.tolerance or attempt == _TRIES - 1:
            break
        # The error goes as the root of tau.
        fresh = _filtered(make, level.request, (level.tau or 0.0) * 0.7 * (options.tolerance / error) ** 2)
        level = replace(fresh, seconds=level.seconds + fresh.seconds)
        error, bias = exact.error_and_bias(level.radiance)
    return replace(level, error=error, bias=bias)


def _maker(cube: NDArray, source: NDArray, options: FilterOptions) -> _Make:
    """The method as a function of a level and a threshold."""
    method, threads = options.method, options.threads
    if method == "tree":
        tree = Tree(cube)
        return lambda request, tau: resized(
            tree.level(request.n * request.points, request.alpha, tau or 0.0, threads), request.n
        )
    rest, points = split_bright(cube, options.split) if options.split else (cube, None)

    def whole(level: NDArray, alpha: float) -> NDArray:
        return level if points is None else add_bright(level, points, alpha, threads)

    def brute(request: LevelRequest, tau: float | None) -> NDArray:
        fine = request.n * request.points
        normals = directions(fine).reshape(-1, 3)
        return resized(filtered_exactly(source, normals, request.alpha, threads).reshape(6, fine, fine, 3), request.n)

    def importance(request: LevelRequest, tau: float | None) -> NDArray:
        made = filtered_by_importance(rest, [(request.n, request.alpha)], options.samples, threads)[0]
        return whole(made, request.alpha)

    def harmonics(request: LevelRequest, tau: float | None) -> NDArray:
        made = filtered_by_harmonics(rest, directions(request.n), request.alpha, options.order)
        return whole(np.maximum(made, 0.0), request.alpha)

    def table(request: LevelRequest, tau: float | None) -> NDArray:
        tables: list[NDArray | None] = [None] * (request.level + 1)
        if request.level >= len(options.tables) or options.tables[request.level] is None:
            raise InputError(f"The table has no level {request.level}: it filters levels 1 to 6 of a cube of 128.")
        if request.n != BASE_SIZE >> request.level:
            raise InputError(f"Tables are for a cube of {BASE_SIZE}, found a level {request.level} of {request.n}.")
        tables[-1] = options.tables[request.level]
        made = filtered_by_table(resized(rest, BASE_SIZE), tables, threads)[-1]
        assert made is not None
        return whole(made, request.alpha)

    makers = {"brute": brute, "importance": importance, "sh": harmonics, "table": table}
    if method not in makers:
        raise InputError(f"There is no method '{method}': known are {', '.join(METHODS)}.")
    return makers[method]


def with_radiance(level: FilteredLevel, radiance: NDArray) -> FilteredLevel:
    """The same level holding other values."""
    return replace(level, radiance=radiance)
