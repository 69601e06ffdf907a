"""The picture of a probe: each level as stored, exact, and their difference; and reflecting spheres by roughness."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from brdffit.colour import encode_srgb
from brdffit.files.image_io import write_png
from brdffit.probes.cubemap import latlong_directions, look_up, look_up_trilinear, resized
from brdffit.probes.tree import Tree, tau_for

if TYPE_CHECKING:
    from brdffit.probes.bake import Probe

_WIDTH, _GAP, _TITLE = 256, 8, 18
#: Grey of the ground, and of captions that matter less.
GROUND, DIM = 24, 170
_SPHERE, _SPHERES = 96, 8
#: Tolerance of the column "exact", over that of the probe.
_FINER = 0.1


def probe_picture(probe: Probe, path: Path, tolerance: float, threads: int) -> None:
    """Draw a probe as a PNG: one row a level, with the stored texels, exact ones, and ten times the difference.

    "Exact" is the tree at a tenth of the tolerance, at most 0.002; brute force would take too long. Below the levels
    are two rows of reflecting spheres of rising roughness: looked up as the engine does, and exact.
    """
    tree, exposure = Tree(probe.source), exposure_of(probe.source)
    tau = tau_for(_FINER * min(tolerance, 0.02))
    row, spheres = _TITLE + _WIDTH // 2, _TITLE + _SPHERE
    sheet = Sheet(3 * _WIDTH + 4 * _GAP, 2 * _TITLE + (len(probe.levels) - 1) * row + 2 * spheres + 2 * _GAP)
    preset, name = probe.preset, probe.surroundings.path.name
    sheet.text(_GAP, 3, f"{name} for {preset.name}: {preset.size}x{preset.size}, curve {probe.curve.name}")
    for column, heading in enumerate(("stored", "exact", "difference x 10")):
        sheet.text(_GAP + column * (_WIDTH + _GAP), _TITLE + 2, heading, DIM)
    at, y = latlong_directions(_WIDTH // 2), 2 * _TITLE
    for level in probe.levels[1:]:
        n, points = level.request.n, level.request.points
        title = f"level {level.request.level}: {n}x{n}, roughness {level.request.roughness:.2f}"
        sheet.text(_GAP, y + 2, f"{title}, error {level.error:.2%}")
        # Both are looked up in the same way, so that the difference shows the filter and not the look-up.
        stored = look_up(level.radiance, at) / probe.scale
        exact = look_up(resized(tree.level(n * points, level.request.alpha, tau, threads), n), at)
        for column, each in enumerate((stored, exact, 10.0 * np.abs(stored - exact))):
            sheet.put(_GAP + column * (_WIDTH + _GAP), y + _TITLE, toned(each, exposure))
        y += row
    sheet.text(_GAP, y + 2, "spheres of roughness 0 to 1, looked up as the engine does")
    sheet.text(_GAP, y + spheres + 2, "exact")
    normal, inside = _sphere_directions(_SPHERE)
    radiances = [level.radiance / probe.scale for level in probe.levels]
    for column, roughness in enumerate(np.linspace(0.0, 1.0, _SPHERES)):
        lod = np.full(inside.shape, probe.curve.level(np.array(roughness)))
        exact, flat = np.zeros(normal.shape), normal[inside]
        exact[inside] = (
            tree.filtered(flat, roughness**2, tau, threads) if roughness > 0.05 else look_up(probe.source, flat)
        )
        for below, each in enumerate((look_up_trilinear(radiances, normal, lod), exact)):
            disc = np.where(inside[..., None], toned(each, exposure), np.uint8(GROUND))
            sheet.put(_GAP + column * _SPHERE, y + _TITLE + below * spheres, disc)
    sheet.write(path)


class Sheet:
    """A dark ground that pictures and their captions are put on."""

    def __init__(self, width: int, height: int) -> None:
        self._canvas = Image.new("RGB", (width, height), (GROUND,) * 3)
        self._draw, self._font = ImageDraw.Draw(self._canvas), ImageFont.load_default(12)

    def text(self, x: int, y: int, text: str, grey: int = 255, outlined: bool = False) -> None:
        """A line of text, its upper left corner at (x, y); ``outlined`` in black, for the top of a picture."""
        self._draw.text(
            (x, y), text, fill=(grey,) * 3, font=self._font, stroke_width=int(outlined), stroke_fill=(0, 0, 0)
        )

    def put(self, x: int, y: int, pixels: NDArray) -> None:
        """A picture (h, w, 3) uint8, its upper left corner at (x, y)."""
        self._canvas.paste(Image.fromarray(pixels), (x, y))

    def write(self, path: Path) -> None:
        """Write a PNG.

        Raises:
            OutputError: when it cannot be written.
        """
        write_png(path, np.asarray(self._canvas))


def exposure_of(cube: NDArray) -> float:
    """Factor that brings the upper quartile of a cube map, or 0.7 of its mean if that is larger (lamps), to 0.35."""
    grey = cube.mean(axis=-1)
    return 0.35 / max(float(np.percentile(grey, 75.0)), 0.7 * float(grey.mean()), 1e-6)


def toned(radiance: NDArray, exposure: float) -> NDArray:
    """(..., 3) uint8 sRGB of linear radiance (..., 3), tone-mapped by Reinhard's curve."""
    x = np.maximum(radiance, 0.0) * exposure
    return (encode_srgb(np.minimum(1.2 * x / (1.0 + x), 1.0)) * 255.0 + 0.5).astype(np.uint8)


def _sphere_directions(size: int) -> tuple[NDArray, NDArray]:
    """Reflected directions (size, size, 3) of a sphere seen from +Z without perspective, and the mask of its disc."""
    across = (np.arange(size) + 0.5) / size * 2.0 - 1.0
    x, y = np.meshgrid(across, -across)
    square = x * x + y * y
    inside = square < 0.97
    z = np.sqrt(np.maximum(1.0 - square, 0.0))
    # r = 2 (n.v) n - v with v = +Z.
    reflected = np.stack([2.0 * z * x, 2.0 * z * y, 2.0 * z * z - 1.0], axis=-1)
    return np.where(inside[..., None], reflected, [0.0, 0.0, 1.0]), inside
