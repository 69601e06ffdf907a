"""The record of benchmarks: rows, targets met or missed, and the machine, as JSON and as Markdown."""

from __future__ import annotations

import dataclasses
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from brdffit.machine import machine as ran_on

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Target:
    """A target of the project for one figure. ``passed`` is None if it was not measured."""

    name: str
    expected: str
    found: str
    passed: bool | None

    @property
    def verdict(self) -> str:
        """PASS, MISS or "not measured"."""
        return "not measured" if self.passed is None else "PASS" if self.passed else "MISS"


@dataclass
class Section:
    """One concern: what was measured and how, its rows (all with the same keys), its targets."""

    name: str
    title: str
    note: str
    rows: list[dict[str, Any]] = field(default_factory=list)
    targets: list[Target] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    seconds: float = 0.0


def machine() -> dict[str, Any]:
    """Date, commit, machine and versions, for the record."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": _commit(),
        **ran_on(),
    }


def _commit() -> str:
    """Short commit of the checkout, with "+" if files differ from it."""
    try:
        head = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True)
        changed = subprocess.run(
            ["git", "status", "--porcelain", "--untracked-files=no"], cwd=ROOT, capture_output=True, text=True
        )
    except OSError:
        return "unknown"
    return (head.stdout.strip() or "unknown") + ("+" if changed.stdout.strip() else "")


def as_record(about: dict[str, Any], sections: Sequence[Section]) -> dict[str, Any]:
    """The whole record, for JSON."""
    found = []
    for section in sections:
        record = dataclasses.asdict(section)
        record["targets"] = [dataclasses.asdict(t) | {"verdict": t.verdict} for t in section.targets]
        found.append(record)
    return {"machine": about, "sections": found}


def as_markdown(about: dict[str, Any], sections: Sequence[Section]) -> str:
    """The whole record as Markdown; the targets of all sections come last."""
    lines = ["# Benchmarks", "", ", ".join(f"{key} {value}" for key, value in about.items()), ""]
    for section in sections:
        lines += [f"## {section.title}", "", section.note, "", *table(section.rows), ""]
        lines += [f"- {problem}" for problem in section.problems] + ([""] if section.problems else [])
    targets = [
        {"target": t.name, "expected": t.expected, "found": t.found, "": t.verdict} for s in sections for t in s.targets
    ]
    return "\n".join([*lines, "## Targets", "", *table(targets), ""])


def table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Lines of a Markdown table, with numbers aligned to the right."""
    if not rows:
        return ["(nothing measured)"]
    names = list(rows[0])
    cells = [[_cell(row.get(name)) for name in names] for row in rows]
    widths = [max(3, len(name), *(len(line[i]) for line in cells)) for i, name in enumerate(names)]
    right = [any(isinstance(row.get(name), int | float) for row in rows) for name in names]
    align = [str.rjust if r else str.ljust for r in right]

    def line(values: Sequence[str]) -> str:
        return "| " + " | ".join(a(v, w) for a, v, w in zip(align, values, widths, strict=True)) + " |"

    rule = "|" + "|".join("-" * (w + 1) + (":" if r else "-") for w, r in zip(widths, right, strict=True)) + "|"
    return [line(names), rule, *(line(each) for each in cells)]


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if isinstance(value, int) or abs(value) >= 1e4:
        return f"{value:,.0f}"
    return f"{value:.2f}" if abs(value) >= 0.1 or value == 0 else f"{value:.2e}"
