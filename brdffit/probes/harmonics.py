"""Spherical harmonics: irradiance in few numbers, the paper's Table 3, and an independent oracle of the filters.

Filtering by a zonal kernel K(n.l) multiplies the harmonics of degree l by lambda_l = 2 pi integral K(t) P_l(t) dt (the
Funk-Hecke theorem). The polar axis here is +Y; the azimuth is 0 along -Z and grows towards +X.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.special import sph_harm_y

from brdffit.probes.cubemap import directions, resized, solid_angles
from brdffit.probes.lobe import lobe, lobe_integral

#: Size of the cube that coefficients are taken from: low degrees resolve no finer texels.
_PROJECTION_SIZE = 64
#: Constants of the real harmonics of degrees 0 to 2, in the order of ``irradiance_nine``.
NINE_CONSTANTS = np.array([0.282095, 0.488603, 0.488603, 0.488603, 1.092548, 1.092548, 0.315392, 1.092548, 0.546274])


def zonal_coefficients(alpha: float, order: int) -> NDArray:
    """(order,) lambda of degrees 0 to order - 1 of the normalised lobe; lambda_0 = 1.

    Gauss-Legendre points in panels of s with 1 - t = s^4, which gathers them at the peak.
    """
    node, share = legendre.leggauss(16)
    panels = 24 + order
    s = ((np.arange(panels)[:, None] + 0.5 * (node + 1.0)) / panels).ravel()
    far, weight = s**4, np.tile(0.5 * share / panels, panels) * 4.0 * s**3
    values = 2.0 * np.pi * weight * lobe(far, alpha) / lobe_integral(alpha)
    t = 1.0 - far
    out, before, now = np.empty(order), np.ones_like(t), t.copy()
    for degree in range(order):
        out[degree] = values @ before
        # (l + 1) P_{l+1} = (2 l + 1) t P_l - l P_{l-1}
        before, now = now, ((2 * degree + 3) * t * now - (degree + 1) * before) / (degree + 2)
    return out


def truncation_error(order: int, alpha: float = 1.0) -> float:
    """L1 over the sphere between a lobe of unit integral and its harmonics of degrees 0 to order - 1 (Table 3)."""
    t = np.linspace(-1.0, 1.0, 400_001)
    degrees = np.arange(order)
    series = legendre.legval(t, (2.0 * degrees + 1.0) / (4.0 * np.pi) * zonal_coefficients(alpha, order))
    distance = np.abs(series - lobe(1.0 - t, alpha) / lobe_integral(alpha))
    return float(2.0 * np.pi * np.trapezoid(distance, t))


def _basis(direction: NDArray, order: int) -> list[tuple[int, int, NDArray]]:
    """(degree, m, Y) for m >= 0 in directions (..., 3)."""
    polar = np.arccos(np.clip(direction[..., 1], -1.0, 1.0))
    azimuth = np.arctan2(direction[..., 0], -direction[..., 2])
    return [(degree, m, sph_harm_y(degree, m, polar, azimuth)) for degree in range(order) for m in range(degree + 1)]


def analysed(cube: NDArray, order: int) -> NDArray:
    """(order, order, 3) complex coefficients (degree, m >= 0) of a cube map (6, n, n, 3)."""
    cube = resized(cube, min(_PROJECTION_SIZE, cube.shape[1]))
    n = cube.shape[1]
    weighted = cube * solid_angles(n)[None, :, :, None]
    out = np.zeros((order, order, 3), complex)
    for degree, m, value in _basis(directions(n), order):
        out[degree, m] = np.einsum("fji,fjic->c", np.conj(value), weighted)
    return out


def evaluated(coefficients: NDArray, direction: NDArray) -> NDArray:
    """(..., 3) float64 value of coefficients (order, order, 3) in directions (..., 3); negative values may occur."""
    out = np.zeros((*direction.shape[:-1], 3))
    for degree, m, value in _basis(direction, len(coefficients)):
        out += (1.0 if m == 0 else 2.0) * (value[..., None] * coefficients[degree, m]).real
    return out


def filtered_by_harmonics(cube: NDArray, normals: NDArray, alpha: float, order: int) -> NDArray:
    """(..., 3) radiance filtered by the lobe, by harmonics of degrees below ``order``."""
    coefficients = analysed(cube, order) * zonal_coefficients(alpha, order)[:, None, None]
    return evaluated(coefficients, normals)


def irradiance_nine(cube: NDArray) -> NDArray:
    """(9, 3) coefficients of irradiance over pi in the real harmonics of degrees 0 to 2, as engines read them.

    The order of the basis is 1, y, z, x, xy, yz, 3z^2 - 1, xz, x^2 - y^2, each with its constant of NINE_CONSTANTS. The
    coefficients contain lambda of the clamped cosine. Sources: Ramamoorthi and Hanrahan 2001; Sloan 2008.
    """
    cube = resized(cube, min(_PROJECTION_SIZE, cube.shape[1]))
    n = cube.shape[1]
    weighted = (cube * solid_angles(n)[None, :, :, None]).reshape(-1, 3).astype(np.float64)
    basis = nine_basis(directions(n).reshape(-1, 3))
    # lambda of the clamped cosine over pi: 1, 2/3, 1/4.
    return (basis.T @ weighted) * np.repeat([1.0, 2.0 / 3.0, 0.25], [1, 3, 5])[:, None]


def nine_basis(direction: NDArray) -> NDArray:
    """(..., 9) real harmonics of degrees 0 to 2 in directions (..., 3), in the order of ``irradiance_nine``."""
    x, y, z = direction[..., 0], direction[..., 1], direction[..., 2]
    rows = [np.ones_like(x), y, z, x, x * y, y * z, 3.0 * z * z - 1.0, x * z, x * x - y * y]
    return np.stack(rows, axis=-1) * NINE_CONSTANTS
