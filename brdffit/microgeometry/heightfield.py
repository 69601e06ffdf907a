"""The surface of a material with a height map.

The geometry is the height: a periodic mesh with a vertex at each texel centre and two triangles between four of them,
all lengths in texels. Colours, roughness and normals are textures on it, read at (column, row) of a point and
interpolated as the reference for maps interpolates them.

The shading normal, which the BRDF uses, comes from maps too. A normal map that accompanies a height map usually repeats
its slopes and adds finer ones; it is then the whole shading normal, as for a renderer of maps. With all effects off,
such a surface is exactly the SVBRDF of the maps, so every difference is due to an effect. Where the correlation of the
two slopes is below ``REPEATS``, the normal map is taken for a separate detail on top of the height, and slopes add.
With m_h the slopes of the height as given, m those of the map and a the amplitude that is asked for,

    m_shading = m + (a - 1) m_h    if the map repeats the height,        m + a m_h    if it does not.

``shading="geometry"`` takes the normals of the triangles instead. Then bounces conserve energy, as a white-furnace test
needs, and the result is what other programs render of the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.machine import free_memory
from brdffit.render._packing import Packed, pack_base
from brdffit.svbrdf import Svbrdf
from brdffit.textures.encoding import height_gradient, normals_from_gradient, slopes_of_normals

#: Least correlation of slopes at which a normal map counts as repeating its height map.
REPEATS = 0.5
#: Bytes of memory for each texel while a surface is made and traced: maps, packed texels, pyramid.
BYTES_PER_TEXEL = 64 + 4 * 12 + 8 + 8 + 24
SHADINGS = ("map", "geometry")


@dataclass(frozen=True)
class HeightField:
    """A traced surface.

    Attributes:
        height: (H, W) float32 heights of the vertices, in texels.
        maxima, levels: the maximum pyramid, see ``maximum_pyramid`` and ``kernels.traversal``.
        packed: the other maps, see ``render._packing``.
        reference: height, in texels, of the plane on which positions are given. It is the mean height, so that the
            parallax is zero on average.
        shading: "map" or "geometry", see the module.
        notes: sentences for the user.
    """

    height: NDArray
    maxima: NDArray
    levels: NDArray
    packed: Packed
    reference: float
    shading: str = "map"
    notes: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, svbrdf: Svbrdf, amplitude: float = 1.0, shading: str = "map") -> HeightField:
        """The surface of a material with a height map, its height (in texels) times ``amplitude``.

        Raises:
            InputError: when there is no height map, a number is not finite, or memory does not suffice.
            ValueError: for another ``shading`` than "map" or "geometry".
        """
        if svbrdf.height is None:
            raise InputError(
                "A traced surface needs a height map and this material has none: give one (--role height=FILE)."
            )
        if shading not in SHADINGS:
            raise ValueError(f"shading is {shading!r}, expected one of {SHADINGS}")
        if not (np.isfinite(amplitude) and svbrdf.is_finite()):
            raise InputError("The material or its amplitude holds numbers that are not finite.")
        check_memory(svbrdf.size)
        notes = []
        if svbrdf.wrap != "tile":
            notes.append("A traced surface goes on beyond its border by repeating, though these maps are clamped.")
        height = np.ascontiguousarray(svbrdf.height * np.float32(amplitude))
        if float(np.ptp(height)) == 0.0:
            notes.append("The height is the same everywhere: parallax, shadows and interreflection have no effect.")
        normal = svbrdf.normal if amplitude == 1.0 and _repeats(svbrdf) else _shading_normals(svbrdf, amplitude, notes)
        packed = pack_base(svbrdf.over_black().replace(normal=normal, wrap="tile"))
        maxima, levels = maximum_pyramid(height)
        return cls(height, maxima, levels, packed, float(height.mean(dtype=np.float64)), shading, notes)

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in texels."""
        return self.height.shape[0], self.height.shape[1]

    @property
    def span(self) -> float:
        """Height of the highest point over the lowest, in texels."""
        return float(np.ptp(self.height))


def maximum_pyramid(height: NDArray) -> tuple[NDArray, NDArray]:
    """(maxima, levels): the largest height in each cell of a periodic height map (H, W), on all levels.

    Cell (j, i) of the finest level lies between vertices (j, i) and (j + 1, i + 1); coarser cells hold 2x2 finer ones.
    ``maxima`` is flat, in the type of the height; ``levels`` is (L, 3) int64: first index, rows and columns of each
    level.
    """
    across = np.maximum(height, np.roll(height, -1, axis=1))
    level = np.maximum(across, np.roll(across, -1, axis=0))
    images = [level]
    while level.size > 1:
        rows, columns = level.shape
        even = np.pad(level, ((0, rows % 2), (0, columns % 2)), mode="edge")
        level = even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2).max(axis=(1, 3))
        images.append(level)
    begins = np.cumsum([0, *(image.size for image in images)])
    levels = [(begin, *image.shape) for begin, image in zip(begins, images, strict=False)]
    return np.concatenate([image.ravel() for image in images]), np.array(levels, np.int64)


def check_memory(size: tuple[int, int]) -> None:
    """Refuse a surface of ``size`` (height, width) texels that does not fit into free memory, before it is made.

    Raises:
        InputError: tells how much memory is needed and how much is free.
    """
    needed, free = size[0] * size[1] * BYTES_PER_TEXEL, free_memory()
    if free is not None and needed > free:
        raise InputError(
            f"A surface of {size[1]}x{size[0]} texels needs about {needed / 2**30:.1f} GiB of memory and "
            f"{free / 2**30:.1f} GiB are free: give smaller maps."
        )


def _repeats(svbrdf: Svbrdf) -> bool:
    """Whether the slopes of the normal map correlate with those of the height by at least ``REPEATS``."""
    assert svbrdf.height is not None
    of_map = slopes_of_normals(svbrdf.normal).astype(np.float64)
    of_height = height_gradient(svbrdf.height, "tile").astype(np.float64)
    norm = np.sqrt(np.square(of_map).sum() * np.square(of_height).sum())
    return bool(norm > 0.0 and (of_map * of_height).sum() >= REPEATS * norm)


def _shading_normals(svbrdf: Svbrdf, amplitude: float, notes: list[str]) -> NDArray:
    """Unit shading normals (H, W, 3) float32 from the slopes of the map and of the height, see the module."""
    assert svbrdf.height is not None
    share = amplitude
    if _repeats(svbrdf):
        share = amplitude - 1.0
    elif bool((svbrdf.normal[..., :2] != 0.0).any()) and float(np.ptp(svbrdf.height)) > 0.0:
        notes.append(
            "The slopes of the normal map do not go along with those of the height map: it is taken for a detail that "
            "stands on the height, and slopes add."
        )
    slopes = slopes_of_normals(svbrdf.normal) + np.float32(share) * height_gradient(svbrdf.height, "tile")
    return normals_from_gradient(slopes).astype(np.float32)
