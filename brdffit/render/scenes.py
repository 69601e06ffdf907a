"""What a camera sees of a textured surface: for each pixel its footprint on the texture, and directions.

World axes: x to the right, y up, z towards the viewer. Positions on the texture are (column, row) in base texels; texel
i is centred on i + 1/2. Rows run down and the tangent space's y runs up, as in the pictures.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.svbrdf import level_sizes

#: Distance of the camera from a plane that faces it, in half widths of the picture: directions vary by 20 degrees.
_CAMERA_DISTANCE = 2.75


@dataclass(frozen=True)
class Scene:
    """A surface as seen by the pixels of a picture of (h, w).

    Attributes:
        name: "plane", "slanted" or "sphere".
        level: the MIP level whose texels are the pixels' size, or None where it varies over the picture.
        base_size: (height, width) of the base texture in texels.
        centre: (h, w, 2) float64, where the pixel's centre falls on the texture: (column, row).
        axes: (h, w, 2, 2) float64, derivative of (column, row) by the pixel's (x to the right, y down): [..., i, j] is
            that of coordinate i by pixel axis j. The footprint is the pixel filter carried along by it.
        view: (h, w, 3) float32 unit vectors to the viewer, tangent space of the texture.
        frame: (h, w, 3, 3) float32, rows tangent, bitangent and normal of the surface in the world: a world direction w
            is frame @ w in tangent space.
        coverage: (h, w) float32 in [0, 1], how much of the pixel the surface covers. 0: the pixel is not rendered.
    """

    name: str
    level: float | None
    base_size: tuple[int, int]
    centre: NDArray
    axes: NDArray
    view: NDArray
    frame: NDArray
    coverage: NDArray

    @property
    def pixels(self) -> tuple[int, int]:
        """(height, width) of the picture."""
        return self.coverage.shape[0], self.coverage.shape[1]


def plane(
    base_size: tuple[int, int],
    level: float,
    pixels: tuple[int, int] = (256, 256),
    shift: tuple[float, float] = (0.0, 0.0),
    rotation: float = 0.0,
) -> Scene:
    """A plane that faces the camera, one pixel one texel of ``level``; it begins with the texture's first texel.

    The perspective varies the view by 20 degrees from the middle to the side, so highlights move over the picture. The
    texture repeats where the level is smaller than the picture.

    Args:
        base_size: (height, width) of the base texture.
        level: MIP level; between integers a pixel is 2^level base texels wide.
        pixels: (height, width) of the picture.
        shift: (x, y) by which the grid of pixels is moved, in pixels, to the right and down.
        rotation: angle in radians by which the lights are turned about the plane's normal, counter-clockwise.

    Raises:
        ValueError: when the texture has no such level.
    """
    x, y = _pixel_grid(pixels, shift)
    scale = _texel_size(base_size, level)
    half = 0.5 * max(pixels)
    view = np.stack([(0.5 * pixels[1] - x) / half, (y - 0.5 * pixels[0]) / half, np.full_like(x, _CAMERA_DISTANCE)], -1)
    return Scene(
        name="plane",
        level=level,
        base_size=base_size,
        centre=np.stack([x * scale[1], y * scale[0]], axis=-1),
        axes=np.broadcast_to(np.diag([scale[1], scale[0]]), (*pixels, 2, 2)).copy(),
        view=_unit(view),
        frame=np.broadcast_to(_turn_z(rotation), (*pixels, 3, 3)).astype(np.float32),
        coverage=np.ones(pixels, np.float32),
    )


def tilted(base_size: tuple[int, int], level: float, pixels: tuple[int, int], degrees: float) -> Scene:
    """A plane seen from afar at an angle to its normal, from the side of -y; lights are given in the plane's own axes.

    A pixel is one texel of ``level`` wide, and on the plane longer than that by 1 / cos.

    Args:
        base_size, level, pixels: as in ``plane``.
        degrees: between the view and the normal.
    """
    x, y = _pixel_grid(pixels, (0.0, 0.0))
    scale, cosine = _texel_size(base_size, level), math.cos(math.radians(degrees))
    view = np.array([0.0, -math.sin(math.radians(degrees)), cosine])
    return Scene(
        name="tilted",
        level=level,
        base_size=base_size,
        centre=np.stack([x * scale[1], y * scale[0] / cosine], axis=-1),
        axes=np.broadcast_to(np.diag([scale[1], scale[0] / cosine]), (*pixels, 2, 2)).copy(),
        view=np.broadcast_to(view, (*pixels, 3)).astype(np.float32),
        frame=np.broadcast_to(np.eye(3), (*pixels, 3, 3)).astype(np.float32),
        coverage=np.ones(pixels, np.float32),
    )


def slanted(
    base_size: tuple[int, int],
    pixels: tuple[int, int] = (256, 256),
    shift: tuple[float, float] = (0.0, 0.0),
    rotation: float = 0.0,
) -> Scene:
    """A floor that runs from the camera to the horizon: level 0 at the bottom, past every level at the top.

    The camera stands one unit above the floor; the ray of a pixel falls by s units for each unit forwards, s from 1 in
    the bottom row (45 degrees) to 1 / height in the top one. One unit is ``height`` base texels. Arguments as in
    ``plane``; the lights turn about the floor's normal.
    """
    height, width = pixels
    x, y = _pixel_grid(pixels, shift)
    side = (x - 0.5 * width) / height
    # Half a row is kept below the horizon, which has no footprint.
    fall = (y + 0.5) / height
    axes = np.zeros((*pixels, 2, 2))
    axes[..., 0, 0] = 1.0 / fall
    axes[..., 0, 1] = -side / fall**2
    axes[..., 1, 1] = 1.0 / fall**2
    # Tangent to the right, bitangent away from the viewer, normal up.
    stand = np.array([(1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)])
    return Scene(
        name="slanted",
        level=None,
        base_size=base_size,
        centre=np.stack([side / fall * height, -height / fall], axis=-1),
        axes=axes,
        view=_unit(np.stack([-side, -np.ones_like(side), fall], axis=-1)),
        frame=np.broadcast_to(_turn_z(rotation) @ stand, (*pixels, 3, 3)).astype(np.float32),
        coverage=np.ones(pixels, np.float32),
    )


def sphere(
    base_size: tuple[int, int],
    level: float,
    pixels: tuple[int, int] = (256, 256),
    shift: tuple[float, float] = (0.0, 0.0),
    rotation: float = 0.0,
) -> Scene:
    """A ball seen from afar, the texture laid onto it from the front: one pixel is one texel of ``level`` everywhere.

    Arguments as in ``plane``; the lights turn about the axis to the viewer. The tangent frame is the shortest rotation
    of the world's to the surface normal.
    """
    x, y = _pixel_grid(pixels, shift)
    scale = _texel_size(base_size, level)
    radius = 0.5 * min(pixels)
    across, up = (x - 0.5 * pixels[1]) / radius, (0.5 * pixels[0] - y) / radius
    distance = np.hypot(across, up)
    # No pixel's surface stands edge-on: the rim is held at 80 degrees.
    inside = np.minimum(distance, 0.985) / np.maximum(distance, 1e-9)
    n_x, n_y = across * inside, up * inside
    n_z = np.sqrt(1.0 - n_x * n_x - n_y * n_y)
    k = 1.0 / (1.0 + n_z)
    frame = np.empty((*pixels, 3, 3))
    frame[..., 0, :] = np.stack([1.0 - n_x * n_x * k, -n_x * n_y * k, -n_x], axis=-1)
    frame[..., 1, :] = np.stack([-n_x * n_y * k, 1.0 - n_y * n_y * k, -n_y], axis=-1)
    frame[..., 2, :] = np.stack([n_x, n_y, n_z], axis=-1)
    return Scene(
        name="sphere",
        level=level,
        base_size=base_size,
        centre=np.stack([x * scale[1], y * scale[0]], axis=-1),
        axes=np.broadcast_to(np.diag([scale[1], scale[0]]), (*pixels, 2, 2)).copy(),
        view=frame[..., :, 2].astype(np.float32),
        frame=(frame @ _turn_z(rotation)).astype(np.float32),
        coverage=np.clip((1.0 - distance) * radius + 0.5, 0.0, 1.0).astype(np.float32),
    )


def side_by_side(parts: Sequence[Scene]) -> Scene:
    """Join scenes of one height: one call renders all, and the reference shares samples of equal footprints."""
    arrays = ("centre", "axes", "view", "frame", "coverage")
    joined: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts], axis=1) for name in arrays}
    return dataclasses.replace(parts[0], **joined)


def level_of_detail(scene: Scene) -> NDArray:
    """Continuous MIP level (h, w) float32 of each pixel: log2 of the longer axis of its footprint in base texels.

    The longer axis is what graphics hardware takes without anisotropic filtering (Vulkan and Direct3D alike): the shape
    of the footprint that a level stands for is a square, and a square that covers the footprint blurs where a smaller
    one would alias. It is not clamped to the levels of the texture.
    """
    longest = np.sqrt(np.max(np.sum(np.square(scene.axes), axis=-2), axis=-1))
    return np.log2(longest).astype(np.float32)


def into_frame(vector: NDArray, normal: NDArray) -> NDArray:
    """Vectors (..., 3) in the frame of unit normals (..., 3): the one that the shortest rotation of z to n carries.

    R'w = (w_xy - k n_xy, n.w) with k = (w_xy.n_xy) / (1 + n_z) + w_z. (n_z = -1 has no shortest rotation.)
    """
    along = np.sum(vector[..., :2] * normal[..., :2], axis=-1)
    k = along / np.maximum(1.0 + normal[..., 2], 1e-6) + vector[..., 2]
    across = vector[..., :2] - k[..., None] * normal[..., :2]
    return np.concatenate([across, (along + vector[..., 2] * normal[..., 2])[..., None]], axis=-1)


def _pixel_grid(pixels: tuple[int, int], shift: tuple[float, float]) -> tuple[NDArray, NDArray]:
    """(x, y) of pixel centres, each (h, w) float64."""
    x, y = np.meshgrid(np.arange(pixels[1]) + 0.5 + shift[0], np.arange(pixels[0]) + 0.5 + shift[1])
    return x, y


def _texel_size(base_size: tuple[int, int], level: float) -> tuple[float, float]:
    """(height, width) in base texels of one texel of a level."""
    sizes = level_sizes(base_size)
    if not 0 <= level <= len(sizes) - 1:
        raise ValueError(f"level is {level}, expected 0 to {len(sizes) - 1} for a texture of {base_size}")
    if level != int(level):
        return 2.0**level, 2.0**level
    height, width = sizes[int(level)]
    return base_size[0] / height, base_size[1] / width


def _turn_z(angle: float) -> NDArray:
    """The rotation by ``angle`` about the z axis."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([(cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)])


def _unit(vector: NDArray) -> NDArray:
    return (vector / np.linalg.norm(vector, axis=-1, keepdims=True)).astype(np.float32)
