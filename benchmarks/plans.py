"""Plans of scenes against their bakes: predicted and measured seconds, and the loss on texels that were not sampled."""

from __future__ import annotations

import time
from pathlib import Path

import msgspec

from benchmarks.materials import accuracy_sets
from benchmarks.record import ROOT, Section, Target
from brdffit.errors import InputError
from brdffit.fitting.method import NonlinearFit
from brdffit.fitting.options import FitOptions
from brdffit.methods import Material
from brdffit.planning.description import SceneFile, read_scene
from brdffit.planning.surface import SurfaceWork
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.procedural import SETS, make_set

_SCENES = ROOT / "data" / "scenes"
#: The scene for all sets: small lights, a glTF target, many levels.
_FOR_ALL = "panel.toml"


def measure_plans(materials: Path, quick: bool) -> Section:
    """Measure the shipped scenes, and real sets in one of them; a full run also bakes with everything on."""
    section = Section(
        "plans",
        "Plans",
        "Shipped scenes with their own sets, then sets in the scene of the brushed-metal panel. Seconds of the fit, "
        "predicted from the plan's sample and measured in a whole bake; everything on: predicted, and in full mode "
        "measured. Lost: SNR in dB against everything on, measured by the plan, at most (two standard errors above), "
        "and after the bake on other texels and directions.",
    )
    for name in SETS:
        if not (ROOT / "data" / "sets" / name).is_dir():
            make_set(name, ROOT / "data" / "sets" / name)
    scenes = {path.stem: read_scene(path) for path in sorted(_SCENES.glob("*.toml"))}
    rows = [(scene, name) for name, scene in scenes.items()]
    panel = read_scene(_SCENES / _FOR_ALL)
    for name, path in accuracy_sets(materials, quick).items():
        if path is not None:
            surface = msgspec.structs.replace(panel.surfaces[0], set=str(path), name=name)
            rows.append((msgspec.structs.replace(panel, surfaces=(surface,)), name))
    for scene, name in rows:
        try:
            section.rows.append(_row(scene, name, whole=not quick and name in scenes))
        except InputError as error:
            section.problems.append(f"{name}: {error}")
    if section.rows:
        off = max(section.rows, key=lambda row: abs(float(row["predicted"]) - 1.0))  # type: ignore[arg-type]
        over = max(section.rows, key=lambda row: float(row["after"]) - float(row["at most"]))  # type: ignore[arg-type]
        section.targets = [
            Target("predicted seconds over measured", "within 30%", f"worst {off['predicted']:.2f} ({off['set']})",
                   abs(float(off["predicted"]) - 1.0) <= 0.3),  # type: ignore[arg-type]
            Target("lost after the bake, less what the plan says at most, dB", "<= 0, but for noise",
                   f"worst {float(over['after']) - float(over['at most']):.3f} ({over['set']})",  # type: ignore[arg-type]
                   float(over["after"]) <= float(over["at most"]) + 0.05),  # type: ignore[arg-type]
        ]  # fmt: skip
    return section


def _row(scene: SceneFile, name: str, whole: bool) -> dict[str, object]:
    began = time.perf_counter()
    planned = SurfaceWork(scene, scene.surfaces[0], 0).plan(lambda text: None)
    planning = time.perf_counter() - began
    work = SurfaceWork(scene, scene.surfaces[0], 1)
    options = FitOptions(**planned.options)
    method = NonlinearFit()
    base = to_svbrdf(work.texture_set, without=planned.unread)
    method.prepare(Material(base), options)
    seconds, baked = _timed(method, base, options)
    _, lost = work.outcome(planned, baked, seconds)
    everything = None
    if whole:
        on = FitOptions(model=scene.model, quality=scene.quality, pixel_filter=scene.pixel_filter, refine=True)
        everything, _ = _timed(method, to_svbrdf(work.texture_set), on)
    return {
        "set": name,
        "levels": f"{planned.reach[0]}-{planned.reach[1]}",
        "off": ", ".join(planned.off),
        "planning s": planning,
        "all on s": planned.everything.seconds,
        "all on, measured": everything,
        "planned s": planned.planned.seconds,
        "measured s": seconds,
        "predicted": planned.planned.seconds / seconds,
        "lost": planned.lost_db,
        "at most": planned.lost_at_most_db,
        "after": lost.db,
    }


def _timed(method: NonlinearFit, base, options: FitOptions):  # type: ignore[no-untyped-def]
    start = time.perf_counter()
    baked = method.bake(Material(base), options)
    return time.perf_counter() - start, baked
