"""Effects of a fit that may be left out: what of the base is then seen, by which kernels, and what completes it.

An effect that is off is off before the loop over texels begins: the loop sees a base that never had it (a grey one, a
white one, one without diffuse colour), and kernels without its code. What it left out, colours, is averaged under the
pixel filter afterwards, one image at a time.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.fitting.batch import ModelKernels, Output, model_kernels
from brdffit.fitting.options import COLOURS, FitOptions
from brdffit.fitting.status import NO_SPECULAR
from brdffit.halfangle.apparent_lobe import Base
from brdffit.methods import one_of
from brdffit.models import Model

#: Of linear RGB (Rec. 709).
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
_BLACK = 1e-12


class Seen(NamedTuple):
    """What a fit sees of a base.

    ``base``: as the loop over texels reads it; ``averaged``: the images (H, W, 3) that it does not read, "specular" or
    "diffuse", whose averages complete its answer; ``hue``: whether the averaged specular colour gives its hue alone;
    ``scale``: of the white lobes that a fit without colours reads, as bright as the base's in the mean, so that its
    loss weighs them against the diffuse light as they are.
    """

    base: Base
    averaged: dict[str, NDArray]
    hue: bool
    scale: float = 1.0


def seen_by(base: Base, options: FitOptions) -> Seen:
    """What a fit under these options sees.

    Raises:
        UnknownNameError: for an unknown ``colour``.
    """
    shared = one_of("colour", options.colour, COLOURS) == "shared" and not base.grey
    averaged, scale = {}, 1.0
    if not options.coupling and base.has_diffuse:
        averaged["diffuse"] = base.diffuse
        # Under lights with a size the loss weighs the lobe against the diffuse light, which it must see.
        base = base._replace(has_diffuse=options.lights != "point")
    if not options.correlation:
        averaged["specular"] = base.specular
        scale = float(np.mean(base.specular, dtype=np.float64)) or 1.0
        base = base._replace(specular=np.full_like(base.specular, scale), grey=True)
    elif shared:
        averaged["specular"] = base.specular
        base = base._replace(specular=np.repeat(base.specular @ _LUMINANCE[:, None], 3, axis=2), grey=True)
    return Seen(base, averaged, hue=options.correlation, scale=scale)


def complete(output: Output, seen: Seen, averages: Mapping[str, NDArray]) -> None:
    """Put the averages (n, 3) of ``seen.averaged`` into the outputs of n texels.

    Diffuse colour is the average; specular colour is the fitted scale times the average (or its hue). Averages below 0
    (a filter's negative weights) count as black; black has no hue, and is left grey.
    """
    if "diffuse" in averages:
        np.maximum(averages["diffuse"], 0.0, out=output.diffuse)
    if "specular" in averages:
        colour = np.maximum(averages["specular"], 0.0)
        luminance = colour @ _LUMINANCE[:, None]
        black = luminance <= _BLACK
        if seen.hue:
            colour = np.where(black, 1.0, colour / np.where(black, 1.0, luminance))
        else:
            output.status[black[:, 0]] = NO_SPECULAR
            colour = colour / seen.scale
        np.multiply(output.specular, colour, out=output.specular, casting="same_kind")


def kernels_of(options: FitOptions, source: Model, target: Model, float_width: int = 32) -> ModelKernels:
    """The kernels that a fit under these options needs."""
    return model_kernels(
        source.name, target.name, float_width, horizon=options.horizon, turns=options.normal != "mean",
        stretches=options.lobe != "isotropic",
    )  # fmt: skip


def reached(reach: tuple[int, int] | None, levels: int) -> range:
    """The levels that are fitted, of so many.

    Raises:
        InputError: when the reach is no range of levels.
    """
    if reach is None:
        return range(levels)
    first, last = reach
    if not 0 <= first <= last:
        raise InputError(f"The reach is {first} to {last}, expected the first and the last level from 0 up.")
    return range(min(first, levels - 1), min(last, levels - 1) + 1)
