"""The training loop: time or steps, a held-out figure every minute, checkpoints written whole, a curve in the end.

Step t draws its random numbers from (seed, t) alone, and the loop runs on one thread: the same seed and steps give the
same weights on one kind of processor.
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

#: told(seconds, steps, share done, mean loss, held-out figure or None): called from time to time.
Told = Callable[[float, int, float, float, float | None], None]


class Task(Protocol):
    """What is trained."""

    kind: str

    def networks(self) -> Mapping[str, Network]:
        """Networks whose weights are trained, by name."""
        ...

    def optimiser(self, size: int) -> Adam:
        """Adam as this training wants it."""
        ...

    def rate(self, step: int, done: float) -> float:
        """Learning rate at a step, and share of the training that is done; asked before that step's batch."""
        ...

    def accumulate(self, rng: np.random.Generator) -> float:
        """One batch: add to the gradients of the networks; returns the loss."""
        ...

    def figure(self) -> float:
        """SNR in dB on what is held out."""
        ...

    def arrays(self) -> dict[str, NDArray]:
        """What the file of weights holds."""
        ...

    def meta(self) -> dict[str, Any]:
        """What its meta says."""
        ...


def warm_then_falling(step: int, done: float, rate: float, last: float, warm: int = 100) -> float:
    """Learning rate: ``warm`` steps up, held for the first half, then falling geometrically to ``last``."""
    fall = 1.0 if done < 0.5 else (last / rate) ** ((done - 0.5) / 0.5)
    return rate * min(1.0, (step + 1) / warm) * fall


@dataclass
class Curve:
    """Mean losses and held-out figures of a training, each with its seconds."""

    losses: list[tuple[float, float]] = field(default_factory=list)
    figures: list[tuple[float, float]] = field(default_factory=list)


def checkpoint_path(output: Path) -> Path:
    """Where a training that writes ``output`` keeps its state."""
    return output.with_name(f"{output.stem}.checkpoint.npz")


def train(
    task: Task, output: Path, *, minutes: float | None, steps: int | None = None, seed: int = 0, resume: bool = False,
    told: Told | None = None,
) -> Curve:  # fmt: skip
    """Train for so many minutes, or steps, and write the weights, their curve as SVG, and a checkpoint every minute.

    ``minutes`` count what earlier runs took when ``resume`` goes on from their checkpoint.

    Raises:
        InputError: when there is nothing to resume, or its weights have another shape.
        OutputError: when a file cannot be written.
    """
    if (minutes is None) == (steps is None):
        raise InputError("Give the minutes of the training, or its steps.")
    networks = task.networks()
    optimisers = {name: task.optimiser(network.weights.size) for name, network in networks.items()}
    curve, before, step = Curve(), 0.0, 0
    if resume:
        before, step, curve = _resumed(checkpoint_path(output), task.kind, seed, networks, optimisers)
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
            _write_checkpoint(output, task, seed, networks, optimisers, seconds, step, curve)
            last_figure = time.monotonic()
    seconds = before + time.monotonic() - start
    curve.figures.append((seconds, task.figure()))
    if told is not None:
        told(seconds, step, 1.0, curve.losses[-1][1] if curve.losses else 0.0, curve.figures[-1][1])
    write_trained(output, task, seed, seconds, step, curve)
    checkpoint_path(output).unlink(missing_ok=True)
    return curve


def write_trained(output: Path, task: Task, seed: int, seconds: float, step: int, curve: Curve) -> None:
    """The weights with all that tells where they come from, and the curve beside them."""
    meta = {
        "kind": task.kind, "model": "ggx", "brdffit": __version__, "processor": platform.machine(),
        "seed": seed, "steps": step, "seconds": round(seconds, 1),
        "held_out_snr_db": round(curve.figures[-1][1], 2) if curve.figures else None, **task.meta(),
    }  # fmt: skip
    write_weights(output, task.arrays(), meta)
    draw_curve(curve, output.with_suffix(".svg"), task.kind)


def _write_checkpoint(
    output: Path, task: Task, seed: int, networks: Mapping[str, Network], optimisers: Mapping[str, Adam],
    seconds: float, step: int, curve: Curve,
) -> None:  # fmt: skip
    arrays = {}
    for name, network in networks.items():
        arrays[f"{name}.weights"] = network.weights
        arrays[f"{name}.mean"], arrays[f"{name}.square"] = optimisers[name].mean, optimisers[name].square
    meta = {
        "kind": f"checkpoint of {task.kind}", "seed": seed, "steps": step, "seconds": seconds,
        "losses": curve.losses, "figures": curve.figures,
    }  # fmt: skip
    write_weights(checkpoint_path(output), arrays, meta)
    # What is there so far can be used as it is.
    write_trained(output, task, seed, seconds, step, curve)


def _resumed(
    path: Path, kind: str, seed: int, networks: Mapping[str, Network], optimisers: Mapping[str, Adam]
) -> tuple[float, int, Curve]:
    if not path.is_file():
        raise InputError(f"There is no checkpoint '{path}' to resume from.")
    arrays, meta = read_weights(path, f"checkpoint of {kind}")
    if meta["seed"] != seed:
        raise InputError(f"The checkpoint '{path}' is of seed {meta['seed']}, expected {seed}.")
    for name, network in networks.items():
        shape = network.weights.shape
        network.weights[:] = shaped(arrays, f"{name}.weights", shape, path)
        optimisers[name].mean[:] = shaped(arrays, f"{name}.mean", shape, path)
        optimisers[name].square[:] = shaped(arrays, f"{name}.square", shape, path)
        optimisers[name].steps = int(meta["steps"])
    curve = Curve([tuple(each) for each in meta["losses"]], [tuple(each) for each in meta["figures"]])
    return float(meta["seconds"]), int(meta["steps"]), curve


def draw_curve(curve: Curve, path: Path, title: str) -> None:
    """The loss and the held-out figure over time, as SVG.

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
