"""The cost of pictures: seconds a megapixel of reference and methods, and the share of each term of the BRDF."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.materials import NAMED, load_any, real_sets
from benchmarks.record import Section, Target
from brdffit.fitting.options import FitOptions
from brdffit.methods import get_method
from brdffit.render import scenes
from brdffit.render.environment import procedural_environment
from brdffit.render.pictures import render_appearance
from brdffit.render.reference import render_halves, render_reference
from brdffit.render.terms import Terms
from brdffit.svbrdf import Svbrdf

#: Target for a picture of 256x256 at level 7 of a 1024x1024 set, with which a whole comparison takes minutes.
FAR_SECONDS = 10.0
_SIDE, _PIXELS = 1024, (256, 256)
_FAR = 7
_TERMS = ("masking", "fresnel", "diffuse", "cosine")


def measure_rendering(materials: Path, quick: bool) -> Section:
    """GGX, four small lights (three of them in front), box filter, all cores, kernels compiled."""
    section = Section(
        "rendering",
        "Rendering",
        f"Pictures of {_PIXELS[1]}x{_PIXELS[0]} under four small lights, or in the studio that ships; seconds a "
        "megapixel of picture, all cores, box filter, standard samples; noise is the reference's own SNR. Shares of "
        "terms: time of the far reference (fixed samples) with all terms minus time without one, over the time with "
        "all.",
    )
    sets: dict[str, Path | None] = {"hammered-metal": None}
    real = real_sets(materials)
    sets |= {name: real[name] for name in NAMED if name in real and not quick}
    for name, path in sets.items():
        svbrdf = load_any(name, path, _SIDE)
        if isinstance(svbrdf, str):
            section.problems.append(f"{name}: {svbrdf}")
            continue
        section.rows += _rows(name, svbrdf, quick)
    far = [row for row in section.rows if row["scene"] == f"plane, level {_FAR}" and row["light"] == "small lights"]
    if far:
        worst = max(far, key=lambda row: row["reference s/Mpixel"])
        seconds = worst["reference s/Mpixel"] * _PIXELS[0] * _PIXELS[1] / 1e6
        section.targets.append(
            Target(
                f"reference of {_PIXELS[1]}x{_PIXELS[0]} at level {_FAR}, s",
                f"<= {FAR_SECONDS:g}",
                f"{seconds:.2f} ({worst['set']})",
                seconds <= FAR_SECONDS,
            )
        )
    return section


def _rows(name: str, svbrdf: Svbrdf, quick: bool) -> list[dict[str, object]]:
    """One row for each scene and light; the row of the far scene holds the shares of the terms."""
    pyramid = get_method("lean").bake_lobes(svbrdf, FitOptions())
    near, middle, far = (scenes.plane(svbrdf.size, min(k, len(pyramid) - 1), _PIXELS) for k in (0, 3, _FAR))
    shown = [(near, None), (middle, None), (far, None)]
    if not quick:
        shown += [(scenes.slanted(svbrdf.size, _PIXELS), None), (middle, procedural_environment())]
    rows = []
    megapixels = _PIXELS[0] * _PIXELS[1] / 1e6
    for scene, environment in shown:
        # The first picture compiles; a small one is enough.
        small = scenes.plane(svbrdf.size, 0, (4, 4))
        render_reference(svbrdf, small, environment=environment, samples=4)
        render_appearance(pyramid, small, environment=environment)
        noise: list[float] = []

        def reference(scene=scene, environment=environment, noise=noise) -> None:  # type: ignore[no-untyped-def]
            noise.append(render_halves(svbrdf, scene, environment=environment).noise_db)

        def method(scene=scene, environment=environment) -> None:  # type: ignore[no-untyped-def]
            render_appearance(pyramid, scene, environment=environment)

        row: dict[str, object] = {
            "set": name,
            "scene": scene.name if scene.level is None else f"{scene.name}, level {scene.level:g}",
            "light": "small lights" if environment is None else "studio",
            "reference s/Mpixel": _seconds(reference, 1) / megapixels,
            "noise dB": noise[-1],
            "method s/Mpixel": _seconds(method, 3) / megapixels,
        }
        row |= _shares(svbrdf, scene) if scene is far else dict.fromkeys((f"{term} %" for term in _TERMS), None)
        rows.append(row)
    return rows


def _shares(svbrdf: Svbrdf, scene: scenes.Scene) -> dict[str, object]:
    """Percent of the reference's time that is saved by leaving out each term."""

    def seconds(terms: Terms) -> float:
        def render() -> None:
            render_reference(svbrdf, scene, terms=terms, samples=4096)

        render_reference(svbrdf, scenes.plane(svbrdf.size, 0, (4, 4)), terms=terms, samples=4)
        return _seconds(render, 3)

    whole = seconds(Terms())
    return {f"{term} %": 100.0 * (1.0 - seconds(Terms(**{term: False})) / whole) for term in _TERMS}


def _seconds(work: Callable[[], None], runs: int) -> float:
    """Median wall-clock seconds."""
    found = []
    for _ in range(runs):
        start = time.perf_counter()
        work()
        found.append(time.perf_counter() - start)
    return statistics.median(found)
