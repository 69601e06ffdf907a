"""Filter one environment and write the folder that an engine loads: the work of `brdffit probe`."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.files.atomic import first_other, replacing
from brdffit.files.image_io import file_sha256
from brdffit.machine import core_count, free_memory
from brdffit.probes.containers import RADIANCE_FORMATS
from brdffit.probes.cubemap import directions
from brdffit.probes.curves import Curve, get_curve
from brdffit.probes.direct import split_bright
from brdffit.probes.filtering import (
    IRRADIANCE_SIZE,
    LARGEST_SOURCE,
    METHODS,
    FilteredLevel,
    FilterOptions,
    LevelRequest,
    filter_levels,
    level_requests,
    with_radiance,
)
from brdffit.probes.harmonics import irradiance_nine, nine_basis
from brdffit.probes.letters import draw_faces
from brdffit.probes.picture import probe_picture
from brdffit.probes.presets import ProbePreset, get_probe_preset
from brdffit.probes.reading import CENTRES, Surroundings, as_cube, is_built_in, read_surroundings, reoriented
from brdffit.probes.sun import Sun, find_sun
from brdffit.probes.writing import SUFFIXES, write_probe

#: Memory that a texel of the source takes while it is filtered, measured at 256^2 and 512^2.
_BYTES_PER_TEXEL = 400
#: Texels along a face of the largest probe.
_LARGEST = 4096
_MIRRORS = {"": np.diag([1, 1, 1]), "x": np.diag([-1, 1, 1]), "z": np.diag([1, 1, -1])}


@dataclass(frozen=True)
class ProbeOptions:
    """Options of one probe. Where a value of the preset may be None here, None keeps the preset's.

    Attributes:
        preset: a name of ``presets.PRESETS``.
        size: texels along a face of level 0, a power of two of at least 16.
        levels: how many levels, level 0 counted, 2 to log2(size) + 1.
        curve: a name of ``curves.CURVES``, or the roughness of each level as "r0,r1,...".
        texel_format: a name of ``containers.RADIANCE_FORMATS``.
        method, samples, order: how levels are filtered (``filtering.FilterOptions``).
        tolerance: wanted relative L1 error of a level, 0.00001 to 0.5.
        table: name or file of the table for the method "table".
        split: texels brighter than this multiple of the mean are filtered apart (all methods but "tree" and "brute").
            In the container "exr" they are also cut off in level 0.
        level0: "copy" (a mirror: the source itself) or "filter".
        keep_narrow: filter a lobe that is narrower than a texel around the texel's centre only, instead of averaging
            over the texel.
        fit: "texels" (exact values at the texels) or "lookup" (values whose trilinear look-up is nearest the truth).
        rotate: degrees about +Y, from +X towards -Z.
        layout: layout of the input (``reading.LAYOUTS``); None guesses it from the shape.
        centre: direction of the middle of a lat-long picture (``reading.CENTRES``).
        clamp: set negative values to 0 and infinite ones to the largest finite value, instead of refusing them.
        scale: scale radiance down to the largest value of the format, instead of clamping it.
        picture: draw picture.png and faces.png.
    """

    preset: str = "plain"
    size: int | None = None
    levels: int | None = None
    curve: str | None = None
    texel_format: str | None = None
    method: str = "tree"
    tolerance: float = 0.01
    samples: int = 1024
    order: int = 11
    table: str = "ggx-const-8"
    split: float | None = None
    level0: str = "copy"
    keep_narrow: bool = False
    fit: str = "texels"
    rotate: float = 0.0
    layout: str | None = None
    centre: str | None = None
    clamp: bool = False
    scale: bool = False
    picture: bool = True


@dataclass(frozen=True)
class Probe:
    """A filtered environment.

    Attributes:
        surroundings: the environment as it was read.
        preset: the preset with the changes of the options.
        curve: roughness of each level.
        source: (6, N, N, 3) cube map that was filtered, in the world's axes.
        levels: filtered levels, in the world's axes.
        irradiance: a level of (6, 32, 32, 3) that holds irradiance over pi, with its error against brute force.
        nine: (9, 3) coefficients of irradiance over pi, see ``harmonics.irradiance_nine``.
        nine_error: relative L1 of these nine harmonics against the irradiance cube.
        sun: the lamp that stands out, or None.
        clamped: how many texels of all levels were clamped to the largest value of the format.
        scale: factor that all radiance here was multiplied by; 1 unless ``ProbeOptions.scale`` was needed.
        notes: sentences for the user.
        seconds: wall-clock seconds of each phase.
    """

    surroundings: Surroundings
    preset: ProbePreset
    curve: Curve
    source: NDArray
    levels: list[FilteredLevel]
    irradiance: FilteredLevel
    nine: NDArray
    nine_error: float
    sun: Sun | None
    clamped: int
    scale: float
    notes: list[str]
    seconds: dict[str, float] = field(default_factory=dict)

    def stored(self, cube: NDArray) -> NDArray:
        """A cube map (6, n, n, 3) as it is stored for the engine: mirrored along the preset's axis, if it has one."""
        return reoriented(cube, _MIRRORS[self.preset.mirror])


