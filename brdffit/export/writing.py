"""Writing a pyramid: MIP-mapped EXR files, engine-ready pictures, manifest and preview, all of them or none.

Memory stays near one EXR file's worth at any size: those are written one after another, pictures level by level, and
derived quantities are computed in bands of rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError, OutputError
from brdffit.export.manifest import FILE_NAME, file_digest, foreign_file, stable_digest, to_json
from brdffit.export.presets import Channels, Picture, Preset, get_preset
from brdffit.files import atomic
from brdffit.files.image_io import read_mip_exr, write_mip_exr, write_png
from brdffit.footprint import filter_channels, get_pixel_filter
from brdffit.methods import Baked, Image, Pyramid
from brdffit.svbrdf import Svbrdf, level_sizes

_TEXELS_PER_BAND = 1 << 20


def check_writable(folder: str | Path, size: tuple[int, int] | None = None) -> None:
    """See, before the work, that ``folder`` can be made or replaced later and that its disk has room.

    Args:
        folder: OUT/<set>.
        size: (height, width) of level 0, to estimate the bytes needed; None asks for no room.

    Raises:
        OutputError: when it cannot; the sentence says why.
    """
    # Four EXR files of three floats and four pictures of four 16-bit channels, uncompressed; 4/3 for the levels.
    needed = 0 if size is None else int(size[0] * size[1] * (4 * 12 + 4 * 8) * 4 / 3)
    atomic.check_writable(folder, foreign_file, needed)


def write_baked(
    baked: Baked,
    folder: str | Path,
    *,
    name: str,
    preset: str = "plain",
    bits: int = 8,
    manifest: Mapping[str, Any],
    preview: NDArray | None = None,
) -> dict[str, Any]:
    """Write a result into ``folder`` (OUT/<set>), which is replaced as a whole or left as it was.

    Writes normal.exr, roughness.exr (the tensor in alpha^2), specular.exr, diffuse.exr, shape.exr where the model has a
    shape parameter, mips/<name>_<role>.<level>.png, manifest.json and, if given, preview.png. A pyramid that stops
    before 1x1 is continued in the EXR files by box averages of its last level, for texture systems cannot read a chain
    that stops short; the manifest lists those levels under ``filled_levels``. The pictures stop where the pyramid does.

    Args:
        baked: what a method returned; pictures for engines are drawn of lobes alone.
        folder: output folder of this set.
        name: name of the set, in the pictures' names.
        preset: name of a preset, see `presets`.
        bits: 8 or 16, of the pictures.
        manifest: from `build_manifest`.
        preview: (H, W, 3) uint8, from `make_preview`.

    Returns:
        The manifest as written.

    Raises:
        UnknownNameError: no such preset.
        OutputError: when the folder cannot be written, or holds files that are not ours.
    """
    chosen = get_preset(preset)
    if bits not in (8, 16):
        raise ValueError(f"bits is {bits}, expected 8 or 16")
    with atomic.replacing(folder, foreign_file) as fresh:
        record = dict(manifest)
        record["filled_levels"] = _write_exr_files(baked, fresh, record["wrap"])
        record["pictures"] = _write_pictures(baked.lobes, fresh, name, chosen, bits) if baked.lobes else {}
        record["preset"] = {
            "name": chosen.name,
            "normal_y": chosen.normal_y,
            "roughness": chosen.roughness,
            "bits": bits,
        }
        if preview is not None:
            write_png(fresh / "preview.png", preview)
        paths = sorted(path for path in fresh.rglob("*") if path.is_file())
        record["files"] = {
            path.relative_to(fresh).as_posix(): {"bytes": path.stat().st_size, "sha256": file_digest(path)}
            for path in paths
        }
        record["stable_digest"] = stable_digest(record)
        (fresh / FILE_NAME).write_text(to_json(record), encoding="utf-8")
    return record


def encode_srgb(linear: NDArray) -> NDArray:
    """Linear [0, 1] to sRGB-encoded [0, 1] (IEC 61966-2-1); values outside are clipped."""
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.power(linear, 1.0 / 2.4) - 0.055)


def quantise(values: NDArray, bits: int) -> NDArray:
    """[0, 1] to codes of uint8 or uint16, halves upwards; values outside are clipped."""
    top = 2**bits - 1
    return np.floor(np.clip(values, 0.0, 1.0) * top + 0.5).astype(f"uint{bits}")


def encode_level(
    svbrdf: Svbrdf, pictures: Sequence[Picture], normal_y: str, towards: tuple[float, float], bits: int
) -> list[tuple[NDArray, int]]:
    """The pictures of one level: (H, W, C) codes of each, and how many values lay outside [0, 1] and were clipped."""
    encoded = [np.empty((*svbrdf.size, len(picture.channels)), f"uint{bits}") for picture in pictures]
    clipped = [0] * len(pictures)
    # Float arithmetic may leave [0, 1] by a few ulps where nothing is lost.
    slack = 1e-5
    for rows in _bands(svbrdf.size):
        channels = Channels(_rows(svbrdf, rows), normal_y, towards)
        for index, picture in enumerate(pictures):
            for place, channel in enumerate(picture.channels):
                values = channels[channel]
                clipped[index] += int(np.count_nonzero((values < -slack) | (values > 1.0 + slack)))
                encoded[index][rows, :, place] = quantise(encode_srgb(values) if picture.srgb else values, bits)
    return list(zip(encoded, clipped, strict=True))


def dominant_direction(svbrdf: Svbrdf) -> tuple[float, float]:
    """Unit direction of larger roughness that most texels agree on: mean of log Sigma's deviator, at half its angle."""
    a, b, c = svbrdf.log_roughness.reshape(-1, 3).mean(axis=0, dtype=np.float64)
    angle = 0.5 * np.arctan2(2.0 * c, a - b)
    return float(np.cos(angle)), float(np.sin(angle))


