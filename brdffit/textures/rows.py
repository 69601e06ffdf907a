"""A large set read in bands of rows: the lobes of a band are those that reading the whole set would give."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.files.image_io import IMAGE_SUFFIXES
from brdffit.files.image_rows import ImageRows
from brdffit.svbrdf import Svbrdf
from brdffit.textures import encoding
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.noise_floor import CodeNoise, code_noise
from brdffit.textures.reading import explicit_roles, read_texture_set
from brdffit.textures.relief import height_scale
from brdffit.textures.resampled_rows import ResampledRows, read_at
from brdffit.textures.settling import settle
from brdffit.textures.texture_set import Map, TextureSet

#: Roles that are read in rows; the normals are those of the height.
ROLES = ("base_color", "height", "roughness", "gloss", "metallic", "ao")
#: Approximate texels of a band; width of its margin above and below, in texels of level K.
BAND_TEXELS, MARGIN = 1 << 21, 2


@dataclass
class _Rows(Map):
    """Some rows of a map, one after the other; ``indices`` (n,) may go around the border of a set that tiles."""

    file: ImageRows | ResampledRows | None = None
    indices: NDArray | None = None
    width: int = 0

    @property
    def size(self) -> tuple[int, int]:
        """(rows, width)."""
        assert self.indices is not None
        return len(self.indices), self.width

    def read(self) -> tuple[NDArray[np.float32], CodeNoise]:
        """See ``Map.read``; finite numbers were checked before."""
        assert self.file is not None and self.indices is not None
        return read_at(self.file, self.indices), code_noise(self.info.bits, self.info.is_float, self.info.format)


class LargeSet:
    """A set that is turned into lobes a band of rows at a time; use it in a ``with`` statement.

    Sides that are no multiples of 2^K are resampled to the nearest. The maps still cover the same part of the surface,
    so texels are W / W' times as wide and heights, told in widths of texels, W' / W times as large; slopes stay as they
    are. Where the two sides change by different factors, so do those of the texels: slopes down the picture are then
    (H' / H) / (W' / W) times those of square texels.

    Args:
        texture_set: with a height map; each map is of its size or of one texel.
        level: K.
        min_roughness: of ``to_svbrdf``.

    Attributes:
        base: (height, width) in texels that level K is made from, multiples of 2^K.

    Raises:
        InputError: where sizes are others, or a map is damaged or holds numbers that are not finite.
    """

    def __init__(self, texture_set: TextureSet, level: int, min_roughness: float) -> None:
        self.texture_set, self.level, self.min_roughness = texture_set, level, min_roughness
        _check(texture_set, level)
        height, width = self.source = texture_set.size
        self.base = ((height + (1 << level >> 1)) >> level << level, (width + (1 << level >> 1)) >> level << level)
        self.rows = max(BAND_TEXELS // self.base[1] >> level, 1) << level
        self.notes: list[str] = []
        if self.base != self.source:
            texture_set.note(
                f"Sides must be multiples of {1 << level}: {width}x{height} texels are resampled to "
                f"{self.base[1]}x{self.base[0]}, with the slopes that they have."
            )
        with ExitStack() as stack:
            wide = [role for role, named in texture_set.maps.items() if named.size != (1, 1)]
            self._files = {role: stack.enter_context(ImageRows(texture_set.maps[role].path)) for role in wide}
            self._maps = {role: self._settled(role, texture_set.maps[role]) for role in texture_set.maps}
            self._open = stack.pop_all()

    def __enter__(self) -> LargeSet:
        return self

    def __exit__(self, *error: object) -> None:
        self._open.close()

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of level K."""
        return self.base[0] >> self.level, self.base[1] >> self.level

    @property
    def bands(self) -> list[tuple[int, int]]:
        """First and last (excluded) row of level K of each band."""
        step = self.rows >> self.level
        return [(first, min(first + step, self.size[0])) for first in range(0, self.size[0], step)]

    @property
    def rows_of_band(self) -> int:
        """Rows of the largest band, with its margin."""
        return min(self.rows, self.base[0]) + (2 * MARGIN << self.level)

    def lobes(self, first: int, last: int) -> tuple[Svbrdf, int]:
        """Rows ``first`` to ``last`` (excluded) as lobes with a margin, and how many rows of margin come before them.

        A set that tiles goes on around its border; one that does not ends there.
        """
        height, margin = self.base[0], MARGIN << self.level
        low, high = first - margin, last + margin
        if self.texture_set.wrap != "tile":
            low, high = max(low, 0), min(high, height)
        # One row more on either side, where the set goes on: slopes are differences of neighbours.
        tile = self.texture_set.wrap == "tile"
        before, behind = int(tile or low > 0), int(tile or high < height)
        indices = np.arange(low - before, high + behind)
        down, across = (base / source for base, source in zip(self.base, self.source, strict=True))
        scale = self.texture_set.height_scale
        band = dataclasses.replace(
            self.texture_set, maps=self._cut(indices % height), notes=[],
            height_scale=None if scale is None else scale * across,
        )  # fmt: skip
        svbrdf = to_svbrdf(band, min_roughness=self.min_roughness)
        if down != across:
            normal = svbrdf.normal * np.array([1.0, down / across, 1.0], np.float32)
            svbrdf = svbrdf.replace(normal=normal / np.linalg.norm(normal, axis=2, keepdims=True))
        self.notes += [note for note in band.notes if note not in self.notes]
        inner = slice(before, len(indices) - behind)
        return svbrdf.replace(**{name: array[inner] for name, array in svbrdf.arrays().items()}), first - low

    def _cut(self, indices: NDArray) -> dict[str, Map]:
        tile = self.texture_set.wrap == "tile"
        files: dict[str, ImageRows | ResampledRows] = dict(self._files)
        if self.base != self.source:
            files = {role: ResampledRows(file, self.base, tile) for role, file in self._files.items()}
        return {
            role: _Rows(**{**_fields(named), "file": files[role], "indices": indices, "width": self.base[1]})
            if role in self._files else named
            for role, named in self._maps.items()
        }  # fmt: skip

    def _settled(self, role: str, named: Map) -> Map:
        """Settle a map's channel by all of its rows, as ``Map.quantity`` does, and the scale of the height.

        Where the colours are alike but for rounding, the channel stays open: each band then takes the same one.
        """
        if role == "base_color" or role not in self._files:
            return named
        low, high, apart = np.float32(math.inf), np.float32(-math.inf), 0.0
        for rows in self._read_through(role, named):
            for k in range(1, min(rows.shape[2], 3)):
                apart = max(apart, float(np.abs(rows[:, :, k] - rows[:, :, 0]).max()))
            low, high = np.minimum(low, rows.min(axis=(0, 1))), np.maximum(high, rows.max(axis=(0, 1)))
        if named.channel == "" and len(self._files[role].info.channels) >= 3 and apart > encoding.ALIKE:
            sample = np.array([[[0.0, min(apart, 1.0), 0.0]]], np.float32)
            taken = encoding.obvious_channel(sample, role)[1]
            self.texture_set.note(f"The colours of '{named.path.name}' differ: its {role} is taken from {taken}.")
            named = dataclasses.replace(named, channel=taken)
        if role == "height" and self.texture_set.height_scale is None:
            ends, _ = named.quantity(np.stack([low, high])[None])
            self.texture_set.height_scale = height_scale(self.texture_set, ends, None)
        return named

    def _read_through(self, role: str, named: Map) -> Iterator[NDArray]:
        for first in range(0, named.size[0], self.rows):
            rows = self._files[role].read(first, min(first + self.rows, named.size[0]))
            if not np.isfinite(rows).all():
                raise InputError(
                    f"'{named.path}' holds NaN or infinity in rows {first} to {first + len(rows)}, expected finite "
                    f"numbers as {role}."
                )
            yield rows


