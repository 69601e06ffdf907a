"""A traced surface as a truth that pictures are compared with, and as a source of queries."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import numba_type
from brdffit.machine import core_count
from brdffit.microgeometry.heightfield import HeightField
from brdffit.microgeometry.kernels.paths import reflect_rows
from brdffit.microgeometry.kernels.traversal import meet_rows
from brdffit.render._kernels import (
    P_DIFFUSE,
    P_NORMAL,
    P_ROUGHNESS,
    P_SPECULAR,
    PERCEPTUAL,
    log_normalisation_type,
    shade_type,
)
from brdffit.render._packing import shading_kernels
from brdffit.render.terms import Terms
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf

#: Samples that one call of the kernel traces.
_PIECE = 8192


@dataclass(frozen=True)
class Effects:
    """Effects that are traced; those that are off cost no time.

    Attributes:
        displacement: the visible point is where the viewer's ray meets the surface, which gives parallax and masking;
            otherwise it is the point of the surface above or below the position on the plane.
        shadowing: a point that the surface hides from the light gets none of it.
        bounces: how often light may be reflected from the surface to itself, at most.
    """

    displacement: bool = True
    shadowing: bool = True
    bounces: int = 0


#: Without effects a surface reflects as its maps do.
NO_EFFECTS = Effects(False, False, 0)


@cache
def reflect_loop() -> Any:
    """``reflect_rows``, compiled once for all models and terms, whose kernels are values of function type.

    Compiled for the kernels themselves it would not be found on the disk again: they are others in each process.
    """
    lines, rows, singles = np.zeros(1), np.zeros((1, 1)), np.zeros((1, 1), np.float32)
    surface = (singles, singles[0], np.zeros((1, 3), np.int64), singles, np.zeros(3, np.int64), 0, False, False, 0.0)
    asked = (False, False, 0, 0.0, rows, lines, rows, rows, np.uint64(0), 0, singles)
    signature = (*map(numba_type, (*surface, *asked)), log_normalisation_type, shade_type)
    if signature not in reflect_rows.overloads:
        reflect_rows.compile(signature)
    reflect_rows.disable_compile()
    return reflect_rows


class Microgeometry:
    """A material whose height map is traced as its surface: a ``Truth``, and a ``QuerySource``.

    A position (column, row) is a point u of the reference plane at the mean height; the visible point is where the
    viewer's ray through u meets the surface. Every estimate is unbiased and takes one sample; it does not depend on the
    number of threads.
    """

    def __init__(
        self,
        field: HeightField,
        effects: Effects = Effects(),
        *,
        light_size: float = 0.0,
        terms: Terms = Terms(),  # noqa: B008
        threads: int | None = None,
    ):
        """Set up the tracer.

        Args:
            field: the surface.
            effects: effects to trace.
            light_size: angular diameter in degrees of the light, a disc of uniform radiance; 0 for a point.
            terms: terms of the BRDF to apply.
            threads: worker threads; None takes one a core.
        """
        self.field = field
        self.effects = effects
        self.light_size = light_size
        self.threads = threads or core_count()
        self._kernels = shading_kernels(field.packed.model, terms)

    @classmethod
    def of(cls, svbrdf: Svbrdf, effects: Effects = Effects(), **options: Any) -> Microgeometry:
        """The tracer of a material with a height map; raises as ``HeightField.of``."""
        return cls(HeightField.of(svbrdf), effects, **options)

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in texels."""
        return self.field.size

    @property
    def normals(self) -> NDArray:
        """(H, W, 3) float32 unit shading normals, those of the maps."""
        return self.field.packed.texels[:, P_NORMAL : P_NORMAL + 3].reshape(*self.size, 3)

    @property
    def alpha2(self) -> NDArray:
        """(H, W) float32 alpha^2 of the lobes, the mean of both axes."""
        found = self.field.packed.texels[:, P_ROUGHNESS : P_ROUGHNESS + 3]
        if self.field.packed.roughness_kind == PERCEPTUAL:
            return np.square(np.square(found[:, 0])).reshape(self.size)
        return 0.5 * tensor_from_log(found.reshape(*self.size, 3))[..., :2].sum(axis=2)

    @property
    def colour(self) -> NDArray:
        """(H, W, 3) float32 linear RGB: diffuse albedo plus reflectance of the lobe."""
        texels = self.field.packed.texels
        both = texels[:, P_DIFFUSE : P_DIFFUSE + 3] + texels[:, P_SPECULAR : P_SPECULAR + 3]
        return both.reshape(*self.size, 3)

    @property
    def notes(self) -> list[str]:
        """Sentences for the user."""
        return self.field.notes

    def reflect(self, position: NDArray, view: NDArray, light: NDArray, seed: int) -> NDArray:
        """See ``brdffit.appearance.Truth``: (n, 3) float32, the BRDF times the cosine, for positions on the plane."""
        return self._trace(position, np.zeros(len(position)), light, view, seed)

    def query(self, position: NDArray, sigma: NDArray, light: NDArray, view: NDArray, seed: int) -> NDArray:
        """See ``queries.QuerySource``."""
        found = self._trace(position, sigma, light, view, seed)
        # M is defined for an irradiance of 1 on the plane.
        return found / np.maximum(np.asarray(light, np.float32)[:, 2:], np.float32(1e-4))

    def parallax(self, position: NDArray, view: NDArray) -> NDArray:
        """(n, 2) from positions on the plane to the columns and rows where the surface is seen, in texels.

        Args:
            position: (n, 2), (column, row) in texels of the tile.
            view: (n, 3) unit vectors to the viewer, above the plane.
        """
        field = self.field
        top = float(field.maxima[field.levels[-1, 0]]) + 1e-3
        downwards = np.asarray(view, np.float64) * (-1.0, 1.0, -1.0)
        origin = np.empty_like(downwards)
        # The ray meets the plane at the position, and vertices stand at texel centres.
        origin[:, :2] = position - 0.5 + downwards[:, :2] * ((top - field.reference) / downwards[:, 2:])
        origin[:, 2] = top
        met = np.empty((len(origin), 5))
        meet_rows(field.height, field.maxima, field.levels, origin, downwards, met)
        return np.where(met[:, :1] >= 0.0, met[:, 1:3] - (position - 0.5), 0.0)

    def _trace(self, position: NDArray, sigma: NDArray, light: NDArray, view: NDArray, seed: int) -> NDArray:
        count = len(position)
        arrays = [np.ascontiguousarray(each, np.float64) for each in (position, sigma, light, view)]
        out = np.empty((count, 3), np.float32)
        field, packed, effects = self.field, self.field.packed, self.effects
        loop = reflect_loop()
        cap = 1.0 - math.cos(math.radians(0.5 * self.light_size))

        def work(first: int) -> None:
            rows = slice(first, min(first + _PIECE, count))
            loop(
                field.height, field.maxima, field.levels, packed.texels, packed.levels[0], packed.roughness_kind,
                packed.has_shape, field.shading == "geometry", field.reference, effects.displacement,
                effects.shadowing, effects.bounces, cap, *(each[rows] for each in arrays), np.uint64(seed), first,
                out[rows], *self._kernels,
            )  # fmt: skip

        pieces = range(0, count, _PIECE)
        if len(pieces) < 2 or self.threads < 2:
            for first in pieces:
                work(first)
        else:
            with ThreadPoolExecutor(self.threads) as pool:
                list(pool.map(work, pieces))
        return out
