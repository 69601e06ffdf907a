"""What the maps of a set say of each other: their sizes, frames, border, the normal's Y and opacity."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from brdffit.errors import InputError
from brdffit.svbrdf import WRAPS
from brdffit.textures.coverage import DEFAULT_CUTOFF, NOTHING, looks_like_coverage
from brdffit.textures.frames import IDENTITY, common_frame
from brdffit.textures.orientation import settle_normal_y
from brdffit.textures.texture_set import MAX_SIDE, Map, TextureSet

#: Longest side of a map that may stand in for a constant, and how far its values may differ.
_STAND_IN, _CONSTANT = 64, 1.5 / 255.0


def settle(
    texture_set: TextureSet, path: Path, *, normal_y: str | None = None, wrap: str | None = None,
    height_scale: float | None = None, denoise_normals: bool = False, without: Collection[str] = (),
) -> None:  # fmt: skip
    """Hold the maps of a set against each other and settle their conventions; arguments as of ``read_texture_set``.

    Raises:
        InputError: when the maps cannot belong together, or there is no surface among them.
    """
    texture_set.height_scale, texture_set.denoise_normals = height_scale, denoise_normals
    settle_wrap(texture_set, path, wrap)
    settle_frames(texture_set, path)
    check_sizes(texture_set, path)
    if "normal" in without and texture_set.maps:
        return
    if not {"normal", "height"} & texture_set.maps.keys():
        _without_surface(texture_set, path)
    if "normal" in texture_set.maps:
        settle_normal_y(texture_set, normal_y)
    settle_opacity(texture_set)


def _without_surface(texture_set: TextureSet, path: Path) -> None:
    """A set without normal and height: of a material file with maps it is flat, else an InputError."""
    if texture_set.entry is not None and texture_set.maps:
        texture_set.note(f"The material of '{texture_set.entry.name}' has no normal map: its surface is flat.")
        return
    if texture_set.entry is not None:
        raise InputError(
            " ".join(
                [
                    f"'{path}' has no normal map and no height map, nor any other: its material is of constants alone.",
                    *texture_set.notes,
                ]
            )
        )
    found = ", ".join(f"{named.path.name} ({role})" for role, named in texture_set.maps.items()) or "no known role"
    of = "" if texture_set.name == path.resolve().name else f" for '{texture_set.name}'"
    raise InputError(
        f"'{path}' has no normal map and no height map{of} (found: {found}), expected one of them; name it with an "
        f"explicit role such as normal=FILE."
    )


def settle_opacity(texture_set: TextureSet) -> None:
    """Take the alpha of a base colour map for opacity, where nothing says what it is and it looks like a cut-out."""
    colour = texture_set.maps.get("base_color")
    taken = {(named.path, named.channel) for named in texture_set.maps.values()}
    if "opacity" in texture_set.maps:
        if texture_set.entry is None:
            texture_set.alpha_cutoff = DEFAULT_CUTOFF
        return
    if colour is None or texture_set.entry is not None or (colour.path, "A") in taken or colour.constant:
        return
    if len(colour.info.channels) not in (2, 4):
        return
    alpha = colour.read()[0][:, :, -1]
    if float(alpha.min()) >= 1.0 - NOTHING:
        return
    if looks_like_coverage(alpha):
        texture_set.maps["opacity"] = Map("opacity", colour.path, "A", colour.data, frame=colour.frame)
        texture_set.alpha_cutoff = DEFAULT_CUTOFF
        texture_set.note(f"The alpha of '{colour.path.name}' is that of a cut-out: it is read as opacity.")
    else:
        texture_set.note(
            f"The alpha of '{colour.path.name}' is not used: it does not look like a cut-out; name what it is, as in "
            f"--role opacity={colour.path.name}:A."
        )


def settle_wrap(texture_set: TextureSet, path: Path, wrap: str | None) -> None:
    """Take the given wrap, or else the file's, which must be known here and the same for all maps (InputError)."""
    if wrap is not None:
        texture_set.wrap = wrap
    elif texture_set.wrap not in WRAPS:
        raise InputError(
            f"The samplers of '{path}' say '{texture_set.wrap}', expected 'tile' or 'clamp' for all maps: give --wrap."
        )


