"""Generators of procedural texture sets; each makes the maps of one kind of surface from a recipe's parameters.

Lengths are in widths of the texture, so that a set looks alike at every size.
"""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from brdffit.textures.displaced import CliffRock, FoamBlobs, Pebbles, TurtleShell, WovenFabric
from brdffit.textures.encoding import height_gradient, normals_from_gradient
from brdffit.textures.facade import GlassPanes
from brdffit.textures.foliage import LeafLitter
from brdffit.textures.patterns import Color, Maps, frequencies, grain, noise, periodic, scattered, step, unit_range
from brdffit.textures.strokes import BrushStrokes


class BrushedMetal(msgspec.Struct, forbid_unknown_fields=True):
    """Streaks along x from filtered noise, and straight scratches."""

    color: Color
    slope: float
    streak_length: float
    scratches: int
    roughness: float

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        fx, fy = frequencies(size)
        streak = np.exp(-0.5 * (fx * self.streak_length) ** 2)
        fine = noise(size, rng, streak * np.exp(-0.5 * (fy / 0.16 / size) ** 2) * (fy > 3))
        broad = noise(size, rng, streak * ((fy >= 1) & (fy < 12)))
        height = fine.copy()
        row = (np.arange(size) + 0.5) / size
        for _ in range(self.scratches):
            start, length, centre = rng.random(), rng.uniform(0.1, 0.5), rng.random()
            along = periodic(row - start)
            profile = np.exp(-((periodic(row - centre) * size / 0.9) ** 2))
            height -= 3.0 * rng.uniform(0.4, 1.0) * np.outer(profile, np.clip(1.0 - np.abs(along) / length, 0.0, 1.0))
        gradient = height_gradient(height, "tile")
        scale = self.slope / float(gradient[:, :, 1].std())
        shade = 1.0 + 0.05 * broad - 0.03 * fine
        return Maps(
            color=np.clip(np.array(self.color) * shade[:, :, None], 0.0, 1.0),
            normal=normals_from_gradient(gradient * scale),
            roughness=self.roughness * (1.0 + 0.1 * broad + 0.06 * fine),
            metallic=np.ones((size, size)),
        )


class HammeredMetal(msgspec.Struct, forbid_unknown_fields=True):
    """Lower envelope of spherical dimples, rounded at the ridges where they meet."""

    color: Color
    dimples: int
    curvature: float
    ridge: float
    roughness: tuple[float, float]

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        centres = scattered(rng, self.dimples)
        depth = rng.uniform(0.0, 1.4 / self.dimples, self.dimples) * 0.5 * self.curvature
        bend = self.curvature * rng.uniform(0.85, 1.2, self.dimples)
        hue = rng.normal(0.0, 1.0, self.dimples)
        reach = 2.6 / np.sqrt(self.dimples)
        axis = (np.arange(size) + 0.5) / size
        envelope, tint = np.full((size, size), 1e-300), np.zeros((size, size))
        for i, (cx, cy) in enumerate(centres):
            dx, dy = periodic(axis - cx), periodic(axis - cy)
            columns, rows = np.flatnonzero(np.abs(dx) < reach), np.flatnonzero(np.abs(dy) < reach)
            square = dy[rows, None] ** 2 + dx[None, columns] ** 2
            weight = np.exp(-(0.5 * bend[i] * square - depth[i]) / self.ridge)
            envelope[np.ix_(rows, columns)] += weight
            tint[np.ix_(rows, columns)] += hue[i] * weight
        height = -self.ridge * np.log(envelope)
        tint /= envelope
        fine = grain(size, rng, 60.0)
        cloud = grain(size, rng, 5.0)
        ridges = unit_range(height) ** 2
        low, high = self.roughness
        shade = 1.0 + 0.03 * tint + 0.04 * cloud - 0.25 * ridges
        color = np.array(self.color) ** (1.0 + 0.12 * ridges + 0.03 * cloud)[:, :, None] * shade[:, :, None]
        return Maps(
            color=np.clip(color, 0.0, 1.0),
            normal=normals_from_gradient(height_gradient(height, "tile") * size),
            roughness=low + (high - low) * np.clip(ridges + 0.12 * cloud + 0.05 * fine, 0.0, 1.0),
            metallic=np.ones((size, size)),
            height=height,
        )


