"""Normals and heights: from the maps as stored to unit normals and a height in texels."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.textures import encoding
from brdffit.textures.frames import IDENTITY, turn_of
from brdffit.textures.noise_floor import flat_as_flat, subtract_noise_floor
from brdffit.textures.orientation import DECISIVE, contradiction, height_agreement, scale_from_slopes
from brdffit.textures.texture_set import Map, TextureSet

#: Height range of a height map without a given scale, as a share of the texture's longer side: about the median of the
#: real sets whose normal maps tell it.
DEFAULT_HEIGHT_SHARE = 0.02
#: Largest component of a stored normal: filters that sharpen exceed 1 a little.
_LARGEST = 2.0
#: Correlation from which the curl of a normal map is reported as contradicting its name.
_CONTRADICTS = 0.5
#: Sources of the normal's Y that measure nothing, as a sentence has them.
_SAID_BY = {"name": "as its name says", "convention": "as its set or its file's format has it", "given": "as asked"}
#: The mean of a normal map's red and green where 0.5 was decoded from sRGB, or encoded to it.
_SRGB_MEANS = {"decoded as": 0.2140, "encoded as": 0.7354}


def decode_normals(texture_set: TextureSet) -> NDArray:
    """Vectors (h, w, 3) of the normal map at its own size: OpenGL, not of unit length yet; without noise if asked.

    Raises:
        InputError: when the map cannot be read or is no normal map.
    """
    named = texture_set.maps["normal"]
    pixels, noise = named.read()
    if pixels.shape[2] == 1:
        raise InputError(f"'{named.path}' has one channel, expected a normal map with two or three.")
    vectors, how = named.vectors(pixels)
    two_channel = bool(how)
    _check_normals(named, pixels, vectors, two_channel)
    xy = flat_as_flat(vectors[:, :, :2], noise)
    if texture_set.denoise_normals:
        xy = subtract_noise_floor(xy, noise, texture_set.wrap)
    z = encoding.rebuild_z(xy) if two_channel else vectors[:, :, 2]
    if two_channel:
        texture_set.note(f"The normal map '{named.path.name}' {how}: z is rebuilt from x and y.")
    xy = xy * np.asarray(texture_set.factors.get("normal", 1.0), np.float32)
    if texture_set.normal_y == "dx":
        xy[:, :, 1] *= -1.0
    if named.frame != IDENTITY:
        xy = xy @ turn_of(named.frame).T.astype(np.float32)
    return np.concatenate([xy, z[:, :, None]], axis=2)


def moved_by_noise(texture_set: TextureSet) -> NDArray:
    """(h, w) angle in radians that ``denoise_normals`` moves each normal by, at the normal map's own size."""
    plain, _ = encoding.unit_normals(decode_normals(replace(texture_set, denoise_normals=False, notes=[])))
    quiet, _ = encoding.unit_normals(decode_normals(replace(texture_set, denoise_normals=True, notes=[])))
    return 2.0 * np.arcsin(np.clip(0.5 * np.sqrt(np.square(plain - quiet).sum(axis=2)), 0.0, 1.0))


def _check_normals(named: Map, pixels: NDArray, vectors: NDArray, two_channel: bool) -> None:
    """Refuse what is not a tangent-space normal map, by its mean."""
    red, green = (float(pixels[:, :, k].mean(dtype=np.float64)) for k in range(2))
    blue = 1.0 if two_channel else float(pixels[:, :, 2].mean(dtype=np.float64))
    for how, value in _SRGB_MEANS.items():
        if abs(red - value) < 0.04 and abs(green - value) < 0.04 and blue > 0.7:
            raise InputError(
                f"'{named.path}' looks like a normal map that was {how} sRGB (red and green have the means {red:.2f} "
                f"and {green:.2f}), expected linear data with means near 0.50."
            )
    largest = float(np.abs(vectors).max())
    if largest > _LARGEST:
        raise InputError(
            f"'{named.path}' holds numbers up to {float(pixels.max()):.4g}, expected normals in [-1, 1] or [0, 1]."
        )
    mean = vectors.reshape(-1, vectors.shape[2]).mean(axis=0, dtype=np.float64)
    z = float(encoding.rebuild_z(vectors[:, :, :2]).mean()) if two_channel else float(mean[2])
    across = float(np.hypot(mean[0], mean[1]))
    all_zero = not two_channel and largest < encoding.ZERO_LENGTH
    if (z < 0.25 or across > z) and not all_zero:
        tilt = float(np.degrees(np.arctan2(across, z)))
        raise InputError(
            f"'{named.path}' is not a tangent-space normal map: its mean vector is ({mean[0]:.2f}, {mean[1]:.2f}, "
            f"{z:.2f}), {tilt:.0f} degrees from z, expected one near (0, 0, 1)."
        )


