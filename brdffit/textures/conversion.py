"""From a texture set to the program's own terms: one map at a time is read, decoded, brought to size and let go."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.methods import one_of
from brdffit.roughness import DEFAULT_MIN_ROUGHNESS, log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf
from brdffit.textures import encoding
from brdffit.textures.noise_floor import flat_as_flat, subtract_noise_floor
from brdffit.textures.orientation import scale_from_slopes
from brdffit.textures.texture_set import Map, TextureSet

#: Reflectance of a dielectric at normal incidence (index of refraction 1.5).
DIELECTRIC_F0 = 0.04
#: What stands for a map that is missing.
DEFAULT_BASE_COLOR, DEFAULT_ROUGHNESS = 0.5, 0.5
#: Height between the values 0 and 1 of a height map nobody gave a scale for, as a share of the texture's longer side:
#: about the median of the real sets whose normal maps tell it.
DEFAULT_HEIGHT_SHARE = 0.02
#: Roles that a set can do without: what they would have added is left out.
UNREAD = ("normal", "height", "ao")
#: The mean of a normal map's red and green where 0.5 was decoded from sRGB, or encoded to it.
_SRGB_MEANS = {"decoded as": 0.2140, "encoded as": 0.7354}


def to_svbrdf(
    texture_set: TextureSet, *, min_roughness: float = DEFAULT_MIN_ROUGHNESS, model: str = "ggx",
    without: Collection[str] = (),
) -> Svbrdf:  # fmt: skip
    """Decode a texture set; what was assumed, mended or clamped is added to ``texture_set.notes``.

    Args:
        texture_set: of ``read_texture_set``.
        min_roughness: perceptual roughness floor, in (0, 1].
        model: name of the lobe model the set was authored for.
        without: roles that are not read, of ``UNREAD``: "normal" (all normals are z, and there is no height), "height"
            or "ao".

    Returns:
        The SVBRDF at the size of the largest map, read or not; the height, if any, in texels.

    Raises:
        InputError: for a map that cannot be read or is not what its role says.
        UnknownNameError: for a role that cannot be done without.
    """
    unread = unread_roles(texture_set, without)
    if not 0.0 < min_roughness <= 1.0:
        raise InputError(f"The roughness floor is {min_roughness}, expected a perceptual roughness in (0, 1].")
    if unread:
        texture_set.note(f"Maps that were not read, because nothing needs them: {', '.join(unread)}.")
    normal, height = _normal_and_height(texture_set, unread)
    roughness = _roughness(texture_set, min_roughness)
    specular, diffuse = _colours(texture_set)
    occlusion = None if "ao" in unread else scalar_map(texture_set, "ao")
    if occlusion is not None:
        strength = float(texture_set.factors.get("occlusion", 1.0))
        occlusion = np.clip(1.0 + strength * (occlusion - 1.0), 0.0, 1.0)
    size = texture_set.size
    return Svbrdf(
        normal=_full(normal, size),
        log_roughness=_full(log_tensor_from_perceptual(roughness), size),
        specular=_full(specular, size),
        diffuse=_full(diffuse, size),
        model=model,
        wrap=texture_set.wrap,
        occlusion=None if occlusion is None else _full(occlusion, size),
        height=None if height is None else _full(height, size),
    )


def unread_roles(texture_set: TextureSet, without: Collection[str]) -> list[str]:
    """The roles of a set that are not read under this ``without``; height goes with the normals.

    Raises:
        UnknownNameError: for a role that cannot be done without.
    """
    for role in without:
        one_of("role to do without", role, UNREAD)
    left = {*without, *(["height"] if "normal" in without else [])}
    return [role for role in texture_set.maps if role in left]


def decode_normals(texture_set: TextureSet) -> NDArray:
    """Vectors (h, w, 3) of the normal map at its own size: OpenGL, not of unit length yet; without noise if asked.

    Raises:
        InputError: when the map cannot be read or is no normal map.
    """
    named = texture_set.maps["normal"]
    pixels, noise = named.read()
    if pixels.shape[2] == 1:
        raise InputError(f"'{named.path}' has one channel, expected a normal map with two or three.")
    vectors = encoding.stored_vectors(pixels, named.info.is_float)
    # Two-channel PNGs are grey with alpha; block-compressed ones come back with a blue of zero or a constant.
    two_channel = pixels.shape[2] == 2 or float(np.ptp(vectors[:, :, 2])) == 0.0
    if two_channel and vectors.shape[2] > 2 and float(np.ptp(vectors, axis=(0, 1)).max()) == 0.0:
        two_channel = not 0.0 < float(vectors[0, 0, 2])  # a constant map keeps what it says
    _check_normals(named, pixels, vectors, two_channel)
    xy = flat_as_flat(vectors[:, :, :2], noise)
    if texture_set.denoise_normals:
        xy = subtract_noise_floor(xy, noise, texture_set.wrap)
    z = encoding.rebuild_z(xy) if two_channel else vectors[:, :, 2]
    if two_channel:
        texture_set.note(f"The normal map '{named.path.name}' has two channels: z is rebuilt from x and y.")
    xy = xy * np.float32(texture_set.factors.get("normal", 1.0))
    if texture_set.normal_y == "dx":
        xy[:, :, 1] *= -1.0
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
    mean = vectors.reshape(-1, vectors.shape[2]).mean(axis=0, dtype=np.float64)
    z = float(encoding.rebuild_z(vectors[:, :, :2]).mean()) if two_channel else float(mean[2])
    across = float(np.hypot(mean[0], mean[1]))
    all_zero = not two_channel and float(np.abs(vectors).max()) < encoding.ZERO_LENGTH
    if (z < 0.25 or across > z) and not all_zero:
        tilt = float(np.degrees(np.arctan2(across, z)))
        raise InputError(
            f"'{named.path}' is not a tangent-space normal map: its mean vector is ({mean[0]:.2f}, {mean[1]:.2f}, "
            f"{z:.2f}), {tilt:.0f} degrees from z, expected one near (0, 0, 1)."
        )


def _normal_and_height(texture_set: TextureSet, unread: Collection[str]) -> tuple[NDArray, NDArray | None]:
    maps = {role: each for role, each in texture_set.maps.items() if role not in unread}
    if not {"normal", "height"} & maps.keys():
        return np.array([[[0.0, 0.0, 1.0]]], np.float32), None
    named = maps.get("height")
    height = None if named is None else _values(texture_set, named)
    vectors = decode_normals(texture_set) if "normal" in maps else None
    if height is not None:
        height = np.float32(_height_scale(texture_set, height, vectors)) * height
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


def _height_scale(texture_set: TextureSet, height: NDArray, vectors: NDArray | None) -> float:
    """Texels (of the full size) between the height values 0 and 1: given, from the normal map's slopes, or a share."""
    if texture_set.height_scale is not None:
        return texture_set.height_scale
    default = DEFAULT_HEIGHT_SHARE * max(texture_set.size)
    if vectors is not None and vectors.shape[:2] == height.shape:
        scale = scale_from_slopes(height, vectors)
        if scale is not None:
            scale *= texture_set.size[0] / height.shape[0]
            texture_set.note(
                f"The height map spans {scale:.1f} texels, the scale at which it fits the normal map's slopes."
            )
            return scale
    texture_set.note(
        f"The height map is taken to span {default:.1f} texels ({DEFAULT_HEIGHT_SHARE:.0%} of the longer side); give "
        f"height-scale if it does not."
    )
    return default


