"""Writing a pyramid: MIP-mapped EXR files, engine-ready pictures, manifest and preview, all of them or none.

Memory stays near that of two EXR files and two pictures at any size: so many are written at once, and derived
quantities are computed in bands of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.export.geometry import Geometry, geometry_of
from brdffit.export.manifest import FILE_NAME, foreign_file, stable_digest, to_json
from brdffit.export.pictures import Count, bands, check_preset, write_pictures
from brdffit.export.presets import Preset, get_preset
from brdffit.files import atomic
from brdffit.files.image_io import file_sha256, write_mip_exr, write_png
from brdffit.footprint import filter_channels, get_pixel_filter
from brdffit.methods import Baked, Image
from brdffit.probes.presets import probe_of_materials
from brdffit.svbrdf import level_sizes, unit_or_up

#: EXR files that are written at the same time.
_FILES_AT_ONCE = 2


def check_writable(
    folder: str | Path, size: tuple[int, int] | None = None, preset: str = "plain", bits: int = 8
) -> None:
    """Check, before the work, that ``folder`` can be made or replaced later and that its disk has room.

    Args:
        folder: OUT/<set>.
        size: (height, width) of level 0, to estimate the bytes needed; None asks for no room.
        preset, bits: of the pictures.

    Raises:
        OutputError: when it cannot, or when the preset cannot store such pictures; the sentence says why.
        MissingEncoderError: when the preset's encoder is not installed.
    """
    check_preset(get_preset(preset), bits, size)
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
    compress: str = "good",
    manifest: Mapping[str, Any] | Callable[[], Mapping[str, Any]],
    preview: NDArray | Callable[[], NDArray] | None = None,
    told: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Write a result into ``folder`` (OUT/<set>), which is replaced as a whole or left as it was.

    Writes normal.exr, roughness.exr (the tensor in alpha^2), specular.exr, diffuse.exr, shape.exr where the model has a
    shape parameter, opacity.exr where the set has opacity, the preset's files (mips/<name>_<role>.<level>.png, or
    <preset>/...), manifest.json and, if given, preview.png. A pyramid that stops before 1x1 is continued in all files
    but PNG by box averages of its last level, since texture systems cannot read a chain that stops short; the manifest
    lists those levels under ``filled_levels``.

    Args:
        baked: what a method returned; pictures for engines are drawn of lobes alone.
        folder: output folder of this set.
        name: name of the set, in the pictures' names.
        preset: name of a preset, see `presets`.
        bits: 8 or 16, of the pictures.
        compress: "fast", "good" or "best": how long encoders of blocks may take.
        manifest: from `build_manifest`.
        preview: (H, W, 3) uint8, from `make_preview`. It and ``manifest`` may be functions: they are called when all
            else is written, so that they may be computed meanwhile.
        told: called with a line on how many pictures are written, after each of them and from any thread.

    Returns:
        The manifest as written.

    Raises:
        UnknownNameError: no such preset.
        OutputError: when the folder cannot be written, or holds files that are not ours.
    """
    chosen = get_preset(preset)
    check_preset(chosen, bits, baked.sizes[0])
    with atomic.replacing(folder, foreign_file) as fresh:
        pictures = _write_files(baked, fresh, name, chosen, bits, compress, told)
        record = {**(manifest() if callable(manifest) else manifest), **pictures}
        record["filled_levels"] = list(range(len(baked.sizes), len(level_sizes(baked.sizes[0]))))
        record["preset"] = _told_of(chosen, bits, compress)
        if preview is not None:
            write_png(fresh / "preview.png", preview() if callable(preview) else preview)
        paths = sorted(path for path in fresh.rglob("*") if path.is_file())
        record["files"] = {
            path.relative_to(fresh).as_posix(): {"bytes": path.stat().st_size, "sha256": file_sha256(path)}
            for path in paths
        }
        record["stable_digest"] = stable_digest(record)
        (fresh / FILE_NAME).write_text(to_json(record), encoding="utf-8")
    return record


def _write_files(
    baked: Baked, fresh: Path, name: str, preset: Preset, bits: int, compress: str, told: Callable[[str], None] | None
) -> dict[str, Any]:
    """Write the EXR files and, beside them, the pictures; entries of the manifest that tell of the pictures."""
    images = baked.images()
    count = Count(told, len(images))
    pictures: dict[str, Any] = {"pictures": {}}
    with ThreadPoolExecutor(_FILES_AT_ONCE) as pool:
        written = [pool.submit(_write_exr_file, image, fresh, baked.wrap, count) for image in images]
        try:
            if baked.lobes is not None:
                geometry = _geometry(baked) if preset.container == "glb" else None
                pictures = write_pictures(baked.lobes, fresh, name, preset, bits, compress, geometry, count)
            for each in written:
                each.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return pictures


def _told_of(preset: Preset, bits: int, compress: str) -> dict[str, Any]:
    """The manifest's entry of the preset."""
    return {
        "name": preset.name,
        "normal_y": preset.normal_y,
        "roughness": preset.roughness,
        "bits": bits,
        "compress": compress,
        "note": preset.note,
        "reflection_probe": probe_of_materials(preset.name),
    }


def _geometry(baked: Baked) -> Geometry | None:
    """The geometry of the input, where that is a glTF file; where it cannot be used, a note says why."""
    if baked.worn is None:
        return None
    geometry, why = geometry_of(*baked.worn)
    if geometry is None:
        baked.notes.append(f"The GLB shows a rectangle, not the geometry of '{baked.worn[0].name}': {why}.")
    return geometry


def _write_exr_file(image: Image, fresh: Path, wrap: str, count: Count) -> None:
    """Write an EXR file down to 1x1."""
    levels = [_whole_level(image, k) for k in range(len(image.sizes))]
    for size in level_sizes(image.sizes[0])[len(levels) :]:
        averaged = filter_channels(levels[-1], size, get_pixel_filter("box"), wrap)
        levels.append(unit_or_up(averaged) if image.unit else averaged)
    write_mip_exr(fresh / f"{image.name}.exr", levels, image.channels)
    count.one_done()


def _whole_level(image: Image, mip_level: int) -> NDArray:
    out = np.empty((*image.sizes[mip_level], len(image.channels)), np.float32)
    for rows in bands(image.sizes[mip_level]):
        out[rows] = image.rows(mip_level, rows)
    return out
