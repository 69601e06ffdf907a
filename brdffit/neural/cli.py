"""The commands ``brdffit neural ...``. They parse options and call; heavy imports stand inside the functions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from brdffit.cli_options import reading_options
from brdffit.nets.command import check_training, train_with_bar, training_options

_FILE = click.argument("file", metavar="MATERIAL.npz", type=click.Path(path_type=Path))


@click.group()
def neural() -> None:
    """Learn a surface with parallax and shadows as a small network (Kuznetsov et al. 2021), draw it, describe it."""


@neural.command()
@click.argument("source", metavar="SET", type=click.Path(path_type=Path))
@training_options("material.npz", "10", "Seed of weights, queries and batches.")
@click.option("--size", type=int, default=128, help="Texels of the longer side of level 0, a power of two.")
@click.option("--paper", is_flag=True, help="Train exactly as the paper does, without our changes.")
@click.option("--no-offset", is_flag=True, help="Leave out the learned parallax offset.")
@click.option("--bounces", type=click.IntRange(0, 16), default=0, help="Bounces of light between surfaces.")
@click.option("--threads", type=click.IntRange(min=1), show_default="all cores", help="Worker threads.")
@reading_options
def train(
    source: Path, output: Path, size: int, minutes: float | None, steps: int | None, paper: bool, no_offset: bool,
    bounces: int, seed: int, resume: bool, threads: int | None, **reading: Any,
) -> None:  # fmt: skip
    """Learn SET, a texture set with a height map, from queries of its traced surface; or an .npz of measured queries.

    Writes the material, its curve as SVG and, while it is at work, a checkpoint each minute.
    """
    from brdffit.neural.source import open_source
    from brdffit.neural.training import NeuralTask

    check_training(output, minutes, steps)
    opened = open_source(source, size, reading, bounces, threads)
    for note in opened.notes:
        click.echo(f"Note: {note}", err=True)
    click.echo("Compiling, and tracing what is to be judged by ...", err=True)
    task = NeuralTask(
        opened.source, opened.size, seed, paper=paper, with_offset=not no_offset, threads=threads, named=opened.named
    )
    minutes = 10.0 if steps is None and minutes is None else minutes
    train_with_bar(task, output, minutes, steps, seed=seed, resume=resume, settings=task.settings)


@neural.command()
@_FILE
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("out"), help="Folder of the sheet.")
@click.option(
    "--truth",
    type=click.Path(path_type=Path),
    metavar="SET",
    show_default="what it was learned from",
    help="To compare with.",
)
def render(file: Path, output: Path, truth: Path | None) -> None:
    """Draw a contact sheet of all levels at 45 degrees, beside the truth and their difference."""
    from brdffit.neural.material import read_material
    from brdffit.neural.sheet import draw_sheet
    from brdffit.neural.source import answers_for

    material = read_material(file)
    answers = answers_for(material, truth)
    if answers is None:
        click.echo("What it was learned from is not there: the sheet shows the material alone; see --truth.", err=True)
    sheet = output / f"{file.stem}.png"
    for level, figures in enumerate(draw_sheet(material, answers, sheet)):
        click.echo(f"level {level}: MSE {1e3 * figures.mse:.3f}e-3, {figures.snr_db:.1f} dB")
    click.echo(f"See {sheet}")


@neural.command()
@_FILE
def info(file: Path) -> None:
    """Print what MATERIAL.npz holds, what it was learned from, and how well."""
    from brdffit.neural.material import read_material
    from brdffit.neural.source import describe

    for line in describe(read_material(file), file):
        click.echo(line)
