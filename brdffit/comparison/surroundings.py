"""Environments read from picture files, for the light of ``render``."""

from __future__ import annotations

from functools import lru_cache

from brdffit.errors import InputError
from brdffit.probes.reading import read_surroundings
from brdffit.probes.shading import ProbeLight
from brdffit.render.environment import Environment, procedural_environment


def read_environment(file: str | None) -> Environment:
    """The environment of a lat-long picture, read as for a probe; None: the one that ships.

    Raises:
        InputError: when the picture cannot be read, has another layout, or holds values that no light has.
    """
    if file is None:
        return procedural_environment()
    found = read_surroundings(file)
    if found.layout != "latlong":
        raise InputError(f"'{file}' is a {found.layout}, expected a lat-long picture (2:1).")
    return Environment(found.pixels)


@lru_cache(maxsize=2)
def surroundings_of(file: str | None, preset: str | None) -> tuple[Environment, ProbeLight | None]:
    """The environment of ``read_environment``, and the probe that an engine has of it, where a preset is named.

    Raises:
        InputError, UnknownNameError: as ``read_environment``, and when there is no such preset.
    """
    environment = read_environment(file)
    return environment, None if preset is None else ProbeLight.of(environment.radiance, preset)
