"""The held-out figure of the trainings of ``latent`` and ``mipnet``: the error on patches of held-out sets."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from brdffit.halfangle.apparent_lobe import base_of
from brdffit.learned.asked import MOST_FACTOR
from brdffit.learned.data import level_strata, read_set
from brdffit.learned.kernels.tables import Table, errors_of, tabulate
from brdffit.learned.latent import FACTOR, NORMAL, TENSOR, lifted
from brdffit.svbrdf import Svbrdf

#: Levels that are measured.
LEVELS = (1, 2, 3)
#: Patches of each set, their side in texels, and the border in texels within which no texel is measured.
_PATCHES, _PATCH, _BORDER = 2, 64, 8

#: Function from a patch to the outputs (h * w, OUTPUTS) of each of its levels, level 0 first, as of ``latent``.
Say = Callable[[Svbrdf], Sequence[NDArray]]


class JudgedPatch:
    """A patch of a held-out set and the footprints of its texels at some levels, away from its border."""

    def __init__(self, name: str, svbrdf: Svbrdf, tables: Mapping[int, tuple[NDArray, Table]]) -> None:
        self.name, self.svbrdf, self.tables = name, svbrdf, tables

    def errors(self, say: Say) -> dict[int, NDArray]:
        """Relative squared errors (n,) of the measured texels, by level."""
        levels, out = say(self.svbrdf), {}
        for level, (index, table) in self.tables.items():
            said = np.asarray(levels[level], np.float64)[index]
            normal = lifted(said[:, NORMAL])
            theta = np.concatenate([-normal[:, :2] / normal[:, 2:], said[:, TENSOR]], axis=1)
            found = errors_of(table, np.arange(len(table)), theta)
            scale = table.colour * np.exp(np.clip(said[:, FACTOR], -MOST_FACTOR, MOST_FACTOR))
            out[level] = np.clip(found.error, 0.0, 5.0) + found.weight * (scale - found.scale) ** 2
        return out


def judged_patches(sources: Sequence[Path], rng: np.random.Generator) -> list[JudgedPatch]:
    """Random patches of each set, with the tables of their footprints."""
    patches = []
    for source in sources:
        svbrdf = read_set(source)
        base = base_of(svbrdf)
        for _ in range(_PATCHES):
            top, left = (_PATCH * int(rng.integers(0, size // _PATCH)) for size in svbrdf.size)
            part = (slice(top, top + _PATCH), slice(left, left + _PATCH))
            tables = {}
            for level in LEVELS:
                side, edge = _PATCH >> level, max(1, _BORDER >> level)
                rows, columns = (p.reshape(-1) for p in np.mgrid[edge : side - edge, edge : side - edge])
                rule, room = level_strata(svbrdf.size, level)
                scale = 1 << level
                table = tabulate(base, rule, left + (columns + 0.5) * scale, top + (rows + 0.5) * scale, room)
                if len(table) == len(rows):
                    tables[level] = rows * side + columns, table
            arrays = {name: np.ascontiguousarray(array[part]) for name, array in svbrdf.arrays().items()}
            patches.append(JudgedPatch(source.name, svbrdf.replace(**arrays), tables))
    return patches


def figure_of(patches: Sequence[JudgedPatch], say: Say) -> float:
    """SNR in dB, averaged over sets and levels."""
    errors: dict[tuple[str, int], list[NDArray]] = {}
    for patch in patches:
        for level, error in patch.errors(say).items():
            errors.setdefault((patch.name, level), []).append(error)
    return float(np.mean([-10.0 * np.log10(np.mean(np.concatenate(each))) for each in errors.values()]))
