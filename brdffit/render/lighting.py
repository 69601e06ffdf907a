"""What lights a picture, and its pixels, as the compiled loops read them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.render import lights as light_sets
from brdffit.render._packing import environment_kernels, shading_kernels
from brdffit.render.environment import Environment
from brdffit.render.lights import Lights
from brdffit.render.scenes import Scene
from brdffit.render.terms import Terms

#: Harmonics of a light that has none: the diffuse part is lit by other means.
_NO_HARMONICS = np.zeros((1, 2, 9, 3), np.float32)


class Lit(NamedTuple):
    """What lights a picture and which terms of the BRDF are lit."""

    lights: Lights | None
    environment: Environment | None
    terms: Terms

    @classmethod
    def by(cls, lights: Lights | None, environment: Environment | None, terms: Terms) -> Lit:
        """Lights, an environment, or both; the few small lights where neither is given."""
        return cls(light_sets.few() if lights is None and environment is None else lights, environment, terms)

    @property
    def sampled(self) -> bool:
        """Whether directions of light are sampled: under an environment or lamps that have a size."""
        return self.environment is not None or (self.lights is not None and bool(self.lights.radius.any()))


class Pass(NamedTuple):
    """A compiled loop, what it reads of one kind of light, and of pixels: arrays of one row each.

    ``sampled``: whether directions of light are sampled, so that two halves of a picture differ.
    """

    loop: Any
    kernels: tuple[Any, ...]
    data: tuple[NDArray, ...]
    pixels: tuple[NDArray, ...]
    sampled: bool

    def of_pixels(self, part: slice) -> tuple[NDArray, ...]:
        """What the loop reads of some pixels."""
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
    found = []
    lights, terms = lit.lights, lit.terms

    def add_directional(lights: Lights, terms: Terms) -> None:
        data = lights.direction.astype(np.float64), lights.irradiance.astype(np.float64)
        found.append(Pass(loop(), shading_kernels(model, terms), data, (view, frame), False))

    if lights is not None:
        points, lamps = lights.part(lights.radius == 0.0), lights.part(lights.radius > 0.0)
        if points is not None:
            add_directional(points, terms)
        if lamps is not None:
            if terms.diffuse:
                add_directional(lamps, dataclasses.replace(terms, lobe=False))
            which = np.zeros(len(key), np.int64)
            kernels = environment_kernels(model, dataclasses.replace(terms, diffuse=False), lamps=True)
            data = lamps.table, lamps.discs, _NO_HARMONICS
            found.append(Pass(sampling_loop(), kernels, data, (key, which, view, frame), True))
    if lit.environment is not None:
        turned = lit.environment.turned(frame)
        up, which = np.unique(np.round(turned[:, 2], 6), axis=0, return_inverse=True)
        harmonics = lit.environment.harmonics(up, terms.fresnel, terms.cosine, terms.clips)
        data = lit.environment.table, lit.environment.picture, harmonics
        which = np.ascontiguousarray(which.reshape(-1), np.int64)
        pixels = key, which, view, turned
        found.append(Pass(sampling_loop(), environment_kernels(model, terms), data, pixels, True))
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
