"""Cut-out leaves: waxy, veined, curled, scattered over a texture that is transparent elsewhere."""

from __future__ import annotations

import msgspec
import numpy as np

from brdffit.textures.encoding import height_gradient, normals_from_gradient
from brdffit.textures.patterns import Color, Maps, grain, periodic, scattered


class LeafLitter(msgspec.Struct, forbid_unknown_fields=True):
    """Leaves that do not overlap by more than their tips; later ones lie above earlier ones."""

    young: Color
    old: Color
    vein: Color
    leaves: int
    length: float
    width: float
    curl: float
    groove: float
    roughness: tuple[float, float]

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        axis = (np.arange(size) + 0.5) / size
        fine = grain(size, rng, 0.2 * size)
        cloud = grain(size, rng, 14.0)
        gradient, opacity = np.zeros((size, size, 2)), np.zeros((size, size))
        color, rough = np.zeros((size, size, 3)), np.full((size, size), self.roughness[1])
        for x0, y0 in scattered(rng, self.leaves):
            turn, scale, age = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.8, 1.1), rng.random()
            x, y = np.meshgrid(periodic(axis - x0), periodic(axis - y0))
            along = (np.cos(turn) * x + np.sin(turn) * y) / (0.5 * scale * self.length)
            across = (-np.sin(turn) * x + np.cos(turn) * y) / (0.5 * scale * self.length)
            # Widest a little before the middle, pointed at the tip, with small teeth.
            inside = np.clip(1.0 - along**2, 0.0, None)
            teeth = 1.0 + 0.05 * np.abs((along * 14.0) % 1.0 - 0.5)
            edge = self.width * inside**0.75 * (1.0 - 0.25 * along) * teeth
            stalk = np.where((along > -1.25) & (along < -0.9), 0.022, 0.0)
            distance = (np.maximum(edge, stalk) - np.abs(across)) * 0.5 * scale * self.length * size
            mask = np.clip(distance + 0.5, 0.0, 1.0) * ((np.abs(along) < 1.0) | (stalk > 0.0))
            rib = np.exp(-((across / 0.02) ** 2))
            side = np.abs((along * 5.0 - 3.2 * np.abs(across)) % 1.0 - 0.5)
            veins = np.maximum(rib, 0.6 * np.exp(-((side / 0.05) ** 2)) * (edge > 0.02))
            shape = self.curl * (across**2 - 0.15 * np.sin(2.5 * along + 6.0 * age)) - self.groove * veins
            tone = np.array(self.young) * (1.0 - age) + np.array(self.old) * age
            tone = tone * (1.0 + 0.12 * cloud + 0.05 * fine)[:, :, None]
            tone += (np.array(self.vein) - tone) * (0.7 * veins)[:, :, None]
            over = mask > 0.0
            # Slopes of the leaf alone: its border is no step of the surface.
            gradient[over] = height_gradient(shape * 0.5 * scale * self.length * size, "tile")[over]
            color[over] = tone[over]
            waxy, dry = self.roughness
            rough[over] = (waxy + (dry - waxy) * np.clip(0.5 * age + 0.5 * veins + 0.04 * fine, 0.0, 1.0))[over]
            opacity = np.maximum(opacity, mask)
        return Maps(
            color=np.clip(color, 0.0, 1.0),
            normal=normals_from_gradient(np.clip(gradient, -1.5, 1.5)),
            roughness=np.clip(rough, 0.0, 1.0),
            opacity=opacity,
        )
