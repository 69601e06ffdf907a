"""All filters on the same environments: error and time, the paper's tables beside ours, errors of engines' look-ups."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.files.atomic import first_other, replacing
from brdffit.machine import core_count
from brdffit.probes.cmgen import beside_cmgen, installed
from brdffit.probes.compare_page import page
from brdffit.probes.curves import get_curve
from brdffit.probes.direct import packed_source
from brdffit.probes.filtering import Exact, FilterOptions, LevelRequest, filter_levels, level_requests
from brdffit.probes.harmonics import truncation_error
from brdffit.probes.importance import preimage_errors
from brdffit.probes.lookup import fitted_to_lookup, lookup_errors
from brdffit.probes.published import TABLE_1, TABLE_1_SAMPLES, TABLE_3, TABLE_3_ORDERS
from brdffit.probes.reading import as_cube, read_surroundings
from brdffit.probes.report_pictures import draw_front, draw_histories, draw_levels, draw_point_responses
from brdffit.probes.seams import seam_ratios
from brdffit.probes.shelf import named_environments
from brdffit.probes.split_sum import split_errors
from brdffit.probes.table_files import LEVELS, load_table, shipped_tables
from brdffit.probes.table_fit import chosen_texels
from brdffit.probes.tables import BASE_SIZE, Goal
from brdffit.probes.tree import Tree

#: (curve, levels) of the engines whose look-up is measured.
_LOOKUPS = (("activision", 7), ("quadratic", 7), ("quadratic", 5), ("linear", 7), ("unity", 7), ("unreal", 8))
_FILES = ("index.html", "records.json", "front.png", "points.png", "searches.png")


def compare_to_folder(
    sources: Sequence[Path], output: Path, quick: bool, threads: int | None, tell: Callable[[str], None]
) -> Path:
    """Measure everything on every environment and write index.html, records.json and pictures; returns the page.

    Raises:
        InputError: when an environment cannot be used.
        OutputError: when the folder cannot be written.
    """
    threads = threads or core_count()
    paths = named_environments(sources)
    cubes = {name: as_cube(read_surroundings(path), BASE_SIZE, threads=threads) for name, path in paths.items()}
    with replacing(output, _foreign) as folder:
        records: dict[str, Any] = {"brdffit": version("brdffit"), "environments": list(cubes), "quick": quick}
        records["preimages"] = preimage_tables(24 if quick else 96, tell)
        records |= {"methods": [], "seams": [], "lookup": []}
        for name, cube in cubes.items():
            tell(f"{name}: methods")
            records["methods"] += measure_methods(name, cube, threads, 64 if quick else 256)
            tell(f"{name}: seams")
            records["seams"].append(measure_seams(name, cube, threads, 3 if quick else 8))
            tell(f"{name}: look-ups")
            records["lookup"] += measure_lookups(name, cube, threads, 300 if quick else 1500)
            draw_levels(cube, folder / f"levels-{name}.png", threads)
        records["cmgen"] = _beside_cmgen([*paths.values()], threads, 64 if quick else 256, tell)
        records["split_sum"] = split_errors(list(cubes.values()), 200 if quick else 1000, threads)
        draw_front(records["methods"], folder / "front.png")
        draw_point_responses(folder / "points.png")
        draw_histories([load_table(name) for name in shipped_tables()], folder / "searches.png")
        (folder / "records.json").write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")
        (folder / "index.html").write_text(page(records), encoding="utf-8")
    return output / "index.html"


def _beside_cmgen(paths: Sequence[Path], threads: int, count: int, tell: Callable[[str], None]) -> list[dict[str, Any]]:
    """Records of cmgen and brdffit on each lat-long picture; none where cmgen is not installed."""
    if not installed():
        tell("cmgen is not on the PATH (Debian: libfilament-tools): no row of it.")
        return []
    records = []
    for path in paths:
        tell(f"{path.stem}: cmgen")
        try:
            records.append(beside_cmgen(path, 0.005, threads, count))
        except InputError as error:
            tell(f"{path.stem}: {error}")
    return records


def _foreign(folder: Path) -> str | None:
    ours = {*_FILES, *(each.name for each in folder.glob("levels-*.png"))}
    return first_other(folder, ours)


def preimage_tables(count: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """The quantities of the paper's tables 1 to 3 for our tables: L1 of preimages on ``count`` texels of each level."""
    alphas = get_curve("activision", LEVELS, BASE_SIZE).alphas()

    @cache
    def goal(n: int, alpha: float) -> Goal:
        texels, shares = chosen_texels(n, "none", count, 2024)
        return Goal.of(texels, alpha, shares)

    out: dict[str, Any] = {"tables": [], "importance": [], "harmonics": [], "irradiance": []}
    for table in map(load_table, shipped_tables()):
        tell(f"preimages of {table.name}")
        is_irradiance = table.curve == "irradiance"
        errors = {
            number: goal(level.size, 1.0 if is_irradiance else alphas[number]).error(level.table)
            for number, level in sorted(table.levels.items())
        }
        mean, key = float(np.mean(list(errors.values()))), (table.terms, table.taps)
        if is_irradiance:
            out["irradiance"].append({"table": table.name, "error": mean, "paper": TABLE_3.get(key)})
            continue
        out["tables"].append(
            {
                "table": table.name,
                "levels": {str(number): error for number, error in errors.items()},
                "mean": mean if table.is_whole else None,
                "paper": TABLE_1.get(key),
                "seconds": sum(level.seconds for level in table.levels.values()),
            }
        )
    for samples, printed in TABLE_1_SAMPLES.items():
        tell(f"preimages of importance sampling, {samples} samples")
        levels = {
            str(level): float(preimage_errors(goal(BASE_SIZE >> level, alphas[level]), alphas[level], samples).mean())
            for level in range(1, LEVELS)
        }
        mean = float(np.mean(list(levels.values())))
        out["importance"].append({"samples": samples, "levels": levels, "mean": mean, "paper": printed})
    for order, printed in TABLE_3_ORDERS.items():
        out["harmonics"].append({"order": order, "error": truncation_error(order), "paper": printed})
    return out


