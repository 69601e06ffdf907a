"""Errors of neural materials of the shipped sets beside those of Kuznetsov et al. 2021, Table 3.

Run ``python -m benchmarks.neural_sets``; ``--steps`` and ``--size`` set how long and at which size each set is learned,
``--ways`` in which ways: default, unguided (by the surface), no-offset, paper. Rows are MSE x 10^3 of pictures at 45
degrees, level by level, without the noise of the truth; a white matt surface that faces the light is 1. ``--sharp``
gives each set an alpha of 0.05 and a reflectance of 0.5, and rows are then dB. The paper's surfaces are others of the
same kinds, learned at 512x512 texels for 45 minutes on a GPU, so its rows give an order of magnitude, not a target.
"""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import numpy as np

from brdffit.microgeometry.tracer import Microgeometry
from brdffit.nets.training import train
from brdffit.neural.material import read_material
from brdffit.neural.questions import Answers
from brdffit.neural.sheet import draw_sheet
from brdffit.neural.source import learned_size
from brdffit.neural.training import NeuralTask
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.procedural import make_set
from brdffit.textures.reading import read_texture_set

#: Shipped sets with visible heights.
SETS = ("pebbles", "cliff", "insulation-foam", "woven-fabric", "turtle-shell")
#: MSE x 10^3 at levels 0 to 7, Table 3.
PAPER = {
    "wool twisted": (3.98, 2.10, 1.47, 1.07, 0.74, 1.16, 1.17, 1.08),
    "wool straight": (0.39, 0.16, 0.11, 0.08, 0.09, 0.05, 0.03, 0.10),
    "turtle shell": (1.31, 0.92, 0.70, 0.67, 0.88, 0.82, 0.55, 0.48),
    "cliff rock": (2.00, 0.87, 0.63, 0.51, 0.42, 0.32, 0.24, 0.10),
    "insulation foam": (3.90, 1.64, 1.20, 0.86, 0.76, 0.55, 0.57, 0.49),
}
WAYS = {"default": {}, "unguided": {}, "no-offset": {"with_offset": False}, "paper": {"paper": True}}


class Alone:
    """A source that answers queries and does not tell its surface, so that it guides nothing."""

    def __init__(self, source: Microgeometry) -> None:
        self.size, self.query = source.size, source.query


def traced(folder: Path, sharp: bool) -> Microgeometry:
    """The surface of a set, as it is or with sharp lobes."""
    svbrdf = to_svbrdf(read_texture_set(folder))
    if sharp:
        log = np.zeros_like(svbrdf.log_roughness)
        log[..., :2] = 2.0 * np.log(0.05)
        half = np.full_like(svbrdf.specular, 0.5)
        svbrdf = svbrdf.replace(log_roughness=log, specular=half, diffuse=half * svbrdf.diffuse)
    return Microgeometry.of(svbrdf)


def learned(name: str, way: str, size: int, steps: int, folder: Path, sharp: bool) -> tuple[list[float], float]:
    """MSE x 10^3 (or dB) of each level of a set learned in one way, and processor seconds of its training."""
    source = folder / name
    if not source.exists():
        make_set(name, source)
    surface = traced(source, sharp)
    texels, _ = learned_size(surface.size, size)
    task = NeuralTask(Alone(surface) if way == "unguided" else surface, texels, 0, **WAYS[way])  # type: ignore[arg-type]
    file, began = folder / f"{name}-{way}.npz", time.process_time()
    train(task, file, minutes=None, steps=steps, seed=0)
    seconds = time.process_time() - began
    material = read_material(file)
    figures = draw_sheet(material, Answers(surface, texels, material.on_plane), folder / "sheet.png")
    return [each.snr_db if sharp else 1e3 * each.mse for each in figures], seconds


@click.command()
@click.option("--size", default=64, help="Texels a side.")
@click.option("--steps", default=2000, help="Of training.")
@click.option("--sets", default=",".join(SETS))
@click.option("--ways", default="default", help=f"Of {', '.join(WAYS)}.")
@click.option("--sharp", is_flag=True, help="Lobes of an alpha of 0.05 instead of the sets' own; in dB.")
def main(size: int, steps: int, sets: str, ways: str, sharp: bool) -> None:
    """Print the table."""
    with TemporaryDirectory() as folder:
        for name in sets.split(","):
            for way in ways.split(","):
                figures, seconds = learned(name, way, size, steps, Path(folder), sharp)
                row = " ".join(f"{each:6.3f}" for each in figures)
                click.echo(f"{name:16} {way:10} {row}  ({seconds:.0f} s of processor time)")
    if sharp:
        return
    for name, row_of_paper in PAPER.items():
        click.echo(f"{name:16} {'published':10} {' '.join(f'{each:6.3f}' for each in row_of_paper)}")


if __name__ == "__main__":
    main()
