"""The best single lobe in a view where the fit stays behind: is the lobe at fault, or the fit?

    python -m benchmarks.best_lobe --set coarse-sand --view far-environment [--texels 3] [--evaluations 1500]

A few random texels of the view's level are drawn, each as a patch: every pixel of the patch has the texel's footprint
and is seen from a direction of the view's picture. The patch is rendered by the reference, with the texel as each
method bakes it, and with lobes that Nelder and Mead's search (1965) finds for a single figure, started from the
methods' texels:

- SNR: the squared error of radiance, without the reference's noise;
- displayed: the mean absolute difference of tone-mapped pixels at the view's own exposure, which FLIP follows.

The lobe is free: normal, roughness tensor, specular and diffuse colour. Where the search for a figure finds nothing
better than the best closed form, a single lobe can do no better and the fit is not at fault.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from benchmarks.materials import every_set
from benchmarks.record import ROOT, table
from benchmarks.seen import Bench, as_asked
from brdffit.comparison.views import Still
from brdffit.halfangle.measure import random_texels
from brdffit.methods import Material
from brdffit.pipeline import Phases, ReadSet, run
from brdffit.render import metrics
from brdffit.render.reference import Reference
from brdffit.render.scenes import Scene
from brdffit.svbrdf import Svbrdf, level_sizes

#: Side of a patch in pixels.
_SIDE = 14
#: Relative squared error that is invisible: 40 dB.
_SEEN = 1e-4
_COLUMNS = ("bfgs", "naive", "toksvig", "vmf", "lean")
#: First steps of the search: slopes, log tensor, logs of colours.
_STEPS = np.array([0.05, 0.05, 0.5, 0.5, 0.2, *[0.1] * 3, *[0.1] * 3])


class Patch:
    """One texel of a view's level, under the view's light and from its directions."""

    def __init__(self, bench: Bench, view: Still, level: int, column: int, row: int) -> None:
        self.bench, self.view, base = bench, view, bench.base.size
        height, width = level_sizes(base)[level]
        scale = base[1] / width, base[0] / height
        centre = (column + 0.5) * scale[0], (row + 0.5) * scale[1]
        scene = _footprint(_few_pixels(view.scene), centre, scale, base)
        self.reference: Reference = bench.studio.reference(bench.base, scene, view.lit)
        # A single lobe is rendered as a texture of one texel.
        self.scene = _footprint(scene, (0.5, 0.5), (1.0, 1.0), (1, 1))
        whole = bench.references()[view.key].radiance
        self.exposure = metrics.exposure_of(whole)
        self.truth = metrics.tone_map(self.reference.radiance, self.exposure)

    def errors(self, texel: Svbrdf) -> tuple[float, float]:
        """(relative squared error of radiance, mean absolute difference of displayed pixels) of a (1, 1) image."""
        halves = self.bench.studio.method([texel], self.scene, self.view.lit)
        squared = 10.0 ** (-0.1 * metrics.snr_db_of_halves(halves, self.reference.halves))
        shown = metrics.tone_map(halves.mean(axis=0), self.exposure)
        return float(squared), float(np.abs(shown - self.truth).mean())

    def best(self, figure: int, starts: list[Svbrdf], evaluations: int) -> tuple[float, Svbrdf]:
        """The least error of one kind and its texel: the search runs from the best start, then from its own end."""
        start = min(starts, key=lambda texel: self.errors(texel)[figure])
        theta = parameters(start)

        def error(at: NDArray) -> float:
            found = self.errors(texel_of(at, start))[figure]
            return found if np.isfinite(found) else 1e9

        for _ in range(2):
            options = {
                "initial_simplex": np.vstack([theta, theta + np.diag(_STEPS)]), "maxfev": evaluations // 2,
                "adaptive": True,
            }  # fmt: skip
            theta = minimize(error, theta, method="Nelder-Mead", options=options).x
        ends = (error(theta), texel_of(theta, start)), (self.errors(start)[figure], start)
        return min(ends, key=lambda each: each[0])


def parameters(texel: Svbrdf) -> NDArray:
    """(11,): slopes of the normal, log tensor, logs of the specular and of the diffuse colour."""
    normal = texel.normal[0, 0].astype(np.float64)
    logs = [np.log(np.maximum(colour[0, 0], 1e-5)) for colour in (texel.specular, texel.diffuse)]
    return np.concatenate([-normal[:2] / max(normal[2], 0.05), texel.log_roughness[0, 0], *logs])


def texel_of(theta: NDArray, like: Svbrdf) -> Svbrdf:
    """The (1, 1) image with these ``parameters``."""
    normal = np.array([-theta[0], -theta[1], 1.0]) / np.sqrt(1.0 + theta[0] ** 2 + theta[1] ** 2)
    log_tensor, specular, diffuse = theta[2:5].copy(), np.exp(theta[5:8]), np.exp(theta[8:11])
    log_tensor[:2] = np.clip(log_tensor[:2], -14.0, 1.0)
    log_tensor[2] = np.clip(log_tensor[2], -6.0, 6.0)
    arrays = {"normal": normal, "log_roughness": log_tensor, "specular": specular, "diffuse": diffuse}
    return like.replace(**{name: each.astype(np.float32)[None, None] for name, each in arrays.items()})


def _few_pixels(scene: Scene) -> Scene:
    """``_SIDE`` x ``_SIDE`` pixels of a scene, evenly spaced."""
    at = np.ix_(*((np.arange(_SIDE) + 0.5) * size // _SIDE for size in scene.pixels))
    at = tuple(each.astype(np.int64) for each in at)
    names = ("centre", "axes", "view", "frame", "coverage")
    return dataclasses.replace(scene, **{name: getattr(scene, name)[at] for name in names})


def _footprint(scene: Scene, centre: tuple[float, float], scale: tuple[float, float], size: tuple[int, int]) -> Scene:
    """The scene with the same directions, and one footprint for all pixels."""
    pixels = scene.pixels
    axes = np.broadcast_to(np.diag(scale), (*pixels, 2, 2)).copy()
    return dataclasses.replace(scene, centre=np.broadcast_to(centre, (*pixels, 2)).copy(), axes=axes, base_size=size)


def measure(
    bench: Bench, key: str, texels: int, evaluations: int, columns: tuple[str, ...] = _COLUMNS,
    tell: Callable[[str], None] = print,
) -> list[dict[str, object]]:  # fmt: skip
    """Rows of the table: each method, and the best lobe for each figure, averaged over the texels."""
    view = next(each for each in bench.views if each.key == key)
    level = int(view.level or 0)
    pyramids = {}
    for column in columns:
        method, options = as_asked(column)
        baked = run(ReadSet(bench.name, Material(bench.base)), method, options, Phases())
        assert baked.lobes is not None
        pyramids[column] = baked.lobes.levels[level].svbrdf
    names = [*columns, "best for SNR", "best displayed"]
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    for column, row in zip(*random_texels(level_sizes(bench.base.size)[level], texels, seed=1), strict=True):
        patch = Patch(bench, view, level, int(column), int(row))
        own = {name: _texel(each, int(column), int(row)) for name, each in pyramids.items()}
        for name, texel in own.items():
            found[name].append(patch.errors(texel))
        for figure, name in enumerate(names[-2:]):
            _, best = patch.best(figure, list(own.values()), evaluations)
            found[name].append(patch.errors(best))
            where = f"{bench.name}, {key}, texel ({column}, {row})"
            tell(f"{where}, {name}: {described(best)}; {columns[0]}: {described(own[columns[0]])}")
    return [
        {
            "set": bench.name, "view": key, "lobe": name,
            "SNR": -10.0 * float(np.log10(max(np.mean([squared for squared, _ in each]), _SEEN))),
            "displayed": float(np.mean([shown for _, shown in each])),
        }
        for name, each in found.items()
    ]  # fmt: skip


def described(texel: Svbrdf) -> str:
    """A lobe in one line: normal, the two alphas, specular and diffuse colour."""
    a, b, c = (float(each) for each in texel.log_roughness[0, 0])
    mean, radius = 0.5 * (a + b), float(np.hypot(0.5 * (a - b), c))
    alphas = np.exp(0.5 * (mean + radius)), np.exp(0.5 * (mean - radius))
    parts = [texel.normal[0, 0], alphas, texel.specular[0, 0], texel.diffuse[0, 0]]
    return " | ".join(" ".join(f"{value:.3g}" for value in part) for part in parts)


def _texel(level: Svbrdf, column: int, row: int) -> Svbrdf:
    arrays = {name: array[row : row + 1, column : column + 1] for name, array in level.arrays().items()}
    return level.replace(**arrays)


@click.command()
@click.option(
    "--materials", type=click.Path(path_type=Path), default=ROOT.parent / "shared" / "materials", show_default=True
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=Path("bench/seen"),
    show_default=True,
    help="Where the references of python -m benchmarks.seen are kept.",
)
@click.option("--set", "names", multiple=True, required=True, help="With a --view each.")
@click.option("--view", "keys", multiple=True, required=True)
@click.option("--texels", default=3, show_default=True)
@click.option("--evaluations", default=1500, show_default=True)
def main(
    materials: Path, output: Path, names: tuple[str, ...], keys: tuple[str, ...], texels: int, evaluations: int
) -> None:
    """Print the table of each set and view."""
    rows: list[dict[str, object]] = []
    for name, key in zip(names, keys, strict=True):
        bench = Bench(name, every_set(materials)[name], output, None)
        rows += measure(bench, key, texels, evaluations, tell=lambda text: click.echo(text, err=True))
    click.echo("\n".join(table(rows)))


if __name__ == "__main__":
    main()
