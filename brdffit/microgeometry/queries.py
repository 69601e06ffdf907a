"""Queries of a multi-scale BTF M(u, sigma, l, v) (Kuznetsov et al. 2021, equation 1), the training data of a neural
material.

M is the radiance that leaves a material towards the viewer v, averaged with a Gaussian of standard deviation sigma
around u on the reference plane, when light from l gives that plane an irradiance of 1.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError


@runtime_checkable
class QuerySource(Protocol):
    """A source that answers queries of one periodic material."""

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in texels of the tile."""
        ...

    def query(self, position: NDArray, sigma: NDArray, light: NDArray, view: NDArray, seed: int) -> NDArray:
        """(n, 3) float32, unbiased estimates of M, one sample each.

        Args:
            position: (n, 2) float, (column, row) in texels of the tile; texel i is centred on i + 1/2.
            sigma: (n,) standard deviation of the Gaussian, in texels of the tile.
            light, view: (n, 3) unit vectors in tangent space (z along the normal of the plane, +Y up in the picture).
            seed: different seeds give independent estimates.
        """
        ...


@runtime_checkable
class TracedSource(QuerySource, Protocol):
    """A source that knows its surface, by which a neural material can be guided."""

    @property
    def normals(self) -> NDArray:
        """(H, W, 3) unit shading normals of the tile."""
        ...

    @property
    def alpha2(self) -> NDArray:
        """(H, W) alpha^2 of the lobes, the mean of both axes."""
        ...

    @property
    def colour(self) -> NDArray:
        """(H, W, 3) linear RGB, at least 0: diffuse albedo plus reflectance of the lobe."""
        ...

    def parallax(self, position: NDArray, view: NDArray) -> NDArray:
        """(n, 2) from positions (n, 2) on the plane to the columns and rows seen from views (n, 3), in texels."""
        ...


class Queries(NamedTuple):
    """Measured queries of one material, from a goniometer or from another program.

    Attributes:
        position: (n, 2) float32, (column, row) in texels of the tile.
        sigma: (n,) float32, standard deviation of the Gaussian in texels.
        light, view: (n, 3) float32 unit vectors in tangent space, above the plane.
        value: (n, 3) float32, M as the module defines it.
        size: (height, width) of the tile in texels.
    """

    position: NDArray
    sigma: NDArray
    light: NDArray
    view: NDArray
    value: NDArray
    size: tuple[int, int]


_WIDTHS = {"position": (2,), "sigma": (), "light": (3,), "view": (3,), "value": (3,)}


def write_queries(path: str | Path, queries: Queries) -> None:
    """Write an .npz that holds each field of ``Queries`` as an array of that name."""
    arrays: dict[str, Any] = {name: np.asarray(array) for name, array in queries._asdict().items()}
    np.savez_compressed(path, **arrays)


def read_queries(path: str | Path) -> Queries:
    """Queries from an .npz that ``write_queries`` wrote, or another program with the same arrays.

    Raises:
        InputError: when the file cannot be read, an array is missing or has another shape, a number is not finite, or a
            direction has not unit length or points below the plane.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            found = {name: np.asarray(file[name]) for name in Queries._fields}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"'{path}' holds no queries ({error}): expected {', '.join(Queries._fields)}.") from error
    count = len(found["position"]) if found["position"].ndim else 0
    arrays = {}
    for name, width in _WIDTHS.items():
        array = found[name]
        if array.shape != (count, *width) or not count:
            raise InputError(f"'{path}': {name} has the shape {array.shape}, expected {(count or 'n', *width)}.")
        if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            raise InputError(f"'{path}': {name} holds what is no finite number.")
        arrays[name] = array.astype(np.float32)
    size = found["size"].ravel()
    if size.size != 2 or size.dtype.kind not in "iu" or size.min() < 1:
        raise InputError(f"'{path}': size is {size.tolist()}, expected the height and width of the tile in texels.")
    for name in ("light", "view"):
        length = np.linalg.norm(arrays[name], axis=1)
        if np.abs(length - 1.0).max() > 1e-3 or arrays[name][:, 2].min() < 0.0:
            raise InputError(f"'{path}': {name} holds vectors that are not of length 1, or point below the plane.")
    return Queries(**arrays, size=(int(size[0]), int(size[1])))