def make_probe(path: str | Path, options: ProbeOptions, threads: int | None = None) -> Probe:
    """Read and filter an environment; ``threads`` is the number of workers, None for all cores.

    Raises:
        InputError: as ``read_surroundings``, and for options that are out of range or do not go together.
    """
    threads = threads or core_count()
    preset, curve, tables = checked(options)
    began = time.perf_counter()
    surroundings = read_surroundings(path, options.layout, options.clamp)
    natural = min(surroundings.natural_size, LARGEST_SOURCE)
    needed, free = _BYTES_PER_TEXEL * 6 * max(natural, preset.size) ** 2, free_memory()
    if free is not None and needed > free:
        raise InputError(
            f"'{path}' in faces of {preset.size}x{preset.size} needs about {needed / 2**30:.1f} GiB of memory, "
            f"{free / 2**30:.1f} GiB are free: ask for a smaller --size."
        )
    source = as_cube(surroundings, max(natural, preset.size), preset.centre, options.rotate, threads)
    seconds = {"reading": time.perf_counter() - began}
    notes = list(surroundings.notes)
    if natural < preset.size:
        notes.append(f"The source resolves about {natural}x{natural} texels a face: level 0 holds no more.")
    began = time.perf_counter()
    levels, irradiance = _filtered(source, preset, curve, tables, options, threads, notes)
    seconds["filtering and measuring"] = time.perf_counter() - began
    began = time.perf_counter()
    nine = irradiance_nine(source)
    drawn = nine_basis(directions(IRRADIANCE_SIZE)) @ nine
    nine_error = float(np.abs(drawn - irradiance.radiance).sum() / max(np.abs(irradiance.radiance).sum(), 1e-30))
    if drawn.min() < 0.0:
        notes.append("The nine harmonics of irradiance are negative in places: use the cube.")
    sun = find_sun(source)
    if preset.container == "exr" and options.split:
        rest, _ = split_bright(levels[0].radiance, options.split)
        levels[0] = with_radiance(levels[0], rest, source, threads)
        notes.append(f"Level 0 is cut at {options.split:g} times the mean: light the scene with the sun besides.")
    scale, clamped, largest = _within_format(levels, preset, options.scale, notes)
    if clamped:
        cut = [np.minimum(level.radiance, np.float32(largest)) for level in levels]
        levels = [with_radiance(level, each, source, threads) for level, each in zip(levels, cut, strict=True)]
    if scale != 1.0:
        levels = [replace(level, radiance=level.radiance * np.float32(scale)) for level in levels]
        irradiance, nine = replace(irradiance, radiance=irradiance.radiance * np.float32(scale)), nine * scale
    seconds["irradiance and sun"] = time.perf_counter() - began
    return Probe(
        surroundings, preset, curve, source, levels, irradiance, nine, nine_error, sun, clamped, scale, notes, seconds
    )


def _filtered(
    source: NDArray,
    preset: ProbePreset,
    curve: Curve,
    tables: Mapping[int, NDArray],
    options: ProbeOptions,
    threads: int,
    notes: list[str],
) -> tuple[list[FilteredLevel], FilteredLevel]:
    """All levels of a cube and its irradiance; adds sentences for the user to ``notes``."""
    filtering = FilterOptions(
        options.method, options.tolerance, options.split, options.samples, options.order, tables, threads
    )
    # Only "tree" and "brute" can average several lobes over a texel.
    keep_narrow = options.keep_narrow or options.method not in ("tree", "brute")
    requests = level_requests(curve, preset.size, source.shape[1], options.level0 == "copy", keep_narrow)
    wide = LevelRequest(0, IRRADIANCE_SIZE, 1.0, 1.0)
    if options.method == "tree":
        *levels, irradiance = filter_levels(source, [*requests, wide], filtering)
    else:
        levels = filter_levels(source, requests, filtering)
        irradiance = filter_levels(source, [wide], replace(filtering, method="tree"))[0]
    narrow = [str(each.level) for each in requests if each.points > 1]
    if narrow:
        notes.append(f"Lobes of level {', '.join(narrow)} are narrower than a texel there and were averaged over it.")
    missed = [str(e.request.level) for e in levels if e.error > options.tolerance]
    if missed and options.method == "tree":
        notes.append(f"Level {', '.join(missed)} errs by more than the tolerance of {options.tolerance:g}.")
    if options.fit == "lookup":
        from brdffit.probes.lookup import fitted_to_lookup

        fitted, before, after = fitted_to_lookup(source, [each.radiance for each in levels], curve, threads)
        levels = [with_radiance(level, each, source, threads) for level, each in zip(levels, fitted, strict=True)]
        notes.append(f"Levels were fitted to what {curve.name} looks up: error {before:.3f} before, {after:.3f} after.")
    return levels, irradiance


