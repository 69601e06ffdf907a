"""From a texture set, or a folder that was baked, to a page: averaged, baked and true side by side."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from brdffit.errors import InputError
from brdffit.export.manifest import FILE_NAME
from brdffit.export.pictures import check_preset, stored_levels
from brdffit.export.presets import get_preset
from brdffit.files.atomic import write_text
from brdffit.files.image_io import read_image, read_mip_exr
from brdffit.methods import Material, Pyramid, get_method
from brdffit.pipeline import Phases, ProgressListener, bake_options, read_set, run
from brdffit.roughness import log_from_tensor
from brdffit.svbrdf import Svbrdf
from brdffit.viewer.packing import pack_environment, pack_levels

#: Largest side of a page's texture; of larger sets the middle is shown.
MOST_TEXELS = 1024
#: Side above which the page holds no level 0 of the methods: the source's is shown, which leaves a quarter.
_WITH_LEVEL_0 = 512
#: Rows of an environment in the page.
_SKY_ROWS = 128
_KEYS = (
    "Drag or arrow keys: turn; wheel, pinch, + and -: distance; [ and ]: level; d: difference; w: wipe; "
    "space: moving light."
)


def view(
    source: str | Path,
    output: str | Path,
    *,
    methods: Sequence[str] = ("bfgs",),
    quality: str = "standard",
    preset: str | None = None,
    environment: str | None = None,
    reading: Mapping[str, Any] | None = None,
    progress: ProgressListener | None = None,
) -> Path:
    """Write a page.

    Args:
        source: a texture set; or a folder that `brdffit bake` wrote, whose level 0 is then the reference.
        output: the page, an .html file.
        methods: methods to bake by, a panel each; of a baked folder its own levels are shown.
        quality: of methods that have one.
        preset: adds a panel of the first method's levels as an engine reads them: encoded, compressed and decoded.
        environment: equirectangular picture of light from all around; None: one that the page draws.
        reading: how a set is read.
        progress: called with phases and texels.

    Returns:
        ``output``.

    Raises:
        InputError: for a source that cannot be used, or a lobe that the page cannot draw.
        UnknownNameError: for an unknown method or preset.
        OutputError: when the page cannot be written.
    """
    if preset is not None:
        check_preset(get_preset(preset))
    for method in methods:
        get_method(method)
    sky = None if environment is None else _sky(environment)
    notes = []
    pyramids: list[tuple[str, Pyramid | list[Svbrdf]]]
    if (Path(source) / FILE_NAME).is_file():
        name, base, pyramids = _baked(Path(source))
        notes.append("The reference is level 0 of the bake: what its inputs held may differ by the pixel filter.")
    else:
        name, base, pyramids, cropped = _bake(source, methods, quality, reading or {}, progress)
        notes += cropped
    if base.model != "ggx":
        raise InputError(
            f"'{source}' is made for the lobe {base.model}, and the page draws ggx alone: bake it for ggx."
        )
    panels = [(method, _levels(made)) for method, made in pyramids]
    if preset is not None and isinstance(pyramids[0][1], Pyramid):
        panels.append((f"{pyramids[0][0]}, preset {preset}", stored_levels(pyramids[0][1], get_preset(preset))))
    large = max(base.size) > _WITH_LEVEL_0
    if large:
        notes.append("Level 0 of every panel is the source's.")
    data = {
        "wrap": base.wrap,
        # Small sets are repeated so that a texel is not larger than the page's pixels.
        "repeat": 1 if large else 2,
        "source": pack_levels([base]),
        "methods": [{"name": each, "levels": pack_levels(levels[1:] if large else levels)} for each, levels in panels],
        "environment": sky,
        "note": " ".join([_said(name, base), *notes, _KEYS]),
    }
    output = Path(output)
    write_text(output, _page(name, data))
    return output


def _said(name: str, base: Svbrdf) -> str:
    return (
        f"{name}, {base.size[1]}x{base.size[0]}. Averaged: every map filtered for itself, as engines do by default. "
        "The reference averages light over the pixel and settles within seconds."
    )


def _page(name: str, data: Mapping[str, Any]) -> str:
    """The text of a page that shows some data."""
    page = (files("brdffit.viewer") / "page.html").read_text(encoding="utf-8")
    # "</" would end the script that holds the data.
    text = json.dumps(data, separators=(",", ":")).replace("</", "<\\/")
    title = f"{name}: MIP levels".replace("&", "&amp;").replace("<", "&lt;")
    return page.replace("TITLE", title, 1).replace("/*DATA*/", text, 1)


def _bake(
    source: str | Path, methods: Sequence[str], quality: str, reading: Mapping[str, Any],
    progress: ProgressListener | None,
) -> tuple[str, Svbrdf, list[tuple[str, Pyramid | list[Svbrdf]]], list[str]]:  # fmt: skip
    """Name, source, and a pyramid for each method."""
    phases = Phases(progress)
    first = get_method(methods[0])
    with phases("reading"):
        read = read_set(str(source), reading, bake_options(first, None, {}))
    base, notes = read.material.svbrdf, []
    if max(base.size) > MOST_TEXELS:
        notes.append(f"The middle {MOST_TEXELS} texels of a set of {base.size[1]}x{base.size[0]}.")
        base = _middle(base)
    read.material = Material(base)
    pyramids: list[tuple[str, Pyramid | list[Svbrdf]]] = []
    for name in methods:
        method = get_method(name)
        # As for metallic-roughness maps the scale of the lobe is held: averaged maps have none either.
        asked = bake_options(method, "three", _with(method, quality))
        baked = run(read, method, asked, phases)
        if baked.lobes is None:
            raise InputError(f"The method '{name}' bakes no lobes, and the page draws lobes alone.")
        pyramids.append((name, baked.lobes))
    return read.name, base, pyramids, notes


def _with(method: Any, quality: str) -> dict[str, Any]:
    """The quality, where a method has one."""
    names: Collection[str] = getattr(method.options, "__dataclass_fields__", {})
    return {"quality": quality} if "quality" in names else {}


def _levels(made: Pyramid | list[Svbrdf]) -> list[Svbrdf]:
    return [level.svbrdf for level in made.levels] if isinstance(made, Pyramid) else made


def _baked(folder: Path) -> tuple[str, Svbrdf, list[tuple[str, Pyramid | list[Svbrdf]]]]:
    """Name, level 0 and levels of a folder that was baked."""
    try:
        manifest = json.loads((folder / FILE_NAME).read_text(encoding="utf-8"))
        name, method, model, wrap = (manifest[key] for key in ("name", "method", "model", "wrap"))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"'{folder / FILE_NAME}' is no manifest of a bake of lobes.") from error
    normals = read_mip_exr(folder / "normal.exr", "XYZ")
    tensors = read_mip_exr(folder / "roughness.exr", ["XX", "YY", "XY"])
    colours = [read_mip_exr(folder / f"{role}.exr", "RGB") for role in ("specular", "diffuse")]
    levels = [
        Svbrdf(normal, log_from_tensor(tensor), specular, diffuse, model=model, wrap=wrap)
        for normal, tensor, specular, diffuse in zip(normals, tensors, *colours, strict=True)
    ]
    while max(levels[0].size) > MOST_TEXELS:
        levels = levels[1:]
    return name, levels[0], [(method, levels)]


def _middle(svbrdf: Svbrdf) -> Svbrdf:
    """The middle of a set, at most MOST_TEXELS a side."""
    height, width = svbrdf.size
    top, left = max(0, (height - MOST_TEXELS) // 2), max(0, (width - MOST_TEXELS) // 2)
    part = slice(top, top + MOST_TEXELS), slice(left, left + MOST_TEXELS)
    return svbrdf.replace(**{name: np.ascontiguousarray(array[part]) for name, array in svbrdf.arrays().items()})


def _sky(environment: str) -> dict[str, Any]:
    """An environment, averaged to so many rows that it stays small in the page."""
    pixels = read_image(environment).pixels
    if pixels.shape[2] < 3:
        raise InputError(f"'{environment}' has {pixels.shape[2]} channels, expected an RGB picture of light.")
    step = max(1, pixels.shape[0] // _SKY_ROWS)
    height, width = pixels.shape[0] // step * step, pixels.shape[1] // step * step
    blocks = pixels[:height, :width, :3].reshape(height // step, step, width // step, step, 3)
    return pack_environment(np.maximum(blocks.mean(axis=(1, 3)), 0.0))
