"""The command ``plan`` and bakes by a plan: their output in a terminal, and the JSON file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from brdffit.files.atomic import write_text
from brdffit.planning.description import SceneFile, read_scene
from brdffit.planning.plan import EffectRow, Plan, SurfacePlan

if TYPE_CHECKING:
    from brdffit.comparison.console import Written
    from brdffit.pipeline import BakeReport

#: Width in columns where the output is no terminal.
_PIPED_WIDTH = 160


def make_plan(
    path: Path, sets: Sequence[Path] = (), seed: int = 0, threads: int | None = None
) -> tuple[SceneFile, Plan]:
    """Read a scene file and plan it; a status line on standard error tells what is being measured.

    Args:
        sets: texture sets that replace the scene's surfaces, each with the fields of its first surface.

    Raises:
        InputError: as ``read_scene`` and ``plan_scene``.
    """
    # Imported here: it loads numba and the kernels.
    from brdffit.planning.run import plan_scene

    scene = read_scene(path)
    if sets:
        first = scene.surfaces[0]
        surfaces = tuple(
            msgspec.structs.replace(first, set=str(each), name=each.name if each.is_dir() else each.stem)
            for each in sets
        )
        scene = msgspec.structs.replace(scene, surfaces=surfaces)
    with Console(stderr=True, highlight=False, markup=False).status("") as status:
        return scene, plan_scene(scene, path.name, seed, threads, lambda text: status.update(text))


def bake_by_plan(path: Path, output: Path, *, preview: bool, threads: int | None) -> list[BakeReport]:
    """Plan a scene, show the plan, and bake its surfaces.

    Raises:
        InputError, OutputError: as ``make_plan`` and ``bake_scene``.
    """
    from brdffit.console import BakeDisplay
    from brdffit.planning.run import bake_scene

    scene, plan = make_plan(path, threads=threads)
    print_plan(plan)
    with BakeDisplay() as display:
        return bake_scene(scene, plan, output, preview=preview, threads=threads, progress=display)


def compare_by_plan(
    path: Path, output: str | Path, *, methods: Sequence[str] = (), quick: bool = False, threads: int | None = None
) -> Written:
    """Plan a scene, show the plan, and compare methods on its surfaces without the effects that the plan leaves out.

    Raises:
        InputError, OutputError: as ``make_plan`` and ``compare_to_folder``.
    """
    from brdffit.comparison.console import compare_to_folder
    from brdffit.planning.run import comparisons

    scene, plan = make_plan(path, threads=threads)
    print_plan(plan)
    sources, asks = comparisons(scene, plan, methods=methods, quick=quick, threads=threads)
    return compare_to_folder(sources, output, asks)


def print_plan(plan: Plan, short: bool = False) -> None:
    """Print every surface with its effects; with several surfaces also one line each, with ``short`` only these."""
    console = Console(highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console.width = _PIPED_WIDTH
    if not short:
        for surface in plan.surfaces:
            _print_surface(console, surface, plan.budget_db)
    if short or len(plan.surfaces) > 1:
        _print_overview(console, plan)


def write_plan(plan: Plan, path: Path) -> None:
    """Write the plan as JSON.

    Raises:
        OutputError: when the file cannot be written.
    """
    write_text(path, msgspec.json.format(msgspec.json.encode(plan), indent=1).decode() + "\n")


def _print_surface(console: Console, surface: SurfacePlan, budget: float) -> None:
    height, width = surface.size
    console.print(Text(f"{surface.name} ({width}x{height})", style="bold"))
    console.print(surface.seen, soft_wrap=True)
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for name, justify in (
        ("effect", "left"), ("", "left"), ("dB", "right"), ("seconds", "right"), ("why", "left"),
        ("what would change it", "left"),
    ):  # fmt: skip
        table.add_column(name, justify=justify)  # type: ignore[arg-type]
    for row in surface.effects:
        style = "" if row.on else "dim"
        verdict = Text("on" if row.on else "off", style="bold green" if row.on else "dim")
        table.add_row(row.title, verdict, _db(row), _seconds(row.costs_seconds), row.why, row.change, style=style)
    console.print(table)
    if surface.unread:
        console.print(f"Not read: {', '.join(surface.unread)}.")
    everything, planned = surface.everything, surface.planned
    lost = f"{max(surface.lost_db, 0.0):.3f} dB are given up, at most {surface.lost_at_most_db:.3f} (budget {budget:g})"
    console.print(
        f"Everything on: {everything.seconds:.1f} s, {everything.snr_db:.1f} dB. Planned: {planned.seconds:.1f} s, "
        f"{planned.snr_db:.1f} dB; {lost}.",
        soft_wrap=True,
    )
    for note in surface.notes:
        console.print(f"- {note}", soft_wrap=True)
    console.print()


def _print_overview(console: Console, plan: Plan) -> None:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for name in ("surface", "levels", "off"):
        table.add_column(name)
    for name in ("all on, s", "planned, s", "saved", "SNR dB", "lost dB", "at most"):
        table.add_column(name, justify="right")
    for each in plan.surfaces:
        saved = 1.0 - each.planned.seconds / max(each.everything.seconds, 1e-9)
        table.add_row(
            each.name, f"{each.reach[0]} to {each.reach[1]}", ", ".join(each.off), f"{each.everything.seconds:.1f}",
            f"{each.planned.seconds:.1f}", f"{saved:.0%}", f"{each.planned.snr_db:.1f}", f"{each.lost_db:.3f}",
            f"{each.lost_at_most_db:.3f}",
        )  # fmt: skip
    console.print(table)


def _db(row: EffectRow) -> str:
    return "-" if row.contributes_db is None else f"{row.contributes_db:.3f}"


def _seconds(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds:.1f}"
