"""Several materials, or UDIM tiles, in one folder: which of its files belong together.

Files belong together if their names agree but for the words of role, resolution and file type, that is, if
``textures.naming`` leaves the same stem. Of UDIM files (``Name_Role.1001.png``) each tile is a set of its own.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from brdffit.textures.naming import LETTERS, NamedSet, name_tokens, roles_from_names
from brdffit.textures.reading import has_alpha

#: Tiles are numbered 1001 + u + 10 v. After an underscore the number may be a resolution, so it needs other tiles
#: beside it.
_UDIM = re.compile(r"^(?P<rest>.*?)(?P<mark>[._])(?P<tile>1[0-9]{3})(?P<tail>(?:[._-][A-Za-z][A-Za-z0-9]*)*)$")
#: Mudbox and its kin count from one: u1_v1 is tile 1001.
_UV = re.compile(r"^(?P<rest>.*?)(?P<mark>[._-])u(?P<u>[1-9])_v(?P<v>\d{1,2})(?P<tail>.*)$", re.IGNORECASE)
_SURFACE = {"normal", "height"}


@dataclass(frozen=True)
class Group:
    """Files of one material: its name as the files have it, and its tile, if it is one."""

    name: str
    files: tuple[str, ...]
    udim: int | None = None


def groups_of(folder: Path, images: Sequence[str]) -> list[Group] | None:
    """The materials among the images of a folder, where they are several; None where the folder is one set or none.

    A group that has neither normal nor height map counts if at least two of its files have a role: it is then refused
    with a sentence, whereas a lone picture is ignored.
    """
    tiles = udim_tiles(images)
    if tiles:
        found = []
        for tile, renamed in sorted(tiles.items()):
            parts = _by_stem(folder, list(renamed)) or [Group(_common_name(list(renamed)), tuple(renamed))]
            for group in parts:
                files = tuple(sorted(renamed[file] for file in group.files))
                found.append(Group(f"{group.name}.{tile}" if group.name else str(tile), files, tile))
        rest = sorted(set(images) - {file for group in found for file in group.files})
        return [*found, *(_by_stem(folder, rest) or _alone(folder, rest))]
    return _by_stem(folder, images) if named_with_alpha(folder, images).rivals else None


def udim_tiles(images: Sequence[str]) -> dict[int, dict[str, str]]:
    """Files of each UDIM tile: the name without the tile's number, and the file; empty where there are none."""
    tiles: dict[int, dict[str, str]] = {}
    marks = set()
    for file in images:
        found = tile_of(file)
        if found is not None and roles_from_names([found[0]]).maps:
            tiles.setdefault(found[1], {})[found[0]] = file
            marks.add(found[2])
    if marks == {"_"} and (len(tiles) < 2 or 1001 not in tiles):
        return {}
    # A map without a tile's number is used for every tile that has no map of its role.
    for file in images if len(tiles) > 1 else []:
        roles = roles_from_names([file]).maps.keys() if tile_of(file) is None else set()
        for renamed in tiles.values():
            stems = {_stem(each) for each in renamed}
            if roles and _stem(file) in stems and not roles & roles_from_names(renamed).maps.keys():
                renamed[file] = file
    return tiles


def tile_of(file: str) -> tuple[str, int, str] | None:
    """A file's name without its tile, the tile (1001 and up), and what stands before the number; None without one."""
    stem, _, suffix = file.rpartition(".")
    match = _UV.match(stem)
    if match:
        tile = 1000 + int(match["u"]) + 10 * (int(match["v"]) - 1)
        return f"{match['rest']}{match['tail']}.{suffix}", tile, "uv"
    match = _UDIM.match(stem)
    if match:
        return f"{match['rest']}{match['tail']}.{suffix}", int(match["tile"]), match["mark"]
    return None


def named_with_alpha(folder: Path, images: Sequence[str]) -> NamedSet:
    """Roles of a folder's images; their headers are read only where names alone do not settle it."""
    named = roles_from_names(images)
    if _SURFACE & named.maps.keys() and not named.rivals:
        return named
    return roles_from_names(images, [file for file in images if has_alpha(folder / file)])


def named_group(folder: Path, files: Sequence[str], udim: int | None) -> NamedSet:
    """Roles of the files of one group; of a tile, by the names without its number."""
    if udim is None:
        return named_with_alpha(folder, files)
    renamed = {(tile_of(file) or (file,))[0]: file for file in files}
    alpha = [name for name, file in renamed.items() if has_alpha(folder / file)]
    named = roles_from_names(renamed, alpha)
    maps = {role: replace(each, file=renamed[each.file]) for role, each in named.maps.items()}
    return NamedSet(maps, [renamed[file] for file in named.ignored], named.notes, named.rivals)


def _alone(folder: Path, images: list[str]) -> list[Group]:
    """The images beside tiles, if they are a set."""
    maps = named_with_alpha(folder, images).maps if images else {}
    return [Group(_common_name(images), tuple(images))] if _SURFACE & maps.keys() else []


def _by_stem(folder: Path, images: Sequence[str]) -> list[Group] | None:
    """Groups by stem, where two or more have a surface."""
    stems: dict[str, list[str]] = {}
    for file in images:
        stem = _stem(file)
        if stem is not None:
            stems.setdefault(stem, []).append(file)
    groups, surfaces = [], 0
    for stem, files in sorted(stems.items()):
        has_surface = bool(_SURFACE & named_with_alpha(folder, files).maps.keys())
        surfaces += has_surface
        if has_surface or len(files) > 1:
            groups.append(Group(_common_name(files) or stem, tuple(files)))
    if surfaces < 2:
        return None
    names = [group.name for group in groups]
    return [
        group if names.count(group.name) == 1 else Group(group.files[0].rpartition(".")[0], group.files)
        for group in groups
    ]


def _stem(file: str) -> str | None:
    """The words of a file's name without those that tell its roles; None for a file without a role."""
    tokens = name_tokens(file.rpartition(".")[0])
    words = {found.word for found in roles_from_names([file], [file]).maps.values()}
    if not words and tokens and tokens[-1] in LETTERS:
        words = {tokens[-1]}  # whether it is a role is told by its company, once the group is known
    if not words:
        return None
    while True:
        for start in range(len(tokens)):
            if "".join(tokens[start:]) in words:
                tokens = tokens[:start]
                break
        else:
            return "".join(tokens)


def _common_name(files: Sequence[str]) -> str:
    """The common beginning of the names, up to a separator."""
    if len(files) == 1:
        return files[0].rpartition(".")[0]
    common = os.path.commonprefix(list(files))
    following = {file[len(common) : len(common) + 1] for file in files}
    if not all(re.fullmatch(r"[^A-Za-z0-9]|[A-Z]|", letter) for letter in following) and not re.search(
        r"[^A-Za-z0-9]$", common
    ):
        common = re.sub(r"[A-Za-z0-9]+$", "", common) or common
    return common.strip(" ._-")
