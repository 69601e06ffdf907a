"""Generators of surfaces whose height is seen: stones, rock, foam, cloth and plates that hide and shade each other.

They are of the kinds that Kuznetsov et al. (2021) show, made for what a height map traced as geometry does to them.
"""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from brdffit.textures.encoding import height_gradient, normals_from_gradient
from brdffit.textures.patterns import Color, Maps, frequencies, grain, noise, periodic, scattered, unit_range


def relief(height: NDArray, depth: float, color: NDArray, roughness: NDArray) -> Maps:
    """Maps of a height brought to a range of ``depth`` texture widths; normals are its slopes."""
    size = len(height)
    height = depth * unit_range(height)
    return Maps(
        color=np.clip(color, 0.0, 1.0),
        normal=normals_from_gradient(height_gradient(height, "tile") * size),
        roughness=roughness,
        height=height,
    )


def cells(size: int, points: NDArray, bend: NDArray, stretch: float = 1.0) -> tuple[NDArray, NDArray]:
    """(size, size) index of each texel's nearest point on the torus, and the distance to the border of that cell.

    ``bend`` (size, size, 2) moves the texels, in texture widths, so that borders are not straight; cells are
    ``stretch`` times as wide as high.
    """
    axis, box = (np.arange(size) + 0.5) / size, np.array([1.0, stretch])
    at = (np.stack(np.meshgrid(axis, axis), axis=2) + bend) % 1.0
    # The nearest border need not be that of the second nearest point.
    distance, index = cKDTree(points * box, boxsize=box).query(at * box, k=6)
    apart = box * periodic(points[index[..., 1:]] - points[index[..., :1]])
    further = distance[..., 1:] ** 2 - distance[..., :1] ** 2
    border = further / (2.0 * np.maximum(np.linalg.norm(apart, axis=-1), 1e-9))
    return index[..., 0], border.min(axis=-1)


class Pebbles(msgspec.Struct, forbid_unknown_fields=True):
    """Smooth stones of several sizes on sand, each of its own colour; the larger ones lie on top."""

    stones: list[Color]
    sand: Color
    count: int
    radius: tuple[float, float]
    flatness: float
    depth: float
    roughness: tuple[float, float]

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        axis = (np.arange(size) + 0.5) / size
        fine, cloud, dunes = grain(size, rng, 0.2 * size), grain(size, rng, 24.0), grain(size, rng, 5.0)
        height = 0.0035 * dunes + 0.0006 * fine
        color = np.array(self.sand) * (1.0 + 0.16 * fine + 0.08 * cloud)[:, :, None]
        smooth, rough = self.roughness
        roughness = rough * (1.0 + 0.03 * fine)
        small, large = self.radius
        radii = np.sort(small * (large / small) ** rng.random(self.count) ** 1.5)
        for radius, (x0, y0) in zip(radii, scattered(rng, self.count), strict=True):
            turn, stretch = rng.uniform(0.0, np.pi), rng.uniform(1.0, 1.5)
            reach = 1.2 * radius * stretch
            near = np.ix_(*(np.flatnonzero(np.abs(periodic(axis - centre)) < reach) for centre in (y0, x0)))
            x, y = np.meshgrid(periodic(axis - x0)[near[1].ravel()], periodic(axis - y0)[near[0].ravel()])
            spots, specks = cloud[near], fine[near]
            along = (np.cos(turn) * x + np.sin(turn) * y) / (radius * stretch)
            across = (-np.sin(turn) * x + np.cos(turn) * y) / radius
            # A little square, as stones are; sunk by a third, so that no wall is upright.
            q = (np.abs(along) ** 2.4 + np.abs(across) ** 2.4) * (1.0 + 0.07 * spots)
            top = self.flatness * radius * (np.sqrt(np.clip(1.0 - q, 0.0, None)) - 0.3 + 0.012 * spots)
            over = (top > height[near]) & (q < 1.0)
            height[near] = np.where(over, top, height[near])
            tone = np.array(self.stones[rng.integers(len(self.stones))]) * rng.uniform(0.75, 1.2)
            bands = 1.0 + 0.15 * np.sin(9.0 * along + 3.0 * spots + rng.uniform(0, 6)) * rng.random()
            tones = tone * (bands * (1.0 + 0.06 * spots + 0.05 * specks))[..., None]
            color[near] = np.where(over[..., None], tones, color[near])
            polish = smooth + 0.45 * (rough - smooth) * rng.random()
            roughness[near] = np.where(over, polish * (1.0 + 0.06 * spots), roughness[near])
        return relief(height, self.depth, color, roughness)


