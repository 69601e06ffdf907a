"""The light of a picture, and its pixels, as the compiled loops read them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.methods import one_of
from brdffit.render import lights as light_sets
from brdffit.render._packing import environment_kernels, shading_kernels
from brdffit.render.environment import Environment
from brdffit.render.lights import Lights
from brdffit.render.scenes import Scene
from brdffit.render.terms import Terms

#: Harmonics of a light that has none: the diffuse part is lit by other means.
_NO_HARMONICS = np.zeros((1, 2, 9, 3), np.float32)


#: How lamps are drawn: by directions in their discs, or as points while lobes are widened to make up for it.
LAMPS = ("sampled", "widened")
#: A disc of angular radius r moves the half vector within r / 2 and so blurs a lobe. The GGX lobe of the same scale
#: that is nearest to a blurred GGX lobe has an alpha^2 larger by this times (r / 2)^2 (0.75 at r / 2 = alpha / 4, 0.70
#: at 4 alpha).
_WIDENING = 0.74


class Lit(NamedTuple):
    """The light of a picture, and the terms of the BRDF that are simulated; ``lamps`` is one of `LAMPS`."""

    lights: Lights | None
    environment: Environment | None
    terms: Terms
    lamps: str

    @classmethod
    def by(cls, lights: Lights | None, environment: Environment | None, terms: Terms, lamps: str = "sampled") -> Lit:
        """Lights, an environment, or both; the few small lights where neither is given."""
        lamps = one_of("way to draw lamps", lamps, LAMPS)
        return cls(light_sets.few() if lights is None and environment is None else lights, environment, terms, lamps)

    @property
    def discs(self) -> Lights | None:
        """The lights whose discs are sampled, or None."""
        if self.lights is None or self.lamps == "widened" or not self.lights.radius.any():
            return None
        return self.lights.part(self.lights.radius > 0.0)

    @property
    def sampled(self) -> bool:
        """Whether directions of light are sampled: under an environment or lamps that have a size."""
        return self.environment is not None or self.discs is not None


class Pass(NamedTuple):
    """A compiled loop, what it reads of one kind of light, and of pixels: arrays of one row each.

    ``sampled``: whether directions of light are sampled, so that two halves of a picture differ.
    """

    loop: Any
    kernels: tuple[Any, ...]
    data: tuple[Any, ...]
    pixels: tuple[NDArray, ...]
    sampled: bool

    def of_pixels(self, part: slice) -> tuple[NDArray, ...]:
        """The loop's arrays for some pixels."""
        return tuple(each[part] for each in self.pixels)


def passes(
    lit: Lit, model: str, key: NDArray, view: NDArray, frame: NDArray,
    loop: Callable[[], Any], sampling_loop: Callable[[], Any],
) -> list[Pass]:  # fmt: skip
    """The passes over pixels that make a picture.

    Args:
        lit: what lights it.
        model: lobe model.
        key, view, frame: (P,), (P, 3) and (P, 3, 3) of the pixels.
        loop, sampling_loop: the drivers for directional lights, and for light that has a size.
    """
    found: list[Pass] = []
    lights, terms = lit.lights, lit.terms

    def add_directional(lights: Lights, terms: Terms, widen: float = 0.0) -> None:
        data = lights.direction.astype(np.float64), lights.irradiance.astype(np.float64), widen
        found.append(Pass(loop(), shading_kernels(model, terms), data, (view, frame), False))

    for radius, alike in () if lights is None else lights.by_radius():
        if radius == 0.0 or lit.lamps == "widened":
            add_directional(alike, terms, _WIDENING * (0.5 * radius) ** 2)
        elif terms.diffuse:
            add_directional(alike, dataclasses.replace(terms, lobe=False))
    discs = lit.discs
    if discs is not None:
        which = np.zeros(len(key), np.int64)
        kernels = environment_kernels(model, dataclasses.replace(terms, diffuse=False), lamps=True)
        data = discs.table, discs.discs, _NO_HARMONICS
        found.append(Pass(sampling_loop(), kernels, data, (key, which, view, frame), True))
    if lit.environment is not None:
        turned = lit.environment.turned(frame)
        up, which = np.unique(np.round(turned[:, 2], 6), axis=0, return_inverse=True)
        harmonics = lit.environment.harmonics(up, terms.fresnel, terms.cosine, terms.clips)
        around = lit.environment.table, lit.environment.picture, harmonics
        which = np.ascontiguousarray(which.reshape(-1), np.int64)
        pixels = key, which, view, turned
        found.append(Pass(sampling_loop(), environment_kernels(model, terms), around, pixels, True))
    return found


class Pixels:
    """The covered pixels of a scene, one after another, as the loops want them: contiguous, double precision."""

    def __init__(self, scene: Scene) -> None:
        self.rows, self.columns = np.nonzero(scene.coverage > 0.0)
        at = self.rows, self.columns
        self.key = (self.rows * 65536 + self.columns).astype(np.int64)
        self.centre, self.axes, self.view, self.frame = (
            np.ascontiguousarray(array[at], np.float64) for array in (scene.centre, scene.axes, scene.view, scene.frame)
        )
