"""Small images that the tests write themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray


def write_image(path: Path, pixels: NDArray, kind: str = "uint8", quality: int = 98) -> Path:
    """Write (H, W, C) values in [0, 1] (or any, for half and float) as ``kind``, by the suffix of ``path``."""
    pixels = np.atleast_3d(np.asarray(pixels, dtype=np.float32))
    top = {"uint8": 255, "uint16": 65535}.get(kind)
    if top:
        stored = np.rint(np.clip(pixels, 0.0, 1.0) * top).astype(kind)
    else:
        stored = pixels.astype(np.float16 if kind == "half" else np.float32)
    path.parent.mkdir(parents=True, exist_ok=True)
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("Compression", f"jpeg:{quality}" if path.suffix == ".jpg" else "zip")
    writer = oiio.ImageOutput.create(str(path))
    assert writer.open(str(path), spec), writer.geterror()
    assert writer.write_image(np.ascontiguousarray(stored)), writer.geterror()
    assert writer.close()
    return path


def bumps(height: int = 48, width: int = 64, slope: float = 0.3) -> tuple[NDArray, NDArray]:
    """A tileable height in texels (H, W) and the exact unit normals (H, W, 3) of its continuous form, OpenGL."""
    x, y = np.meshgrid(np.arange(width) + 0.5, -(np.arange(height) + 0.5))
    kx, ky = 2.0 * np.pi / width, 2.0 * np.pi / height
    field = slope * (np.sin(kx * x) / kx + np.cos(ky * y + 0.7 * np.sin(kx * x)) / ky)
    phase = ky * y + 0.7 * np.sin(kx * x)
    dx = slope * (np.cos(kx * x) - np.sin(phase) * 0.7 * np.cos(kx * x) * kx / ky)
    dy = -slope * np.sin(phase)
    normal = np.stack([-dx, -dy, np.ones_like(dx)], axis=2)
    return field, normal / np.linalg.norm(normal, axis=2, keepdims=True)


def encoded(normal: NDArray, normal_y: str = "gl") -> NDArray:
    """Unit normals as stored, in [0, 1]."""
    flip = np.array([1.0, 1.0 if normal_y == "gl" else -1.0, 1.0])
    return 0.5 * normal * flip + 0.5
