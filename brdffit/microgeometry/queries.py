"""Multi-scale BTF queries M(u, sigma, l, v) (Kuznetsov et al. 2021, equation 1): what a neural material learns from.

M is the radiance that leaves a material towards the viewer v, averaged under a Gaussian of standard deviation sigma
about u on the reference plane, where the light from l gives that plane an irradiance of 1.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from numpy.typing import NDArray


@runtime_checkable
class QuerySource(Protocol):
    """Whatever answers queries of one material that repeats."""

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in texels of the tile."""
        ...

    def query(self, position: NDArray, sigma: NDArray, light: NDArray, view: NDArray, seed: int) -> NDArray:
        """(n, 3) float32, unbiased estimates of M, one sample each.

        Args:
            position: (n, 2) float, (column, row) in texels of the base; texel i is centred on i + 1/2.
            sigma: (n,) standard deviation of the Gaussian, in texels of the base.
            light, view: (n, 3) unit vectors in tangent space (z up, +Y up in the picture).
            seed: two seeds are independent.
        """
        ...
