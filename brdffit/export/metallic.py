"""Specular and diffuse colours as base colour and metallic, and what those cannot hold as a specular colour.

Sources: glTF 2.0 (metallic-roughness), KHR_materials_specular (Khronos).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit.textures.conversion import DIELECTRIC_F0

#: Largest specular colour: F0 is 1 then.
MOST_TINT = 1.0 / DIELECTRIC_F0
#: Share of the dielectric below which its colour is left as it is: dividing by the share would amplify noise.
_LEAST_SHARE = 0.1


def base_color_and_metallic(specular: NDArray, diffuse: NDArray) -> tuple[NDArray, NDArray]:
    """Base colour (..., 3) and metallic (...) of specular and diffuse colours (..., 3), all linear, in [0, 1].

    The model is, per channel, s = 0.04 (1-m) + base m and d = base (1-m).  With q = 1-m and base = d/q:
    0.04 q^2 - (s + d) q + d = 0.  It is linear in s and d, so it holds for the means over the channels too, and one q
    serves all three.  Where s < 0.04 both roots may lie in [0, 1] (a dark metal looks like a dark dielectric): the one
    that fits the channels better is taken, the dielectric when they tie.  Then base is the least-squares answer of both
    equations, (d q + (s - 0.04 q) m) / (q^2 + m^2), whose denominator is at least 1/2: nothing is divided by zero for
    black or noisy colours, and colours of the model itself come back as they were.
    """
    s = specular.mean(axis=-1, dtype=np.float64)
    d = diffuse.mean(axis=-1, dtype=np.float64)
    total = s + d
    root = np.sqrt(np.maximum(np.square(total) - 4.0 * DIELECTRIC_F0 * d, 0.0))
    # The smaller root in the form without cancellation.
    metal = np.clip(2.0 * d / np.maximum(total + root, np.finfo(np.float32).tiny), 0.0, 1.0)
    dielectric = (total + root) / (2.0 * DIELECTRIC_F0)
    q = metal
    # The larger root is a share, at most 1, only for dark colours; 5% more admits those that noise has pushed out.
    dark = dielectric <= 1.05
    if dark.any():
        tie = 1e-4  # of reflectance: well below one code of an 8-bit picture
        other = np.minimum(dielectric[dark], 1.0)
        misfits = [_misfit(specular[dark], diffuse[dark], share) for share in (other, metal[dark])]
        q[dark] = np.where(misfits[0] <= misfits[1] + tie * tie, other, metal[dark])
    return np.clip(_base_color(specular, diffuse, q), 0.0, 1.0), (1.0 - q).astype(np.float32)


def _base_color(specular: NDArray, diffuse: NDArray, q: NDArray) -> NDArray:
    q = q[..., None].astype(np.float32)
    m = 1.0 - q
    return (diffuse * q + (specular - DIELECTRIC_F0 * q) * m) / (q * q + m * m)


def _misfit(specular: NDArray, diffuse: NDArray, q: NDArray) -> NDArray:
    base = np.clip(_base_color(specular, diffuse, q), 0.0, 1.0)
    q = q[..., None].astype(np.float32)
    of_specular = DIELECTRIC_F0 * q + base * (1.0 - q) - specular
    return (np.square(of_specular) + np.square(base * q - diffuse)).sum(axis=-1)


def reflectance(base: NDArray, metallic: NDArray, tint: NDArray | float = 1.0) -> NDArray:
    """Specular colour (..., 3) of a base colour (..., 3), metallic (...) and specular colour of the dielectric."""
    m = metallic[..., None]
    return DIELECTRIC_F0 * np.asarray(tint) * (1.0 - m) + base * m


def tinted(specular: NDArray, diffuse: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Base colour (..., 3), metallic (...) and specular colour (..., 3) that give both colours back.

    With q = 1 - m: base = d / q, and the dielectric's F0 = (s - base m) / q is 0.04 times the specular colour, which
    KHR_materials_specular lets be any up to MOST_TINT. The metallic is that of ``base_color_and_metallic``, or less: so
    that base is at most 1 (m <= 1 - d) and F0 at least 0 (m / q <= s / d) in every channel. Where q is small, the base
    colour is as there, and the specular colour 1.
    """
    base, metallic = base_color_and_metallic(specular, diffuse)
    ratio = (specular / np.maximum(diffuse, 1e-6)).min(axis=-1)
    most = np.minimum(ratio / (1.0 + ratio), 1.0 - diffuse.max(axis=-1))
    lowered = np.minimum(metallic, np.maximum(most, 0.0))
    some = 1.0 - lowered >= _LEAST_SHARE
    metallic = np.where(some, lowered, metallic)
    m = metallic[..., None]
    share = np.where(some[..., None], 1.0 - m, 1.0)
    found = np.where(some[..., None], np.clip(diffuse / share, 0.0, 1.0), base)
    tint = np.clip((specular - found * m) / (DIELECTRIC_F0 * share), 0.0, MOST_TINT)
    return (
        found.astype(np.float32), metallic.astype(np.float32),
        np.where(some[..., None], tint, 1.0).astype(np.float32),
    )  # fmt: skip