def normal_and_height(texture_set: TextureSet, unread: Collection[str]) -> tuple[NDArray, NDArray | None]:
    """Unit normals (H, W, 3), of the height where there is no normal map, and the height (H, W) in texels, if any.

    Raises:
        InputError: as ``decode_normals``.
    """
    maps = {role: each for role, each in texture_set.maps.items() if role not in unread}
    if not {"normal", "height"} & maps.keys():
        return np.array([[[0.0, 0.0, 1.0]]], np.float32), None
    named = maps.get("height")
    height = None if named is None else texture_set.quantity(named)
    vectors = decode_normals(texture_set) if "normal" in maps else None
    if vectors is not None and texture_set.normal_y_source in _SAID_BY:
        against = contradiction(vectors)
        if against >= _CONTRADICTS:
            read = {"gl": "OpenGL (+Y)", "dx": "DirectX (-Y)"}[texture_set.normal_y]
            texture_set.note(
                f"'{maps['normal'].path.name}' is read as {read}, {_SAID_BY[texture_set.normal_y_source]}, but its "
                f"slopes' curl speaks against it (correlation {against:.2f}): check normal-y."
            )
    if height is not None and vectors is not None and vectors.shape[:2] == height.shape:
        across, _ = height_agreement(height, encoding.slopes_of_normals(vectors))
        if across <= -DECISIVE:
            height = float(height.max()) - height
            texture_set.note(
                f"The height map '{maps['height'].path.name}' is inverted, white is deep: along x its slopes are "
                f"opposite to those of the normal map (correlation {across:.2f}). It is turned over."
            )
    if height is not None:
        height = np.float32(height_scale(texture_set, height, vectors)) * height
    if vectors is None:
        assert height is not None
        # A height in texels of the full size, on a grid of its own: its texels may be larger.
        per_texel = np.float32(height.shape[0] / texture_set.size[0])
        gradient = encoding.height_gradient(height, texture_set.wrap) * per_texel
        vectors = encoding.normals_from_gradient(gradient)
        texture_set.note("There is no normal map: the normals are made from the slopes of the height map.")
        file = texture_set.maps["height"].path.name
    else:
        file = texture_set.maps["normal"].path.name
    normals, counts = encoding.unit_normals(vectors)
    total = normals.shape[0] * normals.shape[1]
    if counts["zero"]:
        texture_set.note(f"'{file}' has {counts['zero']} vectors of no length in {total} texels: they point along z.")
    if counts["horizon"]:
        texture_set.note(
            f"'{file}' has {counts['horizon']} normals at or below the horizon in {total} texels: "
            "they are lifted to it."
        )
    if normals.shape[:2] != texture_set.size and normals.shape[:2] != (1, 1):
        normals, _ = encoding.unit_normals(encoding.resample(normals, texture_set.size, texture_set.wrap))
    if height is not None:
        height = encoding.resample(height, texture_set.size, texture_set.wrap)
    return normals, height


def height_scale(texture_set: TextureSet, height: NDArray, vectors: NDArray | None) -> float:
    """Texels (of the full size) between the height values 0 and 1: given, from the normal map's slopes, or a share."""
    if texture_set.height_scale is not None:
        return texture_set.height_scale
    span = float(np.ptp(height))
    if span == 0.0:
        texture_set.note("The height map holds one value throughout: it says nothing.")
        return 1.0
    default = DEFAULT_HEIGHT_SHARE * max(texture_set.size) / (span or 1.0)
    if vectors is not None and vectors.shape[:2] == height.shape:
        scale = scale_from_slopes(height, vectors)
        if scale is not None:
            scale *= texture_set.size[0] / height.shape[0]
            texture_set.note(
                f"The height map spans {scale * span:.1f} texels, the scale at which it fits the normal map's slopes."
            )
            return scale
    values = f", whose values go from {float(height.min()):.4g} to {float(height.max()):.4g}," if span < 0.9 else ""
    values = values or (f", whose values span {span:.4g}," if span > 1.01 else "")
    texture_set.note(
        f"The height map{values} is taken to span {default * span:.1f} texels ({DEFAULT_HEIGHT_SHARE:.0%} of the "
        f"longer side); give height-scale, in texels between the values 0 and 1, if it does not."
    )
    return default
