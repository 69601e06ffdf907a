"""The commands ``compare`` and ``landscape``, and what they show in a terminal."""

from __future__ import annotations

import math
import os
import shlex
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from brdffit.report.records import MOST_DB, RECORDS, Comparison
from brdffit.report.summary import DISTANCES, groups, level_table, overall, summary, through_probe
from brdffit.terminal import plain_console

if TYPE_CHECKING:
    from brdffit.comparison.options import CompareOptions

Path_ = str | os.PathLike[str]


class Written(NamedTuple):
    """A report on the disk: its records, and where its page is."""

    comparison: Comparison
    page: Path


class ComparisonDisplay:
    """The progress of a comparison, on standard error: one line, and a bar while texels are baked."""

    def __init__(self) -> None:
        self._console = console = Console(stderr=True, highlight=False, markup=False)
        columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn())
        self._bars = Progress(*columns, TimeElapsedColumn(), console=console, transient=True)
        self._task = self._bars.add_task("", total=None)
        self._text, self._began = "", time.perf_counter()

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bars.stop()

    def phase(self, text: str) -> None:
        """A phase begins; ``text`` describes it."""
        self._text = text
        if not self._console.is_terminal:
            self._console.print(f"{time.perf_counter() - self._began:6.1f} s  {text}", soft_wrap=True)
        self._bars.update(self._task, description=text, total=None, completed=0)

    def __call__(self, level: int, done: int, total: int) -> None:
        """``done`` of ``total`` texels of a level are baked."""
        description = f"{self._text}, level {level}"
        self._bars.update(self._task, description=description, total=total, completed=done)


def compare_to_folder(
    sources: Sequence[Any],
    folder: Path_,
    asked: CompareOptions | Sequence[CompareOptions],
) -> Written:
    """Compare sets and write the report; what was in the folder stays until all is done.

    Args:
        sources: sets, see ``compare``.
        folder: of the report.
        asked: options for all sets, or one for each.

    Raises:
        InputError, UnknownNameError, OutputError: see ``compare`` and ``write_report``.
    """
    # Heavy: numba and the kernels behind it.
    from brdffit.comparison.compare import compare
    from brdffit.report.writing import check_report_folder, write_report

    check_report_folder(folder)
    command = shlex.join(["brdffit", *sys.argv[1:]])
    with ComparisonDisplay() as display:
        made = compare(sources, asked, command=command, listener=display)
        display.phase("drawing the page")
        return Written(made.comparison, write_report(made.comparison, made.pictures, folder, made.viewer))


def redraw(records: Path_, folder: Path_ | None = None) -> Written:
    """Draw the page of records anew, beside them unless a folder is given.

    Raises:
        InputError: when records or pictures cannot be read.
        OutputError: when the folder cannot be written.
    """
    from brdffit.report.writing import read_report, write_report

    path = Path(records)
    read = read_report(path)
    own = path if path.is_dir() else path.parent
    folder = own if folder is None else folder
    return Written(read.comparison, write_report(read.comparison, read.pictures, folder, read.viewer))


def print_summary(written: Written) -> None:
    """Print every method over all views, then its SNR at near, mid and far; a star marks the first of each column."""
    console = plain_console()
    comparison = written.comparison
    sets = ", ".join(result.name for result in comparison.sets)
    console.print(f"All still views of {sets} (* first of its column)", soft_wrap=True)
    console.print(_overall_table(comparison))
    console.print("SNR in dB by distance and light, mean over the sets")
    console.print(_distance_table(comparison))
    if through_probe(comparison):
        console.print("Views of the environment, and of the same through a filtered probe and the split sum")
        console.print(_probe_table(comparison))
    for result in comparison.sets:
        rows = level_table(result.views)
        if rows:
            console.print(f"{result.name}, traced, at 45 degrees: MSE x 10^3 / SNR in dB / FLIP by level")
            console.print(_level_table(rows))
    for result in comparison.sets:
        for each in result.skipped:
            console.print(f"- {result.name}: no {each.method}. {each.reason}", soft_wrap=True)
        for method in result.methods:
            for note in method.notes:
                console.print(f"- {result.name}, {method.method}: {note}", soft_wrap=True)
    phases: dict[str, float] = {}
    for result in comparison.sets:
        for name, value in result.seconds.items():
            phases[name] = phases.get(name, 0.0) + value
    console.print(", ".join(f"{name} {value:.1f} s" for name, value in phases.items()), soft_wrap=True)
    console.print(f"{written.page} (figures: {written.page.with_name(RECORDS)})", soft_wrap=True)


