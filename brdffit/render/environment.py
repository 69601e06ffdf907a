"""Light from all around: an equirectangular picture of radiance, how it is sampled, and the one that ships.

World axes: x to the right, y up, z towards the viewer. Row 0 is straight up; the middle column is straight ahead of the
camera (-z), a quarter to the right of it is the camera's right (+x).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import LUMINANCE
from brdffit.render.sampling import R2, lobe_rows

#: Share of the samples that are drawn evenly, whatever the luminance, and samples in the table.
_EVENLY, _TABLE = 1e-3, 1 << 15
#: Size in radians of the blocks that diffuse light is summed over, and planes that are computed at a time.
_COARSE, _FRAMES = 0.12, 1024


@dataclass(frozen=True)
class Environment:
    """Radiance from all directions.

    Attributes:
        radiance: (H, W, 3) float32 linear RGB, equirectangular; constant inside a pixel.
        rotation: angle in radians by which the surroundings are turned about the y axis.
    """

    radiance: NDArray
    rotation: float = 0.0

    def __post_init__(self) -> None:
        radiance = np.ascontiguousarray(self.radiance, np.float32)
        if radiance.ndim != 3 or radiance.shape[2] != 3 or not radiance.size:
            raise ValueError(f"radiance has shape {radiance.shape}, expected (H, W, 3)")
        if not (np.isfinite(radiance).all() and (radiance >= 0.0).all()):
            raise ValueError("radiance holds numbers that are negative or not finite")
        object.__setattr__(self, "radiance", radiance)

    def rotated(self, angle: float) -> Environment:
        """The same surroundings, turned by ``angle`` more radians about the y axis (counter-clockwise from above)."""
        return Environment(self.radiance, self.rotation + angle)

    @cached_property
    def solid_angle(self) -> NDArray:
        """(H,) float64 solid angle of the pixels of each row; they sum to 4 pi over the picture."""
        height, width = self.radiance.shape[:2]
        edge = np.cos(np.linspace(0.0, math.pi, height + 1))
        return (edge[:-1] - edge[1:]) * (2.0 * math.pi / width)

    def total(self) -> NDArray:
        """(3,) float64 integral of the radiance over all directions."""
        return np.einsum("h,hwc->c", self.solid_angle, self.radiance.astype(np.float64))

    @cached_property
    def density(self) -> NDArray:
        """(H, W) float64 density, per steradian, of the directions that ``samples`` draws: as luminance goes.

        A thousandth is drawn evenly from everywhere, so that no direction is left out.
        """
        luminance = self.radiance.astype(np.float64) @ LUMINANCE.astype(np.float64)
        total = float(self.solid_angle @ luminance.sum(axis=1))
        if total <= 0.0:
            return np.full(luminance.shape, 0.25 / math.pi)
        return (1.0 - _EVENLY) * luminance / total + _EVENLY * 0.25 / math.pi

    def samples(self, count: int) -> tuple[NDArray, NDArray]:
        """(count, 3) float64 directions drawn by importance, without ``rotation``, and (count, 2) int64 row and column.

        The points are those of a two-dimensional additive recurrence (Roberts 2018), carried through the distribution
        of rows and that of columns in a row; any run of them is well spread. Same picture, same samples.
        """
        height, width = self.radiance.shape[:2]
        mass = self.density * self.solid_angle[:, None]
        of_rows = np.cumsum(mass.sum(axis=1))
        j = np.arange(count)
        u, w = (0.5 + R2[0] * j) % 1.0 * of_rows[-1], (0.5 + R2[1] * j) % 1.0
        row = np.minimum(np.searchsorted(of_rows, u, side="right"), height - 1)
        part = (u - np.where(row > 0, of_rows[row - 1], 0.0)) / np.diff(of_rows, prepend=0.0)[row]
        # One ascending sequence over all rows: row number plus the distribution inside the row.
        inside = np.cumsum(mass, axis=1)
        inside = np.arange(height)[:, None] + inside / inside[:, -1:]
        column = np.searchsorted(inside.ravel(), row + w * (1.0 - 1e-12), side="right") - row * width
        column = np.clip(column, 0, width - 1)
        low = np.where(column > 0, inside[row, column - 1], row)
        across = (row + w - low) / (inside[row, column] - low)
        edge = np.cos(np.arange(height + 1) * math.pi / height)
        y = edge[row] + (edge[row + 1] - edge[row]) * np.clip(part, 0.0, 1.0)
        azimuth = ((column + np.clip(across, 0.0, 1.0)) / width * 2.0 - 1.0) * math.pi
        level = np.sqrt(np.maximum(1.0 - y * y, 0.0))
        return np.stack([level * np.sin(azimuth), y, -level * np.cos(azimuth)], -1), np.stack([row, column], -1)

    def turned(self, frame: NDArray) -> NDArray:
        """Frames (n, 3, 3) relative to ``radiance``: turning the surroundings turns the surface the other way."""
        cos, sin = math.cos(self.rotation), math.sin(self.rotation)
        turn = np.array([(cos, 0.0, sin), (0.0, 1.0, 0.0), (-sin, 0.0, cos)])
        return np.ascontiguousarray(frame @ turn)

    def look_up(self, direction: NDArray) -> tuple[NDArray, NDArray]:
        """Radiance (n, 3) and ``density`` (n,) in some directions (n, 3), without ``rotation``."""
        height, width = self.radiance.shape[:2]
        x, y, z = direction.T
        row = np.int64((0.5 - np.arctan2(y, np.hypot(x, z)) / math.pi) * height)
        column = np.int64((0.5 + 0.5 * np.arctan2(x, -z) / math.pi) * width)
        row, column = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
        return self.radiance[row, column], self.density[row, column]

    @cached_property
    def table(self) -> NDArray:
        """(TABLE_ROWS, n) float32, the samples that the compiled loops use: see ``_environment_kernels``."""
        direction, at = self.samples(_TABLE)
        row, column = at.T
        radiance, density = self.radiance[row, column], self.density[row, column]
        return np.stack([*lobe_rows(_TABLE), *direction.T, *radiance.T, density]).astype(np.float32)

    @cached_property
    def picture(self) -> NDArray:
        """(H, W, 4) float32: radiance and ``density``."""
        return np.concatenate([self.radiance, self.density[..., None]], axis=-1, dtype=np.float32, casting="same_kind")

    def harmonics(self, up: NDArray, fresnel: bool, cosine: bool = True, clips: bool = True) -> NDArray:
        """E(n) and E_w(n) over pi as quadratic functions of the normal n, for planes of normals ``up`` (K, 3).

        Only light above the plane counts. E is the irradiance over pi; E_w the same with Schlick's (1 - n.l)^5 as
        another weight (0 without ``fresnel``). Without ``cosine`` n.l is left out, and without ``clips`` the horizon of
        n. Radiance and normals without ``rotation``.

        Of the radiance above the plane the spherical harmonics up to degree 2 are taken, each degree scaled by that of
        the kernel (Funk and Hecke; Ramamoorthi and Hanrahan 2001: 1% off on average for the cosine, 3% under a single
        lamp); a constant is added that makes it right where n is the plane's normal.

        Returns:
            (K, 2, 9, 3) float32 coefficients of 1, x, y, z, xy, yz, xz, x^2 - y^2, 3 z^2 - 1.
        """
        direction, light = self._coarse
        basis = _quadratic_basis(direction)
        squared_norm = 4.0 * math.pi / np.array([1.0, 3.0, 3.0, 3.0, 15.0, 15.0, 15.0, 15.0 / 4.0, 5.0 / 4.0])
        projector = (basis[:, :, None] * light[:, None, :]).reshape(len(light), 27)
        low = 0.0 if clips else -1.0
        t, weight = np.polynomial.legendre.leggauss(64)
        t, weight = low + 0.5 * (1.0 - low) * (t + 1.0), 0.5 * (1.0 - low) * weight
        scale = []
        for k in (0, 1):
            kernel = (t if cosine else np.ones_like(t)) * ((1.0 - np.maximum(t, 0.0)) ** 5 if k else 1.0) / math.pi
            degrees = [2.0 * math.pi * float(np.sum(weight * kernel * p)) for p in (1.0, t, 1.5 * t * t - 0.5)]
            scale.append(np.repeat(degrees, (1, 3, 5)) / squared_norm)
        out = np.zeros((len(up), 2, 9, 3), np.float32)
        for first in range(0, len(up), _FRAMES):
            part = slice(first, first + _FRAMES)
            height = up[part].astype(np.float32) @ direction.T
            # A block of the picture that the plane cuts counts by its share.
            seen = np.clip(height / np.float32(_COARSE) + np.float32(0.5), 0.0, 1.0)
            projected = (seen @ projector).reshape(-1, 9, 3)
            of_plane = _quadratic_basis(up[part])
            seen *= np.float32(1.0 / math.pi)
            if cosine:
                seen *= np.maximum(height, 0.0)
            for k in range(2 if fresnel else 1):
                found = scale[k][:, None] * projected
                if k:
                    grazing = np.clip(np.float32(1.0) - height, 0.0, 1.0)
                    seen *= np.square(np.square(grazing)) * grazing
                found[:, 0] += seen @ light - np.einsum("pk,pkc->pc", of_plane, found)
                out[part, k] = found
        return out

    @cached_property
    def _coarse(self) -> tuple[NDArray, NDArray]:
        """Directions (m, 3) and radiance times solid angle (m, 3), float32, as coarse as diffuse light allows.

        Blocks of whole pixels, each in the mean direction that its light comes from.
        """
        height, width = self.radiance.shape[:2]
        step = max(1, round(height * _COARSE / math.pi)), max(1, round(width * _COARSE / (2.0 * math.pi)))
        edge = np.cos(np.arange(height + 1) * math.pi / height)
        y = 0.5 * (edge[:-1] + edge[1:])[:, None]
        azimuth = ((np.arange(width) + 0.5) / width * 2.0 - 1.0)[None] * math.pi
        level = np.sqrt(1.0 - y * y)
        towards = np.stack([level * np.sin(azimuth), np.broadcast_to(y, (height, width)), -level * np.cos(azimuth)], -1)
        area = np.broadcast_to(self.solid_angle[:, None, None], (height, width, 1))
        starts = [np.arange(0, size, each) for size, each in zip((height, width), step, strict=True)]

        def summed(values: NDArray) -> NDArray:
            rows = np.add.reduceat(values, starts[0], axis=0)
            return np.add.reduceat(rows, starts[1], axis=1).reshape(-1, values.shape[2])

        luminance = self.radiance.astype(np.float64) @ LUMINANCE + 1e-30
        direction = summed(towards * area * luminance[..., None])
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        return direction.astype(np.float32), summed(self.radiance * area).astype(np.float32)


def _quadratic_basis(direction: NDArray) -> NDArray:
    """(m, 9) of 1, x, y, z, xy, yz, xz, x^2 - y^2, 3 z^2 - 1 for directions (m, 3)."""
    x, y, z = direction.T
    return np.stack([np.ones_like(x), x, y, z, x * y, y * z, x * z, x * x - y * y, 3.0 * z * z - 1.0], axis=-1)


def procedural_environment(height: int = 256) -> Environment:
    """The environment that ships: a studio with three soft boxes, four small bright lamps, and a floor that fades.

    ``height`` rows and twice as many columns.
    """
    row, column = np.meshgrid(np.arange(height) + 0.5, np.arange(2 * height) + 0.5, indexing="ij")
    elevation = (0.5 - row / height) * math.pi
    azimuth = (column / height - 1.0) * math.pi
    up = np.sin(elevation)[..., None]
    warm, cool = np.array([1.0, 0.93, 0.84]), np.array([0.84, 0.92, 1.0])
    # Walls grow a little brighter upwards; the floor is brightest below the camera.
    walls = 0.10 * cool * (0.6 + 0.8 * np.maximum(up, 0.0))
    floor = 0.16 * warm * np.square(np.maximum(-up, 0.0)) + 0.045
    radiance = np.where(up > 0.0, walls, floor)

    def box(at: tuple[float, float], size: tuple[float, float], colour: NDArray) -> None:
        """A soft box with rounded shoulders: centre and half size in degrees of azimuth and elevation."""
        x = np.abs((np.degrees(azimuth) - at[0] + 180.0) % 360.0 - 180.0) / size[0]
        y = np.abs(np.degrees(elevation) - at[1]) / size[1]
        inside = np.clip((1.0 - np.maximum(x, y)) * 12.0, 0.0, 1.0)
        radiance[...] += (inside * (1.0 - 0.3 * y * y))[..., None] * colour

    def lamp(at: tuple[float, float], radius: float, colour: NDArray) -> None:
        """A round lamp: centre in degrees of azimuth and elevation, radius in degrees."""
        to = np.radians(at)
        cosine = np.sin(elevation) * math.sin(to[1]) + np.cos(elevation) * math.cos(to[1]) * np.cos(azimuth - to[0])
        distance = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        inside = np.clip((radius - distance) * height / 180.0 + 0.5, 0.0, 1.0)
        radiance[...] += inside[..., None] * colour

    # Azimuth 0 is ahead of the camera, 180 behind it, where a surface that faces the camera looks.
    box((140.0, 35.0), (22.0, 18.0), 7.0 * warm)
    box((-120.0, 25.0), (9.0, 38.0), 5.0 * cool)
    box((0.0, 40.0), (50.0, 6.0), 4.0 * np.ones(3))
    lamp((-165.0, 52.0), 2.2, 260.0 * warm)
    lamp((165.0, -8.0), 1.5, 180.0 * cool)
    lamp((-150.0, 5.0), 1.2, 220.0 * np.array([1.0, 0.72, 0.45]))
    lamp((25.0, 22.0), 1.8, 160.0 * np.ones(3))
    return Environment(radiance)
