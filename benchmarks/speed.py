"""Speed: fits a second, the whole pyramid, and LEAN beside it in the same run."""

from __future__ import annotations

import statistics
import time
from pathlib import Path

from benchmarks.materials import NAMED, load_any, real_sets
from benchmarks.record import Section, Target
from brdffit.fitting.options import FitOptions
from brdffit.methods import Material, get_method
from brdffit.svbrdf import Svbrdf

FITS_A_SECOND, PYRAMID_SECONDS, LEAN_SECONDS = 250_000.0, 15.0, 0.5
_SIDE = 1024


def measure_speed(materials: Path, quick: bool) -> Section:
    """Measure fits with GGX, five parameters, standard quality, box filter, all cores."""
    section = Section(
        "speed",
        "Speed",
        "GGX, five parameters, box filter, all cores. Fits a second: level 1 alone (footprints of 2x2), median of "
        "several runs. Pyramid: all levels from level 0 down to 1x1. LEAN: the same pyramid, in the same run.",
    )
    sets: dict[str, Path | None] = {"hammered-metal": None}
    real = real_sets(materials)
    sets |= {name: real[name] for name in (NAMED[:2] if quick else NAMED) if name in real}
    for name, path in sets.items():
        svbrdf = load_any(name, path, _SIDE)
        if isinstance(svbrdf, str):
            section.problems.append(f"{name}: {svbrdf}")
            continue
        get_method("bfgs").prepare(Material(svbrdf), FitOptions())
        qualities = ("standard",) if quick else ("draft", "standard", "fine")
        section.rows += [_row(name, svbrdf, quality, runs=3 if quick else 5) for quality in qualities]
    standard = [row for row in section.rows if row["quality"] == "standard"]
    square = [row for row in standard if row["size"] == f"{_SIDE}x{_SIDE}"]
    if standard:
        section.targets += [
            _worst("fits a second, level 1, standard", standard, "fits/s", FITS_A_SECOND, at_least=True),
            _worst("pyramid of 1024x1024, standard, s", square, "pyramid s", PYRAMID_SECONDS),
            _worst("LEAN's pyramid of 1024x1024, s", square, "LEAN s", LEAN_SECONDS),
        ]
    return section


def _row(name: str, svbrdf: Svbrdf, quality: str, runs: int) -> dict[str, object]:
    fit, lean = get_method("bfgs"), get_method("lean")
    # Level 0 kept as authored costs nothing, so of two levels only level 1 is timed.
    only_level_1 = FitOptions(quality=quality, levels=2, keep_level_0=True)
    seconds = []
    for _ in range(runs):
        level = fit.bake_lobes(svbrdf, only_level_1)[1]
        seconds.append(level.seconds)
    texels = level.svbrdf.size[0] * level.svbrdf.size[1]
    lean.bake_lobes(svbrdf, FitOptions())
    lean_seconds = [_timed(lean, svbrdf, FitOptions()) for _ in range(runs)]
    # A whole pyramid takes so long that few repeats suffice.
    pyramid_seconds = [_timed(fit, svbrdf, FitOptions(quality=quality)) for _ in range(max(1, runs - 3))]
    whole, of_lean = statistics.median(pyramid_seconds), statistics.median(lean_seconds)
    assert level.evaluations is not None
    return {
        "set": name,
        "size": f"{svbrdf.size[1]}x{svbrdf.size[0]}",
        "quality": quality,
        "fits/s": texels / statistics.median(seconds),
        "evaluations a fit": float(level.evaluations.mean()),
        "pyramid s": whole,
        "LEAN s": of_lean,
        "pyramid : LEAN": whole / of_lean,
    }


def _timed(method, svbrdf: Svbrdf, options: FitOptions) -> float:  # type: ignore[no-untyped-def]
    start = time.perf_counter()
    method.bake_lobes(svbrdf, options)
    return time.perf_counter() - start


def _worst(name: str, rows: list[dict], column: str, bound: float, at_least: bool = False) -> Target:
    """A target that must hold on every set, shown with the worst set."""
    if not rows:
        return Target(name, f"{'>=' if at_least else '<='} {bound:,g}", "no set of this size", None)
    row = min(rows, key=lambda r: r[column] if at_least else -r[column])
    passed = row[column] >= bound if at_least else row[column] <= bound
    return Target(name, f"{'>=' if at_least else '<='} {bound:,g}", f"{row[column]:,.4g} ({row['set']})", passed)
