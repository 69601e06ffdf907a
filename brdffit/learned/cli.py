"""The commands ``brdffit learn ...``: they parse and call; heavy imports stand inside them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click


@click.group()
def learn() -> None:
    """Train the networks of the methods `learned` and `latent`."""


def _options(command: Callable[..., None]) -> Callable[..., None]:
    for option in (
        click.option("--resume", is_flag=True, help="Go on from the checkpoint beside the output."),
        click.option(
            "--held-out", multiple=True, type=click.Path(path_type=Path, exists=True), metavar="SET",
            help="A set to judge by and never to train on; repeatable.",
        ),
        click.option("--seed", type=click.IntRange(min=0), default=0, help="Of weights, data and batches."),
        click.option("--steps", type=click.IntRange(min=1), help="Instead of minutes: same seed, same weights."),
        click.option("--minutes", type=click.FloatRange(0, min_open=True), show_default="20", help="Of training."),
        click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("weights.npz")),
        click.argument("sources", metavar="SET...", nargs=-1, required=True, type=click.Path(path_type=Path)),
    ):  # fmt: skip
        command = option(command)
    return command


@learn.command()
@_options
def learned(**asked: Any) -> None:
    """Train corrections of the closed form on SETs."""
    from brdffit.learned.residual_training import ResidualTask

    _train(ResidualTask, **asked)


@learn.command()
@_options
def latent(**asked: Any) -> None:
    """Train encoder and decoder of a filterable code on SETs (Kemppinen et al. 2023)."""
    from brdffit.learned.latent_training import LatentTask

    _train(LatentTask, **asked)


def _train(
    task: Callable[..., Any], sources: tuple[Path, ...], held_out: tuple[Path, ...], output: Path,
    minutes: float | None, steps: int | None, seed: int, resume: bool,
) -> None:  # fmt: skip
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from brdffit.errors import InputError
    from brdffit.learned.training import train

    if minutes is not None and steps is not None:
        raise click.UsageError("Give --minutes or --steps, not both.")
    both = {source.resolve() for source in sources} & {each.resolve() for each in held_out}
    if both:
        raise InputError(f"'{min(both)}' is to be trained on and held out; it can be one of both.")
    if output.suffix != ".npz":
        raise InputError(f"The weights '{output}' must bear a name that ends in .npz.")
    if steps is None and minutes is None:
        minutes = 20.0
    click.echo("Reading sets and making the training data ...", err=True)
    made = task(sources, held_out, seed)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("{task.fields[state]}"))
    with Progress(*columns) as bar:
        row = bar.add_task("training", total=1.0, state="")

        def told(seconds: float, step: int, done: float, loss: float, figure: float | None) -> None:
            bar.update(row, completed=done, state=f"step {step}, loss {loss:.3f}")
            if figure is not None:
                bar.console.print(f"{seconds / 60:6.1f} min  step {step}  held out {figure:.2f} dB")

        train(made, output, minutes=minutes, steps=steps, seed=seed, resume=resume, told=told)
    click.echo(f"Wrote {output} and its curve {output.with_suffix('.svg')}.")
