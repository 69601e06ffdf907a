"""Read, bake, assess, write: the one road from a texture set to the files of a baked material."""

from __future__ import annotations

import dataclasses
import inspect
import os
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from brdffit.export import writing as export
from brdffit.export.manifest import build_manifest
from brdffit.export.presets import get_preset
from brdffit.fitting.status import STATUS_NAMES
from brdffit.methods import DEFAULT, Baked, Material, Method, get_method, with_options
from brdffit.models import get_model
from brdffit.options import BakeOptions, LobeOptions, make_options
from brdffit.svbrdf import Svbrdf
from brdffit.textures import READING_OPTIONS
from brdffit.textures.conversion import to_svbrdf, unread_roles
from brdffit.textures.reading import read_texture_set
from brdffit.textures.texture_set import TextureSet

Source = str | os.PathLike[str] | TextureSet | Svbrdf | Material
#: write(baked, manifest, picture): writes a result; manifest and picture are called when all else is written.
Write = Callable[[Baked, Callable[[], dict[str, Any]], Callable[[], NDArray] | None], dict[str, Any]]
#: annotate(baked, seconds of the fit): further entries of a manifest, by its top-level parts.
Annotate = Callable[[Baked, float], Mapping[str, Mapping[str, Any]]]


class ProgressListener(Protocol):
    """Receives the progress of a bake."""

    def phase(self, name: str) -> None:
        """A phase begins: reading, compiling, fitting, finishing, or another that a command adds."""

    def __call__(self, level: int, done: int, total: int) -> None:
        """``done`` of ``total`` texels of a level are finished."""


@dataclass
class ReadSet:
    """A material, and where it comes from.

    Attributes:
        name: of the set.
        material: what a method is given.
        texture_set: whose maps it was made of; None for arrays.
        without: roles of maps that were not read.
        digests: SHA-256 of files, where they are known already.
    """

    name: str
    material: Material
    texture_set: TextureSet | None = None
    without: Collection[str] = ()
    digests: Mapping[Path, str] = field(default_factory=dict)

    @property
    def notes(self) -> list[str]:
        """Sentences on what was assumed or mended."""
        return list(self.texture_set.notes) if self.texture_set else []

    def inputs(self) -> Iterator[tuple[str, Path]]:
        """(role, path) of every file that was read."""
        if self.texture_set is not None:
            unread = unread_roles(self.texture_set, self.without)
            for role, named in self.texture_set.maps.items():
                if role not in unread:
                    for path in dict.fromkeys(named.paths):
                        yield role, path
            if self.texture_set.entry is not None:
                yield "material", self.texture_set.entry

    def conventions(self) -> dict[str, Any]:
        """How the maps were read."""
        names = ("normal_y", "normal_y_source", "wrap", "height_scale", "denoise_normals")
        return {name: getattr(self.texture_set, name) for name in names} if self.texture_set else {}


@dataclass
class BakeReport:
    """What a bake did.

    Attributes:
        folder: where the files are (OUT/<set>).
        baked: what the method returned.
        measured: per level, ``snr_db`` and ``energy_kept`` against the dense rule on random texels, see ``assess``.
        notes: sentences for the user.
        seconds: wall-clock seconds of each phase.
        manifest: as written.
    """

    folder: Path
    baked: Baked
    measured: list[dict[str, Any]]
    notes: list[str]
    seconds: dict[str, float]
    manifest: dict[str, Any] = field(default_factory=dict)


def bake(
    source: Source,
    *,
    method: str = DEFAULT,
    preset: str | None = None,
    without: Collection[str] = (),
    progress: ProgressListener | None = None,
    **options: Any,
) -> Baked:
    """Bake a material in memory; no file is written.

    Args:
        source: a folder of textures, a .gltf, .glb or .mtlx file, a TextureSet, an Svbrdf or a Material.
        method: see ``brdffit methods``.
        preset: an engine's preset; says whether the specular scale and the anisotropy can be stored.
        without: roles of a set that are not read, see ``to_svbrdf``; without "normal" the normal is held.
        progress: called with phases and texels.
        options: of the method, see ``brdffit methods NAME``, and how a folder is read: those of
            ``textures.READING_OPTIONS``.

    Raises:
        InputError: for a source that cannot be used.
        UnknownNameError: for an unknown name, or an option that the method does not have.
        OutputError: for lobes that are not finite numbers.
    """
    reading, given = split_reading(options)
    chosen = get_method(method)
    asked = _without_normals(bake_options(chosen, preset, given), without)
    phases = Phases(progress)
    with phases("reading"):
        read = read_set(source, reading, asked, without)
    return run(read, chosen, asked, phases)


