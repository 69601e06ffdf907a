"""The commands ``brdffit learn ...``: they parse and call; heavy imports stand inside them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

#: Methods of `learn judge`.
_JUDGED = "bfgs,learned,latent,mipnet,lean,vmf,naive"


@click.group()
def learn() -> None:
    """Train the networks of the methods `learned`, `latent` and `mipnet`."""


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
@click.option(
    "--loss", type=click.Choice(["exact", "paper"]), default="exact", show_default=True,
    help="The half-angle objective, or one sample a pixel as in the paper.",
)  # fmt: skip
@click.option(
    "--form", type=click.Choice(["correction", "absolute"]), default="correction", show_default=True,
    help="Outputs: corrections of LEAN's lobe of the filtered code, or the lobe itself as in the paper.",
)  # fmt: skip
@_options
def latent(loss: str, form: str, **asked: Any) -> None:
    """Train encoders and decoders of a filterable code on SETs (Kemppinen et al. 2023)."""
    from functools import partial

    from brdffit.learned.latent_training import LatentTask

    _train(partial(LatentTask, loss=loss, form=form), **asked)


@learn.command()
@_options
def mipnet(**asked: Any) -> None:
    """Train a network from four texels to one on SETs (after Gauthier et al. 2022)."""
    from brdffit.learned.mipnet_training import MipnetTask

    _train(MipnetTask, **asked)


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


@learn.command()
@click.option(
    "--methods", default="bfgs,learned,latent,mipnet,lean,vmf,naive", show_default=True, help="Rows, by commas."
)
@click.option("--texels", type=click.IntRange(min=1), default=48, show_default=True, help="Random texels of a level.")
@click.option("--model", default="ggx", show_default=True, help="Lobe model of the levels.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Write the rows as JSON too.")
@click.argument("sources", metavar="SET...", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
def judge(sources: tuple[Path, ...], methods: str, texels: int, model: str, output: Path | None) -> None:
    """Half-angle SNR in dB of methods on SETs, levels 1 to 5: sets that no training saw tell the truth."""
    import dataclasses
    import json

    from brdffit.files.atomic import write_text
    from brdffit.learned.judge import LEVELS, judge, mean_rows

    heads = "".join(f"{f'level {level}':>9}" for level in LEVELS)
    tables = []

    def show(rows: list[Any]) -> None:
        for row in rows:
            figures = "".join(f"{value:9.2f}" for value in row.snr).ljust(len(heads))
            seconds = "" if row.seconds is None else f"{row.seconds:8.2f} s"
            mean = f"{row.mean:8.2f}" if row.snr else ""
            click.echo(f"{row.source:24}{row.method:10}{figures}{mean}{seconds}")

    click.echo(f"{'set':24}{'method':10}{heads}{'mean':>8}{'bake':>10}")
    for rows in judge(sources, [name.strip() for name in methods.split(",")], texels, model):
        tables.append(rows)
        show(rows)
        for row in rows:
            for note in row.notes:
                click.echo(f"  {row.method}: {note}")
    if len(tables) > 1:
        show(mean_rows(tables))
    if output is not None:
        records = [dataclasses.asdict(row) for table in tables for row in table]
        write_text(output, json.dumps(records, indent=1) + "\n")
