"""A traced surface as a truth that pictures are compared with, and as a source of queries."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.microgeometry.heightfield import HeightField
from brdffit.microgeometry.kernels.paths import reflect_rows
from brdffit.microgeometry.kernels.traversal import meet_rows
from brdffit.render._packing import shading_kernels
from brdffit.render.terms import Terms
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
        self.threads = threads or os.cpu_count() or 1
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
        cap = 1.0 - math.cos(math.radians(0.5 * self.light_size))

        def work(first: int) -> None:
            rows = slice(first, min(first + _PIECE, count))
            reflect_rows(
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
