"""What is tried: each way to a pyramid, or to one texel's lobe, by name."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from brdffit.fitting.presets import Quality, get_quality
from brdffit.methods import QUALITIES, BakeOptions, method_names
from brdffit.models import model_names

TOLERANCES = (0.5, 0.2, 0.1, 0.03)
NODES = (32, 96, 320, 1280)
#: Group of the ways that presets are chosen among: the samples of each preset, with so many nodes on the first rule.
SETTING, SETTING_NODES = "setting", (64, 96, 160, 256, 384)
FIT = "bfgs"


@dataclass(frozen=True)
class Way:
    """One way to fit a level.

    Attributes:
        group: what is varied: method, preset, tolerance, nodes, setting, model, lobe, loss or float.
        name: as shown.
        method: of the registry; all but "bfgs" are timed as a whole bake.
        options: of the bake.
        quality: overrides the preset of the options, or None.
        float_width: of the sums, 32 or 64.
    """

    group: str
    name: str
    method: str = FIT
    options: BakeOptions = BakeOptions()
    quality: Quality | None = None
    float_width: int = 32


def ways() -> list[Way]:
    """All that is tried, the closed forms first."""
    standard = get_quality("standard")
    # Not every set has the heights that the method of that name filters.
    found = [Way("method", name, method=name) for name in method_names() if name not in (FIT, "height")]
    found += [Way("preset", name, options=BakeOptions(quality=name)) for name in QUALITIES]
    found += [Way("tolerance", f"{dB:g} dB", options=BakeOptions(tolerance=dB)) for dB in TOLERANCES]
    found += [Way("nodes", f"{n} nodes", quality=fixed_nodes(standard, n)) for n in NODES]
    found += [
        Way(SETTING, f"samples of {name}, {n} nodes", quality=_setting(name, n))
        for name in QUALITIES
        for n in SETTING_NODES
    ]
    found += [Way("model", name, options=BakeOptions(model=name)) for name in model_names()]
    found += [
        Way("lobe", "isotropic", options=BakeOptions(lobe="isotropic")),
        Way("lobe", "mean normal", options=BakeOptions(normal="mean")),
        Way("lobe", "isotropic, mean normal", options=BakeOptions(lobe="isotropic", normal="mean")),
        Way("lobe", "held colour", options=BakeOptions(specular="held")),
        Way("loss", "relative", options=BakeOptions(loss="relative")),
        Way("loss", "l1", options=BakeOptions(loss="l1")),
        Way("float", "64-bit sums", float_width=64),
    ]
    return found


def _setting(samples: str, nodes: int) -> Quality:
    """The samples of one preset with rules from so many nodes on; all else as in standard."""
    quality, rules = get_quality(samples), (nodes, 2 * nodes, 4 * nodes)
    return dataclasses.replace(
        get_quality("standard"), least=quality.least, most=quality.most, room=quality.room, step=quality.step,
        merge=quality.merge, nodes=rules,
    )  # fmt: skip


def fixed_nodes(quality: Quality, nodes: int) -> Quality:
    """A preset that takes this many nodes for every texel, whatever its error estimate says."""
    return dataclasses.replace(quality, nodes=(nodes, nodes, nodes), trusted=math.inf)
