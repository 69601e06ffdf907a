"""The command ``tradeoff``: from texture sets to tradeoff.json, tradeoff.md, the pictures and tables in a terminal."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
from rich.console import Console
from rich.table import Table

from brdffit.files.atomic import check_writable, first_other, replacing
from brdffit.halfangle.measure import PERFECT_DB
from brdffit.machine import machine
from brdffit.options import BakeOptions
from brdffit.pipeline import read_set
from brdffit.tradeoff.drawing import draw
from brdffit.tradeoff.front import choices
from brdffit.tradeoff.record import Tradeoff
from brdffit.tradeoff.run import QUICK, Size, measure_set

_FILES = ("tradeoff.json", "tradeoff.md", "tradeoff.svg", "tradeoff.png")


def run(sources: Sequence[str], output: Path, quick: bool, command: str) -> Tradeoff:
    """Measure all sets and write the folder, all of it or nothing.

    Raises:
        InputError: for a set that cannot be read.
        OutputError: when the folder cannot be written, or holds a file that no trade-off wrote.
    """
    check_writable(output, _foreign)
    size, console, began = QUICK if quick else Size(), Console(stderr=True), time.perf_counter()
    bases = []
    for source in sources:
        read = read_set(source, {}, BakeOptions())
        bases.append((read.name, read.material.svbrdf))
    points, solvers = [], []
    with console.status("starting") as status:
        for name, svbrdf in bases:
            own_points, own_solvers = measure_set(name, svbrdf, size, status.update)
            points += own_points
            solvers += own_solvers
    seconds = round(time.perf_counter() - began, 1)
    found = Tradeoff(command, machine(), list(size.texels), points, solvers, choices(points), seconds)
    with replacing(output, _foreign) as fresh:
        (fresh / _FILES[0]).write_bytes(msgspec.json.format(msgspec.json.encode(found), indent=1))
        (fresh / _FILES[1]).write_text(as_markdown(found), encoding="utf-8")
        draw(found, fresh)
    return found


def _foreign(folder: Path) -> str | None:
    """A file that no trade-off wrote, or None."""
    return first_other(folder, _FILES)


_HEAD = ("set", "group", "candidate", "s / Mtexel", "dB", "energy", "front", "s / Mtexel for each dB")


def _rows(found: Tradeoff) -> list[tuple[str, ...]]:
    """One row a point, by set and time."""
    order = {name: k for k, name in enumerate(dict.fromkeys(point.set for point in found.points))}
    return [
        (
            point.set, point.group, point.name, f"{point.seconds_per_megatexel:.3g}", f"{point.snr_db:.2f}",
            f"{100 * point.energy:.0f}%", "yes" if point.front else "",
            "" if point.price is None else f"{point.price:.3g}",
        )
        for point in sorted(found.points, key=lambda each: (order[each.set], each.seconds_per_megatexel))
    ]  # fmt: skip


_SOLVER_HEAD = ("set", "optimiser", "ms / texel", "dB behind the best, mean", "worst texel", "evaluations")


def _solver_rows(found: Tradeoff) -> list[tuple[str, ...]]:
    return [
        (
            each.set,
            each.name,
            f"{each.milliseconds:.3g}",
            f"{each.behind_db:.3f}",
            f"{each.worst_db:.2f}",
            f"{each.evaluations:.0f}",
        )
        for each in found.solvers
    ]


_CHOICE_HEAD = (
    "preset", "may lose", "cheapest setting within that", "time", "dB", "worst", "preset: time", "dB", "worst",
)  # fmt: skip


def _choice_rows(found: Tradeoff) -> list[tuple[str, ...]]:
    return [
        (
            each.preset, f"{each.allowed_db:g}", each.setting, f"{each.cost:.2f}", f"{each.behind_db:.3f}",
            f"{each.worst_db:.2f}", f"{each.preset_cost:.2f}", f"{each.preset_behind_db:.3f}",
            f"{each.preset_worst_db:.2f}",
        )
        for each in found.choices
    ]  # fmt: skip


def as_markdown(found: Tradeoff) -> str:
    """The tables as Markdown, with the command that made them."""
    ran_on = ", ".join(f"{key} {value}" for key, value in found.machine.items())
    parts = [
        f"# What accuracy costs in time\n\nBy `{found.command}` in {found.seconds:.0f} s on {ran_on}.\n\n"
        "Seconds per megatexel of the base for levels 0 to 5 (processor seconds over the number of cores; closed "
        "forms: a whole bake); SNR of the error under lights of 2, 10 and 40 degrees that the default fit minimises "
        "(on a screen, with squared errors from afar), mean of these levels in dB; energy kept; the "
        "front: no candidate is faster and better; what each dB costs that a candidate on the front has over the one "
        "before.\n",
        "## What the front says of the presets\n\nThe cheapest setting of samples and nodes that loses no more than a "
        "preset may, then the preset itself. What is missing to the best candidate of a set, mean of the sets and the "
        f"worst of them in dB, levels above {PERFECT_DB:g} dB counting as that. Time: over that of standard, geometric "
        "mean.\n",
        _markdown_table(_CHOICE_HEAD, _choice_rows(found)),
        "\n## Every candidate\n",
        _markdown_table(_HEAD, _rows(found)),
        "\n## Optimisers\n\nOn one table a texel (320 nodes, levels 1 and 3), from the closed-form start; time of the "
        "search alone.\n",
        _markdown_table(_SOLVER_HEAD, _solver_rows(found)),
    ]
    return "\n".join(parts)


def _markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def show(found: Tradeoff, output: Path) -> None:
    """Print the front of each set, the choices for the presets and the race of the optimisers."""
    console = Console()
    for name in dict.fromkeys(point.set for point in found.points):
        table = Table(title=f"{name}: the front, and the presets", box=None, title_justify="left")
        for k, head in enumerate(_HEAD[1:]):
            table.add_column(head, justify="left" if k < 2 else "right")
        for row in _rows(found):
            if row[0] == name and (row[6] or row[1] == "preset"):
                table.add_row(*row[1:], style="bold" if row[1] == "preset" else None)
        console.print(table)
    if found.choices:
        table = Table(
            title="What the front says of the presets: time over standard's, dB behind the best",
            box=None,
            title_justify="left",
        )
        for k, head in enumerate(_CHOICE_HEAD):
            table.add_column(head, justify="left" if k in (0, 2) else "right")
        for row in _choice_rows(found):
            table.add_row(*row)
        console.print(table)
    if found.solvers:
        table = Table(title="Optimisers on one objective", box=None, title_justify="left")
        for k, head in enumerate(_SOLVER_HEAD):
            table.add_column(head, justify="left" if k < 2 else "right")
        for row in _solver_rows(found):
            table.add_row(*row)
        console.print(table)
    console.print(f"{output / _FILES[0]}, {_FILES[1]}, {_FILES[2]}, {_FILES[3]}")
