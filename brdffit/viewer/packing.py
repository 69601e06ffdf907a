"""Levels of an SVBRDF as text for a page: integers, differences along a row, planes of bytes, deflate, base64.

The browser undoes it (`unpack` in page.html) and uploads float and sRGB textures. Normals are stored in steps of
1/2047 (0.03 degrees), log Sigma in steps of 1/256 (0.2% of alpha), colours in 8-bit sRGB.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import encode_srgb
from brdffit.svbrdf import Svbrdf

#: Steps of normals and of log Sigma.
NORMAL_STEPS, LOG_STEPS = 2047.0, 256.0
#: Largest scale of a lobe that alpha holds beside a specular colour.
MOST_SPECULAR = 4.0


def pack_levels(levels: Sequence[Svbrdf]) -> dict[str, Any]:
    """Levels as the page reads them: their sizes, and the packed planes of all, one level after another."""
    integers, bytes_ = bytearray(), bytearray()
    for level in levels:
        a, b, c = np.moveaxis(level.log_roughness, -1, 0)
        fields = [level.normal[..., 0] * NORMAL_STEPS, level.normal[..., 1] * NORMAL_STEPS]
        fields += [0.5 * (a + b) * LOG_STEPS, 0.5 * (a - b) * LOG_STEPS, c * LOG_STEPS]
        for field in fields:
            integers += planes(np.clip(np.round(field), -32768, 32767).astype("<i2"))
        # The colour is divided by the scale as stored, which is what the page multiplies by.
        scale = np.ceil(255.0 / MOST_SPECULAR * np.clip(level.specular.max(axis=-1), 1.0, MOST_SPECULAR))
        top = scale[..., None] * (MOST_SPECULAR / 255.0)
        specular = np.round(255.0 * encode_srgb(np.clip(level.specular / top, 0.0, 1.0)))
        diffuse = np.round(255.0 * encode_srgb(np.clip(level.diffuse, 0.0, 1.0)))
        for plane in (*np.moveaxis(specular, -1, 0), scale, *np.moveaxis(diffuse, -1, 0)):
            bytes_ += planes(plane.astype(np.uint8))
    return {
        "sizes": [list(level.size) for level in levels],
        "shapes": _text(bytes(integers)),
        "colours": _text(bytes(bytes_)),
    }


def planes(values: NDArray) -> bytes:
    """Differences along each row of (H, W) integers, wrapped around, their bytes apart: the highest last."""
    differences = values.copy()
    differences[:, 1:] -= values[:, :-1]
    apart = np.ascontiguousarray(differences).view(np.uint8).reshape(-1, values.dtype.itemsize)
    return apart.T.tobytes()


def pack_environment(pixels: NDArray) -> dict[str, Any]:
    """An equirectangular picture (H, W, 3) of linear radiance, as RGBE-like bytes: colours over a shared exponent."""
    largest = np.maximum(pixels.max(axis=-1), 1e-9)
    exponent = np.clip(np.ceil(np.log2(largest)), -100, 100)
    colours = np.clip(np.round(pixels / np.exp2(exponent)[..., None] * 255.0), 0, 255)
    stacked = np.concatenate([colours, (exponent + 128)[..., None]], axis=-1).astype(np.uint8)
    return {"size": list(pixels.shape[:2]), "data": _text(b"".join(planes(stacked[..., k]) for k in range(4)))}


def _text(data: bytes) -> str:
    # Level 9 takes ten times as long for 4% less.
    return base64.b64encode(zlib.compress(data, 6)).decode("ascii")
