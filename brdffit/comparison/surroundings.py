"""Environments read from picture files, for the light of ``render``."""

from __future__ import annotations

from functools import lru_cache

from brdffit.errors import InputError
from brdffit.files.image_io import read_image
from brdffit.probes.shading import ProbeLight
from brdffit.render.environment import Environment, procedural_environment


def read_environment(file: str | None) -> Environment:
    """The environment of an equirectangular picture in linear radiance (.hdr, .exr); None: the one that ships.

    Raises:
        InputError: when the picture cannot be read, or holds values that no light has.
    """
    if file is None:
        return procedural_environment()
    try:
        return Environment(read_image(file).pixels[..., :3])
    except ValueError as error:
        raise InputError(f"'{file}' cannot light a scene: {error}.") from error


@lru_cache(maxsize=2)
def surroundings_of(file: str | None, preset: str | None) -> tuple[Environment, ProbeLight | None]:
    """The environment of ``read_environment``, and the probe that an engine has of it, where a preset is named.

    Raises:
        InputError, UnknownNameError: as ``read_environment``, and when there is no such preset.
    """
    environment = read_environment(file)
    return environment, None if preset is None else ProbeLight.of(environment.radiance, preset)
