"""What draft, standard and fine mean, in one place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from brdffit.methods import QUALITIES, one_of


class Tier(NamedTuple):
    """One rule of several: samples of a footprint along an axis (at least, at most, a pixel of it) and nodes.

    Where the least is not reached by two samples a base texel, more are taken between texels.
    """

    least: int
    most: int
    nodes: int


@dataclass(frozen=True)
class Quality:
    """A preset of the fit.

    Attributes:
        tiers: rules from coarse to fine; a texel moves on only where the one before will not do.
        trusted: disagreement of two half rules, as a share of the residual, above which a texel moves on.
        coarse: share of the energy in samples further than a lobe's width from the next, above which it moves on.
        negligible: disagreement (relative squared error) that never sends a texel on.
        last_doubt: last rule that a disagreement alone can lead to.
        starts: how many closed-form starts are followed to the end.
        tolerance: share of the error that a step must still promise.
        iterations: most steps of a search.
    """

    tiers: tuple[Tier, ...]
    trusted: float
    coarse: float
    negligible: float
    last_doubt: int
    starts: int
    tolerance: float
    iterations: int


_PRESETS = {
    "draft": Quality(
        (Tier(4, 16, 64), Tier(8, 16, 128), Tier(16, 24, 256), Tier(16, 24, 256)), 0.3, 0.3, 1e-3, 1, 1, 1e-2, 20
    ),
    "standard": Quality(
        (Tier(4, 32, 128), Tier(8, 32, 256), Tier(16, 32, 512), Tier(24, 32, 512)), 0.2, 0.2, 1e-4, 2, 1, 2e-3, 40
    ),
    "fine": Quality(
        (Tier(8, 64, 384), Tier(16, 64, 768), Tier(32, 64, 2048), Tier(64, 64, 2048)), 0.08, 0.05, 1e-5, 3, 5, 5e-4, 80
    ),
}


def get_quality(name: str) -> Quality:
    """The preset of this name.

    Raises:
        UnknownNameError: with the nearest known name.
    """
    return _PRESETS[one_of("quality", name, QUALITIES)]
