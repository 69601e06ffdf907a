"""The meaning of each channel of an engine's pictures, and its inverse: the lobe that the pictures hold.

Each channel name is defined once, as a property of `Channels`; `decode` inverts them all. Sources: glTF 2.0 and
KHR_materials_anisotropy (Khronos); the standard material of Godot 4; Unreal 5 (GetAnisotropicRoughness) and Unity HDRP,
alpha (1 +- A); Standard Surface (Autodesk), as MaterialX computes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from brdffit.export.factors import Factors, gltf_strength_from_alphas
from brdffit.export.metallic import base_color_and_metallic, reflectance, tinted
from brdffit.roughness import eigenvalues_of_log, perceptual_from_alpha_squared, perceptual_from_log_tensor
from brdffit.svbrdf import Svbrdf

#: Godot's smallest ratio of the two alphas: aspect^2 = 1 - 0.9 anisotropy. Blender's Principled BSDF has the same.
GODOT_RANGE = 0.9


#: Nothing is divided.
_PLAIN = Factors()


class Channels:
    """The channels of a `Picture` by name, for one SVBRDF: (H, W), colours (H, W, 3), not yet clipped to [0, 1].

    Args:
        svbrdf: one level, or a band of its rows.
        normal_y: "gl" or "dx".
        towards: (x, y), the middle of the half plane that anisotropy directions are turned into: a direction and its
            opposite are the same lobe, but a texture filter would average them to zero.
        strongest: largest strength of glTF in the pyramid, by which lengths of directions are divided.
        factors: what the material multiplies values by, so that they are stored divided.
    """

    def __init__(
        self, svbrdf: Svbrdf, normal_y: str = "gl", towards: tuple[float, float] = (1.0, 0.0), strongest: float = 1.0,
        factors: Factors = _PLAIN,
    ) -> None:  # fmt: skip
        self._svbrdf = svbrdf
        self._normal_y = normal_y
        self._towards = towards
        self._strongest = strongest
        self._factors = factors

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
    def opacity(self) -> NDArray:
        """Share of the texel that the surface covers, 1 where the set has no opacity."""
        return self.one if self._svbrdf.opacity is None else self._svbrdf.opacity

    @cached_property
    def _normal(self) -> NDArray:
        """Normals whose x and y are divided by the material's scale, of unit length."""
        if self._factors.normal == 1.0:
            return self._svbrdf.normal
        stretched = self._svbrdf.normal / np.array([self._factors.normal, self._factors.normal, 1.0], np.float32)
        return stretched / np.linalg.norm(stretched, axis=-1, keepdims=True)

    @property
    def normal_x(self) -> NDArray:
        """X of the normal, [-1, 1] on [0, 1]."""
        return 0.5 + 0.5 * self._normal[..., 0]

    @property
    def normal_y(self) -> NDArray:
        """Y of the normal in the preset's convention, [-1, 1] on [0, 1]."""
        return 0.5 + (0.5 if self._normal_y == "gl" else -0.5) * self._normal[..., 1]

    @property
    def normal_z(self) -> NDArray:
        """Z of the normal, [-1, 1] on [0, 1]."""
        return 0.5 + 0.5 * self._normal[..., 2]

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
    def _metallic_roughness(self) -> tuple[NDArray, NDArray, NDArray | None]:
        """Base colour and metallic, and a specular colour where the material has such."""
        if self._factors.specular is None:
            return *base_color_and_metallic(self._svbrdf.specular, self._svbrdf.diffuse), None
        return tinted(self._svbrdf.specular, self._svbrdf.diffuse)

    @property
    def base_color(self) -> NDArray:
        """(H, W, 3) base colour of the metallic-roughness model."""
        return self._metallic_roughness[0]

    @property
    def specular_color(self) -> NDArray:
        """(H, W, 3) specular colour of KHR_materials_specular, over the material's; ones where it has none."""
        tint, factor = self._metallic_roughness[2], self._factors.specular
        return np.ones((*self._svbrdf.size, 3), np.float32) if tint is None or factor is None else tint / factor

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

    @cached_property
    def _scaled(self) -> NDArray:
        """Directions whose length is the strength of anisotropy over the strongest of the pyramid, at most 1.

        Engines normalise them, so the length is free. This one fades the noise of directions where lobes are nearly
        round: blocks spend no bits on it, and between texels the direction of the more anisotropic lobe prevails.
        """
        return self._direction * (self._strength / max(self._strongest, 1e-6))[..., None]

    @property
    def direction_x(self) -> NDArray:
        """X of the direction of larger roughness, [-1, 1] on [0, 1]; its length means nothing, see `_scaled`."""
        return 0.5 + 0.5 * self._scaled[..., 0]

    @property
    def direction_y(self) -> NDArray:
        """Y of that direction, +Y up whatever the convention of the normals."""
        return 0.5 + 0.5 * self._scaled[..., 1]

    @property
    def tangent_x(self) -> NDArray:
        """X of the unit direction of larger roughness, for engines that read it as they read a normal."""
        return 0.5 + 0.5 * self._direction[..., 0]

    @property
    def tangent_y(self) -> NDArray:
        """Y of that direction, in the preset's convention."""
        return 0.5 + (0.5 if self._normal_y == "gl" else -0.5) * self._direction[..., 1]

    @property
    def half(self) -> NDArray:
        """Code of 0 where [-1, 1] lies on [0, 1]: Z of a tangent."""
        return np.full(self._svbrdf.size, 0.5, np.float32)

    @property
    def mean_roughness(self) -> NDArray:
        """r of Unreal and HDRP: r^2 is the arithmetic mean of the two alphas."""
        return np.sqrt(0.5 * (self._alphas[0] + self._alphas[1]))

    @property
    def mean_smoothness(self) -> NDArray:
        """1 - r of HDRP."""
        return 1.0 - self.mean_roughness

    @property
    def mean_anisotropy(self) -> NDArray:
        """A of Unreal, HDRP and Filament: the alphas are r^2 (1 + A) and r^2 (1 - A); never negative here."""
        return (self._alphas[0] - self._alphas[1]) / (self._alphas[0] + self._alphas[1])

    @property
    def gltf_roughness(self) -> NDArray:
        """r of glTF: alpha_b = r^2 is the smaller alpha; over the material's factor."""
        return perceptual_from_alpha_squared(np.square(self._alphas[1])) / np.float32(self._factors.roughness)

    @cached_property
    def _strength(self) -> NDArray:
        return gltf_strength_from_alphas(*self._alphas)

    @property
    def gltf_strength(self) -> NDArray:
        """Strength s of KHR_materials_anisotropy, over the material's; see `gltf_strength_from_alphas`."""
        return self._strength / np.float32(self._factors.strength)

    @property
    def godot_strength(self) -> NDArray:
        """Anisotropy of Godot, alpha_y / alpha_x = 1 - 0.9 s (a ratio below 0.1 is more than Godot has)."""
        return (1.0 - self._alphas[1] / self._alphas[0]) / GODOT_RANGE

    @property
    def ratio_strength(self) -> NDArray:
        """s = 1 - alpha_minor / alpha_major; with roughness r: alpha_major, alpha_minor = r^2 (1 - s)^(-1/2, 1/2)."""
        return 1.0 - self._alphas[1] / self._alphas[0]


