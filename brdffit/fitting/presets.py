"""What draft, standard and fine mean, in one place."""

from __future__ import annotations

from dataclasses import dataclass

from brdffit.methods import QUALITIES, one_of


@dataclass(frozen=True)
class Quality:
    """A preset of the fit.

    Attributes:
        least: samples of a footprint along a pixel, at least (where a texel of the level is smaller than that many half
            texels of the base, they stand between texels).
        most: samples along a pixel, at most; beyond, samples are random points of wider strata.
        room: samples of a footprint in all, where steep normals have strata cut up.
        step: lobe widths that the normal may turn from one sample to the next.
        nodes: of the half-angle integral, from few to many.
        trusted: disagreement of two half rules, as a share of the residual, above which a texel gets more nodes.
        negligible: disagreement (relative squared error) that never does.
        starts: how many closed-form starts are followed to the end.
        tolerance: share of the error that a step must still promise.
        iterations: most steps of a search.
    """

    least: int
    most: int
    room: int
    step: float
    nodes: tuple[int, int, int]
    trusted: float
    negligible: float
    starts: int
    tolerance: float
    iterations: int


_PRESETS = {
    "draft": Quality(4, 32, 128, 2.0, (64, 128, 256), 0.3, 1e-3, 1, 1e-2, 20),
    "standard": Quality(4, 128, 512, 1.5, (160, 320, 640), 0.2, 1e-4, 1, 2e-3, 40),
    "fine": Quality(8, 256, 4096, 0.5, (384, 1024, 2048), 0.08, 1e-5, 5, 5e-4, 80),
}


def get_quality(name: str) -> Quality:
    """The preset of this name.

    Raises:
        UnknownNameError: with the nearest known name.
    """
    return _PRESETS[one_of("quality", name, QUALITIES)]
