"""Pictures of a preset: from levels to channels, codes and blocks, and into the files that an engine loads.

Two pictures are made at a time, with all their levels. What is written is decoded again and compared with what was
baked, see ``cost``.
"""

from __future__ import annotations

import dataclasses
import io
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import decode_srgb, encode_srgb
from brdffit.errors import OutputError
from brdffit.export.beside import write_beside
from brdffit.export.channels import Channels, decode
from brdffit.export.compression import check_compression, encode_level, encode_uastc, require_basis
from brdffit.export.cost import Cost
from brdffit.export.coverage import share_above, with_alpha, with_kept_coverage
from brdffit.export.dds import write_dds
from brdffit.export.decompression import decode_blocks
from brdffit.export.factors import Factors, factors_of, largest_strength
from brdffit.export.formats import FORMATS, PixelFormat
from brdffit.export.geometry import Geometry
from brdffit.export.gltf import write_glb
from brdffit.export.ktx2 import write_ktx2
from brdffit.export.presets import Picture, Preset
from brdffit.files.image_io import write_mip_exr, write_png
from brdffit.footprint import filter_channels, get_pixel_filter
from brdffit.methods import Pyramid
from brdffit.roughness import log_from_tensor, tensor_from_log
from brdffit.svbrdf import Svbrdf, level_sizes, unit_or_up

#: The manifest's record of a picture, and for a GLB the bytes of its KTX2 file.
_Made = tuple[dict[str, Any], bytes]
_TEXELS_PER_BAND = 1 << 20
_PICTURES_AT_ONCE = 2
#: Float arithmetic may leave [0, 1] by a few ulps where nothing is lost.
_SLACK = 1e-5


class Count:
    """Counts pictures that are written, from any thread, and calls ``told`` with a line after each."""

    def __init__(self, told: Callable[[str], None] | None = None, total: int = 0) -> None:
        self._told, self._done, self._total, self._lock = told, 0, total, threading.Lock()

    def more(self, count: int) -> None:
        """``count`` more are to be written."""
        with self._lock:
            self._total += count

    def one_done(self) -> None:
        """One is written."""
        with self._lock:
            self._done += 1
            if self._told is not None:
                self._told(f"measuring and writing: {self._done} of {self._total} pictures written")


def check_preset(preset: Preset, bits: int = 8, size: tuple[int, int] | None = None) -> None:
    """Check, before the work, that a preset can be written.

    Raises:
        MissingEncoderError: when its encoder is not installed.
        OutputError: when it cannot store so many bits, or pictures of ``size`` (height, width).
    """
    if bits not in (8, 16):
        raise ValueError(f"bits is {bits}, expected 8 or 16")
    odd = size is not None and bool(size[0] % 4 or size[1] % 4)
    if odd and bits == 8 and preset.beside == "unity":
        assert size is not None
        raise OutputError(
            f"The preset '{preset.name}' needs sides that are multiples of 4 (Unity takes no other blocks), found "
            f"{size[1]}x{size[0]}: resize the maps, or leave blocks out with --bits 16."
        )
    if not any(picture.pixels == "uastc" for picture in preset.pictures):
        return
    require_basis(f"The preset '{preset.name}'")
    if bits == 16:
        raise OutputError(
            f"The preset '{preset.name}' stores UASTC, which has 8 bits a channel, not 16: leave --bits out, or choose "
            "'three' for 16-bit floats in KTX2."
        )
    if odd and preset.container == "glb":
        assert size is not None
        raise OutputError(
            f"The preset '{preset.name}' needs sides that are multiples of 4 (KHR_texture_basisu), found "
            f"{size[1]}x{size[0]}: resize the maps, or choose the preset 'three'."
        )


