"""Maps that a material file computes from images, evaluated when they are read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import decode_srgb
from brdffit.errors import InputError
from brdffit.files.image_io import ImageInfo, read_image, read_info
from brdffit.textures.encoding import resample
from brdffit.textures.frames import Frame, common_frame, read_through, size_in
from brdffit.textures.materialx_graph import CHANNELS, Expression, Picture
from brdffit.textures.noise_floor import CodeNoise, code_noise
from brdffit.textures.texture_set import Map

_GAMMAS = {"g18_rec709": 1.8, "gamma18": 1.8, "g22_rec709": 2.2, "gamma22": 2.2, "gamma24": 2.4, "rec709_display": 2.4}
_LINEAR = ("lin_rec709", "lin_srgb", "raw", "none", "data")
#: Linear colours of ACEScg (AP1, D60) in those of sRGB (D65), by Bradford's adaptation.
_FROM_AP1 = np.array(
    [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]], np.float32
)


@dataclass
class ComputedMap(Map):
    """A map that is an expression over images; ``path`` is the document that says so.

    Attributes:
        expression: what is evaluated; its images are brought to the size of the largest.
    """

    expression: Expression | Picture | None = None

    @cached_property
    def info(self) -> ImageInfo:
        """As of a float picture of the size at which it is evaluated."""
        height, width = self._full
        return ImageInfo(self.path, width, height, ("R", "G", "B"), 32, True, "computed")

    @property
    def paths(self) -> tuple[Path, ...]:
        """The images that are read."""
        return tuple(picture.path for picture in self._pictures)

    @property
    def _pictures(self) -> list[Picture]:
        return self.expression.pictures() if self.expression is not None else []

    @cached_property
    def _full(self) -> tuple[int, int]:
        sizes = [size_in(each.frame, (info.height, info.width)) for each in self._pictures for info in [_info(each)]]
        full = max(sizes, key=lambda size: size[0] * size[1], default=(1, 1))
        for each, (height, width) in zip(self._pictures, sizes, strict=True):
            if (height, width) != (1, 1) and abs(height * full[1] - width * full[0]) > max(full):
                raise InputError(
                    f"The images of '{self.path}' cannot belong together: '{each.path.name}' is {width}x{height} where "
                    f"the largest is {full[1]}x{full[0]}, expected the same proportions."
                )
        return full

    def read(self) -> tuple[NDArray[np.float32], CodeNoise]:
        """Pixels (H, W, C): linear colours, quantities, or vectors in [-1, 1] of normals; without noise of codes.

        Raises:
            InputError: when an image cannot be read, or what is computed is not finite.
        """
        assert self.expression is not None
        with np.errstate(all="ignore"):
            pixels = self.expression.evaluate(self._read_picture, {})
        pixels = np.ascontiguousarray(np.broadcast_to(pixels, (*self._full, pixels.shape[2])), np.float32)
        if not np.isfinite(pixels).all():
            count = int((~np.isfinite(pixels)).any(axis=2).sum())
            raise InputError(
                f"'{self.path}' computes NaN or infinity in {count} of {pixels.shape[0] * pixels.shape[1]} texels, "
                f"expected finite numbers as {self.role}."
            )
        if self.constant:
            pixels = pixels.mean(axis=(0, 1), keepdims=True)
        return pixels, code_noise(32, True, "computed")

    def quantity(self, pixels: NDArray) -> tuple[NDArray, str]:
        """(H, W): its first channel, or the mean of three."""
        return (pixels.mean(axis=2) if pixels.shape[2] == 3 else pixels[:, :, 0]), ""

    def _read_picture(self, picture: Picture) -> NDArray:
        image = read_image(picture.path)
        if image.is_float and not np.isfinite(image.pixels).all():
            raise InputError(f"'{picture.path}' holds NaN or infinity, expected finite numbers.")
        count = CHANNELS.get(picture.type, 3)
        pixels = _with_channels(image.pixels, count)
        if picture.type in ("color3", "color4"):
            pixels = pixels.copy()
            pixels[..., :3] = _linear(picture, pixels[..., :3], image.is_float)
        return resample(read_through(picture.frame, pixels), self._full, "tile").astype(np.float64)


def computed_frame(frames: Sequence[Frame]) -> Frame | None:
    """The frame for all images of a document: plain coordinates if all are integer, else one of them, or None."""
    plain = Frame()
    if all(frame.is_integer for frame in frames):
        return plain
    return common_frame(frames)


def _info(picture: Picture) -> ImageInfo:
    return read_info(picture.path)


def _with_channels(pixels: NDArray, count: int) -> NDArray:
    """``count`` channels: grey is spread, alpha that is missing is 1."""
    have = pixels.shape[2]
    if have >= count and not (have == 2 and count > 2):
        return pixels[..., :count]
    grey, alpha = pixels[..., :1], pixels[..., -1:] if have in (2, 4) else np.ones_like(pixels[..., :1])
    colour = pixels[..., :3] if have >= 3 else np.repeat(grey, min(count, 3), axis=2)
    return np.concatenate([colour, alpha], axis=2)[..., :count]


def _linear(picture: Picture, colours: NDArray, is_float: bool) -> NDArray:
    """Colours in linear sRGB primaries, by the colour space of the image; without one, integers are sRGB."""
    space = picture.color_space or ("lin_rec709" if is_float else "srgb_texture")
    if space in _LINEAR:
        return colours
    if space == "srgb_texture":
        return decode_srgb(colours)
    if space in _GAMMAS:
        return np.maximum(colours, 0.0) ** _GAMMAS[space]
    if space in ("acescg", "lin_ap1", "lin_ap1_scene"):
        return np.maximum(colours @ _FROM_AP1.T, 0.0)
    raise InputError(
        f"The image '{picture.path}' is in the colour space '{space}', expected srgb_texture, lin_rec709, acescg or a "
        f"gamma of sRGB's primaries."
    )
