"""What a trade-off measured, as it is written to tradeoff.json."""

from __future__ import annotations

from typing import Any

import msgspec


class Point(msgspec.Struct, frozen=True):
    """One way on one set.

    ``seconds_per_megatexel``: of the base, levels 0 to 5 together, on the machine's cores; ``snr_db``: half-angle SNR,
    mean of the levels in dB; ``rendered_db``: SNR of radiance over pairs of light and viewer, mean of the levels it was
    measured at; ``energy``: kept, mean; ``levels_db``: half-angle SNR of each level; ``front``: no way is both faster
    and better; ``price``: seconds per megatexel for each dB more than the way before on the front.
    """

    set: str
    group: str
    name: str
    seconds_per_megatexel: float
    snr_db: float
    rendered_db: float | None
    energy: float
    levels_db: list[float]
    front: bool = False
    price: float | None = None


class Solver(msgspec.Struct, frozen=True):
    """One optimiser on the objective that all share: milliseconds a texel, and dB behind the best end of all."""

    set: str
    name: str
    milliseconds: float
    behind_db: float
    worst_db: float
    evaluations: float


class Choice(msgspec.Struct, frozen=True):
    """The cheapest setting that loses at most ``allowed_db`` to the best way, in the mean of all sets, beside a preset.

    ``cost``: seconds over those of standard, geometric mean of the sets; ``behind_db``: mean of the sets, what is above
    50 dB counting as that; ``worst_db``: of one set; the same three of the preset.
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
    """All points of a run, and what it ran on."""

    command: str
    machine: dict[str, Any]
    texels: list[int]
    points: list[Point]
    solvers: list[Solver]
    choices: list[Choice]
    seconds: float
