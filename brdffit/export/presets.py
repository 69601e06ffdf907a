"""What each engine expects of its pictures: roles, packing, roughness convention, normal Y, anisotropy.

A preset is a table; what a channel name means is said once, in `Channels`, where the formulas of each engine stand
beside their inverses. Sources: glTF 2.0 and KHR_materials_anisotropy (Khronos), the standard material of Godot 4,
Unity HDRP's mask map, Unreal's occlusion-roughness-metallic packing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from brdffit.methods import one_of
from brdffit.roughness import eigenvalues_of_log, perceptual_from_alpha_squared, perceptual_from_log_tensor
from brdffit.svbrdf import Svbrdf
from brdffit.textures.conversion import DIELECTRIC_F0

#: Godot's smallest ratio of the two alphas: aspect^2 = 1 - 0.9 anisotropy.
GODOT_RANGE = 0.9


@dataclass(frozen=True)
class Picture:
    """One file of a preset.

    Attributes:
        role: ending of the file's name in that engine.
        channels: names of properties of `Channels`, in the file's order.
        srgb: whether the (first three) channels are encoded as sRGB.
        needs: "anisotropy" or "occlusion": written only where the pyramid has it; "" always.
    """

    role: str
    channels: tuple[str, ...]
    srgb: bool = False
    needs: str = ""


@dataclass(frozen=True)
class Preset:
    """What an engine expects.

    Attributes:
        name: as on the command line.
        summary: one line.
        normal_y: "gl" (+Y up in the picture) or "dx".
        roughness: what the roughness channel holds, in words.
        lobe: "anisotropic", or "isotropic" where the engine has none (then the bake fits isotropic lobes).
        specular: "free", or "held" where the pictures have no room for a specular scale (metallic-roughness).
        pictures: the files.
    """

    name: str
    summary: str
    normal_y: str
    roughness: str
    lobe: str
    specular: str
    pictures: tuple[Picture, ...]


_NORMAL = ("normal_x", "normal_y", "normal_z")
_BASE_COLOR = ("base_color_r", "base_color_g", "base_color_b")

_PRESETS = (
    Preset(
        name="plain",
        summary="every parameter for itself: normal, roughness, anisotropy, specular and diffuse colour",
        normal_y="gl",
        roughness="perceptual roughness, alpha = r^2, of the isotropic lobe with the same determinant",
        lobe="anisotropic",
        specular="free",
        pictures=(
            Picture("normal", _NORMAL),
            Picture("roughness", ("roughness",)),
            Picture("anisotropy", ("direction_x", "direction_y", "ratio_strength"), needs="anisotropy"),
            Picture("specular", ("specular_r", "specular_g", "specular_b"), srgb=True),
            Picture("diffuse", ("diffuse_r", "diffuse_g", "diffuse_b"), srgb=True),
            Picture("occlusion", ("occlusion",), needs="occlusion"),
        ),
    ),
    Preset(
        name="gltf",
        summary="glTF 2.0 metallic-roughness with KHR_materials_anisotropy",
        normal_y="gl",
        roughness="perceptual roughness of the smaller alpha, alpha_b = r^2; alpha_t = mix(alpha_b, 1, strength^2)",
        lobe="anisotropic",
        specular="held",
        pictures=(
            Picture("baseColor", _BASE_COLOR, srgb=True),
            Picture("normal", _NORMAL),
            Picture("occlusionRoughnessMetallic", ("occlusion", "gltf_roughness", "metallic")),
            Picture("anisotropy", ("direction_x", "direction_y", "gltf_strength"), needs="anisotropy"),
        ),
    ),
    Preset(
        name="unreal",
        summary="Unreal: base colour, DirectX normal, occlusion-roughness-metallic; isotropic",
        normal_y="dx",
        roughness="perceptual roughness, alpha = r^2",
        lobe="isotropic",
        specular="held",
        pictures=(
            Picture("D", _BASE_COLOR, srgb=True),
            Picture("N", _NORMAL),
            Picture("ORM", ("occlusion", "roughness", "metallic")),
        ),
    ),
    Preset(
        name="unity",
        summary="Unity HDRP: base map, normal, mask map (metallic, occlusion, detail, smoothness); isotropic",
        normal_y="gl",
        roughness="smoothness = 1 - perceptual roughness, in alpha",
        lobe="isotropic",
        specular="held",
        pictures=(
            Picture("BaseMap", _BASE_COLOR, srgb=True),
            Picture("Normal", _NORMAL),
            Picture("MaskMap", ("metallic", "occlusion", "one", "smoothness")),
        ),
    ),
    Preset(
        name="godot",
        summary="Godot 4: albedo, normal, ORM, anisotropy flow map (set the material's anisotropy to 1)",
        normal_y="gl",
        roughness="perceptual roughness, alpha_x alpha_y = r^4; alpha_y / alpha_x = 1 - 0.9 anisotropy",
        lobe="anisotropic",
        specular="held",
        pictures=(
            Picture("albedo", _BASE_COLOR, srgb=True),
            Picture("normal", _NORMAL),
            Picture("orm", ("occlusion", "roughness", "metallic")),
            Picture("flowmap", ("direction_x", "direction_y", "zero", "godot_strength"), needs="anisotropy"),
        ),
    ),
)

PRESETS = {preset.name: preset for preset in _PRESETS}


def preset_names() -> list[str]:
    """Names of the presets, the default first."""
    return list(PRESETS)


def get_preset(name: str) -> Preset:
    """The preset of this name.

    Raises:
        UnknownNameError: with the nearest known name.
    """
    return PRESETS[one_of("preset", name, preset_names())]


class Channels:
    """What the channel names of a `Picture` mean for one SVBRDF; each property is (H, W) in [0, 1] before clipping.

    Args:
        svbrdf: one level, or a band of its rows.
        normal_y: "gl" or "dx".
        towards: (x, y) half plane in which anisotropy directions are given: a direction and its opposite are the same
            lobe, but a texture filter would average them to nothing.
    """

    def __init__(self, svbrdf: Svbrdf, normal_y: str = "gl", towards: tuple[float, float] = (1.0, 0.0)) -> None:
        self._svbrdf = svbrdf
        self._normal_y = normal_y
        self._towards = towards

    def __getitem__(self, name: str) -> NDArray:
        stem, _, component = name.rpartition("_")
        if component in ("r", "g", "b"):
            return getattr(self, stem)[..., "rgb".index(component)]
        return getattr(self, name)

    @property
    def one(self) -> NDArray:
        """Ones."""
        return np.ones(self._svbrdf.size, np.float32)

    @property
    def zero(self) -> NDArray:
        """Zeros."""
        return np.zeros(self._svbrdf.size, np.float32)

    @property
    def occlusion(self) -> NDArray:
        """Ambient occlusion, 1 where the set has none."""
        return self.one if self._svbrdf.occlusion is None else self._svbrdf.occlusion

    @property
    def normal_x(self) -> NDArray:
        """X of the normal, [-1, 1] on [0, 1]."""
        return 0.5 + 0.5 * self._svbrdf.normal[..., 0]

    @property
    def normal_y(self) -> NDArray:
        """Y of the normal in the preset's convention, [-1, 1] on [0, 1]."""
        return 0.5 + (0.5 if self._normal_y == "gl" else -0.5) * self._svbrdf.normal[..., 1]

    @property
    def normal_z(self) -> NDArray:
        """Z of the normal, [-1, 1] on [0, 1]."""
        return 0.5 + 0.5 * self._svbrdf.normal[..., 2]

    @property
    def roughness(self) -> NDArray:
        """Perceptual roughness of the isotropic lobe with the same determinant."""
        return perceptual_from_log_tensor(self._svbrdf.log_roughness)

    @property
    def smoothness(self) -> NDArray:
        """1 - perceptual roughness."""
        return 1.0 - self.roughness

    @property
    def specular(self) -> NDArray:
        """(H, W, 3) scale of the lobe."""
        return self._svbrdf.specular

    @property
    def diffuse(self) -> NDArray:
        """(H, W, 3) diffuse albedo."""
        return self._svbrdf.diffuse

    @cached_property
    def _metallic_roughness(self) -> tuple[NDArray, NDArray]:
        return base_color_and_metallic(self._svbrdf.specular, self._svbrdf.diffuse)

    @property
    def base_color(self) -> NDArray:
        """(H, W, 3) base colour of the metallic-roughness model."""
        return self._metallic_roughness[0]

    @property
    def metallic(self) -> NDArray:
        """Metallic of the metallic-roughness model."""
        return self._metallic_roughness[1]

    @cached_property
    def _alphas(self) -> tuple[NDArray, NDArray]:
        major, minor = eigenvalues_of_log(self._svbrdf.log_roughness)
        return np.sqrt(major), np.sqrt(minor)

    @cached_property
    def _direction(self) -> NDArray:
        direction = anisotropy_direction(self._svbrdf.normal, self._svbrdf.log_roughness)
        along = direction[..., 0] * self._towards[0] + direction[..., 1] * self._towards[1]
        return np.where(along[..., None] < 0.0, -direction, direction)

    @property
    def direction_x(self) -> NDArray:
        """X of the direction of larger roughness, [-1, 1] on [0, 1]."""
        return 0.5 + 0.5 * self._direction[..., 0]

    @property
    def direction_y(self) -> NDArray:
        """Y of the direction of larger roughness (tangent space is +Y up wherever we write one), [-1, 1] on [0, 1]."""
        return 0.5 + 0.5 * self._direction[..., 1]

    @property
    def gltf_roughness(self) -> NDArray:
        """r of glTF: alpha_b = r^2 is the smaller alpha."""
        return perceptual_from_alpha_squared(np.square(self._alphas[1]))

    @property
    def gltf_strength(self) -> NDArray:
        """Strength s of KHR_materials_anisotropy; see `gltf_strength_from_alphas`."""
        return gltf_strength_from_alphas(*self._alphas)

    @property
    def godot_strength(self) -> NDArray:
        """Anisotropy of Godot, alpha_y / alpha_x = 1 - 0.9 s (a ratio below 0.1 is more than Godot has)."""
        return (1.0 - self._alphas[1] / self._alphas[0]) / GODOT_RANGE

    @property
    def ratio_strength(self) -> NDArray:
        """s = 1 - alpha_minor / alpha_major; with roughness r: alpha_major, alpha_minor = r^2 (1 - s)^(-1/2, 1/2)."""
        return 1.0 - self._alphas[1] / self._alphas[0]


