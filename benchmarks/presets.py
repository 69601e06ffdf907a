"""Accuracy of each preset's pictures against the baked levels: `python -m benchmarks.presets SET... [--fast]`.

Every set is baked once by LEAN (its levels are as varied as any, and it is quick), and its pyramid is written by every
preset. Printed as a table in Markdown: SNR in dB of the decoded pictures at levels 1 and 3 (with colours, and of the
lobe alone), SNR of the roughness tensor alone (normals as baked), and the mean angle between normals. The table
compares stored with baked levels; it does not say how well the bake keeps the appearance.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import brdffit
from brdffit.export.pictures import write_pictures
from brdffit.export.presets import PRESETS
from brdffit.methods import Pyramid

LEVELS = (1, 3)


def rows(pyramid: Pyramid, name: str, compress: str) -> list[str]:
    """One row a preset and number of bits."""
    found = []
    for preset in PRESETS.values():
        for bits in (8, 16):
            uastc = any(picture.pixels == "uastc" for picture in preset.pictures)
            if preset.name == "ntc" or (bits == 16 and (uastc or preset.container == "exr")):
                continue
            with tempfile.TemporaryDirectory() as folder:
                start = time.process_time()
                stored = write_pictures(pyramid, Path(folder), name, preset, bits, compress)["stored"]
                seconds = time.process_time() - start
            cells = [name, f"`{preset.name}`" + (" `--bits 16`" if bits == 16 else "")]
            for level in LEVELS:
                figures = stored[level]
                cells.append(f"{figures['appearance_db']:.1f}, {figures['lobe_db']:.1f}")
                tensor = figures.get("compression_roughness_db")
                cells.append("" if tensor is None else f"{tensor:.1f}" if tensor < 99 else "exact")
                cells.append(f"{figures['normal_degrees']:.2f}")
            found.append("| " + " | ".join([*cells, f"{seconds:.0f}"]) + " |")
    return found


def main(arguments: list[str]) -> int:
    """Print the table."""
    compress = "fast" if "--fast" in arguments else "good"
    sets = [each for each in arguments if not each.startswith("--")]
    cells = [f"level {level}: dB, lobe dB | tensor after compression | normals, degrees" for level in LEVELS]
    lines = [f"| set | preset | {' | '.join(cells)} | CPU s |", "|---|---" + "|---" * (3 * len(LEVELS) + 1) + "|"]
    sys.stdout.write("\n".join(lines) + "\n")
    for source in sets:
        pyramid = brdffit.bake(source, method="lean").lobes
        assert pyramid is not None
        sys.stdout.write("\n".join(rows(pyramid, Path(source).name, compress)) + "\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
