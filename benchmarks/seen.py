"""What the eye sees: candidates for the default of the fit against the closed forms, in every view of every set.

The table that the default was chosen from, losers included. Pictures and figures are those of ``brdffit compare``.
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np

from benchmarks.materials import QUICK_SETS, real_sets
from benchmarks.record import ROOT, Section, Target
from brdffit.comparison.ask import Ask
from brdffit.comparison.compare import compare
from brdffit.report.records import Figures, SetResult

FIT = "bfgs"
CLOSED = ("lean", "vmf", "toksvig", "naive")
#: What was tried, by the words that ``brdffit compare --methods bfgs+WORD`` takes.
CANDIDATES = (
    FIT, "bfgs+point", "bfgs+point+held", "bfgs+l2", "bfgs+l2+free", "bfgs+l2+held", "bfgs+held", "bfgs+relative",
    "bfgs+lamps", "bfgs+lamps+l2", "bfgs+energy",
)  # fmt: skip
_SHARE, _FLIP_SHARE, _AHEAD_OF_AVERAGES = 0.9, 0.95, 0.75
#: SNR beyond which nobody sees a difference, and the slack of a figure that counts as no worse.
_PERFECT_DB, _SLACK_DB, _SLACK_FLIP, _SLACK_SSIM = 40.0, 1.0, 1e-3, 2e-3
_ENERGY = (0.9, 1.1)


def measure_seen(materials: Path, quick: bool) -> Section:
    """Every candidate and every closed form on the real sets and the shipped ones."""
    section = Section(
        "seen",
        "What is seen",
        "Views of each set under small lights, lamps and an environment: in how many a candidate is first in SNR, more "
        "than 1 dB behind the best closed form (below 40 dB), not behind LEAN, vMF and Toksvig in FLIP and SSIM, and "
        "ahead of averaged maps. Energy is that of levels. The first row is the default.",
    )
    found: list[SetResult] = []
    sources = [*real_sets(materials).values(), *sorted(p for p in (ROOT / "data" / "sets").glob("*") if p.is_dir())]
    ask = Ask.of(methods=[*CANDIDATES, *CLOSED], quick=True)
    for source in sources[:QUICK_SETS] if quick else sources:
        # One at a time: a set's pictures are let go before the next.
        comparison, _ = compare([source], ask)
        found += comparison.sets
    section.problems = [f"{each.name}: {skipped.reason}" for each in found for skipped in each.skipped]
    section.rows = [summarise(found, name) for name in (*CANDIDATES, *CLOSED)]
    if found:
        section.targets = _targets(section.rows[0])
    return section


def summarise(sets: list[SetResult], name: str) -> dict[str, object]:
    """One row: how often a method is first, not behind or ahead, its means, and its worst view."""
    counts: dict[str, int] = defaultdict(int)
    means: dict[str, list[float]] = defaultdict(list)
    worst, worst_view = np.inf, ""
    for each in sets:
        for view in each.views:
            shots = {shot.method: shot.figures for shot in view.shots if shot.figures is not None}
            if name not in shots or not all(other in shots for other in CLOSED):
                continue
            mine, others = shots[name], [shots[other] for other in CLOSED if other != name]
            closed = [shots[other] for other in CLOSED[:3] if other != name]
            _count(counts, mine, others, closed, shots["naive"])
            means["SNR"].append(min(mine.snr_db, _PERFECT_DB))
            means["FLIP"].append(mine.flip_ldr)
            means["SSIM"].append(mine.ssim)
            behind = mine.snr_db - max(other.snr_db for other in others)
            if behind < worst:
                worst, worst_view = behind, f"{each.name}, {view.key}"
    energy = [
        level.energy_kept
        for each in sets
        for method in each.methods
        for level in method.levels
        if method.method == name and level.energy_kept is not None
    ]
    views = counts.pop("views", 0)
    return {
        "method": name, "views": views, **{k: counts[k] for k in ("first", "1 dB behind", "FLIP", "SSIM")},
        "FLIP ahead of averages": counts["averages"],
        **{f"mean {key}": float(np.mean(values)) for key, values in means.items()},
        "least energy": min(energy, default=float("nan")), "most energy": max(energy, default=float("nan")),
        "worst": f"{worst:.1f} dB ({worst_view})",
    }  # fmt: skip


def _count(
    counts: dict[str, int], mine: Figures, others: list[Figures], closed: list[Figures], averages: Figures
) -> None:
    best = max(other.snr_db for other in others)
    counts["views"] += 1
    counts["first"] += mine.snr_db >= best
    counts["1 dB behind"] += best < _PERFECT_DB and mine.snr_db < best - _SLACK_DB
    counts["FLIP"] += mine.flip_ldr <= min(other.flip_ldr for other in closed) + _SLACK_FLIP
    counts["SSIM"] += mine.ssim >= max(other.ssim for other in closed) - _SLACK_SSIM
    counts["averages"] += mine.flip_ldr <= averages.flip_ldr


def _targets(row: dict) -> list[Target]:
    views = max(row["views"], 1)

    def share(name: str, key: str, least: float) -> Target:
        found = row[key] / views
        return Target(name, f">= {least:.0%}", f"{row[key]} of {row['views']}", found >= least)

    low, high = row["least energy"], row["most energy"]
    return [
        share("first in SNR", "first", _SHARE),
        Target("views more than 1 dB behind", "0", str(row["1 dB behind"]), row["1 dB behind"] == 0),
        share("not behind in FLIP", "FLIP", _FLIP_SHARE),
        share("not behind in SSIM", "SSIM", _FLIP_SHARE),
        share("ahead of averaging in FLIP", "FLIP ahead of averages", _AHEAD_OF_AVERAGES),
        Target("energy of every level", "0.9 to 1.1", f"{low:.2f} to {high:.2f}",
               _ENERGY[0] <= low and high <= _ENERGY[1]),
    ]  # fmt: skip
