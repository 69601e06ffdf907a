"""Texture sets made from recipes, which the program ships so that it can bake on a machine without textures.

A recipe (``data/*.toml``) names a generator, a seed and parameters. All sets tile, save the record.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from brdffit.colour import encode_srgb
from brdffit.errors import BrdffitError, InputError, UnknownNameError
from brdffit.files.atomic import fresh_file
from brdffit.files.image_io import write_png
from brdffit.textures.generators import GENERATORS, unit_range

_CHECKOUT = Path(__file__).resolve().parents[2] / "data"
#: Folder of the recipes: in a checkout, or where an installation puts them.
RECIPES = _CHECKOUT if (_CHECKOUT / "hammered-metal.toml").is_file() else Path(sys.prefix, "share", "brdffit")
#: Names of the shipped sets.
SETS = (
    "brushed-metal", "bumpy-mirror", "cliff", "glass-panes", "glossy-tiles", "grooved-record", "hammered-metal",
    "insulation-foam", "leaf-litter", "pebbles", "plaster-wall", "rocky-terrain", "turtle-shell", "woven-fabric",
)  # fmt: skip
#: Names of shipped sets that are made only when named, since they are large.
ON_DEMAND = ("brushed-strokes-4k",)


class Recipe(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """A recipe file; ``size`` is the side of its maps in texels, unless another is asked for."""

    summary: str
    generator: str
    origin: str
    licence: str
    seed: int
    wrap: str
    parameters: dict[str, Any]
    size: int = 512


def read_recipe(path: Path) -> tuple[Recipe, Any]:
    """A recipe and its generator with parameters.

    Raises:
        InputError: when the recipe cannot be read, or its parameters are not the generator's.
        UnknownNameError: for an unknown generator.
    """
    try:
        recipe = msgspec.convert(tomllib.loads(path.read_text(encoding="utf-8")), Recipe)
        generator = GENERATORS.get(recipe.generator)
        if generator is None:
            raise UnknownNameError("generator", recipe.generator, GENERATORS)
        return recipe, msgspec.convert(recipe.parameters, generator)
    except OSError as error:
        raise InputError(f"The recipe '{path}' cannot be read: {error.strerror}.") from error
    except (tomllib.TOMLDecodeError, msgspec.ValidationError, UnicodeDecodeError) as error:
        raise InputError(f"The recipe '{path}' is not as expected: {error}.") from error


def make_set(name: str, folder: str | Path, size: int | None = None) -> Path:
    """Write the maps of a shipped set into ``folder``; the same name and size give the same bytes.

    Args:
        name: one of ``SETS`` or ``ON_DEMAND``.
        folder: where the maps go; made if missing.
        size: side of the maps in texels; None: the recipe's.

    Returns:
        The folder.

    Raises:
        UnknownNameError: for an unknown name.
        OutputError: when a map cannot be written; no half-written map bears a final name.
    """
    if name not in SETS + ON_DEMAND:
        raise UnknownNameError("procedural set", name, SETS + ON_DEMAND)
    recipe, generator = read_recipe(RECIPES / f"{name}.toml")
    maps = generator.make(size or recipe.size, np.random.default_rng(recipe.seed))
    folder = Path(folder)
    stem = "".join(part.capitalize() for part in name.split("-"))
    pictures = {
        "Color": _with_alpha(_codes(encode_srgb(maps.color), 255), maps.opacity),
        "NormalGL": None if maps.normal is None else _codes(0.5 * maps.normal + 0.5, 65535),
        "Roughness": _codes(maps.roughness, 255),
        "Metallic": None if maps.metallic is None else _codes(maps.metallic, 255),
        "Height": None if maps.height is None else _codes(unit_range(maps.height), 65535),
    }
    for role, pixels in pictures.items():
        if pixels is None:
            continue
        with fresh_file(folder / f"{stem}_{role}.png") as fresh:
            write_png(fresh, pixels)
    return folder


def _with_alpha(colours: NDArray, opacity: NDArray | None) -> NDArray:
    return colours if opacity is None else np.dstack([colours, _codes(opacity, 255)])


def _codes(values: NDArray, top: int) -> NDArray:
    return np.rint(np.clip(values, 0.0, 1.0) * top).astype(np.uint8 if top == 255 else np.uint16)


def main(arguments: list[str], tell: Callable[[str], object] = sys.stderr.write) -> int:
    """``OUT [NAMES]``: write the named sets, or all that are not large, each into a folder of its name."""
    if not arguments or arguments[0].startswith("-"):
        tell(f"usage: python -m brdffit.textures.procedural OUT [{' '.join(SETS + ON_DEMAND)}]\n")
        return 2
    try:
        for name in arguments[1:] or SETS:
            make_set(name, Path(arguments[0]) / name)
    except BrdffitError as error:
        tell(f"{error}\n")
        return 2 if isinstance(error, UnknownNameError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
