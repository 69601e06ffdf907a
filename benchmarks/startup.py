"""Time until something happens: help, the first compile on a machine, and the start of every later run."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.record import ROOT, Section, Target
from brdffit.textures.procedural import make_set

HELP_SECONDS, COMPILE_SECONDS, START_SECONDS, BESIDE_SECONDS = 0.5, 45.0, 2.0, 2.5

# Exits with the seconds of preparing and the time when the first texels are fitted, on a clock that the parent shares.
_FIRST_TEXEL = """
import sys, time
from brdffit.fitting.options import FitOptions
from brdffit.methods import Material, get_method
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.reading import read_texture_set
svbrdf = to_svbrdf(read_texture_set(sys.argv[1]))
before = time.time()
fit = get_method("bfgs")
fit.prepare(Material(svbrdf), FitOptions())
after = time.time()
fit.bake_lobes(svbrdf, FitOptions(levels=1), lambda *_: sys.exit(f"{after - before} {time.time()}"))
"""

# LEAN hardly takes any time itself, so the rest is start, reading, measuring, preview and files.
_BESIDE = """
import sys
from brdffit.pipeline import bake_to_folder
print(bake_to_folder(sys.argv[1], sys.argv[2], method="lean").seconds["fitting"])
"""


def measure_startup(quick: bool) -> Section:
    """Measure each figure in a process of its own."""
    section = Section(
        "startup",
        "Start-up",
        "Each figure from processes of their own; compiling into a cache folder that was empty, then once more with "
        "it. The bakes are of a 32x32 set with all that belongs to one (measuring, preview, files).",
    )
    runs = 3 if quick else 7
    with tempfile.TemporaryDirectory() as scratch:
        maps = make_set("hammered-metal", Path(scratch) / "hammered-metal", 32)
        # Python keeps its bytecode, as it does for a user.
        environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        environment |= {"BRDFFIT_CACHE": f"{scratch}/cache", "PYTHONPYCACHEPREFIX": f"{scratch}/bytecode"}
        command = [sys.executable, "-m", "brdffit.cli"]
        entry = Path(sys.executable).with_name("brdffit")
        help_command = [str(entry), "--help"] if entry.exists() else [*command, "--help"]
        _run(help_command, environment)
        help_seconds = statistics.median(_run(help_command, environment)[0] for _ in range(runs))
        compiling, _ = _first_texel(maps, environment)
        script = "import sys; from brdffit.cli import main; main(sys.argv[1:])"
        bake = [sys.executable, "-c", script, "bake", str(maps), "-o", str(Path(scratch) / "out")]
        first_bake, failed = _run(bake, environment)
        warm = [_first_texel(maps, environment) for _ in range(runs)]
        later_bake, failed_again = _run(bake, environment)
        large = make_set("hammered-metal", Path(scratch) / "large", 1024)
        beside = statistics.median(_beside_the_fit(large, Path(scratch) / "out", environment) for _ in range(runs))
    if failed or failed_again:
        section.problems.append(f"The bake of the small set failed: {(failed or failed_again).strip()}")
    start = statistics.median(first for _, first in warm)
    bake_compiling = compiling + max(0.0, first_bake - later_bake)
    figures = {
        "brdffit --help": help_seconds,
        "compiling the fit, empty cache": compiling,
        "first bake after that, whole (compiles the rest)": first_bake,
        "later bake, whole": later_bake,
        "compiling in all (fit, and first bake - later bake)": bake_compiling,
        "later process until the first texels are fitted": start,
        "bake of 1024x1024 texels beside its fit, whole process": beside,
    }
    section.rows = [{"what": name, "seconds": value} for name, value in figures.items()]
    section.targets = [
        Target("brdffit --help, s", f"<= {HELP_SECONDS}", f"{help_seconds:.2f}", help_seconds <= HELP_SECONDS),
        Target("first compile in all, s", f"<= {COMPILE_SECONDS:g}", f"{bake_compiling:.1f}",
               bake_compiling <= COMPILE_SECONDS),
        Target("later start until fitting, s", f"<= {START_SECONDS:g}", f"{start:.2f}", start <= START_SECONDS),
        Target("1024x1024 beside the fit, s", f"<= {BESIDE_SECONDS:g}", f"{beside:.2f}", beside <= BESIDE_SECONDS),
    ]  # fmt: skip
    return section


def _run(command: list[str], environment: dict[str, str]) -> tuple[float, str]:
    """Wall-clock seconds of a process, and its message if it failed."""
    start = time.perf_counter()
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True)
    return time.perf_counter() - start, done.stderr if done.returncode else ""


def _first_texel(maps: Path, environment: dict[str, str]) -> tuple[float, float]:
    """(seconds of compiling or loading kernels, seconds from a process's start until its first texels are fitted)."""
    start = time.time()
    done = subprocess.run(
        [sys.executable, "-c", _FIRST_TEXEL, str(maps)], env=environment, cwd=ROOT, capture_output=True, text=True
    )
    try:
        compiling, first = map(float, done.stderr.split()[-2:])
    except ValueError as error:
        raise RuntimeError(f"the start-up probe failed: {done.stderr}") from error
    return compiling, first - start


def _beside_the_fit(maps: Path, output: Path, environment: dict[str, str]) -> float:
    """Wall-clock seconds of a process that bakes a set by LEAN, without those of the fit."""
    start = time.perf_counter()
    command = [sys.executable, "-c", _BESIDE, str(maps), str(output)]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=True)
    return time.perf_counter() - start - float(done.stdout)