def _roughness(texture_set: TextureSet, min_roughness: float) -> NDArray:
    factors = texture_set.factors
    roughness = scalar_map(texture_set, "roughness")
    if roughness is not None:
        roughness = roughness * np.float32(factors.get("roughness", 1.0))
    elif (gloss := scalar_map(texture_set, "gloss")) is not None:
        roughness = 1.0 - gloss * np.float32(factors.get("gloss", 1.0))
    else:
        value = float(factors.get("roughness", DEFAULT_ROUGHNESS))
        if "roughness" not in factors:
            texture_set.note(f"There is no roughness or gloss map: a perceptual roughness of {value} is assumed.")
        roughness = np.full((1, 1), value, dtype=np.float32)
    raised = int(np.count_nonzero(roughness < np.float32(min_roughness)))
    if raised:
        texture_set.note(f"The roughness floor of {min_roughness} raised {raised} of {roughness.size} texels.")
    return np.clip(roughness, np.float32(min_roughness), 1.0)


def _colours(texture_set: TextureSet) -> tuple[NDArray, NDArray]:
    """Linear specular and diffuse colours, (h, w, 3), of the metallic or of the specular workflow."""
    factors = texture_set.factors
    base = _colour(texture_set, "base_color")
    if base is None:
        base = np.full((1, 1, 3), 1.0 if "base_color" in factors else DEFAULT_BASE_COLOR, dtype=np.float32)
        if "base_color" not in factors:
            texture_set.note(f"There is no base colour map: a grey of {DEFAULT_BASE_COLOR} (linear) is assumed.")
    base = base * np.asarray(factors.get("base_color", 1.0), dtype=np.float32)
    metallic = scalar_map(texture_set, "metallic")
    if metallic is not None:
        metallic = metallic * np.float32(factors.get("metallic", 1.0))
    elif "metallic" in factors:
        metallic = np.full((1, 1), float(factors["metallic"]), dtype=np.float32)
    specular_factor = np.asarray(factors.get("specular", 1.0), dtype=np.float32)
    if metallic is None and ("specular" in texture_set.maps or "specular" in factors):
        specular = _colour(texture_set, "specular")
        return (np.ones((1, 1, 3), np.float32) if specular is None else specular) * specular_factor, base
    f0: NDArray | np.float32 = np.float32(DIELECTRIC_F0)
    if "specular" in texture_set.maps:
        # Beside a metallic map a specular map is the engines' scale of a dielectric: 0.5 is an F0 of 0.04.
        scale = scalar_map(texture_set, "specular")
        assert scale is not None
        f0 = (2.0 * DIELECTRIC_F0 * scale).astype(np.float32)[:, :, None]
        texture_set.note(
            "Beside a metallic map the specular map is read as the scale of a dielectric's F0 (0.08 at 1)."
        )
    if metallic is None:
        shape = np.broadcast_shapes(base.shape, np.shape(f0) or (1, 1, 1))
        return np.broadcast_to(f0, shape), base
    metallic = np.clip(metallic, 0.0, 1.0)[:, :, None]
    return f0 * (1.0 - metallic) + base * metallic, base * (1.0 - metallic)


