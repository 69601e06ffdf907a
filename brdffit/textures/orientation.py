"""What the maps of a set say of each other: which way a normal map's Y goes, and the scale of a height map.

The height map tells it by agreement. Without one the slopes themselves do: those of a surface have no curl,
dm_x/dy = dm_y/dx, and flipping y turns this correlation negative.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from brdffit.textures import encoding

if TYPE_CHECKING:
    from brdffit.textures.texture_set import TextureSet

#: Agreement (a correlation) from which the evidence for a normal's Y is believed.
DECISIVE = 0.2
#: Side of the crop on which this is measured, in texels.
_CROP = 1024
#: Correlation of slopes with a height's gradient from which the height's scale is taken from them.
_SCALE_AGREEMENT = 0.3


def settle_normal_y(texture_set: TextureSet, normal_y: str | None) -> None:
    """Decide the normal's Y where no name tells it: by the height map, by the slopes' curl, or assume OpenGL."""
    if normal_y is not None:
        texture_set.normal_y, texture_set.normal_y_source = normal_y, "given"
        return
    if texture_set.normal_y_source != "assumed":
        return
    file = texture_set.maps["normal"].path.name
    agreement, evidence = normal_y_agreement(texture_set)
    if abs(agreement) >= DECISIVE:
        texture_set.normal_y, texture_set.normal_y_source = ("gl" if agreement > 0.0 else "dx"), evidence
        said = "OpenGL (+Y)" if agreement > 0.0 else "DirectX (-Y)"
        why = "its slopes agree with the height map" if evidence == "height" else "its slopes then have the least curl"
        texture_set.note(
            f"The normal map '{file}' does not say whether it is OpenGL or DirectX: {said} is taken because {why} "
            f"(correlation {abs(agreement):.2f})."
        )
    else:
        texture_set.note(
            f"The normal map '{file}' does not say whether it is OpenGL or DirectX, and its slopes do not tell: OpenGL "
            f"(+Y) is assumed; give normal-y if it is not."
        )


def normal_y_agreement(texture_set: TextureSet) -> tuple[float, str]:
    """Evidence for the normal's Y as stored: a correlation, positive for OpenGL, and "height" or "slopes".

    With a height map: of the normal's y slope with the height's gradient. Without: of dm_x/dy with dm_y/dx, which are
    equal on any surface (its slopes have no curl) and opposite where y is flipped.
    """
    normal = texture_set.maps["normal"]
    pixels, noise = normal.read()
    if pixels.shape[2] < 2:
        return 0.0, "slopes"
    slope = encoding.slopes_of_normals(normal.vectors(pixels[:_CROP, :_CROP])[0])
    height = texture_set.maps.get("height")
    if height is not None and height.size == normal.size:
        field_, _ = height.quantity(height.read()[0])
        up = encoding.height_gradient(field_[:_CROP, :_CROP], "clamp")[:, :, 1]
        # A slope under a code step is no evidence; chrome's dither correlates with nothing.
        if float(slope[:, :, 1].std()) > noise.step and float(up.std()) > 0.0:
            agreement = _correlation(slope[:, :, 1], up)
            if abs(agreement) >= DECISIVE:
                return agreement, "height"
    if min(slope.shape[:2]) < 4 or float(slope.std()) <= noise.step:
        return 0.0, "slopes"
    along_x = encoding.height_gradient(slope[:, :, 0], "clamp")[1:-1, 1:-1, 1]
    along_y = encoding.height_gradient(slope[:, :, 1], "clamp")[1:-1, 1:-1, 0]
    return _correlation(along_x, along_y), "slopes"


def scale_from_slopes(height: NDArray, vectors: NDArray) -> float | None:
    """Factor of ``height`` (H, W) at which its gradient best fits the slopes of normals (H, W, 3); None if none does.

    Averaged over blocks of texels, the noise of an 8-bit height does not bias the regression towards zero; single
    texels keep sharp ridges; normals may be those of central differences or of the surface. Of these ways the one
    with the best correlation is taken.
    """
    height = height[:_CROP, :_CROP]
    slope = encoding.slopes_of_normals(vectors[:_CROP, :_CROP])
    best, scale = _SCALE_AGREEMENT, None
    for block in (1, 2, 4):
        if min(height.shape) < 3 * block:
            break
        gradient = encoding.height_gradient(_blocks(height, block), "clamp")[1:-1, 1:-1] / block
        blocks = _blocks(slope, block)
        middle = blocks[1:-1, 1:-1]
        # The mean slope between the two ends of a central difference, by Simpson's rule.
        across = (blocks[1:-1, :-2, 0] + 4.0 * middle[:, :, 0] + blocks[1:-1, 2:, 0]) / 6.0
        up = (blocks[:-2, 1:-1, 1] + 4.0 * middle[:, :, 1] + blocks[2:, 1:-1, 1]) / 6.0
        for fitted in (middle, np.stack([across, up], axis=2)):
            power = float(np.square(gradient).sum(dtype=np.float64))
            cross = float((gradient * fitted).sum(dtype=np.float64))
            norm = (power * float(np.square(fitted).sum(dtype=np.float64))) ** 0.5
            if norm > 0.0 and cross > best * norm:
                best, scale = cross / norm, cross / power
    return scale


def _blocks(array: NDArray, block: int) -> NDArray:
    rows, columns = array.shape[0] // block, array.shape[1] // block
    cut = array[: rows * block, : columns * block]
    return cut.reshape(rows, block, columns, block, *array.shape[2:]).mean(axis=(1, 3))


def _correlation(first: NDArray, second: NDArray) -> float:
    first, second = first - first.mean(), second - second.mean()
    norm = float(np.sqrt(np.square(first).sum(dtype=np.float64) * np.square(second).sum(dtype=np.float64)))
    return float((first * second).sum(dtype=np.float64)) / norm if norm > 0.0 else 0.0