def bake_to_folder(
    source: Source,
    output: str | os.PathLike[str],
    *,
    method: str = DEFAULT,
    preset: str = "plain",
    bits: int = 8,
    compress: str = "good",
    preview: bool = True,
    without: Collection[str] = (),
    progress: ProgressListener | None = None,
    name: str | None = None,
    annotate: Annotate | None = None,
    **options: Any,
) -> BakeReport:
    """Bake a set and write OUT/<set>: EXR pyramid, engine pictures, manifest, preview; all of them or none.

    Arguments as in ``bake``; ``bits`` (8 or 16) of the pictures, ``compress`` how long encoders of
    blocks may take ("fast", "good", "best"), ``name`` of the set if not that of its folder,
    ``annotate`` what more the manifest says.

    Raises:
        InputError, UnknownNameError: as ``bake``.
        OutputError: when the folder cannot be written; found out before the work where possible.
    """
    reading, given = split_reading(options)
    chosen = get_method(method)
    asked: Any = _without_normals(bake_options(chosen, preset, given), without)
    phases = Phases(progress)
    with phases("reading"):
        texture_set = open_set(source, reading, without)
        name = name or (texture_set.name if texture_set else "svbrdf")
        folder = Path(output) / name
        export.check_writable(folder, preset=preset, bits=bits)
        loading = _in_background(lambda: _load(asked, preview)) if isinstance(asked, LobeOptions) else None
        read = dataclasses.replace(read_set(texture_set or source, {}, asked, without), name=name)
        export.check_writable(folder, read.material.size, preset, bits)
    from brdffit.assessment import draw_preview, warm_up

    with phases("compiling"):
        if loading is not None and not loading.result():
            warm_up(asked, preview)
    baked = run(read, chosen, asked, phases)
    if baked.lobes is None and preset != "plain":
        baked.notes.append(f"Pictures for engines are drawn of lobes alone: there are none for the preset '{preset}'.")
    draw = (lambda: draw_preview(read.material, baked, read.name)) if preview else None

    def write(
        baked: Baked, manifest: Callable[[], dict[str, Any]], picture: Callable[[], NDArray] | None
    ) -> dict[str, Any]:
        return export.write_baked(
            baked, folder, name=read.name, preset=preset, bits=bits, compress=compress, manifest=manifest,
            preview=picture, told=None if progress is None else progress.phase,
        )  # fmt: skip

    manifest, measured = finish(read, baked, phases, write=write, draw=draw, annotate=annotate)
    return BakeReport(folder, baked, measured, [*baked.notes, *read.notes], phases.seconds, manifest)


