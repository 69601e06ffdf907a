"""What trilinear filtering makes of a decoder's outputs, judged by either loss, and the gradient back to the outputs.

Filtered are unit normals, log tensors and the logs of scales, T texels of a pyramid to n points:

    v = sum_t w_t n_t,   slopes m = -v_xy / v_z,   dm/dv = -(I, m) / v_z,

and n_t = (x, y, sqrt(1 - x^2 - y^2)) lifts what is said, so that within the disc dz/d(x, y) = -(x, y) / z. Beyond the
disc the length is cut and only the direction counts: d(cut)/d(xy) = (R / r) (I - xy xy' / r^2).
"""

from __future__ import annotations

import math

from brdffit._jit import kernel

#: Columns of a lifted output: normal, log tensor, log of the scale.
LIFTED = 7


@kernel
def lift_rows(said, longest, whole):
    """``whole`` (T, LIFTED) of outputs (T, 6)."""
    for i in range(said.shape[0]):
        x, y = said[i, 0], said[i, 1]
        r = math.sqrt(x * x + y * y)
        cut = min(1.0, longest / max(r, 1e-12))
        x, y = x * cut, y * cut
        whole[i, 0], whole[i, 1], whole[i, 2] = x, y, math.sqrt(1.0 - x * x - y * y)
        for k in range(4):
            whole[i, 3 + k] = said[i, 2 + k]


@kernel
def interpolate_rows(whole, taps, shares, mean, theta):
    """``mean`` (n, LIFTED) of eight texels a point, and lobes ``theta`` (n, 5) as slopes and log tensor."""
    for i in range(taps.shape[0]):
        for k in range(LIFTED):
            mean[i, k] = 0.0
        for t in range(taps.shape[1]):
            for k in range(LIFTED):
                mean[i, k] += shares[i, t] * whole[taps[i, t], k]
        theta[i, 0], theta[i, 1] = -mean[i, 0] / mean[i, 2], -mean[i, 1] / mean[i, 2]
        theta[i, 2], theta[i, 3], theta[i, 4] = mean[i, 3], mean[i, 4], mean[i, 5]


@kernel
def slopes_back(mean, by_theta, steepest, by_mean):
    """``by_mean`` (n, LIFTED), its last column untouched, from dL/dtheta (n, 5).

    Normals are known to a lobe's width: in those units no point may pull harder than ``steepest``.
    """
    for i in range(mean.shape[0]):
        z = mean[i, 2]
        g_x, g_y = by_theta[i, 0], by_theta[i, 1]
        by_mean[i, 0], by_mean[i, 1] = -g_x / z, -g_y / z
        by_mean[i, 2] = (g_x * mean[i, 0] + g_y * mean[i, 1]) / (z * z)
        width = math.exp(0.25 * (mean[i, 3] + mean[i, 4]))
        total = 0.0
        for k in range(3):
            by_mean[i, 3 + k] = by_theta[i, 2 + k]
            total += by_mean[i, k] * by_mean[i, k] * width * width + by_theta[i, 2 + k] * by_theta[i, 2 + k]
        shrink = min(1.0, steepest / max(math.sqrt(total), 1e-12))
        for k in range(6):
            by_mean[i, k] *= shrink


@kernel
def spread_rows(said, whole, taps, shares, by_mean, by_whole, longest, by_said):
    """dL/d(said) (T, 6) from ``by_mean``; ``by_whole`` (T, LIFTED) is scratch."""
    for i in range(by_whole.shape[0]):
        for k in range(LIFTED):
            by_whole[i, k] = 0.0
    for i in range(taps.shape[0]):
        for t in range(taps.shape[1]):
            for k in range(LIFTED):
                by_whole[taps[i, t], k] += shares[i, t] * by_mean[i, k]
    for i in range(said.shape[0]):
        x, y = whole[i, 0], whole[i, 1]
        g_x = by_whole[i, 0] - by_whole[i, 2] * x / whole[i, 2]
        g_y = by_whole[i, 1] - by_whole[i, 2] * y / whole[i, 2]
        r = math.sqrt(said[i, 0] * said[i, 0] + said[i, 1] * said[i, 1])
        if r > longest:
            e_x, e_y = said[i, 0] / r, said[i, 1] / r
            along = g_x * e_x + g_y * e_y
            g_x, g_y = (g_x - along * e_x) * longest / r, (g_y - along * e_y) * longest / r
        by_said[i, 0], by_said[i, 1] = g_x, g_y
        for k in range(4):
            by_said[i, 2 + k] = by_whole[i, 3 + k]
