"""From a texture set to the program's own terms: one map at a time is read, decoded, brought to size and let go."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import decode_srgb
from brdffit.errors import InputError
from brdffit.methods import one_of
from brdffit.roughness import DEFAULT_MIN_ROUGHNESS, log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf
from brdffit.textures import encoding
from brdffit.textures.coverage import covered
from brdffit.textures.relief import normal_and_height
from brdffit.textures.texture_set import TextureSet

#: Reflectance of a dielectric at normal incidence (index of refraction 1.5).
DIELECTRIC_F0 = 0.04
#: Linear base colour and perceptual roughness in place of missing maps.
DEFAULT_BASE_COLOR, DEFAULT_ROUGHNESS = 0.5, 0.5
#: How far a quantity may lie outside of [0, 1] without a note, by the rounding of half floats and filters.
_BEYOND = 0.01
#: Roles whose maps may be left unread.
UNREAD = ("normal", "height", "ao")


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
    normal, height = normal_and_height(texture_set, unread)
    roughness = _roughness(texture_set, min_roughness)
    specular, diffuse = _colours(texture_set)
    occlusion = None if "ao" in unread else scalar_map(texture_set, "ao")
    if occlusion is not None:
        strength = float(texture_set.factors.get("occlusion", 1.0))
        occlusion = np.clip(1.0 + strength * (occlusion - 1.0), 0.0, 1.0)
    size = texture_set.size
    svbrdf = Svbrdf(
        normal=_full(normal, size),
        log_roughness=_full(_log_tensor(texture_set, roughness), size),
        specular=_full(specular, size),
        diffuse=_full(diffuse, size),
        model=model,
        wrap=texture_set.wrap,
        occlusion=None if occlusion is None else _full(occlusion, size),
        height=None if height is None else _full(height, size),
    )
    return covered(texture_set, svbrdf, scalar_map(texture_set, "opacity"), unread)


def unread_roles(texture_set: TextureSet, without: Collection[str]) -> list[str]:
    """The roles of a set that are not read under this ``without``; height goes with the normals.

    Raises:
        UnknownNameError: for a role that cannot be done without.
    """
    for role in without:
        one_of("role to do without", role, UNREAD)
    left = {*without, *(["height"] if "normal" in without else [])}
    return [role for role in texture_set.maps if role in left]


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


def _log_tensor(texture_set: TextureSet, roughness: NDArray) -> NDArray:
    """Log tensors (h, w, 3) of perceptual roughness and, where there is one, of KHR_materials_anisotropy.

    alpha_b = r^2 across the direction and alpha_t = mix(alpha_b, 1, strength^2) along it. The direction is that of red
    and green, y up, turned by the rotation; blue multiplies the strength. log S = l_b I + (l_t - l_b) t t'.
    """
    factors, named = texture_set.factors, texture_set.maps.get("anisotropy")
    strength = np.full((1, 1), float(factors.get("anisotropy", 1.0 if named else 0.0)), np.float32)
    if not strength.any():
        return log_tensor_from_perceptual(roughness)
    angle = np.full((1, 1), float(factors.get("anisotropy_rotation", 0.0)), np.float32)
    if named is not None:
        pixels, _ = named.read()
        if pixels.shape[2] < 3:
            raise InputError(
                f"'{named.path}' has {pixels.shape[2]} channels, expected three of an anisotropy map: a direction in "
                f"red and green, a strength in blue."
            )
        # The direction is an axis, without a sign: it is interpolated by its doubled angle.
        x, y = (2.0 * pixels[:, :, k] - 1.0 for k in (0, 1))
        doubled = _enlarge(texture_set, np.stack([x * x - y * y, 2.0 * x * y, pixels[:, :, 2]], axis=2))
        angle = angle + 0.5 * np.arctan2(doubled[:, :, 1], doubled[:, :, 0])
        strength = strength * doubled[:, :, 2]
    across = np.square(roughness)
    along = across + (1.0 - across) * np.square(np.clip(strength, 0.0, 1.0))
    log_across, more = 2.0 * np.log(across), 2.0 * (np.log(along) - np.log(across))
    cosine, sine = np.cos(angle), np.sin(angle)
    parts = (log_across + more * cosine * cosine, log_across + more * sine * sine, more * sine * cosine)
    return np.stack(np.broadcast_arrays(*parts), axis=2).astype(np.float32)


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
    has_specular = "specular" in texture_set.maps or "specular" in factors
    is_level = has_specular and (metallic is not None or _is_level(texture_set))
    if has_specular and not is_level:
        specular = _colour(texture_set, "specular")
        factor = np.asarray(factors.get("specular", 1.0), dtype=np.float32)
        return (np.ones((1, 1, 3), np.float32) if specular is None else specular) * factor, base
    f0 = _dielectric(texture_set, is_level)
    if metallic is None:
        shape = np.broadcast_shapes(base.shape, f0.shape)
        return np.broadcast_to(f0, shape), base
    metallic = np.clip(metallic, 0.0, 1.0)[:, :, None]
    return f0 * (1.0 - metallic) + base * metallic, base * (1.0 - metallic)


def _is_level(texture_set: TextureSet) -> bool:
    """Whether a specular map without a metallic one scales a dielectric's F0: it is grey and beside a roughness map."""
    named = texture_set.maps.get("specular")
    if named is None or named.channel or "roughness" not in texture_set.maps:
        return False
    pixels, _ = named.read()
    grey = pixels.shape[2] < 3 or encoding.obvious_channel(pixels, "specular")[1] == ""
    if grey:
        texture_set.note(f"The specular map '{named.path.name}' is grey and beside a roughness map: it is a level.")
    return grey


