"""Which texels hold surface: alpha, an opacity map, and the gutters of baked atlases.

What a set holds where nothing is drawn (the black beyond a leaf, the gutters between the islands of an atlas) is no
part of the material. It weighs almost nothing in any level (``svbrdf.LEAST_WEIGHT``), and at level 0 takes the values
of the nearest texel that counts, so that interpolation across the edge finds no dark texels.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.svbrdf import Svbrdf
from brdffit.textures.texture_set import TextureSet

#: Opacity below which a texel has no surface at all, half a code of 8 bits; least share of unused texels.
NOTHING, LEAST_SHARE = 0.5 / 255.0, 1e-4
#: Share of an alpha channel's texels at 0 or 1 from which it is taken for coverage, where nothing says what it is.
BIMODAL = 0.5
#: Opacity at which a cut-out is tested where nothing says it, as glTF has it.
DEFAULT_CUTOFF = 0.5


def looks_like_coverage(alpha: NDArray) -> bool:
    """Whether an alpha channel (H, W) is that of a cut-out: some of it is 0, and most of it is 0 or 1."""
    empty, full = alpha <= NOTHING, alpha >= 1.0 - NOTHING
    return bool(empty.any() and np.mean(empty | full) >= BIMODAL and full.any())


def covered(texture_set: TextureSet, svbrdf: Svbrdf, opacity: NDArray | None, unread: Collection[str] = ()) -> Svbrdf:
    """``svbrdf`` with its opacity (h, w, or one texel); texels without surface take their neighbours' values.

    Without an opacity map, texels that are black in every map count as unused; maps of ``unread`` roles are not looked
    at.

    Raises:
        InputError: where opacity is 0 everywhere.
    """
    factor = float(texture_set.factors.get("opacity", 1.0))
    if opacity is not None and not (opacity >= 1.0 - NOTHING).all():
        opacity = np.ascontiguousarray(np.broadcast_to(opacity, svbrdf.size), np.float32)
        if factor < 1.0:
            texture_set.note(f"The opacity's factor of {factor:g} stays with the renderer.")
        alpha = "mask" if texture_set.alpha_cutoff is not None else "blend"
        nothing = opacity <= NOTHING
        if nothing.all():
            file = texture_set.maps["opacity"].path
            raise InputError(f"'{file}' is 0 everywhere as opacity, expected some surface: is it transparency?")
        texture_set.note(
            f"Opacity weighs every map: {1.0 - float(opacity.mean()):.1%} of the surface is not there; the "
            f"{float(nothing.mean()):.1%} of texels without any take the values of their neighbours."
        )
        cutoff = DEFAULT_CUTOFF if texture_set.alpha_cutoff is None else texture_set.alpha_cutoff
        return _filled(svbrdf.replace(opacity=opacity, alpha=alpha, cutoff=cutoff), nothing)
    unused = _unused(texture_set, svbrdf.size, unread)
    if unused is None:
        return svbrdf
    texture_set.note(
        f"{float(unused.mean()):.1%} of the texels are black in every map, as the gutters of an atlas are: they weigh "
        f"nothing and take the values of their neighbours."
    )
    return _filled(svbrdf.replace(opacity=(~unused).astype(np.float32)), unused)


def _unused(texture_set: TextureSet, size: tuple[int, int], unread: Collection[str]) -> NDArray | None:
    """(H, W) texels that are black in every map; None where there are none, or too few maps to tell.

    A black normal is no direction at all: without a normal map a black texel may be black paint.
    """
    maps = {role: named for role, named in texture_set.maps.items() if role not in unread}
    normal = maps.get("normal")
    if normal is None or "base_color" not in maps or normal.size != size:
        return None
    if normal.encoding == "signed" or normal.info.is_float:
        return None
    unused: NDArray = np.ones(size, bool)
    files = {(named.path, id(named.data)): named for named in maps.values() if named.role != "opacity"}
    for named in sorted(files.values(), key=lambda each: each.role != "normal"):
        if named.size != size:
            return None
        unused &= ~(named.read()[0][:, :, :3] > NOTHING).any(axis=2)
        if float(unused.mean()) < LEAST_SHARE:
            return None
    return unused if not unused.all() else None


def _filled(svbrdf: Svbrdf, empty: NDArray) -> Svbrdf:
    """``svbrdf`` with the values of the nearest other texel where ``empty``, in every map but opacity."""
    if not empty.any() or empty.all():
        return svbrdf
    height, width = empty.shape
    # Search across the border too, where the texture tiles: the nearest texel is at most half a period away. 512 texels
    # bound the memory.
    room = tuple(min(side // 2 + 1, 512) if svbrdf.wrap == "tile" else 0 for side in empty.shape)
    wide = np.pad(empty, [(each, each) for each in room], mode="wrap")
    from scipy import ndimage  # half a second to import, of use to few sets

    rows, columns = ndimage.distance_transform_edt(wide, return_distances=False, return_indices=True)
    inner = tuple(slice(each, each + side) for each, side in zip(room, empty.shape, strict=True))
    row, column = (rows[inner][empty] - room[0]) % height, (columns[inner][empty] - room[1]) % width
    changes = {}
    for name, array in svbrdf.arrays().items():
        if name != "opacity":
            filled = array.copy()
            filled[empty] = array[row, column]
            changes[name] = filled
    return svbrdf.replace(**changes)