class CliffRock(msgspec.Struct, forbid_unknown_fields=True):
    """Layers of rock broken along planes: ledges, tilted faces and cracks."""

    colors: list[Color]
    blocks: int
    layers: int
    tilt: float
    depth: float
    roughness: tuple[float, float]

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        fx, fy = frequencies(size)
        broad = noise(size, rng, np.hypot(fx, fy).clip(1.0) ** -2.2 * (np.hypot(fx, fy) > 0.5))
        fine = noise(size, rng, np.hypot(fx, fy).clip(6.0) ** -1.6)
        row = (np.arange(size)[:, None] + 0.5) / size
        bend = 0.006 * np.stack([grain(size, rng, 11.0), grain(size, rng, 11.0)], axis=2)
        index, border = cells(size, scattered(rng, self.blocks), bend, 1.7)
        face = rng.normal(0.0, 1.0, (self.blocks, 3))
        centre_x, centre_y = np.zeros(self.blocks), np.zeros(self.blocks)
        axis = (np.arange(size) + 0.5) / size
        x, y = np.meshgrid(axis, axis)
        for k in range(self.blocks):
            inside = index == k
            if inside.any():
                # On the torus the mean is that of the angles.
                centre_x[k] = np.angle(np.exp(2j * np.pi * x[inside]).mean()) / (2.0 * np.pi)
                centre_y[k] = np.angle(np.exp(2j * np.pi * y[inside]).mean()) / (2.0 * np.pi)
        tilted = self.tilt * (
            face[index, 0] * periodic(x - centre_x[index]) + face[index, 1] * periodic(y - centre_y[index])
        )
        phase = row * self.layers + 0.35 * broad + 0.25 * face[index, 2]
        step = phase - np.floor(phase)
        ledge = np.minimum(step / 0.8, (1.0 - step) / 0.2)
        crack = np.exp(-((border / 0.004) ** 2))
        height = 0.03 * broad + tilted + 0.022 * ledge + 0.014 * face[index, 2] - 0.012 * crack
        # Edges are worn: a cell's wall is not upright.
        height = gaussian_filter(height, 0.0035 * size, mode="wrap") + 0.0018 * fine
        place = np.clip(0.45 + 0.18 * fine + 0.16 * face[index, 2] + 0.12 * broad - 0.35 * crack, 0.0, 1.0)
        stops = np.linspace(0.0, 1.0, len(self.colors))
        color = np.stack([np.interp(place, stops, channel) for channel in zip(*self.colors, strict=True)], axis=2)
        smooth, rough = self.roughness
        return relief(height, self.depth, color, rough + (smooth - rough) * place)


class FoamBlobs(msgspec.Struct, forbid_unknown_fields=True):
    """Blobs that swelled into each other, with deep folds between them and small bubbles on them."""

    color: Color
    fold: Color
    blobs: int
    radius: tuple[float, float]
    depth: float
    roughness: tuple[float, float]

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        axis = (np.arange(size) + 0.5) / size
        lumps, fine = grain(size, rng, 30.0), grain(size, rng, 0.16 * size)
        highest, second = np.zeros((size, size)), np.zeros((size, size))
        small, large = self.radius
        for x0, y0 in scattered(rng, self.blobs):
            radius = rng.uniform(small, large)
            x, y = np.meshgrid(periodic(axis - x0), periodic(axis - y0))
            q = (x * x + y * y) / radius**2 * (1.0 + 0.03 * lumps)
            top = radius * (0.35 + rng.uniform(0.0, 0.5)) * np.sqrt(np.clip(1.0 - 0.92 * q, 0.0, None))
            second = np.maximum(second, np.minimum(highest, top))
            highest = np.maximum(highest, top)
        # Where two blobs are equally high they meet in a fold.
        near = np.exp(-(((highest - second) / 0.006) ** 2))
        height = highest - 0.006 * near + 0.0012 * lumps + 0.0003 * fine
        shade = (1.0 + 0.05 * lumps + 0.03 * fine)[:, :, None]
        deep = np.clip(0.75 * near + 0.6 * (1.0 - unit_range(height)) ** 2, 0.0, 1.0)[:, :, None]
        color = (np.array(self.color) * (1.0 - deep) + np.array(self.fold) * deep) * shade
        smooth, rough = self.roughness
        return relief(height, self.depth, color, smooth + (rough - smooth) * deep[..., 0])


