"""What an error counts for, as weights of the nodes: every loss is a weighted least-squares fit, solved once or anew.

- L2: the half-angle error integral itself. It follows the peak of the lobe.
- RELATIVE: |T - F|^2 / (|T|^2 + knee^2), the relative squared loss of Kemppinen et al. 2023 (their equation 5) at each
  half angle; their denominator is the prediction, held constant, because their target is noisy; ours is not.
- L1: sqrt(|T - F|^2 + knee^2), a smoothed absolute error (Manson and Sloan 2016 fit GGX's tail by an absolute error,
  which L2 sacrifices to the peak), by iteratively reweighted least squares: with weights 1 / sqrt(|r|^2 + knee^2) of
  the residual r before, each fit lowers the loss, since the square is a tangent from above to the square root.
- SEEN: |T - F|^2 / (T + k), k = mean T + 4 d / pi, the squared error relative to what is seen there: the lobe, its
  mean over all half angles, and the diffuse albedo d as a lobe's value (d / pi over the 1 / (4 (n.l) (n.v)) of a lobe).
- DISPLAYED: |T - F|^2 / (T + k / 5)^1.5, the squared error of what a screen shows. With the light exposed so that its
  mean is grey, Reinhard's curve y = x / (1 + x) and sRGB's y^(1/2.2) have slopes whose square falls as x^-1.1 below
  the mean and as x^-2.9 far above it; 1.5 and a fifth of the mean stand for both (benchmarks/seen.py).

The knee is a share of the target's highest value on the nodes: what lies below it counts absolutely.
An energy constraint needs no loss of its own: lobes are normalised, so holding the scale at the filtered colour keeps
the mean of the lobe exactly, at the least L2 error that leaves (``--specular held``).
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import kernel
from brdffit.halfangle.quadrature import BLUE, GREEN, MEASURE, RED, WEIGHT

real = np.float32

L2, RELATIVE, L1, SEEN, DISPLAYED = range(5)
#: Codes of the names in brdffit.methods.LOSSES.
LOSS_CODES = {"l2": L2, "relative": RELATIVE, "l1": L1, "seen": SEEN, "displayed": DISPLAYED}

#: Fits of L1 beyond the first.
ROUNDS = 4
_KNEE = 0.03
# Of DISPLAYED: the power of the denominator, and the share of k in it.
_POWER, _DARK = 1.5, 0.2


@kernel
def _knee_squared(nodes):
    """(share of the highest |T|)^2."""
    red, green, blue = nodes[RED], nodes[GREEN], nodes[BLUE]
    highest = real(0.0)
    for j in range(nodes.shape[1]):
        highest = max(highest, red[j] * red[j] + green[j] * green[j] + blue[j] * blue[j])
    return highest * real(_KNEE * _KNEE)


@kernel
def weigh_relatively(nodes):
    """WEIGHT <- MEASURE over |T|^2 + knee^2, in units of the knee, so that no weight grows."""
    red, green, blue, weight, measure = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT], nodes[MEASURE]
    knee = _knee_squared(nodes)
    if not knee > real(0.0):
        return
    for j in range(nodes.shape[1]):
        square = red[j] * red[j] + green[j] * green[j] + blue[j] * blue[j]
        weight[j] = measure[j] * knee / (square + knee)


@kernel
def weigh_as_seen(nodes, moment, displayed):
    """WEIGHT <- MEASURE over what is seen, T + k with k = mean T + 4 d / pi, in units of k; T and d are channel sums.

    ``moment`` (9,): sums of diffuse colour times normal, (channel, axis). ``displayed``: over (T + k / 5)^1.5.
    """
    red, green, blue, weight, measure = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT], nodes[MEASURE]
    whole, mean = real(0.0), real(0.0)
    for j in range(nodes.shape[1]):
        whole += measure[j]
        mean += measure[j] * (red[j] + green[j] + blue[j])
    diffuse = 0.0
    for channel in range(3):
        diffuse += math.sqrt(moment[3 * channel] ** 2 + moment[3 * channel + 1] ** 2 + moment[3 * channel + 2] ** 2)
    knee = mean / max(whole, real(1e-30)) + real(4.0 / math.pi * diffuse)
    if displayed:
        knee *= real(_DARK)
    if not knee > real(0.0):
        return
    for j in range(nodes.shape[1]):
        # Negative weights of a filter can make the target negative.
        share = knee / (max(red[j] + green[j] + blue[j], real(0.0)) + knee)
        weight[j] = measure[j] * (share * np.sqrt(share) if displayed else share)


@kernel
def weigh_absolutely(nodes, values, red_scale, green_scale, blue_scale):
    """WEIGHT <- MEASURE over sqrt(|T - F|^2 + knee^2), in units of the knee; F = scale * values."""
    red, green, blue, weight, measure = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT], nodes[MEASURE]
    knee = _knee_squared(nodes)
    if not knee > real(0.0):
        return
    r, g, b = real(red_scale), real(green_scale), real(blue_scale)
    for j in range(nodes.shape[1]):
        d_r, d_g, d_b = red[j] - r * values[j], green[j] - g * values[j], blue[j] - b * values[j]
        weight[j] = measure[j] * np.sqrt(knee / (d_r * d_r + d_g * d_g + d_b * d_b + knee))
