"""The record of a trade-off, as it is written to tradeoff.json."""

from __future__ import annotations

from typing import Any

import msgspec


class Point(msgspec.Struct, frozen=True):
    """One candidate on one set.

    ``seconds_per_megatexel``: of the base, levels 0 to 5 together, on all cores; ``snr_db``: SNR of the error on a
    screen under lights with a size (``brdffit.tradeoff.seen``), mean of the levels in dB; ``energy``: mean of the scale
    over the filtered colour; ``levels_db``: that SNR of each level; ``front``: whether no candidate is both faster and
    better; ``price``: seconds per megatexel for each dB gained over the next faster candidate on the front.
    """

    set: str
    group: str
    name: str
    seconds_per_megatexel: float
    snr_db: float
    energy: float
    levels_db: list[float]
    front: bool = False
    price: float | None = None


class Solver(msgspec.Struct, frozen=True):
    """One optimiser on the common objective: milliseconds a texel, dB behind the best result of all optimisers (of the
    mean error, and at the worst texel), evaluations a texel."""

    set: str
    name: str
    milliseconds: float
    behind_db: float
    worst_db: float
    evaluations: float


class Choice(msgspec.Struct, frozen=True):
    """The cheapest setting that loses at most ``allowed_db`` to the best candidate in the mean of sets, and a preset.

    ``cost``: seconds over those of standard, geometric mean of the sets; ``behind_db``: dB behind the best candidate,
    mean of sets, levels above 50 dB counting as 50 dB; ``worst_db``: of the worst set; the same three of the preset.
    """

    preset: str
    allowed_db: float
    setting: str
    cost: float
    behind_db: float
    worst_db: float
    preset_cost: float
    preset_behind_db: float
    preset_worst_db: float


class Tradeoff(msgspec.Struct, frozen=True):
    """All results of a run, with its command, machine and measured texels of each level."""

    command: str
    machine: dict[str, Any]
    texels: list[int]
    points: list[Point]
    solvers: list[Solver]
    choices: list[Choice]
    seconds: float
