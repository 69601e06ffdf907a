"""A texture set as it lies on disk: images by role, their encodings and conventions. It knows nothing of lobes."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.files.image_io import ImageInfo, file_sha256, read_image, read_info
from brdffit.textures import encoding
from brdffit.textures.frames import IDENTITY, Frame, read_through, size_in
from brdffit.textures.noise_floor import CodeNoise, code_noise

NORMAL_YS = ("gl", "dx")
#: Longest side of a map; more is taken for a damaged header.
MAX_SIDE = 32768


@dataclass
class Map:
    """Where one role of a set comes from.

    Attributes:
        role: one of ``naming.ROLES``.
        path: the image file, or the .glb or .gltf file that holds it.
        channel: "" for all or the obvious one, else "R", "G", "B" or "A".
        data: the image's bytes when it is embedded, else None.
        word: the word of the file name that told the role, or "".
        as_rgba: whether the file stands for an RGBA picture (glTF): grey is spread over R, G and B, missing alpha is 1.
        frame: where in the picture it is read.
        encoding: "srgb" or "linear" of a colour, "signed" of normals in [-1, 1]; "" as is usual for the file's type.
        constant: whether the picture holds one value throughout, and so is read as a single texel.
    """

    role: str
    path: Path
    channel: str = ""
    data: bytes | None = None
    word: str = ""
    as_rgba: bool = False
    frame: Frame = IDENTITY
    encoding: str = ""
    constant: bool = False

    @cached_property
    def info(self) -> ImageInfo:
        """The image's header."""
        return read_info(self.path, self.data)

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in texels, at which it is read."""
        return (1, 1) if self.constant else size_in(self.frame, (self.info.height, self.info.width))

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files that it is read from."""
        return (self.path,)

    def read(self) -> tuple[NDArray[np.float32], CodeNoise]:
        """Pixels (H, W, C) as stored, integers scaled to [0, 1], and the noise of their codes.

        Raises:
            InputError: when the file cannot be read or holds NaN or infinity.
        """
        image = read_image(self.path, self.data)
        pixels = image.pixels
        if image.is_float and not np.isfinite(pixels).all():
            count = int((~np.isfinite(pixels)).any(axis=2).sum())
            raise InputError(
                f"'{self.path}' holds NaN or infinity in {count} of {image.width * image.height} texels, expected "
                f"finite numbers as {self.role}."
            )
        bits = image.bits
        if bits == 16 and not image.is_float and not (np.rint(pixels * 65535.0) % 257).any():
            bits = 8  # eight bits in sixteen: the noise floor is that of the codes in use
        if self.constant:
            pixels = pixels.mean(axis=(0, 1), keepdims=True, dtype=np.float64).astype(np.float32)
        return read_through(self.frame, pixels), code_noise(bits, image.is_float, image.format)

    def vectors(self, pixels: NDArray) -> tuple[NDArray, str]:
        """(H, W, 2 or 3) vectors of a normal map's pixels, and why z must be rebuilt from x and y, or ""."""
        if self.encoding == "signed":
            return pixels[:, :, :3], ""
        if encoding.x_in_alpha(pixels):
            return 2.0 * pixels[:, :, [3, 1]] - 1.0, "holds x in alpha and y in green"
        vectors = encoding.stored_vectors(pixels, self.info.is_float)
        return vectors, encoding.rebuilt_how(pixels, vectors)

    def quantity(self, pixels: NDArray) -> tuple[NDArray, str]:
        """(H, W) of the one quantity this map holds, of its pixels; and the channel taken ("" when all are alike).

        Raises:
            InputError: when the channel that was asked for is not there.
        """
        if not self.channel:
            return encoding.obvious_channel(pixels, self.role)
        index = encoding.channel_index(self.info.channels, self.channel, self.as_rgba)
        if index is not None:
            return pixels[:, :, index], self.channel
        if self.as_rgba:
            return np.ones(pixels.shape[:2], np.float32), self.channel
        raise InputError(
            f"'{self.path}' has the channels {', '.join(self.info.channels)}, expected {self.channel} among them, for "
            f"its {self.role} is asked of it."
        )


@dataclass
class TextureSet:
    """Maps by role, with the conventions they follow.

    Attributes:
        name: of the input folder, or the stem of the .gltf, .glb or .mtlx file.
        maps: one ``Map`` a role.
        normal_y: "gl" (+Y up in the picture) or "dx" (+Y down).
        normal_y_source: how ``normal_y`` is known: "given", "name", "convention", "height", "slopes" or "assumed".
        wrap: "tile" or "clamp"; before ``settling.settle`` it may be another mode of a material file.
        alpha_cutoff: opacity below which a mask is cut out; None where opacity is blended, or there is none.
        height_scale: texels between height values 0 and 1, or None to be derived.
        denoise_normals: whether the normals are read without what their codes cannot tell from flat (``noise_floor``).
        factors: constants that multiply a map, or stand for it: "base_color" (3,), "metallic", "roughness",
            "specular" (3,), "normal" (of x and y), "occlusion", "gloss", "opacity", "f0" (of a dielectric),
            "specular_level" and "specular_color" (3,) (of it), "anisotropy" (strength), "anisotropy_rotation" (radians,
            counter-clockwise).
        ignored: image files that were not used.
        notes: what was assumed or mended, one sentence each.
        entry: the .gltf, .glb or .mtlx file the set was read from, or None.
        material: its number in a .gltf or .glb file, or None.
    """

    name: str
    maps: dict[str, Map]
    normal_y: str = "gl"
    normal_y_source: str = "assumed"
    wrap: str = "tile"
    height_scale: float | None = None
    denoise_normals: bool = False
    alpha_cutoff: float | None = None
    factors: dict[str, NDArray | float] = field(default_factory=dict)
    ignored: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    entry: Path | None = None
    material: int | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the largest map; the others are brought to it."""
        return max((named.size for named in self.maps.values()), key=lambda size: size[0] * size[1], default=(1, 1))

    def quantity(self, named: Map) -> NDArray:
        """(H, W) of a map of one quantity, as stored; which channel was taken is noted where it is not plain.

        Raises:
            InputError: as ``Map.read`` and ``Map.quantity``.
        """
        values, taken = named.quantity(named.read()[0])
        if taken and not named.channel:
            names = {"R": "red", "G": "green", "B": "blue"}
            self.note(f"The colours of '{named.path.name}' differ: its {named.role} is taken from {names[taken]}.")
        return values

    @property
    def inputs(self) -> list[tuple[Path, str]]:
        """Every file that is used, and its SHA-256."""
        paths = {path for named in self.maps.values() for path in named.paths} | ({self.entry} if self.entry else set())
        return [(path, file_sha256(path)) for path in sorted(paths)]

    def note(self, sentence: str) -> None:
        """Add a sentence, once."""
        if sentence not in self.notes:
            self.notes.append(sentence)
