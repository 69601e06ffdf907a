"""What a trade-off compares: each method, preset and setting of the fit, by name."""

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
#: Group of the candidates among which presets are chosen: each preset with these numbers of nodes in its first rule.
SETTING, SETTING_NODES = "setting", (64, 96, 160, 256, 384, 640)
#: Candidates that are not timed as whole bakes: the fit, timed by the texel, and the oracle.
FIT, ORACLE = "bfgs", "oracle"


@dataclass(frozen=True)
class Candidate:
    """A method with its options, to be measured beside the others.

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


def candidates() -> list[Candidate]:
    """All candidates, the closed forms first, the oracle last.

    The half-angle error under point lights is measured, so most candidates minimise it.
    """
    standard = get_quality("standard")
    found = [Candidate("method", name, method=name) for name in lobe_method_names() if name != FIT]
    found += [Candidate("preset", name, options=FitOptions(lights="point", quality=name)) for name in QUALITIES]
    found += [
        Candidate("tolerance", f"{dB:g} dB", options=FitOptions(lights="point", tolerance=dB)) for dB in TOLERANCES
    ]
    found += [Candidate("nodes", f"{n} nodes", quality=fixed_nodes(standard, n)) for n in NODES]
    found += [
        Candidate(
            SETTING, f"{name}, {n} nodes", quality=dataclasses.replace(get_quality(name), nodes=(n, 2 * n, 4 * n))
        )
        for name in QUALITIES
        for n in SETTING_NODES
    ]
    found += [Candidate("model", name, options=FitOptions(lights="point", model=name)) for name in model_names()]
    found += [
        Candidate("lobe", "isotropic", options=FitOptions(lights="point", lobe="isotropic")),
        Candidate("lobe", "mean normal", options=FitOptions(lights="point", normal="mean")),
        Candidate(
            "lobe", "isotropic, mean normal", options=FitOptions(lights="point", lobe="isotropic", normal="mean")
        ),
        Candidate("lobe", "held colour", options=FitOptions(lights="point", specular="held")),
        Candidate("lights", "mixed", options=FitOptions()),
        Candidate("loss", "relative", options=FitOptions(lights="point", loss="relative")),
        Candidate("loss", "l1", options=FitOptions(lights="point", loss="l1")),
        Candidate("float", "64-bit sums", float_width=64),
        Candidate("oracle", "oracle", method=ORACLE),
    ]
    return found


def fixed_nodes(quality: Quality, nodes: int) -> Quality:
    """A preset with this many nodes for every texel, whatever its error estimate is."""
    return dataclasses.replace(quality, nodes=(nodes, nodes, nodes), trusted=math.inf)
