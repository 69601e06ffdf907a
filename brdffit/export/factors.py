"""Factors of a glTF material by which its pictures are divided, so that 8 bits are spent on what a set has.

A flat set's normals use a few codes of 255 and a smooth one's roughness half of them; but glTF multiplies what it
reads: the x and y of a normal by normalTexture.scale (then it is brought to unit length), roughness by roughnessFactor,
the strength of an anisotropic lobe by anisotropyStrength. With the largest value of the pyramid as the factor the codes
cover what there is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from brdffit.export.metallic import base_color_and_metallic, reflectance, tinted
from brdffit.roughness import eigenvalues_of_log
from brdffit.svbrdf import Svbrdf

#: Texels of a level that are sampled, for the normals' scale and for the error of F0.
_TEXELS = 4096
#: Scales that are tried: powers of the square root of 2.
_SMALLEST_EXPONENT = -12
#: How much larger than the best for codes a scale is: with smaller ones z varies too, and blocks have one channel more
#: to follow. Measured with UASTC on levels of brushed metal: 0.19 degrees against 0.21 at the best for codes.
_FOR_BLOCKS = 4.0
#: Mean error of F0 over a level above which a specular colour is stored: a tenth of a dielectric's F0.
_MISSING = 0.004


@dataclass(frozen=True)
class Factors:
    """What a material multiplies the values of its pictures by; all are 1 where it does not.

    Attributes:
        normal: of x and y of normals.
        roughness: of perceptual roughness.
        strength: of the strength of KHR_materials_anisotropy.
        specular: of the specular colour of KHR_materials_specular; None where base colour and metallic say all.
    """

    normal: float = 1.0
    roughness: float = 1.0
    strength: float = 1.0
    specular: float | None = None


def factors_of(levels: Sequence[Svbrdf]) -> Factors:
    """Factors that make the most of 8 bits, rounded to four digits (upwards where a value must not exceed them)."""
    roughness = max(math.sqrt(float(_alphas(level)[1].max())) for level in levels)
    return Factors(
        round(_normal_scale(levels), 4), _rounded_up(roughness), largest_strength(levels), _specular_factor(levels)
    )


def largest_strength(levels: Sequence[Svbrdf]) -> float:
    """Largest strength of KHR_materials_anisotropy, rounded up to four digits; 1 where there is none."""
    return _rounded_up(max(float(gltf_strength_from_alphas(*_alphas(level)).max()) for level in levels))


def _alphas(level: Svbrdf) -> tuple[NDArray, NDArray]:
    """The larger and the smaller alpha (h, w), at most 1."""
    major, minor = (np.sqrt(np.minimum(each, 1.0)) for each in eigenvalues_of_log(level.log_roughness))
    return major, minor


def _specular_factor(levels: Sequence[Svbrdf]) -> float | None:
    """Largest specular colour; None where base colour and metallic give the colours of every level back."""
    if not any(_lacks_specular(level) for level in levels):
        return None
    largest = max(float(tinted(level.specular, level.diffuse)[2].max()) for level in levels)
    return max(math.ceil(largest * 1e4) / 1e4, 1e-4)


def _lacks_specular(level: Svbrdf) -> bool:
    """Whether F0 is lost in base colour and metallic, in the mean of some texels."""
    specular, diffuse = level.specular.reshape(-1, 3), level.diffuse.reshape(-1, 3)
    if len(specular) > _TEXELS:
        some = np.random.default_rng(0).choice(len(specular), _TEXELS, replace=False)
        specular, diffuse = specular[some], diffuse[some]
    base, metallic = base_color_and_metallic(specular, diffuse)
    return float(np.abs(reflectance(base, metallic) - specular).max(axis=-1).mean()) > _MISSING


def _normal_scale(levels: Sequence[Svbrdf]) -> float:
    """_FOR_BLOCKS times the scale with the smallest mean square of angles between normals and codes, at most 1.

    A normal with slope t = |xy| / z is stored as (xy / s, z), brought to unit length: its z is 1 / sqrt(1 + (t / s)^2).
    An error d of each component there changes the slope by s d (1 + (t / s)^2) along it and s d sqrt(1 + (t / s)^2)
    across, and an angle by that over 1 + t^2 and over sqrt(1 + t^2).
    """
    random = np.random.default_rng(0)
    found = []
    for level in levels:
        normal = level.normal.reshape(-1, 3)
        if len(normal) > _TEXELS:
            normal = normal[random.choice(len(normal), _TEXELS, replace=False)]
        z = np.maximum(normal[:, 2].astype(np.float64), 1e-2)
        found.append(1.0 / np.square(z) - 1.0)
    scales = 2.0 ** (0.5 * np.arange(_SMALLEST_EXPONENT, 1))
    errors = [sum(float(_squared_angle(squared, scale).mean()) for squared in found) for scale in scales]
    return min(_FOR_BLOCKS * float(scales[int(np.argmin(errors))]), 1.0)


def _squared_angle(squared_slope: NDArray, scale: float) -> NDArray:
    """Mean square of the angle, in units of d, of slopes whose squares are given."""
    stretched = 1.0 + squared_slope / scale**2
    return scale**2 * (np.square(stretched / (1.0 + squared_slope)) + stretched / (1.0 + squared_slope))


def _rounded_up(value: float) -> float:
    """At most 1; nothing to divide by is 1."""
    return min(math.ceil(value * 1e4) / 1e4, 1.0) or 1.0


def gltf_strength_from_alphas(major: NDArray, minor: NDArray) -> NDArray:
    """Strength s of KHR_materials_anisotropy of the two alphas (...).

    Its alpha_t = mix(alpha, 1, s^2) = alpha + (1 - alpha) s^2 with alpha = alpha_b, so
    s^2 = (alpha_t - alpha_b) / (1 - alpha_b).  An alpha above 1 has no place in it and is held at 1.
    """
    major, minor = np.minimum(major, 1.0), np.minimum(minor, 1.0)
    return np.sqrt((major - minor) / np.maximum(1.0 - minor, np.finfo(np.float32).tiny))
