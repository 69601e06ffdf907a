"""The command line: it parses and calls.

Heavy imports (NumPy, Numba, OpenImageIO, rich) stand inside the commands, so that ``brdffit --help`` answers at once.
Exit codes: 0 done, 1 a bad input or a failed bake, 2 a wrong command line, 130 interrupted.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from brdffit.cli_options import (
    LEVELS_FROM_HELP,
    LIGHTS_HELP,
    OUTPUT_HELP,
    SCENE_HELP,
    Command,
    choice,
    known,
    reading_options,
    refuse_beside_scene,
    set_option,
    shard_of,
    texel_of,
)
from brdffit.errors import BrdffitError, UnknownNameError
from brdffit.learned.cli import learn
from brdffit.neural.cli import neural
from brdffit.probes.cli import probe
from brdffit.textures import READING_OPTIONS
from brdffit.viewer.cli import view


class _Group(click.Group):
    """Turns our errors into their exit codes; their text is one full sentence."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except BrdffitError as error:
            click.echo(f"Error: {error}", err=True)
            ctx.exit(2 if isinstance(error, UnknownNameError) else 1)
        except KeyboardInterrupt:
            click.echo("Interrupted: what was in the output folder before is still there.", err=True)
            ctx.exit(130)


_SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": 110, "show_default": True}


@click.group(cls=_Group, context_settings=_SETTINGS)
@click.version_option(package_name="brdffit")
def main() -> None:
    """Bake MIP pyramids of materials that keep their appearance in the distance."""


main.add_command(probe)
main.add_command(learn)
main.add_command(neural)
main.add_command(view)


@main.command(cls=Command)
@click.argument("source", metavar="SET", required=False)
@click.option("--scene", "scene_file", type=click.Path(path_type=Path), metavar="FILE", help=SCENE_HELP)
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("out"), help=OUTPUT_HELP)
@click.option("--preset", default="plain", callback=known("preset"), help="Pictures for this engine.")
@click.option("--quality", **choice("draft", "standard", "fine"), show_default="standard", help="Accuracy of the fit.")
@click.option(
    "--method", default="bfgs", callback=known("method"), help="See `brdffit methods`; your own as module:object."
)
@click.option("--model", callback=known("model"), show_default="ggx", help="See `brdffit models`.")
@click.option("--lights", metavar="NAME", show_default="mixed", help=LIGHTS_HELP)
@set_option
@click.option("--bits", type=click.Choice(["8", "16"]), default="8", help="Bits per channel.")
@click.option("--compress", **choice("fast", "good", "best"), show_default="good", help="Effort of compression.")
@click.option("--no-preview", is_flag=True, help="Do not draw preview.png.")
@click.option("--show", is_flag=True, help="Open preview.png when done; without a screen, draw it in the terminal.")
@click.option("--levels-from", type=click.IntRange(min=1), metavar="K", help=LEVELS_FROM_HELP)
@click.option("--threads", type=click.IntRange(min=1), show_default="all cores", help="Worker threads.")
@reading_options
@click.pass_context
def bake(
    context: click.Context, source: str | None, scene_file: Path | None, output: Path, bits: str, no_preview: bool,
    show: bool, levels_from: int | None, assigned: dict[str, str], **options: Any,
) -> None:  # fmt: skip
    """Bake the MIP pyramid of SET.

    SET is a folder of textures, or a .gltf, .glb or .mtlx file.
    """
    from brdffit.console import BakeDisplay, print_report, show_picture
    from brdffit.pipeline import bake_to_folder

    if (source is None) == (scene_file is None):
        raise click.UsageError("Give a texture set to bake, or --scene FILE to bake all that a scene calls for.")
    if scene_file is not None:
        from brdffit.planning.console import bake_by_plan

        refuse_beside_scene(context, ("scene_file", "output", "threads", "no_preview", "show"))
        reports = bake_by_plan(scene_file, output, preview=not no_preview, threads=options["threads"])
    elif source is not None:
        given = {name: value for name, value in options.items() if value not in (None, False)} | assigned
        if levels_from is not None:
            from brdffit.reduction import bake_levels_from

            bake_to_folder = functools.partial(bake_levels_from, levels_from=levels_from)
        with BakeDisplay() as display:
            reports = [
                bake_to_folder(source, output, bits=int(bits), preview=not no_preview, progress=display, **given)
            ]
    for report in reports:
        print_report(report)
        if show and not no_preview:
            show_picture(report.folder / "preview.png")