def checked(options: ProbeOptions) -> tuple[ProbePreset, Curve, Mapping[int, NDArray]]:
    """The preset with the changes of the options, the curve, and the tables of the method "table".

    Raises:
        InputError: for options that are out of range or do not go together.
        UnknownNameError: when there is no such preset or table.
    """
    preset = get_probe_preset(options.preset)
    size = preset.size if options.size is None else options.size
    if not 16 <= size <= _LARGEST or size & (size - 1):
        raise InputError(f"A probe of {size} texels a face was asked for, expected a power of two, 16 to {_LARGEST}.")
    levels = preset.levels if options.levels is None else options.levels
    if not 2 <= levels <= size.bit_length():
        asked = "were asked for" if options.levels else f"are those of the preset '{preset.name}'"
        raise InputError(f"{levels} levels {asked}, expected 2 to {size.bit_length()} for {size} texels a face.")
    texel_format = options.texel_format or preset.texel_format
    if preset.container == "exr" and options.texel_format:
        raise InputError(f"The preset '{preset.name}' writes EXR files of floats, found the format '{texel_format}'.")
    if preset.container != "exr" and texel_format not in RADIANCE_FORMATS:
        raise InputError(f"There is no format '{texel_format}': known are {', '.join(RADIANCE_FORMATS)}.")
    if preset.container == "ktx1" and RADIANCE_FORMATS[texel_format].opengl is None:
        raise InputError(f"A KTX1 file here cannot hold '{texel_format}'.")
    if options.method not in METHODS:
        raise InputError(f"There is no method '{options.method}': known are {', '.join(METHODS)}.")
    centre = options.centre or preset.centre
    if centre not in CENTRES:
        raise InputError(f"The centre cannot be '{centre}': known are {', '.join(CENTRES)}.")
    if not 1e-5 <= options.tolerance <= 0.5:
        raise InputError(f"A tolerance of {options.tolerance:g} was asked for, expected 0.00001 to 0.5.")
    if not np.isfinite(options.rotate):
        raise InputError(f"A rotation by {options.rotate:g} degrees was asked for, expected a finite number.")
    if options.split is not None and not 1.0 <= options.split < np.inf:
        raise InputError(f"A split at {options.split:g} times the mean was asked for, expected at least 1.")
    if options.split is not None and options.method in ("tree", "brute") and preset.container != "exr":
        raise InputError(f"The method '{options.method}' takes no split: bright texels cost it no accuracy.")
    curve = get_curve(preset.curve if options.curve is None else options.curve, levels, size)
    tables: Mapping[int, NDArray] = {}
    if options.method == "table":
        from brdffit.probes.table_files import load_table

        table = load_table(options.table)
        if table.curve != curve.name:
            raise InputError(f"The table '{table.name}' is for the curve {table.curve}, found {curve.name}.")
        tables = table.tables
    preset = replace(preset, size=size, levels=levels, texel_format=texel_format, centre=centre)
    return preset, curve, tables


def _within_format(
    levels: list[FilteredLevel], preset: ProbePreset, scale_down: bool, notes: list[str]
) -> tuple[float, int, float]:
    """Factor by which levels fit into the format, how many texels must be clamped instead, and to which value."""
    largest = RADIANCE_FORMATS[preset.texel_format].largest if preset.container != "exr" else float("inf")
    peak = max(float(level.radiance.max()) for level in levels)
    if peak <= largest:
        return 1.0, 0, largest
    if scale_down:
        scale = float(2.0 ** np.floor(np.log2(largest / peak)))
        notes.append(f"Radiance reaches {peak:.0f}: everything was multiplied by {scale:g}, multiply it back.")
        return scale, 0, largest
    clamped = sum(int((level.radiance > largest).any(axis=-1).sum()) for level in levels)
    notes.append(
        f"Radiance reaches {peak:.0f}: {clamped} texel{'s' * (clamped != 1)} clamped to {largest:.0f}, the most that "
        f"{preset.texel_format} holds; --scale keeps them."
    )
    return 1.0, clamped, largest


