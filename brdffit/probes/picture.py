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
_SPHERE, _SPHERES = 96, 8
#: Tolerance of the column "exact", over that of the probe.
_FINER = 0.1


def probe_picture(probe: Probe, path: Path, tolerance: float, threads: int) -> None:
    """Draw a probe as a PNG: one row a level, with the stored texels, exact ones, and ten times the difference.

    "Exact" is the tree at a tenth of the tolerance, at most 0.002; brute force would take too long. Below the levels
    are two rows of reflecting spheres of rising roughness: looked up as the engine does, and exact.
    """
    tree = Tree(probe.source)
    at = latlong_directions(_WIDTH // 2)
    exposure = exposure_of(probe.source)
    tau = tau_for(_FINER * min(tolerance, 0.02))
    rows = []
    for level in probe.levels[1:]:
        stored = look_up(level.radiance, at) / probe.scale
        n = level.request.n
        # Both are looked up in the same way, so that the difference shows the filter and not the look-up.
        points = level.request.points
        exact = look_up(resized(tree.level(n * points, level.request.alpha, tau, threads), n), at)
        difference = np.abs(stored - exact)
        error = "" if level.error is None else f", error {level.error:.2%}"
        title = f"level {level.request.level}: {n}x{n}, roughness {level.request.roughness:.2f}{error}"
        rows.append((title, [toned(each, exposure) for each in (stored, exact, 10.0 * difference)]))
    normal, inside = _sphere_directions(_SPHERE)
    drawn, true = [], []
    radiances = [level.radiance / probe.scale for level in probe.levels]
    for roughness in np.linspace(0.0, 1.0, _SPHERES):
        lod = probe.curve.level(np.array(roughness))
        seen = look_up_trilinear(radiances, normal, np.full(normal.shape[:-1], lod))
        flat = normal[inside]
        if roughness > 0.05:
            values = tree.filtered(flat, roughness**2, tau, threads)
        else:
            values = look_up(probe.source, flat)
        exact = np.zeros_like(seen)
        exact[inside] = values
        drawn.append(np.where(inside[..., None], toned(seen, exposure), 24))
        true.append(np.where(inside[..., None], toned(exact, exposure), 24))
    write_png(path, _composed(probe, rows, drawn, true))


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


def _composed(probe: Probe, rows: list, drawn: list[NDArray], true: list[NDArray]) -> NDArray:
    width = 3 * _WIDTH + 4 * _GAP
    height = 2 * _TITLE + len(rows) * (_WIDTH // 2 + _TITLE) + 2 * (_SPHERE + _TITLE) + 2 * _GAP
    canvas = Image.new("RGB", (width, height), (24, 24, 24))
    draw = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(12)
    preset = probe.preset
    head = f"{probe.surroundings.path.name} for {preset.name}: {preset.size}x{preset.size}, curve {probe.curve.name}"
    draw.text((_GAP, 3), head, fill=(255, 255, 255), font=font)
    for column, name in enumerate(("stored", "exact", "difference x 10")):
        draw.text((_GAP + column * (_WIDTH + _GAP), _TITLE + 2), name, fill=(170, 170, 170), font=font)
    y = 2 * _TITLE
    for title, pictures in rows:
        draw.text((_GAP, y + 2), title, fill=(255, 255, 255), font=font)
        y += _TITLE
        for column, pixels in enumerate(pictures):
            canvas.paste(Image.fromarray(pixels), (_GAP + column * (_WIDTH + _GAP), y))
        y += _WIDTH // 2
    for title, spheres in (("spheres of roughness 0 to 1, looked up as the engine does", drawn), ("exact", true)):
        draw.text((_GAP, y + 2), title, fill=(255, 255, 255), font=font)
        y += _TITLE
        for column, pixels in enumerate(spheres):
            canvas.paste(Image.fromarray(pixels.astype(np.uint8)), (_GAP + column * _SPHERE, y))
        y += _SPHERE
    return np.asarray(canvas)