#: Options of ``bake`` that ``library`` takes too, for all of its sets.
_OF_BAKES = ("preset", "quality", "method", "bits", "assigned")
_SHARED = [each for each in bake.params if each.name in _OF_BAKES]
_SHARED += [each for each in bake.params if each.name in READING_OPTIONS and each.name != "roles"]


@main.command(cls=Command, params=[*_SHARED])
@click.argument("root", type=click.Path(path_type=Path))
@click.option("-o", "--output", default="out", metavar="FOLDER", help="Folder or fsspec address, as s3://...")
@click.option(
    "--settings",
    type=click.Path(path_type=Path),
    show_default="ROOT/library.toml",
    help="File of options, for all sets or by pattern.",
)
@click.option(
    "--only", multiple=True, metavar="PATTERN", help="Bake only sets whose path matches, as metal/*; repeatable."
)
@click.option("--shard", callback=shard_of, metavar="I/N", help="Bake only the I-th of N parts, for array jobs.")
@click.option("--force", is_flag=True, help="Bake also what is up to date.")
@click.option("--dry-run", is_flag=True, help="List what would be baked, and why; bake nothing.")
@click.option("--workers", type=click.IntRange(min=1), show_default="one a core", help="Number of processes.")
@click.option(
    "--memory",
    type=click.FloatRange(0, min_open=True),
    metavar="GIB",
    show_default="4/5 of it",
    help="Memory of all processes.",
)
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler that runs the bakes, as tcp://host:8786.")
@click.pass_context
def library(context: click.Context, root: Path, output: str, memory: float | None, **options: Any) -> None:
    """Bake every texture set below ROOT; sets that are up to date are skipped.

    A run that was stopped continues from there. The exit code is 1 if a set failed; all others are baked.
    """
    from brdffit.library.display import LibraryDisplay, print_plan, print_summary
    from brdffit.library.run import run_library

    shared = {each.name or "": options.pop(each.name or "") for each in _SHARED}
    source = context.get_parameter_source
    given = {name: value for name, value in shared.items() if source(name) != click.core.ParameterSource.DEFAULT}
    given |= given.pop("assigned", {})
    bytes_ = None if memory is None else int(memory * 2**30)
    with LibraryDisplay() as display:
        summary = run_library(root, output, memory=bytes_, listener=display, **options, **given)
    print_plan(summary.plan) if options["dry_run"] else print_summary(summary, output)
    if summary.failures or summary.plan.failures:
        context.exit(1)