def request_digest(path: Path, options: ProbeOptions) -> str:
    """SHA-256 of the input files, the options and the version: where it is unchanged, the probe is up to date."""
    files: list[Path] = []
    if not is_built_in(path):
        files = sorted(each for each in path.iterdir() if each.is_file()) if path.is_dir() else [path]
    content = "".join(file_sha256(each) for each in files)
    asked = json.dumps([asdict(options), version("brdffit"), content], sort_keys=True)
    return hashlib.sha256(asked.encode()).hexdigest()


def bake_probe(
    path: str | Path, output: Path, options: ProbeOptions, threads: int | None = None
) -> tuple[Probe, dict[str, Any]]:
    """Make a probe and write its folder, whole or not at all; returns the probe and its manifest.

    Args:
        path: the environment, see ``reading.read_surroundings``.
        output: folder to write; an older probe in it is replaced.
        options: of the probe.
        threads: workers; None takes all cores.

    Raises:
        InputError: when the environment or an option cannot be used.
        OutputError: when the folder cannot be written.
    """
    path = Path(path)
    with replacing(output, foreign_file) as folder:
        probe = make_probe(path, options, threads)
        began = time.perf_counter()
        files = write_probe(probe, folder)
        if options.picture:
            probe_picture(probe, folder / "picture.png", options.tolerance, threads or core_count())
            title = f"{path.name} for {probe.preset.name}, faces as stored, {probe.preset.turning}"
            draw_faces(probe.stored(probe.levels[0].radiance / np.float32(probe.scale)), folder / "faces.png", title)
            files += ["picture.png", "faces.png"]
        probe.seconds["writing and drawing"] = time.perf_counter() - began
        manifest = probe_manifest(probe, options, files)
        manifest["digest"] = request_digest(path, options)
        (folder / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n", encoding="utf-8")
    return probe, manifest


def foreign_file(folder: Path) -> str | None:
    """Name of a file in a folder that no probe wrote, or None; such a folder is not replaced."""
    ours = {"manifest.json", "picture.png", "faces.png", "harmonics.json", "dfg.exr"}
    ours |= {kind + suffix for kind in ("specular", "irradiance") for suffix in SUFFIXES.values()}
    return first_other(folder, ours | {f"specular-{level}.exr" for level in range(16)})


def probe_manifest(probe: Probe, options: ProbeOptions, files: list[str]) -> dict[str, Any]:
    """The manifest of a probe, ready for JSON; ``files`` are the names that were written."""
    levels = [
        {
            "level": each.request.level,
            "size": each.request.n,
            "roughness": round(each.request.roughness, 6),
            "averaged_over_texels": each.request.points > 1,
            "copied": each.request.alpha == 0.0,
            "error": round(each.error, 6),
            "bias": round(each.bias, 6),
            "energy": round(each.energy, 6),
            "seconds": round(each.seconds, 4),
        }
        for each in probe.levels
    ]
    return {
        "brdffit": version("brdffit"),
        "source": str(probe.surroundings.path),
        "layout": probe.surroundings.layout,
        "options": asdict(options),
        "preset": asdict(probe.preset),
        "curve": {
            "name": probe.curve.name,
            "lod": probe.curve.formula,
            "roughness_is": "perceptual, alpha = roughness^2",
        },
        "orientation": {
            "faces": "+X -X +Y -Y +Z -Z, +Y up, as OpenGL looks them up",
            "centre_of_latlong": probe.preset.centre,
            "rotated_degrees": options.rotate,
            "mirrored": probe.preset.mirror or None,
        },
        "source_size": int(probe.source.shape[1]),
        "method": options.method,
        "error_is": "relative L1 of radiance against brute force on at most 64 texels a level; of a copied level "
        "against the source on all texels; before texels are rounded to the format",
        "levels": levels,
        "irradiance": {
            "size": IRRADIANCE_SIZE,
            "is": "irradiance over pi",
            "error": round(probe.irradiance.error, 6),
            "harmonics": np.round(probe.nine, 7).tolist(),
            "harmonics_error": round(probe.nine_error, 6),
        },
        "sun": asdict(probe.sun) if probe.sun else None,
        "clamped_texels": probe.clamped,
        "scale": probe.scale,
        "notes": [*probe.notes, *([probe.preset.note] if probe.preset.note else [])],
        "seconds": {name: round(value, 3) for name, value in probe.seconds.items()},
        "files": files,
        "specular": files[0],
    }
