"""``python -m benchmarks [--quick] [--materials FOLDER] [-o FOLDER]``: run all, write and show the record."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import click

from benchmarks import (
    accuracy,
    effects,
    integrals,
    plans,
    rendering,
    roofline,
    scaling,
    speed,
    startup,
    tolerance,
)
from benchmarks.record import ROOT, Section, as_markdown, as_record, machine

CONCERNS = (
    "startup",
    "speed",
    "rendering",
    "scaling",
    "integrals",
    "roofline",
    "tolerance",
    "effects",
    "plans",
    "accuracy",
)


@click.command()
@click.option("--quick/--full", default=False, help="Three sets, few texels, small sizes: a few minutes.")
@click.option(
    "--materials",
    type=click.Path(path_type=Path),
    default=ROOT.parent / "shared" / "materials",
    show_default=True,
    help="Folder of real texture sets; the shipped sets stand in where it is missing.",
)
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("bench"), show_default=True)
@click.option(
    "--only", type=click.Choice(CONCERNS), multiple=True, help="Some of them (what is seen: python -m benchmarks.seen)."
)
@click.option("--set", "sets", multiple=True, help="Accuracy of these sets alone.")
def main(quick: bool, materials: Path, output: Path, only: tuple[str, ...], sets: tuple[str, ...]) -> None:
    """Measure speed, memory, start-up and accuracy; write bench.json and bench.md into the output folder."""

    def tell(text: str) -> None:
        click.echo(text, err=True)

    def save(section: Section) -> None:
        """Write the record as it grows, so that an interrupted run leaves what it has measured."""
        shown = [*sections, section, *([accuracy.with_means(section)] if section.name == "accuracy" else [])]
        (output / "bench.json").write_text(json.dumps(as_record(about, shown), indent=1) + "\n", encoding="utf-8")
        (output / "bench.md").write_text(as_markdown(about, shown), encoding="utf-8")
        if section.name == "accuracy" and section.rows:
            tell(f"accuracy: {section.rows[-1]['set']}")

    about = machine()
    about["mode"] = "quick" if quick else "full"
    runs: dict[str, Callable[[], Section]] = {
        "startup": lambda: startup.measure_startup(quick),
        "speed": lambda: speed.measure_speed(materials, quick),
        "rendering": lambda: rendering.measure_rendering(materials, quick),
        "scaling": lambda: scaling.measure_scaling(quick),
        "roofline": lambda: roofline.measure_roofline(materials, quick),
        "tolerance": lambda: tolerance.measure_tolerance(materials, quick),
        "effects": lambda: effects.measure_effects(materials, quick),
        "plans": lambda: plans.measure_plans(materials, quick),
        "integrals": lambda: integrals.measure_integrals(quick),
        "accuracy": lambda: accuracy.measure_accuracy(materials, quick, save, sets),
    }
    output.mkdir(parents=True, exist_ok=True)
    sections: list[Section] = []
    for name in only or CONCERNS:
        start = time.perf_counter()
        section = runs[name]()
        section.seconds = round(time.perf_counter() - start, 1)
        save(section)
        tell(f"{name}: {section.seconds:.0f} s")
        sections.append(section)
        if name == "accuracy":
            sections.append(accuracy.with_means(section))
    click.echo(as_markdown(about, sections))


if __name__ == "__main__":
    main()