def gltf_strength_from_alphas(major: NDArray, minor: NDArray) -> NDArray:
    """Strength s of KHR_materials_anisotropy of the two alphas (...).

    Its alpha_t = mix(alpha, 1, s^2) = alpha + (1 - alpha) s^2 with alpha = alpha_b, so
    s^2 = (alpha_t - alpha_b) / (1 - alpha_b).  An alpha above 1 has no place in it and is held at 1.
    """
    major, minor = np.minimum(major, 1.0), np.minimum(minor, 1.0)
    return np.sqrt((major - minor) / np.maximum(1.0 - minor, np.finfo(np.float32).tiny))


def alphas_from_gltf(roughness: NDArray, strength: NDArray) -> tuple[NDArray, NDArray]:
    """(alpha_t, alpha_b) of roughness and strength as KHR_materials_anisotropy has them: the inverse of the above."""
    minor = np.square(roughness)
    return minor + (1.0 - minor) * np.square(strength), minor


def anisotropy_direction(normal: NDArray, log_roughness: NDArray) -> NDArray:
    """Direction of larger roughness as engines read it: unit (..., 2), its sign left open.

    The eigenvector of log Sigma in the frame of the normal stands at half the angle of (a - b, 2c); the rotation that
    takes z to n lifts it into the tangent plane; engines lay tangents into the plane of the geometry, so it is
    projected there along z.  Inverse: `tangent_above`.
    """
    angle = 0.5 * np.arctan2(2.0 * log_roughness[..., 2], log_roughness[..., 0] - log_roughness[..., 1])
    e_x, e_y = np.cos(angle), np.sin(angle)
    x, y, z = normal[..., 0], normal[..., 1], normal[..., 2]
    # R e = e - (e.n_xy) (n_xy / (1 + z), 1): what the shortest rotation does to a vector of the plane.
    k = (e_x * x + e_y * y) / (1.0 + np.maximum(z, 0.0))
    t_x, t_y = e_x - k * x, e_y - k * y
    length = np.hypot(t_x, t_y)
    safe = np.where(length > 1e-6, length, 1.0)
    return np.stack([np.where(length > 1e-6, t_x / safe, e_x), np.where(length > 1e-6, t_y / safe, e_y)], axis=-1)


