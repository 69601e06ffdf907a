"""Effects that a fit may leave out: the base and the kernels that it then uses, and how its result is completed.

An effect is switched off before the loop over texels begins: the loop gets a base without it (grey, white, or without
diffuse colour) and kernels without its code. Colours that the loop did not see are averaged under the pixel filter
afterwards, one image at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.fitting.batch import LevelRules, ModelKernels, Output, cell_of, model_kernels
from brdffit.fitting.options import COLOURS, FitOptions
from brdffit.fitting.search import Search
from brdffit.fitting.status import NO_SPECULAR
from brdffit.halfangle.apparent_lobe import Base
from brdffit.methods import one_of
from brdffit.models import Model

#: Luminance of linear RGB (Rec. 709).
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
_BLACK = 1e-12
#: Highest scale of a fit whose scale is free.
UNBOUNDED = 1e30


class Seen(NamedTuple):
    """What a fit sees of a base.

    Attributes:
        base: as the loop over texels reads it.
        averaged: images (H, W, 3) that the loop does not read, by name ("specular", "diffuse"); their averages complete
            its result.
        hue: whether only the hue of the averaged specular colour is used, because the fit gives its luminance.
        scale: specular colour of the white lobes that a fit without colours reads: the mean of the base's, so that the
            loss weighs lobes against the diffuse light as in the base.
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
        # Under lights with a size the loss weighs the lobe against the diffuse light, so it must see that light.
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

    The diffuse colour is the average. The specular colour is the fitted one times the hue of the average, or times the
    average over ``seen.scale``. Averages below 0 (a filter's negative weights) count as black; black has no hue, and
    the fitted grey is kept.
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


def keep_energy(
    output: Output, base: Base, rules: LevelRules, search: Search, average: Callable[[], NDArray]
) -> None:  # fmt: skip
    """Bring the specular colours of n texels within their bounds of the exact average, (n, 3), in each channel.

    The search bounds its scale by the colour of the footprint's samples. Where these are at random points, a footprint
    whose surface is a thin rim has few of them on it, which may see half of its colour (a leaf that reaches into a
    texel by half a base texel). ``average`` is not called where samples are at regular places (on the level that the
    footprints are merged from), or nothing is bounded.
    """
    strata = rules.strata
    if rules.chain is not None and cell_of(rules, base, search) > 0.0:
        strata = rules.chain.strata
    at_random = strata.jitter_x > 0.0 or strata.jitter_y > 0.0
    if at_random and search.rendered and search.scale_high < UNBOUNDED:
        colour = average()
        reflects = (colour > 0.0) & (output.status != NO_SPECULAR)[:, None]
        np.clip(
            output.specular, search.scale_low * colour, search.scale_high * colour, out=output.specular, where=reflects
        )


def kernels_of(options: FitOptions, source: Model, target: Model, float_width: int = 32) -> ModelKernels:
    """The kernels that a fit under these options needs."""
    return model_kernels(
        source.name, target.name, float_width, horizon=options.horizon, turns=options.normal != "mean",
        stretches=options.lobe != "isotropic",
    )  # fmt: skip


def reached(reach: tuple[int, int] | None, levels: int) -> range:
    """The levels that are fitted, of a pyramid with so many ``levels``; None reaches all of them.

    Raises:
        InputError: when the reach is no range of levels.
    """
    if reach is None:
        return range(levels)
    first, last = reach
    if not 0 <= first <= last:
        raise InputError(f"The reach is {first} to {last}, expected the first and the last level from 0 up.")
    return range(min(first, levels - 1), min(last, levels - 1) + 1)
