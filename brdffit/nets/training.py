"""The training loop: a number of minutes or steps, a held-out figure and a checkpoint every minute, a curve at the end.

Step t draws its random numbers from (seed, t) alone, and no task's sums depend on the number of threads, so the same
seed and steps give the same weights on one kind of processor.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from brdffit import __version__
from brdffit.errors import InputError, OutputError
from brdffit.nets.adam import Adam
from brdffit.nets.layers import Network
from brdffit.nets.weights import read_weights, shaped, write_weights

_FIGURE_SECONDS = 60.0
#: Steps whose mean loss is one point of the curve.
_POINT = 100

#: told(seconds, steps, share done, mean loss, held-out figure or None), called every _POINT steps and every minute.
Told = Callable[[float, int, float, float, float | None], None]


class Task(Protocol):
    """Something that can be trained. ``kind`` names the type of its file of weights."""

    kind: str

    def networks(self) -> Mapping[str, Network]:
        """Networks whose weights are trained, by name."""
        ...

    def optimiser(self, size: int) -> Adam:
        """The optimiser for ``size`` weights."""
        ...

    def rate(self, step: int, done: float) -> float:
        """Learning rate of a step, when the share ``done`` of the training is over; called before the step's batch."""
        ...

    def accumulate(self, rng: np.random.Generator) -> float:
        """Add the gradient of one batch to those of the networks; returns the batch's loss."""
        ...

    def figure(self) -> float:
        """SNR in dB on held-out data."""
        ...

    def arrays(self) -> dict[str, NDArray]:
        """Arrays of the file of weights, by name."""
        ...

    def meta(self) -> dict[str, Any]:
        """Entries of the file's meta; they override those of ``write_trained``."""
        ...


def warm_then_falling(step: int, done: float, rate: float, last: float, warm: int = 100) -> float:
    """Learning rate: rises linearly to ``rate`` over ``warm`` steps, falls geometrically to ``last`` from half on."""
    fall = 1.0 if done < 0.5 else (last / rate) ** ((done - 0.5) / 0.5)
    return rate * min(1.0, (step + 1) / warm) * fall


@dataclass
class Curve:
    """(seconds, mean loss) and (seconds, held-out figure in dB) of a training, in order of time."""

    losses: list[tuple[float, float]] = field(default_factory=list)
    figures: list[tuple[float, float]] = field(default_factory=list)


def checkpoint_path(output: Path) -> Path:
    """Path of the checkpoint of a training that writes ``output``."""
    return output.with_name(f"{output.stem}.checkpoint.npz")


def train(
    task: Task, output: Path, *, minutes: float | None, steps: int | None = None, seed: int = 0, resume: bool = False,
    told: Told | None = None, settings: Mapping[str, Any] | None = None,
) -> Curve:  # fmt: skip
    """Train for a number of minutes, or of steps, and write the weights and their curve as SVG.

    Once a minute the weights so far and a checkpoint are written. Time that earlier runs took counts when ``resume``
    continues from their checkpoint, and so do their steps.

    Args:
        task: what is trained.
        output: file of the weights, .npz.
        minutes, steps: length of the training; exactly one of them.
        seed: of the batches.
        resume: continue from the checkpoint beside ``output``.
        told: is called with the progress.
        settings: what else a training must have in common with the checkpoint that it continues from, as JSON has it.

    Raises:
        InputError: when both or neither of minutes and steps are given, there is nothing to resume, or the checkpoint
            is of another kind, seed or shape, or has other settings.
        OutputError: when a file cannot be written.
    """
    if (minutes is None) == (steps is None):
        raise InputError("Give the minutes of the training, or its steps.")
    networks = task.networks()
    optimisers = {name: task.optimiser(network.weights.size) for name, network in networks.items()}
    curve, before, step = Curve(), 0.0, 0
    settings = {**(settings or {}), "seed": seed}
    if resume:
        before, step, curve = _resumed(checkpoint_path(output), task.kind, settings, networks, optimisers)
    start = last_figure = time.monotonic()
    losses: list[float] = []
    while True:
        seconds = before + time.monotonic() - start
        done = step / steps if steps is not None else seconds / (60.0 * (minutes or 0.0))
        if done >= 1.0:
            break
        rate = task.rate(step, done)
        losses.append(task.accumulate(np.random.default_rng([seed, step])))
        for name, network in networks.items():
            optimisers[name].step(network.weights, network.gradient, rate)
        step += 1
        if len(losses) == _POINT:
            curve.losses.append((seconds, float(np.mean(losses))))
            losses = []
            if told is not None:
                told(seconds, step, done, curve.losses[-1][1], None)
        if time.monotonic() - last_figure > _FIGURE_SECONDS:
            curve.figures.append((seconds, task.figure()))
            if told is not None:
                told(seconds, step, done, curve.losses[-1][1] if curve.losses else 0.0, curve.figures[-1][1])
            _write_checkpoint(output, task, settings, networks, optimisers, seconds, step, curve)
            last_figure = time.monotonic()
    seconds = before + time.monotonic() - start
    curve.figures.append((seconds, task.figure()))
    if told is not None:
        told(seconds, step, 1.0, curve.losses[-1][1] if curve.losses else 0.0, curve.figures[-1][1])
    write_trained(output, task, seed, seconds, step, curve)
    checkpoint_path(output).unlink(missing_ok=True)
    return curve