def _colour(texture_set: TextureSet, role: str) -> NDArray | None:
    """Linear (H, W, 3) of a colour map at full size, or at one texel; integers are sRGB, floats are linear."""
    named = texture_set.maps.get(role)
    if named is None:
        return None
    pixels, _ = named.read()
    pixels = np.repeat(pixels[:, :, :1], 3, axis=2) if pixels.shape[2] < 3 else pixels[:, :, :3]
    linear = np.maximum(pixels, 0.0) if named.info.is_float else encoding.linear_from_srgb(pixels)
    return _enlarge(texture_set, linear)


def scalar_map(texture_set: TextureSet, role: str) -> NDArray | None:
    """(H, W) in [0, 1] of a map of one quantity at full size, or at one texel."""
    named = texture_set.maps.get(role)
    return None if named is None else _enlarge(texture_set, np.clip(_values(texture_set, named), 0.0, 1.0))


def _values(texture_set: TextureSet, named: Map) -> NDArray:
    pixels, _ = named.read()
    values, taken = named.quantity(pixels)
    if taken and not named.channel:
        names = {"R": "red", "G": "green", "B": "blue"}
        texture_set.note(f"The colours of '{named.path.name}' differ: its {named.role} is taken from {names[taken]}.")
    return values


def _enlarge(texture_set: TextureSet, array: NDArray) -> NDArray:
    # One texel is broadcast at the end, not enlarged before.
    return array if array.shape[:2] == (1, 1) else encoding.resample(array, texture_set.size, texture_set.wrap)


def _full(array: NDArray, size: tuple[int, int]) -> NDArray[np.float32]:
    return np.ascontiguousarray(np.broadcast_to(array, (*size, *array.shape[2:])), dtype=np.float32)
