"""Training crops of the method ``latent``: augmented patches of 32 x 32 texels, and footprints in them.

The augmentation is the paper's: roughness, slopes and colours are scaled, tensors are stretched, patches are flipped
and transposed, and a binary mask of noise combines two patches, so that a patch holds contrasts that no set has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import LUMINANCE
from brdffit.fitting.batch import model_kernels
from brdffit.fitting.presets import get_quality
from brdffit.footprint import get_pixel_filter
from brdffit.halfangle.apparent_lobe import base_of, strata
from brdffit.learned.data import read_set
from brdffit.learned.kernels.tables import Table, tabulate
from brdffit.learned.latent import MODELS, inputs_of
from brdffit.roughness import DEFAULT_MIN_ROUGHNESS, clipped_log
from brdffit.svbrdf import Svbrdf

SIDE = 32
#: Levels of a crop's pyramid, and the texels of all of them.
LEVELS = 6
TEXELS = sum((SIDE >> level) ** 2 for level in range(LEVELS))
#: Scales of the footprints of a crop, and footprints at each scale. Footprints lie within the crop; those wider than
#: it, beyond level 5, see it repeated.
SCALES, POINTS = 12, 16
_LOWEST, _HIGHEST = -0.5, 5.5
#: Largest number of samples of a footprint along an axis.
_MOST_SAMPLES = 24
_TAPS = 8


@dataclass(frozen=True)
class Crop:
    """One patch and its footprints.

    Attributes:
        model: lobe model of the base.
        inputs: (32, 32, INPUTS) float32, before whitening.
        taps: (n, 8) int64, rows of the pyramid of all levels that trilinear filtering reads for each point.
        shares: (n, 8) weights of the taps.
        x, y, size: (n,) centre and width of each point's footprint in base texels; runs of POINTS share one size.
        table: the exact objective of the footprints; None where it was not asked for.
        normal, tensor, light: the base, float32: (32, 32, 3) normals, (32, 32, 3) log tensors, (32, 32) luminance.
        pooled_light: (TEXELS,) luminance of all levels, averaged.
    """

    model: str
    inputs: NDArray
    taps: NDArray
    shares: NDArray
    x: NDArray
    y: NDArray
    size: NDArray
    table: Table | None
    normal: NDArray
    tensor: NDArray
    light: NDArray
    pooled_light: NDArray


class Source:
    """The maps of a texture set that crops are cut from: normals, log tensors and specular luminance."""

    def __init__(self, path: str | Path) -> None:
        svbrdf = read_set(path)
        self.normal, self.log_roughness = svbrdf.normal, svbrdf.log_roughness
        self.luminance = svbrdf.specular @ LUMINANCE

    def patch(self, rng: np.random.Generator) -> tuple[NDArray, NDArray, NDArray]:
        """An augmented patch: normals, log tensors, luminance."""
        height, width = self.luminance.shape
        rows = (rng.integers(0, height) + np.arange(SIDE)) % height
        columns = (rng.integers(0, width) + np.arange(SIDE)) % width
        part = np.ix_(rows, columns)
        turned = _turned(self.normal[part], self.log_roughness[part], self.luminance[part], rng)
        return _varied(*turned, rng)


def _turned(
    normal: NDArray, tensor: NDArray, luminance: NDArray, rng: np.random.Generator
) -> tuple[NDArray, NDArray, NDArray]:
    """A random symmetry of the square applied to maps and vectors. Rows run down, y runs up."""
    flip_x, flip_y, swap = rng.random(3) < 0.5
    normal, tensor = normal.copy(), tensor.copy()
    if flip_x:
        normal, tensor, luminance = normal[:, ::-1], tensor[:, ::-1], luminance[:, ::-1]
        normal[..., 0] *= -1.0
        tensor[..., 2] *= -1.0
    if flip_y:
        normal, tensor, luminance = normal[::-1], tensor[::-1], luminance[::-1]
        normal[..., 1] *= -1.0
        tensor[..., 2] *= -1.0
    if swap:
        # Columns become rows: x becomes -y, y becomes -x.
        normal, tensor = normal.transpose(1, 0, 2), tensor.transpose(1, 0, 2)
        normal = np.stack([-normal[..., 1], -normal[..., 0], normal[..., 2]], axis=2)
        tensor = np.stack([tensor[..., 1], tensor[..., 0], tensor[..., 2]], axis=2)
        luminance = luminance.T
    return normal, tensor, luminance


def _varied(
    normal: NDArray, tensor: NDArray, luminance: NDArray, rng: np.random.Generator
) -> tuple[NDArray, NDArray, NDArray]:
    steepness = math.exp(rng.uniform(math.log(0.4), math.log(2.5)))
    normal = normal * np.array([steepness, steepness, 1.0], np.float32)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    mean = 4.0 * math.log(math.exp(rng.uniform(math.log(0.35), math.log(1.3))))
    stretch, angle = (rng.uniform(0.0, 1.5), rng.uniform(0.0, math.pi)) if rng.random() < 0.3 else (0.0, 0.0)
    half, off = stretch * math.cos(2.0 * angle), stretch * math.sin(2.0 * angle)
    tensor = tensor + np.array([mean + half, mean - half, off], np.float32)
    return (
        normal,
        clipped_log(tensor, DEFAULT_MIN_ROUGHNESS).astype(np.float32),
        np.minimum(luminance * math.exp(rng.uniform(-1.2, 1.2)), 1.0),
    )


def noise_mask(rng: np.random.Generator) -> NDArray:
    """(32, 32) bool: where value noise of four octaves exceeds a random quantile of it."""
    total = np.zeros((SIDE, SIDE))
    for octave in range(1, 5):
        cells = 1 << octave
        grid = rng.standard_normal((cells + 1, cells + 1)) / cells
        at = np.linspace(0.0, cells, SIDE, endpoint=False)
        first = at.astype(int)
        share = at - first
        down = grid[first] * (1.0 - share)[:, None] + grid[first + 1] * share[:, None]
        total += down[:, first] * (1.0 - share) + down[:, first + 1] * share
    return total > np.quantile(total, rng.uniform(0.1, 0.9))


def make_crop(sources: Sequence[Source], rng: np.random.Generator, exact: bool = True) -> Crop:
    """A crop of a random set and a random lobe model; half of all crops combine two patches by a mask."""
    patch = sources[int(rng.integers(len(sources)))].patch(rng)
    if rng.random() < 0.5:
        other, mask = sources[int(rng.integers(len(sources)))].patch(rng), noise_mask(rng)
        patch = tuple(
            np.where(mask[..., None] if one.ndim == 3 else mask, one, two)
            for one, two in zip(patch, other, strict=True)
        )  # type: ignore[assignment]
    normal, tensor, light = (np.ascontiguousarray(part, np.float32) for part in patch)
    return crop_of(normal, tensor, light, rng, MODELS[int(rng.integers(len(MODELS)))], exact)


def crop_of(
    normal: NDArray, tensor: NDArray, light: NDArray, rng: np.random.Generator, model: str = MODELS[0],
    exact: bool = True,
) -> Crop:  # fmt: skip
    """A crop of these maps with footprints at random scales and points; with ``exact``, with their tables.

    Args:
        normal, tensor, light: (32, 32, 3) normals, (32, 32, 3) log tensors, (32, 32) luminance.
        rng: draws the footprints.
        model: lobe model of the maps.
        exact: whether ``Crop.table`` is made.
    """
    grey = np.repeat(light[..., None], 3, axis=2)
    svbrdf = Svbrdf(normal, tensor, grey, np.zeros_like(grey), model=model, wrap="clamp")
    bases = {wrap: base_of(svbrdf.replace(wrap=wrap)) for wrap in ("clamp", "tile")}
    kernels = model_kernels(model, "ggx")
    quality, pixel_filter = get_quality("draft"), get_pixel_filter("box")
    tables, taps, shares, places = [], [], [], []
    for k in range(SCALES):
        level = _LOWEST + (_HIGHEST - _LOWEST) * (k + rng.random()) / SCALES
        scale = 2.0**level
        half = 0.5 * min(scale, SIDE)
        x, y = (rng.uniform(half, max(SIDE - half, half + 1e-6), POINTS) for _ in range(2))
        if exact:
            per_texel = 2 * max(1, math.ceil(0.5 * quality.least / max(scale, 1.0)))
            size = (SIDE / scale, SIDE / scale)
            rule = strata(pixel_filter, (SIDE, SIDE), size, per_texel, _MOST_SAMPLES, 0, quality.merge)  # type: ignore[arg-type]
            base = bases["tile" if scale > SIDE else "clamp"]
            table = tabulate(base, rule, x, y, 4 * rule.samples + quality.room + 1, kernels)
            if len(table) < POINTS:  # a black patch: nothing to learn from
                continue
            tables.append(table)
        here, weights = trilinear(x, y, level)
        taps.append(here)
        shares.append(weights)
        places.append((x, y, np.full(POINTS, scale)))
    if not places:
        return crop_of(normal, tensor, np.full_like(light, 0.5), rng, model, exact)
    levels = [light]
    for _ in range(LEVELS - 1):
        side = len(levels[-1]) // 2
        levels.append(levels[-1].reshape(side, 2, side, 2).mean(axis=(1, 3)))
    centre_x, centre_y, width = (np.concatenate(part) for part in zip(*places, strict=True))
    return Crop(
        model=model, inputs=inputs_of(normal, tensor, light), taps=np.concatenate(taps), shares=np.concatenate(shares),
        x=centre_x, y=centre_y, size=width, table=Table.joined(tables) if exact else None, normal=normal, tensor=tensor,
        light=light, pooled_light=np.concatenate([level.reshape(-1) for level in levels]),
    )  # fmt: skip


def trilinear(x: NDArray, y: NDArray, level: float) -> tuple[NDArray, NDArray]:
    """Taps and weights, both (n, 8), of trilinear reads at points in base texels; borders are clamped."""
    detail = min(max(level, 0.0), LEVELS - 1.0)
    fine = min(int(detail), LEVELS - 2)
    taps, shares = np.empty((len(x), _TAPS), np.int64), np.empty((len(x), _TAPS))
    starts = np.cumsum([0, *((SIDE >> k) ** 2 for k in range(LEVELS))])
    for k in range(2):
        side = SIDE >> (fine + k)
        level_share = 1.0 - (detail - fine) if k == 0 else detail - fine
        u, v = (np.clip(p / (1 << (fine + k)) - 0.5, 0.0, side - 1.0) for p in (x, y))
        i, j = (np.minimum(p.astype(np.int64), max(side - 2, 0)) for p in (u, v))
        a, b = u - i, v - j
        for corner in range(4):
            di, dj = corner % 2, corner // 2
            column, row = np.minimum(i + di, side - 1), np.minimum(j + dj, side - 1)
            taps[:, 4 * k + corner] = starts[fine + k] + row * side + column
            shares[:, 4 * k + corner] = level_share * (a if di else 1.0 - a) * (b if dj else 1.0 - b)
    return taps, shares