def write_trained(output: Path, task: Task, seed: int, seconds: float, step: int, curve: Curve) -> None:
    """Write the weights with their provenance, and the curve beside them as SVG."""
    meta = {
        "kind": task.kind, "model": "ggx", "brdffit": __version__, "processor": platform.machine(),
        "seed": seed, "steps": step, "seconds": round(seconds, 1),
        "held_out_snr_db": round(curve.figures[-1][1], 2) if curve.figures else None, **task.meta(),
    }  # fmt: skip
    write_weights(output, task.arrays(), meta)
    draw_curve(curve, output.with_suffix(".svg"), task.kind)


def _write_checkpoint(
    output: Path, task: Task, settings: Mapping[str, Any], networks: Mapping[str, Network],
    optimisers: Mapping[str, Adam], seconds: float, step: int, curve: Curve,
) -> None:  # fmt: skip
    arrays = {}
    for name, network in networks.items():
        arrays[f"{name}.weights"] = network.weights
        arrays[f"{name}.mean"], arrays[f"{name}.square"] = optimisers[name].mean, optimisers[name].square
    meta = {
        **settings, "kind": f"checkpoint of {task.kind}", "steps": step, "seconds": seconds,
        "losses": curve.losses, "figures": curve.figures,
    }  # fmt: skip
    write_weights(checkpoint_path(output), arrays, meta)
    # The weights so far are usable if the training is stopped.
    write_trained(output, task, settings["seed"], seconds, step, curve)


def _resumed(
    path: Path, kind: str, settings: Mapping[str, Any], networks: Mapping[str, Network], optimisers: Mapping[str, Adam]
) -> tuple[float, int, Curve]:
    if not path.is_file():
        raise InputError(f"There is no checkpoint '{path}' to resume from.")
    arrays, meta = read_weights(path, f"checkpoint of {kind}")
    for name, value in settings.items():
        if name not in meta:
            raise InputError(f"The checkpoint '{path}' is of an older version of brdffit: train without --resume.")
        if meta[name] != value:
            raise InputError(f"The checkpoint '{path}' has {name} {meta[name]}, expected {value} as asked for.")
    for name, network in networks.items():
        shape = network.weights.shape
        network.weights[:] = shaped(arrays, f"{name}.weights", shape, path)
        optimisers[name].mean[:] = shaped(arrays, f"{name}.mean", shape, path)
        optimisers[name].square[:] = shaped(arrays, f"{name}.square", shape, path)
        optimisers[name].steps = int(meta["steps"])
    curve = Curve([tuple(each) for each in meta["losses"]], [tuple(each) for each in meta["figures"]])
    return float(meta["seconds"]), int(meta["steps"]), curve


def draw_curve(curve: Curve, path: Path, title: str) -> None:
    """Plot the loss and the held-out figure over time, as SVG.

    Raises:
        OutputError: when it cannot be written.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.4), layout="constrained")
    axes = figure.subplots()
    if curve.losses:
        seconds, losses = np.array(curve.losses).T
        axes.plot(seconds / 60.0, losses, color="tab:gray", linewidth=0.8)
    axes.set(xlabel="minutes", ylabel="training loss", title=f"Training of {title}")
    if curve.figures:
        other = axes.twinx()
        seconds, figures = np.array(curve.figures).T
        other.plot(seconds / 60.0, figures, color="tab:blue", marker=".")
        other.set_ylabel("held-out SNR (dB)", color="tab:blue")
    try:
        figure.savefig(path, metadata={"Date": None})
    except OSError as error:
        raise OutputError(f"'{path}' could not be written: {error.strerror or error}.") from error
