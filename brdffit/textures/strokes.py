"""Brush strokes as a height map fine enough to show bristles, which a bake from a deeper level turns into roughness."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from brdffit.textures.patterns import Color, Maps, periodic, scattered

#: Samples of a stroke's profile across a bristle.
_FINE = 8


class BrushStrokes(msgspec.Struct, forbid_unknown_fields=True):
    """Strokes of a brush along arcs, each over those before it; bristles leave grooves along it.

    ``width``, ``length`` and ``bristle`` (the distance of grooves) are in texture widths, ``groove`` (their rms height)
    in bristles, ``thickness`` (of the paint) in stroke widths; ``turn`` is how far strokes turn about x, in radians.
    """

    color: Color
    roughness: float
    metallic: float
    count: int
    width: tuple[float, float]
    length: tuple[float, float]
    bristle: float
    groove: float
    thickness: float
    turn: float

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        bristle = max(self.bristle, 3.0 / size)
        height = np.zeros((size, size), np.float32)
        for x0, y0 in scattered(rng, self.count):
            half, length = 0.5 * rng.uniform(*self.width), rng.uniform(*self.length)
            direction, bend = self.turn * rng.standard_normal(), rng.uniform(-1.0, 1.0) / length
            profile, ripple = self._profile(half, bristle, rng), rng.uniform(0.0, 2.0 * np.pi, 2)
            reach = 0.5 * length + half
            wide, high = (reach * abs(f(direction)) + (0.13 * length + half) for f in (np.cos, np.sin))
            columns, rows = (_near(centre, extent, size) for centre, extent in ((x0, wide), (y0, high)))
            x = periodic((columns + 0.5) / size - x0).astype(np.float32)[None, :]
            y = periodic((rows + 0.5) / size - y0).astype(np.float32)[:, None]
            along = np.float32(np.cos(direction)) * x + np.float32(np.sin(direction)) * y
            across = np.float32(np.cos(direction)) * y - np.float32(np.sin(direction)) * x
            across -= np.float32(0.5 * bend) * along * along
            # Bristles wander a little as the hand does.
            across += np.float32(0.4 * bristle) * np.sin(np.float32(9.0 / length) * along + np.float32(ripple[0]))
            ends = 0.5 * length + 0.3 * half * np.sin(across * np.float32(40.0 / half) + np.float32(ripple[1]))
            inside = (np.abs(across) < half) & (np.abs(along) < ends)
            t, s = across[inside] / half, np.minimum((ends - np.abs(along))[inside] / half, 1.0)
            # Paint thins out to the borders and to the ends, and the grooves in it with it.
            body = np.minimum(4.0 * (1.0 - np.abs(t)), 1.0) * s
            place = (t + 1.0) * (0.5 * (len(profile) - 1))
            grooves = np.interp(place, np.arange(len(profile)), profile).astype(np.float32)
            paint = body * (2.0 * half * self.thickness + self.groove * bristle * grooves)
            where = np.ix_(rows, columns)
            patch = height[where]
            patch[inside] = np.where(body > 0.25, 0.0, patch[inside]) * (1.0 - body) + paint
            height[where] = patch
        one = np.ones((1, 1))
        return Maps(
            color=np.array([[self.color]]), normal=None, roughness=self.roughness * one, metallic=self.metallic * one,
            height=height,
        )  # fmt: skip

    def _profile(self, half: float, bristle: float, rng: np.random.Generator) -> NDArray:
        """Height across a stroke at _FINE samples a bristle, variance 1: noise about as wide as bristles are."""
        count = max(round(2.0 * half / bristle * _FINE), 2 * _FINE)
        frequency = np.fft.rfftfreq(count, 1.0 / _FINE)
        transform = np.fft.rfft(rng.standard_normal(count)) * np.exp(-(((frequency - 1.0) / 0.6) ** 2))
        profile = np.fft.irfft(transform, count)
        return profile / max(float(profile.std()), 1e-12)


def _near(centre: float, extent: float, size: int) -> NDArray:
    """Indices of the texels of a periodic axis within ``extent`` of ``centre``, each once."""
    if extent >= 0.5:
        return np.arange(size)
    first, last = (int(np.floor((centre + side * extent) * size)) for side in (-1, 1))
    return np.arange(first, min(last, first + size - 1) + 1) % size