def alphas_from_gltf(roughness: NDArray, strength: NDArray) -> tuple[NDArray, NDArray]:
    """(alpha_t, alpha_b) of KHR_materials_anisotropy: the inverse of ``gltf_roughness`` and ``gltf_strength``."""
    minor = np.square(roughness)
    return minor + (1.0 - minor) * np.square(strength), minor


def decode(channels: Mapping[str, NDArray], normal_y: str = "gl", factors: Factors = _PLAIN) -> Svbrdf:
    """The SVBRDF that an engine reads from channels, by their names in `Channels`: the inverse of that class.

    Args:
        channels: (H, W) each, linear, in [0, 1].
        normal_y: "gl" or "dx".
        factors: of the material.

    Returns:
        An SVBRDF of GGX; without channels for them, the specular colour is 1 and the lobe isotropic.
    """
    sign = 1.0 if normal_y == "gl" else -1.0
    xy = np.stack([2.0 * channels["normal_x"] - 1.0, sign * (2.0 * channels["normal_y"] - 1.0)], axis=-1)
    # Two channels, and engines that read two of three, take Z from unit length.
    z = np.sqrt(np.maximum(1.0 - np.square(xy).sum(axis=-1), 0.0))
    if "normal_z" in channels:
        z = np.maximum(2.0 * channels["normal_z"] - 1.0, 0.0)
    normal = np.concatenate([factors.normal * xy, z[..., None]], axis=-1)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
    major, minor = (np.maximum(alpha, 1e-4) for alpha in _alphas_of(channels, factors))
    if "direction_x" in channels:
        direction = np.stack([channels["direction_x"], channels["direction_y"]], axis=-1) * 2.0 - 1.0
    elif "tangent_x" in channels:
        direction = np.stack([2.0 * channels["tangent_x"] - 1.0, sign * (2.0 * channels["tangent_y"] - 1.0)], axis=-1)
    else:
        direction = np.broadcast_to([1.0, 0.0], xy.shape)
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    direction = np.where(length > 1e-6, direction / np.maximum(length, 1e-6), [1.0, 0.0])
    if "specular_r" in channels:
        specular, diffuse = (np.stack([channels[f"{name}_{c}"] for c in "rgb"], -1) for name in ("specular", "diffuse"))
    else:
        base, metallic = np.stack([channels[f"base_color_{c}"] for c in "rgb"], -1), channels["metallic"]
        tint: NDArray | float = 1.0
        if "specular_color_r" in channels and factors.specular is not None:
            tint = factors.specular * np.stack([channels[f"specular_color_{c}"] for c in "rgb"], -1)
        specular, diffuse = reflectance(base, metallic, tint), base * (1.0 - metallic)[..., None]
    return Svbrdf(
        normal=normal.astype(np.float32),
        log_roughness=_log_tensor(normal, direction, major, minor).astype(np.float32),
        specular=specular.astype(np.float32),
        diffuse=diffuse.astype(np.float32),
    )