@main.command(cls=Command)
@click.argument("sources", metavar="SET...", nargs=-1)
@click.option("-o", "--output", type=click.Path(path_type=Path), show_default="report", help="Folder of the report.")
@click.option(
    "--methods", multiple=True, metavar="A,B,...", show_default="all", help="See `brdffit methods`; repeatable."
)
@click.option("--quick", is_flag=True, help="For a first look: small pictures, few samples, draft fit.")
@click.option("--quality", **choice("draft", "standard", "fine"), show_default="standard", help="Accuracy of the fit.")
@click.option(
    "--environment", metavar="FILE", show_default="procedural", help="Light: an equirectangular .hdr or .exr."
)
@click.option("--model", callback=known("model"), show_default="ggx", help="See `brdffit models`.")
@set_option
@click.option("--threads", type=click.IntRange(min=1), show_default="all cores", help="Worker threads.")
@click.option("--from", "records", metavar="FILE", help="Draw the page again from this records.json.")
@click.option("--scene", "scene_file", type=click.Path(path_type=Path), metavar="FILE", help=SCENE_HELP)
@click.option(
    "--truth",
    **choice("maps", "microgeometry"),
    show_default="maps",
    help="Compare with the maps, or with the traced height.",
)
@click.option("--bounces", type=click.IntRange(min=0), default=1, help="Bounces of light on a traced height.")
@click.option("--viewer", is_flag=True, help="Link a page of `brdffit view` of each set too: some 5 MB.")
@click.option(
    "--through-probe", metavar="ENGINE", help="Light by a probe too, for this engine (`brdffit probe --for`)."
)
@reading_options
@click.pass_context
def compare(
    context: click.Context, sources: tuple[str, ...], output: Path | None, records: str | None,
    scene_file: Path | None, truth: str | None, bounces: int, through_probe: str | None, viewer: bool,
    assigned: dict[str, str], **asked: Any,
) -> None:  # fmt: skip
    """Bake each SET by every method, compare the results with a reference, and write a report."""
    from brdffit.comparison.console import compare_to_folder, print_summary, redraw
    from brdffit.comparison.options import CompareOptions

    if bool(sources) + bool(records) + bool(scene_file) != 1:
        raise click.UsageError("Give texture sets to compare, or --scene FILE, or --from FILE to draw a report anew.")
    reading = {name: asked.pop(name) for name in READING_OPTIONS}
    given = {name: value for name, value in asked.items() if value not in (None, False, ())} | assigned
    if records:
        page = redraw(records, output)
    elif scene_file:
        from brdffit.planning.console import compare_by_plan

        refuse_beside_scene(context, ("scene_file", "output", "methods", "quick", "threads"))
        page = compare_by_plan(scene_file, output or "report", **given)
    else:
        make = None
        if truth == "microgeometry":
            from brdffit.comparison.traced import methods_of_table, traced_truth
            from brdffit.microgeometry.tracer import Effects

            make = functools.partial(traced_truth, effects=Effects(bounces=bounces), threads=given.get("threads"))
            given = {"methods": methods_of_table(given)} | given
        chosen = dataclasses.replace(
            CompareOptions.of(reading=reading, **given), truth=make, through_probe=through_probe, viewer=viewer
        )
        page = compare_to_folder(sources, output or "report", chosen)
    print_summary(page)


@main.command()
@click.argument("source", metavar="SET")
@click.option("--level", type=click.IntRange(min=0), default=3, help="MIP level of the texel.")
@click.option("--texel", default="0,0", callback=texel_of, metavar="X,Y", help="Column and row in that level.")
@click.option("--model", default="ggx", callback=known("model"), help="See `brdffit models`.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("landscape.svg"), help="Picture, .svg or .png."
)
@reading_options
def landscape(source: str, level: int, texel: tuple[int, int], model: str, output: Path, **reading: Any) -> None:
    """Draw the error of one texel over roughness and normal, and the path that the optimiser took."""
    from brdffit.comparison.console import draw_landscape

    draw_landscape(source, level, texel, output, model=model, reading=reading)


@main.command()
@click.argument("source", metavar="SET")
@reading_options
@click.pass_context
def inspect(context: click.Context, source: str, **options: Any) -> None:
    """Print what was found in SET, and what looks wrong.

    SET is a folder of textures, or a .gltf, .glb or .mtlx file. The exit code is 1 if it cannot be baked as it is.
    """
    from brdffit.console import print_inspection
    from brdffit.textures.inspection import inspect_set
    from brdffit.textures.reading import read_texture_set

    inspection = inspect_set(read_texture_set(source, **options))
    print_inspection(inspection)
    if "roughness_mean" not in inspection.statistics:  # it could not be decoded; the reason was told
        context.exit(1)


@main.command()
@click.argument("sources", metavar="SET...", nargs=-1, required=True)
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("tradeoff"), help="Folder to write to.")
@click.option("--quick", is_flag=True, help="Measure few texels: a minute per set, noisier figures.")
def tradeoff(sources: tuple[str, ...], output: Path, quick: bool) -> None:
    """Measure what accuracy costs in time: every method, model, preset and optimiser on the same texels.

    SET is a folder of textures, or a .gltf, .glb or .mtlx file.
    """
    from brdffit.tradeoff.command import run, show

    command = " ".join(["brdffit tradeoff", *sources, *(["--quick"] if quick else [])])
    show(run(sources, output, quick, command), output)


