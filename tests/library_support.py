"""Small libraries of texture sets, and methods that misbehave, for the tests of libraries."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import numpy as np

from brdffit.files.image_io import write_png
from brdffit.methods import LobeMethod, get_method


def write_maps(folder, seed=0, size=8, names="Set_{}.png", roles=("NormalGL", "Color", "Roughness")):
    """Random maps of a material; the normals are those of a gentle, tilted surface."""
    random = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    for role in roles:
        codes = random.integers(40, 220, (size, size, 3), dtype=np.uint8)
        if role.lower().startswith(("n", "nor")):
            normal = np.concatenate([0.3 * random.standard_normal((size, size, 2)), np.ones((size, size, 1))], axis=-1)
            normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
            codes = np.rint(255.0 * (0.5 * normal + 0.5)).astype(np.uint8)
        write_png(folder / names.format(role), codes)
    return folder


def make_library(root, count=4, size=8):
    """Sets in folders of two depths."""
    for index in range(count):
        place = f"set{index}" if index % 2 else f"deep/set{index}"
        write_maps(root / place, seed=index, size=size + 4 * (index % 3))
    return root


def contents(folder: Path) -> dict[str, object]:
    """Every file below a folder; of manifests and records what is not volatile. The page shows seconds: left out."""
    found: dict[str, object] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != "index.html":
            data: object = path.read_bytes()
            if path.suffix == ".json":
                data = json.loads(path.read_bytes())
                data.pop("volatile")  # type: ignore[attr-defined]
            found[path.relative_to(folder).as_posix()] = data
        elif path.is_dir():
            found[path.relative_to(folder).as_posix() + "/"] = None
    return found


def whole_sets(folder: Path) -> int:
    """How many sets are whole; folders may vanish meanwhile."""
    found = 0
    for _, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += "manifest.json" in files
    return found


class _Odd(LobeMethod):
    """A method that does as `naive`, but for a set whose base has one texel a side more than that of the others."""

    summary = "for tests"
    name = "odd"

    def bake_lobes(self, svbrdf, options, progress=None):
        if svbrdf.size == (9, 9):
            self.misbehave()
        return get_method("naive").bake_lobes(svbrdf, options)


class DiesAlways(_Odd):
    def misbehave(self):
        os.kill(os.getpid(), signal.SIGKILL)


class DiesOnce(_Odd):
    def misbehave(self):
        try:
            Path(os.environ["BRDFFIT_TEST_FLAG"]).touch(exist_ok=False)
        except FileExistsError:
            return
        os.kill(os.getpid(), signal.SIGKILL)


class Fails(_Odd):
    def misbehave(self):
        raise ZeroDivisionError("an error of the program")
