"""What each quality costs in time, and what it loses to the best lobe, on every set that ships or in a folder.

Run ``python -m benchmarks.qualities [--materials FOLDER] [--set NAME ...]``. The error is that on a screen under the
default lights, of random texels of levels 0 to 5, on the part of a set that ``benchmarks.seen`` takes; the best lobe
has a free scale (``brdffit.tradeoff``). Levels above 50 dB count as 50 dB. Times are the processor's.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from benchmarks.materials import crop, real_sets
from brdffit.errors import InputError
from brdffit.halfangle.measure import PERFECT_DB
from brdffit.textures.procedural import SETS
from brdffit.tradeoff.candidates import ORACLE, Candidate, candidates
from brdffit.tradeoff.run import QUICK, measure_candidates

_PRESETS = [each for each in candidates() if each.group == "preset"]
_CHOSEN = [*_PRESETS, Candidate("oracle", "oracle", method=ORACLE)]


def row_of(name: str, path: Path | None) -> list[tuple[float, float]]:
    """For each preset (seconds over those of standard, dB behind the best lobe in the mean of levels).

    Raises:
        InputError: when the set cannot be read.
    """
    points = measure_candidates(name, crop(name, path).over_black(), QUICK, lambda _: None, _CHOSEN)
    *presets, best = points
    usual = next(each.seconds_per_megatexel for each in presets if each.name == "standard")
    seen = [float(np.minimum(each.levels_db, PERFECT_DB).mean()) for each in (*presets, best)]
    return [(each.seconds_per_megatexel / usual, seen[-1] - seen[k]) for k, each in enumerate(presets)]


@click.command()
@click.option("--materials", type=click.Path(path_type=Path), help="Folder of texture sets; the shipped ones if none.")
@click.option("--set", "chosen", multiple=True, help="These alone.")
def main(materials: Path | None, chosen: tuple[str, ...]) -> None:
    """Print a row for each set, then the geometric mean of times, the mean and the worst of decibels."""
    sets: dict[str, Path | None] = dict(real_sets(materials)) if materials else dict.fromkeys(SETS)
    names = [each.name for each in _PRESETS]
    click.echo("| set |" + "".join(f" {name}: time | dB behind |" for name in names))
    click.echo("|---|" + "---:|" * (2 * len(names)))
    rows = []
    for name, path in sets.items():
        if chosen and name not in chosen:
            continue
        try:
            rows.append(row_of(name, path))
        except InputError as error:
            click.echo(f"{name}: {error}", err=True)
            continue
        click.echo(f"| {name} |" + "".join(f" {time:.2f} | {behind:.2f} |" for time, behind in rows[-1]))
    if rows:
        times, behind = np.moveaxis(np.array(rows), 2, 0)
        for label, figure in (("mean", behind.mean(axis=0)), ("worst", behind.max(axis=0))):
            mean = np.exp(np.log(times).mean(axis=0))
            click.echo(f"| {label} |" + "".join(f" {t:.2f} | {d:.2f} |" for t, d in zip(mean, figure, strict=True)))


if __name__ == "__main__":
    main()
