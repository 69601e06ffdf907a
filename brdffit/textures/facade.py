"""A glass facade: panes that are near-mirrors, each a little out of plane, in dull frames, with dust at their feet."""

from __future__ import annotations

import msgspec
import numpy as np

from brdffit.textures.encoding import height_gradient, normals_from_gradient
from brdffit.textures.patterns import Color, Maps, grain


class GlassPanes(msgspec.Struct, forbid_unknown_fields=True):
    """Bevelled panes of coated glass. Seen from afar each pane is one needle of light, a bevel another one."""

    glass: Color
    frame: Color
    dust: Color
    panes: tuple[int, int]
    joint: float
    bevel: float
    bevel_slope: float
    tilt: float
    bow: float
    dusty: float
    roughness: tuple[float, float, float]

    def make(self, size: int, rng: np.random.Generator) -> Maps:
        across, down = self.panes
        axis = (np.arange(size) + 0.5) / size
        u, v = np.meshgrid(axis * across, axis * down)
        column, row = u.astype(int), v.astype(int)
        # From the pane's centre, in texture widths, y down.
        x, y = (u - column - 0.5) / across, (v - row - 0.5) / down
        to_edge = np.minimum(0.5 / across - np.abs(x), 0.5 / down - np.abs(y)) - 0.5 * self.joint
        in_pane = np.clip(to_edge * size + 0.5, 0.0, 1.0)
        # A bevel is a plane of its own, a pane is bowed by its seal: two slopes, and a sharp edge between them.
        bevel = self.bevel_slope * np.clip(to_edge, 0.0, self.bevel)
        tilt_x, tilt_y = rng.normal(0.0, self.tilt, (2, down, across))
        bow = rng.normal(0.0, self.bow, (down, across))[row, column]
        plane = x * tilt_x[row, column] + y * tilt_y[row, column]
        curve = bow * 0.5 * ((x * across) ** 2 / across + (y * down) ** 2 / down)
        height = (bevel + plane + curve) * in_pane
        cloud = grain(size, rng, 12.0)
        fine = grain(size, rng, 0.2 * size)
        # Dust gathers at the lower edge and thins out upwards.
        rise = 0.5 - y * down
        film = np.clip(1.0 - rise / self.dusty + 0.25 * cloud, 0.0, 1.0) * in_pane
        clean, dusted, frame = self.roughness
        rough = clean + (dusted - clean) * film**0.5 * (film > 0.0) * np.clip(1.0 + 0.1 * fine, 0.0, 1.5)
        is_glass = in_pane[:, :, None]
        colour = np.array(self.glass) + (np.array(self.dust) - np.array(self.glass)) * film[:, :, None]
        frame_colour = np.array(self.frame) * (1.0 + 0.06 * fine)[:, :, None]
        return Maps(
            color=np.clip(frame_colour + (colour - frame_colour) * is_glass, 0.0, 1.0),
            normal=normals_from_gradient(height_gradient(height, "tile") * size),
            roughness=np.clip(frame + (rough - frame) * in_pane, 0.0, 1.0),
            metallic=np.clip(in_pane * (1.0 - film), 0.0, 1.0),
            height=height,
        )