class GroovedRecord(msgspec.Struct, forbid_unknown_fields=True):
    """Concentric grooves with smooth bands between the tracks; a label; felt around the disc."""

    vinyl: Color
    label: Color
    felt: Color
    grooves: int
    slope: float
    modulation: float
    roughness: float

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        axis = (np.arange(size) + 0.5) / size - 0.5
        x, y = np.meshgrid(axis, -axis)
        radius, angle = np.hypot(x, y), np.arctan2(y, x)
        inner, outer, label, hole = 0.205, 0.465, 0.165, 0.012
        turn = (radius - inner) / (outer - inner) * self.grooves
        grooved = step(radius, inner, size) * (1.0 - step(radius, outer, size))
        for gap in (0.16, 0.39, 0.55, 0.79):
            band = inner + gap * (outer - inner)
            grooved *= np.clip(np.abs(radius - band) / 0.004 - 0.6, 0.0, 1.0)
        # The recorded signal bends each groove along the angle, its neighbours differently.
        bend = sum(np.cos(k * angle + rng.uniform(0, 6) + rng.uniform(2, 9) * turn) / k**0.5 for k in (5, 13, 29, 47))
        loud = 0.75 + 0.25 * np.cos(3.1 * turn / self.grooves * 6.28 + rng.uniform(0, 6))
        wall = self.slope * loud * grooved * np.cos(2.0 * np.pi * (turn + 0.05 * self.modulation * bend))
        across = 0.12 * self.modulation * self.slope * grooved * np.sin(31 * angle + 2.0 * turn)
        edge = -0.7 * np.exp(-(((radius - 0.482) / 0.004) ** 2)) - 0.25 * np.exp(-(((radius - label) / 0.003) ** 2))
        felt = step(radius, 0.484, size)
        paper = 1.0 - step(radius, label, size)
        paper *= step(radius, hole, size)
        fibre = grain(size, rng, 0.2 * size)
        fibre_gradient = height_gradient(fibre, "clamp")
        fibre_gradient *= (0.16 * felt + 0.02 * paper)[:, :, None] / float(fibre_gradient.std())
        unit_x, unit_y = np.cos(angle), np.sin(angle)
        radial = wall + edge * (1.0 - felt)
        gradient = np.stack([radial * unit_x - across * unit_y, radial * unit_y + across * unit_x], axis=2)
        ring = np.exp(-(((radius - 0.148) / 0.0025) ** 2)) + np.exp(-(((radius - 0.05) / 0.0025) ** 2))
        print_ = np.clip(ring + 0.8 * (np.abs(y - 0.09) < 0.012) * (np.abs(x) < 0.06), 0.0, 1.0) * paper
        color = np.array(self.vinyl) * (1.0 - felt)[:, :, None] + np.array(self.felt) * felt[:, :, None]
        color = color * (1.0 - paper)[:, :, None] + np.array(self.label) * paper[:, :, None]
        color = color * (1.0 - print_)[:, :, None] + np.array((0.75, 0.62, 0.35)) * print_[:, :, None]
        color = color * (1.0 + 0.18 * (felt + 0.15 * paper) * fibre)[:, :, None]
        return Maps(
            color=np.clip(color, 0.0, 1.0),
            normal=normals_from_gradient(gradient + fibre_gradient),
            roughness=self.roughness + (0.62 - self.roughness) * paper + (0.93 - self.roughness) * felt,
        )


class GlossyTiles(msgspec.Struct, forbid_unknown_fields=True):
    """Rounded tiles in a running bond, each a little tilted and of its own shade, in rough grout."""

    glaze: Color
    grout: Color
    tiles: tuple[int, int]
    joint: float
    bevel: float
    depth: float
    tilt: float
    ripple: float
    roughness: tuple[float, float]

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        across, down = self.tiles
        axis = (np.arange(size) + 0.5) / size
        u, v = np.meshgrid(axis * across, axis * down)
        row = v.astype(int)
        u = (u + 0.5 * (row % 2)) % across
        column = u.astype(int)
        # From the tile's centre, in texture widths.
        x, y = (u - column - 0.5) / across, (v - row - 0.5) / down
        half_x, half_y = 0.5 / across - 0.5 * self.joint, 0.5 / down - 0.5 * self.joint
        corner = 0.6 * self.bevel
        out_x, out_y = np.abs(x) - half_x + corner, np.abs(y) - half_y + corner
        inside = corner - np.hypot(np.maximum(out_x, 0), np.maximum(out_y, 0)) - np.minimum(np.maximum(out_x, out_y), 0)
        rise = np.clip(inside / self.bevel, 0.0, 1.0)
        profile = np.sqrt(np.clip(1.0 - (1.0 - rise) ** 2, 0.0, 1.0))
        tilt_x, tilt_y = rng.normal(0.0, self.tilt, (2, down, across))
        shade, lift = rng.normal(0.0, 1.0, (2, down, across))
        sand = grain(size, rng, 0.18 * size)
        wave = grain(size, rng, 9.0)
        speck = grain(size, rng, 40.0)
        wave_gradient = height_gradient(wave, "tile") * size
        plane = x * tilt_x[row, column] + y * tilt_y[row, column] + 0.0004 * lift[row, column]
        height = profile * (self.depth + plane + self.ripple / float(wave_gradient.std()) * wave)
        height += (1.0 - profile) * 0.0004 * sand
        is_tile = np.clip(inside * size + 0.5, 0.0, 1.0)
        tone = 1.0 + 0.22 * shade[row, column] + 0.05 * wave - 0.25 * (1.0 - rise)
        glaze = np.array(self.glaze) * tone[:, :, None]
        glaze[:, :, 1] *= 1.0 + 0.18 * lift[row, column]
        grout = np.array(self.grout) * (1.0 + 0.07 * sand + 0.06 * speck)[:, :, None]
        glossy, dull = self.roughness
        rough_tile = glossy * (1.0 + 0.15 * np.clip(speck, -2, 2) + 0.25 * shade[row, column].clip(-1, 2))
        return Maps(
            color=np.clip(grout + (glaze - grout) * is_tile[:, :, None], 0.0, 1.0),
            normal=normals_from_gradient(height_gradient(height, "tile") * size),
            roughness=dull * (1.0 + 0.05 * sand) * (1.0 - is_tile) + rough_tile * is_tile,
            height=height,
        )


