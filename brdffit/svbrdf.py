"""A spatially varying BRDF in the program's own terms; it knows nothing of files."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WRAPS = ("tile", "clamp")
#: Weight of a texel without any surface, relative to one that is fully covered.
LEAST_WEIGHT = 1e-3


@dataclass
class Svbrdf:
    """Per-texel parameters of one lobe; all arrays float32, row 0 at the top of the picture.

    Attributes:
        normal: (H, W, 3) unit normals, tangent space, z up, +Y up in the picture (OpenGL).
        log_roughness: (H, W, 3) matrix logarithm (a, b, c) of the roughness tensor [[a, c], [c, b]] in alpha^2,
            in the tangent plane of the normal (frame: the rotation that takes z to n by the shortest way).
        specular: (H, W, 3) linear RGB scale of the lobe (reflectance at normal incidence).
        diffuse: (H, W, 3) linear RGB diffuse albedo.
        model: name of the lobe model.
        wrap: "tile" or "clamp", how the texture goes on beyond its border.
        shape: (H, W) further parameter of the lobe, or None where the model has none.
        occlusion: (H, W) ambient occlusion in [0, 1], or None; carried along, averaged, never fitted.
        height: (H, W) height in texels (positive up), or None; read by the method that filters heights.
        opacity: (H, W) share of each texel that the surface covers, in [0, 1], or None where it covers all; it weighs
            every other map (see ``weighted``), and is itself averaged.
        alpha: how engines use opacity: "mask" (tested against ``cutoff``), "blend", or "" where it only marks texels
            that nothing uses.
        cutoff: opacity below which a mask is cut out.
    """

    normal: NDArray
    log_roughness: NDArray
    specular: NDArray
    diffuse: NDArray
    model: str = "ggx"
    wrap: str = "tile"
    shape: NDArray | None = None
    occlusion: NDArray | None = None
    height: NDArray | None = None
    opacity: NDArray | None = None
    alpha: str = ""
    cutoff: float = 0.5

    def __post_init__(self) -> None:
        size = self.normal.shape[:2]
        for name in ("normal", "log_roughness", "specular", "diffuse"):
            array = getattr(self, name)
            if array.shape != (*size, 3):
                raise ValueError(f"{name} has shape {array.shape}, expected {(*size, 3)}")
        for name in ("shape", "occlusion", "height", "opacity"):
            array = getattr(self, name)
            if array is not None and array.shape != size:
                raise ValueError(f"{name} has shape {array.shape}, expected {size}")
        if self.wrap not in WRAPS:
            raise ValueError(f"wrap is {self.wrap!r}, expected one of {WRAPS}")

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in texels."""
        return self.normal.shape[0], self.normal.shape[1]

    def replace(self, **changes: object) -> Svbrdf:
        """A copy with some fields changed (arrays are shared, not copied)."""
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]

    def without(self, roles: Collection[str]) -> Svbrdf:
        """As if maps of these roles had not been read: without "normal", normals are z and there is no height."""
        if "normal" not in roles:
            return self
        flat = np.zeros_like(self.normal)
        flat[..., 2] = 1.0
        return self.replace(normal=flat, height=None)

    def weighted(self) -> Svbrdf:
        """Colours times the weight w = L + (1 - L) opacity, which takes opacity's place; L = ``LEAST_WEIGHT``.

        A level's target sum_i f_i a_i rho_i D_i / sum_i f_i a_i, for filter weights f, is linear in the colours: bake
        these, filter w alongside, and divide. So every method that weighs lobes by their colours weighs them by opacity
        too, and a footprint without any surface comes out as the plain average of its texels.
        """
        if self.opacity is None:
            return self
        weight = np.float32(LEAST_WEIGHT) + np.float32(1.0 - LEAST_WEIGHT) * self.opacity
        colours = {name: getattr(self, name) * weight[..., None] for name in ("specular", "diffuse")}
        return self.replace(opacity=weight, **colours)

    def unweighted(self) -> Svbrdf:
        """The inverse of ``weighted``, for a level whose weights were filtered like its colours."""
        if self.opacity is None:
            return self
        # Mitchell's filter has negative weights.
        weight = np.maximum(self.opacity, np.float32(LEAST_WEIGHT))
        colours = {name: getattr(self, name) / weight[..., None] for name in ("specular", "diffuse")}
        opacity = np.clip((weight - LEAST_WEIGHT) / (1.0 - LEAST_WEIGHT), 0.0, 1.0).astype(np.float32)
        return self.replace(opacity=opacity, **colours)

    def over_black(self) -> Svbrdf:
        """Composited over black: colours times opacity, and no opacity."""
        if self.opacity is None:
            return self
        colours = {name: getattr(self, name) * self.opacity[..., None] for name in ("specular", "diffuse")}
        return self.replace(opacity=None, **colours)

    def averaged_scalars(self, average: Callable[[NDArray], NDArray]) -> tuple[NDArray | None, NDArray | None]:
        """Occlusion and opacity of a level, by a function that filters (H, W, C); of ``weighted`` maps.

        Occlusion is weighted by opacity.
        """
        if self.opacity is None:
            return None if self.occlusion is None else average(self.occlusion[..., None])[..., 0], None
        opacity = average(self.opacity[..., None])[..., 0]
        if self.occlusion is None:
            return None, opacity
        occlusion = average((self.occlusion * self.opacity)[..., None])[..., 0]
        return np.clip(occlusion / np.maximum(opacity, LEAST_WEIGHT), 0.0, 1.0), opacity

    def arrays(self) -> dict[str, NDArray]:
        """The arrays that are present, by field name."""
        names = ("normal", "log_roughness", "specular", "diffuse", "shape", "occlusion", "height", "opacity")
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    def is_finite(self) -> bool:
        """Whether every stored number is finite."""
        return all(bool(np.isfinite(array).all()) for array in self.arrays().values())


def level_sizes(size: tuple[int, int], levels: int | None = None) -> list[tuple[int, int]]:
    """Sizes (height, width) of the MIP levels of a base of this size, each half the one before, rounded down, to 1x1.

    ``levels`` stops the list early (level 0 counts).
    """
    height, width = size
    sizes = [(height, width)]
    while (height, width) != (1, 1):
        height, width = max(1, height // 2), max(1, width // 2)
        sizes.append((height, width))
    return sizes if levels is None else sizes[:levels]


def unit_or_up(normal: NDArray) -> NDArray:
    """Averaged normals (..., 3) float32 at unit length; (0, 0, 1) where nothing is left of them."""
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.where(length > 1e-6, normal / np.maximum(length, 1e-6), np.array([0.0, 0.0, 1.0], np.float32))
