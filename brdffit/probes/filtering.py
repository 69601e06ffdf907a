"""Filter the levels of a probe by any of the methods, and measure the error of each level.

The error of a level is the relative L1 of radiance, sum |a - b| / sum b, against brute force in float64 over the same
source, on texels drawn from the level (all of a small one).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.probes.cubemap import directions, mean_radiance, resized, solid_angles
from brdffit.probes.curves import Curve
from brdffit.probes.direct import add_bright, filtered_exactly, packed_source, split_bright
from brdffit.probes.downsampling import ColourPyramid
from brdffit.probes.harmonics import filtered_by_harmonics
from brdffit.probes.importance import filtered_by_importance
from brdffit.probes.lobe import is_narrow
from brdffit.probes.tables import BASE_SIZE, filtered_by_table
from brdffit.probes.tree import Tree, tau_for

#: Texels along a face of the irradiance cube, and of the largest source.
IRRADIANCE_SIZE, LARGEST_SOURCE = 32, 1024
METHODS = ("tree", "brute", "table", "importance", "sh")
#: Texels of a level that are held against brute force.
MEASURED = 64
#: alpha of a mirror, where level 0 is filtered instead of copied.
_LEAST_ALPHA = 1e-3
#: Relative difference between the mean of a level and that of the source that is left: sampling at texels explains it.
ENERGY = 1e-3
#: How often a level is filtered at most, until it meets the tolerance.
_TRIES = 4


@dataclass(frozen=True)
class LevelRequest:
    """One level that is wanted.

    Attributes:
        level: its number.
        n: texels along a face.
        roughness: perceptual roughness at which a shader looks it up.
        alpha: roughness alpha of the lobe; 0 asks for a copy of the source.
        points: a texel is the mean over points^2 lobes around directions within it; above 1 for narrow lobes.
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
        error: relative L1 of ``radiance`` against brute force on sampled texels; of a copy, against the source on all
            texels; NaN if not measured.
        bias: sum over these texels against that of brute force, less one; NaN if not measured.
        energy: mean of the channels' sum over that of the source. Where a level has few texels, even exact values miss
            1 by half a percent, since they sample the sphere.
        tau: threshold of the tree; None for other methods.
    """

    request: LevelRequest
    radiance: NDArray
    seconds: float
    error: float
    bias: float
    energy: float
    tau: float | None = None


def level_requests(
    curve: Curve, size: int, source_size: int, copy_first: bool = True, keep_narrow: bool = False
) -> list[LevelRequest]:
    """The levels of a curve on a cube of ``size``; each is half the size of the one before, and at least 1.

    Args:
        curve: roughness of the levels.
        size: texels along a face of level 0.
        source_size: texels along a face of the source.
        copy_first: copy the source to level 0, as for a mirror, instead of filtering it.
        keep_narrow: filter around texel centres only, even where the lobe is narrower than a texel.
    """
    out = []
    roughness = curve.roughness(np.arange(curve.levels, dtype=np.float64))
    for level, alpha in enumerate(curve.alphas()):
        n = max(size >> level, 1)
        stored = 0.0 if level == 0 and copy_first else max(alpha, _LEAST_ALPHA)
        # More points than the source has texels there would add nothing: so narrow a lobe sees one source texel.
        fits = not keep_narrow and stored > 0.0 and is_narrow(stored, n)
        points = min(max(source_size // n, 1), 2) if fits else 1
        out.append(LevelRequest(level, n, float(roughness[level]), stored, points))
    return out


#: Function from a request and the tree's threshold (None for other methods) to a level (6, n, n, 3).
_Make = Callable[[LevelRequest, float | None], NDArray]


def sampled_texels(n: int, count: int = MEASURED) -> NDArray:
    """Flat indices of at most ``count`` texels of a level of n^2, no two the same."""
    total = 6 * n * n
    if total <= count:
        return np.arange(total)
    return np.sort(np.random.default_rng([0, n]).choice(total, count, replace=False))


def points_of(n: int, points: int) -> tuple[NDArray, NDArray]:
    """(6 n^2, points^2, 3) directions within each texel, and (6 n^2, points^2) their shares of its solid angle."""
    shape = (6, n, points, n, points)
    at = directions(n * points).reshape(*shape, 3).transpose(0, 1, 3, 2, 4, 5).reshape(6 * n * n, points**2, 3)
    whole = np.broadcast_to(solid_angles(n * points), (6, n * points, n * points)).reshape(shape)
    share = whole.transpose(0, 1, 3, 2, 4).reshape(6 * n * n, points**2)
    return at, share / share.sum(axis=1, keepdims=True)


class Exact:
    """Brute-force values of ``count`` texels of a level, from a ``packed_source``, to measure levels against."""

    def __init__(self, source: NDArray, request: LevelRequest, threads: int = 1, count: int = MEASURED) -> None:
        self._chosen, points = sampled_texels(request.n, count), request.points
        at, share = points_of(request.n, points)
        exact = filtered_exactly(source, at[self._chosen].reshape(-1, 3), request.alpha, threads)
        #: (at most count, 3) exact radiance.
        self.radiance = (exact.reshape(-1, points**2, 3) * share[self._chosen][..., None]).sum(axis=1)

    def found(self, level: NDArray) -> NDArray:
        """These texels of a level (6, n, n, 3), in the shape of ``radiance``."""
        return level.reshape(-1, 3)[self._chosen]

    def error_and_bias(self, level: NDArray) -> tuple[float, float]:
        """(error, bias) of a level (6, n, n, 3) on these texels: sum |a - b| / sum |b| and sum (a - b) / sum |b|."""
        return _error_and_bias(self.found(level), self.radiance)


def with_energy(level: NDArray, energy: float) -> NDArray:
    """A filtered level (6, n, n, 3), scaled so that its mean is within ENERGY of ``energy``, the mean of the source.

    Both means are of the sum of the channels. Filtering keeps the mean over the sphere, since K has unit integral over
    n as well as over l. The mean of exact texel values still differs a little, because they sample the sphere; ENERGY
    leaves room for that.
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
        tolerance: wanted relative L1 error of each level, for "tree".
        split: texels brighter than this multiple of the mean are taken out and added exactly; None takes none out.
            "tree" and "brute" ignore it: the one refines bright nodes anyway, the other is exact.
        samples: samples a texel, for "importance".
        order: number of degrees, for "sh".
        tables: table of each level, for "table".
        threads: workers; no result depends on their number.
    """

    method: str = "tree"
    tolerance: float = 0.01
    split: float | None = None
    samples: int = 1024
    order: int = 11
    tables: Mapping[int, NDArray] = field(default_factory=dict)
    threads: int = 1


def filter_levels(
    cube: NDArray, requests: Sequence[LevelRequest], options: FilterOptions, measure: bool = True
) -> list[FilteredLevel]:
    """Filter a cube map (6, N, N, 3), N a power of two and at least the largest n, into the levels asked for.

    Without ``measure`` no error is measured, and the tree neither refines a level nor corrects its mean.

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
            if measure:
                level = _checked(level, Exact(source, request, options.threads), make, options, energy)
        out.append(replace(level, energy=_energy(level.radiance, energy)))
    return out


