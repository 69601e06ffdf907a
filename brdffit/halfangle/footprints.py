"""Footprints that are gathered once: those of a level are merged from the footprints of the level before.

With the box filter a pixel is the union of pixels of the level before (``brdffit.footprint.iter_pyramid``). So the
lobes that it averages are theirs, with equal weights, and each mean over the footprint is the mean of their means:
diffuse moments, colour, mean normal. Lobes that the smallest light hardly distinguishes were merged into cells there,
which keep energy, mean normal and the covariance of normals (``merging.py``). The grid of cells is the same for all
texels, and these sums are additive, so merging cells of cells gives what merging all samples at once would give, but
for cells whose mean falls just beyond the border of its cell in the grid. No cell becomes larger than one of a single
footprint.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import inline, kernel
from brdffit.halfangle.albedo import albedo_of_lobes
from brdffit.halfangle.apparent_lobe import DIFFUSE_MOMENT, gather_lobes, normalise_mixture
from brdffit.halfangle.closed_forms import STEEPEST_SLOPE
from brdffit.halfangle.merging import merge_lobes
from brdffit.halfangle.quadrature import ALPHA_SQUARED, GAIN, MIXTURE, SHAPE, SPECULAR, SPREAD

#: Columns of a stored lobe: normal, alpha^2, shape, weighted colour, mixture weight, SPREAD, GAIN.
STORED = 13
#: Sums of a footprint: the diffuse moment; the colour (0 where nothing is reflected); the mean of normal and of
#: log alpha^2, weighted by reflected energy; the albedo.
COLOUR, AVERAGE, REFLECTED, SUMS = DIFFUSE_MOMENT, DIFFUSE_MOMENT + 3, DIFFUSE_MOMENT + 7, DIFFUSE_MOMENT + 8
# Lobes of a footprint for which there is room at first.
_USUAL = 16


class Footprints(NamedTuple):
    """Merged lobes of n footprints: those of footprint i are ``lobes[first[i] : first[i + 1]]``.

    ``first`` (n + 1,) int64; ``lobes`` (m, STORED) float32; ``sums`` (n, SUMS) float64.
    """

    first: NDArray
    lobes: NDArray
    sums: NDArray

    def __len__(self) -> int:
        return len(self.sums)

    def part(self, start: int, stop: int) -> Footprints:
        """Footprints ``start`` to ``stop`` - 1."""
        a, b = self.first[start], self.first[stop]
        return Footprints(self.first[start : stop + 1] - a, self.lobes[a:b], self.sums[start:stop])

    @property
    def most(self) -> int:
        """Lobes of the largest footprint."""
        return int(np.diff(self.first).max(initial=0))


def no_footprints() -> Footprints:
    """None are given: footprints are gathered where they are needed."""
    return Footprints(np.zeros(1, np.int64), np.zeros((0, STORED), np.float32), np.zeros((0, SUMS)))


def joined(parts: list[Footprints]) -> Footprints:
    """Footprints one after the other. ``parts`` is emptied, so that they are not held twice: they may be many."""
    texels, lobes = sum(len(part) for part in parts), sum(len(part.lobes) for part in parts)
    whole = Footprints(np.zeros(texels + 1, np.int64), np.empty((lobes, STORED), np.float32), np.empty((texels, SUMS)))
    at = 0
    while parts:
        part = parts.pop(0)
        used = whole.first[at]
        whole.first[at + 1 : at + len(part) + 1] = used + part.first[1:]
        whole.lobes[used : used + len(part.lobes)] = part.lobes
        whole.sums[at : at + len(part)] = part.sums
        at += len(part)
    return whole


@inline
def average_of_lobes(lobes, count):
    """Mean normal (x, y, z) and mean log alpha^2 of isotropic lobes, weighted by the mixture."""
    x, y, z, log = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        w = lobes[i, MIXTURE]
        x += w * lobes[i, 0]
        y += w * lobes[i, 1]
        z += w * lobes[i, 2]
        log += w * math.log(lobes[i, ALPHA_SQUARED])
    return x, y, z, log


@inline
def _store(lobe, row):
    for k in range(4):
        row[k] = lobe[k]
        row[9 + k] = lobe[SPREAD + k]
    row[4] = lobe[SHAPE]
    for k in range(3):
        row[5 + k] = lobe[SPECULAR + k]
    row[8] = lobe[MIXTURE]


@inline
def _load(row, lobe, colour, mixture):
    for k in range(3):
        lobe[k] = row[k]
        lobe[SPECULAR + k] = colour * row[5 + k]
        lobe[SPREAD + k] = row[9 + k]
    lobe[ALPHA_SQUARED], lobe[SHAPE], lobe[GAIN] = row[3], row[4], row[12]
    lobe[MIXTURE] = mixture * row[8]


@kernel
def _append(lobes, count, stored, used):
    """Write lobes to ``stored`` from row ``used`` on; returns the array, a longer one if there was no room."""
    if used + count > stored.shape[0]:
        longer = np.empty((2 * stored.shape[0] + count, STORED), np.float32)
        longer[:used] = stored[:used]
        stored = longer
    for i in range(count):
        _store(lobes[i], stored[used + i])
    return stored


@kernel
def thin(lobes, count, most):
    """Keep at most ``most`` lobes, each with a multiple of 1 / ``most`` of the mixture; returns how many.

    Lobes are picked at equal steps of the mixture (systematic resampling), so that a lobe is kept in proportion to its
    energy, and neighbours stand for each other.
    """
    if count <= most:
        return count
    kept, reached, picked = 0, 0.0, 0
    for i in range(count):
        reached += lobes[i, MIXTURE]
        last = min(int(reached * most + 0.5), most) if i < count - 1 else most
        if last > picked and lobes[i, MIXTURE] > 0.0:
            share = (last - picked) / most
            factor = share / lobes[i, MIXTURE]
            for k in range(GAIN + 1):
                lobes[kept, k] = lobes[i, k]
            for k in range(3):
                lobes[kept, SPECULAR + k] *= factor
            lobes[kept, MIXTURE] = share
            kept, picked = kept + 1, last
    return kept


@kernel
def gather_footprints(base, strata, step, cell, most, columns, rows, lobes, cells):
    """Gather and merge the footprints of the texels (columns[i], rows[i]): the fields of ``Footprints``.

    ``step`` and ``lobes`` as in ``gather_lobes``, ``cell`` and ``cells`` as in ``merge_lobes``; ``most``: lobes of a
    footprint at most.
    """
    texels = columns.size
    first, sums = np.zeros(texels + 1, np.int64), np.zeros((texels, SUMS))
    stored = np.empty((_USUAL * texels, STORED), np.float32)
    for i in range(texels):
        own = sums[i]
        count, _ = gather_lobes(base, strata, step, columns[i], rows[i], lobes, own[:DIFFUSE_MOMENT])
        red, green, blue, some = normalise_mixture(lobes, count)
        if some:
            own[COLOUR], own[COLOUR + 1], own[COLOUR + 2] = red, green, blue
        own[AVERAGE], own[AVERAGE + 1], own[AVERAGE + 2], own[AVERAGE + 3] = average_of_lobes(lobes, count)
        own[REFLECTED] = albedo_of_lobes(lobes, count, True)
        count, _ = merge_lobes(lobes, count, strata.light, cell, cells)
        count = thin(lobes, count, most)
        stored = _append(lobes, count, stored, first[i])
        first[i + 1] = first[i] + count
    return first, stored[: first[texels]].copy(), sums


@kernel
def merge_footprints(finer, index, light, cell, most, lobes, cells):
    """Footprints that are the unions of finer ones, of the footprints ``index[i]`` for each i.

    ``light``: alpha^2 that the smallest light adds to lobes; the rest as in ``gather_footprints``. ``lobes`` must have
    room for all lobes of a union.
    """
    texels, many = index.shape
    first, sums = np.zeros(texels + 1, np.int64), np.zeros((texels, SUMS))
    stored = np.empty((_USUAL * texels, STORED), np.float32)
    equal = 1.0 / many
    for i in range(texels):
        own, energy, count = sums[i], 0.0, 0
        for k in range(many):
            part = finer.sums[index[i, k]]
            energy += part[COLOUR] + part[COLOUR + 1] + part[COLOUR + 2]
        for k in range(many):
            j = index[i, k]
            part = finer.sums[j]
            # Where nothing at all is reflected, lobes are white and have the weights of the filter.
            share = (part[COLOUR] + part[COLOUR + 1] + part[COLOUR + 2]) / energy if energy > 0.0 else equal
            for m in range(AVERAGE):
                own[m] += equal * part[m]
            for m in range(AVERAGE, SUMS):
                own[m] += share * part[m]
            if share > 0.0:
                for m in range(finer.first[j], finer.first[j + 1]):
                    _load(finer.lobes[m], lobes[count], equal, share)
                    count += 1
        count, _ = merge_lobes(lobes, count, light, cell, cells)
        count = thin(lobes, count, most)
        stored = _append(lobes, count, stored, first[i])
        first[i + 1] = first[i] + count
    return first, stored[: first[texels]].copy(), sums


@kernel
def take_footprint(footprints, i, lobes, diffuse_moment):
    """Write footprint i into ``lobes`` and ``diffuse_moment``, as ``gather_lobes`` and ``normalise_mixture`` would.

    Returns (how many lobes, the mean colour r, g, b, whether any is reflected).
    """
    start, sums = footprints.first[i], footprints.sums[i]
    count = footprints.first[i + 1] - start
    for k in range(count):
        _load(footprints.lobes[start + k], lobes[k], 1.0, 1.0)
    for k in range(DIFFUSE_MOMENT):
        diffuse_moment[k] = sums[k]
    red, green, blue = sums[COLOUR], sums[COLOUR + 1], sums[COLOUR + 2]
    return count, red, green, blue, red + green + blue > 0.0


@inline
def average_of_footprint(footprints, i):
    """As ``average_of_lobes``, for footprint i before its lobes were merged."""
    sums = footprints.sums[i]
    return sums[AVERAGE], sums[AVERAGE + 1], sums[AVERAGE + 2], sums[AVERAGE + 3]


@inline
def set_average(x, y, z, log, shape, average):
    """``average`` (6,) <- the lobe of a mean normal and a mean log alpha^2; returns whether it is not too steep."""
    if not z > math.sqrt(x * x + y * y) / STEEPEST_SLOPE:
        return False
    average[0], average[1], average[2], average[3] = -x / z, -y / z, log, log
    average[4], average[5] = 0.0, shape
    return True
