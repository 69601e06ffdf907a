"""How long the fit of every set takes: `python -m benchmarks.bakes [--against CHECKOUT] [--set NAME] [-o FILE]`.

Random texels of each level are fitted by default on one thread, in processor seconds, and extrapolated to the level: so
a table of all sets takes minutes, and a busy machine changes little. With ``--against`` another checkout of brdffit
fits the same texels, each set right after ours; only the ratio of two columns of one run means anything.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import click

from benchmarks.materials import every_set
from benchmarks.record import ROOT, Section, as_markdown, machine

#: Both checkouts run this. Half a second or so of each level is timed, the best of two; the first texels compile.
_TIME = """
import json, pathlib, sys, tempfile, time
from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample
from brdffit.halfangle.measure import random_texels
from brdffit.svbrdf import level_sizes
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.procedural import SETS, make_set
from brdffit.textures.reading import read_texture_set

name, path = sys.argv[1:]
if not path and name not in SETS:
    sys.stdout.write("null")
    sys.exit()
with tempfile.TemporaryDirectory() as folder:
    source = pathlib.Path(path) if path else make_set(name, pathlib.Path(folder) / name, 1024)
    base = to_svbrdf(read_texture_set(source))
sample, found = None, []
for level, size in enumerate(level_sizes(base.size)):
    texels = random_texels(size, max(4096 >> (2 * level), 64), seed=level)
    sample = LevelSample(base, 0, *texels, threads=1) if sample is None else sample.at(level, *texels)
    sample.subset(2).fit()
    took = []
    for _ in range(2):
        start = time.process_time()
        sample.fit()
        took.append((time.process_time() - start) / len(sample))
    found.append((size[0] * size[1], min(took)))
sys.stdout.write(json.dumps({"size": base.size, "levels": found}))
"""


def timed(name: str, path: Path | None, checkout: Path) -> dict | None:
    """Size of a set, and for each level its texels and seconds a texel, as a checkout fits it; None for a shipped set
    that it does not have."""
    ran = subprocess.run(
        [sys.executable, "-c", _TIME, name, str(path or "")], cwd=checkout, capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1"},
    )  # fmt: skip
    if ran.returncode:
        raise click.ClickException(f"{name}: {ran.stderr.strip().splitlines()[-1]}")
    return json.loads(ran.stdout)


def row(name: str, ours: dict, theirs: dict | None, compared: bool) -> dict:
    """One row: thousands of texels a processor second at two levels, and seconds of the whole pyramid on two cores.

    ``compared``: whether it has the columns that compare with another checkout, empty where that lacks the set.
    """

    def rate(found: dict, level: int) -> float:
        return 1e-3 / found["levels"][min(level, len(found["levels"]) - 1)][1]

    def whole(found: dict) -> float:
        return sum(texels * seconds for texels, seconds in found["levels"]) / 2

    least = min(1e-3 / seconds for _, seconds in ours["levels"])
    found = {
        "set": name, "size": "x".join(map(str, reversed(ours["size"]))), "k/s level 1": rate(ours, 1),
        "k/s level 4": rate(ours, 4), "k/s slowest": least, "pyramid s": whole(ours),
    }  # fmt: skip
    if compared:
        found |= dict.fromkeys(("rate, level 1", "time, pyramid"))
    if theirs is not None:
        found |= {"rate, level 1": rate(ours, 1) / rate(theirs, 1), "time, pyramid": whole(ours) / whole(theirs)}
    return found


@click.command()
@click.option("--materials", type=click.Path(path_type=Path), default=ROOT.parent / "shared" / "materials")
@click.option("--against", type=click.Path(path_type=Path, exists=True), help="Another checkout of brdffit.")
@click.option("--set", "names", multiple=True, help="These sets alone.")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("bench/bakes.md"), show_default=True)
def main(materials: Path, against: Path | None, names: tuple[str, ...], output: Path) -> None:
    """Time every set and write the table, row by row."""
    note = (
        "Thousands of texels a processor second, by default, at levels 1 and 4 and at the slowest; seconds of the fit "
        "of the whole pyramid on two cores."
    )
    if against is not None:
        note += f" Rate and time over those of {against.name}, in the same run (-: it lacks the set)."
    section, about = Section("bakes", "Fits of every set", note), machine()
    output.parent.mkdir(parents=True, exist_ok=True)
    for name, path in every_set(materials).items():
        if names and name not in names:
            continue
        ours = timed(name, path, ROOT)
        assert ours is not None  # a set of this checkout
        theirs = None if against is None else timed(name, path, against.resolve())
        section.rows.append(row(name, ours, theirs, against is not None))
        output.write_text(as_markdown(about, [section]), encoding="utf-8")
        click.echo(f"{name}: {section.rows[-1]['pyramid s']:.1f} s", err=True)
    click.echo(as_markdown(about, [section]))


if __name__ == "__main__":
    main()
