"""Find the maps of a material: in a folder of images, or through a glTF or MaterialX file."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from brdffit.errors import InputError, UnknownNameError
from brdffit.files.image_io import IMAGE_SUFFIXES, UNREAD_SUFFIXES, read_info
from brdffit.svbrdf import WRAPS
from brdffit.textures.gltf import gltf_material_names, read_gltf
from brdffit.textures.naming import ROLES, NamedSet, old_cc0textures, packed_roles, roles_from_names
from brdffit.textures.settling import settle
from brdffit.textures.texture_set import NORMAL_YS, Map, TextureSet

SUFFIXES = (".gltf", ".glb", ".mtlx")


def read_material(path: Path, material: str | None = None) -> TextureSet:
    """The texture set of a material file; its name is the file's stem.

    Raises:
        InputError: when the file is damaged, of another kind, or has no material with maps.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        folder = f"; give its folder, '{path.parent}'" if suffix in IMAGE_SUFFIXES else ""
        raise InputError(
            f"'{path}' is a file of another kind, expected a folder of textures or a .gltf, .glb or .mtlx file{folder}."
        )
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}.") from error
    if not data:
        raise InputError(f"'{path}' is empty (0 bytes), expected a {suffix} file.")
    if suffix == ".mtlx":
        from brdffit.textures.materialx import read_materialx

        return read_materialx(path, data, material)
    return read_gltf(path, data, material)


def material_names(path: Path) -> list[str]:
    """Names of the materials that a file's meshes use, as ``--material`` takes them; of several, those that have a map.

    Raises:
        InputError: when the file cannot be read.
    """
    if path.suffix.lower() == ".mtlx":
        from brdffit.textures.materialx import materialx_material_names

        names = materialx_material_names(path)
    else:
        names = gltf_material_names(path)
    return names if len(names) < 2 else [name for name in names if read_material(path, name).maps]


def read_texture_set(
    path: str | os.PathLike[str],
    *,
    roles: Mapping[str, str] | None = None,
    normal_y: str | None = None,
    wrap: str | None = None,
    height_scale: float | None = None,
    denoise_normals: bool = False,
    material: str | None = None,
    without: Collection[str] = (),
) -> TextureSet:
    """Find the maps of a material and their conventions; pixels are read later, one map at a time.

    Args:
        path: a folder of images, or a .gltf, .glb or .mtlx file.
        roles: file by role (relative to the folder), which wins over names; a role is one of ``naming.ROLES`` or a
            packing such as "orm"; a file may end in ":R", ":G", ":B" or ":A" to name a channel.
        normal_y: "gl" or "dx", which wins over names; None tells it from names, from the height map, or from the
            slopes themselves (those of a surface have no curl), and says which.
        wrap: "tile" or "clamp"; None is what the material file says, or else "tile".
        height_scale: texels between the height values 0 and 1; None derives it.
        denoise_normals: read the normal map without what its codes cannot tell from a flat one, see ``noise_floor``.
        material: name of the material to read from a file that holds several; None chooses, see ``read_gltf`` and
            ``read_materialx``.
        without: roles that will not be read (see ``conversion.to_svbrdf``): without "normal" nothing is asked of it.

    Raises:
        InputError: when there is nothing to read, or what is there cannot belong together.
        UnknownNameError: for an unknown role, ``normal_y`` or ``wrap``.
    """
    path = Path(path)
    for kind, value, known in (("normal Y", normal_y, NORMAL_YS), ("wrap mode", wrap, WRAPS)):
        if value is not None and value not in known:
            raise UnknownNameError(kind, value, known)
    if height_scale is not None and not (np.isfinite(height_scale) and height_scale > 0.0):
        raise InputError(f"The height scale is {height_scale}, expected a positive number of texels.")
    texture_set = _find_maps(path, dict(roles or {}), material)
    settle(
        texture_set, path, normal_y=normal_y, wrap=wrap, height_scale=height_scale, denoise_normals=denoise_normals,
        without=without,
    )  # fmt: skip
    return texture_set


def _find_maps(path: Path, roles: dict[str, str], material: str | None) -> TextureSet:
    if not path.exists():
        raise InputError(f"'{path}' does not exist, expected a folder of textures or a .gltf, .glb or .mtlx file.")
    if path.is_file():
        texture_set = read_material(path, material)
        texture_set.maps |= explicit_roles(path.parent, roles)
        if "normal" in roles:
            normal_y_from_names(texture_set)
        return texture_set
    try:
        names = file_names(path)
        folders = sorted(name for name in os.listdir(path) if name[0] != "." and os.path.isdir(path / name))
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}.") from error
    images = [name for name in names if name.lower().endswith(IMAGE_SUFFIXES)]
    scenes = [name for name in names if name.lower().endswith(SUFFIXES)]
    if not images and not scenes and not roles:
        if folders and not names:
            raise InputError(
                f"'{path}' holds folders alone ({', '.join(folders[:3])}), expected a folder of textures; "
                f"`brdffit library` bakes all sets below a folder."
            )
        what = f"{len(names)} files, none of them an image" if names else "nothing"
        raise InputError(f"'{path}' holds {what}, expected a folder of textures such as Name_NormalGL.png.")
    if material is not None and not scenes:
        raise InputError(
            f"'{path}' has no .gltf, .glb or .mtlx file, expected one that holds the material '{material}'."
        )
    explicit = explicit_roles(path, roles)
    unread = [name for name in names if name.lower().endswith(UNREAD_SUFFIXES)]
    bad = [name for name in images if not _is_utf8(name)]
    images = [name for name in images if name not in bad]
    named = roles_from_names(images, [name for name in images if has_alpha(path / name)])
    from_file, why = _by_file(path, scenes, named, material)
    texture_set = from_file or set_of_names(path, named, explicit)
    if why:
        texture_set.note(why)
    if bad:
        shown = ", ".join(name.encode("utf-8", "backslashreplace").decode() for name in bad)
        texture_set.note(f"Files whose names are not UTF-8 are not read: {shown}; rename them.")
    texture_set.maps = dict(sorted((texture_set.maps | explicit).items(), key=lambda item: ROLES.index(item[0])))
    used = {file.name for each in texture_set.maps.values() for file in each.paths}
    texture_set.ignored = [name for name in images if name not in used] + unread
    return texture_set