def settle_frames(texture_set: TextureSet, path: Path) -> None:
    """Bring maps that are scaled or turned against each other to one frame; one that all share is the renderer's.

    Raises:
        InputError: where the others repeat a whole number of times in no map's frame, or the set does not tile.
    """
    frames = {role: named.frame for role, named in texture_set.maps.items()}
    if len(set(frames.values())) <= 1:
        if any(frame != IDENTITY for frame in frames.values()):
            texture_set.note(
                "All maps share a texture transform: it stays with the renderer, and changes no texel here."
            )
        for named in texture_set.maps.values():
            named.frame = IDENTITY
        return
    common = common_frame([frames[role] for role in sorted(frames, key=lambda role: role != "normal")])
    back = common.inverse() if common is not None and texture_set.wrap == "tile" else None
    if back is None:
        each = ", ".join(f"{role} {frame}" for role, frame in frames.items())
        raise InputError(
            f"The maps of '{path}' are scaled or turned against each other so that they do not tile together ({each}), "
            f"expected one texture transform, or such that each map repeats a whole number of times."
        )
    owners = ", ".join(role for role, frame in frames.items() if frame == common)
    moved = ", ".join(role for role, frame in frames.items() if frame != common)
    texture_set.note(f"Texture transforms differ: {moved} is read as it lies under the texels of {owners}.")
    for named in texture_set.maps.values():
        named.frame = named.frame.after(back)


def check_sizes(texture_set: TextureSet, path: Path) -> None:
    """Refuse maps that cannot be brought to one size; a map of one value throughout goes with any other."""
    if not texture_set.maps:
        return
    for named in texture_set.maps.values():
        height, width = named.size
        if max(height, width) > MAX_SIDE:
            raise InputError(f"'{named.path}' is {width}x{height} texels, expected at most {MAX_SIDE} a side.")
        if named.info.remark:
            texture_set.note(f"'{named.path.name}'{named.info.remark}")
    for named in texture_set.maps.values():
        if not _fits(named.size, texture_set.size):
            for small in (each for each in texture_set.maps.values() if not _fits(each.size, named.size)):
                small.constant = small.constant or (max(small.size) <= _STAND_IN and _is_constant(small))
            named.constant = named.constant or (max(named.size) <= _STAND_IN and _is_constant(named))
    full_height, full_width = texture_set.size
    for named in texture_set.maps.values():
        height, width = named.size
        if not _fits((height, width), (full_height, full_width)):
            raise InputError(
                f"The maps of '{path}' cannot belong together: '{named.path.name}' is {width}x{height} where the "
                f"largest map is {full_width}x{full_height}, expected the same proportions."
            )
    sizes = {(named.path.name, id(named.data)): named.size for named in texture_set.maps.values()}
    different = sorted({f"{w}x{h}" for h, w in sizes.values()})
    if len(different) > 1:
        texture_set.note(f"Maps of different sizes ({', '.join(different)}) are brought to {full_width}x{full_height}.")


def _fits(size: tuple[int, int], full: tuple[int, int]) -> bool:
    """Whether a map of ``size`` can be brought to ``full``: one texel of rounding on the shorter way is allowed."""
    (height, width), (full_height, full_width) = size, full
    return (
        size == (1, 1)
        or abs(width - full_width * height / full_height) <= 1.0
        or abs(height - full_height * width / full_width) <= 1.0
    )


def _is_constant(named: Map) -> bool:
    """Whether a map holds one value throughout."""
    pixels, _ = named.read()
    return float(np.ptp(pixels, axis=(0, 1)).max()) <= _CONSTANT