def _filtered(make: _Make, request: LevelRequest, tau: float | None) -> FilteredLevel:
    """One level by the method, not measured."""
    began = time.process_time()
    radiance = make(request, tau).astype(np.float32)
    return FilteredLevel(request, radiance, time.process_time() - began, np.nan, np.nan, 1.0, tau)


def _checked(
    level: FilteredLevel, exact: Exact, make: _Make, options: FilterOptions, energy: float
) -> FilteredLevel:  # fmt: skip
    """A level with its measured error; a level of the tree that misses the tolerance is filtered again, more finely.

    A level of the tree is also scaled to the mean of the source, unless the error would then exceed the tolerance:
    where lobes are narrower than texels, even exact values have another mean.
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
    """The method as a function from a request and a threshold to a level."""
    threads = options.threads
    if options.method == "tree":
        tree = Tree(cube)
        return lambda request, tau: resized(
            tree.level(request.n * request.points, request.alpha, tau or 0.0, threads), request.n
        )
    if options.method == "brute":

        def brute(request: LevelRequest, tau: float | None) -> NDArray:
            at = directions(request.n * request.points)
            return resized(
                filtered_exactly(source, at.reshape(-1, 3), request.alpha, threads).reshape(at.shape), request.n
            )

        return brute
    rest, points = split_bright(cube, options.split) if options.split else (cube, None)
    approximate = _approximation(rest, options)

    def make(request: LevelRequest, tau: float | None) -> NDArray:
        level = approximate(request)
        return level if points is None else add_bright(level, points, request.alpha, threads)

    return make


def _approximation(cube: NDArray, options: FilterOptions) -> Callable[[LevelRequest], NDArray]:
    """The function from a request to a level of the methods "sh", "importance" and "table"."""
    if options.method == "sh":
        return lambda request: np.maximum(
            filtered_by_harmonics(cube, directions(request.n), request.alpha, options.order), 0.0
        )
    if options.method == "importance":
        means = ColourPyramid.of(cube, box=True)
        return lambda request: filtered_by_importance(means, request.n, request.alpha, options.samples, options.threads)
    if options.method != "table":
        raise InputError(f"There is no method '{options.method}': known are {', '.join(METHODS)}.")
    pyramid = ColourPyramid.of(resized(cube, BASE_SIZE))

    def by_table(request: LevelRequest) -> NDArray:
        if request.level not in options.tables:
            raise InputError(f"The table has no level {request.level}: it filters levels 1 to 6 of a cube of 128.")
        if request.n != BASE_SIZE >> request.level:
            raise InputError(f"Tables are for a cube of {BASE_SIZE}, found a level {request.level} of {request.n}.")
        return filtered_by_table(pyramid, request.n, options.tables[request.level], options.threads)

    return by_table


def with_radiance(level: FilteredLevel, radiance: NDArray, cube: NDArray, threads: int = 1) -> FilteredLevel:
    """A level of ``cube`` with other radiance (6, n, n, 3), measured anew; the level itself where no texel differs."""
    if np.array_equal(radiance, level.radiance):
        return level
    if level.request.alpha == 0.0:
        error, bias = _error_and_bias(radiance, resized(cube, level.request.n))
    else:
        error, bias = Exact(packed_source(cube), level.request, threads).error_and_bias(radiance)
    energy = _energy(radiance, float(mean_radiance(cube).sum()))
    return replace(level, radiance=radiance, error=error, bias=bias, energy=energy)


def _energy(level: NDArray, energy: float) -> float:
    """Mean of a level over ``energy``, the mean of the source, both of the sum of the channels."""
    return float(mean_radiance(level).sum()) / energy if energy > 0.0 else 1.0


def _error_and_bias(found: NDArray, exact: NDArray) -> tuple[float, float]:
    """sum |a - b| / sum |b| and sum (a - b) / sum |b|."""
    total = float(np.abs(exact).sum(dtype=np.float64))
    difference = found - exact
    scale = 1.0 / total if total > 0.0 else 1.0
    return float(np.abs(difference).sum(dtype=np.float64)) * scale, float(difference.sum(dtype=np.float64)) * scale
