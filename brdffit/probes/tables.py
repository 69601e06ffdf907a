"""Tables of the second pass (Manson and Sloan 2016, sections 5 and 6): their error, and filtering with them.

The error of a table at a texel is that of the preimage, the integral over the sphere of |A - B| with both kernels of
unit integral, as in the paper's tables 1 to 3. A is the kernel that the table reads. B is the exact one: K at the texel
centres of a base of 128^2 times the solid angles, normalised to unit sum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from brdffit.probes.cubemap import directions, face_points, solid_angles
from brdffit.probes.downsampling import ColourPyramid, layout_of
from brdffit.probes.kernels.tables import filter_by_table, table_error
from brdffit.probes.lobe import lobe
from brdffit.probes.parallel import over_rows

#: Size of the base that tables are for, and the polynomial terms of each kind.
BASE_SIZE = 128
TERMS = {"const": 1, "quadratic": 3, "quartic": 6}


def texels_of(n: int) -> NDArray:
    """(6 n^2, 3) face, u and v of all texels of a level of n^2."""
    face, j, i = np.meshgrid(np.arange(6), np.arange(n), np.arange(n), indexing="ij")
    return np.stack([face.ravel(), (2.0 * i.ravel() + 1.0) / n - 1.0, 1.0 - (2.0 * j.ravel() + 1.0) / n], axis=-1)


def texel_directions(texels: NDArray) -> NDArray:
    """(T, 3) unit directions of texels given as face, u and v."""
    points = face_points(texels[:, 1], texels[:, 2])[texels[:, 0].astype(int), np.arange(len(texels))]
    return points / np.linalg.norm(points, axis=-1, keepdims=True)


def wanted_preimages(texels: NDArray, alpha: float, n: int) -> NDArray:
    """(T, 6 n^2) float32 exact weights of the texels of a base of n^2 in each filtered texel; rows sum to one.

    At alpha = 1 the lobe is the clamped cosine: irradiance.
    """
    at, angle = directions(n).reshape(-1, 3), np.tile(solid_angles(n).ravel(), 6)
    out = np.empty((len(texels), len(at)), np.float32)
    for q, normal in enumerate(texel_directions(texels)):
        # 1 - n.l = |n - l|^2 / 2 keeps its digits where the lobe is narrow.
        far = 0.5 * np.square(at - normal).sum(axis=1)
        kernel = lobe(far, alpha) * angle
        out[q] = kernel / kernel.sum()
    return out


@dataclass(frozen=True)
class Goal:
    """Texels of a level with their exact preimages: what a table of that level is measured on.

    Attributes:
        texels: (T, 3) face, u, v.
        shares: (T,) weights that sum to one.
        wanted: (T, 6 n^2) exact preimages at level ``base`` of the pyramid.
        base: level of the pyramid at which preimages are compared; 0, except in searches for rough levels.
    """

    texels: NDArray
    shares: NDArray
    wanted: NDArray
    base: int = 0

    @classmethod
    def of(cls, texels: NDArray, alpha: float, shares: NDArray | None = None, base: int = 0) -> Goal:
        """Texels (T, 3) with the preimages of the lobe of ``alpha``; without ``shares`` all weigh the same."""
        shares = np.full(len(texels), 1.0) if shares is None else np.asarray(shares, np.float64)
        return cls(texels, shares / shares.sum(), wanted_preimages(texels, alpha, BASE_SIZE >> base), base)

    def error(self, table: NDArray, smoothing: float = 0.0) -> float:
        """Mean error of a table (5, terms, 3 N)."""
        return self._measure(table, smoothing, False)[0]

    def error_and_gradient(self, table: NDArray, smoothing: float) -> tuple[float, NDArray]:
        """Mean smoothed error and its gradient, in the shape of the table."""
        error, gradient, _ = self._measure(table, smoothing, True)
        return error, gradient

    def errors(self, table: NDArray) -> NDArray:
        """(T,) error of each texel."""
        return self._measure(table, 0.0, False)[2]

    def _measure(self, table: NDArray, smoothing: float, with_gradient: bool) -> tuple[float, NDArray, NDArray]:
        table, layout = np.ascontiguousarray(table, np.float64), layout_of(BASE_SIZE)
        flat, gradient, errors = np.zeros(layout.offsets[-1]), np.zeros(table.shape), np.zeros(len(self.texels))
        arrays = layout.offsets, layout.sizes, layout.borders, layout.weights
        error = table_error(
            table, self.texels, self.shares, self.wanted, smoothing, flat, arrays, self.base, with_gradient, gradient,
            errors,
        )  # fmt: skip
        return float(error), gradient, errors


def filtered_by_table(pyramid: ColourPyramid, n: int, table: NDArray, threads: int = 1) -> NDArray:
    """A level (6, n, n, 3) float32 of a pyramid over 128^2, by the table of that level."""
    layout, flat = pyramid
    table, out = np.ascontiguousarray(table), np.empty((6, n, n, 3), np.float32)

    def rows(first: int, last: int) -> None:
        filter_by_table(table, n, first, last, flat, layout.offsets, layout.sizes, out)

    over_rows(rows, 6 * n, threads)
    return out
