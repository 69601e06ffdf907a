"""A library's run in a terminal: a bar with rate and time left, failures as they come, a list at the end."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from brdffit.terminal import plain_console, plain_table

if TYPE_CHECKING:
    from brdffit.library.run import Plan, Summary
    from brdffit.library.task import Outcome

_PHASES = {"looking": "looking at the sets", "compiling": "compiling or loading the kernels", "baking": "baking"}
#: Sets that a dry run lists before it only counts them.
_LISTED = 200


class LibraryDisplay:
    """A ``run.Listener`` on standard error. The bar goes by texels: sets are not of one size."""

    def __init__(self) -> None:
        self._console = Console(stderr=True, highlight=False, markup=False, emoji=False, soft_wrap=True)
        self._bars = Progress(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[state]}"), TimeRemainingColumn(),
            console=self._console, transient=True, speed_estimate_period=120.0,
        )  # fmt: skip
        self._task = self._bars.add_task("", total=None, state="")
        self._done = self._failed = self._texels = 0
        self._sets = 0
        self._began = time.perf_counter()

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._bars.stop()

    def phase(self, name: str) -> None:
        """A phase begins."""
        self._began = time.perf_counter()
        self._bars.update(self._task, description=_PHASES.get(name, name))

    def planned(self, plan: Plan) -> None:
        """Show the plan's counts and failures, and start the bar."""
        self._sets = len(plan.reasons)
        self._bars.reset(self._task, total=sum(height * width for height, width in plan.sizes.values()), state="")
        self._console.print(
            f"{_sets(len(plan.tasks))} found: {len(plan.reasons)} to bake, {len(plan.skipped)} up to date, "
            f"{len(plan.failures)} that cannot be baked."
        )
        for sentence in plan.failures.values():
            self._console.print(f"- {sentence}")
        self._failed = len(plan.failures)

    def finished(self, outcome: Outcome, sizes: Mapping[str, tuple[int, int]]) -> None:
        """A set is baked or set aside."""
        self._done += outcome.error is None
        self._failed += outcome.error is not None
        self._texels += outcome.texels
        height, width = sizes[outcome.key]
        rate = self._texels / max(time.perf_counter() - self._began, 1e-9)
        state = f"{self._done} of {_sets(self._sets)}, {rate:,.0f} texels/s, {self._failed} failed"
        self._bars.update(self._task, advance=height * width, state=state)
        if outcome.error is not None:
            self._console.print(f"- {outcome.error}")
        elif not self._console.is_terminal:
            self._console.print(f"{self._done}/{self._sets} {outcome.key} {width}x{height} {_seconds(outcome):.1f} s")


def print_plan(plan: Plan) -> None:
    """Print what a run would bake, and why."""
    console = plain_console()
    table = plain_table("set", "size", "why", "method", "preset", "options")
    for key, reason in list(plan.reasons.items())[:_LISTED]:
        task, (height, width) = plan.tasks[key], plan.sizes[key]
        options = ", ".join(f"{name} {value}" for name, value in task.options.items())
        table.add_row(key, f"{width}x{height}", reason, task.method, task.preset, options)
    if plan.reasons:
        console.print(table)
    if len(plan.reasons) > _LISTED:
        console.print(f"... and {len(plan.reasons) - _LISTED} more.")
    console.print(f"{_sets(len(plan.reasons))} would be baked, {len(plan.skipped)} are up to date.")


def print_summary(summary: Summary, output: str) -> None:
    """Print what was done, and the list of what failed."""
    console = plain_console()
    baked = [outcome for outcome in summary.outcomes if outcome.error is None]
    line = f"{_sets(len(baked))} baked, {len(summary.plan.skipped)} up to date, {len(summary.failures)} failed"
    if baked:
        line += (
            f"; {summary.texels:,} texels in {summary.seconds:.1f} s, {summary.texels / summary.seconds:,.0f} a second"
        )
        spent: dict[str, float] = {}
        for outcome in baked:
            for phase, seconds in outcome.seconds.items():
                spent[phase] = spent.get(phase, 0.0) + seconds
        line += ".\nOf the workers' time: " + ", ".join(f"{phase} {seconds:.1f} s" for phase, seconds in spent.items())
    console.print(line + ".")
    if summary.failures:
        console.print("Failed:")
    for key, sentence in sorted(summary.failures.items()):
        console.print(f"- {key}: {sentence}")
    console.print(f"{output} (see {output.rstrip('/')}/index.html)")


def _seconds(outcome: Outcome) -> float:
    return sum(outcome.seconds.values())


def _sets(count: int) -> str:
    return f"{count} set{'' if count == 1 else 's'}"