def tangent_above(normal: NDArray, direction: NDArray) -> NDArray:
    """Unit tangent (..., 3) at right angles to the normal (n_z > 0) that lies straight above a direction (..., 2)."""
    rise = -(direction * normal[..., :2]).sum(axis=-1) / normal[..., 2]
    tangent = np.concatenate([direction, rise[..., None]], axis=-1)
    return tangent / np.linalg.norm(tangent, axis=-1, keepdims=True)


def base_color_and_metallic(specular: NDArray, diffuse: NDArray) -> tuple[NDArray, NDArray]:
    """Base colour (..., 3) and metallic (...) of specular and diffuse colours (..., 3), all linear, in [0, 1].

    The model is, per channel, s = 0.04 (1-m) + base m and d = base (1-m).  With q = 1-m and base = d/q:
    0.04 q^2 - (s + d) q + d = 0.  It is linear in s and d, so it holds for the means over the channels too, and one q
    serves all three.  Where s < 0.04 both roots may lie in [0, 1] (a dark metal looks like a dark dielectric): the one
    that explains the channels better is taken, the dielectric when they tie.  Then base is the least-squares answer of
    both equations, (d q + (s - 0.04 q) m) / (q^2 + m^2), whose denominator is at least 1/2: nothing is divided by zero
    for black or noisy colours, and colours of the model itself come back as they were.
    """
    s = specular.mean(axis=-1, dtype=np.float64)
    d = diffuse.mean(axis=-1, dtype=np.float64)
    total = s + d
    root = np.sqrt(np.maximum(np.square(total) - 4.0 * DIELECTRIC_F0 * d, 0.0))
    # The smaller root in the form without cancellation.
    metal = np.clip(2.0 * d / np.maximum(total + root, np.finfo(np.float32).tiny), 0.0, 1.0)
    dielectric = (total + root) / (2.0 * DIELECTRIC_F0)
    q = metal
    # Only for dark colours is the larger root a share at all; 5% more, for those that noise has pushed out.
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
