"""The best single lobe in a view where the fit stays behind: is the lobe at fault, or the fit?

    python -m benchmarks.best_lobe --set coarse-sand --view far-environment [--texels 3] [--evaluations 1500]
    python -m benchmarks.best_lobe --losing [--texels 2] [--evaluations 400]

A few random texels of the view's level are drawn, each as a patch: every pixel of the patch has the texel's footprint
and is seen from a direction of the view's picture. The patch is rendered by the reference, with the texel as each
method bakes it, and with lobes that Nelder and Mead's search (1965) finds for a single figure, started from the
methods' texels:

- SNR: the squared error of radiance, without the reference's noise;
- displayed: the mean absolute difference of tone-mapped pixels at the view's own exposure, which FLIP follows.

The lobe is free: normal, roughness tensor, specular and diffuse colour. Where the search for a figure finds nothing
better than the best closed form, a single lobe can do no better and the fit is not at fault.

``--losing`` takes every view in which the fit is more than 1 dB behind in the records of ``benchmarks.seen``, and gives
a verdict on each, in the texels of twelve random ones in which it is furthest behind. A closed form is a single lobe
too, so one that is ahead in a view proves little: a bake has one lobe for all views of a level. So a third search
maximises the mean dB over all views of that level. If that lobe is also more than 1 dB behind the closed form in this
view, the views ask for different lobes, and the lobe is at fault; else the fit.

A slanted plane and a sphere show many texels of several levels, which no search of texels answers for. There whole
pyramids are tried that lie between the fit's and that of the closed form that is ahead: normals, log tensors and
colours are mixed. The best of them in this view, and the best for all views by the same light, take the places of the
best lobes; they are a lower bound of what lobes could do.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from benchmarks.materials import every_set
from benchmarks.record import ROOT, table
from benchmarks.seen import Bench, as_asked, read_records
from benchmarks.seen_summary import summary
from brdffit.comparison.views import Still
from brdffit.halfangle.measure import random_texels
from brdffit.methods import Material
from brdffit.pipeline import Phases, ReadSet, run
from brdffit.render import metrics
from brdffit.render.reference import Reference
from brdffit.render.scenes import Scene
from brdffit.svbrdf import Svbrdf, level_sizes, unit_or_up

#: Side of a patch in pixels.
_SIDE = 14
#: Relative squared error that is invisible: 40 dB.
_SEEN = 1e-4
#: Random texels of a level, of which those are judged in which the fit is furthest behind.
_DRAWN = 12
_COLUMNS = ("bfgs", "naive", "toksvig", "vmf", "lean")
#: Shares of the closed form in the pyramids between it and the fit.
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
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
        whole = bench.references[view.key].radiance
        self.exposure = metrics.exposure_of(whole)
        self.truth = metrics.tone_map(self.reference.radiance, self.exposure)

    def errors(self, texel: Svbrdf) -> tuple[float, float]:
        """(relative squared error of radiance, mean absolute difference of displayed pixels) of a (1, 1) image."""
        halves = self.bench.studio.method([texel], self.scene, self.view.lit)
        squared = 10.0 ** (-0.1 * metrics.snr_db_of_halves(halves, self.reference.halves))
        shown = metrics.tone_map(halves.mean(axis=0), self.exposure)
        return float(squared), float(np.abs(shown - self.truth).mean())

    def decibels(self, texel: Svbrdf) -> float:
        """SNR of a (1, 1) image, at most 40 dB."""
        return min(-10.0 * float(np.log10(max(self.errors(texel)[0], _SEEN))), 40.0)


def best(error: Callable[[Svbrdf], float], starts: list[Svbrdf], evaluations: int) -> Svbrdf:
    """The texel of the least error: the search runs from the best start, then from its own end."""
    start = min(starts, key=error)
    theta = parameters(start)

    def error_at(at: NDArray) -> float:
        found = error(texel_of(at, start))
        return found if np.isfinite(found) else 1e9

    for _ in range(2):
        options = {
            "initial_simplex": np.vstack([theta, theta + np.diag(_STEPS)]), "maxfev": evaluations // 2,
            "adaptive": True,
        }  # fmt: skip
        theta = minimize(error_at, theta, method="Nelder-Mead", options=options).x
    return min(texel_of(theta, start), start, key=error)


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
    pyramids = {column: each[level] for column, each in baked_levels(bench, columns).items()}
    names = [*columns, "best for SNR", "best displayed"]
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    for column, row in zip(*random_texels(level_sizes(bench.base.size)[level], texels, seed=1), strict=True):
        patch = Patch(bench, view, level, int(column), int(row))
        own = {name: _texel(each, int(column), int(row)) for name, each in pyramids.items()}
        for name, texel in own.items():
            found[name].append(patch.errors(texel))
        for figure, name in enumerate(names[-2:]):
            texel = best(lambda at, patch=patch, k=figure: patch.errors(at)[k], list(own.values()), evaluations)  # type: ignore[misc]
            found[name].append(patch.errors(texel))
            where = f"{bench.name}, {key}, texel ({column}, {row})"
            tell(f"{where}, {name}: {described(texel)}; {columns[0]}: {described(own[columns[0]])}")
    return [
        {
            "set": bench.name, "view": key, "lobe": name,
            "SNR": -10.0 * float(np.log10(max(np.mean([squared for squared, _ in each]), _SEEN))),
            "displayed": float(np.mean([shown for _, shown in each])),
        }
        for name, each in found.items()
    ]  # fmt: skip


def baked_levels(bench: Bench, columns: tuple[str, ...]) -> dict[str, list[Svbrdf]]:
    """The levels of each column."""
    found = {}
    for column in columns:
        method, options = as_asked(column)
        baked = run(ReadSet(bench.name, Material(bench.base)), method, options, Phases())
        assert baked.lobes is not None
        found[column] = [level.svbrdf for level in baked.lobes.levels]
    return found


def judge(
    bench: Bench, keys: list[str], texels: int, evaluations: int, columns: tuple[str, ...] = _COLUMNS
) -> Iterator[dict[str, object]]:
    """Yield one row a view of a set: the fit, the best closed form, the best lobe, that of all views; the verdict."""
    pyramids = baked_levels(bench, columns)
    for distance in dict.fromkeys(view.distance for view in bench.views if view.key in keys and view.distance):
        views = [view for view in bench.views if view.distance == distance]
        level = int(views[0].level or 0)
        size = level_sizes(bench.base.size)[level]
        names = (*columns, "best lobe", "of all views")
        found: dict[str, dict[str, list[float]]] = {view.key: {name: [] for name in names} for view in views}
        drawn = []
        for column, row in np.stack(random_texels(size, _DRAWN, seed=1), axis=1).tolist():
            patches = {view.key: Patch(bench, view, level, column, row) for view in views}
            own = {name: _texel(each[level], column, row) for name, each in pyramids.items()}
            behind = 0.0
            for key in (key for key in patches if key in keys):
                dB = {name: patches[key].decibels(texel) for name, texel in own.items()}
                behind += max(dB[name] for name in columns[1:]) - dB[columns[0]]
            drawn.append((behind, patches, own))
        drawn.sort(key=lambda each: -each[0])
        for _, patches, own in drawn[:texels]:
            starts = list(own.values())
            of_all = best(
                lambda at, patches=patches: -sum(each.decibels(at) for each in patches.values()),  # type: ignore[misc]
                starts, evaluations,
            )  # fmt: skip
            for key in (key for key in patches if key in keys):
                patch = patches[key]
                lobe = best(lambda at, patch=patch: -patch.decibels(at), [*starts, of_all], evaluations)  # type: ignore[misc]
                for name, texel in {**own, "best lobe": lobe, "of all views": of_all}.items():
                    found[key][name].append(patch.decibels(texel))
        for key in (view.key for view in views if view.key in keys):
            yield _verdict(bench, key, {name: float(np.mean(each)) for name, each in found[key].items()}, columns)
    several = [view for view in bench.views if view.key in keys and not view.distance]
    yield from (_between(bench, view, pyramids, columns) for view in several)


def _verdict(bench: Bench, key: str, figures: dict[str, float], columns: tuple[str, ...]) -> dict[str, object]:
    """The row of a view, by the dB of each column, "best lobe" and "of all views"."""
    ahead = max(columns[1:], key=lambda name: figures[name])
    if figures[columns[0]] >= figures[ahead] - 1.0:
        verdict = "not behind here"
    else:
        verdict = "fit" if figures["of all views"] >= figures[ahead] - 1.0 else "lobe"
    return {
        "set": bench.name, "view": key, "fit": figures[columns[0]],
        "best closed form": f"{figures[ahead]:.1f} ({ahead})", "best lobe": figures["best lobe"],
        "best lobe of all views": figures["of all views"], "at fault": verdict,
    }  # fmt: skip


def _between(
    bench: Bench, view: Still, pyramids: dict[str, list[Svbrdf]], columns: tuple[str, ...]
) -> dict[str, object]:
    """The row of a view of several levels, with pyramids between the fit's and the best closed form's as lobes."""

    def decibels(levels: list[Svbrdf], seen: Still) -> float:
        halves = bench.studio.method(levels, seen.scene, seen.lit)
        return min(metrics.snr_db_of_halves(halves, bench.references[seen.key].halves), 40.0)

    figures = {name: decibels(pyramids[name], view) for name in columns}
    ahead = max(columns[1:], key=lambda name: figures[name])
    others = [each for each in bench.views if each.lit == view.lit and each.key != view.key]
    tried = []
    for share in _SHARES:
        levels = [mixed(*pair, share) for pair in zip(pyramids[columns[0]], pyramids[ahead], strict=True)]
        own = decibels(levels, view)
        tried.append((own, own + sum(decibels(levels, each) for each in others)))
    figures["best lobe"] = max(own for own, _ in tried)
    figures["of all views"] = max(tried, key=lambda each: each[1])[0]
    return _verdict(bench, view.key, figures, columns)


def mixed(one: Svbrdf, other: Svbrdf, share: float) -> Svbrdf:
    """The level between two of the same size, ``share`` of it ``other``: of normals, log tensors and colours."""
    names = ("normal", "log_roughness", "specular", "diffuse")
    arrays = {name: (1.0 - share) * getattr(one, name) + share * getattr(other, name) for name in names}
    arrays["normal"] = unit_or_up(arrays["normal"])
    return one.replace(**{name: each.astype(np.float32) for name, each in arrays.items()})


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
@click.option("--set", "names", multiple=True, help="With a --view each.")
@click.option("--view", "keys", multiple=True)
@click.option("--losing", is_flag=True, help="Every view in which the fit is behind; --set names some sets alone.")
@click.option("--texels", default=3, show_default=True)
@click.option("--evaluations", default=1500, show_default=True)
def main(
    materials: Path, output: Path, names: tuple[str, ...], keys: tuple[str, ...], losing: bool, texels: int,
    evaluations: int,
) -> None:  # fmt: skip
    """Print the table of each set and view."""
    rows: list[dict[str, object]] = []
    if losing:
        _, views = summary(read_records(output), _COLUMNS[0])
        behind = [each for each in views if "1 dB behind" in each["behind in"]]
        for name in dict.fromkeys(each["set"] for each in behind if not names or each["set"] in names):
            bench = Bench(name, every_set(materials)[name], output, None)
            for found in judge(bench, [each["view"] for each in behind if each["set"] == name], texels, evaluations):
                click.echo(str(found), err=True)
                rows.append(found)
        click.echo("\n".join(table(rows)))
        return
    for name, key in zip(names, keys, strict=True):
        bench = Bench(name, every_set(materials)[name], output, None)
        rows += measure(bench, key, texels, evaluations, tell=lambda text: click.echo(text, err=True))
    click.echo("\n".join(table(rows)))


if __name__ == "__main__":
    main()
