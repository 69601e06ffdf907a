"""The interfaces of the renderer to a result and to the truth, neither of which need be made of lobes.

An appearance says what a pixel of a baked material reflects, whatever it is made of: a pyramid of lobes, two lobes, a
distribution of normals, a network. The renderer reads it once for each pixel (``look_up``) and then asks for every
light. A ``LobePyramid`` is drawn by compiled loops, anything else by one path in numpy, so that a new kind of result
needs its size and four functions, and no change of the renderer.

A truth is what pictures are compared with: an ``Svbrdf`` at full resolution, or anything that knows what one of its
points reflects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf, unit_or_up


class Lookups(NamedTuple):
    """Where n pixels look at a texture, and from where.

    Attributes:
        position: (n, 2) float64, (column, row) in texels of the base; texel i is centred on i + 1/2.
        axes: (n, 2, 2) float64, the pixel's footprint in base texels: [:, i, j] is the derivative of coordinate i by
            the pixel's axis j (x to the right, y down).
        detail: (n,) float64, continuous MIP level, log2 of the footprint's longer axis; not clamped.
        view: (n, 3) float64, unit vectors to the viewer in the tangent space of the texture (z up, +Y up in the
            picture).
    """

    position: NDArray
    axes: NDArray
    detail: NDArray
    view: NDArray

    def part(self, rows: Any) -> Lookups:
        """Some of them, by a slice or an index array."""
        return Lookups(*(each[rows] for each in self))


@runtime_checkable
class Appearance(Protocol):
    """The appearance of a material at any distance. All directions are unit vectors in tangent space.

    ``texels`` is whatever ``look_up`` returns; the renderer hands it back as it is. What depends on the view alone (a
    neural offset, say) belongs in ``look_up``.
    """

    @property
    def base_size(self) -> tuple[int, int]:
        """(height, width) in texels of the base, in whose texels positions are counted."""
        ...

    def look_up(self, lookups: Lookups) -> Any:
        """Read what n pixels need once, for all lights."""
        ...

    def evaluate(self, texels: Any, view: NDArray, light: NDArray) -> NDArray:
        """(n, 3): the BRDF times the cosine of the light, 0 where nothing is reflected.

        ``view`` and ``light`` are (n, 3), one pair a pixel. The value is the linear radiance under a light that gives a
        surface facing it an irradiance of 1.
        """
        ...

    def sample(self, texels: Any, view: NDArray, u: NDArray) -> NDArray:
        """(n, 3) directions to light, one a pixel, from ``u`` (n, 2) uniform in [0, 1), with the density ``pdf``."""
        ...

    def pdf(self, texels: Any, view: NDArray, light: NDArray) -> NDArray:
        """(n,) density per steradian of the directions that ``sample`` draws; positive wherever light is reflected."""
        ...


@runtime_checkable
class Truth(Protocol):
    """What pictures are compared with, if it is no ``Svbrdf`` (which is drawn by compiled loops).

    The reference averages what points of a footprint reflect under the pixel filter, each lit and seen from the
    pixel's own directions (Kemppinen et al. 2023, equations 2 and 3).
    """

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in texels."""
        ...

    def reflect(self, position: NDArray, view: NDArray, light: NDArray, seed: int) -> NDArray:
        """(n, 3): the BRDF times the cosine at points of the surface, each under one pair of directions.

        Args:
            position: (n, 2) float64, (column, row) in texels, also beyond the border: the truth wraps or clamps them.
            view, light: (n, 3) unit vectors in tangent space.
            seed: of a random estimate: its mean over seeds is the value, and two seeds are independent.
        """
        ...


class Lobes(NamedTuple):
    """What a ``LobePyramid`` reads for n pixels: arrays as those of an ``Svbrdf``, one row a pixel.

    ``tensor`` (n, 3) is Sigma as (XX, YY, XY) in alpha^2; ``shape`` is None where the model has none.
    """

    normal: NDArray
    tensor: NDArray
    specular: NDArray
    diffuse: NDArray
    shape: NDArray | None


