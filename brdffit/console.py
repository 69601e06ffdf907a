"""What people see in a terminal: the progress of a bake, its report, and what was found in a texture set."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from rich.color import Color
from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn
from rich.segment import Segment, Segments
from rich.style import Style

from brdffit.files.image_io import read_image
from brdffit.fitting.status import FALLBACK
from brdffit.options import described
from brdffit.terminal import plain_console, plain_table

if TYPE_CHECKING:
    from brdffit.doctor import Diagnosis
    from brdffit.methods import Method
    from brdffit.pipeline import BakeReport
    from brdffit.textures.inspection import Inspection

_PHASES = {
    "reading": "reading the textures",
    "compiling": "compiling the kernels",
    "looking": "looking at the worst texels, and at some of each level",
    "finishing": "measuring, drawing and writing",
}

#: Columns of a picture in the terminal.
_MOST_COLUMNS = 100


class BakeDisplay:
    """The progress of a bake, on standard error: a bar with level and texels a second; compiling is shown apart."""

    def __init__(self) -> None:
        self._console = Console(stderr=True, highlight=False)
        columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
        self._bars = Progress(*columns, TextColumn("{task.fields[rate]}"), console=self._console, transient=True)
        self._task = self._bars.add_task("", total=None, rate="")
        self._phase = ""
        self._level = -1
        self._phase_began = self._level_began = self._last_report = time.perf_counter()

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bars.stop()

    def phase(self, name: str) -> None:
        """A phase begins; names without an entry in ``_PHASES`` are shown as they stand."""
        if name == self._phase:
            return
        now = time.perf_counter()
        if self._phase == "compiling":
            self._console.print(f"Compiled in {now - self._phase_began:.1f} s.")
        if name == "compiling":
            self._console.print("Compiling the kernels: once on this machine, and no part of the fitting time.")
        self._phase, self._level, self._phase_began, self._last_report = name, -1, now, now
        self._bars.reset(self._task, total=None, description=_PHASES.get(name, name), rate="")

    def __call__(self, level: int, done: int, total: int) -> None:
        """``done`` of ``total`` texels of a level are finished."""
        if level != self._level:
            # A level's first report comes when part of it is done, so it is taken to have begun at the report before.
            self._level, self._level_began = level, self._last_report
            self._bars.reset(self._task, total=total, description=f"level {level}")
        self._last_report = time.perf_counter()
        seconds = max(self._last_report - self._level_began, 1e-9)
        self._bars.update(self._task, completed=done, rate=f"{done / seconds:,.0f} texels/s")


def print_report(report: BakeReport) -> None:
    """Print a table of the levels, the notes, the seconds of each phase, and the folder."""
    table = plain_table("level", "size", "SNR dB", "energy kept", "fallbacks", "texels/s", justify="right")
    for index, ((height, width), level) in enumerate(zip(report.baked.sizes, report.baked.levels, strict=True)):
        status, seconds = (level.status, level.seconds) if level else (None, 0.0)
        measured = report.measured[index] if index < len(report.measured) else {}
        table.add_row(
            str(index),
            f"{width}x{height}",
            _number(measured.get("snr_db"), ".1f"),
            _number(measured.get("energy_kept"), ".1%"),
            _number(None if status is None else int((status == FALLBACK).sum()), ","),
            _number(height * width / seconds if seconds > 0 else None, ",.0f"),
        )
    console = plain_console()
    console.print(table)
    of_preset = report.manifest["preset"]["note"] if report.baked.lobes is not None else ""
    _print_list(console, [*report.notes, *filter(None, [of_preset])])
    console.print(", ".join(f"{_PHASES.get(name, name)} {seconds:.1f} s" for name, seconds in report.seconds.items()))
    preview = report.folder / "preview.png"
    console.print(f"{report.folder}" + (f" (see {preview})" if preview.exists() else ""))
    if report.baked.lobes is not None and report.manifest.get("model") == "ggx":
        console.print(f"Moving, beside averages, in a browser: brdffit view {shlex.quote(str(report.folder))} --open")


def print_options(method: Method, plain: bool = False) -> None:
    """Print the options of a method: names, values, defaults, and a line on each; ``plain`` prints the names alone."""
    console = plain_console()
    options = described(method.options).values()
    if plain:
        for each in options:
            console.print(each.full_name)
        return
    console.print(f"{method.name}: {method.summary}")
    console.print("Each is said by --set NAME=VALUE, or by NAME = VALUE in the table [options] of library.toml.")
    table = plain_table("option", "values", "default", "")
    for each in options:
        default = str(each.default).lower() if each.default in (None, True, False) else str(each.default)
        table.add_row(each.full_name, each.values, default, each.says)
    console.print(table)


def print_inspection(inspection: Inspection) -> None:
    """Print the maps with their roles and decoding, conventions, statistics, and what looks wrong."""
    console = plain_console()
    height, width = inspection.size
    console.print(
        f"{inspection.name}: {width}x{height}, wrap {inspection.wrap}, "
        f"normal Y {inspection.normal_y} ({inspection.normal_y_source})"
    )
    table = plain_table("role", "file", "size", "bits", "read as")
    for image in inspection.maps:
        file = f"{image.file}:{image.channel}" if image.channel else image.file
        bits = f"{image.bits} float" if image.is_float else str(image.bits)
        table.add_row(image.role, file, f"{image.width}x{image.height}", bits, image.decoding)
    console.print(table)
    table = plain_table("statistic", "value")
    for name, value in inspection.statistics.items():
        values = value if isinstance(value, tuple) else (value,)
        table.add_row(name.replace("_", " "), "  ".join(f"{number:.4g}" for number in values))
    if inspection.statistics:
        console.print(table)
    for title, sentences in (
        ("Looks wrong:", inspection.wrong),
        ("Assumed or mended:", inspection.notes),
        ("Not used:", inspection.ignored),
    ):
        if sentences:
            console.print(title)
            _print_list(console, sentences)


def print_diagnosis(diagnosis: Diagnosis) -> None:
    """Print the hard cases and their meaning, the fit of the worst texels and of each level, and advice."""
    console = plain_console()
    console.print(f"{diagnosis.name}: {diagnosis.width}x{diagnosis.height}, quality {diagnosis.options['quality']}")
    if diagnosis.findings:
        table = plain_table("hard case", "texels", "of level", "worst (x,y)", "there the fit", "dB")
        for finding in diagnosis.findings:
            treatment = finding.treatment
            place = ",".join(map(str, finding.worst[0][1:])) if finding.worst else "-"
            ended = _statuses(treatment.statuses) if treatment else "-"
            share = f"{finding.texels:,} ({_share(finding.share)})" if finding.share < 1.0 else "all"
            decibel = _number(treatment.measured_db if treatment else None, ".1f")
            table.add_row(finding.case, share, str(finding.level), place, ended, decibel)
        console.print(table)
        _print_list(console, [f"{each.case}: {each.meaning}" for each in diagnosis.findings])
    else:
        console.print("None of the hard cases was found.")
    table = plain_table("level", "size", "texels looked at", "the fit", "dB by the fit", "dB measured", "energy kept")
    for level in diagnosis.levels:
        each = level.treatment
        table.add_row(str(level.level), f"{level.width}x{level.height}", f"{each.texels:,}", _statuses(each.statuses),
                      _number(each.own_db, ".1f"), _number(each.measured_db, ".1f"),
                      _number(each.energy_kept, ".0%"))  # fmt: skip
    console.print(table)
    _print_list(console, [*diagnosis.advice, *diagnosis.notes])


def _share(share: float) -> str:
    return f"{share:.1%}" if share >= 1e-3 else "<0.1%"


def _statuses(counts: dict[str, int]) -> str:
    """The shares of how texels ended, the commonest first."""
    total = sum(counts.values())
    ordered = sorted(counts.items(), key=lambda item: -item[1])
    return ", ".join(name if count == total else f"{name} {count / total:.0%}" for name, count in ordered)


def show_picture(path: Path) -> None:
    """Open a picture on the screen; without one, draw it in the terminal; into a pipe or a file, do nothing."""
    console = plain_console()
    if not console.is_terminal:
        return
    opener = shutil.which("open" if sys.platform == "darwin" else "xdg-open")
    if opener and (sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        subprocess.Popen([opener, str(path)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    else:
        console.print(Segments(_half_blocks(path, min(console.width, _MOST_COLUMNS))))


def _half_blocks(path: Path, columns: int) -> Iterator[Segment]:
    """A picture as upper half blocks: the foreground colour is one pixel, the background the one below it."""
    pixels = read_image(path).pixels[..., :3]
    height, width = pixels.shape[:2]
    columns = min(columns, width)
    rows = max(2, columns * height // width // 2 * 2)
    # A cell shows the mean of the pixels that fall into it.
    sums = np.add.reduceat(pixels, np.arange(rows) * height // rows, axis=0)
    sums = np.add.reduceat(sums, np.arange(columns) * width // columns, axis=1)
    counts = np.diff(np.arange(rows + 1) * height // rows)[:, None] * np.diff(np.arange(columns + 1) * width // columns)
    codes = np.rint(255.0 * sums / counts[..., None]).astype(int)
    for upper, lower in zip(codes[::2], codes[1::2], strict=True):
        for ink, ground in zip(upper, lower, strict=True):
            yield Segment("\u2580", Style(color=Color.from_rgb(*ink), bgcolor=Color.from_rgb(*ground)))
        yield Segment.line()


def _print_list(console: Console, sentences: list[str]) -> None:
    for sentence in sentences:
        console.print(f"- {sentence}")


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
