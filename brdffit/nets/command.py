"""Shared by the commands that train: options, their checks, and a progress bar."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click


def training_options(output: str, minutes: str, seed: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A decorator that adds the options for output, minutes or steps, seed and resume.

    Args:
        output: default of --output.
        minutes: default of --minutes, as the help shows it.
        seed: help text of --seed.
    """

    def add(command: Callable[..., None]) -> Callable[..., None]:
        for option in (
            click.option("--resume", is_flag=True, help="Continue from the checkpoint beside the output."),
            click.option("--seed", type=click.IntRange(min=0), default=0, help=seed),
            click.option(
                "--steps", type=click.IntRange(min=1), help="Steps instead of minutes: reproducible by the seed."
            ),
            click.option(
                "--minutes", type=click.FloatRange(0, min_open=True), show_default=minutes, help="Minutes of training."
            ),
            click.option(
                "-o", "--output", type=click.Path(path_type=Path), default=Path(output), help="File to write."
            ),
        ):
            command = option(command)
        return command

    return add


def check_training(output: Path, minutes: float | None, steps: int | None) -> None:
    """Check the options of a training before it begins.

    Raises:
        click.UsageError: when minutes and steps are both given.
        InputError: when the output is not named .npz.
        OutputError: when it cannot be written.
    """
    from brdffit.errors import InputError
    from brdffit.files.atomic import check_file

    if minutes is not None and steps is not None:
        raise click.UsageError("Give --minutes or --steps, not both.")
    if output.suffix != ".npz":
        raise InputError(f"'{output}' must bear a name that ends in .npz.")
    check_file(output)


def train_with_bar(task: Any, output: Path, minutes: float | None, steps: int | None, **named: Any) -> None:
    """Train a ``nets.training.Task`` with a progress bar, and print a line for each held-out figure.

    ``named`` are further arguments of ``nets.training.train``, which also says what is raised.
    """
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from brdffit.nets.training import train

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("{task.fields[state]}"))
    with Progress(*columns) as bar:
        row = bar.add_task("training", total=1.0, state="")

        def told(seconds: float, step: int, done: float, loss: float, figure: float | None) -> None:
            bar.update(row, completed=done, state=f"step {step}, loss {loss:.5f}")
            if figure is not None:
                bar.console.print(f"{seconds / 60:6.1f} min  step {step}  held out {figure:.2f} dB")

        train(task, output, minutes=minutes, steps=steps, told=told, **named)
    click.echo(f"Wrote {output} and its curve {output.with_suffix('.svg')}.")
