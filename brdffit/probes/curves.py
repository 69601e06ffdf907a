"""Roughness curves: the roughness that each level of a probe is filtered at, and the level that a shader looks up.

Levels are numbered from 0 (the sharpest); roughness is perceptual, alpha = roughness^2 (``brdffit.roughness``).
Filtering, ``compare --through-probe``, scenes and all manifests take their curves from here. Sources: the engines'
shaders.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.roughness import (
    alpha_from_perceptual,
    alpha_squared_from_perceptual,
    exponent_from_alpha_squared,
    perceptual_from_alpha,
    perceptual_from_alpha_squared,
)


@dataclass(frozen=True)
class Curve:
    """The relation between level and roughness of one engine.

    Attributes:
        name: as on the command line.
        levels: number of levels.
        roughness: function from level (float array in [0, levels - 1]) to perceptual roughness in [0, 1].
        level: its inverse, from perceptual roughness to level.
        formula: the shader's line for ``level``; r is roughness.
    """

    name: str
    levels: int
    roughness: Callable[[NDArray], NDArray]
    level: Callable[[NDArray], NDArray]
    formula: str

    def alphas(self) -> list[float]:
        """alpha of each level."""
        return alpha_from_perceptual(self.roughness(np.arange(self.levels, dtype=np.float64))).tolist()


def _parabola(name: str, a: float, formula: str) -> Callable[[int, int], Curve]:
    """lod = last r (a - (a - 1) r): the larger a is, from 1 to 2, the more of the levels sharp lobes get."""

    def curve(levels: int, size: int) -> Curve:
        last = max(levels - 1, 1)

        def roughness(level: NDArray) -> NDArray:
            x = level / last
            return 2.0 * x / (a + np.sqrt(np.maximum(a * a - 4.0 * (a - 1.0) * x, 0.0)))

        return Curve(name, levels, roughness, lambda r: last * r * (a - (a - 1.0) * r), f"lod = {last} * {formula}")

    return curve


def _unreal(levels: int, size: int) -> Curve:
    """Unreal: lod = n - 2 + 1.2 log2 r, n the levels of the full chain; roughness is clamped to 1 beyond n - 2."""
    full = int(math.log2(size)) + 1
    return Curve(
        "unreal",
        levels,
        lambda k: np.minimum(np.exp2((k - (full - 2)) / 1.2), 1.0),
        lambda r: full - 2 + 1.2 * np.log2(np.maximum(r, 1e-4)),
        f"lod = {full - 2} + 1.2 * log2(r)",
    )


def _babylon(levels: int, size: int) -> Curve:
    """Babylon: lod = 0.8 log2(size alpha), with its lodGenerationScale of 0.8."""
    return Curve(
        "babylon",
        levels,
        lambda k: np.minimum(perceptual_from_alpha(np.exp2(k / 0.8) / size), 1.0),
        lambda r: 0.8 * np.log2(np.maximum(size * alpha_from_perceptual(r), 1e-6)),
        f"lod = 0.8 * log2({size} * r^2)",
    )


def _activision(levels: int, size: int) -> Curve:
    """Activision: gloss = 1 - lod/last, alpha^2 = 2 / (1 + 2^(18 gloss)).

    With the seven levels of Manson and Sloan, alpha grows by about 2^1.5 from level to level.
    """
    last = max(levels - 1, 1)

    def roughness(level: NDArray) -> NDArray:
        return perceptual_from_alpha_squared(2.0 / (1.0 + np.exp2(18.0 * (1.0 - level / last))))

    def level(r: NDArray) -> NDArray:
        exponent = exponent_from_alpha_squared(alpha_squared_from_perceptual(np.maximum(r, 1e-4)))
        return last - np.log2(np.maximum(exponent + 1.0, 1.0)) * last / 18.0

    return Curve("activision", levels, roughness, level, f"lod = {last} - log2(2 / r^4 - 1) * {last} / 18")


CURVES: dict[str, Callable[[int, int], Curve]] = {
    "linear": _parabola("linear", 1.0, "r"),
    "quadratic": _parabola("quadratic", 2.0, "r * (2 - r)"),  # Filament, Ogre, three.js
    "activision": _activision,
    "babylon": _babylon,
    "unity": _parabola("unity", 1.7, "r * (1.7 - 0.7 * r)"),
    "unreal": _unreal,
}


def get_curve(name: str, levels: int, size: int) -> Curve:
    """The curve of a name, or of a list of roughness values "0,0.1,0.4,1", for a cube of ``size`` with ``levels``.

    Raises:
        InputError: when the name is unknown, or a list has another length or does not rise strictly within [0, 1].
    """
    if name in CURVES:
        return CURVES[name](levels, size)
    try:
        values = np.array([float(part) for part in name.split(",")])
    except ValueError as error:
        known = ", ".join(CURVES)
        raise InputError(
            f"There is no roughness curve '{name}': known are {known}, or a list as 0,0.2,0.5,1."
        ) from error
    rises = len(values) > 1 and np.all(np.diff(values) > 0.0) and 0.0 <= values[0] and values[-1] <= 1.0
    if not rises or len(values) != levels:
        raise InputError(f"The curve '{name}' has {len(values)} values, expected {levels} that rise within 0 to 1.")
    steps = np.arange(levels, dtype=np.float64)
    return Curve(
        "custom",
        levels,
        lambda k: np.interp(k, steps, values),
        lambda r: np.interp(r, values, steps),
        "lod = piecewise linear through the roughness of the levels",
    )
