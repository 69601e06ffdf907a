"""What each loss of the method ``latent`` reaches by the processor's time.

Run ``python -m benchmarks.latent_losses SET... --held-out SET --minutes 3``. Every way trains from nothing with the
same seed; after each minute of processor time it prints the held-out figure (dB, patches of 64 texels, levels 1 to 3)
and the steps so far. Making the first crops and measuring do not count. Ways: "exact", the half-angle objective;
"paper", the loss of Kemppinen et al. 2023, one sample a pixel; "paper-rate", that loss at the paper's own learning
rate. The rate falls over each run as in a training of that length.
"""

from __future__ import annotations

import time
from pathlib import Path

import click
import numpy as np

from brdffit.learned.latent_training import LatentTask

#: Loss and highest learning rate (None: ours) of each way.
WAYS = {"exact": ("exact", None), "paper": ("paper", None), "paper-rate": ("paper", 5e-5)}
#: Crops that steps draw from: fewer than in a training, so that a short run has made them soon.
CROPS = 300


def reached(task: LatentTask, minutes: float, seed: int = 0) -> list[tuple[int, float]]:
    """(steps, held-out figure in dB) after each minute of processor time, and at the end of the last one."""
    networks = task.networks()
    optimisers = {name: task.optimiser(network.weights.size) for name, network in networks.items()}
    found: list[tuple[int, float]] = []
    step, idle, start = 0, 0.0, time.process_time()
    while len(found) < minutes:
        seconds = time.process_time() - start - idle
        if seconds >= 60.0 * min(len(found) + 1, minutes):
            before = time.process_time()
            found.append((step, task.figure()))
            idle += time.process_time() - before
            continue
        rate = task.rate(step, seconds / (60.0 * minutes))
        task.accumulate(np.random.default_rng([seed, step]))
        for name, network in networks.items():
            optimisers[name].step(network.weights, network.gradient, rate)
        step += 1
    return found


@click.command()
@click.argument("sources", metavar="SET...", nargs=-1, required=True, type=click.Path(path_type=Path, exists=True))
@click.option("--held-out", multiple=True, type=click.Path(path_type=Path, exists=True), help="Sets to judge by.")
@click.option("--minutes", type=click.FloatRange(0, min_open=True), default=0.5, show_default=True, help="Of each way.")
@click.option("--ways", default=",".join(WAYS), show_default=True)
@click.option("--crops", type=click.IntRange(min=1), default=CROPS, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
def main(
    sources: tuple[Path, ...], held_out: tuple[Path, ...], minutes: float, ways: str, crops: int, seed: int
) -> None:
    """Print what the ways of training reach on the held-out sets, minute by minute of processor time."""
    for way in ways.split(","):
        if way not in WAYS:
            raise click.BadParameter(f"'{way}' is no way; expected some of {', '.join(WAYS)}.")
    for way in ways.split(","):
        loss, rate = WAYS[way]
        before = time.process_time()
        task = LatentTask(sources, held_out, seed, crops, loss)
        task.highest = task.highest if rate is None else rate
        click.echo(f"{way:12}making {crops} crops took {time.process_time() - before:.0f} s")
        for minute, (steps, figure) in enumerate(reached(task, minutes, seed), 1):
            click.echo(f"{way:12}{min(minute, minutes):6.1f} min {steps:8} steps {figure:8.2f} dB")


if __name__ == "__main__":
    main()
