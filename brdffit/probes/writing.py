"""Write the files of a probe: specular levels, irradiance, harmonics, and the table of the split sum."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from brdffit.files.image_io import write_mip_exr
from brdffit.probes.containers import write_cube
from brdffit.probes.cubemap import latlong_directions, look_up
from brdffit.probes.harmonics import NINE_CONSTANTS
from brdffit.probes.split_sum import dfg_table

if TYPE_CHECKING:
    from brdffit.probes.bake import Probe

#: Suffix of the files of a container.
SUFFIXES = {"ktx2": ".ktx2", "ktx1": ".ktx", "dds": ".dds", "exr": ".exr"}


def write_probe(probe: Probe, folder: Path) -> list[str]:
    """Write all files of a probe but the manifest and the pictures; returns their names, specular levels first.

    Raises:
        OutputError: when a cube map cannot be written.
    """
    preset = probe.preset
    specular = [probe.stored(level.radiance) for level in probe.levels]
    irradiance = probe.stored(probe.irradiance.radiance)
    # Harmonics belong to the stored cube: mirroring an axis negates those that are odd in it.
    odd = {"": [], "x": [3, 4, 7], "z": [2, 5, 7]}[preset.mirror]
    nine = probe.nine.copy()
    nine[odd] *= -1.0
    files = []
    if preset.container == "exr":
        for level, cube in enumerate(specular):
            files.append(f"specular-{level}.exr")
            _write_latlong(folder / files[-1], cube)
        files.append("irradiance.exr")
        _write_latlong(folder / files[-1], irradiance)
    else:
        suffix = SUFFIXES[preset.container]
        for name, levels in (("specular", specular), ("irradiance", [irradiance])):
            files.append(name + suffix)
            # Filament's shader does not apply the constants of the basis, so its file contains them.
            rows = nine * NINE_CONSTANTS[:, None] if preset.container == "ktx1" else nine
            text = "\n".join(" ".join(f"{value:.7g}" for value in row) for row in rows) + "\n"
            pairs = {"KTXwriter": "brdffit", "sh": text}
            write_cube(folder / files[-1], preset.container, levels, preset.texel_format, pairs)
    (folder / "harmonics.json").write_text(
        json.dumps(
            {
                "is": "irradiance over pi: the sum of coefficient and basis, the clamped cosine multiplied in",
                "basis": "0.282095, 0.488603 (y, z, x), 1.092548 (xy, yz), 0.315392 (3z^2-1), "
                "1.092548 xz, 0.546274 (x^2-y^2)",
                "coefficients": np.round(nine, 7).tolist(),
                "relative_l1_error": round(probe.nine_error, 6),
            },
            indent=1,
        )
        + "\n",
        encoding="utf-8",
    )
    _write_chain(folder / "dfg.exr", dfg_table(32), ("R", "G"))
    return [*files, "harmonics.json", "dfg.exr"]


def latlong_of(cube: NDArray, height: int) -> NDArray:
    """(height, 2 height, 3) float32 lat-long picture of a cube map, middle column along -Z, of 2x2 points a pixel."""
    fine = look_up(cube, latlong_directions(2 * height))
    return fine.reshape(height, 2, 2 * height, 2, 3).mean(axis=(1, 3)).astype(np.float32)


def _write_latlong(path: Path, cube: NDArray) -> None:
    _write_chain(path, latlong_of(cube, max(2 * cube.shape[1], 8)), ("R", "G", "B"))


def _write_chain(path: Path, picture: NDArray, names: tuple[str, ...]) -> None:
    """A MIP-mapped EXR file; its coarser levels are plain means."""
    levels = [picture]
    while levels[-1].shape[:2] != (1, 1):
        height, width = levels[-1].shape[:2]
        rows, columns = max(height // 2, 1), max(width // 2, 1)
        blocks = levels[-1].reshape(rows, height // rows, columns, width // columns, -1)
        levels.append(blocks.mean(axis=(1, 3)).astype(np.float32))
    write_mip_exr(path, levels, names)
