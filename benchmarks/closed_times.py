"""Processor time of methods without a search against LEAN's: the fit alone, in turn, in one run.

Run ``python -m benchmarks.closed_times SET... [--methods learned,latent]``. It prints a line for each set and method:
the medians over the repeats, and their ratio. In turn, so that what else the machine does slows all alike.
"""

from __future__ import annotations

import statistics
import time
from pathlib import Path

import click

from brdffit.methods import DEFAULT, LobeMethod, Material, get_method
from brdffit.pipeline import bake_options, read_set
from brdffit.svbrdf import Svbrdf


def medians(svbrdf: Svbrdf, names: tuple[str, ...], repeats: int) -> dict[str, float]:
    """Seconds of the processor that each method takes for a set; a first round is not counted."""
    took: dict[str, list[float]] = {name: [] for name in names}
    for repeat in range(repeats + 1):
        for name in names:
            method = get_method(name)
            assert isinstance(method, LobeMethod)
            options = method.options()
            method.prepare(Material(svbrdf), options)
            start = time.process_time()
            method.bake_lobes(svbrdf, options)
            if repeat:
                took[name].append(time.process_time() - start)
    return {name: statistics.median(seconds) for name, seconds in took.items()}


@click.command()
@click.argument("sources", metavar="SET...", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@click.option("--methods", default="learned", show_default=True)
@click.option("--repeats", type=click.IntRange(min=1), default=9, show_default=True)
def main(sources: tuple[Path, ...], methods: str, repeats: int) -> None:
    """Print the times of methods over that of LEAN."""
    for source in sources:
        read = read_set(str(source), {}, bake_options(get_method(DEFAULT), None, {}))
        found = medians(read.material.svbrdf, ("lean", *methods.split(",")), repeats)
        for name, seconds in found.items():
            click.echo(f"{source.name:24}{name:12}{seconds:8.3f} s{seconds / found['lean']:8.2f} x LEAN")


if __name__ == "__main__":
    main()
