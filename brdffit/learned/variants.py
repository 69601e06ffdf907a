"""Training variants with edges: a set whose surface is cut into plates with bevels, or bears studs.

Such footprints hold two populations of normals: a flat one that makes the highlight, and a steep one that makes any
covariance large. Plates, tiles and planks are full of them; few sets of the training are.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from brdffit.roughness import DEFAULT_MIN_ROUGHNESS, clipped_log
from brdffit.svbrdf import Svbrdf

#: Ranges of random variants, drawn evenly in the logarithm: slope of an edge, its share of a plate's or stud's side,
#: plates along an axis of the texture, factor of the set's own slopes, factor of its perceptual roughness.
_SLOPE, _WIDTH, _PLATES, _OWN, _ROUGHNESS = (0.15, 12.0), (0.01, 0.12), (2.0, 24.0), (0.05, 1.0), (0.3, 1.2)
#: Radius of a stud as a share of the texture, and the share of the texture that studs cover at most.
_RADIUS, _COVERED = (0.004, 0.05), 0.35
#: Ratio of the alphas of variants with stretched lobes, and the share of such variants.
_RATIO, _STRETCHED = (1.3, 6.0), 0.3
#: Share of variants without diffuse light, as of metals.
_BARE = 0.5


def varied(svbrdf: Svbrdf, roughness: float, steepness: float) -> Svbrdf:
    """An SVBRDF with perceptual roughness and slopes scaled; eigenvalues of the log tensor are clipped to the range."""
    if roughness == 1.0 and steepness == 1.0:
        return svbrdf
    normal = svbrdf.normal.copy()
    normal[..., :2] *= steepness
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    log_roughness = svbrdf.log_roughness + np.float32(4.0 * math.log(roughness)) * np.array([1, 1, 0], np.float32)
    return svbrdf.replace(normal=normal, log_roughness=clipped_log(log_roughness, DEFAULT_MIN_ROUGHNESS))


def with_edges(svbrdf: Svbrdf, rng: np.random.Generator) -> Svbrdf:
    """A random variant: plates, studs or both, over the set's own bumps; roughness scaled, some lobes stretched."""
    own = _between(rng, _OWN)
    slopes = -own * svbrdf.normal[..., :2] / np.maximum(svbrdf.normal[..., 2:], 0.05)
    kind = int(rng.integers(0, 3))
    if kind != 1:
        slopes = slopes + plates(svbrdf.size, rng)
    if kind != 0:
        slopes = slopes + studs(svbrdf.size, rng)
    normal = np.concatenate([-slopes, np.ones_like(slopes[..., :1])], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    made = varied(svbrdf, _between(rng, _ROUGHNESS), 1.0).replace(normal=normal.astype(np.float32))
    if rng.random() < _BARE:
        made = made.replace(diffuse=np.zeros_like(made.diffuse))
    return stretched(made, _between(rng, _RATIO)) if rng.random() < _STRETCHED else made


def _between(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    low, high = bounds
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def plates(size: tuple[int, int], rng: np.random.Generator) -> NDArray:
    """Slopes (h, w, 2) of bevels along the joints of a grid of plates, which may be turned; it tiles."""
    height, width = size
    y, x = np.mgrid[0:height, 0:width]
    count = max(2, round(_between(rng, _PLATES)))
    lean = int(rng.integers(-count, count + 1)) if rng.random() < 0.5 else 0
    waves = np.array([(count, lean), (-lean, max(1, round(count * _between(rng, (0.5, 2.0)))))], np.float64)
    edge, slope, round_off = _between(rng, _WIDTH), _between(rng, _SLOPE), float(rng.random() < 0.5)
    slopes, nearest = np.zeros((height, width, 2)), np.full((height, width), edge)
    for wave in waves:
        # The phase across one family of joints, 0 to 1 from joint to joint, and how far the nearest joint is.
        phase = (wave[0] * (x + 0.5) / width + wave[1] * (y + 0.5) / height) % 1.0
        distance = np.minimum(phase, 1.0 - phase)
        here = distance < nearest
        steep = np.where(phase < 0.5, slope, -slope) * (1.0 - round_off * distance / edge)
        slopes[here] = (steep[..., None] * wave / np.linalg.norm(wave))[here]
        nearest = np.minimum(nearest, distance)
    return slopes


def studs(size: tuple[int, int], rng: np.random.Generator) -> NDArray:
    """Slopes (h, w, 2) of round studs or dents at random places; it tiles."""
    height, width = size
    # At least two texels, so that a stud has sides.
    radius, slope = max(_between(rng, _RADIUS), 2.0 / min(size)), _between(rng, _SLOPE) * float(rng.choice([-1.0, 1.0]))
    count = max(1, min(400, round(rng.uniform(0.05, _COVERED) / (math.pi * radius * radius))))
    reach = max(2, math.ceil(radius * max(size)))
    offsets = np.arange(-reach, reach + 1)
    slopes = np.zeros((height, width, 2))
    for _ in range(count):
        row, column = int(rng.integers(0, height)), int(rng.integers(0, width))
        dx, dy = np.meshgrid(offsets / width, offsets / height)
        share = np.hypot(dx, dy) / radius
        # A cap whose slope grows from its top to its rim.
        cap = np.where(share < 1.0, -slope / radius, 0.0)
        part = np.ix_((row + offsets) % height, (column + offsets) % width)
        inside = share < 1.0
        here = slopes[part]
        here[inside] = np.stack([cap * dx, cap * dy], axis=2)[inside]
        slopes[part] = here
    return slopes


def stretched(svbrdf: Svbrdf, ratio: float, turns: int = 1) -> Svbrdf:
    """A variant whose lobes have alphas of this ratio, with the same determinant as far as the range of roughness
    allows. The direction of the wide axis turns ``turns`` times by 180 degrees along either axis of the texture."""
    height, width = svbrdf.size
    y, x = np.mgrid[0:height, 0:width]
    angle = math.pi * turns * ((x + 0.5) / width + (y + 0.5) / height)
    change = math.log(ratio) * np.stack([np.cos(2.0 * angle), -np.cos(2.0 * angle), np.sin(2.0 * angle)], axis=2)
    made = clipped_log(svbrdf.log_roughness + change, DEFAULT_MIN_ROUGHNESS)
    return svbrdf.replace(log_roughness=made.astype(np.float32))
