"""From a texture set to a pyramid, and to the files of a pyramid: the one road through the house."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from brdffit.errors import UnknownNameError
from brdffit.export import writing as export
from brdffit.export.manifest import build_manifest
from brdffit.export.presets import get_preset
from brdffit.fitting.batch import model_kernels
from brdffit.fitting.status import NOT_REACHED, STATUS_NAMES
from brdffit.halfangle.apparent_lobe import base_of
from brdffit.halfangle.density import DENSITY_EXPONENTS
from brdffit.halfangle.measure import measure, random_texels, snr
from brdffit.methods import BakeOptions, Method, Pyramid, get_method
from brdffit.models import get_model
from brdffit.render.preview import make_preview
from brdffit.svbrdf import Svbrdf
from brdffit.textures import READING_OPTIONS
from brdffit.textures.conversion import to_svbrdf, unread_roles
from brdffit.textures.reading import read_texture_set
from brdffit.textures.texture_set import TextureSet

#: Random texels of a level, nodes and samples an axis of what the manifest reports.
_REPORT_TEXELS, _REPORT_NODES, _REPORT_SAMPLES = 64, 1024, (16, 96)

#: annotate(pyramid, seconds of the fit): what more a manifest says, by its top-level parts.
Annotate = Callable[[Pyramid, float], Mapping[str, Mapping[str, Any]]]

Source = str | os.PathLike[str] | TextureSet | Svbrdf


class ProgressListener(Protocol):
    """Who wants to know how far a bake is."""

    def phase(self, name: str) -> None:
        """A phase begins: reading, compiling, fitting, measuring, preview, writing."""

    def __call__(self, level: int, done: int, total: int) -> None:
        """So many texels of a level are done."""


@dataclass
class BakeReport:
    """What a bake did.

    Attributes:
        folder: where the files are (OUT/<set>).
        pyramid: the levels.
        measured: per level, ``snr_db`` and ``energy_kept`` against the dense rule on random texels, see ``assess``.
        notes: sentences for the user.
        seconds: wall-clock seconds of each phase.
        manifest: as written.
    """

    folder: Path
    pyramid: Pyramid
    measured: list[dict[str, Any]]
    notes: list[str]
    seconds: dict[str, float]
    manifest: dict[str, Any] = field(default_factory=dict)


def bake(
    source: Source,
    *,
    method: str = "bfgs",
    preset: str | None = None,
    without: Collection[str] = (),
    progress: ProgressListener | None = None,
    **options: Any,
) -> Pyramid:
    """Bake a pyramid of arrays; no file is written.

    Args:
        source: a folder of textures, a .gltf, .glb or .mtlx file, a TextureSet or an Svbrdf.
        method: see ``brdffit methods``.
        preset: an engine's preset; says whether the specular scale and the anisotropy can be stored.
        without: roles of a set that are not read, see ``to_svbrdf``; without "normal" the normal is held.
        progress: told of phases and texels.
        options: fields of ``BakeOptions``, and how a folder is read: those of ``textures.READING_OPTIONS``.

    Raises:
        InputError: for a source that cannot be used.
        UnknownNameError: for an unknown name.
    """
    reading = {name: options.pop(name) for name in READING_OPTIONS if name in options}
    chosen, asked = get_method(method), _without_normals(bake_options(preset, options), without)
    phases = _Phases(progress)
    with phases("reading"):
        texture_set = _texture_set(source, reading, without)
        svbrdf = source if isinstance(source, Svbrdf) else _svbrdf(texture_set, asked, without)
    return _run(chosen, svbrdf, asked, phases, progress)


def bake_to_folder(
    source: Source,
    output: str | os.PathLike[str],
    *,
    method: str = "bfgs",
    preset: str = "plain",
    bits: int = 8,
    preview: bool = True,
    without: Collection[str] = (),
    progress: ProgressListener | None = None,
    name: str | None = None,
    annotate: Annotate | None = None,
    **options: Any,
) -> BakeReport:
    """Bake a set and write OUT/<set>: EXR pyramid, engine pictures, manifest, preview; all of them or none.

    Arguments as in ``bake``; ``bits`` (8 or 16) of the pictures, ``name`` of the set if not that of its folder,
    ``without`` roles of maps that are not read, ``annotate`` what more the manifest says.

    Raises:
        InputError, UnknownNameError: as ``bake``.
        OutputError: when the folder cannot be written; found out before the work where possible.
    """
    reading = {name: options.pop(name) for name in READING_OPTIONS if name in options}
    chosen, asked = get_method(method), _without_normals(bake_options(preset, options), without)
    phases = _Phases(progress)
    with phases("reading"):
        texture_set = _texture_set(source, reading, without)
        name = name or (texture_set.name if texture_set else "svbrdf")
        folder = Path(output) / name
        export.check_writable(folder)
        svbrdf = source if isinstance(source, Svbrdf) else _svbrdf(texture_set, asked, without)
        export.check_writable(folder, svbrdf.size)
    pyramid = _run(chosen, svbrdf, asked, phases, progress)
    with phases("measuring"):
        measured = assess(svbrdf, pyramid)
    picture = None
    if preview:
        with phases("preview"):
            naive = pyramid if method == "naive" else get_method("naive").bake(svbrdf, asked)
            picture = make_preview(svbrdf, naive, pyramid, title=name, threads=asked.threads)
            del naive
    notes = [*pyramid.notes, *(texture_set.notes if texture_set else [])]
    noted: Mapping[str, Mapping[str, Any]] = {}
    if annotate is not None:
        with phases("measuring"):
            noted = annotate(pyramid, phases.seconds["fitting"])
    with phases("writing"):
        manifest = build_manifest(
            pyramid,
            name=name,
            inputs=inputs_of(texture_set, without),
            conventions=conventions_of(texture_set),
            status_names=STATUS_NAMES,
            measured=measured,
            notes=texture_set.notes if texture_set else (),
        )
        for part, more in noted.items():
            manifest[part] = {**manifest.get(part, {}), **more}
        manifest = export.write_pyramid(
            pyramid, folder, name=name, preset=preset, bits=bits, manifest=manifest, preview=picture
        )
    return BakeReport(folder, pyramid, measured, notes, phases.seconds, manifest)


def bake_options(preset: str | None, given: Mapping[str, Any]) -> BakeOptions:
    """Options as given; what a preset's pictures cannot store is fitted as they can.

    Raises:
        UnknownNameError: for an option that does not exist.
    """
    known = [each.name for each in dataclasses.fields(BakeOptions)]
    for name in given:
        if name not in known:
            raise UnknownNameError("bake option", name, known)
    options = dict(given)
    get_model(options.get("model", "ggx"))
    if preset is not None:
        chosen = get_preset(preset)
        options.setdefault("specular", chosen.specular)
        options.setdefault("lobe", chosen.lobe)
    return BakeOptions(**options)


def assess(svbrdf: Svbrdf, pyramid: Pyramid, texels: int = _REPORT_TEXELS) -> list[dict[str, Any]]:
    """SNR in dB and energy kept of each level, measured on random texels against a dense rule.

    Nothing of levels that no pixel reads.
    """
    source, target = get_model(svbrdf.model), get_model(pyramid.model)
    kernels = model_kernels(source.name, target.name)
    base = base_of(svbrdf, source.default_shape)
    figures: list[dict[str, Any]] = []
    for mip_level, level in enumerate(pyramid.levels):
        if level.status is not None and (level.status == NOT_REACHED).all():
            figures.append({})
            continue
        columns, rows = random_texels(level.svbrdf.size, texels, seed=mip_level)
        found = measure(
            base, svbrdf.size, [level], columns, rows, pixel_filter=pyramid.options.pixel_filter,
            exponent=DENSITY_EXPONENTS[pyramid.options.density], kernels=kernels, default_shape=target.default_shape,
            nodes=_REPORT_NODES, samples=_REPORT_SAMPLES,
        )  # fmt: skip
        # Rounded well above the noise of the sums, so that manifests agree to the byte.
        figures.append(
            {
                "snr_db": round(min(snr(found.error), 99.0), 2),
                "energy_kept": round(float(found.energy.mean()), 4),
                "measured_texels": len(columns),
            }
        )
    return figures


def _run(
    method: Method, svbrdf: Svbrdf, options: BakeOptions, phases: _Phases, progress: ProgressListener | None
) -> Pyramid:
    """Compile apart, then bake."""
    prepare = getattr(method, "prepare", None)
    if prepare is not None:
        with phases("compiling"):
            prepare(options.model, svbrdf.model, options)
    with phases("fitting"):
        return method.bake(svbrdf, options, progress)


def _texture_set(source: Source, reading: Mapping[str, Any], without: Collection[str]) -> TextureSet | None:
    """The set behind a source, or None for an Svbrdf."""
    if isinstance(source, Svbrdf):
        return None
    return source if isinstance(source, TextureSet) else read_texture_set(source, without=without, **reading)


def _svbrdf(texture_set: TextureSet | None, options: BakeOptions, without: Collection[str]) -> Svbrdf:
    assert texture_set is not None
    return to_svbrdf(texture_set, min_roughness=options.min_roughness, without=without)


def _without_normals(options: BakeOptions, without: Collection[str]) -> BakeOptions:
    """Where all normals are z, the normal is held: there is nothing to search."""
    return dataclasses.replace(options, normal="mean") if "normal" in without else options


def inputs_of(texture_set: TextureSet | None, without: Collection[str] = ()) -> Iterator[tuple[str, Path]]:
    """(role, path) of every file that was read."""
    if texture_set is not None:
        unread = unread_roles(texture_set, without)
        for role, named in texture_set.maps.items():
            if role not in unread:
                yield role, named.path
        if texture_set.entry is not None:
            yield "material", texture_set.entry


def conventions_of(texture_set: TextureSet | None) -> dict[str, Any]:
    """How the inputs were read."""
    if texture_set is None:
        return {}
    return {
        "normal_y": texture_set.normal_y,
        "normal_y_source": texture_set.normal_y_source,
        "wrap": texture_set.wrap,
        "height_scale": texture_set.height_scale,
        "denoise_normals": texture_set.denoise_normals,
    }


class _Phases:
    """Times phases and tells the listener."""

    def __init__(self, progress: ProgressListener | None) -> None:
        self.progress = progress
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        if self.progress is not None:
            self.progress.phase(name)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
