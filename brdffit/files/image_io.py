"""Images in and out: the one file that imports OpenImageIO.

OpenImageIO raises nothing: calls return None or False and the words are in ``geterror()``, and a truncated JPEG
returns an array all the same. Every call is followed by a look at the error, here and nowhere else.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from brdffit.errors import InputError, OutputError
from brdffit.files.exr_chunks import is_complete
from brdffit.files.layout import default_layer, upright

#: File types that are read as maps of a texture set.
IMAGE_SUFFIXES = (
    ".png", ".jpg", ".jpeg", ".jpe", ".jif", ".jfif", ".jfi", ".exr", ".sxr", ".mxr", ".tif", ".tiff", ".tx", ".tga",
    ".tpic", ".bmp", ".dib", ".webp", ".hdr", ".rgbe", ".dds", ".jp2", ".j2k", ".j2c", ".jph", ".jxl", ".psd", ".psb",
    ".gif", ".ico", ".dpx", ".cin", ".pnm", ".ppm", ".pgm", ".pbm", ".pfm", ".rla", ".sgi", ".rgb", ".rgba", ".iff",
    ".fits", ".pic",
)  # fmt: skip
#: File types that hold pictures or materials but are not read: ``inspect`` lists them as unused.
UNREAD_SUFFIXES = (
    ".ktx", ".ktx2", ".basis", ".avif", ".heic", ".heif", ".svg", ".pdf", ".sbsar", ".sbs", ".spp", ".usd", ".usda",
    ".usdc", ".usdz", ".blend", ".fbx", ".obj", ".mtl", ".mat", ".uasset", ".tres", ".vmt", ".vtf", ".pcx", ".crn",
    ".astc", ".pvr", ".xcf", ".kra", ".raw", ".rat",
)  # fmt: skip
#: Side of the tiles of written EXR files, in texels.
TILE_SIZE = 64

#: libpng's flag for Paeth's predictor.
_PNG_FILTER_PAETH = 0x80
_BITS = {"uint8": 8, "int8": 8, "uint16": 16, "int16": 16, "uint32": 32, "int32": 32, "half": 16, "float": 32}


@dataclass(frozen=True)
class ImageInfo:
    """What the header of an image file says.

    Attributes:
        path: the file.
        width, height: size in texels.
        channels: channel names in file order.
        bits: stored bits per channel (8 or 16 for integers, 16 for half, 32 for float).
        is_float: whether the file stores half or float.
        format: name of the file format ("png", "jpeg", "openexr", ...).
        orientation: how it is stored, 1 to 8 as in Exif; width and height are those of the picture set upright.
        associated: whether the file says that its colours are multiplied by alpha.
        part: number of the part that is read, where the file has several.
        picked: indices of its channels among those of the file, where the file holds more; () for all.
        remark: what of the file is left out, or "".
    """

    path: Path
    width: int
    height: int
    channels: tuple[str, ...]
    bits: int
    is_float: bool
    format: str
    orientation: int = 1
    associated: bool = False
    part: int = 0
    picked: tuple[int, ...] = ()
    remark: str = ""

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the file's bytes, in hexadecimal."""
        return file_sha256(self.path)


@dataclass(frozen=True, kw_only=True)
class Image(ImageInfo):
    """An image file with its pixels.

    Attributes:
        pixels: (H, W, C) float32, row 0 at the top; integer formats scaled to [0, 1], float formats as stored.
    """

    pixels: NDArray[np.float32]


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal.

    Raises:
        InputError: when the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}.") from error


def read_info(path: str | Path, data: bytes | None = None) -> ImageInfo:
    """The header of an image file, without its pixels; ``data`` are the bytes of an image embedded in ``path``.

    Raises:
        InputError: when the file is missing, empty, unreadable or no image.
    """
    path = Path(path)
    with _embedded(path, data) as file:
        reader, info = open_reader(path, file)
        reader.close()
    return info