class BumpyMirror(msgspec.Struct, forbid_unknown_fields=True):
    """Band-limited noise as height, smudges as roughness."""

    color: Color
    slope: float
    bumps: tuple[float, float]
    roughness: tuple[float, float]

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        fx, fy = frequencies(size)
        frequency = np.hypot(fx, fy)
        low, high = self.bumps
        height = noise(size, rng, np.exp(-((np.log(np.maximum(frequency, 0.5) / np.sqrt(low * high)) / 0.6) ** 2)))
        # Few and round rather than a random sea: the highest bumps stand out of a flatter ground.
        height = np.log1p(np.exp(1.8 * height)) / 1.8
        gradient = height_gradient(height, "tile") * size
        scale = self.slope / float(gradient.std())
        cloud = noise(size, rng, np.exp(-0.5 * (frequency / 4.0) ** 2))
        wipe = noise(size, rng, np.exp(-0.5 * ((fx + fy) / 5.0) ** 2 - 0.5 * ((fx - fy) / 60.0) ** 2))
        smudge = np.clip(0.5 * cloud + 0.2 * wipe - 0.15, 0.0, 1.0)
        clean, smudged = self.roughness
        color = np.array(self.color) * (1.0 - 0.05 * smudge)[:, :, None]
        return Maps(
            color=np.clip(color, 0.0, 1.0),
            normal=normals_from_gradient(gradient * scale),
            roughness=clean + (smudged - clean) * smudge,
            metallic=np.ones((size, size)),
            height=height * scale,
        )


class FractalRelief(msgspec.Struct, forbid_unknown_fields=True):
    """A height of all sizes of bumps, some of them ridges; colour and roughness follow the height and a noise."""

    colors: list[Color]
    slope: float
    cycles: tuple[float, float]
    falloff: float
    ridges: float
    patches: float
    roughness: tuple[float, float]

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        fx, fy = frequencies(size)
        cycles = np.hypot(fx, fy)
        low, high = self.cycles
        band = np.maximum(cycles, low) ** -self.falloff * (1.0 - np.exp(-((cycles / low) ** 4)))
        band *= np.exp(-0.5 * (cycles / high) ** 2)
        height = noise(size, rng, band)
        # A fold along the zeros of another noise, rounded, is a ridge.
        fold = -np.sqrt(np.square(noise(size, rng, band * np.exp(-0.5 * (cycles / (4.0 * low)) ** 2))) + 0.01)
        height += self.ridges * (fold - fold.mean()) / fold.std()
        gradient = height_gradient(height, "tile") * size
        scale = self.slope / float(gradient.std())
        cloud = noise(size, rng, np.exp(-0.5 * (cycles / (3.0 * low)) ** 2))
        place = np.clip(0.5 + 0.25 * (height / height.std() * (1.0 - self.patches) + self.patches * cloud), 0.0, 1.0)
        stops = np.linspace(0.0, 1.0, len(self.colors))
        rough, smooth = self.roughness[1], self.roughness[0]
        return Maps(
            color=np.stack([np.interp(place, stops, channel) for channel in zip(*self.colors, strict=True)], axis=2),
            normal=normals_from_gradient(gradient * scale),
            roughness=rough + (smooth - rough) * place,
            height=height * scale,
        )


GENERATORS: dict[str, Any] = {
    "brushed_metal": BrushedMetal,
    "hammered_metal": HammeredMetal,
    "grooved_record": GroovedRecord,
    "glossy_tiles": GlossyTiles,
    "bumpy_mirror": BumpyMirror,
    "fractal_relief": FractalRelief,
    "glass_panes": GlassPanes,
    "leaf_litter": LeafLitter,
    "pebbles": Pebbles,
    "cliff_rock": CliffRock,
    "foam_blobs": FoamBlobs,
    "woven_fabric": WovenFabric,
    "turtle_shell": TurtleShell,
    "brush_strokes": BrushStrokes,
}