def split_reading(options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split options into those that say how a set is read and those of the method."""
    reading = {name: value for name, value in options.items() if name in READING_OPTIONS}
    return reading, {name: value for name, value in options.items() if name not in reading}


def bake_options(method: Method, preset: str | None, given: Mapping[str, Any]) -> Any:
    """The options of a method as given, within what the preset's pictures can hold.

    Where they hold no anisotropy or no scale of the lobe, the bake leaves it out too, unless it is asked for.


    Raises:
        OptionError: for an option that the method does not have, or a value that it cannot have.
        UnknownNameError: for an unknown preset.
    """
    asked = make_options(method.options, given, f"'{method.name}'")
    if preset is None:
        return asked
    chosen = get_preset(preset)
    said = {name.rpartition(".")[2] for name in given}
    usual = {"lobe": chosen.lobe, **({"specular": "held"} if chosen.specular == "held" else {})}
    return with_options(asked, {name: value for name, value in usual.items() if name not in said})


def bound_sources(method: str, model: str | None = None) -> list[Path]:
    """Source files of a method and of a lobe model's kernels, which may lie outside of the package."""
    bound: list[Any] = [type(get_method(method))]
    if model is not None:
        found = get_model(model)
        bound += [found.profile, found.profile_gradient, found.log_normalisation]
    sources = {inspect.getsourcefile(getattr(each, "py_func", each)) for each in bound}
    return sorted(Path(each) for each in sources if each is not None)


def open_set(source: Source, reading: Mapping[str, Any], without: Collection[str] = ()) -> TextureSet | None:
    """The set behind a source, its pixels unread; None for arrays.

    Raises:
        InputError: for a source that cannot be used.
    """
    if isinstance(source, (Svbrdf, Material)):
        return None
    return source if isinstance(source, TextureSet) else read_texture_set(source, without=without, **reading)


def read_set(
    source: Source, reading: Mapping[str, Any], options: BakeOptions, without: Collection[str] = ()
) -> ReadSet:
    """Read a source into a material.

    Raises:
        InputError: for a source that cannot be used.
    """
    texture_set = open_set(source, reading, without)
    if texture_set is not None:
        svbrdf = to_svbrdf(texture_set, min_roughness=options.min_roughness, without=without)
        return ReadSet(texture_set.name, Material(svbrdf), texture_set, without)
    assert isinstance(source, (Svbrdf, Material))
    return ReadSet("svbrdf", source if isinstance(source, Material) else Material(source))


def run(read: ReadSet, method: Method, options: BakeOptions, phases: Phases) -> Baked:
    """Prepare the method, then bake; the seconds of both are kept apart.

    Raises:
        OutputError: for lobes that are not finite numbers.
    """
    with phases("compiling"):
        method.prepare(read.material, options)
    with phases("fitting"):
        baked = method.bake(read.material, options, phases.progress)
        baked.check_finite(read.name)
        if read.texture_set and read.texture_set.entry and read.texture_set.material is not None:
            baked.worn = read.texture_set.entry, read.texture_set.material
        return baked


def finish(
    read: ReadSet,
    baked: Baked,
    phases: Phases,
    *,
    write: Write,
    draw: Callable[[], NDArray] | None = None,
    annotate: Annotate | None = None,
    record: Mapping[str, Any] | None = None,
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Measure, draw and write a result; files are written while its figures and its picture are made.

    Args:
        read: what was baked.
        baked: the result.
        phases: times the work.
        write: writes the result, a manifest and a picture (both functions, called last); returns the manifest.
        draw: makes the picture.
        annotate, record: further entries of the manifest.

    Returns:
        The manifest as written, and what was measured of each level.
    """
    from brdffit.assessment import assess

    with phases("finishing"), ThreadPoolExecutor(2) as pool:
        measuring = pool.submit(assess, read.material, baked)
        drawing = None if draw is None else pool.submit(draw)

        def manifest() -> dict[str, Any]:
            made = build_manifest(
                baked, name=read.name, inputs=read.inputs(), conventions=read.conventions(),
                status_names=STATUS_NAMES, measured=measuring.result(), notes=read.notes, digests=read.digests,
            )  # fmt: skip
            noted = annotate(baked, phases.seconds["fitting"]) if annotate is not None else {}
            for part, more in noted.items():
                made[part] = {**made.get(part, {}), **more}
            return made | dict(record or {})

        written = write(baked, manifest, None if drawing is None else drawing.result)
        return written, measuring.result()


def _in_background(work: Callable[[], bool]) -> Future[bool]:
    """Run work in a thread of its own, so that an error of the caller is reported before the work ends."""
    pool = ThreadPoolExecutor(1)
    started = pool.submit(work)
    pool.shutdown(wait=False)
    return started


def _load(options: LobeOptions, preview: bool) -> bool:
    """Import and load what measures and draws, while the set is read: importing Numba alone takes as long.

    Where nothing is compiled yet, nothing is done, and False returned: the process does not end before its threads do,
    and a set that cannot be read must not wait for the compiler.
    """
    from brdffit._jit import CACHE_FOLDERS

    if not any(Path(CACHE_FOLDERS["render"]).rglob("*.nbi")):
        return False
    from brdffit.assessment import warm_up

    warm_up(options, preview)
    return True


def _without_normals(options: BakeOptions, without: Collection[str]) -> BakeOptions:
    """Do not search for the normal of a set whose normals are not read: all of them are z."""
    return with_options(options, {"normal": "mean"}) if "normal" in without else options


class Phases:
    """Times phases and reports them to the listener."""

    def __init__(self, progress: ProgressListener | None = None, **seconds: float) -> None:
        self.progress = progress
        self.seconds = seconds

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """A phase of this name; of one that comes twice, the seconds are added."""
        if self.progress is not None:
            self.progress.phase(name)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start