def read_image(path: str | Path, data: bytes | None = None) -> Image:
    """Read a file at full resolution, set upright; colours are divided by associated alpha, and stay undecoded.

    Of a file of several parts the first with colours is read, of several layers the first. ``data`` are the bytes of
    an image that is embedded in ``path``.

    Raises:
        InputError: when the file is missing, empty, unreadable, no image, or truncated (JPEG too).
    """
    path = Path(path)
    with _embedded(path, data) as file:
        reader, info = open_reader(path, file)
        try:
            count = reader.spec().nchannels
            pixels = reader.read_image(info.part, 0, 0, count, oiio.FLOAT)
            # A truncated JPEG returns an array: only the error shows it.
            problem = error_of(reader) if reader.has_error else ""
        except MemoryError as error:
            raise InputError(
                f"'{path}' says it is {info.width}x{info.height} with {count} channels, more than there is memory for."
            ) from error
        finally:
            reader.close()
    if pixels is None or problem:
        raise InputError(
            f"'{path}' is truncated or damaged ({one_line(problem)}), expected {info.width}x{info.height} pixels."
        )
    stored = (info.height, info.width) if info.orientation < 5 else (info.width, info.height)
    pixels = as_said(info, np.asarray(pixels, dtype=np.float32).reshape(*stored, count))
    pixels = np.ascontiguousarray(upright(pixels, info.orientation))
    return Image(**{name: getattr(info, name) for name in ImageInfo.__dataclass_fields__}, pixels=pixels)


