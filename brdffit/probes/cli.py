"""The commands of `brdffit probe`. They parse options and call; heavy imports stand inside the functions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

#: Presets, curves and formats by name, as the modules have them; a test holds them together.
PRESET_NAMES = (
    "plain", "bevy", "khronos", "filament", "three", "babylon", "unity", "unreal", "activision", "godot",
)  # fmt: skip
FORMAT_NAMES = ("rgba16f", "rgba32f", "rgb9e5", "r11g11b10f", "bc6h")
METHOD_NAMES = ("tree", "brute", "table", "importance", "sh")
LAYOUT_NAMES = ("latlong", "horizontal-cross", "vertical-cross", "strip", "column")
_THREADS = click.option("--threads", type=click.IntRange(min=1), show_default="all cores", help="Worker threads.")


class _Probe(click.Group):
    """A group whose default command is ``filter``: `brdffit probe ENV` is `brdffit probe filter ENV`."""

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and args[0] not in self.commands:
            args = ["filter", *args]
        return super().resolve_command(ctx, args)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        # Options before the first argument are those of the default command, `filter`.
        if args and args[0].startswith("-") and args[0] not in ("-h", "--help"):
            args = ["filter", *args]
        return super().parse_args(ctx, args)


@click.group(cls=_Probe)
def probe() -> None:
    """Filter environments into what engines load as reflection probes.

    `brdffit probe ENV... -o OUT` is short for `brdffit probe filter ENV... -o OUT`.
    """


@probe.command("filter")
@click.argument("sources", metavar="ENV...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("out/probes"), help="Each probe gets a subfolder."
)
@click.option("--for", "preset", type=click.Choice(PRESET_NAMES), default="plain", help="Engine that loads the files.")
@click.option("--tolerance", type=float, default=0.01, help="Relative L1 error that each level may have.")
@click.option("--size", type=int, show_default="as the preset", help="Texels along a face of level 0.")
@click.option("--levels", type=int, show_default="as the preset", help="Number of levels, with level 0.")
@click.option("--curve", show_default="as the preset", help="Roughness of each level: a name, or r0,r1,...")
@click.option(
    "--format", "texel_format", type=click.Choice(FORMAT_NAMES), show_default="as the preset", help="Of texels."
)
@click.option("--method", type=click.Choice(METHOD_NAMES), default="tree", help="How levels are filtered.")
@click.option("--samples", type=click.IntRange(min=1), default=1024, help="Samples a texel of --method importance.")
@click.option("--order", type=click.IntRange(1, 64), default=11, help="Order of the harmonics of --method sh.")
@click.option("--table", default="ggx-const-8", help="For --method table: a shipped one or a file.")
@click.option(
    "--split",
    type=click.FloatRange(min=1.0),
    metavar="X",
    help="Filter light above X times the mean apart.",
)
@click.option("--level0", type=click.Choice(["copy", "filter"]), default="copy", help="Copy the input or filter it.")
@click.option("--keep-narrow", is_flag=True, help="Filter narrow lobes at texel centres, not over texels.")
@click.option(
    "--fit",
    type=click.Choice(["texels", "lookup"]),
    default="texels",
    help="Minimise the error of texels or of trilinear look-ups.",
)
@click.option("--rotate", type=float, default=0.0, metavar="DEG", help="Turn about +Y, from +X towards -Z.")
@click.option("--layout", type=click.Choice(LAYOUT_NAMES), show_default="guessed from the shape", help="Of the input.")
@click.option(
    "--centre",
    type=click.Choice(["-z", "+x", "+z", "-x"]),
    show_default="as the preset",
    help="Direction at the centre of a lat-long picture.",
)
@click.option("--clamp", is_flag=True, help="Set negative values to 0 and infinite ones to the largest.")
@click.option("--scale", is_flag=True, help="Scale radiance beyond the format down instead of clamping it.")
@click.option("--no-picture", is_flag=True, help="Do not draw picture.png.")
@click.option("--force", is_flag=True, help="Filter also what is up to date.")
@_THREADS
@click.pass_context
def filter_(
    context: click.Context, sources: tuple[Path, ...], output: Path, no_picture: bool, force: bool, threads: int | None,
    **asked: Any,
) -> None:  # fmt: skip
    """Filter each ENV to a stated error, and write levels, irradiance, a split-sum table, a manifest, a picture.

    ENV is a lat-long picture, a cross, a strip, a KTX2 or DDS cube map, a folder of six faces, a folder of any of
    these, `procedural` for the one that ships, or `letters` for faces that bear their names, by which an engine shows
    how it turns cube maps. What fails is named, all others are done; the exit code is then 1.
    """
    from brdffit.probes.bake import ProbeOptions
    from brdffit.probes.shelf import bake_all

    options = ProbeOptions(picture=not no_picture, **asked)
    failed = bake_all(sources, output, options, threads, force, click.echo)
    for name, error in failed:
        click.echo(f"Error: {error}" if name in str(error) else f"Error: {name}: {error}", err=True)
    if failed:
        context.exit(1)


@probe.command()
@click.argument("source", metavar="FILE", type=click.Path(path_type=Path))
@click.option(
    "-o", "--faces", type=click.Path(path_type=Path), help="Also write a picture of the faces with their names."
)
def inspect(source: Path, faces: Path | None) -> None:
    """Print what FILE holds: an environment, or a folder or file that a probe was written to."""
    from brdffit.probes.shelf import describe, draw_faces_of

    for line in describe(source):
        click.echo(line)
    if faces:
        draw_faces_of(source, faces)
        click.echo(f"  see {faces}")


@probe.command()
@click.argument("sources", metavar="ENV...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("report"), help="Folder of the report.")
@click.option("--quick", is_flag=True, help="Measure fewer texels: figures vary by a few percent.")
@_THREADS
def compare(sources: tuple[Path, ...], output: Path, quick: bool, threads: int | None) -> None:
    """Compare all methods with brute force and the paper's tables on each ENV, and write a page."""
    from brdffit.probes.compare import compare_to_folder

    click.echo(f"See {compare_to_folder(sources, output, quick, threads, click.echo)}")


