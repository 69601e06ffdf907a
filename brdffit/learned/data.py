"""Training data of the networks: texture sets, their variants, and footprints drawn from them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from brdffit.errors import InputError
from brdffit.fitting.method import level_rules
from brdffit.fitting.presets import get_quality
from brdffit.footprint import get_pixel_filter
from brdffit.halfangle.apparent_lobe import Strata, base_of
from brdffit.learned.kernels.footprints import ENERGY, SUMS, sum_blocks
from brdffit.learned.kernels.moments import MOMENTS
from brdffit.learned.kernels.tables import Table, tabulate
from brdffit.roughness import DEFAULT_MIN_ROUGHNESS, clipped_log
from brdffit.svbrdf import Svbrdf, level_sizes
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.reading import read_texture_set

#: Levels whose footprints are trained on; those of coarser levels resemble the last.
LEVELS = 6
#: Variants of a set: factor of perceptual roughness, factor of slopes.
VARIANTS = ((1.0, 1.0), (0.6, 1.0), (0.8, 2.0), (1.2, 0.5), (0.35, 1.5))


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


def varied(svbrdf: Svbrdf, roughness: float, steepness: float) -> Svbrdf:
    """An SVBRDF with perceptual roughness and slopes scaled; eigenvalues of the log tensor are clipped to the range."""
    if roughness == 1.0 and steepness == 1.0:
        return svbrdf
    normal = svbrdf.normal.copy()
    normal[..., :2] *= steepness
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    log_roughness = svbrdf.log_roughness + np.float32(4.0 * math.log(roughness)) * np.array([1, 1, 0], np.float32)
    return svbrdf.replace(normal=normal, log_roughness=clipped_log(log_roughness, DEFAULT_MIN_ROUGHNESS))


def level_strata(base_size: tuple[int, int], level: int) -> tuple[Strata, int]:
    """Strata of a level's box footprints, sampled as by the draft preset, and how many lobes they need room for."""
    sizes = level_sizes(base_size)
    level = min(level, len(sizes) - 1)
    rules = level_rules(get_pixel_filter("box"), base_size, sizes[level], level, get_quality("draft"))
    return rules.strata, rules.room + 1


def footprints(svbrdf: Svbrdf, level: int, count: int, rng: np.random.Generator) -> Table:
    """The table of ``count`` random footprints of a level, with moments as a bake computes them."""
    sizes = level_sizes(svbrdf.size)
    level = min(level, len(sizes) - 1)
    height, width = sizes[level]
    strata, room = level_strata(svbrdf.size, level)
    columns, rows = rng.integers(0, width, count), rng.integers(0, height, count)
    x, y, base = (columns + 0.5) * svbrdf.size[1] / width, (rows + 0.5) * svbrdf.size[0] / height, base_of(svbrdf)
    moments = None
    if svbrdf.size == (height << level, width << level):
        sums = np.zeros((count, SUMS))
        sum_blocks(base, columns << level, rows << level, 1 << level, sums)
        moments = sums[:, :MOMENTS] / sums[:, ENERGY : ENERGY + 1]
    return tabulate(base, strata, x, y, room, moments=moments)


def training_table(sources: Sequence[str | Path], texels: int, rng: np.random.Generator) -> Table:
    """The table of footprints of all sets, variants and levels, about ``texels`` in total.

    Raises:
        InputError: when a set cannot be read, or no set reflects anything.
    """
    each = max(8, math.ceil(texels / (len(sources) * len(VARIANTS) * LEVELS)))
    parts = []
    for source in sources:
        svbrdf = read_set(source)
        for roughness, steepness in VARIANTS:
            variant = varied(svbrdf, roughness, steepness)
            parts += [footprints(variant, level, each, rng) for level in range(LEVELS)]
    table = Table.joined(parts)
    if not len(table):
        raise InputError("The sets reflect nothing; there is nothing to train on.")
    return table
