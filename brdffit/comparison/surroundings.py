"""Surroundings from a picture: where the files of ``textures`` and the light of ``render`` meet."""

from __future__ import annotations

from brdffit.errors import InputError
from brdffit.files.image_io import read_image
from brdffit.render.environment import Environment, procedural_environment


def read_environment(file: str | None) -> Environment:
    """The environment of an equirectangular picture in linear radiance (.hdr, .exr); None: the one that ships.

    Raises:
        InputError: when the picture cannot be read, or no light is like it.
    """
    if file is None:
        return procedural_environment()
    try:
        return Environment(read_image(file).pixels[..., :3])
    except ValueError as error:
        raise InputError(f"'{file}' cannot light a scene: {error}.") from error
