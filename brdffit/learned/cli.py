"""The commands ``brdffit learn ...``. They parse options and call; heavy imports stand inside the functions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from brdffit.nets.command import check_training, train_with_bar, training_options

#: Methods that `learn judge` measures unless others are named.
_JUDGED = "bfgs,learned,latent,mipnet,lean,vmf,naive"


@click.group()
def learn() -> None:
    """Train the networks of the methods `learned`, `latent` and `mipnet`."""


def _options(command: Callable[..., None]) -> Callable[..., None]:
    command = training_options("weights.npz", "20", "Seed of weights, data and batches.")(command)
    command = click.option(
        "--held-out", multiple=True, type=click.Path(path_type=Path, exists=True), metavar="SET",
        help="Set to judge by, never trained on; repeatable.",
    )(command)  # fmt: skip
    return click.argument("sources", metavar="SET...", nargs=-1, required=True, type=click.Path(path_type=Path))(
        command
    )


@learn.command()
@_options
def learned(**asked: Any) -> None:
    """Train the method `learned` on SETs: corrections of the closed form."""
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
    """Train the method `latent` on SETs: encoders and decoders of a filterable code (Kemppinen et al. 2023)."""
    from functools import partial

    from brdffit.learned.latent_training import LatentTask

    _train(partial(LatentTask, loss=loss, form=form), **asked)


@learn.command()
@_options
def mipnet(**asked: Any) -> None:
    """Train the method `mipnet` on SETs: a network from four texels to one (after Gauthier et al. 2022)."""
    from brdffit.learned.mipnet_training import MipnetTask

    _train(MipnetTask, **asked)


def _train(
    task: Callable[..., Any], sources: tuple[Path, ...], held_out: tuple[Path, ...], output: Path,
    minutes: float | None, steps: int | None, seed: int, resume: bool,
) -> None:  # fmt: skip
    from brdffit.errors import InputError

    check_training(output, minutes, steps)
    both = {source.resolve() for source in sources} & {each.resolve() for each in held_out}
    if both:
        raise InputError(f"'{min(both)}' is to be trained on and held out; it can be one of both.")
    click.echo("Reading sets and making the training data ...", err=True)
    minutes = 20.0 if steps is None and minutes is None else minutes
    train_with_bar(task(sources, held_out, seed), output, minutes, steps, seed=seed, resume=resume)


@learn.command()
@click.option("--methods", default=_JUDGED, show_default=True, help="Separated by commas.")
@click.option("--texels", type=click.IntRange(min=1), default=48, show_default=True, help="Random texels per level.")
@click.option("--model", default="ggx", show_default=True, help="Lobe model of the levels.")
@click.option(
    "--anisotropy", type=click.FloatRange(min=1.0), default=1.0, show_default=True,
    help="Stretch the sets' lobes to this ratio of alphas, in a direction that turns.",
)  # fmt: skip
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Also write the rows as JSON.")
@click.argument("sources", metavar="SET...", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
def judge(
    sources: tuple[Path, ...], methods: str, texels: int, model: str, anisotropy: float, output: Path | None
) -> None:
    """Print the half-angle SNR of methods on SETs, in dB; only sets that were not trained on are fair."""
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
    for rows in judge(sources, [name.strip() for name in methods.split(",")], texels, model, anisotropy):
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
