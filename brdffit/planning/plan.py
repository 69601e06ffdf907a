"""The record of a plan, and how its verdicts are reached.

A plan starts with everything on. Each effect is switched off alone and its loss is measured. Effects are then switched
off in the order of their losses, as long as their summed losses (each with two standard errors added) stay within the
budget. Finally the loss of all together is measured, and effects are switched on again if it exceeds the budget.
Verdicts depend on dB and on facts of the scene, so a plan is the same on a busy machine; timings decide only under a
budget of seconds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from brdffit.planning.effects import BY_NAME
from brdffit.planning.facts import Fact
from brdffit.planning.trial import Loss

Together = Callable[[set[str]], Loss]


class EffectRow(msgspec.Struct, frozen=True, kw_only=True):
    """One effect of one surface.

    Attributes:
        asked: "auto", "on" or "off", as the scene file says.
        on: the verdict. why: its reason. change: what would change it.
        contributes_db: measured SNR that is lost without it; None where a fact of the scene decides.
        uncertain_db: standard error of that.
        costs_seconds: of the fit, or of a comparison's pictures for the judge's effects, with everything else on.
    """

    name: str
    title: str
    asked: str
    on: bool
    why: str
    change: str = ""
    contributes_db: float | None = None
    uncertain_db: float | None = None
    costs_seconds: float | None = None


class Outcome(msgspec.Struct, frozen=True, kw_only=True):
    """Seconds of the fit, and SNR in dB of what the scene's cameras see (at most 40, where no error is visible)."""

    seconds: float
    snr_db: float


class SurfacePlan(msgspec.Struct, frozen=True, kw_only=True):
    """The plan of one surface of a scene.

    Attributes:
        reach: first and last level that are fitted. seen: why.
        options: fields of ``FitOptions`` that differ from the defaults.
        unread: roles of maps that are not read.
        terms: terms of the judge that are left out. environment: whether the judge uses the environment as a light.
        everything, planned: predictions with every effect on, and for the plan.
        lost_db, lost_at_most_db: loss of the whole plan on the sample, and with two standard errors added.
    """

    name: str
    set: str
    size: tuple[int, int]
    reach: tuple[int, int]
    seen: str
    effects: tuple[EffectRow, ...]
    options: dict[str, Any]
    unread: tuple[str, ...]
    terms: tuple[str, ...]
    environment: bool
    everything: Outcome
    planned: Outcome
    lost_db: float
    lost_at_most_db: float
    notes: tuple[str, ...] = ()

    @property
    def off(self) -> tuple[str, ...]:
        """Names of the effects that are off."""
        return tuple(row.name for row in self.effects if not row.on)


class Plan(msgspec.Struct, frozen=True, kw_only=True):
    """Plans of all surfaces of a scene."""

    scene: str
    seed: int
    budget_db: float
    budget_seconds: float | None
    surfaces: tuple[SurfacePlan, ...]


#: dB that an extra pass must gain, since it costs several times the fit.
WORTH_A_PASS = 1.0


def is_worth_a_pass(loss: Loss) -> bool:
    """Whether the loss without an extra pass exceeds ``WORTH_A_PASS`` by more than two standard errors."""
    return loss.db - 2.0 * loss.error > WORTH_A_PASS


class Question(msgspec.Struct, frozen=True, kw_only=True):
    """The basis of the verdicts.

    Attributes:
        losses: measured, by effect. asked: settings of the scene file, by effect. facts: what the scene settles.
        budget: dB.
    """

    losses: Mapping[str, Loss]
    asked: Mapping[str, str]
    facts: Mapping[str, Fact]
    budget: float

    def free(self) -> list[str]:
        """Effects that neither the user nor the scene settles, the smallest loss first."""
        open_ = [n for n in self.losses if n not in self.facts and self.asked.get(n, "auto") == "auto"]
        return sorted(open_, key=lambda name: (self.losses[name].at_most, name))

    def settled_off(self) -> set[str]:
        """Effects that the scene file switches off, or a fact where the scene file does not switch them on."""
        said = {name for name, word in self.asked.items() if word == "off"}
        return said | {name for name, fact in self.facts.items() if not fact.on and self.asked.get(name) != "on"}


def verdicts(question: Question, together: Together) -> tuple[set[str], Loss]:
    """Names of the effects that are switched off, and the loss of all of them together.

    Args:
        question: the measured losses, and the effects settled without them.
        together: measures the loss of several effects at once (it ignores those of the judge).
    """
    off, spent = question.settled_off(), 0.0
    for name in question.free():
        may_lose = question.losses[name].at_most
        if BY_NAME[name].judge:
            # It changes no bake, so it does not draw on the common budget.
            off |= {name} if may_lose <= question.budget else set()
        elif BY_NAME[name].extra:
            off |= set() if is_worth_a_pass(question.losses[name]) else {name}
        elif spent + may_lose <= question.budget:
            off.add(name)
            spent += may_lose
    found = together(off)
    for name in reversed(question.free()):
        if found.at_most <= question.budget:
            break
        if name in off and not BY_NAME[name].judge and not BY_NAME[name].extra:
            off.remove(name)
            found = together(off)
    return off, found


def faster(question: Question, off: set[str], costs: Mapping[str, float], excess: float) -> set[str]:
    """Switch off more effects, those with the least dB a second first, until they save ``excess`` seconds or none is
    left."""
    more = set(off)
    left = [n for n in question.free() if n not in off and not BY_NAME[n].judge and costs.get(n, 0.0) > 0.0]
    for name in sorted(left, key=lambda name: max(question.losses[name].db, 0.0) / costs[name]):
        if excess <= 0.0:
            break
        more.add(name)
        excess -= costs[name]
    return more
