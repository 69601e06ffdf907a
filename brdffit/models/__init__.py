"""Lobe models: one file each, with its paper, its formula and its kernels.

Every lobe here has the form ``D(h; n, Sigma) = K(s) / (pi sqrt(det Sigma)) * profile(q, C; s)`` with

- ``q = x' Sigma^-1 x``, x the tangent-plane part of h in the frame of n (the rotation that takes z to n by the
  shortest way),
- ``C = (n.h)^2``,
- ``s`` a shape parameter, where the model has one, and K(s) what it adds to the normalisation,

so a model is a profile with its derivatives, and every loop is written once, elsewhere.
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
        isotropic: whether the model knows only one roughness; its fits hold the tensor isotropic.
        widening: what normals of covariance C do to the nearest sharp lobe of this model: log alpha^2 grows by the
            first number times the mean of C (in units of alpha^2), log Sigma by the second times C's deviation from it,
            the scale by the third power of the determinant's growth. (2, 2, 0) is that of a Gaussian peak.
        blur: what a light whose disc covers half vectors up to R away adds to alpha^2, over R^2, so that the wider lobe
            is the nearest in L2 (docs/maths.md). A Gaussian peak's is 1/2 for a small light (twice the disc's variance
            along an axis), 0.55 at R = alpha and 0.63 at 2 alpha.
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
    blur: float = 0.58

    @property
    def default_shape(self) -> float:
        """Shape parameter of a lobe that says nothing of it."""
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