def _methods() -> list[tuple[str, FilterOptions]]:
    """Names and options of what is compared."""
    out = [(f"tree {tolerance:g}", FilterOptions("tree", tolerance)) for tolerance in (0.02, 0.005, 0.001)]
    for table in map(load_table, shipped_tables()):
        if table.is_whole:
            out.append((table.name, FilterOptions("table", tables=table.tables)))
            out.append((f"{table.name}, split 10", FilterOptions("table", tables=table.tables, split=10.0)))
    for samples in (32, 128, 1024):
        out.append((f"importance {samples}", FilterOptions("importance", samples=samples)))
    out.append(("importance 128, split 10", FilterOptions("importance", samples=128, split=10.0)))
    return out


def measure_methods(name: str, cube: NDArray, threads: int, count: int) -> list[dict[str, Any]]:
    """Error and processor seconds of every method on levels 1 to 6 of one environment, one record a method.

    The first record is brute force; its seconds are extrapolated from ``count`` texels of each level.
    """
    curve = get_curve("activision", LEVELS, BASE_SIZE)
    requests = level_requests(curve, BASE_SIZE, BASE_SIZE, keep_narrow=True)[1:]
    source, exact, seconds = packed_source(cube), [], 0.0
    for request in requests:
        began = time.process_time()
        exact.append(Exact(source, request, threads, count))
        seconds += (time.process_time() - began) * 6 * request.n**2 / len(exact[-1].radiance)
    records = [{"environment": name, "method": "brute force", "error": 0.0, "worst": 0.0, "seconds": seconds}]
    for method, options in _methods():
        options = replace(options, threads=threads)
        # The first run of a method may compile.
        filter_levels(cube, [LevelRequest(6, 2, 1.0, 1.0)], options, measure=False)
        began = time.process_time()
        levels = filter_levels(cube, requests, options, measure=False)
        spent = time.process_time() - began
        errors, worst = [], []
        for known, level in zip(exact, levels, strict=True):
            distance = np.abs(known.found(level.radiance) - known.radiance).sum(axis=1)
            wanted = known.radiance.sum(axis=1)
            errors.append(float(distance.sum() / wanted.sum()))
            worst.append(float(np.percentile(distance / np.maximum(wanted, 1e-12), 99.0)))
        records.append(
            {
                "environment": name,
                "method": method,
                "error": float(np.mean(errors)),
                "worst": float(np.max(worst)),
                "seconds": spent,
                "levels": [round(each, 6) for each in errors],
            }
        )
    return records


def measure_seams(name: str, cube: NDArray, threads: int, turns: int) -> dict[str, Any]:
    """``seams.seam_ratios`` of the tree: of the environment as it stands, and summed over ``turns`` rotations."""
    curve, levels = get_curve("activision", LEVELS, BASE_SIZE), (3, 4, 5)
    requests = [level_requests(curve, BASE_SIZE, BASE_SIZE, keep_narrow=True)[level] for level in levels]
    options = FilterOptions("tree", 0.005, threads=threads)
    upright, turned = (seam_ratios(cube, requests, options, count) for count in (1, turns))
    return {
        "environment": name,
        "turns": turns,
        "levels": levels,
        "upright": [*upright.values()],
        "turned": [*turned.values()],
    }


def measure_lookups(name: str, cube: NDArray, threads: int, count: int) -> list[dict[str, Any]]:
    """Error of each engine's look-up on levels filtered to 0.003, and of Filament's after the fit to the look-up."""
    tree = Tree(cube)
    records = []
    for curve_name, levels in _LOOKUPS:
        curve = get_curve(curve_name, levels, BASE_SIZE)
        requests = level_requests(curve, BASE_SIZE, BASE_SIZE)
        made = [each.radiance for each in filter_levels(cube, requests, FilterOptions(tolerance=0.003), measure=False)]
        error = float(lookup_errors(tree, made, curve, threads, count).mean())
        record = {"environment": name, "curve": curve_name, "levels": levels, "error": error}
        if (curve_name, levels) == ("quadratic", 7):
            record["fitted"] = fitted_to_lookup(cube, made, curve, threads)[2]
        records.append(record)
    return records
