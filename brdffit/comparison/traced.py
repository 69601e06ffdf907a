"""A comparison with the height traced as a surface: level by level at 45 degrees (Kuznetsov et al. 2021, Table 3).

Maps are compared with a truth that has parallax, masking, shadows and interreflection. They cannot show these; a neural
material beside them can. The light's irradiance on the plane is pi: a white matt plane has the radiance 1, so that mean
squared errors of linear radiance are on the scale of the paper's.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator

import msgspec
import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import Truth
from brdffit.comparison.options import SMALL_LIGHTS
from brdffit.comparison.views import Announce, Drawn, Still, Studio, pictures_of, take, view_of
from brdffit.methods import Material
from brdffit.microgeometry.tracer import Effects, Microgeometry
from brdffit.render.lights import Lights
from brdffit.render.scenes import tilted
from brdffit.report.records import LEVEL_GROUP, View
from brdffit.svbrdf import Svbrdf

#: Methods of the table where none are named, and the one that joins them where one of its options is given.
METHODS, NEURAL = ("naive", "vmf", "lean", "bfgs", "height", "ndm"), "neural"
#: Degrees between the view and the plane's normal, and levels that are seen.
_TILT, _LEVELS = 45.0, 8
#: A little to the left, and from above.
_LIGHT = np.array([-0.5, 0.35, 1.0])


def traced_truth(
    material: Material,
    effects: Effects = Effects(bounces=1),  # noqa: B008
    threads: int | None = None,
) -> Microgeometry:
    """The height of a set as a surface, with these effects.

    Raises:
        InputError: when the set has no height map.
    """
    return Microgeometry.of(material.svbrdf, effects, threads=threads)


def methods_of_table(options: Iterable[str]) -> tuple[str, ...]:
    """Methods of a table where none are named: with the neural material if one of its options is given."""
    return (*METHODS, NEURAL) if any(name.startswith(f"{NEURAL}.") for name in options) else METHODS


def tilted_views(
    truth: Svbrdf | Truth, drawn: Drawn, depth: int, studio: Studio, announce: Announce = lambda what: None
) -> Iterator[tuple[View, dict[str, NDArray]]]:
    """A view of each level that the studio reaches, at 45 degrees, with its pictures as ``views.all_views`` has them.

    Args:
        truth: what is seen.
        drawn: results by name of the method.
        depth: number of levels that all of them have.
        studio: pixels and samples.
        announce: called before each picture.
    """
    direction = _LIGHT / np.linalg.norm(_LIGHT)
    light = Lights(direction[None], np.full((1, 3), math.pi / direction[2]))
    one = dataclasses.replace(studio, lights=light, lit=(SMALL_LIGHTS,))
    side = max(studio.pixels // 2, 16)
    last = min(depth, _LEVELS) - 1
    first, last = (min(level, last) for level in studio.reach or (0, last))
    for level in range(first, last + 1):
        announce(f"level {level} at {_TILT:g} degrees")
        scene = tilted(truth.size, level, (side, side), _TILT)
        still = Still(
            f"level-{level}", LEVEL_GROUP, f"Level {level} at {_TILT:g} degrees", scene, SMALL_LIGHTS, "", level
        )
        taken = take(truth, drawn, scene, SMALL_LIGHTS, one)
        view = view_of(still, taken)
        first, second = taken.reference.halves.astype(np.float64)
        for shot in view.shots:
            picture = taken.methods[shot.method].mean(axis=0)
            assert shot.figures is not None
            # Free of the truth's own noise, which is independent in its halves.
            mse = float(((picture - first) * (picture - second)).mean())
            shot.figures = msgspec.structs.replace(shot.figures, mse=mse)
        yield view, pictures_of(taken, view.exposure)
