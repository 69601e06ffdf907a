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
        group: what is varied: method, preset, tolerance, nodes, setting, model, lobe, lights, loss, energy or float; or
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
    options: FitOptions = FitOptions()
    quality: Quality | None = None
    float_width: int = 32


def candidates() -> list[Candidate]:
    """All candidates, the closed forms first, the oracle last.

    The default fit's own error is measured, so those of other lights and losses show what their choice costs.
    """
    standard = get_quality("standard")
    found = [Candidate("method", name, method=name) for name in lobe_method_names() if name != FIT]
    found += [Candidate("preset", name, options=FitOptions(quality=name)) for name in QUALITIES]
    found += [Candidate("tolerance", f"{dB:g} dB", options=FitOptions(tolerance=dB)) for dB in TOLERANCES]
    found += [Candidate("nodes", f"{n} nodes", quality=fixed_nodes(standard, n)) for n in NODES]
    found += [
        Candidate(
            SETTING, f"{name}, {n} nodes", quality=dataclasses.replace(get_quality(name), nodes=(n, 2 * n, 4 * n))
        )
        for name in QUALITIES
        for n in SETTING_NODES
    ]
    found += [Candidate("model", name, options=FitOptions(model=name)) for name in model_names()]
    found += [
        Candidate("lobe", "isotropic", options=FitOptions(lobe="isotropic")),
        Candidate("lobe", "mean normal", options=FitOptions(normal="mean")),
        Candidate("lobe", "isotropic, mean normal", options=FitOptions(lobe="isotropic", normal="mean")),
        Candidate("lobe", "held colour", options=FitOptions(specular="held")),
        Candidate("lobe", "free colour", options=FitOptions(specular="free")),
        Candidate("lights", "point lights", options=FitOptions(lights="point")),
        Candidate("lights", "lamps of 10 degrees", options=FitOptions(lights="10")),
        Candidate("lights", "2 to 40 degrees in five sizes", options=FitOptions(lights="2,5,10,20,40")),
        *(Candidate("loss", name, options=FitOptions(loss=name)) for name in ("l2", "seen", "relative", "l1")),
        *(Candidate("energy", f"{share:g} of an even light", options=FitOptions(energy=share)) for share in (0.1, 0.3)),
        Candidate("float", "64-bit sums", float_width=64),
        Candidate("oracle", "oracle", method=ORACLE),
    ]
    return found


def fixed_nodes(quality: Quality, nodes: int) -> Quality:
    """A preset with this many nodes for every texel, whatever its error estimate is."""
    return dataclasses.replace(quality, nodes=(nodes, nodes, nodes), trusted=math.inf)
