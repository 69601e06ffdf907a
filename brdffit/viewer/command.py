"""From a texture set, or a folder that was baked, to a page: averaged, baked and true side by side."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from brdffit.errors import InputError
from brdffit.export.manifest import FILE_NAME
from brdffit.export.pictures import check_preset, stored_levels
from brdffit.export.presets import get_preset
from brdffit.files.atomic import check_file, write_text
from brdffit.files.image_io import read_mip_exr
from brdffit.methods import Material, Pyramid, get_method
from brdffit.pipeline import Phases, ProgressListener, bake_options, read_set, run
from brdffit.roughness import log_from_tensor
from brdffit.svbrdf import Svbrdf
from brdffit.viewer.page import DRAWN_MODEL, MOST_TEXELS, middle, page_text, sky_of


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
    output = Path(output)
    check_file(output)
    sky = None if environment is None else sky_of(environment)
    notes = []
    pyramids: list[tuple[str, Pyramid | list[Svbrdf]]]
    if (Path(source) / FILE_NAME).is_file():
        name, base, pyramids = _baked(Path(source))
        notes.append("The reference is level 0 of the bake: what its inputs held may differ by the pixel filter.")
    else:
        name, base, pyramids, cropped = _bake(source, methods, quality, reading or {}, progress)
        notes += cropped
    if base.model != DRAWN_MODEL:
        raise InputError(
            f"'{source}' is made for the lobe {base.model}, and the page draws {DRAWN_MODEL} alone: bake it for that."
        )
    panels = [(method, _levels(made)) for method, made in pyramids]
    if preset is not None and isinstance(pyramids[0][1], Pyramid):
        panels.append((f"{pyramids[0][0]}, preset {preset}", stored_levels(pyramids[0][1], get_preset(preset))))
    write_text(output, page_text(name, base, panels, sky=sky, notes=notes))
    return output


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
        base = middle(base)
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
    if not (folder / "roughness.exr").is_file():
        raise InputError(f"'{folder}' holds no levels of lobes, which the page draws: it was baked by '{method}'.")
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