@dataclass(frozen=True)
class LobePyramid:
    """MIP levels of one lobe a texel, interpolated as a renderer interpolates what the files store.

    Between texels and levels the normal (then brought to unit length), the roughness tensor in alpha^2 and linear
    colours are interpolated: bilinearly in each of the two nearest levels, and linearly between them. The level is
    clamped to those that exist.

    Attributes:
        levels: level 0 (as large as the base) and on, all of one lobe model.
    """

    levels: Sequence[Svbrdf]

    def __post_init__(self) -> None:
        # A cut-out is composited over black, here as in the reference.
        object.__setattr__(self, "levels", [level.over_black() for level in self.levels])

    @property
    def base_size(self) -> tuple[int, int]:
        """(height, width) of level 0."""
        return self.levels[0].size

    @property
    def model(self) -> str:
        """Name of the lobe model."""
        return self.levels[0].model

    @cached_property
    def images(self) -> list[NDArray]:
        """(h, w, 12 or 13) float32 of each level, as interpolated: normal, tensor, specular, diffuse, shape if any."""
        found = []
        for level in self.levels:
            arrays = [level.normal, tensor_from_log(level.log_roughness), level.specular, level.diffuse]
            arrays += [] if level.shape is None else [level.shape[..., None]]
            found.append(np.concatenate(arrays, axis=-1))
        return found

    def look_up(self, lookups: Lookups) -> Lobes:
        """The trilinear value for each pixel."""
        values = trilinear(self.images, lookups, self.base_size, self.levels[0].wrap)
        shape = values[:, 12] if values.shape[1] > 12 else None
        return Lobes(unit_or_up(values[:, :3]), values[:, 3:6], values[:, 6:9], values[:, 9:12], shape)

    def evaluate(self, texels: Lobes, view: NDArray, light: NDArray) -> NDArray:
        """See ``Appearance``."""
        from brdffit.models.microfacet import brdf  # numba

        return brdf(*texels[:4], view, light, model=self.model, shape=texels.shape)

    def sample(self, texels: Lobes, view: NDArray, u: NDArray) -> NDArray:
        """See ``Appearance``: from the lobe, or by the cosine for the diffuse part."""
        from brdffit.models.microfacet import draw, share_of_lobe

        return draw(texels.normal, texels.tensor, share_of_lobe(texels.specular, texels.diffuse), view, u)

    def pdf(self, texels: Lobes, view: NDArray, light: NDArray) -> NDArray:
        """See ``Appearance``."""
        from brdffit.models.microfacet import drawn_density, share_of_lobe

        share = share_of_lobe(texels.specular, texels.diffuse)
        return drawn_density(texels.normal, texels.tensor, share, view, light)


def trilinear(images: Sequence[NDArray], lookups: Lookups, base_size: tuple[int, int], wrap: str) -> NDArray:
    """Values (n, C) float32 of MIP levels (h, w, C): bilinear in the two levels nearest to the detail, linear between.

    The detail is clamped to the levels that exist. ``wrap``: "tile" or "clamp".
    """
    detail = np.clip(lookups.detail, 0.0, len(images) - 1.0)
    fine = np.minimum(detail.astype(np.int64), max(len(images) - 2, 0))
    part = detail - fine
    found = np.zeros((len(detail), images[0].shape[2]), np.float32)
    for number, image in enumerate(images):
        weight = np.where(fine == number, 1.0 - part, np.where(fine + 1 == number, part, 0.0))
        rows = np.flatnonzero(weight > 0.0)
        if len(rows):
            scale = image.shape[1] / base_size[1], image.shape[0] / base_size[0]
            found[rows] += weight[rows, None].astype(np.float32) * bilinear(image, lookups.position[rows] * scale, wrap)
    return found


def bilinear(image: NDArray, position: NDArray, wrap: str) -> NDArray:
    """Values (n, C) of an image (h, w, C) at positions (n, 2) as (column, row) in its texels; texel i is at i + 1/2."""
    at = position - 0.5
    first = np.floor(at).astype(np.int64)
    x, y = (at - first).T.astype(image.dtype)[..., None]
    size = np.array(image.shape[1::-1])
    corners = [first + step for step in ((0, 0), (1, 0), (0, 1), (1, 1))]
    corners = [corner % size if wrap == "tile" else np.clip(corner, 0, size - 1) for corner in corners]
    values = [image[corner[:, 1], corner[:, 0]] for corner in corners]
    upper, lower = values[0] + x * (values[1] - values[0]), values[2] + x * (values[3] - values[2])
    return upper + y * (lower - upper)
