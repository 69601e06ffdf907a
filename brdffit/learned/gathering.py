"""Moments and colours of a level's footprints, texel by texel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import kernel
from brdffit.fitting.batch import diffuse_scale
from brdffit.halfangle.apparent_lobe import DIFFUSE_MOMENT, Base, Strata
from brdffit.halfangle.quadrature import LOBE_COLUMNS
from brdffit.learned.moments import MOMENTS, lobe_moments
from brdffit.learned.tables import prepare_lobes

#: What a texel that reflects nothing weighs.
_DARKEST = 1e-9


class Gathered(NamedTuple):
    """Of n texels: ``moments`` (n, MOMENTS), filtered specular ``colour`` (n, 3), ``diffuse`` (n, 12) as
    ``gather_lobes`` leaves it, and whether ``some`` light is reflected at all (n,)."""

    moments: NDArray
    colour: NDArray
    diffuse: NDArray
    some: NDArray

    @staticmethod
    def empty(texels: int) -> Gathered:
        """Arrays to be filled."""
        return Gathered(
            np.zeros((texels, MOMENTS)),
            np.zeros((texels, 3)),
            np.zeros((texels, DIFFUSE_MOMENT)),
            np.zeros(texels, np.bool_),
        )

    def rows(self, part: slice) -> Gathered:
        """Some of its texels, not copied."""
        return Gathered(*(array[part] for array in self))


@kernel
def gather_rows(base, strata, columns, rows, lobes, moments, colour, diffuse, some):
    """Fill the arrays of ``Gathered`` for texels (columns[i], rows[i]) of a level."""
    for i in range(columns.size):
        count, isotropic, red, green, blue, any_light = prepare_lobes(
            base, strata, columns[i], rows[i], lobes, diffuse[i]
        )
        lobe_moments(lobes, count, isotropic, moments[i])
        colour[i, 0], colour[i, 1], colour[i, 2] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
        some[i] = any_light


@kernel
def diffuse_rows(moments, normal, exponent, out):
    """Diffuse colours (n, 3) that fit footprints' ``Gathered.diffuse`` under normals (n, 3)."""
    for i in range(normal.shape[0]):
        for k in range(3):
            out[i, k] = diffuse_scale(moments[i], k, normal[i, 0], normal[i, 1], normal[i, 2], exponent)


def gather(base: Base, strata: Strata, room: int, columns: NDArray, rows: NDArray) -> Gathered:
    """Texels (columns[i], rows[i]) of a level; ``room`` is how many lobes a footprint may have."""
    found = Gathered.empty(len(columns))
    gather_rows(base, strata, columns, rows, np.zeros((room + 1, LOBE_COLUMNS)), *found)
    return found


def pooled(finer: Gathered, size: tuple[int, int]) -> Gathered:
    """The next level, of half the ``size`` (both even) of this one.

    A box footprint is the union of four of the level before: colours are their mean, moments their mean weighted by
    reflected light. It costs hardly anything, and leaves nothing to chance where footprints are wide.
    """
    height, width = size

    def mean(array: NDArray) -> NDArray:
        four = array.reshape(height // 2, 2, width // 2, 2, array.shape[1])
        return four.mean(axis=(1, 3)).reshape(-1, array.shape[1])

    weight = np.maximum(finer.colour.sum(axis=1, keepdims=True), _DARKEST)
    moments = mean(finer.moments * weight) / mean(weight)
    return Gathered(moments, mean(finer.colour), mean(finer.diffuse), mean(finer.some[:, None])[:, 0] > 0.0)
