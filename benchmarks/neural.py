"""Speed of neural materials: a step of training, and a picture of 1920x1080 with and without what is kept over lights.

Run ``python -m benchmarks.neural``. Rates are the best of several windows, since other work on the machine can only
lower them. Rates by processor time are those of one core.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import click
import numpy as np

from brdffit.nets.adam import Adam
from brdffit.neural.network import Design, Learner, Network
from brdffit.neural.questions import batch_of, random_queries

_SIZE = (128, 128)
_PICTURE = 1920 * 1080


def best(work: Callable[[], object], windows: int = 12) -> tuple[float, float]:
    """Least wall-clock seconds and least processor seconds of several windows."""
    clock, processor = [], []
    for _ in range(windows):
        start, used = time.perf_counter(), time.process_time()
        work()
        clock.append(time.perf_counter() - start)
        processor.append(time.process_time() - used)
    return min(clock), min(processor)


def steps(threads: int | None, with_offset: bool) -> tuple[float, float]:
    """Million queries a second in training, by wall-clock time and by processor time."""
    rng = np.random.default_rng(0)
    learner = Learner(Network(Design(_SIZE, True, with_offset)), threads)
    queries = batch_of(_SIZE, rng)
    targets = rng.uniform(0, 1, (len(queries), 3)).astype(np.float32)
    adams = {name: Adam(each.size) for name, each in learner.network.parameters().items()}

    def step() -> None:
        learner.refresh(0.0)
        _, gradients = learner.accumulate(queries, targets, False)
        for name, each in learner.network.parameters().items():
            adams[name].step(each, gradients[name], 1e-4)

    return tuple(1e-6 * len(queries) / each for each in best(step))  # type: ignore[return-value]


def main() -> None:
    """Print all figures."""
    for with_offset in (True, False):
        for threads in (1, None):
            clock, processor = steps(threads, with_offset)
            click.echo(
                f"step {'with' if with_offset else 'without'} offset, {threads or 'all'} thread(s): "
                f"{clock:.2f} M queries/s, {processor:.2f} M a second of processor time"
            )
    reader = Learner(Network(Design(_SIZE)))
    queries = random_queries(_PICTURE, _SIZE, np.random.default_rng(1), 1.0)
    # As in a picture, neighbouring pixels see neighbouring texels.
    row, column = np.divmod(np.arange(_PICTURE), 1920)
    queries[:, 0], queries[:, 1] = 0.5 * column % _SIZE[1], 0.5 * row % _SIZE[0]
    features = reader.look_up(queries)
    for name, work in (
        ("1920x1080, both stages", lambda: reader.predict(queries)),
        ("1920x1080, a further light (offset and look-up kept)", lambda: reader.decode(features, queries)),
    ):
        clock, processor = best(work, 5)
        click.echo(f"{name}: {clock:.3f} s, {processor:.3f} s of processor time")


if __name__ == "__main__":
    main()
