"""Effects that a scene settles without a measurement, because they cannot be seen, stored or distinguished."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from brdffit.export.presets import get_preset
from brdffit.models import get_model
from brdffit.planning.description import SceneFile
from brdffit.planning.effects import EFFECTS
from brdffit.svbrdf import Svbrdf


class Fact(NamedTuple):
    """A settled effect: the verdict, the reason, and what would change it."""

    on: bool
    why: str
    change: str


def settled(scene: SceneFile, base: Svbrdf, reach: tuple[int, int]) -> dict[str, Fact]:
    """Effects that need no measurement, by name."""
    preset, model = get_preset(scene.target.preset), get_model(scene.model)
    found: dict[str, Fact] = {}
    if reach[0] > 0:
        found["level_0"] = Fact(False, "no camera comes near enough to see it", "a nearer camera")
    elif scene.model != base.model:
        found["level_0"] = Fact(True, f"the set is authored for {base.model}, so level 0 is fitted", "its own model")
    if preset.lobe == "isotropic":
        found["anisotropy"] = Fact(False, f"preset '{preset.name}' has no anisotropy", "a preset that stores it")
    elif model.isotropic:
        found["anisotropy"] = Fact(False, f"{model.name} is isotropic", "an anisotropic model")
    if preset.specular == "held":
        why = f"preset '{preset.name}' has no scale of the lobe to store"
        found["scale"] = Fact(False, why, "a preset that stores a specular colour")
    specular = base.specular
    if not np.any(np.ptp(specular.reshape(-1, 3), axis=0)):
        found["correlation"] = Fact(False, "the specular colour does not vary", "a set in which it does")
        found["colour"] = Fact(False, "the specular colour does not vary", "a set in which it does")
    elif not np.any(np.ptp(specular, axis=2)):
        found["colour"] = Fact(False, "the specular colour is grey", "a coloured set")
    if not np.any(base.diffuse):
        found["coupling"] = Fact(False, "nothing is reflected diffusely", "a set that is not all metal")
    if base.height is None or not np.ptp(base.height):
        for effect in EFFECTS:
            if effect.traced:
                found[effect.name] = Fact(False, "the set has no height map", "a height map")
    if scene.environment is None:
        found["environment"] = Fact(False, "the scene has no environment", "an environment in the scene file")
    elif not scene.lights:
        found["environment"] = Fact(True, "it is the only light", "other lights")
    return found