@main.command()
@click.argument("source", metavar="SET")
@click.option("--manifest", metavar="FILE", help="Manifest of a bake of SET, to be used instead of a sample fit.")
@click.option("--json", "as_json", is_flag=True, help="Print everything that was found as JSON.")
@click.option("--quality", **choice("draft", "standard", "fine"), show_default="standard", help="Accuracy of the fit.")
@click.option("--model", callback=known("model"), show_default="ggx", help="See `brdffit models`.")
@click.option("--specular", **choice("free", "held"), show_default="free", help="Fit or hold the lobe's colour.")
@reading_options
def doctor(source: str, manifest: str | None, as_json: bool, **asked: Any) -> None:
    """Print which hard cases SET holds, where, and what a bake does about them."""
    from brdffit.console import BakeDisplay, print_diagnosis
    from brdffit.doctor import diagnose

    reading = {name: asked.pop(name) for name in READING_OPTIONS}
    given = {name: value for name, value in asked.items() if value is not None}
    with BakeDisplay() as display:
        diagnosis = diagnose(source, manifest=manifest, reading=reading, phase=display.phase, **given)
    click.echo(diagnosis.to_json(), nl=False) if as_json else print_diagnosis(diagnosis)


@main.group()
def scene() -> None:
    """Write scene files: cameras, surfaces, distances and lights that a bake is planned for."""


@scene.command()
@click.argument("file", type=click.Path(path_type=Path), default=Path("scene.toml"))
@click.option("--force", is_flag=True, help="Replace FILE if it is there.")
def init(file: Path, force: bool) -> None:
    """Write a scene file with every default and a comment on it, to be changed by hand.

    It names the texture sets below the current folder; FILE is scene.toml unless told otherwise.
    """
    from brdffit.library.discovery import find_sets
    from brdffit.planning.template import write_template

    # A set that shares its folder with others has no name that a scene could call it by.
    sets = [found.source for found in find_sets(Path()) if found.files is None]
    click.echo(f"{write_template(file, sets, force)}: {len(sets) or 'no'} texture set{'s' * (len(sets) != 1)} found.")


@main.command()
@click.argument("file", metavar="SCENE", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("plan.json"), help="Plan to write, as JSON."
)
@click.option("--sets", type=click.Path(path_type=Path), metavar="ROOT", help="Plan for every set below ROOT in turn.")
@click.option("--short", is_flag=True, help="Print one line per surface.")
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Seed of the sampled texels and directions.")
@click.option("--threads", type=click.IntRange(min=1), show_default="all cores", help="Worker threads.")
def plan(file: Path, output: Path, sets: Path | None, short: bool, seed: int, threads: int | None) -> None:
    """Print which levels and effects each surface of SCENE needs, why, and what they cost.

    Effects are measured on a few texels and directions; nothing is baked.
    """
    from brdffit.files.atomic import check_file
    from brdffit.library.discovery import find_sets
    from brdffit.planning.console import make_plan, print_plan, write_plan

    found = [each.source for each in find_sets(sets) if each.files is None] if sets else []
    if sets and not found:
        raise click.UsageError(f"There is no texture set below '{sets}'.")
    check_file(output)
    _, made = make_plan(file, found, seed, threads)
    write_plan(made, output)
    print_plan(made, short or bool(sets))


@main.command()
@click.argument("name", required=False, callback=known("method"))
@click.option("--plain", is_flag=True, help="One name a line, for scripts.")
def methods(name: str | None, plain: bool) -> None:
    """List the methods, or the options of the method NAME."""
    from brdffit.methods import get_method, method_names

    if name is not None:
        from brdffit.console import print_options

        print_options(get_method(name), plain)
        return
    _print_names(method_names(), get_method, plain)


@main.command()
@click.option("--plain", is_flag=True, help="One name a line, for scripts.")
def models(plain: bool) -> None:
    """List the lobe models."""
    from brdffit.models import get_model, model_names

    _print_names(model_names(), get_model, plain)


def _print_names(names: list[str], get: Callable[[str], Any], plain: bool) -> None:
    width = max(map(len, names), default=0)
    for name in names:
        click.echo(name if plain else f"{name:{width}}  {get(name).summary}")
