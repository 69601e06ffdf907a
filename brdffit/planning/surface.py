"""One surface of a scene: its texture set, the sample on which effects are tried, its plan and the plan's outcome."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec

from brdffit.fitting.options import FitOptions
from brdffit.methods import DEFAULT, Baked, Material, get_method
from brdffit.options import changed_options
from brdffit.pipeline import open_set, read_set
from brdffit.planning.description import SceneFile, Surface
from brdffit.planning.effects import BY_NAME, Setup, setup
from brdffit.planning.facts import Fact, settled
from brdffit.planning.judge import judge_costs
from brdffit.planning.lighting import directions, environment_of, lights_of
from brdffit.planning.plan import (
    WORTH_A_PASS,
    EffectRow,
    Outcome,
    Question,
    SurfacePlan,
    faster,
    is_worth_a_pass,
    verdicts,
)
from brdffit.planning.reach import Reach, reached_levels
from brdffit.planning.refinement import try_refinement
from brdffit.planning.sizes import light_sizes, lights_option, shares_of
from brdffit.planning.traced import OFF, seconds_a_picture, traced_losses, what_maps_lack
from brdffit.planning.trial import Errors, Loss, Sample, Shining, loss, snr_db
from brdffit.render.terms import Terms
from brdffit.svbrdf import Svbrdf, level_sizes
from brdffit.textures.texture_set import TextureSet

#: Share of the budget that is the tolerance of a bake without the effect "texels".
_SHORTCUTS = 0.5
#: Called with a sentence on what is being done.
Tell = Callable[[str], None]


class _Tried(NamedTuple):
    """The loss without each effect, and the seconds that each costs."""

    losses: dict[str, Loss]
    costs: dict[str, float]


def texture_set_of(surface: Surface) -> TextureSet:
    """The texture set of a surface, with its pixels not read yet."""
    found = open_set(surface.set, surface.reading())
    assert found is not None  # a path is no array
    return found


class SurfaceWork:
    """One surface of a scene.

    Args:
        scene, surface: as read.
        seed: of texels and directions.
        threads: None takes all cores.
    """

    def __init__(self, scene: SceneFile, surface: Surface, seed: int, threads: int | None = None) -> None:
        self.scene, self.surface, self.seed, self.threads = scene, surface, seed, threads
        self.texture_set: TextureSet = texture_set_of(surface)
        self.asked = {name: scene.switch(name) for name in BY_NAME}
        self.sizes = light_sizes(scene, surface)

    def plan(self, tell: Tell) -> SurfacePlan:
        """Measure and decide.

        Raises:
            InputError: for a set that cannot be used.
        """
        tell(f"{self.surface.name}: reading")
        base = read_set(self.texture_set, {}, FitOptions()).material.svbrdf.over_black()
        seen = reached_levels(self.scene, self.surface, base.size)
        facts = settled(self.scene, base, (seen.first, seen.last))
        get_method(DEFAULT).prepare(Material(base), FitOptions(model=self.scene.model))
        sample = self._sample(base, seen)
        everything = self._everything(facts)
        on = sample.versions(self._setup(seen, everything))
        sample.aim(on)
        found = sample.errors([on])
        tried = self._try(base, sample, seen, facts, on, found, tell)

        def together(off: set[str]) -> Loss:
            return loss(sample.errors([on, sample.versions(self._setup(seen, off))]), 1)

        question = Question(losses=tried.losses, asked=self.asked, facts=facts, budget=self.scene.budget.db)
        off, lost = verdicts(question, together)
        tell(f"{self.surface.name}: timing the plan")
        seconds, notes = self._seconds(sample, seen, off, tried), []
        most = self.scene.budget.seconds
        if most is not None and seconds > most:
            off = faster(question, off, tried.costs, seconds - most)
            lost, seconds = together(off), self._seconds(sample, seen, off, tried)
            if seconds > most:
                notes.append(f"The budget of {most:g} s cannot be met: what is left takes about {seconds:.1f} s.")
        notes += self._of_height(base, tried, off)
        final, snr = self._setup(seen, off), snr_db(found, 0)
        return SurfacePlan(
            name=self.surface.name, set=Path(self.surface.set).name, size=base.size, reach=(seen.first, seen.last),
            seen=seen.sentence, effects=tuple(self._row(name, name not in off, facts, tried) for name in BY_NAME),
            options=changed_options(final.options), unread=tuple(r for r in final.unread if r in self.texture_set.maps),
            terms=tuple(name for name, lit in dataclasses.asdict(final.terms).items() if not lit),
            environment=final.environment,
            everything=Outcome(seconds=self._seconds_of_all(base, everything, tried), snr_db=snr),
            planned=Outcome(seconds=seconds, snr_db=snr - lost.db),
            lost_db=lost.db, lost_at_most_db=lost.at_most, notes=tuple(notes),
        )  # fmt: skip

    def outcome(self, planned: SurfacePlan, baked: Baked, seconds: float) -> tuple[Outcome, Loss]:
        """Outcome of a plan on texels of this seed: seconds and SNR, and the loss against everything on."""
        base = read_set(self.texture_set, {}, FitOptions()).material.svbrdf.over_black()
        seen = reached_levels(self.scene, self.surface, base.size)
        sample = self._sample(base, seen)
        everything = self._everything(settled(self.scene, base, planned.reach))
        on = sample.versions(self._setup(seen, everything))
        sample.aim(on)
        assert baked.lobes is not None
        errors = sample.errors([on, sample.picked([level.svbrdf.over_black() for level in baked.lobes.levels])])
        return Outcome(seconds=seconds, snr_db=snr_db(errors, 1)), loss(errors, 1)

    def _try(
        self, base: Svbrdf, sample: Sample, seen: Reach, facts: Mapping[str, Fact], on: Sequence[Svbrdf], found: Errors,
        tell: Tell,
    ) -> _Tried:  # fmt: skip
        """Switch off each effect alone: those that nothing settles, and those that the user sets against a fact."""
        everything = self._everything(facts)
        names = [n for n in BY_NAME if n not in facts or self.asked[n] not in ("auto", "on" if facts[n].on else "off")]
        baked = [n for n in names if not BY_NAME[n].judge and n != "refinement"]
        tell(f"{self.surface.name}: trying {len(names)} effects")
        setups = [self._setup(seen, everything), *(self._setup(seen, everything | {n}) for n in baked)]
        errors = sample.errors([on, *(sample.versions(each) for each in setups[1:])])
        losses = {n: loss(errors, m + 1) for m, n in enumerate(baked)}
        tell(f"{self.surface.name}: timing them")
        seconds = sample.seconds(setups)
        costs = {n: seconds[0] - each for n, each in zip(baked, seconds[1:], strict=True)}
        lights, environment = lights_of(self.scene), environment_of(self.scene)
        if "refinement" in names:
            tell(f"{self.surface.name}: trying refinement")
            losses["refinement"], costs["refinement"] = try_refinement(
                base, setups[0].options, (seen.first, seen.last), lights, self.seed
            )
        traced = [n for n in names if BY_NAME[n].traced]
        if traced:
            tell(f"{self.surface.name}: tracing its height")
            of_height, their_costs = traced_losses(sample, found, traced)
            losses |= of_height
            costs |= their_costs
        for name in (n for n in names if BY_NAME[n].judge and not BY_NAME[n].traced):
            if name == "environment":
                dark = msgspec.structs.replace(self.scene, environment=None)
                without = sample.errors([on], lights=self._lights(dark))
            else:
                without = sample.errors([on], Terms(**dict.fromkeys(BY_NAME[name].terms, False)))
            # A change of the judge's figure counts in either direction.
            change = loss(without, 0, 0, found)
            losses[name] = Loss(abs(change.db), change.error)
        costs |= judge_costs(base, seen.first, lights, environment, self.threads)
        return _Tried(losses, costs)

    def _of_height(self, base: Svbrdf, tried: _Tried, off: set[str]) -> list[str]:
        """Notes on effects that the scene calls for and no map shows."""
        on = [name for name in OFF if name not in off]
        if not on or base.height is None:
            return []
        pixels = max(math.prod(camera.resolution) for camera in self.scene.cameras)
        return what_maps_lack(tried.losses, on, base.size, pixels, seconds_a_picture(base, on, pixels, self.threads))

    def _row(self, name: str, on: bool, facts: Mapping[str, Fact], tried: _Tried) -> EffectRow:
        """One line of the plan: the verdict and its reason."""
        effect, asked, loss = BY_NAME[name], self.asked[name], tried.losses.get(name)
        budget = self.scene.budget.db
        if asked != "auto":
            why, change = "the scene file says so", f'{name} = "auto"'
        elif name in facts:
            why, change = facts[name].why, facts[name].change
        else:
            assert loss is not None
            may = f"{loss.at_most:.2g} dB"
            if on and loss.at_most <= budget:
                why, change = "the budget is spent on effects that lose less", "a larger budget"
            elif on:
                what = "the judge's figure moves" if effect.judge else "the scene loses"
                why, change = f"without it {what} by up to {may}", f"a budget above {may}"
            elif effect.extra and not is_worth_a_pass(loss):
                why, change = f"it is not shown to bring {WORTH_A_PASS:g} dB", "a set or a view in which it does"
            else:
                over = " (over the budget: its seconds are saved)" if loss.at_most > budget else ""
                why, change = f"{effect.absent}: at most {may} are lost{over}", f"a budget below {may}"
        return EffectRow(
            name=name, title=effect.title, asked=asked, on=on, why=why, change=change,
            contributes_db=None if loss is None else loss.db, uncertain_db=None if loss is None else loss.error,
            costs_seconds=tried.costs.get(name),
        )  # fmt: skip

    def _everything(self, facts: Mapping[str, Fact]) -> set[str]:
        """Effects that are off even with everything on, because the target cannot store them."""
        return {n for n in ("anisotropy", "scale") if n in facts and not facts[n].on and self.asked[n] != "on"}

    def _setup(self, seen: Reach | None, off: Iterable[str]) -> Setup:
        scene = self.scene
        # The fit minimises what the plan measures: errors under the sizes of the scene's own lights.
        options = FitOptions(
            lights=lights_option(self.sizes), model=scene.model, quality=scene.quality, pixel_filter=scene.pixel_filter,
            threads=self.threads,
            reach=None if seen is None else (seen.first, seen.last),
        )  # fmt: skip
        return setup(options, set(off), tolerance=_SHORTCUTS * scene.budget.db)

    def _sample(self, base: Svbrdf, seen: Reach) -> Sample:
        return self._sample_of(base, (seen.first, seen.last))

    def _sample_of(self, base: Svbrdf, levels: tuple[int, int]) -> Sample:
        options = self._setup(None, ()).options
        return Sample(base, options, levels, self._lights(self.scene), self.seed, threads=self.threads)

    def _lights(self, scene: SceneFile) -> list[Shining]:
        sizes = light_sizes(scene, self.surface)
        draws = [functools.partial(directions, scene, self.surface, luminance=size.luminance) for size in sizes]
        return [
            Shining(size.radius, float(share), draw)
            for size, share, draw in zip(sizes, shares_of(sizes), draws, strict=True)
        ]

    def _seconds(self, sample: Sample, seen: Reach, off: set[str], tried: _Tried) -> float:
        return sample.seconds([self._setup(seen, off)])[0] + _refining(tried, off)

    def _seconds_of_all(self, base: Svbrdf, everything: set[str], tried: _Tried) -> float:
        """Seconds of all levels with everything on."""
        sample = self._sample_of(base, (0, len(level_sizes(base.size)) - 1))
        return sample.seconds([self._setup(None, everything)])[0] + _refining(tried, everything)


def _refining(tried: _Tried, off: set[str]) -> float:
    return 0.0 if "refinement" in off else tried.costs.get("refinement", 0.0)