def _fields(named: Map) -> dict[str, Any]:
    """The fields of a map by name."""
    return {field.name: getattr(named, field.name) for field in dataclasses.fields(Map)}


def _check(texture_set: TextureSet, level: int) -> None:
    height, width = texture_set.size
    of = f"'{texture_set.name}'"
    if "height" not in texture_set.maps:
        raise InputError(f"{of} has no height map, expected one whose levels are taken from {level} on.")
    for role, named in texture_set.maps.items():
        if role not in ROLES:
            raise InputError(
                f"{of} has a {role} map, '{named.path.name}': level {level} is made from the height and from "
                f"{', '.join(each for each in ROLES if each != 'height')} alone; give the height map's file instead of "
                "the folder."
            )
        if named.size not in ((1, 1), (height, width)) or (named.data is not None and named.size != (1, 1)):
            raise InputError(
                f"'{named.path}' is {named.size[1]}x{named.size[0]}, expected {width}x{height} as the largest map of "
                f"{of}, or one texel: maps of a large set are read in rows."
            )
    deepest = min(height, width).bit_length() - 1
    if level > deepest:
        raise InputError(
            f"{of} is {width}x{height} and its levels cannot be taken from {level} on, expected 1 to {deepest}."
        )


def open_large(source: str | os.PathLike[str], reading: Mapping[str, Any]) -> TextureSet:
    """The set of a height map's file, or of a folder.

    Raises:
        InputError: for a source that cannot be used.
    """
    path = Path(source)
    if not (path.is_file() and path.suffix.lower() in IMAGE_SUFFIXES):
        return read_texture_set(path, **reading)
    texture_set = TextureSet(path.stem, {"height": Map("height", path)})
    texture_set.maps |= explicit_roles(path.parent, dict(reading.get("roles") or {}))
    known = {name: value for name, value in reading.items() if name in ("wrap", "height_scale")}
    settle(texture_set, path, **known)
    return texture_set
