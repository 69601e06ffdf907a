"""Visible errors: candidates for the fit's default against the closed forms, in every still view of every set.

    python -m benchmarks.seen [-o FOLDER] [--column "bfgs loss=relative"] [--set NAME] [--anew] [--summary]

A column is a method with options. Everything is measured on the crop of 256 x 256 texels of ``materials.crop``, with
the pictures of ``brdffit compare --quick``; the reference of a set is rendered once and kept. Each set and column has a
record of its own in FOLDER (SET/COLUMN.json, displayed pictures beside it), so a run that was cut off continues where
it ended, and a new candidate costs only its own column. The summary covers all records in the folder: summary.md holds
the table and the losing views; worst.png shows the views in which the first column is furthest behind, beside the
reference, averaging, LEAN and vMF.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
from functools import cached_property
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from benchmarks.materials import crop, every_set
from benchmarks.record import ROOT, as_markdown, machine
from benchmarks.seen_summary import figures_table, summary
from brdffit.assessment import assess
from brdffit.comparison.surroundings import read_environment
from brdffit.comparison.views import Still, Studio, still_views
from brdffit.methods import Material, Method, get_method
from brdffit.options import BakeOptions, make_options, parse_settings
from brdffit.pipeline import Phases, ReadSet, run
from brdffit.render import lights, metrics
from brdffit.render.reference import Reference
from brdffit.svbrdf import Svbrdf, level_sizes

COLUMNS = ("bfgs", "bfgs loss=relative", "bfgs lights=point", "naive", "toksvig", "vmf", "lean")
"""The first is the default that is judged."""
#: Side of the pictures in pixels; two thirds of it under lights with a size.
_PIXELS = 96
#: Views shown in worst.png.
_WORST = 12


class Bench:
    """One set: its crop, its references (kept on disk), and the columns of its table."""

    def __init__(self, name: str, path: Path | None, folder: Path, threads: int | None) -> None:
        self.name, self.folder, self.threads = name, folder / name, threads
        self.base = crop(name, path).over_black()
        self.studio = Studio(
            pixels=_PIXELS, frames=1, samples="draft", environment=read_environment(None), lights=lights.few(),
            threads=threads,
        )  # fmt: skip
        self.views = still_views(self.base.size, len(level_sizes(self.base.size)), self.studio)

    @cached_property
    def references(self) -> dict[str, Reference]:
        """The reference picture of each view, read from disk if it is there."""
        path = self.folder / "references.npz"
        digest = _digest(self.base)
        if path.is_file():
            with np.load(path) as kept:
                if str(kept["digest"]) == digest:
                    return {view.key: Reference(kept[view.key].mean(axis=0), kept[view.key]) for view in self.views}
        found = {view.key: self.studio.reference(self.base, view.scene, view.lit) for view in self.views}
        self.folder.mkdir(parents=True, exist_ok=True)
        halves: dict[str, Any] = {key: each.halves for key, each in found.items()}
        np.savez(path, digest=digest, **halves)
        save_pictures(self.folder / "reference.npz", {k: _displayed(v.radiance, v) for k, v in found.items()})
        return found

    def measure(self, column: str) -> dict[str, Any]:
        """A column's record: figures of each view, energy of each level, seconds of the fit."""
        method, options = as_asked(column)
        phases, material = Phases(), Material(self.base)
        baked = run(ReadSet(self.name, material), method, options, phases)
        pictures, views = {}, {}
        for view in self.views:
            views[view.key], pictures[view.key] = self._figures(baked.appearance, view)
        save_pictures(self.folder / f"{slug(column)}.npz", pictures)
        energy = [level["energy_kept"] for level in assess(material, baked) if level]
        return {
            "set": self.name, "column": column, "seconds": round(phases.seconds["fitting"], 2), "energy": energy,
            "views": views, "machine": machine(),
        }  # fmt: skip

    def _figures(self, appearance: Any, view: Still) -> tuple[dict[str, float], NDArray]:
        reference = self.references[view.key]
        halves = self.studio.method(appearance, view.scene, view.lit)
        picture = halves.mean(axis=0)
        shown, truth = _displayed(picture, reference), _displayed(reference.radiance, reference)
        snr = metrics.snr_db_of_halves(halves, reference.halves)
        return {
            "snr": float(np.clip(np.nan_to_num(snr, nan=-99.0), -99.0, 99.0)),
            "flip": metrics.flip_ldr(shown, truth),
            "ssim": metrics.ssim(shown, truth),
            "energy": metrics.energy_kept(picture, reference.radiance),
            "displayed": float(np.abs(shown - truth).mean()),
        }, shown

    def run(self, columns: tuple[str, ...], anew: bool) -> None:
        """Measure the columns that are not on disk, or all if ``anew``."""
        todo = [c for c in columns if anew or not (self.folder / f"{slug(c)}.json").is_file()]
        if not todo:
            return
        for column in todo:
            start = time.perf_counter()
            record = self.measure(column)
            (self.folder / f"{slug(column)}.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
            click.echo(f"{self.name}: {column}, {time.perf_counter() - start:.0f} s", err=True)


def slug(column: str) -> str:
    """The name of a column's file."""
    return re.sub(r"[^a-z0-9.,:]+", "-", column.lower()).replace(":", "_")


def save_pictures(path: Path, pictures: dict[str, NDArray]) -> None:
    """Save displayed pictures as uint8, by view."""
    shown: dict[str, Any] = {k: np.rint(255.0 * np.nan_to_num(p)).astype(np.uint8) for k, p in pictures.items()}
    np.savez_compressed(path, **shown)


def read_records(folder: Path) -> list[dict[str, Any]]:
    """All records in a folder."""
    return [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*/*.json"))]


def draw_worst(folder: Path, losing: list[dict[str, Any]], columns: list[str], path: Path, most: int = _WORST) -> None:
    """Draw losing views, one row each: the reference and every column, under a line of text."""
    rows = []
    for each in losing[:most]:
        names = ["reference", *columns]
        tiles = []
        for name in names:
            with np.load(folder / each["set"] / f"{slug(name)}.npz") as kept:
                tiles.append(Image.fromarray(kept[each["view"]]).resize((192, 192), Image.Resampling.NEAREST))
        row = Image.new("RGB", (196 * len(names), 212))
        ImageDraw.Draw(row).text((2, 0), f"{each['set']}, {each['view']}: " + ", ".join(names), fill="white")
        for i, tile in enumerate(tiles):
            row.paste(tile, (196 * i, 16))
        rows.append(row)
    if rows:
        sheet = Image.new("RGB", (rows[0].width, 212 * len(rows)))
        for i, row in enumerate(rows):
            sheet.paste(row, (0, 212 * i))
        sheet.save(path)


def as_asked(column: str) -> tuple[Method, BakeOptions]:
    """The method of a column and its options: "bfgs loss=relative"."""
    name, *words = column.split()
    method = get_method(name)
    return method, make_options(method.options, parse_settings(words), f"'{name}'")


def _displayed(picture: NDArray, reference: Reference) -> NDArray:
    return metrics.tone_map(picture, metrics.exposure_of(reference.radiance))


def _digest(base: Svbrdf) -> str:
    digest = hashlib.sha256()
    for name, array in sorted(base.arrays().items()):
        digest.update(name.encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


@click.command()
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("bench/seen"), show_default=True)
@click.option(
    "--materials",
    type=click.Path(path_type=Path),
    default=ROOT.parent / "shared" / "materials",
    show_default=True,
    help="Folder of real texture sets; the shipped ones are always measured.",
)
@click.option("--column", "columns", multiple=True, help="These columns alone; the first is the one that is judged.")
@click.option("--set", "names", multiple=True, help="These sets alone.")
@click.option("--anew", is_flag=True, help="Measure columns again that are on disk.")
@click.option("--summary", "only_summary", is_flag=True, help="Measure nothing.")
@click.option("--threads", type=int, default=None)
def main(
    output: Path,
    materials: Path,
    columns: tuple[str, ...],
    names: tuple[str, ...],
    anew: bool,
    only_summary: bool,
    threads: int | None,
) -> None:
    """Measure what is not on disk, then write summary.md and worst.png."""
    for name, path in {} if only_summary else every_set(materials).items():
        if not names or name in names:
            Bench(name, path, output, threads).run(columns or COLUMNS, anew)
    records = read_records(output)
    judged = columns[0] if columns else COLUMNS[0]
    section, losing = summary(records, judged)
    text = as_markdown(machine(), [section]) + "\n" + "\n".join(figures_table(losing)) + "\n"
    (output / "summary.md").write_text(text, encoding="utf-8")
    shown = [judged, *(c for c in ("naive", "lean", "vmf") if any(r["column"] == c for r in records))]
    draw_worst(output, losing, shown, output / "worst.png")
    click.echo(text)


if __name__ == "__main__":
    main()
