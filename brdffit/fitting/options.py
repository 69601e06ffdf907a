"""Options of the nonlinear fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from brdffit.options import LobeOptions, option

QUALITIES = ("draft", "standard", "fine")
#: "auto" is l2 with a free scale under point lights (the half-angle error of the papers), else balanced and bounded.
LOSSES = ("auto", "balanced", "displayed", "seen", "l2", "relative", "l1")
SPECULARS = ("auto", "bounded", "free", "held")
COLOURS = ("channels", "shared")


def _check_lights(lights: str) -> None:
    from brdffit.halfangle.lights import sizes_of  # numba

    sizes_of(lights, 1.0, 1.0)


@dataclass(frozen=True)
class FitOptions(LobeOptions):
    """Options of the nonlinear fit. ``brdffit plan`` chooses ``lights``, ``reach`` and the effects for a scene."""

    group: ClassVar[str] = "fit"

    quality: str = option("standard", "sampling, quadrature and end of the search", names=QUALITIES)
    tolerance: float | None = option(
        None, "instead of a quality: dB that a level's SNR may stay below the best lobe's", above=0.0
    )
    lights: str = option(
        "mixed", "lights to look right under: point, sun, lamp, window, sky, mixed, or radii in degrees (2,10:0.5)",
        check=_check_lights,
    )  # fmt: skip
    loss: str = option(
        "auto", "displayed: as a screen shows errors; balanced: and l2 from afar; l2: peaks; relative, l1: tails",
        names=LOSSES,
    )  # fmt: skip
    energy: float = option(0.0, "share of a light from everywhere, which sees a lobe's energy alone", least=0.0)
    refine: bool = option(
        False,
        "fit also what a renderer interpolates, in l2 under points (docs/maths.md)",
    )
    specular: str = option(
        "auto", "scale of the lobe: fitted freely, bounded to 0.91 to 1.09 of the filtered colour, or held",
        names=SPECULARS,
    )  # fmt: skip
    normal: str = option("free", "fit the normal, or hold the mean", names=("free", "mean"))
    reach: tuple[int, int] | None = option(None, "first and last level that pixels read; the others are averaged")
    colour: str = option("channels", "fit red, green and blue together, or their luminance", names=COLOURS)
    correlation: bool = option(True, "colours weigh the lobes of a footprint; without, all lobes count alike")
    coupling: bool = option(True, "average diffuse colour and normal together, so that bright sides of bumps stay")
    horizon: bool = option(True, "lobes end at their own horizon, n.h = 0, in the search")