def _write_pictures(pyramid: Pyramid, fresh: Path, name: str, preset: Preset, bits: int) -> dict[str, Any]:
    """Write the PNG files; what the manifest says of each role."""
    (fresh / "mips").mkdir()
    # One half plane for all levels, or trilinear filtering would mix a direction with its opposite.
    towards = dominant_direction(pyramid[0].svbrdf)
    base = pyramid[0].svbrdf
    present = {"": True, "anisotropy": pyramid.options.lobe == "anisotropic", "occlusion": base.occlusion is not None}
    pictures = [picture for picture in preset.pictures if present[picture.needs]]
    clipped: list[list[int]] = [[] for _ in pictures]
    for mip_level, level in enumerate(pyramid.levels):
        encoded = encode_level(level.svbrdf, pictures, preset.normal_y, towards, bits)
        for picture, counts, (codes, outside) in zip(pictures, clipped, encoded, strict=True):
            write_png(fresh / "mips" / f"{name}_{picture.role}.{mip_level}.png", codes)
            counts.append(outside)
    return {
        picture.role: {"channels": picture.channels, "srgb": picture.srgb, "clipped_values": counts}
        for picture, counts in zip(pictures, clipped, strict=True)
    }


def _write_exr_files(baked: Baked, fresh: Path, wrap: str) -> list[int]:
    """Write the EXR files; the levels that the result lacks and that were filled."""
    sizes = level_sizes(baked.sizes[0])
    for image in baked.images():
        levels = [_whole_level(image, k) for k in range(len(image.sizes))]
        for size in sizes[len(levels) :]:
            averaged = filter_channels(levels[-1], size, get_pixel_filter("box"), wrap)
            levels.append(_normalised(averaged) if image.unit else averaged)
        path = fresh / f"{image.name}.exr"
        write_mip_exr(path, levels, image.channels)
        _verify(path, levels, image.channels)
    return list(range(len(baked.sizes), len(sizes)))


def _verify(path: Path, levels: Sequence[NDArray], channels: Sequence[str]) -> None:
    """Read a file back: on a full disk the EXR writer closes a truncated file without a word."""
    try:
        stored = read_mip_exr(path, channels)
    except InputError:
        stored = []
    if len(stored) != len(levels) or not all(map(np.array_equal, stored, levels)):
        raise OutputError(f"'{path}' could not be written in full: is the disk full?")


def _normalised(normal: NDArray) -> NDArray:
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0], np.float32)
    return np.where(length > 1e-6, normal / np.maximum(length, 1e-6), up).astype(np.float32)


def _bands(size: tuple[int, int]) -> Iterator[slice]:
    rows = max(1, _TEXELS_PER_BAND // size[1])
    for start in range(0, size[0], rows):
        yield slice(start, min(start + rows, size[0]))


def _rows(svbrdf: Svbrdf, rows: slice) -> Svbrdf:
    return svbrdf.replace(**{field: array[rows] for field, array in svbrdf.arrays().items()})


def _whole_level(image: Image, mip_level: int) -> NDArray:
    out = np.empty((*image.sizes[mip_level], len(image.channels)), np.float32)
    for rows in _bands(image.sizes[mip_level]):
        out[rows] = image.rows(mip_level, rows)
    return out
