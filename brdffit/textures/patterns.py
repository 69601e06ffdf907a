"""Building blocks of generators of procedural sets: their maps, and tileable noise, scatter and steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Color = tuple[float, float, float]


@dataclass
class Maps:
    """The maps of a generator; None where the set has no such map. A map of one value may have one texel.

    Attributes:
        color: (H, W, 3) linear.
        normal: (H, W, 3) unit, OpenGL.
        roughness: (H, W) perceptual.
        metallic: (H, W).
        height: (H, W) in texture widths.
        opacity: (H, W) in [0, 1]; it goes into the alpha of the colours.
    """

    color: NDArray
    normal: NDArray | None
    roughness: NDArray
    metallic: NDArray | None = None
    height: NDArray | None = None
    opacity: NDArray | None = None


def frequencies(size: int) -> tuple[NDArray, NDArray]:
    """Absolute frequencies across and down, cycles a texture, of rfft2's half spectrum: (size, size // 2 + 1) each."""
    fx, fy = np.meshgrid(np.fft.rfftfreq(size, 1.0 / size), np.abs(np.fft.fftfreq(size, 1.0 / size)))
    return fx, fy


def noise(size: int, rng: np.random.Generator, spectrum: NDArray) -> NDArray:
    """Tileable noise of mean 0 and variance 1 with this amplitude spectrum."""
    transform = np.fft.rfft2(rng.standard_normal((size, size))) * spectrum
    transform[0, 0] = 0.0
    field = np.fft.irfft2(transform, (size, size))
    return field / field.std()


def grain(size: int, rng: np.random.Generator, cycles: float) -> NDArray:
    """Tileable noise of no more than so many cycles across the texture."""
    return noise(size, rng, np.exp(-0.5 * (np.hypot(*frequencies(size)) / cycles) ** 2))


def periodic(offset: NDArray) -> NDArray:
    """The nearest image of an offset on the unit circle, in [-0.5, 0.5)."""
    return (offset + 0.5) % 1.0 - 0.5


def scattered(rng: np.random.Generator, count: int) -> NDArray:
    """(count, 2) points on the unit torus, no two very close: the farthest of six candidates is taken each time."""
    points = rng.random((1, 2))
    while len(points) < count:
        candidates = rng.random((6, 2))
        offsets = periodic(candidates[:, None, :] - points[None, :, :])
        nearest = np.square(offsets).sum(axis=2).min(axis=1)
        points = np.concatenate([points, candidates[nearest.argmax()][None]])
    return points


def step(radius: NDArray, edge: float, size: int) -> NDArray:
    """0 inside of ``edge`` and 1 outside, with a linear ramp one texel wide; lengths are in texture widths."""
    return np.clip((radius - edge) * size + 0.5, 0.0, 1.0)


def unit_range(array: NDArray) -> NDArray:
    """``array`` scaled and moved to [0, 1]."""
    return (array - array.min()) / max(float(np.ptp(array)), 1e-12)
