"""The sets that are measured: real ones if there are any, otherwise the procedural ones that ship."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from brdffit.errors import InputError
from brdffit.files.image_io import read_image, write_png
from brdffit.svbrdf import Svbrdf
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.procedural import SETS, make_set
from brdffit.textures.reading import read_texture_set

#: The sets whose mean margin over LEAN and vMF is a target; a quick run takes the first of them.
NAMED = ("metal-plates-006", "ice-002", "white-tiles-grout", "smudged-mirror-imperfections003", "coarse-sand")
QUICK_SETS = 3
#: Side of the part of a set that ``crop`` takes, in texels.
CROP = 256


def real_sets(materials: Path) -> dict[str, Path]:
    """Folders of real sets by name, the named ones first; empty where there are none."""
    if not materials.is_dir():
        return {}
    names = sorted(path.name for path in materials.iterdir() if path.is_dir())
    names.sort(key=lambda name: NAMED.index(name) if name in NAMED else len(NAMED))
    return {name: materials / name for name in names}


def accuracy_sets(materials: Path, quick: bool) -> dict[str, Path | None]:
    """Sets of the accuracy table; a path of None means a procedural one."""
    found: dict[str, Path | None] = dict(real_sets(materials)) or dict.fromkeys(SETS)
    return dict(list(found.items())[:QUICK_SETS]) if quick else found


def load(path: Path) -> Svbrdf:
    """The SVBRDF of a folder.

    Raises:
        InputError: when it cannot be read.
    """
    return to_svbrdf(read_texture_set(path))


def load_procedural(name: str, size: int) -> Svbrdf:
    """The SVBRDF of a shipped set at this size."""
    with tempfile.TemporaryDirectory() as folder:
        return load(make_set(name, Path(folder) / name, size))


def load_any(name: str, path: Path | None, size: int = 1024) -> Svbrdf | str:
    """A real set, or a procedural one where ``path`` is None; the sentence of the error if it cannot be read."""
    try:
        return load_procedural(name, size) if path is None else load(path)
    except InputError as error:
        return str(error)


def tiled(svbrdf: Svbrdf, times: int) -> Svbrdf:
    """The set repeated ``times`` times in either direction: more texels of the same kind."""
    arrays = {name: np.tile(a, (times, times) + (1,) * (a.ndim - 2)) for name, a in svbrdf.arrays().items()}
    return svbrdf.replace(**arrays)


def write_tiled(source: Path, folder: Path, times: int) -> Path:
    """Copies of the pictures of a set, tiled ``times`` times in either direction."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(source.glob("*.png")):
        image = read_image(path)
        top, kind = (65535, np.uint16) if image.bits == 16 else (255, np.uint8)
        codes = np.rint(image.pixels * top).astype(kind)
        write_png(folder / path.name, np.tile(codes, (times, times, 1)))
    return folder


def every_set(materials: Path) -> dict[str, Path | None]:
    """The real sets and the shipped ones, by name; the shipped ones, made anew by ``crop``, have no path."""
    return dict(real_sets(materials)) | dict.fromkeys(SETS)


def crop(name: str, path: Path | None, side: int = CROP) -> Svbrdf:
    """A part of a set, ``side`` texels square (all of a smaller one); of a shipped one where there is no path.

    It is the tile of a grid with the median spread of normals and roughness: neither the emptiest nor the busiest place
    of an atlas. It tiles as the set does; the seam is in every method's picture and in the reference.

    Raises:
        InputError: when the set cannot be read.
    """
    base = load_procedural(name, 1024) if path is None else load(path)
    corners = [(r, c) for r in range(0, base.size[0] - side + 1, side) for c in range(0, base.size[1] - side + 1, side)]
    if not corners:
        return base
    parts = [(slice(r, r + side), slice(c, c + side)) for r, c in corners]
    spread = [
        float(base.normal[p].var(axis=(0, 1)).sum() + base.log_roughness[p].var(axis=(0, 1)).sum()) for p in parts
    ]
    chosen = parts[int(np.argsort(spread, kind="stable")[len(spread) // 2])]
    return base.replace(**{name: np.ascontiguousarray(array[chosen]) for name, array in base.arrays().items()})
