"""The error landscape of one texel (Baker): error over roughness and normal, and the path that the optimiser took.

The path is that of the fit itself: its compiled search is run from the same start for one step, for two, and so on.
The landscape is drawn over a plane through the end of the search: one axis scales the roughness, the other leans the
normal towards the start. All other parameters keep their values at the end of the search, so that the end of the path
lies on the surface, and the points before it are projections.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import numba_type
from brdffit.errors import InputError
from brdffit.fitting.batch import model_kernels
from brdffit.fitting.bfgs import make_space, minimise
from brdffit.fitting.method import search_settings
from brdffit.fitting.options import FitOptions
from brdffit.fitting.presets import get_quality
from brdffit.fitting.solvers import Problem
from brdffit.halfangle.apparent_lobe import base_of
from brdffit.halfangle.closed_forms import LEAN, VMF
from brdffit.halfangle.measure import dense_strata
from brdffit.halfangle.quadrature import lattice
from brdffit.models import get_model
from brdffit.options import make_options
from brdffit.svbrdf import Svbrdf, level_sizes

#: Points along each side of the picture.
SIDE = 64
#: Nodes of the rule, and samples of the footprint along an axis.
_NODES, _SAMPLES = 2048, (32, 128)
#: How far the picture reaches beyond the path: a factor of alpha, lobe widths of the normal.
_MARGIN_ALPHA, _MARGIN_WIDTHS = 3.0, 2.5


@dataclass(frozen=True)
class Landscape:
    """Error of one texel's lobe over a plane of its parameters.

    Attributes:
        level, column, row: the texel.
        roughness: (n,) alpha of the lobe, the fourth root of det Sigma, ascending.
        angle: (n,) degrees by which the normal leans from where the search ended.
        error: (n, n) relative squared error with the best scale; rows go with ``angle``.
        path: (k, 2) of (alpha, angle), from the start to the end.
        values: (k,) relative squared error along the path.
    """

    level: int
    column: int
    row: int
    roughness: NDArray
    angle: NDArray
    error: NDArray
    path: NDArray
    values: NDArray


def landscape(svbrdf: Svbrdf, level: int, texel: tuple[int, int], *, model: str = "ggx",
              side: int = SIDE) -> Landscape:  # fmt: skip
    """The landscape of one texel (column, row) of a level.

    Raises:
        InputError: when the set has no such level or the level no such texel.
        UnknownNameError: for an unknown model.
    """
    size = _checked_size(svbrdf, level, texel)
    source, target = get_model(svbrdf.model), get_model(model)
    options = make_options(FitOptions, {"model": model}, "'bfgs'")
    base, kernels = base_of(svbrdf, source.default_shape), model_kernels(source.name, target.name)
    search = search_settings(options, get_quality("fine"), base, source, target)
    strata = dense_strata(svbrdf.size, size, options.pixel_filter, _SAMPLES)
    problem = Problem(strata, lattice(_NODES), search, kernels)
    starts = problem.set_footprint(base, *texel)
    start = min((problem.clamped(starts[k]) for k in (LEAN, VMF)), key=problem.value)
    steps = _path(problem, start)
    end = steps[-1]

    away = start[0:2] - end[0:2]
    tensor_axis = _long_axis(end[2:5])
    leaning = float(np.hypot(*away))
    direction = away / leaning if leaning > 1e-6 else tensor_axis
    alphas = np.array([_alpha(theta) for theta in steps])
    along = np.array([float((theta[0:2] - end[0:2]) @ direction) for theta in steps])
    width = _MARGIN_WIDTHS * max(float(alphas[-1]), 1e-3)
    roughness = np.geomspace(alphas.min() / _MARGIN_ALPHA, min(alphas.max() * _MARGIN_ALPHA, 1.5), side)
    slopes = np.linspace(min(along.min(), 0.0) - width, max(along.max(), 0.0) + width, side)
    error = np.empty((side, side))
    for j, alpha in enumerate(roughness):
        for i, slope in enumerate(slopes):
            error[i, j] = 1.0 + _value(problem, _moved(end, alpha, slope * direction))
    return Landscape(
        level=level, column=texel[0], row=texel[1], roughness=roughness,
        angle=np.array([_angle(end, slope, direction) for slope in slopes]), error=np.clip(error, 0.0, None),
        path=np.stack([alphas, [_angle(end, slope, direction) for slope in along]], axis=1),
        values=np.array([1.0 + _value(problem, theta) for theta in steps]),
    )  # fmt: skip


def _path(problem: Problem, start: NDArray) -> NDArray:
    """Parameters (k, 6) after each step of the fit's search, the start first."""
    search, kernels = problem.search, problem.kernels
    theta, space = start.copy(), make_space()

    def arguments(most: int) -> tuple:
        return (theta, value, search.free, problem.table, problem.setting, kernels.moments,
                kernels.log_normalisation, search.tolerance, search.floor, most, search.rescaled, space,
                math.inf)  # fmt: skip

    value = float(problem.value(start))
    minimise.compile(tuple(map(numba_type, arguments(1))))
    steps = [start]
    for most in range(1, search.iterations + 1):
        theta[:] = start
        value = float(problem.value(start))
        space.gradient[:] = problem.gradient
        minimise(*arguments(most))
        end = problem.clamped(theta)
        if np.array_equal(end, steps[-1]):
            break
        steps.append(end)
    return np.array(steps)


def _value(problem: Problem, theta: NDArray) -> float:
    return float(problem.value(theta))


def _alpha(theta: NDArray) -> float:
    """Fourth root of det Sigma."""
    return math.exp(0.25 * (theta[2] + theta[3]))


def _moved(end: NDArray, alpha: float, slope: NDArray) -> NDArray:
    """The end of the search with another size of the lobe and another slope of the normal."""
    theta = end.copy()
    theta[0:2] += slope
    theta[2:4] += 2.0 * (math.log(alpha) - math.log(_alpha(end)))
    return theta


def _angle(end: NDArray, distance: float, direction: NDArray) -> float:
    """Degrees between the normals at the end and at a slope so far along a direction from it; signed as the distance.

    Slopes along a straight line turn the normal in one plane, so the angle grows with the distance.
    """
    one, other = (np.array([-m[0], -m[1], 1.0]) for m in (end[0:2], end[0:2] + distance * direction))
    # From the cross product: the arc cosine of nearly 1 would lose small angles.
    degrees = math.degrees(math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other)))
    return math.copysign(degrees, distance)


def _long_axis(log_tensor: NDArray) -> NDArray:
    """Unit vector (2,) along which the lobe is widest."""
    a, b, c = log_tensor
    return np.linalg.eigh([[a, c], [c, b]])[1][:, 1]


def _checked_size(svbrdf: Svbrdf, level: int, texel: tuple[int, int]) -> tuple[int, int]:
    sizes = level_sizes(svbrdf.size)
    if not 0 <= level < len(sizes):
        of = f"{svbrdf.size[1]}x{svbrdf.size[0]}"
        raise InputError(f"A set of {of} texels has no level {level}, expected 0 to {len(sizes) - 1}.")
    height, width = sizes[level]
    if not (0 <= texel[0] < width and 0 <= texel[1] < height):
        raise InputError(
            f"Level {level} has no texel {texel[0]},{texel[1]}, "
            f"expected column 0 to {width - 1} and row 0 to {height - 1}."
        )
    return sizes[level]
