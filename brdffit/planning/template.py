"""The scene file that ``brdffit scene init`` writes: every field with its default and a comment."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from brdffit.errors import OutputError
from brdffit.files.atomic import write_text
from brdffit.planning.effects import NAMES
from brdffit.textures.reading import SUFFIXES

TEMPLATE = """\
# A scene: who looks at which surfaces, from where and under which light. brdffit computes what it calls for.
# Whatever stands here is the default and may be left out, but for the surfaces; lengths are metres, angles degrees.

model = "ggx"                   # lobe: see `brdffit models`
quality = "standard"            # draft, standard or fine
pixel_filter = "box"            # box, gaussian or mitchell

# Light from all around: an equirectangular .hdr or .exr picture, or "procedural", the one that comes with brdffit. It
# stands where neither it nor a light is named. y is up in it, and z points out of the surface.
# environment = "procedural"
# probe = "unity"               # compare lights it also as this engine does, see `brdffit probe --for`

# Cameras: as many as there are kinds of view.
[[cameras]]
name = ""                       # as the plan calls it
distance = [1.0, 10.0]          # nearest and farthest, or one number
field_of_view = 50.0            # horizontal
resolution = [1920, 1080]       # width and height in pixels
tilt = [0.0, 60.0]              # between view and surface normal: least and most, or one number

# Surfaces.
{surfaces}
# Lights, far away.
# [[lights]]
# direction = [-0.4, 0.5, 1.0]  # towards the light: x to the right, y up, z out of the surface
# irradiance = [3.0, 2.9, 2.7]  # linear, facing the light; or one number
# size = 0.0                    # diameter; 0: infinitely small. The sun: 0.53

[target]
preset = "plain"                # plain, gltf, unreal, unity or godot
bits = 8                        # of the pictures: 8 or 16

[budget]
db = 0.1                        # that all effects left out may cost together
# seconds = 60                  # that a bake may take

# What the plan may leave out: "auto" leaves it to the plan, "on" and "off" overrule it.
[effects]
{effects}"""

_SURFACE = """\
[[surfaces]]
set = {set}
name = {name:<24} # of its output folder; "": as the set
# repetitions = 1.0             # of the texture's width per metre; or texel_size = 0.002, in metres
# radius = 0.5                  # of a curved surface; flat without it
# wrap = "tile"                 # tile or clamp; else as the file says, or tile
# normal_y = "gl"               # gl or dx; else told by names or slopes
# height_scale = 8              # texels between heights 0 and 1
# denoise_normals = true        # read a normal map that only dithers between codes as flat
# material = "Name"             # of a glTF or MaterialX file that holds several
# roles = {{ normal = "bumps.png" }}
"""


def template(sets: Sequence[str | Path] = (), folder: Path | None = None) -> str:
    """The text of a scene file with one surface for each set, or one for a folder "textures" if no set is given.

    Args:
        sets: folders or files of texture sets.
        folder: of the scene file, to which the paths are written relative; None: paths are written as given.
    """
    paths = [Path(os.path.relpath(path, folder) if folder else path).as_posix() for path in sets] or ["textures"]
    bare = [Path(path).with_suffix("") if Path(path).suffix in SUFFIXES else Path(path) for path in paths]
    ends = [path.name for path in bare]
    surfaces = []
    for path, named in zip(paths, bare, strict=True):
        # Sets of equal names would be written to the same place.
        parts = [part for part in named.parts if part not in ("..", "/")]
        name = ".".join(parts) if ends.count(named.name) > 1 else ""
        surfaces.append(_SURFACE.format(set=_quoted(path), name=_quoted(name)))
    effects = "".join(f'# {name} = "auto"\n' for name in NAMES)
    return TEMPLATE.format(surfaces="\n".join(surfaces), effects=effects)


def write_template(path: str | Path, sets: Sequence[str | Path] = (), force: bool = False) -> Path:
    """Write a commented scene file that names ``sets``.

    Raises:
        OutputError: when the file exists (unless ``force``) or cannot be written; an existing file is then unchanged.
    """
    path = Path(path)
    if path.exists() and not force:
        raise OutputError(f"'{path}' is there already, expected a name that is free, or --force to replace it.")
    text = template(sets, path.resolve().parent)
    write_text(path, text)
    return path


def _quoted(text: str) -> str:
    """The text as a TOML string."""
    return json.dumps(text, ensure_ascii=False)
