"""Training data of the networks: texture sets, their variants, and footprints drawn from them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from brdffit.errors import InputError
from brdffit.fitting.presets import get_quality
from brdffit.fitting.rules import level_rules
from brdffit.footprint import get_pixel_filter
from brdffit.halfangle.apparent_lobe import Base, Strata, base_of
from brdffit.learned.kernels.displayed import Shown, show
from brdffit.learned.kernels.footprints import ENERGY, SUMS, sum_blocks
from brdffit.learned.kernels.moments import MOMENTS
from brdffit.learned.kernels.tables import Table, tabulated
from brdffit.learned.variants import varied, with_edges
from brdffit.svbrdf import Svbrdf, level_sizes
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.reading import read_texture_set

#: Levels whose footprints are trained on; those of coarser levels resemble the last.
LEVELS = 8
#: Variants of a set: factor of perceptual roughness, of slopes, of the diffuse colour.
VARIANTS = ((1.0, 1.0, 1.0), (0.6, 1.0, 1.0), (0.8, 2.0, 0.0), (1.2, 0.5, 1.0), (0.35, 1.5, 0.0))
#: Further variants of a set, at random, see ``variants``.
EDGED = 3


def read_set(source: str | Path) -> Svbrdf:
    """A texture set as an SVBRDF of GGX lobes, without occlusion and height."""
    return to_svbrdf(read_texture_set(source)).replace(occlusion=None, height=None)


def set_digest(source: str | Path) -> str:
    """SHA-256 over the files of a set, in the order of their names."""
    folder = Path(source)
    files = sorted(path for path in folder.rglob("*") if path.is_file()) if folder.is_dir() else [folder]
    digest = hashlib.sha256()
    for path in files:
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def level_strata(base_size: tuple[int, int], level: int) -> tuple[Strata, int]:
    """Strata of a level's box footprints, sampled as by the draft preset, and how many lobes they need room for."""
    sizes = level_sizes(base_size)
    level = min(level, len(sizes) - 1)
    rules = level_rules(get_pixel_filter("box"), base_size, sizes[level], level, get_quality("draft"))
    return rules.strata, rules.room + 1


class Footprints(NamedTuple):
    """Footprints as both losses see them: the half-angle error under point lights, the error on a screen."""

    point: Table
    shown: Shown

    def __len__(self) -> int:
        return len(self.point)


def footprints(
    svbrdf: Svbrdf, level: int, count: int, rng: np.random.Generator, base: Base | None = None
) -> Footprints:
    """``count`` random footprints of a level, with moments as a bake computes them; ``base`` is that of the SVBRDF."""
    sizes = level_sizes(svbrdf.size)
    level = min(level, len(sizes) - 1)
    height, width = sizes[level]
    strata, room = level_strata(svbrdf.size, level)
    columns, rows = rng.integers(0, width, count), rng.integers(0, height, count)
    x, y = (columns + 0.5) * svbrdf.size[1] / width, (rows + 0.5) * svbrdf.size[0] / height
    base = base or base_of(svbrdf)
    moments = None
    if svbrdf.size == (height << level, width << level):
        sums = np.zeros((count, SUMS))
        sum_blocks(base, columns << level, rows << level, 1 << level, sums)
        moments = sums[:, :MOMENTS] / sums[:, ENERGY : ENERGY + 1]
    point, fine = tabulated(base, strata, x, y, room, moments=moments)
    shown = show(base, strata, x, y, room, point.moments)
    fine &= shown.is_finite()
    return Footprints(point.rows(fine), shown.rows(fine))


def variants_of(svbrdf: Svbrdf, rng: np.random.Generator) -> Iterator[Svbrdf]:
    """The variants of a set that a network is trained on."""
    for roughness, steepness, diffuse in VARIANTS:
        variant = varied(svbrdf, roughness, steepness)
        yield variant.replace(diffuse=np.float32(diffuse) * variant.diffuse)
    for _ in range(EDGED):
        yield with_edges(svbrdf, rng)


def training_data(sources: Sequence[str | Path], texels: int, rng: np.random.Generator) -> Footprints:
    """Footprints of all sets, variants and levels, about ``texels`` in total.

    Raises:
        InputError: when a set cannot be read, or no set reflects anything.
    """
    each = max(8, math.ceil(texels / (len(sources) * (len(VARIANTS) + EDGED) * LEVELS)))
    parts = []
    for source in sources:
        svbrdf = read_set(source)
        for variant in variants_of(svbrdf, rng):
            base = base_of(variant)
            parts += [footprints(variant, level, each, rng, base) for level in range(LEVELS)]
    data = Footprints(Table.joined([each.point for each in parts]), Shown.joined([each.shown for each in parts]))
    if not len(data):
        raise InputError("The sets reflect nothing; there is nothing to train on.")
    return data