def _by_file(path: Path, scenes: list[str], named: NamedSet, material: str | None) -> tuple[TextureSet | None, str]:
    """The set of a folder by its one material file; or None, and why, where the names of its images are used instead.

    Occlusion and height, which the file may lack, are added by names.
    """
    has_surface = bool({"normal", "height"} & named.maps.keys())
    if len(scenes) != 1:
        several = f"'{path}' has {len(scenes)} material files ({', '.join(scenes)}): maps are taken by their names."
        return None, several if scenes and has_surface else ""
    scene = scenes[0]
    try:
        texture_set = read_material(path / scene, material)
        missing = [file.name for each in texture_set.maps.values() for file in each.paths if not file.exists()]
    except InputError as error:
        if not has_surface:
            raise
        return None, f"'{scene}' is not read, maps are taken by their names. {error}"
    if has_surface and missing:
        return None, f"'{scene}' names files that are not there ({missing[0]}): maps are taken by their names."
    if has_surface and not {"normal", "height"} & texture_set.maps.keys():
        return None, f"'{scene}' names no normal map, and the folder holds one: maps are taken by their names."
    texture_set.name = path.resolve().name
    for role in ("ao", "height"):
        found = named.maps.get(role)
        if found is not None and role not in texture_set.maps and not found.channel:
            texture_set.maps[role] = Map(role, path / found.file, word=found.word)
            texture_set.note(f"'{found.file}' is not in '{scene}': it is read as {role} by its name.")
    return texture_set, f"Maps and factors are those of '{scene}'." if has_surface else ""


def file_names(folder: Path) -> list[str]:
    """Names of the files of a folder, sorted, without hidden ones and links that lead nowhere (OSError)."""
    # What cannot be looked at is no file for os.path, but an error for pathlib.
    return sorted(name for name in os.listdir(folder) if name[0] != "." and os.path.isfile(folder / name))


def set_of_names(path: Path, named: NamedSet, explicit: dict[str, Map]) -> TextureSet:
    """The set of a folder by the names of its files; InputError where they are of several materials."""
    for role, files in named.rivals.items():
        if role not in explicit:
            raise InputError(
                f"'{path}' holds maps of more than one material ({', '.join(files)} all claim {role}), expected one; "
                f"name the maps with explicit roles such as {role}={files[0]}."
            )
    maps = {
        role: Map(role, path / found.file, found.channel, word=found.word)
        for role, found in named.maps.items()
        if role not in explicit
    }
    texture_set = TextureSet(name=path.resolve().name, maps=maps | explicit, notes=list(named.notes))
    normal_y_from_names(texture_set, named)
    return texture_set


def has_alpha(path: Path) -> bool:
    """Whether a picture has an alpha channel; one that cannot be read is an error only once it is used."""
    try:
        return len(read_info(path).channels) in (2, 4)
    except InputError:
        return False


def _is_utf8(name: str) -> bool:
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def explicit_roles(folder: Path, roles: dict[str, str]) -> dict[str, Map]:
    """Maps of roles given as FILE or FILE:CHANNEL; a packing gives several.

    Raises:
        InputError: for one channel of a normal map.
        UnknownNameError: for an unknown role.
    """
    maps: dict[str, Map] = {}
    for role, text in roles.items():
        file, _, channel = text.rpartition(":")
        if not file or channel.upper() not in ("R", "G", "B", "A"):
            file, channel = text, ""
        elif role == "normal":
            raise InputError(f"'{text}' is one channel, expected a whole picture as the normal map.")
        path = folder / file
        packed = packed_roles(role)
        if role in ROLES:
            maps[role] = Map(role, path, channel.upper())
        elif packed:
            for name, letter in zip(packed, "RGBA", strict=False):
                if name:
                    maps[name] = Map(name, path, letter)
        else:
            raise UnknownNameError("role", role, (*ROLES, "orm", "arm", "rma"))
    return maps


def normal_y_from_names(texture_set: TextureSet, named: NamedSet | None = None) -> None:
    """Take the normal's Y from the file's name, or from the naming convention of the whole set."""
    if "normal" not in texture_set.maps:
        return
    file = texture_set.maps["normal"].path.name
    if named is None or "normal" not in named.maps or named.maps["normal"].file != file:
        named = roles_from_names([file])  # it was given another role, or lies elsewhere
    texture_set.normal_y, texture_set.normal_y_source = "gl", "assumed"
    said = named.maps["normal"].normal_y if "normal" in named.maps else ""
    if said:
        texture_set.normal_y, texture_set.normal_y_source = said, "name"
    elif old_cc0textures(named):
        texture_set.normal_y, texture_set.normal_y_source = "dx", "convention"
