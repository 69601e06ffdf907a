"""Lobe models: one file each, with its paper, its formula and its kernels.

Every lobe here has the form ``D(h; n, Sigma) = K(s) / (pi sqrt(det Sigma)) * profile(q, C; s)`` with

- ``q = x' Sigma^-1 x``, x the tangent-plane part of h in the frame of n (that of the shortest rotation from z to n),
- ``C = (n.h)^2``,
- ``s`` a shape parameter, where the model has one, and K(s) its factor in the normalisation.

So a model is a profile with its derivatives; the loops are written once, elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from brdffit.errors import UnknownNameError


@dataclass(frozen=True)
class Model:
    """A lobe model.

    Attributes:
        name: as on the command line.
        summary: one line.
        profile: kernel (q, C, s) -> value.
        profile_gradient: kernel (q, C, s) -> value and its derivatives by q, C and s.
        log_normalisation: kernel s -> (log K, d log K / d s).
        shape_bounds: (low, default, high) of the shape parameter s, or None where there is none.
        source: the paper.
        isotropic: whether the model has only one roughness; fits then hold the tensor isotropic.
        widening: the sharp lobe nearest to the average over normals of covariance C (in units of alpha^2): log alpha^2
            grows by the first number times half the trace of C, log Sigma by the second times the deviator of C, and
            the scale by the growth of det Sigma to the power of the third. A Gaussian peak has (2, 2, 0).
        averages: whether the profile is (q + C)^-2, whose mean over normals ``quadrature.mean_over_normals`` knows.
        blur: b, where a light whose disc moves half vectors by up to R adds b R^2 to alpha^2, so that the wider lobe is
            the nearest in L2 (docs/maths.md). For a Gaussian peak b is 1/2 for a small light (twice the disc's variance
            along an axis over R^2), 0.55 at R = alpha and 0.63 at 2 alpha.
    """

    name: str
    summary: str
    profile: Any
    profile_gradient: Any
    log_normalisation: Any
    source: str
    shape_bounds: tuple[float, float, float] | None = None
    isotropic: bool = False
    widening: tuple[float, float, float] = (2.0, 2.0, 0.0)
    averages: bool = False
    blur: float = 0.58

    @property
    def default_shape(self) -> float:
        """Shape parameter of a lobe for which none is given."""
        return self.shape_bounds[1] if self.shape_bounds else 0.0


def model_names() -> list[str]:
    """Names of the installed models, the default first."""
    names = sorted(point.name for point in entry_points(group="brdffit.models"))
    return sorted(names, key=lambda name: name != "ggx")


@cache
def get_model(name: str) -> Model:
    """The model of this name.

    Raises:
        UnknownNameError: with the nearest known name.
    """
    for point in entry_points(group="brdffit.models"):
        if point.name == name:
            return point.load()
    raise UnknownNameError("model", name, model_names())
