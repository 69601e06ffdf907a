"""The cost of the judge's effects: seconds of a comparison's pictures, from a few pixels of one picture."""

from __future__ import annotations

import functools

from brdffit.planning.effects import BY_NAME
from brdffit.planning.trial import timed
from brdffit.render.environment import Environment
from brdffit.render.lights import Lights
from brdffit.render.reference import render_halves
from brdffit.render.scenes import plane
from brdffit.render.terms import Terms
from brdffit.svbrdf import Svbrdf

#: Side of the picture that is timed; pixels of one set's pictures in a comparison, under lights and an environment.
_SIDE, _PIXELS, _PIXELS_AROUND = 16, 5 * 192 * 192, 3 * 128 * 128
_REPEATS = 2


def judge_costs(
    base: Svbrdf, level: int, lights: Lights | None, environment: Environment | None, threads: int | None
) -> dict[str, float]:
    """Seconds that each effect of the judge adds to the reference pictures of a comparison, by its name.

    Args:
        base: the set. level: at which it is seen. lights, environment: of the scene, if it has any.
    """
    scene = plane(base.size, level, (_SIDE, _SIDE))

    def seconds(terms: Terms, lit: Lights | None, around: Environment | None) -> float:
        draw = functools.partial(
            render_halves, base, scene, lit, environment=around, terms=terms, samples="draft", threads=threads
        )
        return min(timed(draw, threads) for _ in range(_REPEATS)) / _SIDE**2

    found = {}
    if lights is not None or environment is None:
        whole = seconds(Terms(), lights, None)
        for name in ("masking", "fresnel"):
            terms = Terms(**dict.fromkeys(BY_NAME[name].terms, False))
            found[name] = (whole - seconds(terms, lights, None)) * _PIXELS
    if environment is not None:
        found["environment"] = seconds(Terms(), None, environment) * _PIXELS_AROUND
    return found
