"""The texture sets below a folder, by file names, headers and material files; pixels are read when a set is baked.

Each folder of textures is a set; so is each material of a folder that holds several, each UDIM tile, and each glTF or
MaterialX file where no images with roles tell the set. A set's place below the output is that below the root.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path

from brdffit.errors import InputError
from brdffit.export.manifest import FILE_NAME as MANIFEST
from brdffit.files.image_io import IMAGE_SUFFIXES
from brdffit.library.grouping import groups_of, named_with_alpha
from brdffit.library.task import Found
from brdffit.textures.reading import SUFFIXES, file_names, material_names, read_material


def find_sets(
    root: Path, output: Path | None = None, is_left_out: Callable[[str], bool] = lambda key: False
) -> list[Found]:
    """All sets below ``root``, by key.

    Hidden folders, the output itself and folders that an earlier bake wrote are passed over; symbolic links are
    followed, each folder once.

    Args:
        root: folder of the library.
        output: the library's output, should it lie within.
        is_left_out: whether the place of a folder or a set is left out.

    Raises:
        InputError: when ``root`` is no folder that can be read, or two sets would take the same place.
    """
    if not root.is_dir():
        raise InputError(f"'{root}' is no folder, expected the root of a library of texture sets.")
    sets: list[Found] = []
    owners: list[str] = []  # places of folders that are sets
    for folder, place in _folders(root, output, is_left_out):
        here = _sets_of(folder, _beside_owner(place, owners), root)
        owners += [place for found in here if found.source == folder and place and found.files is None]
        sets += here
    sets = [found for found in _without_parts(sets) if not is_left_out(found.key)]
    for one, other in zip(sorted_sets := sorted(sets, key=_place), sorted_sets[1:], strict=False):
        if one.key == other.key:
            raise InputError(
                f"'{one.source}' and '{other.source}' would both be written to '{one.key}', expected names that "
                f"differ: rename one, or leave it out by `exclude` in library.toml."
            )
    return sorted_sets


def _place(found: Found) -> str:
    return found.key


def _folders(root: Path, output: Path | None, is_left_out: Callable[[str], bool]) -> Iterator[tuple[Path, str]]:
    """Folders with their place below the root, parents first."""
    seen = {output.resolve()} if output is not None else set()

    def failed(error: OSError) -> None:
        if Path(error.filename) == root:
            raise InputError(f"'{root}' cannot be read: {error.strerror}.") from error

    for parent, names, files in os.walk(root, followlinks=True, onerror=failed):
        folder = Path(parent)
        place = "" if folder == root else folder.relative_to(root).as_posix()
        real = folder.resolve()
        if real in seen or (MANIFEST in files and _is_baked(folder)) or (place and is_left_out(place)):
            names.clear()
            continue
        seen.add(real)
        names[:] = sorted(name for name in names if not name.startswith("."))
        yield folder, place


def _is_baked(folder: Path) -> bool:
    try:
        return "stable_digest" in json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError, TypeError):
        return False


def _beside_owner(place: str, owners: list[str]) -> str:
    """A place that does not lie inside the place of another set, which is replaced as a whole: oak/old is oak.old."""
    for owner in sorted(owners, key=len, reverse=True):
        if place.startswith(owner + "/"):
            return owner + "." + place[len(owner) + 1 :].replace("/", ".")
    return place


def _sets_of(folder: Path, place: str, root: Path) -> list[Found]:
    """The sets of one folder."""
    names = file_names(folder)
    images = [name for name in names if name.lower().endswith(IMAGE_SUFFIXES)]
    scenes = [name for name in names if name.lower().endswith(SUFFIXES)]
    whole = place or root.resolve().name

    def within(name: str) -> str:
        return f"{place}/{name}" if place else name

    groups = groups_of(folder, images) if images else None
    several = [
        Found(within(f"{stem}/{_as_folder(name)}" if len(scenes) > 1 or not place else _as_folder(name)),
              folder / scene, material=name)
        for scene in scenes
        for stem, names in [(Path(scene).stem, _materials(folder / scene))]
        if len(names) > 1
        for name in names
    ]  # fmt: skip
    if several:
        # Images that such a file uses are no set of their own; others in the folder may be.
        used = {path.resolve() for found in several for path in references(found.source, found.material)}
        left = [group for group in groups or [] if not all((folder / file).resolve() in used for file in group.files)]
        return several + [Found(within(group.name or whole), folder, group.files, group.udim) for group in left]
    if groups:
        return [Found(within(group.name or whole), folder, group.files, group.udim) for group in groups]
    maps = named_with_alpha(folder, images).maps if images else {}
    if {"normal", "height"} & maps.keys() or len(scenes) == 1:
        return [Found(whole, folder)]
    if scenes:
        return [Found(within(Path(name).stem), folder / name) for name in scenes]
    # Maps without normal or height are an incomplete set, which is reported; pictures without a role are no set.
    return [Found(whole, folder)] if maps else []


def _materials(entry: Path) -> list[str]:
    """Materials of a file; none where it is damaged, which is reported when it is read."""
    try:
        return material_names(entry)
    except InputError:
        return []


def _as_folder(name: str) -> str:
    """A material's name as that of a folder."""
    return re.sub(r"[\\/:]+", "-", name).strip(". ") or "material"


def _without_parts(sets: list[Found]) -> list[Found]:
    """Leave out folders whose images a material file uses: they are no sets of their own."""
    used: set[Path] = set()
    for found in sets:
        entry = material_file(found)
        if entry is not None:
            used |= {path.resolve() for path in references(entry, found.material)}
    kept = []
    for found in sets:
        if used and material_file(found) is None:
            files = found.files or tuple(
                name for name in os.listdir(found.folder) if name.lower().endswith(IMAGE_SUFFIXES)
            )
            roles = named_with_alpha(found.folder, sorted(files)).maps.values()
            if all((found.folder / each.file).resolve() in used for each in roles):
                continue
        kept.append(found)
    return kept


def material_file(found: Found) -> Path | None:
    """The glTF or MaterialX file a set is read from, or None where names tell its maps.

    Raises:
        InputError: when its folder cannot be read.
    """
    if found.source.is_file():
        return found.source
    if found.files is not None:
        return None
    try:
        scenes = [name for name in os.listdir(found.source) if name.lower().endswith(SUFFIXES) and name[0] != "."]
    except OSError as error:
        raise InputError(f"'{found.source}' cannot be read: {error.strerror}.") from error
    return found.source / scenes[0] if len(scenes) == 1 else None


def references(entry: Path, material: str | None = None) -> list[Path]:
    """The files that a material file needs, itself first; of a damaged one only those that could be found."""
    paths = [entry]
    try:
        paths += sorted(
            {path for named in read_material(entry, material).maps.values() for path in named.paths} - {entry}
        )
        if entry.suffix.lower() == ".gltf":
            buffers = json.loads(entry.read_bytes()).get("buffers", [])
            uris = [buffer["uri"] for buffer in buffers if not buffer.get("uri", "data:").startswith("data:")]
            paths += [entry.parent / uri for uri in uris]
    except (InputError, OSError, ValueError, KeyError, TypeError, AttributeError):
        pass
    return paths