def write_pictures(
    pyramid: Pyramid, fresh: Path, name: str, preset: Preset, bits: int = 8, compress: str = "good",
    geometry: Geometry | None = None, count: Count | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Write the files of a preset below ``fresh``.

    Args:
        pyramid: what a method returned.
        fresh: folder of the set.
        name: of the set, in the files' names.
        preset: what to write.
        bits: 8; or 16: PNG of 16 bits, and floats of 16 bits instead of blocks in DDS and KTX2.
        compress: one of COMPRESSIONS, how long encoders of blocks may take.
        geometry: the geometry that a GLB shows; None for a rectangle.
        count: counts each picture.

    Returns:
        For the manifest: ``pictures``, a record by role, and ``stored``, the figures of ``Cost`` for each level.
    """
    check_preset(preset, bits)
    check_compression(compress)
    # A PNG chain may stop where the pyramid does; readers of containers refuse that.
    levels = [level.svbrdf for level in pyramid.levels]
    if preset.container != "png":
        levels = full_chain(levels)
    levels = with_kept_coverage(levels)
    folder = fresh / ("mips" if preset.container == "png" else preset.name)
    folder.mkdir()
    drawing = Drawing(levels, preset)
    cost = Cost(levels[: len(pyramid)], preset.normal_y, drawing.factors)
    chosen = [with_alpha(picture, levels[0]) for picture in wanted_pictures(preset, pyramid, drawing.factors)]

    count = count or Count()
    count.more(len(chosen))

    def write(picture: Picture) -> _Made:
        path = folder / f"{name}_{picture.role}.{preset.container}"
        made = _write_picture(path, picture, preset, bits, compress, drawing, cost)
        count.one_done()
        return made

    made = _at_once(write, chosen)
    roles = [picture.role for picture in chosen]
    if preset.container == "glb":
        with (folder / f"{name}.glb").open("wb") as stream:
            cutoff = levels[0].cutoff if levels[0].alpha == "mask" else None
            alpha = levels[0].alpha if levels[0].opacity is not None else ""
            textures = {role: data for role, (_, data) in zip(roles, made, strict=True)}
            write_glb(
                stream, textures, name, levels[0].size, levels[0].wrap, alpha=alpha, cutoff=cutoff,
                factors=drawing.factors, geometry=geometry,
            )  # fmt: skip
    write_beside(preset, folder, name, levels[0], roles)
    records = {role: record for role, (record, _) in zip(roles, made, strict=True)}
    factors = {"factors": dataclasses.asdict(drawing.factors)} if preset.factors else {}
    return {"pictures": records, "stored": cost.figures()} | factors | _of_alpha(levels)


def _at_once(write: Callable[[Picture], _Made], chosen: Sequence[Picture]) -> list[_Made]:
    """Write pictures, two at a time: the encoder of UASTC uses one core. The first failure ends it."""
    with ThreadPoolExecutor(_PICTURES_AT_ONCE) as pool:
        waiting = [pool.submit(write, picture) for picture in chosen]
        try:
            return [each.result() for each in waiting]
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def wanted_pictures(preset: Preset, pyramid: Pyramid, factors: Factors) -> list[Picture]:
    """The pictures of a preset for which a pyramid has something."""
    has = {
        "": True,
        "anisotropy": pyramid.options.lobe == "anisotropic",
        "occlusion": pyramid.levels[0].svbrdf.occlusion is not None,
        "specular": factors.specular is not None,
    }
    return [picture for picture in preset.pictures if has[picture.needs]]


def _write_picture(
    path: Path, picture: Picture, preset: Preset, bits: int, compress: str, drawing: Drawing, cost: Cost
) -> _Made:
    """Write all levels of a picture."""
    pixels = pixels_of(picture, preset, bits)
    srgb, codes = encoding_of(picture, preset, pixels, bits)
    encoded, clipped = drawing.draw(picture, srgb, codes)
    size = drawing.size
    data = None if pixels is None else to_blocks(pixels, encoded, compress)
    texture = b""
    if pixels is None or data is None:
        _write_plain(path, picture, encoded)
    elif preset.container == "glb":
        file = io.BytesIO()
        write_ktx2(file, pixels, size, data.__getitem__, zstd=preset.zstd)
        texture = file.getvalue()
    else:
        with path.open("wb") as stream:
            if preset.container == "dds":
                write_dds(stream, pixels, size, data.__getitem__)
            else:
                write_ktx2(stream, pixels, size, data.__getitem__, zstd=preset.zstd)
    record = {
        "channels": picture.channels,
        "srgb": srgb,
        "pixels": pixels.name if pixels is not None else "float" if codes is None else f"unorm{codes}",
        "clipped_values": clipped,
        **cost.add(picture, srgb, encoded, pixels, data),
    }
    return record, texture


def _of_alpha(levels: Sequence[Svbrdf]) -> dict[str, Any]:
    """For the manifest: the mode of alpha, and the share of each level that passes its test."""
    base = levels[0]
    if base.opacity is None or not base.alpha:
        return {}
    if base.alpha != "mask":
        return {"alpha": {"mode": base.alpha}}
    shares = [round(share_above(each.opacity, base.cutoff), 4) for each in levels if each.opacity is not None]
    return {"alpha": {"mode": base.alpha, "cutoff": base.cutoff, "tested_share": shares}}


def stored_levels(pyramid: Pyramid, preset: Preset, compress: str = "good") -> list[Svbrdf]:
    """The levels as an engine reads them: drawn as a preset's pictures of 8 bits, compressed and decoded."""
    levels = [level.svbrdf for level in pyramid.levels]
    drawing = Drawing(levels, preset)
    channels: list[dict[str, NDArray]] = [{} for _ in levels]
    for picture in wanted_pictures(preset, pyramid, drawing.factors):
        pixels = pixels_of(picture, preset, 8)
        srgb, bits = encoding_of(picture, preset, pixels, 8)
        encoded, _ = drawing.draw(picture, srgb, bits)
        data = None if pixels is None else to_blocks(pixels, encoded, compress)
        for level, exact in enumerate(encoded):
            stored = exact if bits is None else exact / np.float32(2**bits - 1)
            if pixels is not None and data is not None:
                stored = decode_blocks(pixels, exact.shape[:2], data[level])
            for place, channel in enumerate(picture.channels):
                values = stored[..., place]
                channels[level][channel] = decode_srgb(values) if srgb and place < 3 else values
    return [decode(each, preset.normal_y, drawing.factors).replace(wrap=levels[0].wrap) for each in channels]


def encoding_of(picture: Picture, preset: Preset, pixels: PixelFormat | None, bits: int) -> tuple[bool, int | None]:
    """Whether a picture is encoded as sRGB, and bits of its codes; None where its encoder takes floats."""
    is_float = preset.container == "exr" or (pixels is not None and pixels.is_float)
    takes_floats = is_float or (pixels is not None and pixels.takes_floats)
    return picture.srgb and not is_float, None if takes_floats else bits


def pixels_of(picture: Picture, preset: Preset, bits: int) -> PixelFormat | None:
    """The pixel format of a picture; None where its container has a single one (PNG, EXR)."""
    if preset.container in ("png", "exr"):
        return None
    if bits == 16:
        return FORMATS["rgba16f"]
    name = picture.pixels
    if name == "uastc" and len(picture.channels) == 4:
        name = "uastc_rgba"
    return FORMATS[name + ("_srgb" if picture.srgb else "")]


def to_blocks(pixels: PixelFormat, levels: Sequence[NDArray], compress: str) -> list[bytes]:
    """Data of each level (H, W, C), uint8 or float32, in a pixel format."""
    if pixels.vulkan != 0:
        return [encode_level(pixels, level, compress) for level in levels]
    wide = []
    for level in levels:
        full = np.full((*level.shape[:2], 4), 255, np.uint8)
        full[..., : level.shape[2]] = level
        wide.append(full)
    return encode_uastc(pixels, wide, compress)


class Drawing:
    """Draws pictures of levels: one half plane for all directions, one scale for their lengths, the same factors.

    Trilinear filtering would otherwise mix a direction with its opposite.
    """

    def __init__(self, levels: Sequence[Svbrdf], preset: Preset) -> None:
        self._levels = levels
        self._normal_y = preset.normal_y
        self._towards = dominant_direction(levels[0])
        #: By which values are divided: what the preset's material multiplies.
        self.factors = factors_of(levels) if preset.factors else Factors()
        self._strongest = self.factors.strength if preset.factors else largest_strength(levels)

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of level 0."""
        return self._levels[0].size

    def draw(self, picture: Picture, srgb: bool, bits: int | None) -> tuple[list[NDArray], list[int]]:
        """(H, W, C) of each level, and how many values of it lay outside [0, 1] and were clipped.

        Args:
            picture: which channels.
            srgb: encode the first three of them.
            bits: 8 or 16: unsigned codes; None: float32.
        """
        pictures, counts = [], []
        for level in self._levels:
            out = np.empty((*level.size, len(picture.channels)), np.float32 if bits is None else f"uint{bits}")
            clipped = 0
            for rows in bands(level.size):
                channels = Channels(rows_of(level, rows), self._normal_y, self._towards, self._strongest, self.factors)
                for place, channel in enumerate(picture.channels):
                    values = channels[channel]
                    clipped += int(np.count_nonzero((values < -_SLACK) | (values > 1.0 + _SLACK)))
                    values = encode_srgb(values) if srgb and place < 3 else values
                    out[rows, :, place] = np.clip(values, 0.0, 1.0) if bits is None else quantise(values, bits)
            pictures.append(out)
            counts.append(clipped)
        return pictures, counts


def quantise(values: NDArray, bits: int) -> NDArray:
    """[0, 1] to codes of uint8 or uint16, halves upwards; values outside are clipped."""
    top = 2**bits - 1
    return np.floor(np.clip(values, 0.0, 1.0) * top + 0.5).astype(f"uint{bits}")


def dominant_direction(svbrdf: Svbrdf) -> tuple[float, float]:
    """Unit direction of larger roughness that most texels agree on: mean of log Sigma's deviator, at half its angle."""
    a, b, c = svbrdf.log_roughness.reshape(-1, 3).mean(axis=0, dtype=np.float64)
    angle = 0.5 * np.arctan2(2.0 * c, a - b)
    return float(np.cos(angle)), float(np.sin(angle))


def full_chain(levels: Sequence[Svbrdf]) -> list[Svbrdf]:
    """Levels down to 1x1: missing ones are box averages of the last, where Sigma is averaged, not its logarithm."""
    levels = list(levels)
    sizes = level_sizes(levels[0].size)
    box, last = get_pixel_filter("box"), levels[-1]
    for size in sizes[len(levels) :]:
        averaged: dict[str, NDArray] = {}
        for name, array in last.arrays().items():
            source = tensor_from_log(array) if name == "log_roughness" else array
            source = source if source.ndim == 3 else source[..., None]
            found = filter_channels(np.ascontiguousarray(source, np.float32), size, box, last.wrap)
            averaged[name] = (
                log_from_tensor(found) if name == "log_roughness" else found.reshape(*size, *array.shape[2:])
            )
        averaged["normal"] = unit_or_up(averaged["normal"])
        levels.append(last.replace(**averaged))
    return levels


def bands(size: tuple[int, int]) -> Iterator[slice]:
    """Bands of a picture's rows, which bound the memory of arrays derived from them."""
    rows = max(1, _TEXELS_PER_BAND // size[1])
    for start in range(0, size[0], rows):
        yield slice(start, min(start + rows, size[0]))


def rows_of(svbrdf: Svbrdf, rows: slice) -> Svbrdf:
    """Some rows of a level."""
    return svbrdf.replace(**{field: array[rows] for field, array in svbrdf.arrays().items()})


def _write_plain(path: Path, picture: Picture, levels: Sequence[NDArray]) -> None:
    """A PNG a level, or one EXR with all of them."""
    if path.suffix == ".png":
        for level, codes in enumerate(levels):
            write_png(path.with_name(f"{path.stem}.{level}.png"), codes, quick=True)
    else:
        names = {1: ("Y",), 3: ("R", "G", "B"), 4: ("R", "G", "B", "A")}[len(picture.channels)]
        write_mip_exr(path, levels, names)
