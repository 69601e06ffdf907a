"""The record of a plan, and how verdicts are reached.

Everything on is the start. Each effect is taken away alone and its loss is measured; those that lose least go first, as
long as what they may lose together (measured losses plus two standard errors) stays within the budget. All that went is
then measured together, and what turns out too much comes back. Verdicts stand on dB and on facts of the scene, never on
timings, so a plan is the same on a busy machine; only a budget of seconds makes timings decide.
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
        contributes_db: SNR that is lost without it, measured; None where a fact of the scene decides.
        uncertain_db: standard error of that.
        costs_seconds: of the fit, or of a comparison's pictures for what is the judge's, with everything else on.
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
    """Seconds of the fit, and SNR in dB of what the scene's cameras see; 40 dB is as good as perfect."""

    seconds: float
    snr_db: float


class SurfacePlan(msgspec.Struct, frozen=True, kw_only=True):
    """What one surface of a scene is given.

    Attributes:
        reach: first and last level that are fitted. seen: why.
        options: fields of ``FitOptions`` that differ from the defaults.
        unread: roles of maps that are not read.
        terms: terms of the judge that are left out. environment: whether it lights by the environment.
        everything, planned: predicted, with every effect on, and as planned.
        lost_db, lost_at_most_db: what the plan gives up in all, on the sample, and with two standard errors.
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


#: dB that a pass of its own has to bring: it costs several times the fit.
WORTH_A_PASS = 1.0


def is_worth_a_pass(loss: Loss) -> bool:
    """Whether what is lost without an extra pass is shown beyond chance to be worth it."""
    return loss.db - 2.0 * loss.error > WORTH_A_PASS


class Question(msgspec.Struct, frozen=True, kw_only=True):
    """What verdicts are reached from.

    Attributes:
        losses: measured, by effect. asked: the user's words, by effect. facts: what the scene settles.
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
        """Effects that are off by the user's word or, where there is none, by a fact."""
        said = {name for name, word in self.asked.items() if word == "off"}
        return said | {name for name, fact in self.facts.items() if not fact.on and self.asked.get(name) != "on"}


def verdicts(question: Question, together: Together) -> tuple[set[str], Loss]:
    """Names of the effects that go, and what their absence loses in all.

    Args:
        question: the measured losses, and what is settled without them.
        together: measures the loss of several effects at once (those of the judge do not matter to it).
    """
    off, spent = question.settled_off(), 0.0
    for name in question.free():
        may_lose = question.losses[name].at_most
        if BY_NAME[name].judge:
            # Nothing that is baked depends on it: it stands by itself.
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
    """More effects off, the least dB a second first, until they save ``excess`` seconds or none is left."""
    more = set(off)
    left = [n for n in question.free() if n not in off and not BY_NAME[n].judge and costs.get(n, 0.0) > 0.0]
    for name in sorted(left, key=lambda name: max(question.losses[name].db, 0.0) / costs[name]):
        if excess <= 0.0:
            break
        more.add(name)
        excess -= costs[name]
    return more
