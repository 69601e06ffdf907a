"""The ways that a trade-off compares: each method, preset and setting, by name."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from brdffit.fitting.options import QUALITIES, FitOptions
from brdffit.fitting.presets import Quality, get_quality
from brdffit.methods import lobe_method_names
from brdffit.models import model_names

TOLERANCES = (0.5, 0.2, 0.1, 0.03)
NODES = (32, 96, 320, 1280)
#: Group of the ways among which presets are chosen: each preset with these numbers of nodes in its first rule.
SETTING, SETTING_NODES = "setting", (64, 96, 160, 256, 384, 640)
#: Ways that are not timed as whole bakes: the fit, timed by the texel, and the oracle.
FIT, ORACLE = "bfgs", "oracle"


@dataclass(frozen=True)
class Way:
    """One way to fit a level.

    Attributes:
        group: what is varied: method, preset, tolerance, nodes, setting, model, lobe, lights, loss or float; or
            "oracle".
        name: as shown.
        method: name of a method, timed as a whole bake; or FIT or ORACLE.
        options: of the bake.
        quality: overrides the preset of the options, or None.
        float_width: of the sums, 32 or 64.
    """

    group: str
    name: str
    method: str = FIT
    options: FitOptions = FitOptions(lights="point")
    quality: Quality | None = None
    float_width: int = 32


def ways() -> list[Way]:
    """All ways, the closed forms first, the oracle last.

    The half-angle error under point lights is measured, so most ways minimise it.
    """
    standard = get_quality("standard")
    found = [Way("method", name, method=name) for name in lobe_method_names() if name != FIT]
    found += [Way("preset", name, options=FitOptions(lights="point", quality=name)) for name in QUALITIES]
    found += [Way("tolerance", f"{dB:g} dB", options=FitOptions(lights="point", tolerance=dB)) for dB in TOLERANCES]
    found += [Way("nodes", f"{n} nodes", quality=fixed_nodes(standard, n)) for n in NODES]
    found += [
        Way(SETTING, f"{name}, {n} nodes", quality=dataclasses.replace(get_quality(name), nodes=(n, 2 * n, 4 * n)))
        for name in QUALITIES
        for n in SETTING_NODES
    ]
    found += [Way("model", name, options=FitOptions(lights="point", model=name)) for name in model_names()]
    found += [
        Way("lobe", "isotropic", options=FitOptions(lights="point", lobe="isotropic")),
        Way("lobe", "mean normal", options=FitOptions(lights="point", normal="mean")),
        Way("lobe", "isotropic, mean normal", options=FitOptions(lights="point", lobe="isotropic", normal="mean")),
        Way("lobe", "held colour", options=FitOptions(lights="point", specular="held")),
        Way("lights", "mixed", options=FitOptions()),
        Way("loss", "relative", options=FitOptions(lights="point", loss="relative")),
        Way("loss", "l1", options=FitOptions(lights="point", loss="l1")),
        Way("float", "64-bit sums", float_width=64),
        Way("oracle", "oracle", method=ORACLE),
    ]
    return found


def fixed_nodes(quality: Quality, nodes: int) -> Quality:
    """A preset with this many nodes for every texel, whatever its error estimate is."""
    return dataclasses.replace(quality, nodes=(nodes, nodes, nodes), trusted=math.inf)
