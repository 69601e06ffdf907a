"""Which footprints of a pyramid are merged from those of the level before, and the work of merging them.

A chain begins at level ``FIRST`` or coarser, where footprints are gathered from the base; every further level has
sides that divide those of the level before.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.halfangle.apparent_lobe import Base, Strata, example_base, example_strata
from brdffit.halfangle.footprints import Footprints, gather_footprints, joined, merge_footprints, no_footprints
from brdffit.halfangle.merging import make_cells
from brdffit.halfangle.quadrature import LOBE_COLUMNS

#: The finest level whose footprints are kept: those of level 1 would be many, and take as long to merge as to gather.
FIRST = 2
# Texels of the first level of a chain that are gathered at a time.
_AT_A_TIME = 1 << 14


class Chain(NamedTuple):
    """Levels whose footprints are merged from one another, up to one level.

    Attributes:
        strata: of the first level, gathered from the base.
        room: for the samples of a footprint of that level.
        sizes: (height, width) of each level, the finest first.
        most: lobes of a footprint at most, for each level.
    """

    strata: Strata
    room: int
    sizes: tuple[tuple[int, int], ...]
    most: tuple[int, ...]

    @property
    def parts(self) -> tuple[int, int]:
        """How many pixels of the level before the last make one of the last: (down, across)."""
        (height, width), (finer_height, finer_width) = self.sizes[-1], self.sizes[-2]
        return finer_height // height, finer_width // width

    def before(self) -> Chain:
        """The chain without its last level."""
        return self._replace(sizes=self.sizes[:-1], most=self.most[:-1])


def first_of_chain(sizes: list[tuple[int, int]], mip_level: int) -> int | None:
    """The level whose footprints are gathered to be merged to those of ``mip_level``; None for too fine a level."""
    first = mip_level
    while first > FIRST and divides(sizes[first], sizes[first - 1]):
        first -= 1
    return first if first >= FIRST else None


def divides(size: tuple[int, int], finer: tuple[int, int]) -> bool:
    """Whether the pixels of a level are unions of those of a finer level."""
    return finer[0] % size[0] == 0 and finer[1] % size[1] == 0


@cache
def compile_footprints() -> None:
    """Compile the kernels of a chain or load them from the cache, before threads start or a fit is timed."""
    none, lobes, cells = np.zeros(0, np.int64), np.zeros((1, LOBE_COLUMNS)), make_cells(1)
    gather_footprints(example_base(), example_strata(), 0.0, 0.0, 1, none, none, lobes, cells)
    merge_footprints(no_footprints(), none.reshape(0, 1), 0.0, 0.0, 1, lobes, cells)


def footprints_of(base: Base, chain: Chain, step: float, cell: float, columns: NDArray, rows: NDArray) -> Footprints:
    """Footprints of texels of the last level of a chain.

    ``step``, ``cell``: as in ``Search``. Their parts on the first level are gathered a few texels at a time.
    """
    if len(chain.sizes) == 1:
        lobes, cells = np.zeros((chain.room + 1, LOBE_COLUMNS)), make_cells(chain.room)
        most = chain.most[0]
        return Footprints(*gather_footprints(base, chain.strata, step, cell, most, columns, rows, lobes, cells))
    (height, width), (fine_height, fine_width) = chain.sizes[-1], chain.sizes[0]
    at_a_time = max(1, _AT_A_TIME * height * width // (fine_height * fine_width))
    found = []
    for k in range(0, len(columns), at_a_time):
        part = slice(k, k + at_a_time)
        finer = parts_of(base, chain, step, cell, columns[part], rows[part])
        found.append(unions(finer, chain, cell))
    return joined(found)


def parts_of(base: Base, chain: Chain, step: float, cell: float, columns: NDArray, rows: NDArray) -> Footprints:
    """Footprints of the level before the last whose unions are those of texels of the last, those of a texel together.

    The chain must have two levels or more.
    """
    down, across = chain.parts
    y, x = (grid.ravel() for grid in np.indices((down, across)))
    fine_columns, fine_rows = columns[:, None] * across + x, rows[:, None] * down + y
    return footprints_of(base, chain.before(), step, cell, fine_columns.ravel(), fine_rows.ravel())


def unions(finer: Footprints, chain: Chain, cell: float, rows: bool = False) -> Footprints:
    """Footprints of the last level of a chain from those of the level before.

    ``finer``: as ``parts_of`` returns them, or all footprints of whole ``rows`` of that level.
    """
    down, across = chain.parts
    each = np.arange(len(finer))
    if rows:
        each = each.reshape(-1, down, chain.sizes[-1][1], across).swapaxes(1, 2).ravel()
    index = each.reshape(-1, down * across)
    room = max(1, int(np.diff(finer.first)[index].sum(axis=1).max(initial=0)))
    lobes, cells = np.zeros((room, LOBE_COLUMNS)), make_cells(room)
    return Footprints(*merge_footprints(finer, index, chain.strata.light, cell, chain.most[-1], lobes, cells))
