"""The presets draft, standard and fine, and the preset that a tolerance in dB calls for."""

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
        least: fewest samples of a footprint along one axis of a pixel.
        most: most samples along one axis of a pixel. Where strata are no narrower than a base texel, each is sampled at
            a random point.
        room: most samples of a footprint in all, where strata are cut because the normal turns quickly.
        step: lobe widths by which the normal may turn from one sample to the next.
        merge: lobe widths by which the normal may turn between four texels for one sample to represent the whole patch.
        nodes: of the half-angle integral, for the three rules from few to many; twice as many where a footprint spans
            at least four base texels an axis.
        trusted: disagreement of the two halves of a rule, as a share of the residual, above which a texel gets more
            nodes.
        negligible: disagreement (relative squared error) below which it never does.
        tolerance: share of the error; a search stops when its next step promises less.
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


# `make tradeoff` measures the cheapest setting that stays within 0.5, 0.1 and 0.02 dB of the best, for each preset.
# The loss is that of a displayed picture, so the dark beyond a lobe counts, which few nodes see: at 64 and 128 nodes
# lobes of hammered-metal at level 2 came out 3% too wide, and one in a hundred by a third, which glows in pictures.
_PRESETS = {
    "draft": Quality(4, 32, 128, 3.0, 1.5, (96, 192, 384), 0.3, 1e-3, 1e-2, 20),
    "standard": Quality(4, 128, 512, 2.5, 1.0, (160, 320, 640), 0.2, 1e-4, 2e-3, 40),
    "fine": Quality(4, 256, 2048, 2.0, 0.6, (384, 768, 1536), 0.08, 1e-5, 5e-4, 80),
}


def get_quality(name: str) -> Quality:
    """The preset of this name.

    Raises:
        UnknownNameError: with the nearest known name.
    """
    return _PRESETS[one_of("quality", name, QUALITIES)]


#: The preset whose sampling of footprints serves tolerances from this many dB on.
_SAMPLING = ((0.3, "draft"), (0.05, "standard"), (0.0, "fine"))
# Five parameters fitted to N random nodes add about 5 / N to the error, 22 / N dB; low-discrepancy nodes add less.
_NODES_TIMES_DB = 16.0
_FEWEST, _MOST = 64, 1024
# Under lights with a size the loss is that of a displayed picture, and several sizes share the nodes: a tolerance only
# saves steps of the search, and starts from the sampling and the nodes of this preset. With 64 nodes hammered metal was
# 3 dB behind it, with 96 one level of metal plates 5 dB.
_LEAST_SIZED = "standard"


def quality_of(options: FitOptions) -> Quality:
    """The preset that the options name, or the one that their tolerance in dB calls for.

    Raises:
        UnknownNameError: for an unknown preset.
        InputError: for a tolerance that is not above 0.
    """
    quality = get_quality(options.quality)
    if options.tolerance is None:
        return quality
    if not options.tolerance > 0.0:
        raise InputError(f"The tolerance is {options.tolerance} dB; it must be above 0.")
    name = next(name for least, name in _SAMPLING if options.tolerance >= least)
    fewest = _FEWEST
    if options.lights != "point":
        fewest = get_quality(_LEAST_SIZED).nodes[0]
        name = _LEAST_SIZED if name == "draft" else name
    nodes = 32 * round(min(max(_NODES_TIMES_DB / options.tolerance, fewest), _MOST) / 32)
    return dataclasses.replace(get_quality(name), nodes=(max(fewest, nodes // 80 * 32), nodes, 2 * nodes))