class WovenFabric(msgspec.Struct, forbid_unknown_fields=True):
    """A twill of twisted yarns: each goes over two and under two, one further in each row."""

    warp: Color
    weft: Color
    yarns: int
    twist: float
    fibre: float
    depth: float
    roughness: tuple[float, float]

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        axis = (np.arange(size) + 0.5) / size
        fuzz, cloud = grain(size, rng, 0.22 * size), grain(size, rng, 9.0)
        u, v = np.meshgrid(axis * self.yarns, axis * self.yarns)
        # Yarns are not quite straight.
        u = u + 0.07 * grain(size, rng, 10.0)
        v = v + 0.07 * grain(size, rng, 10.0)
        tops, tones = [], []
        for across, along, sign in ((u, v, 1.0), (v, u, -1.0)):
            number = np.floor(across).astype(int) % self.yarns
            x = 2.0 * (across - np.floor(across)) - 1.0
            # Over two, under two: the wave has four crossings, and each yarn begins one later.
            wave = np.cos(0.5 * np.pi * (along - 0.5 - number) - 0.25 * np.pi)
            wave = sign * wave if sign > 0 else -np.cos(0.5 * np.pi * (number - along + 0.5) - 0.25 * np.pi)
            strand = np.abs(np.sin(np.pi * (self.twist * along + 0.9 * x + 0.37 * number)))
            round_ = np.sqrt(np.clip(1.0 - (0.96 * x) ** 2, 0.0, None))
            tops.append(0.62 * wave + 0.75 * round_ + self.fibre * (strand * round_ + 0.08 * fuzz))
            shade = rng.uniform(0.85, 1.15, self.yarns)[number]
            tones.append(shade * (0.8 + 0.25 * strand) * (1.0 + 0.06 * fuzz + 0.04 * cloud))
        over = (tops[0] >= tops[1])[..., None]
        color = np.where(over, np.array(self.warp) * tones[0][..., None], np.array(self.weft) * tones[1][..., None])
        smooth, rough = self.roughness
        return relief(np.maximum(*tops), self.depth, color, smooth + (rough - smooth) * np.clip(0.5 + 0.2 * fuzz, 0, 1))


class TurtleShell(msgspec.Struct, forbid_unknown_fields=True):
    """Plates with rings of growth around a raised middle, and grooves between them."""

    light: Color
    dark: Color
    plates: int
    rings: int
    groove: float
    depth: float
    roughness: tuple[float, float]

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        cloud, fine = grain(size, rng, 16.0), grain(size, rng, 0.2 * size)
        points = scattered(rng, self.plates)
        bend = 0.008 * np.stack([grain(size, rng, 4.0), grain(size, rng, 4.0)], axis=2)
        index, border = cells(size, points, bend)
        widest = np.zeros(self.plates)
        np.maximum.at(widest, index.ravel(), border.ravel())
        inward = np.clip(border / np.maximum(widest[index], 1e-9), 0.0, 1.0)
        ring = inward * self.rings + 0.03 * cloud
        step = ring - np.floor(ring)
        terrace = (np.floor(ring) + np.clip((step - 0.5) / 0.5, 0.0, 1.0) ** 2) / self.rings
        rise = np.clip(border / self.groove, 0.0, 1.0)
        height = 0.5 * np.sqrt(1.0 - (1.0 - rise) ** 2) + 0.3 * inward + 0.2 * terrace + 0.008 * cloud * rise
        axis = (np.arange(size) + 0.5) / size
        x, y = np.meshgrid(axis, axis)
        angle = np.arctan2(periodic(y - points[index, 1]), periodic(x - points[index, 0]))
        rays = 0.5 + 0.5 * np.sin(7.0 * angle + rng.uniform(0, 6, self.plates)[index] + 1.5 * cloud)
        blotch = np.clip(0.9 * inward + 0.7 * rays * (1.0 - inward) - 0.25 + 0.12 * fine, 0.0, 1.0)
        tone = np.array(self.dark) + (np.array(self.light) - np.array(self.dark)) * blotch[..., None]
        color = tone * (rise * (1.0 - 0.25 * (step > 0.85)) + 0.35 * (1.0 - rise))[..., None]
        smooth, rough = self.roughness
        return relief(height, self.depth, color, rough + (smooth - rough) * rise * (1.0 + 0.08 * fine))
