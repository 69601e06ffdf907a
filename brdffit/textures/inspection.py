"""What was found in a texture set and what looks wrong with it: plain data for the command ``inspect``."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.roughness import perceptual_from_log_tensor
from brdffit.svbrdf import Svbrdf
from brdffit.textures.conversion import scalar_map, to_svbrdf
from brdffit.textures.noise_floor import subtract_noise_floor
from brdffit.textures.orientation import DECISIVE, measured_evidence
from brdffit.textures.texture_set import TextureSet

#: Mean length of stored normals below which they are called short.
SHORT_LENGTH = 0.95
#: Slope from which a normal is called steep, and the share of such texels from which it is reported.
STEEP_SLOPE, STEEP_SHARE = 4.0, 0.001
#: Tilt of the mean normal, in degrees, from which it is reported.
TILT_DEGREES = 2.0
#: Rounding of float32 and the colour noise of JPEG: a map that varies by less is constant.
_CONSTANT = 1.5 / 255.0


@dataclass(frozen=True)
class MapReport:
    """One map: role, file name, channel ("" for all), size in texels, stored bits, and how it is decoded."""

    role: str
    file: str
    channel: str
    width: int
    height: int
    bits: int
    is_float: bool
    decoding: str


@dataclass
class Inspection:
    """A texture set as ``inspect`` shows it.

    Attributes:
        name: of the set.
        size: (height, width) of the largest map.
        wrap: "tile" or "clamp".
        normal_y: "gl" or "dx".
        normal_y_source: how it is known: "given", "name", "convention", "height", "slopes" or "assumed".
        maps: one report a role.
        ignored: image files without a use.
        statistics: by name; numbers or tuples of numbers. Slopes and normals are those after decoding.
        wrong: what looks wrong, one sentence each.
        notes: what was assumed or mended, one sentence each.
    """

    name: str
    size: tuple[int, int]
    wrap: str
    normal_y: str
    normal_y_source: str
    maps: list[MapReport]
    ignored: list[str]
    statistics: dict[str, float | tuple[float, ...]] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def inspect_set(texture_set: TextureSet) -> Inspection:
    """Read every map of a set, gather statistics, and say what looks wrong, also why a set cannot be decoded.

    Raises:
        InputError: when a map cannot be read at all.
    """
    inspection = Inspection(
        name=texture_set.name,
        size=texture_set.size,
        wrap=texture_set.wrap,
        normal_y=texture_set.normal_y,
        normal_y_source=texture_set.normal_y_source,
        maps=[_report(texture_set, role) for role in texture_set.maps],
        ignored=list(texture_set.ignored),
    )
    sizes = sorted({(report.width, report.height) for report in inspection.maps})
    if len(sizes) > 1:
        inspection.wrong.append(f"The maps have different sizes: {', '.join(f'{w}x{h}' for w, h in sizes)}.")
    for role in texture_set.maps:
        _look_at_map(inspection, texture_set, role)
    try:
        svbrdf = to_svbrdf(texture_set)
    except InputError as error:
        inspection.wrong.append(str(error))
    else:
        _gather(inspection, texture_set, svbrdf)
    inspection.notes += texture_set.notes
    return inspection


def _report(texture_set: TextureSet, role: str) -> MapReport:
    named = texture_set.maps[role]
    info = named.info
    decoding = "data"
    if role in ("base_color", "specular"):
        decoding = "linear" if info.is_float else "sRGB"
    elif role == "normal":
        decoding = {"gl": "OpenGL (+Y)", "dx": "DirectX (-Y)"}[texture_set.normal_y]
    return MapReport(role, named.path.name, named.channel, info.width, info.height, info.bits, info.is_float, decoding)


def _look_at_map(inspection: Inspection, texture_set: TextureSet, role: str) -> None:
    """Look at one map as stored, before it is decoded."""
    named = texture_set.maps[role]
    pixels, noise = named.read()
    if role != "normal":
        values = pixels[:, :, :3]
        if role != "base_color":
            values, _ = named.quantity(pixels)
        if values.size > 3 and float(np.ptp(values, axis=(0, 1)).max()) <= _CONSTANT:
            inspection.wrong.append(f"The {role} of '{named.path.name}' is constant ({float(values.mean()):.3f}).")
        return
    if pixels.shape[2] < 2:
        return
    vectors = named.vectors(pixels)[0]
    if vectors.shape[2] == 3 and float(np.ptp(vectors[:, :, 2])) > 0.0:
        length = float(np.sqrt(np.square(vectors).sum(axis=2)).mean(dtype=np.float64))
        inspection.statistics["stored_normal_length"] = length
        if length < SHORT_LENGTH:
            inspection.wrong.append(
                f"The normals of '{named.path.name}' are short (mean length {length:.2f} at level 0, expected 1): they "
                f"were averaged or squeezed before; they are normalised here."
            )
    xy = vectors[:, :, :2]
    spread = float(xy.std())
    if 0.0 < spread < 4.0 * noise.step:
        kept = float(subtract_noise_floor(xy, noise, texture_set.wrap).std(axis=(0, 1)).max())
        if kept < 0.1 * noise.step:
            read = "is read as flat" if texture_set.denoise_normals else "--denoise-normals reads it as flat"
            inspection.wrong.append(
                f"'{named.path.name}' is flat: it only dithers between neighbouring codes of its {named.info.bits} "
                f"bits (standard deviation {spread / noise.step:.1f} codes); {read}."
            )
    found = measured_evidence(texture_set)
    says = {"gl": "OpenGL", "dx": "DirectX"}
    weighed = ", ".join(
        f"{each.source} for {says[each.normal_y]} {each.strength:.2f}" for each in found if each.strength
    )
    inspection.notes.append(
        f"The normal's Y is read as {says[texture_set.normal_y]}; this is known from: {texture_set.normal_y_source}. "
        f"Correlations: {weighed or 'none could be measured'}."
    )
    best = max(found, key=lambda each: each.strength)
    if best.strength >= DECISIVE and best.normal_y != texture_set.normal_y:
        why = "the height map" if best.source == "height" else "the slopes' curl"
        inspection.wrong.append(
            f"'{named.path.name}' is read as {texture_set.normal_y.upper()}, but {why} speaks for "
            f"{best.normal_y.upper()} (correlation {best.strength:.2f}): check normal-y."
        )


def _gather(inspection: Inspection, texture_set: TextureSet, svbrdf: Svbrdf) -> None:
    normal = svbrdf.normal
    mean = normal.reshape(-1, 3).mean(axis=0, dtype=np.float64)
    slope = normal[:, :, :2] / normal[:, :, 2:]
    roughness = perceptual_from_log_tensor(svbrdf.log_roughness)
    statistics = inspection.statistics
    statistics["mean_normal"] = tuple(float(value) for value in mean)
    statistics["slope_spread"] = tuple(float(value) for value in slope.std(axis=(0, 1), dtype=np.float64))
    statistics["normal_length_8x8"] = _mean_length(normal, 8)
    statistics["roughness_mean"] = float(roughness.mean(dtype=np.float64))
    statistics["roughness_range"] = (float(roughness.min()), float(roughness.max()))
    metallic = scalar_map(texture_set, "metallic")
    if metallic is not None:
        statistics["metallic_share"] = float(np.mean(metallic > 0.5))
    steep = float(np.mean(np.square(slope).sum(axis=2) > STEEP_SLOPE**2))
    if steep > STEEP_SHARE:
        inspection.wrong.append(
            f"{steep:.1%} of the normals are steeper than {np.degrees(np.arctan(STEEP_SLOPE)):.0f} degrees: methods "
            f"that average slopes (LEAN) will suffer from them."
        )
    tilt = float(np.degrees(np.arctan2(np.hypot(mean[0], mean[1]), mean[2])))
    if tilt > TILT_DEGREES:
        inspection.wrong.append(f"The mean normal leans by {tilt:.1f} degrees from z, expected a level surface.")


def _mean_length(normal: NDArray, block: int) -> float:
    """Mean length of the mean of unit normals over blocks of block x block texels, or of the whole if it is smaller."""
    rows, columns = (min(block, side) for side in normal.shape[:2])
    height, width = normal.shape[0] // rows * rows, normal.shape[1] // columns * columns
    blocks = normal[:height, :width].reshape(height // rows, rows, width // columns, columns, 3)
    return float(np.sqrt(np.square(blocks.mean(axis=(1, 3))).sum(axis=2)).mean())
