"""Training crops of the method ``latent``: augmented patches of 32 x 32 texels and footprints in them.

Augmented as in the paper: factors of roughness, turned and stretched tensors, steeper and flatter normals, brighter
and darker colours, flips and quarter turns, and a binary mask of noise that puts two variants side by side, so that one
patch holds differences that no set has.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from brdffit.fitting.presets import get_quality
from brdffit.footprint import get_pixel_filter
from brdffit.halfangle.apparent_lobe import base_of, strata
from brdffit.learned.data import read_set
from brdffit.learned.latent import inputs_of, luminance_of
from brdffit.learned.tables import Table, tabulate
from brdffit.roughness import DEFAULT_MIN_ROUGHNESS
from brdffit.svbrdf import Svbrdf

SIDE = 32
#: Levels of a crop's pyramid, and its texels in all.
LEVELS = 6
TEXELS = sum((SIDE >> level) ** 2 for level in range(LEVELS))
#: Scales that a crop is judged at, and points a scale. Footprints lie within the crop: levels -0.5 to 5.
SCALES, POINTS = 12, 16
_LOWEST, _HIGHEST = -0.5, 5.0
#: Samples of a footprint along an axis, at most.
_MOST_SAMPLES = 24
_TAPS = 8


@dataclass(frozen=True)
class Crop:
    """One patch.

    Attributes:
        inputs: (32, 32, INPUTS) float32, before whitening.
        table: footprints at random points and scales.
        taps: (n, 8) int64, rows of the pyramid of all levels that trilinear filtering reads for each of them.
        shares: (n, 8) their weights.
    """

    inputs: NDArray
    table: Table
    taps: NDArray
    shares: NDArray


class Source:
    """A set as the crops read it: normals, log tensors and luminance."""

    def __init__(self, path: str | Path) -> None:
        svbrdf = read_set(path)
        self.normal, self.log_roughness = svbrdf.normal, svbrdf.log_roughness
        self.luminance = luminance_of(svbrdf.specular)

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
    """One of the eight symmetries of the square. Rows run down, y runs up."""
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
    return normal, within(tensor), np.minimum(luminance * math.exp(rng.uniform(-1.2, 1.2)), 1.0)


def within(tensor: NDArray) -> NDArray:
    """Log tensors (..., 3) with eigenvalues within the roughness floor and 1."""
    low = 4.0 * math.log(DEFAULT_MIN_ROUGHNESS)
    mean, half, off = 0.5 * (tensor[..., 0] + tensor[..., 1]), 0.5 * (tensor[..., 0] - tensor[..., 1]), tensor[..., 2]
    radius = np.hypot(half, off)
    major, minor = np.clip(mean + radius, low, 0.0), np.clip(mean - radius, low, 0.0)
    mean, shrink = 0.5 * (major + minor), 0.5 * (major - minor) / np.where(radius > 0.0, radius, 1.0)
    return np.stack([mean + shrink * half, mean - shrink * half, shrink * off], axis=-1).astype(np.float32)


def noise_mask(rng: np.random.Generator) -> NDArray:
    """(32, 32) bool: where noise of several octaves, random numbers on grids, is above a random level."""
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


def make_crop(sources: Sequence[Source], rng: np.random.Generator) -> Crop:
    """A patch of a random set, half of them with another behind a mask, and footprints in it."""
    patch = sources[int(rng.integers(len(sources)))].patch(rng)
    if rng.random() < 0.5:
        other, mask = sources[int(rng.integers(len(sources)))].patch(rng), noise_mask(rng)
        patch = tuple(
            np.where(mask[..., None] if one.ndim == 3 else mask, one, two)
            for one, two in zip(patch, other, strict=True)
        )  # type: ignore[assignment]
    normal, tensor, luminance = (np.ascontiguousarray(part, np.float32) for part in patch)
    return crop_of(normal, tensor, luminance, rng)


def crop_of(normal: NDArray, tensor: NDArray, luminance: NDArray, rng: np.random.Generator) -> Crop:
    """A crop of these maps with footprints at random scales and points."""
    grey = np.repeat(luminance[..., None], 3, axis=2)
    base = base_of(Svbrdf(normal, tensor, grey, np.zeros_like(grey), wrap="clamp"))
    quality, pixel_filter = get_quality("draft"), get_pixel_filter("box")
    tables, taps, shares = [], [], []
    for k in range(SCALES):
        level = _LOWEST + (_HIGHEST - _LOWEST) * (k + rng.random()) / SCALES
        scale = 2.0**level
        per_texel = 2 * max(1, math.ceil(0.5 * quality.least / max(scale, 1.0)))
        size = (SIDE / scale, SIDE / scale)
        rule = strata(pixel_filter, (SIDE, SIDE), size, per_texel, _MOST_SAMPLES, 0, quality.merge)  # type: ignore[arg-type]
        half = 0.5 * scale
        x, y = (rng.uniform(half, SIDE - half, POINTS) for _ in range(2))
        table = tabulate(base, rule, x, y, 4 * rule.samples + quality.room + 1)
        if len(table) < POINTS:  # a black patch: nothing to learn from
            continue
        tables.append(table)
        here, weights = trilinear(x, y, level)
        taps.append(here)
        shares.append(weights)
    if not tables:
        return crop_of(normal, tensor, np.full_like(luminance, 0.5), rng)
    return Crop(
        inputs_of(normal, tensor, luminance), Table.joined(tables), np.concatenate(taps), np.concatenate(shares)
    )


def trilinear(x: NDArray, y: NDArray, level: float) -> tuple[NDArray, NDArray]:
    """Taps (n, 8) and weights of points in base texels, at a level of detail; borders are clamped."""
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