def _overall_table(comparison: Comparison) -> Table:
    """Means of SNR, FLIP and SSIM over all views, in how many of them a method is first, and its worst view."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("method\n")
    for title in ("mean\nSNR", "\nFLIP", "\nSSIM", "energy\nkept", "first in\nSNR", "\nFLIP", "\nSSIM", "of\nviews"):
        table.add_column(title, justify="right")
    table.add_column("worst view\n")
    table.add_column("\nseconds", justify="right")
    for row in overall(comparison):
        cells = [
            ("snr_db", _decibels(row.snr_db)), ("flip", _figure(row.flip)), ("ssim", _figure(row.ssim)),
            ("", "-" if row.energy is None else f"{row.energy[0]:.2f}-{row.energy[1]:.2f}"),
            ("snr_firsts", str(row.firsts[0])), ("flip_firsts", str(row.firsts[1])),
            ("ssim_firsts", str(row.firsts[2])), ("", str(row.views)),
        ]  # fmt: skip
        worst = "-" if row.worst is None else f"{row.worst[0]} ({_decibels(row.worst[1])})"
        seconds = "-" if row.seconds is None else f"{row.seconds:.2f}"
        table.add_row(row.method, *(_marked(text, name in row.best) for name, text in cells), worst, seconds)
    return table


def _probe_table(comparison: Comparison) -> Table:
    """The error that a probe adds to every method."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("method\n")
    for title in ("environment\nSNR", "probe\nSNR", "\nlost", "environment\nrelative L2", "probe\nrelative L2"):
        table.add_column(title, justify="right")
    for row in through_probe(comparison):
        decibels = (row.exact_db, row.probe_db, row.exact_db - row.probe_db)
        errors = (row.exact_error, row.probe_error)
        table.add_row(row.method, *map(_decibels, decibels), *(f"{each:.3g}" for each in errors))
    return table


def _level_table(rows: Sequence[tuple[str, Sequence[tuple[float, float, float]]]]) -> Table:
    """Errors of every method at each level."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("method")
    for level in range(max(len(figures) for _, figures in rows)):
        table.add_column(str(level), justify="right")
    for method, figures in rows:
        table.add_row(method, *(f"{mse:.2f} / {snr:.1f} / {flip:.3f}" for mse, snr, flip in figures))
    return table


def _distance_table(comparison: Comparison) -> Table:
    """SNR of every method at near, mid and far under each light."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("method\n")
    for group, _ in groups(comparison):
        for i, distance in enumerate(DISTANCES):
            table.add_column(f"{group if i == 0 else ''}\n{distance}", justify="right")
    for row in summary(comparison):
        table.add_row(row.method, *(_marked(_decibels(cell.value), cell.best) for cell in row.cells))
    return table


def draw_landscape(
    source: Path_, level: int, texel: tuple[int, int], output: Path, *, model: str, reading: Mapping[str, Any]
) -> None:
    """Read a set, compute the landscape of a texel and draw it.

    Raises:
        InputError: for a set, level or texel that there is not.
        OutputError: when the picture cannot be written.
    """
    from brdffit.files.atomic import check_file
    from brdffit.landscape import landscape
    from brdffit.report.plots import check_picture, save_landscape
    from brdffit.textures.conversion import to_svbrdf
    from brdffit.textures.reading import read_texture_set

    check_picture(output)
    check_file(output)
    began = time.perf_counter()
    texture_set = read_texture_set(source, **reading)
    found = landscape(to_svbrdf(texture_set).weighted(), level, texel, model=model)
    title = f"{texture_set.name}, level {level}, texel {texel[0]},{texel[1]}: log(1 + error)"
    save_landscape(found, title, output)
    first, last = (_decibels(-10.0 * _log10(value)) for value in (found.values[0], found.values[-1]))
    plain_console().print(
        f"{len(found.path) - 1} steps, {first} to {last} dB, {time.perf_counter() - began:.1f} s: {output}"
    )


def _marked(text: str, best: bool) -> Text:
    return Text(f"*{text}" if best else text, style="bold magenta" if best else "")


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _decibels(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.1f}" if abs(value) < MOST_DB else ("inf" if value > 0 else "-inf")


def _log10(value: float) -> float:
    return math.log10(max(value, 1e-10))
