"""Every file of baked presets through its reader: `python tests/clients/check.py OUT...`, exit 1 if one fails.

KTX2 by npm ktx-parse (written back byte for byte), DDS by OpenImageIO at every level, GLB by the Khronos glTF
validator, MIP-mapped EXR by OpenImageIO. `npm install --prefix tests/clients` brings the readers for Node.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import OpenImageIO as oiio

HERE = Path(__file__).parent


def levels_of(path: Path) -> str:
    """What is wrong with the levels of a picture, down to 1x1; "" where all of them can be read."""
    size, level = (0, 0), 0
    while True:
        image = oiio.ImageBuf(str(path), 0, level)
        if not image.initialized or image.nmiplevels <= level:
            image.geterror()  # beyond the last level: no fault
            break
        found = image.spec().width, image.spec().height
        if level and found != tuple(max(1, side >> 1) for side in size):
            return f"level {level} is {found[0]}x{found[1]}"
        if not image.read(0, level, True):
            return f"level {level}: {image.geterror()}"
        size, level = found, level + 1
    return "" if size == (1, 1) else f"stops at {size[0]}x{size[1]}"


def main(folders: list[str]) -> int:
    """Print one line a kind of file, and each fault."""
    files = [path for folder in folders for path in sorted(Path(folder).rglob("*")) if path.is_file()]
    faults = []
    for suffix in (".dds", ".exr"):
        found = [path for path in files if path.suffix == suffix]
        wrong = [f"{path}: {said}" for path in found if (said := levels_of(path))]
        sys.stdout.write(f"{suffix}: {len(found) - len(wrong)} of {len(found)} read at every level\n")
        faults += wrong
    ktx2 = [str(path) for path in files if path.suffix == ".ktx2"]
    if ktx2:
        result = subprocess.run(["node", HERE / "parse.mjs", *ktx2], capture_output=True, text=True, check=False)
        sys.stdout.write(f".ktx2: {len(ktx2)} through ktx-parse, exit {result.returncode}\n")
        faults += [result.stdout + result.stderr] if result.returncode else []
    glb = [str(path) for path in files if path.suffix == ".glb"]
    if glb:
        result = subprocess.run(["node", HERE / "validate.mjs", *glb], capture_output=True, text=True, check=False)
        reports = [json.loads(line) for line in result.stdout.splitlines()]
        bad = [str(report) for report in reports if report["errors"]]
        sys.stdout.write(f".glb: {len(reports) - len(bad)} of {len(glb)} without an error\n")
        faults += bad if len(reports) == len(glb) else [*bad, result.stderr]
    sys.stdout.write("".join(f"{fault}\n" for fault in faults))
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