def _dielectric(texture_set: TextureSet, is_level: bool) -> NDArray:
    """F0 (h, w, 3 or 1) of the dielectric: by its index of refraction, scaled by a level and tinted by a colour."""
    factors = texture_set.factors
    f0 = np.full((1, 1, 1), float(factors.get("f0", DIELECTRIC_F0)), np.float32)
    if is_level and "specular" in texture_set.maps:
        # The engines' scale of a dielectric: 0.5 is an F0 of 0.04.
        scale = scalar_map(texture_set, "specular")
        assert scale is not None
        f0 = (2.0 * DIELECTRIC_F0 * scale).astype(np.float32)[:, :, None]
        texture_set.note("The specular map is read as the scale of a dielectric's F0: 0.08 at 1, 0.04 at 0.5.")
    if "specular_color" in factors or "specular_color" in texture_set.maps:
        colour = _colour(texture_set, "specular_color")
        f0 = f0 * np.asarray(factors.get("specular_color", 1.0), np.float32) * (1.0 if colour is None else colour)
        f0 = np.minimum(f0, 1.0)
    if "specular_level" in factors or "specular_level" in texture_set.maps:
        level = scalar_map(texture_set, "specular_level")
        f0 = f0 * np.float32(factors.get("specular_level", 1.0)) * (1.0 if level is None else level[:, :, None])
    return f0.astype(np.float32)


def _colour(texture_set: TextureSet, role: str) -> NDArray | None:
    """Linear (H, W, 3) of a colour map at full size, or at one texel; integers are sRGB, floats are linear."""
    named = texture_set.maps.get(role)
    if named is None:
        return None
    pixels, _ = named.read()
    if named.channel:
        pixels = named.quantity(pixels)[0][:, :, None]
    pixels = np.repeat(pixels[:, :, :1], 3, axis=2) if pixels.shape[2] < 3 else pixels[:, :, :3]
    is_linear = named.encoding == "linear" or (named.encoding == "" and named.info.is_float)
    linear = np.maximum(pixels, 0.0) if is_linear else decode_srgb(pixels)
    most = float(linear.max())
    if most > 1.0:
        texture_set.note(
            f"'{named.path.name}' reaches {most:.3g} as {role}, expected at most 1, all the light that falls on it: it "
            f"is read as it is."
        )
    return _enlarge(texture_set, linear)


def scalar_map(texture_set: TextureSet, role: str) -> NDArray | None:
    """(H, W) in [0, 1] of a map of one quantity at full size, or at one texel."""
    named = texture_set.maps.get(role)
    if named is None:
        return None
    values = texture_set.quantity(named)
    least, most = float(values.min()), float(values.max())
    if least < -_BEYOND or most > 1.0 + _BEYOND:
        texture_set.note(
            f"'{named.path.name}' goes from {least:.3g} to {most:.3g} as {role}, expected 0 to 1: it is cut there."
        )
    return _enlarge(texture_set, np.clip(values, 0.0, 1.0))


def _enlarge(texture_set: TextureSet, array: NDArray) -> NDArray:
    # One texel is broadcast at the end, not enlarged before.
    return array if array.shape[:2] == (1, 1) else encoding.resample(array, texture_set.size, texture_set.wrap)


def _full(array: NDArray, size: tuple[int, int]) -> NDArray[np.float32]:
    return np.ascontiguousarray(np.broadcast_to(array, (*size, *array.shape[2:])), dtype=np.float32)
