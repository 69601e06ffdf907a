"""What lights a picture, and its pixels, as the compiled loops read them."""

from __future__ import annotations

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


class Lighting(NamedTuple):
    """A compiled loop, and what it reads of one kind of light: directional lights, or an environment."""

    loop: Any
    kernels: tuple[Any, ...]
    data: tuple[NDArray, ...]
    environment: Environment | None

    def pixels(self, key: NDArray, view: NDArray, frame: NDArray) -> tuple[NDArray, ...]:
        """What the loop reads of pixels."""
        return (view, frame) if self.environment is None else (key, view, self.environment.turned(frame))


def lightings(
    lights: Lights | None, environment: Environment | None, model: str, terms: Terms,
    loop: Callable[[], Any], environment_loop: Callable[[], Any],
) -> list[Lighting]:  # fmt: skip
    """What lights a picture: lights, an environment, or both; the few small lights where neither is given."""
    found = []
    if lights is None and environment is None:
        lights = light_sets.few()
    if lights is not None:
        data = lights.direction.astype(np.float64), lights.irradiance.astype(np.float64)
        found.append(Lighting(loop(), shading_kernels(model, terms), data, None))
    if environment is not None:
        harmonics = environment.harmonics(terms.fresnel, terms.cosine, terms.clips)
        around = environment.table, environment.picture, harmonics
        found.append(Lighting(environment_loop(), environment_kernels(model, terms), around, environment))
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