def as_said(info: ImageInfo, pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Pixels (h, w, C) of a file: the channels that are read, their colours divided by associated alpha."""
    if info.picked:
        pixels = pixels[:, :, info.picked]
    if info.associated:
        alpha = pixels[:, :, -1:]
        colours = np.divide(pixels[:, :, :-1], alpha, out=np.zeros_like(pixels[:, :, :-1]), where=alpha > 0.0)
        pixels = np.concatenate([colours if info.is_float else np.minimum(colours, 1.0), alpha], axis=2)
    return pixels


def write_png(path: str | Path, pixels: NDArray, quick: bool = False) -> None:
    """Write (H, W) or (H, W, C) uint8 or uint16 pixels, C from 1 to 4, as a PNG; alpha is stored unassociated.

    ``quick`` writes large maps in less than half the time, into files some 5% larger.

    Raises:
        OutputError: when the file cannot be written in full.
    """
    path = Path(path)
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.dtype not in (np.uint8, np.uint16) or not 1 <= pixels.shape[2] <= 4:
        raise ValueError(f"a PNG holds 1 to 4 channels of uint8 or uint16, not {pixels.shape} {pixels.dtype}")
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, str(pixels.dtype))
    spec.attribute("oiio:UnassociatedAlpha", 1)
    # A quarter faster than the default of 6, and files 1% larger.
    spec.attribute("png:compressionLevel", 2 if quick else 4)
    if quick:
        # Paeth's predictor for all rows: most of the time goes into trying every filter on each.
        spec.attribute("png:filter", _PNG_FILTER_PAETH)
    writer = _create(path, "png")
    _check(writer.open(str(path), spec), writer, path)
    _check(writer.write_image(np.ascontiguousarray(pixels)), writer, path)
    _check(writer.close(), writer, path)
    with path.open("rb") as file:
        file.seek(-min(12, path.stat().st_size), 2)
        if file.read()[4:8] != b"IEND":
            raise OutputError(f"'{path}' could not be written in full: is the disk full?")


def write_mip_exr(
    path: str | Path,
    levels: Sequence[NDArray],
    channel_names: Sequence[str],
    attributes: Mapping[str, str | int | float] | None = None,
) -> None:
    """Write a tiled, MIP-mapped float EXR with these levels as they are; the same input gives the same bytes.

    Args:
        path: the file; its suffix must be .exr.
        levels: (h, w, C) float32 arrays, level 0 first, each half the one before (rounded down) to 1x1.
        channel_names: C names.
        attributes: further header attributes.

    Raises:
        OutputError: when the file cannot be written in full.
    """
    path = Path(path)
    if levels[-1].shape[:2] != (1, 1):
        # OpenImageIO closes a chain that stops short without complaint, and reads the missing levels back as None.
        raise ValueError(f"the last MIP level is {levels[-1].shape[:2]}, expected (1, 1)")
    writer = _create(path, "openexr")
    for mip_level, level in enumerate(levels):
        height, width, channels = level.shape
        if channels != len(channel_names):
            raise ValueError(f"level {mip_level} has {channels} channels, expected {tuple(channel_names)}")
        spec = oiio.ImageSpec(width, height, channels, "float")
        spec.channelnames = tuple(channel_names)
        spec.alpha_channel = -1
        spec.tile_width = spec.tile_height = TILE_SIZE
        spec.tile_depth = 1
        spec.attribute("textureformat", "Plain Texture")
        # The level of zip that is quickest: two thirds of the time, and files 5 to 8% larger.
        spec.attribute("compression", "zip:1")
        # Without this date the writer stores the present one, and no two bakes would have the same bytes.
        spec.attribute("DateTime", "1970:01:01 00:00:00")
        for name, value in (attributes or {}).items():
            spec.attribute(name, value)
        opened = writer.open(str(path), spec) if mip_level == 0 else writer.open(str(path), spec, "AppendMIPLevel")
        _check(opened, writer, path)
        _check(writer.write_image(np.ascontiguousarray(level, dtype=np.float32)), writer, path)
    _check(writer.close(), writer, path)
    # On a full disk the writer ends a truncated file without a word; the last bytes are written when it is let go.
    del writer
    if not is_complete(path):
        raise OutputError(f"'{path}' could not be written in full: is the disk full?")


def read_mip_exr(path: str | Path, channel_names: Sequence[str] | None = None) -> list[NDArray[np.float32]]:
    """All MIP levels of a file, level 0 first, as (h, w, C) float32.

    An EXR file keeps its channels sorted by name (XX, XY, YY); ``channel_names`` gives the order wanted here.

    Raises:
        InputError: as ``read_image``, and when a level cannot be read or a channel is missing.
    """
    path = Path(path)
    reader, info = open_reader(path, path)
    missing = [name for name in channel_names or () if name not in info.channels]
    if missing:
        reader.close()
        raise InputError(
            f"'{path}' has the channels {', '.join(info.channels)}, expected {', '.join(channel_names or ())}."
        )
    order = [info.channels.index(name) for name in channel_names or info.channels]
    levels: list[NDArray[np.float32]] = []
    try:
        while reader.seek_subimage(0, len(levels)):
            spec = reader.spec()
            pixels = reader.read_image(0, len(levels), 0, spec.nchannels, oiio.FLOAT)
            problem = error_of(reader) if reader.has_error else ""
            if pixels is None or problem:
                raise InputError(f"'{path}' is damaged at MIP level {len(levels)} ({one_line(problem)}).")
            shaped = np.asarray(pixels, dtype=np.float32).reshape(spec.height, spec.width, spec.nchannels)
            in_order = order == list(range(spec.nchannels))
            levels.append(np.ascontiguousarray(shaped if in_order else shaped[:, :, order]))
    finally:
        reader.close()
    return levels


@contextmanager
def _embedded(path: Path, data: bytes | None) -> Iterator[Path]:
    """The file to read: ``path``, or a temporary one with the embedded bytes (the bindings read files only)."""
    if data is None:
        yield path
        return
    suffix = ".jpg" if data[:2] == b"\xff\xd8" else ".webp" if data[8:12] == b"WEBP" else ".png"
    suffix = ".dds" if data[:4] == b"DDS " else suffix
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"embedded{suffix}"
        file.write_bytes(data)
        yield file


def open_reader(path: Path, file: Path) -> tuple[oiio.ImageInput, ImageInfo]:
    """Open ``file``; errors speak of ``path``."""
    try:
        if not path.exists():
            raise InputError(f"'{path}' does not exist, expected an image file.")
        if path.is_dir():
            raise InputError(f"'{path}' is a folder, expected an image file.")
        if file.stat().st_size == 0:
            raise InputError(f"'{path}' is empty (0 bytes), expected an image file.")
        with path.open("rb"):
            pass
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}.") from error
    config = oiio.ImageSpec()
    config.attribute("oiio:UnassociatedAlpha", 1)
    try:
        reader = oiio.ImageInput.open(str(file), config)
    except (UnicodeEncodeError, TypeError) as error:
        raise InputError(f"'{path}' has a name that is not UTF-8, expected one that is: rename it.") from error
    if reader is None:
        raise InputError(f"'{path}' is not an image that can be read ({error_of(oiio)}).")
    try:
        return reader, _info_of(reader, path)
    except UnicodeDecodeError as error:
        reader.close()
        raise InputError(f"'{path}' is damaged: its header holds text that is not UTF-8.") from error
    except InputError:
        reader.close()
        raise


def _info_of(reader: oiio.ImageInput, path: Path) -> ImageInfo:
    """What the header of an open file says."""
    part, remark = _first_with_colours(reader)
    spec = reader.spec()
    names, picked, more = default_layer(tuple(spec.channelnames))
    remark = remark + more
    base = str(oiio.TypeDesc(spec.format.basetype))
    orientation = spec.get_int_attribute("Orientation", 1)
    orientation = orientation if 1 <= orientation <= 8 else 1
    is_tiff = reader.format_name() == "tiff"
    info = ImageInfo(
        path=path,
        width=spec.width if orientation < 5 else spec.height,
        height=spec.height if orientation < 5 else spec.width,
        channels=names,
        bits=_BITS.get(base, 32),
        is_float=base in ("half", "float", "double"),
        format=reader.format_name(),
        orientation=orientation,
        # Of the formats that declare it, only TIFF is met with both associated and unassociated alpha.
        associated=is_tiff and names[-1:] == ("A",) and not spec.get_int_attribute("oiio:UnassociatedAlpha", 0),
        part=part,
        picked=picked,
        remark=remark,
    )
    if reader.has_error:
        raise InputError(f"'{path}' is not an image that can be read ({error_of(reader)}).")
    if not (info.width > 0 and info.height > 0 and names):
        raise InputError(f"'{path}' has no pixels ({info.width}x{info.height}), expected an image.")
    return info


def _first_with_colours(reader: oiio.ImageInput) -> tuple[int, str]:
    """The part of a file to read, and what is left out; the reader is set to it. MIP levels are no parts."""
    if reader.format_name() != "openexr" or not reader.seek_subimage(1, 0):
        reader.seek_subimage(0, 0)
        error_of(reader)
        return 0, ""
    names: list[str] = []
    chosen = None
    while reader.seek_subimage(len(names), 0):
        spec = reader.spec()
        names.append(spec.get_string_attribute("name") or str(len(names)))
        plain = {channel.rpartition(".")[2] for channel in spec.channelnames}
        if chosen is None and ({"R", "G", "B"} <= plain or {"X", "Y", "Z"} <= plain or plain == {"Y"}):
            chosen = len(names) - 1
    chosen = chosen or 0
    error_of(reader)
    reader.seek_subimage(chosen, 0)
    return chosen, f" has {len(names)} parts ({', '.join(names)}): '{names[chosen]}' is read."


def _create(path: Path, file_format: str) -> oiio.ImageOutput:
    writer = oiio.ImageOutput.create(file_format)
    if writer is None:
        raise OutputError(f"'{path}' could not be written: {error_of(oiio)}.")
    return writer


def _check(done: bool, writer: oiio.ImageOutput, path: Path) -> None:
    problem = error_of(writer) if writer.has_error else ""
    if not done or problem:
        writer.close()
        raise OutputError(
            f"'{path}' could not be written ({one_line(problem)}): is the folder writable and the disk not full?"
        )


def error_of(source: Any) -> str:
    """The library's words for what went wrong, on one line; they may quote bytes of the file that are no text."""
    try:
        return one_line(source.geterror())
    except UnicodeDecodeError:
        return "its bytes are not as they should be"


def one_line(text: str) -> str:
    return " ".join(text.split()).rstrip(".") or "no reason given"
