"""What draft, standard and fine mean, in one place."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from brdffit.errors import InputError
from brdffit.fitting.options import QUALITIES, FitOptions
from brdffit.methods import one_of


@dataclass(frozen=True)
class Quality:
    """A preset of the fit.

    Attributes:
        least: samples of a footprint along a pixel, at least (where a texel of the level is smaller than that many half
            texels of the base, they stand between texels).
        most: samples along a pixel, at most; beyond, samples are random points of wider strata.
        room: samples of a footprint in all, where steep normals have strata cut up.
        step: lobe widths that the normal may turn from one sample to the next.
        merge: lobe widths that it may turn between four texels for one sample to stand for all that lies there.
        nodes: of the half-angle integral, from few to many, on levels 0 and 1; twice as many beyond.
        trusted: disagreement of two half rules, as a share of the residual, above which a texel gets more nodes.
        negligible: disagreement (relative squared error) that never does.
        tolerance: share of the error that a step must still promise.
        iterations: most steps of a search.
    """

    least: int
    most: int
    room: int
    step: float
    merge: float
    nodes: tuple[int, int, int]
    trusted: float
    negligible: float
    tolerance: float
    iterations: int


# `make tradeoff` says of each what the cheapest setting within 0.5, 0.1 and 0.02 dB of the best is.
_PRESETS = {
    "draft": Quality(4, 32, 128, 3.0, 1.5, (64, 128, 256), 0.3, 1e-3, 1e-2, 20),
    "standard": Quality(4, 128, 512, 2.5, 1.0, (160, 320, 640), 0.2, 1e-4, 2e-3, 40),
    "fine": Quality(4, 256, 2048, 2.0, 0.6, (384, 768, 1536), 0.08, 1e-5, 5e-4, 80),
}


def get_quality(name: str) -> Quality:
    """The preset of this name.

    Raises:
        UnknownNameError: with the nearest known name.
    """
    return _PRESETS[one_of("quality", name, QUALITIES)]


#: From this many dB of tolerance on, a preset's sampling of footprints will do.
_SAMPLING = ((0.3, "draft"), (0.05, "standard"), (0.0, "fine"))
# Five parameters fitted to N nodes lose about 5 / N of the error, 22 / N dB; the low-discrepancy rule does better.
_NODES_TIMES_DB = 16.0
_FEWEST, _MOST = 64, 1024


def quality_of(options: FitOptions) -> Quality:
    """The preset that was asked for, or what a tolerance in dB calls for.

    Raises:
        UnknownNameError: for an unknown preset.
        InputError: for a tolerance that is not above 0.
    """
    quality = get_quality(options.quality)
    if options.tolerance is None:
        return quality
    if not options.tolerance > 0.0:
        raise InputError(f"The tolerance is {options.tolerance} dB; it must be above 0.")
    sampling = get_quality(next(name for least, name in _SAMPLING if options.tolerance >= least))
    nodes = 32 * round(min(max(_NODES_TIMES_DB / options.tolerance, _FEWEST), _MOST) / 32)
    return dataclasses.replace(sampling, nodes=(max(_FEWEST, nodes // 80 * 32), nodes, 2 * nodes))
