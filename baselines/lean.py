"""Olano & Baker 2010, "LEAN Mapping": linear filtering of the moments of slopes, m = (-n_x / n_z, -n_y / n_z).

    E = E[m_x, m_y, m_x^2, m_y^2, m_x m_y],   Cov = E[m m'] - E[m] E[m]'

The mean normal is that of E[m]. In Beckmann's convention alpha^2 is twice the variance of the slopes, so in slope
space the lobe widens by 2 Cov. Our roughness tensor lives in the tangent plane of the mean normal n, not of z: a half
vector of slope E[m] + d is (-(E[m] + d), 1), and in the frame of n (T, the shortest rotation of z to n) to first order
T'(-E[m] - d, 1) = (0, 0, 1 / n_z) - T'(d, 0), hence its slope there is

    J d,   J = n_z (I - n_xy n_xy' / (1 + n_z)),      (n_z^2 along the tilt, n_z across it)
    Sigma' = E[Sigma] + 2 J Cov J'.

This is exact in the moments for Beckmann lobes and small tilts, and a heuristic for GGX, which has no variance. The
paper's own shader works with slopes in the frame of z: it adds 1/s of the base Blinn-Phong lobe to Cov and evaluates a
Gaussian at the half vector's slope, so its base lobe narrows by J where the surface tilts. Ours is given in the frame
of its normal and does not narrow.

Slopes of near-horizontal normals would dominate both moments: they are cut at ``MAX_SLOPE`` and counted in the notes.
E[Sigma] averages alpha^2; colours are averaged linearly.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from baselines._filtering import (
    BLOCK_TEXELS,
    SINGLE_NOISE,
    FilteringMethod,
    LevelContext,
    log_of_bounded_tensor,
    tensor_channels,
    with_three_channels,
)
from brdffit.svbrdf import Svbrdf

#: Steepest slope that is not cut: 84 degrees from z.
MAX_SLOPE = 10.0


class Lean(FilteringMethod):
    """Anisotropic widening from the covariance of slopes."""

    name = "lean"
    summary = "covariance of slopes added to the roughness tensor, anisotropic (LEAN mapping, Olano & Baker 2010)"

    def channels(self, svbrdf: Svbrdf, notes: list[str]) -> dict[str, NDArray]:
        """First and second moments of the slopes, and the roughness tensor."""
        moments = np.empty((*svbrdf.size, 5), dtype=np.float32)
        clamped = 0
        rows = max(1, BLOCK_TEXELS // svbrdf.size[1])
        for start in range(0, svbrdf.size[0], rows):
            n_x, n_y, n_z = np.moveaxis(svbrdf.normal[start : start + rows], -1, 0)
            # The n_z with which this tangential part would have the slope MAX_SLOPE.
            least = np.maximum(np.sqrt(n_x * n_x + n_y * n_y) / np.float32(MAX_SLOPE), np.float32(1e-6))
            clamped += int(np.count_nonzero(n_z < least))
            minus_inverse = np.float32(-1.0) / np.maximum(n_z, least)
            m_x, m_y = n_x * minus_inverse, n_y * minus_inverse
            for channel, moment in enumerate((m_x, m_y, m_x * m_x, m_y * m_y, m_x * m_y)):
                moments[start : start + rows, :, channel] = moment
        if clamped:
            notes.append(
                f"{clamped} of {svbrdf.normal[..., 0].size} base texels have slopes steeper than {MAX_SLOPE:g}; "
                f"LEAN took them as {MAX_SLOPE:g}."
            )
        return {"moments": moments, "tensor": tensor_channels(svbrdf)}

    def finish(self, filtered: Mapping[str, NDArray], context: LevelContext) -> tuple[NDArray, NDArray]:
        """Mean normal and Sigma' = E[Sigma] + 2 J Cov J'."""
        m_x, m_y, m_xx, m_yy, m_xy = np.moveaxis(filtered["moments"], -1, 0).astype(np.float64, order="C")
        # A difference of single-precision averages has a rounding error of a few 1e-7 of the subtracted values.
        noise = SINGLE_NOISE * (m_xx + m_yy)
        cov_xx = np.maximum(m_xx - m_x * m_x - noise, 0.0)
        cov_yy = np.maximum(m_yy - m_y * m_y - noise, 0.0)
        limit = np.sqrt(cov_xx * cov_yy)
        cov_xy = np.clip(m_xy - m_x * m_y, -limit, limit)

        n_z = 1.0 / np.sqrt(1.0 + m_x * m_x + m_y * m_y)
        n_x, n_y = -m_x * n_z, -m_y * n_z
        scale = n_z / (1.0 + n_z)
        j_xx, j_yy, j_xy = n_z - scale * n_x * n_x, n_z - scale * n_y * n_y, -scale * n_x * n_y
        # J Cov, then (J Cov) J'; J is symmetric.
        left_xx, left_xy = j_xx * cov_xx + j_xy * cov_xy, j_xx * cov_xy + j_xy * cov_yy
        left_yx, left_yy = j_xy * cov_xx + j_yy * cov_xy, j_xy * cov_xy + j_yy * cov_yy
        tensor = with_three_channels(filtered["tensor"])
        tensor[..., 0] += 2.0 * (left_xx * j_xx + left_xy * j_xy)
        tensor[..., 1] += 2.0 * (left_yx * j_xy + left_yy * j_yy)
        tensor[..., 2] += 2.0 * (left_xx * j_xy + left_xy * j_yy)
        return np.stack([n_x, n_y, n_z], axis=-1), log_of_bounded_tensor(tensor, context)