def _alphas_of(channels: Mapping[str, NDArray], factors: Factors) -> tuple[NDArray, NDArray]:
    """The two alphas of whichever roughness and strength the channels hold."""
    if "gltf_roughness" in channels:
        roughness = factors.roughness * channels["gltf_roughness"]
        strength = factors.strength * channels.get("gltf_strength", np.zeros_like(roughness))
        return alphas_from_gltf(roughness, strength)
    if "mean_roughness" in channels or "mean_smoothness" in channels:
        mean = channels["mean_roughness"] if "mean_roughness" in channels else 1.0 - channels["mean_smoothness"]
        alpha, strength = np.square(mean), channels.get("mean_anisotropy", np.zeros_like(mean))
        return alpha * (1.0 + strength), alpha * (1.0 - strength)
    alpha = np.square(channels["roughness"])
    ratio = 1.0 - channels.get("ratio_strength", GODOT_RANGE * channels.get("godot_strength", np.zeros_like(alpha)))
    root = np.sqrt(np.maximum(ratio, 1e-6))
    return alpha / root, alpha * root


def _log_tensor(normal: NDArray, direction: NDArray, major: NDArray, minor: NDArray) -> NDArray:
    """log Sigma (..., 3) of alphas (...) whose larger one lies along a direction: inverse of `anisotropy_direction`.

    The tangent above the direction goes back into the frame of the normal, R'w = w_xy - (w.n_xy / (1 + z) + w_z) n_xy,
    and its angle, doubled, turns the half difference of the logarithms of alpha^2.
    """
    tangent = tangent_above(np.concatenate([normal[..., :2], np.maximum(normal[..., 2:], 1e-3)], axis=-1), direction)
    k = (tangent[..., :2] * normal[..., :2]).sum(axis=-1) / (1.0 + normal[..., 2]) + tangent[..., 2]
    e = tangent[..., :2] - k[..., None] * normal[..., :2]
    twice = 2.0 * np.arctan2(e[..., 1], e[..., 0])
    mean, half = np.log(major) + np.log(minor), np.log(major) - np.log(minor)
    return np.stack([mean + half * np.cos(twice), mean - half * np.cos(twice), half * np.sin(twice)], axis=-1)


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
