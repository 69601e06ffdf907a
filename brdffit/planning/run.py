"""From a scene file to plans, and from plans to baked sets."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from brdffit.comparison.options import ENVIRONMENT, SMALL_LIGHTS, CompareOptions
from brdffit.comparison.traced import traced_truth
from brdffit.methods import Baked
from brdffit.microgeometry.tracer import Effects
from brdffit.pipeline import BakeReport, ProgressListener, bake_to_folder
from brdffit.planning.description import PROCEDURAL, SceneFile
from brdffit.planning.lighting import lights_of
from brdffit.planning.plan import Plan, SurfacePlan
from brdffit.planning.surface import SurfaceWork, Tell, texture_set_of
from brdffit.planning.traced import OFF, effects_without
from brdffit.render.terms import Terms
from brdffit.textures.texture_set import TextureSet


def _nobody(text: str) -> None:
    """Ignore what is being measured."""


def plan_scene(scene: SceneFile, name: str, seed: int = 0, threads: int | None = None, tell: Tell = _nobody) -> Plan:
    """Plan every surface of a scene.

    Args:
        scene: of ``read_scene``. name: of its file, for the record.
        seed: of the sampled texels and directions; the same seed gives the same verdicts.
        tell: called with a sentence on what is being measured.

    Raises:
        InputError: for a set or an environment that cannot be used.
    """
    surfaces = tuple(SurfaceWork(scene, surface, seed, threads).plan(tell) for surface in scene.surfaces)
    return Plan(
        scene=name, seed=seed, budget_db=scene.budget.db, budget_seconds=scene.budget.seconds, surfaces=surfaces
    )


def bake_scene(
    scene: SceneFile, plan: Plan, output: Path, *, preview: bool = True, threads: int | None = None,
    progress: ProgressListener | None = None,
) -> list[BakeReport]:  # fmt: skip
    """Bake every surface by its plan, each into a folder of its name.

    The manifest holds the plan under "plan". Its entry "measured" has SNR and loss after the bake, on texels and
    directions that the plan did not see. Seconds are in the part "volatile", which is not hashed.

    Raises:
        InputError, OutputError: as ``bake_to_folder``.
    """
    reports = []
    for surface, planned in zip(scene.surfaces, plan.surfaces, strict=True):
        work = SurfaceWork(scene, surface, plan.seed + 1, threads)
        options: dict[str, Any] = {**planned.options, "threads": threads}
        reports.append(
            bake_to_folder(
                work.texture_set, output, name=surface.name, preset=scene.target.preset, bits=scene.target.bits,
                preview=preview, progress=progress, without=planned.unread,
                annotate=functools.partial(_notes, work, planned), **options,
            )
        )  # fmt: skip
    return reports


def comparisons(
    scene: SceneFile, plan: Plan, *, methods: Sequence[str] = (), quick: bool = False, threads: int | None = None
) -> tuple[list[TextureSet], list[CompareOptions]]:
    """The surfaces of a scene, and for each the options of a comparison with only the effects that its plan has on.

    A surface whose plan calls for parallax, shadowing or interreflection is compared with its traced height.

    Args:
        methods, quick, threads: as ``CompareOptions.of``.

    Raises:
        InputError: for a set that cannot be read.
    """
    sources, asked = [], []
    for surface, planned in zip(scene.surfaces, plan.surfaces, strict=True):
        lit, effects = [SMALL_LIGHTS] if scene.lights else [], traced_effects(planned)
        usual = CompareOptions.of(methods=methods, quick=quick, threads=threads)
        sources.append(texture_set_of(surface))
        asked.append(
            dataclasses.replace(
                usual,
                environment=None if scene.environment == PROCEDURAL else scene.environment,
                through_probe=scene.probe,
                lights=lights_of(scene),
                lit=tuple(lit + [ENVIRONMENT] * planned.environment),
                # A traced height reflects by the whole BRDF: terms that the plan leaves out are simulated beside it.
                terms=Terms() if effects else Terms(**dict.fromkeys(planned.terms, False)),
                unread=planned.unread,
                truth=functools.partial(traced_truth, effects=effects, threads=threads) if effects else None,
                options={**planned.options, "threads": threads},
            )
        )
    return sources, asked


def traced_effects(planned: SurfacePlan) -> Effects | None:
    """Effects of a traced height that the plan of a surface has on; None if it has none of them on."""
    on = {row.name for row in planned.effects if row.on and row.name in OFF}
    return effects_without([name for name in OFF if name not in on]) if on else None


def _notes(work: SurfaceWork, planned: SurfacePlan, baked: Baked, seconds: float) -> dict[str, Any]:
    """Entries of the manifest on the plan and its outcome."""
    outcome, lost = work.outcome(planned, baked, seconds)
    record = msgspec.to_builtins(planned)
    timed = {name: record[name].pop("seconds") for name in ("everything", "planned")}
    costs = {row["name"]: row.pop("costs_seconds") for row in record["effects"]}
    record["measured"] = {"snr_db": round(outcome.snr_db, 2), "lost_db": round(lost.db, 3), "uncertain_db": lost.error}
    return {"plan": record, "volatile": {"plan_seconds": {**timed, "measured": outcome.seconds, "effects": costs}}}
