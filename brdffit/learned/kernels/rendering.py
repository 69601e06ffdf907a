"""Losses by rendering: lobes seen from half vectors, their gradients by way of the held-scale objective.

A loss sum_j f_j(P_j) of what a lobe shows, P = k D(h), has at that point the gradient of sum_j w_j (k D(h_j) - y_j)^2
with any weights w_j and y_j = P_j - f_j'(P_j) / (2 w_j); so ``evaluate``, which has the derivatives of a lobe, serves
any of them.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import kernel
from brdffit.halfangle.objective import HELD, HOLDS, LOG_LOW, SCALE, SETTINGS, TARGET, evaluate
from brdffit.halfangle.patch import wrapped
from brdffit.halfangle.quadrature import H_X, H_Y, H_Z, NODE_ROWS, WEIGHT

#: What is seen of a lobe counts as this much at least where something is divided by it.
_LEAST_SEEN = 1e-3


@kernel
def sample_base(normal, tensor, light, x, y, theta):
    """The lobe at (x, y), in base texels, of a base (S, S, 3), (S, S, 3), (S, S) that repeats; returns its scale.

    As a renderer reads it: normals, the log tensor and colours are interpolated bilinearly.
    """
    side = normal.shape[0]
    fx, fy = x - 0.5, y - 0.5
    x0, y0 = math.floor(fx), math.floor(fy)
    fx, fy = fx - x0, fy - y0
    n_x, n_y, n_z, scale = 0.0, 0.0, 0.0, 0.0
    theta[2], theta[3], theta[4], theta[5] = 0.0, 0.0, 0.0, 0.0
    for corner in range(4):
        dx, dy = corner & 1, corner >> 1
        w = (fx if dx else 1.0 - fx) * (fy if dy else 1.0 - fy)
        i, j = wrapped(int(x0) + dx, side, True), wrapped(int(y0) + dy, side, True)
        n_x += w * normal[j, i, 0]
        n_y += w * normal[j, i, 1]
        n_z += w * normal[j, i, 2]
        for k in range(3):
            theta[2 + k] += w * tensor[j, i, k]
        scale += w * light[j, i]
    theta[0], theta[1] = -n_x / n_z, -n_y / n_z
    return scale


@kernel
def relative_rows(
    theta, scale, half, points, normal, tensor, light, x, y, size, offset, epsilon, log_low, by_theta, by_scale,
    moments_kernel, values_kernel, log_normalisation, source_values, source_log_normalisation,
):  # fmt: skip
    """Equation 5 of Kemppinen et al. 2023, and its gradients by theta (n, 5) and the log of the scale (n,).

    Images are runs of ``points`` points that share one scale, seen from each of J half vectors ``half`` (3, J). With
    P = scale D(half; theta) and G one sample of the base within the footprint (``size`` base texels about (x, y),
    ``offset`` (n, J, 2) in [-1/2, 1/2)), an image's loss is |P - G|^2 / (|P|^2 + epsilon), its denominator held: then
    dL/dP = 2 (P - G) / (|P|^2 + epsilon) vanishes in the mean at P = E[G], however noisy G is.
    """
    count, many = theta.shape[0], half.shape[1]
    nodes, one = np.zeros((NODE_ROWS, many), np.float32), np.zeros((NODE_ROWS, 1), np.float32)
    values, value, inverse = np.zeros(many, np.float32), np.zeros(1, np.float32), np.zeros(many)
    setting, work, full, slope, sampled = np.zeros(SETTINGS), np.zeros(48), np.zeros(6), np.zeros(6), np.zeros(6)
    setting[HELD], setting[SCALE], setting[LOG_LOW] = HOLDS, 1.0, log_low
    for j in range(many):
        nodes[H_X, j], nodes[H_Y, j], nodes[H_Z, j] = half[0, j], half[1, j], half[2, j]
    total = 0.0
    for first in range(0, count, points):
        for j in range(many):
            inverse[j] = epsilon
        for i in range(first, first + points):
            for k in range(5):
                full[k] = theta[i, k]
            values_kernel(full, nodes, log_normalisation, values, work)
            for j in range(many):
                seen = scale[i] * values[j]
                inverse[j] += seen * seen
        for j in range(many):
            inverse[j] = 1.0 / inverse[j]
        for i in range(first, first + points):
            for k in range(5):
                full[k] = theta[i, k]
            for j in range(many):
                at_x, at_y = x[i] + size[i] * offset[i, j, 0], y[i] + size[i] * offset[i, j, 1]
                colour = sample_base(normal, tensor, light, at_x, at_y, sampled)
                one[H_X, 0], one[H_Y, 0], one[H_Z, 0] = half[0, j], half[1, j], half[2, j]
                source_values(sampled, one, source_log_normalisation, value, work)
                truth = colour * value[0]
                nodes[WEIGHT, j] = scale[i] * scale[i] * inverse[j]
                nodes[TARGET, j] = scale[i] * truth * inverse[j]
                total += truth * truth * inverse[j]
            total += evaluate(full, nodes, setting, moments_kernel, log_normalisation, slope, work)
            by_scale[i] = 2.0 * (work[1] - work[0]) / many
            for k in range(5):
                by_theta[i, k] = slope[k] / many
    return total / (many * (count // points))


@kernel
def seen_rows(theta, scale, half, out, values_kernel, log_normalisation):
    """``out`` (n, J): scale D(half; theta) of lobes theta (n, 5) and half vectors (3, J)."""
    many = half.shape[1]
    nodes, values = np.zeros((NODE_ROWS, many), np.float32), np.zeros(many, np.float32)
    full, work = np.zeros(6), np.zeros(48)
    for j in range(many):
        nodes[H_X, j], nodes[H_Y, j], nodes[H_Z, j] = half[0, j], half[1, j], half[2, j]
    for i in range(theta.shape[0]):
        for k in range(5):
            full[k] = theta[i, k]
        values_kernel(full, nodes, log_normalisation, values, work)
        for j in range(many):
            out[i, j] = scale[i] * values[j]


@kernel
def tonemapped_rows(theta, scale, half, truth, log_low, by_theta, moments_kernel, values_kernel, log_normalisation):
    """Mean of |log(1 + P) - log(1 + G)| over lobes theta (n, 5) and half vectors (3, J), and its gradient (n, 5).

    ``truth`` (n, J) is G; P = scale D(half; theta), so that dL/dP = sign(P - G) / (1 + P).
    """
    count, many = theta.shape[0], half.shape[1]
    nodes, values = np.zeros((NODE_ROWS, many), np.float32), np.zeros(many, np.float32)
    setting, work, full, slope = np.zeros(SETTINGS), np.zeros(48), np.zeros(6), np.zeros(6)
    setting[HELD], setting[SCALE], setting[LOG_LOW] = HOLDS, 1.0, log_low
    for j in range(many):
        nodes[H_X, j], nodes[H_Y, j], nodes[H_Z, j] = half[0, j], half[1, j], half[2, j]
    total, share = 0.0, 1.0 / (count * many)
    for i in range(count):
        for k in range(5):
            full[k] = theta[i, k]
        values_kernel(full, nodes, log_normalisation, values, work)
        for j in range(many):
            seen = scale[i] * values[j]
            difference = math.log1p(seen) - math.log1p(truth[i, j])
            total += share * abs(difference)
            # Weighted so that y is 0 or 2 P: in single precision no difference of large numbers is left.
            weight = 0.5 * share / ((1.0 + seen) * max(seen, _LEAST_SEEN))
            step = max(seen, _LEAST_SEEN)
            nodes[WEIGHT, j] = weight * scale[i] * scale[i]
            nodes[TARGET, j] = weight * scale[i] * (seen - math.copysign(step, difference))
        evaluate(full, nodes, setting, moments_kernel, log_normalisation, slope, work)
        for k in range(5):
            by_theta[i, k] = slope[k]
    return total
