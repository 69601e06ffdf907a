"""The cost of a texel as sets grow, which should stay constant, and the memory of a large bake."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.materials import load_procedural, tiled, write_tiled
from benchmarks.record import ROOT, Section, Target
from brdffit.fitting.method import NonlinearFit
from brdffit.fitting.options import FitOptions
from brdffit.methods import Material
from brdffit.textures.procedural import make_set

FLATNESS, MEMORY_GIB = 0.20, 6.0
_SET, _SMALLEST = "hammered-metal", 256
#: Levels that are timed: their texels are the costliest, and they hold nine tenths of all texels.
_LEVELS = 3

_BAKE = """
import json, resource, sys, time
from brdffit.pipeline import bake_to_folder
start = time.perf_counter()
report = bake_to_folder(sys.argv[1], sys.argv[2], quality=sys.argv[3])
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
sys.stdout.write(json.dumps({"bytes": peak, "seconds": time.perf_counter() - start, "phases": report.seconds}))
"""


def measure_scaling(quick: bool) -> Section:
    """Microseconds a texel of the first levels at growing sizes; peak memory of a bake in a process of its own."""
    section = Section(
        "scaling",
        "Scaling and memory",
        f"{_SET} at {_SMALLEST}x{_SMALLEST}, tiled to each size, so that every size holds texels of the same kind. "
        f"Time: levels 0 to {_LEVELS - 1} at standard quality, box filter, all cores. Memory: the peak of a process "
        "that bakes the set from PNG files to a folder, preview and all, at draft quality, which holds the "
        "same arrays as standard.",
    )
    sides = (256, 512, 1024) if quick else (256, 512, 1024, 2048, 4096)
    base = load_procedural(_SET, _SMALLEST)
    fit = NonlinearFit()
    fit.prepare(Material(base), FitOptions())
    for side in sides:
        svbrdf = tiled(base, side // _SMALLEST)
        runs = 3 if side <= 512 else 1
        seconds = []
        for _ in range(runs):
            start = time.perf_counter()
            pyramid = fit.bake_lobes(svbrdf, FitOptions(levels=_LEVELS))
            seconds.append(time.perf_counter() - start)
        texels = sum(level.svbrdf.size[0] * level.svbrdf.size[1] for level in pyramid.levels)
        section.rows.append(
            {"size": f"{side}x{side}", "microseconds a texel": 1e6 * sorted(seconds)[runs // 2] / texels}
        )
    costs = [row["microseconds a texel"] for row in section.rows]
    for row in section.rows:
        row["to the mean"] = row["microseconds a texel"] / (sum(costs) / len(costs))
    spread = max(costs) / min(costs) - 1.0
    name = f"cost per texel, {sides[0]} to {sides[-1]}: largest over smallest - 1"
    section.targets.append(Target(name, f"<= {FLATNESS}", f"{spread:.2f}", spread <= FLATNESS))
    for side in (1024,) if quick else (1024, 4096):
        _memory(section, side)
    if quick:
        section.targets.append(Target("peak memory at 4096x4096, GiB", f"<= {MEMORY_GIB:g}", "run it in full", None))
    return section


def _memory(section: Section, side: int) -> None:
    """Bake in a process of its own and write its peak memory into the row of this size."""
    row = next(row for row in section.rows if row["size"] == f"{side}x{side}")
    with tempfile.TemporaryDirectory() as scratch:
        small = make_set(_SET, Path(scratch) / "small", _SMALLEST)
        large = write_tiled(small, Path(scratch) / _SET, side // _SMALLEST)
        done = subprocess.run(
            [sys.executable, "-c", _BAKE, str(large), str(Path(scratch) / "out"), "draft"],
            cwd=ROOT, env=os.environ, capture_output=True, text=True,
        )  # fmt: skip
    if done.returncode:
        section.problems.append(f"The bake at {side}x{side} failed: {done.stderr.strip().splitlines()[-1]}")
        gib = float("inf")
    else:
        found = json.loads(done.stdout)
        gib = found["bytes"] / 2**30
        for other in section.rows:
            other.setdefault("peak GiB, draft", None)
            other.setdefault("whole bake s, draft", None)
        row["peak GiB, draft"], row["whole bake s, draft"] = gib, found["seconds"]
    if side == 4096:
        name = "peak memory at 4096x4096, GiB"
        section.targets.append(Target(name, f"<= {MEMORY_GIB:g}", f"{gib:.2f}", gib <= MEMORY_GIB))
