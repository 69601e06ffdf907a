"""How close the fit comes to the best single lobe there is, and how far ahead of the closed forms it is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.materials import NAMED, accuracy_sets, load_any
from benchmarks.record import Section, Target
from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample, Lobes
from brdffit.halfangle.apparent_lobe import base_of
from brdffit.halfangle.measure import lobe_parameters, random_texels, snr
from brdffit.methods import get_method
from brdffit.svbrdf import Svbrdf, level_sizes

ORACLE_GAP, MARGIN = 0.1, 2.5
CLOSED_FORMS = ("naive", "toksvig", "vmf", "lean", "filament", "godot")
LEVELS = 6
_THREADS = 2
# Baking a closed form and measuring it round differently; figures this close (dB) count as equal.
_EQUAL = 0.005


def measure_accuracy(
    materials: Path, quick: bool, save: Callable[[Section], object] = lambda _: None, only: tuple[str, ...] = ()
) -> Section:
    """SNR in dB of every method and of the oracle, on random texels of every level of every set.

    ``save`` is called after each set with the section so far, since a full run takes long. ``only``: names of sets, or
    none for all.
    """
    texels = 60 if quick else 200
    section = Section(
        "accuracy",
        "Accuracy",
        f"Half-angle SNR in dB of levels 0 to {LEVELS - 1}, box filter, GGX, {texels} random texels a level (all where "
        "there are fewer), cosine-distributed l and v, against the filtered, bilinearly reconstructed base, by a rule "
        "that neither the fit nor the oracle uses. Held: specular is the filtered colour; oracle: scale free. Gap: "
        "oracle - fit. Margin: fit - the better of vMF and LEAN.",
    )
    for name, path in accuracy_sets(materials, quick).items():
        if only and name not in only:
            continue
        svbrdf = load_any(name, path)
        if isinstance(svbrdf, str):
            section.problems.append(f"{name}: {svbrdf}")
            continue
        section.rows += compare_set(name, svbrdf, texels, ("standard",) if quick else ("draft", "standard", "fine"))
        section.targets = targets(section.rows)
        save(section)
    return section


def compare_set(name: str, svbrdf: Svbrdf, texels: int, qualities: tuple[str, ...], levels: int = LEVELS) -> list[dict]:
    """One row a level."""
    base = base_of(svbrdf)
    sizes = level_sizes(svbrdf.size, levels)
    closed = {
        each: get_method(each).bake_lobes(svbrdf, FitOptions(lights="point", levels=levels)) for each in CLOSED_FORMS
    }
    rows = []
    for mip_level, size in enumerate(sizes):
        at = random_texels(size, texels, seed=1000 + mip_level)
        sample = LevelSample(svbrdf, mip_level, *at, base=base, threads=_THREADS)
        lobes: dict[str, Lobes] = {}
        for each, pyramid in closed.items():
            version = pyramid[mip_level].svbrdf
            lobes[each] = Lobes(lobe_parameters(version, *at), version.specular[at[1], at[0]].astype(np.float64))
        for quality in qualities:
            lobes[quality] = sample.fit(FitOptions(lights="point", quality=quality))[0]
        lobes["held"] = sample.fit(FitOptions(lights="point", specular="held"))[0]
        lobes["oracle"] = sample.best([lobes[quality] for quality in qualities])
        error = sample.measure(list(lobes.values())).error
        figures = {name: min(snr(error[k]), 99.0) for k, name in enumerate(lobes)}
        rival = max(figures["vmf"], figures["lean"])
        rows.append(
            {"set": name, "level": mip_level, "texels": len(at[0])}
            | figures
            | {"gap": figures["oracle"] - figures["standard"], "margin": figures["standard"] - rival}
        )
    return rows


def targets(rows: list[dict]) -> list[Target]:
    """The project's targets, each with the worst measured case."""
    if not rows:
        return []
    where = "{set}, level {level}".format
    far = max(rows, key=lambda row: row["gap"])
    missed = sum(row["gap"] > ORACLE_GAP for row in rows)
    ahead = [(row["standard"] - max(row[each] for each in CLOSED_FORMS), row) for row in rows]
    least, behind = min(ahead, key=lambda pair: pair[0])
    below = sum(lead < -_EQUAL for lead, _ in ahead)
    named = [row["margin"] for row in rows if row["set"] in NAMED and 1 <= row["level"] <= 5]
    complete = {row["set"] for row in rows} >= set(NAMED)
    margin = float(np.mean(named)) if named else float("nan")
    sets = f"{len({row['set'] for row in rows} & set(NAMED))} of {len(NAMED)} sets"
    mean_gap = float(np.mean([row["gap"] for row in rows]))
    return [
        Target(
            "gap to the oracle on every set and level, dB", f"<= {ORACLE_GAP}",
            f"worst {far['gap']:.2f} ({where(**far)}), mean {mean_gap:.3f}, missed on {missed} of {len(rows)}",
            missed == 0,
        ),
        Target(
            "lead over the best closed form on every set and level, dB", ">= 0",
            f"least {least:.2f} ({where(**behind)}), behind on {below} of {len(rows)}", below == 0,
        ),
        Target(
            "mean margin over the better of vMF and LEAN, levels 1 to 5, dB", f">= {MARGIN}",
            f"{margin:.2f} ({sets})" if named else "none of the named sets",
            (margin >= MARGIN) if named and complete else (None if not named or margin >= MARGIN else False),
        ),
    ]  # fmt: skip


def means(rows: list[dict]) -> list[dict]:
    """One row a set: the mean of each figure over levels 1 to 5."""
    found = []
    for name in dict.fromkeys(row["set"] for row in rows):
        own = [row for row in rows if row["set"] == name and 1 <= row["level"] <= 5]
        keys = [key for key in own[0] if key not in ("set", "level", "texels")] if own else []
        found.append({"set": name} | {key: float(np.mean([row[key] for row in own])) for key in keys})
    return found


def with_means(section: Section) -> Section:
    """A second section: the means of each set."""
    return dataclasses.replace(
        section, name="accuracy-means", title="Accuracy, mean of levels 1 to 5", rows=means(section.rows), targets=[],
        problems=[], note="The table above, averaged over levels in dB.", seconds=0.0,
    )  # fmt: skip
