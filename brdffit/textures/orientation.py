"""Conventions that the maps of a set imply for each other: a normal map's Y, and the sign and scale of a height map.

Evidence for the Y is weighed. A name that says it, or a file format that defines it, counts 1; a guess by a whole set's
names counts 0.5. The map's own slopes count by a correlation: those of a surface have no curl, dm_x/dy = dm_y/dx, and
flipping y turns it negative. A height map counts by the correlation of its gradient with the slopes, in y, relative to
that in x: where x disagrees as well, the height is inverted (white is deep) and says nothing against the normals.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from brdffit.textures import encoding

if TYPE_CHECKING:
    from brdffit.textures.texture_set import TextureSet

#: Agreement (a correlation) from which the evidence for a normal's Y is believed.
DECISIVE = 0.2
#: Strength of a guess by the names of a whole set; factor of a height map's correlation where none is seen in x.
_GUESS, _HALF_BLIND = 0.5, 0.5
#: Side of the crop on which this is measured, in texels.
_CROP = 1024
#: Correlation of slopes with a height's gradient from which the height's scale is taken from them.
_SCALE_AGREEMENT = 0.3
_SAID = {"gl": "OpenGL (+Y)", "dx": "DirectX (-Y)"}
_WHY = {
    "name": "its name says so", "convention": "the names of its set are those of such maps",
    "height": "its slopes agree with the height map", "slopes": "its slopes then have the least curl",
}  # fmt: skip


@dataclass(frozen=True)
class Evidence:
    """One piece of evidence for the normal's Y: "gl" or "dx", its strength in [0, 1], and where it comes from."""

    normal_y: str
    strength: float
    source: str


def settle_normal_y(texture_set: TextureSet, normal_y: str | None) -> None:
    """Decide the normal's Y: as it is given, as the file defines it, or by the strongest evidence; OpenGL without any.

    Where a name or a file states it, nothing is measured here, since that would read the map; ``contradiction`` is
    checked when the map is decoded.
    """
    if normal_y is not None:
        texture_set.normal_y, texture_set.normal_y_source = normal_y, "given"
        return
    guessed = texture_set.normal_y_source == "convention" and texture_set.entry is None
    if texture_set.normal_y_source != "assumed" and not guessed:
        return
    file = texture_set.maps["normal"].path.name
    found = measured_evidence(texture_set)
    if guessed:
        found.append(Evidence(texture_set.normal_y, _GUESS, "convention"))
    found = sorted((each for each in found if each.strength >= DECISIVE), key=lambda each: -each.strength)
    if not found:
        texture_set.note(
            f"The normal map '{file}' does not say whether it is OpenGL or DirectX, and its slopes do not tell: OpenGL "
            f"(+Y) is assumed; give normal-y if it is not."
        )
        return
    best = found[0]
    texture_set.normal_y, texture_set.normal_y_source = best.normal_y, best.source
    if best.source == "convention":
        texture_set.note(
            f"The normal map '{file}' is read as DirectX (-Y), as the older CC0Textures are by their names."
        )
    else:
        texture_set.note(
            f"The normal map '{file}' does not say whether it is OpenGL or DirectX: {_SAID[best.normal_y]} is taken "
            f"because {_WHY[best.source]} (correlation {best.strength:.2f})."
        )
    against = [each for each in found if each.normal_y != best.normal_y]
    if against:
        texture_set.note(
            f"The evidence for the Y of '{file}' contradicts itself: {against[0].source} speaks for "
            f"{_SAID[against[0].normal_y]} with {against[0].strength:.2f}; give normal-y if that is right."
        )


def measured_evidence(texture_set: TextureSet) -> list[Evidence]:
    """Evidence of the normal map and of the height map, as stored, for the normal's Y."""
    normal = texture_set.maps["normal"]
    pixels, noise = normal.read()
    if pixels.shape[2] < 2:
        return []
    slope = encoding.slopes_of_normals(normal.vectors(pixels[:_CROP, :_CROP])[0])
    found = []
    height = texture_set.maps.get("height")
    # A slope below a code step is no evidence: it is the dither of a flat map.
    if height is not None and height.size == normal.size and float(slope[:, :, 1].std()) > noise.step:
        values, _ = height.quantity(height.read()[0])
        x, y = height_agreement(values, slope)
        strength = abs(y) if abs(x) >= DECISIVE else _HALF_BLIND * abs(y)
        sign = y * (x if abs(x) >= DECISIVE else 1.0)
        found.append(Evidence("gl" if sign > 0.0 else "dx", strength, "height"))
    curl = curl_agreement(slope) if float(slope.std()) > noise.step else 0.0
    found.append(Evidence("gl" if curl > 0.0 else "dx", abs(curl), "slopes"))
    return found


def contradiction(vectors: NDArray) -> float:
    """How strongly the curl of decoded normals (H, W, 3), OpenGL, speaks against their Y: a correlation, or 0."""
    return max(0.0, -curl_agreement(encoding.slopes_of_normals(vectors[:_CROP, :_CROP])))


def curl_agreement(slope: NDArray) -> float:
    """Correlation of dm_x/dy with dm_y/dx of slopes (H, W, 2): positive where y goes up."""
    if min(slope.shape[:2]) < 4:
        return 0.0
    along_x = encoding.height_gradient(slope[:, :, 0], "clamp")[1:-1, 1:-1, 1]
    along_y = encoding.height_gradient(slope[:, :, 1], "clamp")[1:-1, 1:-1, 0]
    return _correlation(along_x, along_y)


def height_agreement(height: NDArray, slope: NDArray) -> tuple[float, float]:
    """Correlations of slopes (H, W, 2) with the gradient of a height (H, W), in x and in y."""
    gradient = encoding.height_gradient(height[:_CROP, :_CROP], "clamp")
    slope = slope[:_CROP, :_CROP]
    return _correlation(slope[:, :, 0], gradient[:, :, 0]), _correlation(slope[:, :, 1], gradient[:, :, 1])


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
