"""The effects that a scene may call for: what each one is, and what changes when it is off.

An effect is a small change of a bake's options, of the maps that are read, or of the terms of the judge, the reference
renderer of a comparison. A new effect is one more entry here; its contribution and cost are measured (``trial``), and a
plan decides whether it stays (``plan``).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from brdffit.fitting.options import FitOptions
from brdffit.render.terms import Terms


@dataclass(frozen=True)
class Effect:
    """One effect.

    Attributes:
        name: in scene files.
        title: in tables.
        absent: what happens without it, for the sentences of plans.
        on, off: fields of ``FitOptions`` with it and without it.
        unread: roles of maps that are not read without it.
        terms: fields of the judge's ``Terms`` that are False without it.
        judge: whether it belongs to the judge alone: it changes what a comparison simulates, but no pyramid.
        extra: whether it is an extra pass of the fit, which is on only if it is shown to help.
        traced: whether it needs the height traced as a surface, since no map shows it; such effects are the judge's.
    """

    name: str
    title: str
    absent: str
    on: Mapping[str, Any] = field(default_factory=dict)
    off: Mapping[str, Any] = field(default_factory=dict)
    unread: tuple[str, ...] = ()
    terms: tuple[str, ...] = ()
    judge: bool = False
    extra: bool = False
    traced: bool = False


EFFECTS: tuple[Effect, ...] = (
    Effect(
        "normals", "variation of normals", "every normal is that of the surface; no normal or height map is read",
        on={"normal": "free"}, off={"normal": "mean"}, unread=("normal", "height"),
    ),
    Effect(
        "anisotropy", "anisotropy of the lobes", "one roughness for all directions",
        on={"lobe": "anisotropic"}, off={"lobe": "isotropic"},
    ),
    Effect(
        "scale", "free specular scale", "the filtered specular colour is held",
        on={"specular": "auto"}, off={"specular": "held"},
    ),
    Effect(
        "colour", "three colour channels in the fit", "one fit of the luminance serves all channels",
        on={"colour": "channels"}, off={"colour": "shared"},
    ),
    Effect(
        "correlation", "correlation of colour with normals and roughness", "all texels of a footprint count alike",
        on={"correlation": True}, off={"correlation": False},
    ),
    Effect(
        "coupling", "diffuse light from the varying normals", "the diffuse colour is averaged plainly",
        on={"coupling": True}, off={"coupling": False},
    ),
    Effect(
        "level_0", "pixel filter at level 0", "level 0 stays as authored",
        on={"keep_level_0": False}, off={"keep_level_0": True},
    ),
    Effect(
        "horizon", "lobes cut at their own horizon", "lobes go on below it",
        on={"horizon": True}, off={"horizon": False},
    ),
    Effect(
        "refinement", "refinement for interpolation between texels and levels", "every texel is fitted for its centre",
        on={"refine": True}, off={"refine": False}, extra=True,
    ),
    Effect(
        "texels", "the same work in every texel", "each texel is given no more work than the budget asks for",
        on={"tolerance": None}, off={"tolerance": 0.1},
    ),
    Effect(
        "masking", "masking and shadowing in the judge", "microfacets hide none of each other",
        terms=("masking",), judge=True,
    ),
    Effect(
        "fresnel", "Fresnel in the judge", "reflectance is that at normal incidence", terms=("fresnel",), judge=True
    ),
    Effect(
        "environment", "light from the environment in the judge", "only the lights of the scene shine", judge=True
    ),
    Effect(
        "parallax", "parallax and masking by the height", "the surface is flat to its viewer", judge=True, traced=True
    ),
    Effect(
        "shadowing", "shadows that the height throws", "every point sees the light", judge=True, traced=True
    ),
    Effect(
        "interreflection", "light between the hills of the height", "light is reflected once", judge=True, traced=True
    ),
)  # fmt: skip

BY_NAME = {effect.name: effect for effect in EFFECTS}
NAMES = tuple(BY_NAME)


@dataclass(frozen=True)
class Setup:
    """The settings of a bake and of the judge that follow from a set of effects.

    Attributes:
        options: of the bake.
        unread: roles of maps that are not read.
        terms: of the judge.
        environment: whether the judge uses the environment as a light.
    """

    options: FitOptions
    unread: tuple[str, ...] = ()
    terms: Terms = field(default_factory=Terms)
    environment: bool = True


def setup(options: FitOptions, off: Collection[str] = (), tolerance: float = 0.1) -> Setup:
    """The settings with everything on except the effects named in ``off``.

    Args:
        options: of the scene: model, quality, pixel filter, reach.
        off: names of effects.
        tolerance: dB, of a bake without "texels".
    """
    changes: dict[str, Any] = {}
    unread: list[str] = []
    terms: dict[str, bool] = {}
    for effect in EFFECTS:
        gone = effect.name in off
        changes |= effect.off if gone else effect.on
        if gone:
            unread += effect.unread
            terms |= dict.fromkeys(effect.terms, False)
    if "texels" in off:
        changes["tolerance"] = tolerance
    return Setup(
        dataclasses.replace(options, **changes), tuple(unread), Terms(**terms), environment="environment" not in off
    )
