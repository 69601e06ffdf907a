"""Bake many environments one after another, and describe what a file or folder holds."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from brdffit.colour import LUMINANCE
from brdffit.errors import BrdffitError, InputError, OutputError
from brdffit.probes.bake import ProbeOptions, bake_probe, checked, request_digest
from brdffit.probes.containers import read_cube_file
from brdffit.probes.cubemap import mean_radiance
from brdffit.probes.letters import draw_faces
from brdffit.probes.reading import as_cube, is_built_in, is_folder_of_faces, read_surroundings
from brdffit.probes.sun import find_sun

_SUFFIXES = (".hdr", ".exr", ".ktx2", ".ktx", ".dds", ".png", ".jpg", ".tif", ".tiff")


def find_environments(path: Path) -> list[Path]:
    """The environments that a path stands for: itself, or those directly in a folder that is not itself six faces.

    Raises:
        InputError: when it does not exist or a folder holds none.
    """
    if is_built_in(path):
        return [path]
    if not path.exists():
        raise InputError(f"'{path}' does not exist, expected an environment or a folder of them.")
    if not path.is_dir() or is_folder_of_faces(path):
        return [path]
    found = []
    for each in sorted(path.iterdir()):
        if each.name.startswith("."):
            continue
        if each.is_dir():
            found += [each] if is_folder_of_faces(each) else []
        elif each.suffix.lower() in _SUFFIXES:
            found.append(each)
    if not found:
        raise InputError(
            f"There is no environment in '{path}': expected {', '.join(_SUFFIXES)} or folders of six faces."
        )
    return found


def named_environments(sources: Sequence[Path]) -> dict[str, Path]:
    """The environments that paths stand for, by the names that their outputs take, no two the same.

    Raises:
        InputError: as ``find_environments``.
    """
    out: dict[str, Path] = {}
    for path in (each for source in sources for each in find_environments(source)):
        name = path.name if path.is_dir() else path.stem
        while name in out:
            name += "-2"
        out[name] = path
    return out


def bake_all(
    sources: Sequence[Path], output: Path, options: ProbeOptions, threads: int | None, force: bool,
    tell: Callable[[str], None],
) -> list[tuple[str, BrdffitError]]:  # fmt: skip
    """Bake every environment to ``output``/name, except those that are up to date; returns (path, error) of failures.

    ``force`` bakes all of them; ``tell`` is called with lines for the user.
    """
    checked(options)
    found = named_environments(sources)
    failed: list[tuple[str, BrdffitError]] = []
    for name, path in found.items():
        folder = output / name
        try:
            if not force and _is_up_to_date(folder, path, options):
                tell(f"{folder}: up to date")
                continue
            _, manifest = bake_probe(path, folder, options, threads)
        except BrdffitError as error:
            failed.append((str(path), error))
            continue
        for line in _report(folder, manifest):
            tell(line)
    if len(found) > 1:
        tell(f"{len(found) - len(failed)} of {len(found)} environments done.")
    return failed


def _is_up_to_date(folder: Path, path: Path, options: ProbeOptions) -> bool:
    try:
        manifest = _manifest(folder)
    except InputError:
        return False
    if not manifest or not all((folder / name).exists() for name in manifest.get("files", ())):
        return False
    return manifest.get("digest") == request_digest(path, options)


def _report(folder: Path, manifest: dict) -> list[str]:
    lines = [f"{folder}"]
    for level in manifest["levels"]:
        error = f"error {level['error']:.2%}, bias {level['bias']:+.2%}"
        if level["copied"]:
            error = "copied" if level["error"] == 0.0 else f"copied, {error}"
        size = f"{level['size']}x{level['size']}"
        head = f"  level {level['level']}  {size:>9}  roughness {level['roughness']:.3f}"
        lines.append(f"{head}  {error}, energy {level['energy']:.2%}")
    irradiance = manifest["irradiance"]
    lines.append(
        f"  irradiance: cube errs by {irradiance['error']:.2%}, nine harmonics by {irradiance['harmonics_error']:.2%}"
    )
    if manifest["sun"]:
        lines.append(_sun_line(**manifest["sun"]))
    lines += [f"  {note}" for note in manifest["notes"]]
    lines.append("  " + ", ".join(f"{name} {seconds:.2f} s" for name, seconds in manifest["seconds"].items()))
    return lines


def _sun_line(direction: Sequence[float], radius_degrees: float, share: float, **_: Any) -> str:
    towards = ", ".join(f"{value:.3f}" for value in direction)
    return f"  sun towards ({towards}), radius {radius_degrees} degrees, {share:.0%} of the energy"


def _manifest(folder: Path) -> dict | None:
    """The manifest of a folder that a probe was written to; None where there is none.

    Raises:
        InputError: when it is none of a probe.
    """
    path = folder / "manifest.json"
    if not path.exists():
        return None
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"'{path}' cannot be read ({error}).") from error
    if not isinstance(manifest, dict) or not {"specular", "irradiance"} <= set(manifest):
        raise InputError(f"'{path}' is not the manifest of a probe, expected one that `brdffit probe` wrote.")
    return manifest


def draw_faces_of(path: Path, picture: Path) -> None:
    """Draw the faces, each with its name, of a folder of a probe, a cube map file, or an environment.

    Raises:
        InputError: when it can be read as none of them.
        OutputError: when the picture is no PNG or cannot be written.
    """
    if picture.suffix.lower() != ".png":
        raise OutputError(f"'{picture}' was asked for, expected a name that ends in .png.")
    manifest = _manifest(path)
    path = path / manifest["specular"] if manifest else path
    surroundings = read_surroundings(path, clamp=True)
    cube = as_cube(surroundings, min(surroundings.natural_size, 256))
    draw_faces(cube, picture, f"{path.name}: faces as stored")


def describe(path: Path) -> list[str]:
    """Lines that describe a folder of a probe, a cube map file, or an environment.

    Raises:
        InputError: when it can be read as none of them.
    """
    manifest = _manifest(path)
    if manifest:
        return [f"A probe of {manifest['source']} for {manifest['preset']['name']}.", *_report(path, manifest)]
    if path.suffix.lower() in (".ktx2", ".ktx", ".dds"):
        file = read_cube_file(path)
        lines = [f"{path}: a cube map in {file.texel_format}, {len(file.levels)} levels"]
        for level, cube in enumerate(file.levels):
            red, green, blue = mean_radiance(cube)
            lines.append(
                f"  level {level}  {cube.shape[1]}x{cube.shape[1]}  mean {red:.4g} {green:.4g} {blue:.4g}, "
                f"largest {cube.max():.4g}"
            )
        return lines + [f"  {key}: {' '.join(value.split())}" for key, value in file.metadata.items()]
    surroundings = read_surroundings(path, clamp=True)
    cube = as_cube(surroundings, min(surroundings.natural_size, 256))
    luminance = cube @ LUMINANCE
    mean = float(mean_radiance(luminance[..., None])[0])
    lines = [f"{path}", *(f"  {note}" for note in surroundings.notes)]
    lines.append(
        f"  mean luminance {mean:.4g}, largest {luminance.max():.4g} ({luminance.max() / max(mean, 1e-30):.0f} x)"
    )
    sun = find_sun(cube)
    return [*lines, _sun_line(**asdict(sun))] if sun else lines