@probe.command()
@click.option("--taps", type=click.IntRange(1, 64), default=8, help="Trilinear reads per frame.")
@click.option(
    "--terms", type=click.Choice(["const", "quadratic", "quartic"]), default="const", help="Polynomials of the taps."
)
@click.option("--curve", default="activision", help="Curve of roughness, or `irradiance`.")
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("table.json"),
    help="Table to write; an existing one is continued.",
)
@click.option("--starts", type=click.IntRange(min=1), default=48, help="Importance-sampled starts per level.")
@click.option("--texels", type=click.IntRange(min=1), default=32, help="Texels that a search measures.")
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Seed of starts and texels.")
@click.option(
    "--begin-with", multiple=True, metavar="TABLE", help="Also start from a table of fewer terms; repeatable."
)
@click.option("--paper", is_flag=True, help="Use the paper's optimiser: one start, golden sections. Slow.")
def table(
    taps: int, terms: str, curve: str, output: Path, starts: int, texels: int, seed: int, begin_with: tuple[str, ...],
    paper: bool,
) -> None:  # fmt: skip
    """Optimise a table for `--method table` (Manson and Sloan 2016, second pass), on one core."""
    from brdffit.probes.report_pictures import draw_histories
    from brdffit.probes.table_files import load_table, make_table
    from brdffit.probes.table_fit import TableRequest

    request = TableRequest(taps, terms, starts, texels, seed, paper)
    command = f"brdffit probe table --taps {taps} --terms {terms} --curve {curve} --starts {starts}"
    command += "".join(f" --begin-with {Path(each).stem}" for each in begin_with) + " --paper" * paper
    made = make_table(output, request, curve, command, [load_table(each) for each in begin_with], click.echo)
    mean = sum(level.error for level in made.levels.values()) / len(made.levels)
    picture = output.with_suffix(".png")
    draw_histories([made], picture)
    click.echo(f"{output}: mean error {mean:.4f} over {len(made.levels)} levels. How the searches went: {picture}")
