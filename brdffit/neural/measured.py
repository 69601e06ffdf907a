"""Training data from a file of measured queries, for which no new queries can be made."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.microgeometry.queries import Queries
from brdffit.neural.kernels.dense import ROWS
from brdffit.neural.kernels.material import QUERY
from brdffit.neural.questions import RADIUS, SIGMA

#: One in how many queries is held out, and the fewest queries that a material can be learned from.
_HELD, _FEWEST = 16, 16 * ROWS


class Measured:
    """Measured queries, with positions in texels of the neural material.

    Queries with a direction beyond ``RADIUS`` on the disc are left out, since the material does not represent those.

    Args:
        found: from ``read_queries``.
        size: (height, width) of level 0, which covers the same tile.
        on_plane: targets are pi M, as in the paper, instead of pi M times the light's cosine.

    Attributes:
        queries, targets: (n, QUERY) and (n, 3) float32, for training.
        held, held_targets: the same of queries that are held out.

    Raises:
        InputError: when too few queries are left.
    """

    def __init__(self, found: Queries, size: tuple[int, int], on_plane: bool = False) -> None:
        scale = np.array(size[::-1], float) / np.array(found.size[::-1], float)
        queries = np.zeros((len(found.position), QUERY), np.float32)
        queries[:, :2] = np.mod(found.position * scale, size[::-1])
        sigma = np.maximum(found.sigma * math.sqrt(scale.prod()), 1e-6)
        queries[:, 2] = np.clip(np.log2(sigma / SIGMA), 0.0, max(size).bit_length() - 1)
        queries[:, 3:5], queries[:, 5:7] = found.light[:, :2], found.view[:, :2]
        targets = math.pi * found.value * (1.0 if on_plane else found.light[:, 2:])
        within = np.logical_and(*(np.linalg.norm(queries[:, k : k + 2], axis=1) <= RADIUS for k in (3, 5)))
        if int(within.sum()) < _FEWEST:
            raise InputError(
                f"A neural material is learned from at least {_FEWEST} queries whose directions are within "
                f"{math.degrees(math.asin(RADIUS)):.0f} degrees of the normal, and {int(within.sum())} of "
                f"{len(queries)} are."
            )
        order = np.random.default_rng(0).permutation(np.flatnonzero(within))
        share = len(order) // _HELD
        self.queries, self.targets = queries[order[share:]], np.ascontiguousarray(targets[order[share:]], np.float32)
        self.held, self.held_targets = queries[order[:share]], targets[order[:share]].astype(np.float32)

    def batch(self, count: int, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
        """``count`` random training queries (n, QUERY), sorted by row, and their targets (n, 3)."""
        drawn = rng.integers(len(self.queries), size=count)
        drawn = drawn[np.argsort(self.queries[drawn, 1], kind="stable")]
        return self.queries[drawn], self.targets[drawn]

    def judged(self, level: int) -> tuple[NDArray, NDArray]:
        """Held-out queries (n, QUERY) of the measured level nearest to this one, and truths (2, n, 3).

        There is only one measurement of each, so both truths are the same and its noise counts as error.
        """
        levels = np.rint(self.held[:, 2])
        nearest = levels[np.argmin(np.abs(levels - level))]
        own = levels == nearest
        return self.held[own], np.stack([self.held_targets[own]] * 2)
