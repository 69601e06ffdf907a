"""Losses as weights of the quadrature nodes: each is a weighted least-squares fit, solved once or, for L1, repeatedly.

- L2: the half-angle error integral itself. It follows the peak of the lobe.
- RELATIVE: |T - F|^2 / (|T|^2 + knee^2), the relative squared loss of Kemppinen et al. 2023 (their equation 5) at each
  half angle. Their denominator is the prediction, held constant, because their target is noisy; ours is not.
- L1: sqrt(|T - F|^2 + knee^2), a smoothed absolute error (Manson and Sloan 2016 fit GGX by an absolute error to keep
  its tail, which L2 sacrifices to the peak), by iteratively reweighted least squares with weights
  1 / sqrt(|r|^2 + knee^2), r the residual of the fit before. No fit raises the loss: as a function of |r|^2 the square
  root is concave, so the weighted square lies above it and touches it at the fit before.
- SEEN: |T - F|^2 / (T + k), k = mean T + 4 d / pi, the squared error relative to the light seen there: the lobe, its
  mean over all half angles, and the diffuse albedo d in units of a lobe (d / pi over a lobe's 1 / (4 (n.l) (n.v))).
- DISPLAYED: |T - F|^2 / (T + k')^1.5, k' = D + (mean T + D) / 2, D = 16 d / (9 pi), the squared error on a screen. D
  is the diffuse light, 4 d / pi (n.l) (n.v) in units of a lobe, in the mean over cosine-distributed l and v. With the
  mean light exposed as grey, Reinhard's curve y = x / (1 + x) and sRGB's y^(1/2.2) have a slope whose square falls as
  x^-1.1 below the mean and as x^-2.9 far above it; the power 1.5 and half of the mean approximate both
  (benchmarks/seen.py).

- BALANCED: from level 2 on (DISPLAYED + w L2) / (1 + w), each a share of its own norm of the target, so that it
  is DISPLAYED with a floor under its weight: w = 0.2 a level, at most 0.6. From afar a lobe stands for many, misses
  part of them whatever it is, and DISPLAYED alone gives highlights away for the dark beside them. Near by, at levels 0
  and 1, a lobe stands for few, and what shows is its glow in the dark: DISPLAYED with 0.2 instead of 0.5 of the mean
  light in k'.

The knee is 3% of the target's highest value on the nodes: below it RELATIVE counts errors absolutely, and L1 squared.
An energy constraint needs no loss of its own: lobes are normalised, so a scale held at the filtered colour keeps the
energy exactly, and the search finds the least L2 error under that constraint (``--set fit.specular=held``).
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import kernel
from brdffit.fitting.options import LOSSES
from brdffit.halfangle.lights import segment
from brdffit.halfangle.quadrature import BLUE, GREEN, MEASURE, RED, WEIGHT
from brdffit.methods import one_of

real = np.float32

L2, RELATIVE, L1, SEEN, DISPLAYED = range(5)
#: Codes of the names in brdffit.fitting.options.LOSSES; "auto" becomes one of these before a search.
LOSS_CODES = {"l2": L2, "relative": RELATIVE, "l1": L1, "seen": SEEN, "displayed": DISPLAYED, "balanced": DISPLAYED}

#: Reweighted fits of L1 after the first.
ROUNDS = 4
_KNEE = 0.03
#: DISPLAYED: the share of the mean light in its denominator.
DARK = 0.5
# Mean of (n.l) (n.v) over cosine-distributed l and v.
_BOTH_COSINES = 4.0 / 9.0
# Mean squared error of diffuse light, in units of a lobe, for a squared error of 1 in the vector d n: see
# ``set_diffuse_error``.
_DIFFUSE_ERROR = 2.0 / math.pi**2
# BALANCED: the last level near by, the share of the mean light there, the weight of the squared error for each level
# beyond, and the most of it.
_NEAR, _DARK_NEAR, _SQUARES_A_LEVEL, _MOST_SQUARES = 1, 0.2, 0.2, 0.6


def loss_of(name: str, lights: str) -> str:
    """The loss that the option ``loss`` names: "auto" is l2 under point lights, else balanced.

    Raises:
        UnknownNameError: with the nearest known name.
    """
    if one_of("loss", name, LOSSES) != "auto":
        return name
    return "l2" if lights == "point" else "balanced"


def balance_of(loss: str, mip_level: int) -> tuple[float, float]:
    """The share of the mean light in DISPLAYED's denominator, and the weight w of the squared error beside it (0 for
    losses other than BALANCED)."""
    if loss != "balanced":
        return DARK, 0.0
    squares = min(_SQUARES_A_LEVEL * max(mip_level - _NEAR, 0), _MOST_SQUARES)
    return _DARK_NEAR if mip_level <= _NEAR else DARK, squares


@kernel
def _knee_squared(nodes):
    """Square of the knee, a share of the highest |T| on the nodes."""
    red, green, blue = nodes[RED], nodes[GREEN], nodes[BLUE]
    highest = real(0.0)
    for j in range(nodes.shape[1]):
        highest = max(highest, red[j] * red[j] + green[j] * green[j] + blue[j] * blue[j])
    return highest * real(_KNEE * _KNEE)


@kernel
def weigh_relatively(nodes):
    """WEIGHT <- MEASURE knee^2 / (|T|^2 + knee^2), so that no weight exceeds MEASURE."""
    red, green, blue, weight, measure = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT], nodes[MEASURE]
    knee = _knee_squared(nodes)
    if not knee > real(0.0):
        return
    for j in range(nodes.shape[1]):
        square = red[j] * red[j] + green[j] * green[j] + blue[j] * blue[j]
        weight[j] = measure[j] * knee / (square + knee)


@kernel
def weigh_as_seen(nodes, moment, displayed, dark=DARK):
    """WEIGHT <- MEASURE k / (T + k); if ``displayed``, MEASURE (k' / (T + k'))^1.5. See the head of this file.

    T and d are sums over channels. ``moment`` (DIFFUSE_MOMENT,): its first nine entries are the sums of diffuse colour
    times normal, (channel, axis); d of a channel is the length of its sum. ``dark``: share of the mean light in k'.
    """
    red, green, blue, weight, measure = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT], nodes[MEASURE]
    whole, mean = real(0.0), real(0.0)
    for j in range(nodes.shape[1]):
        whole += measure[j]
        mean += measure[j] * (red[j] + green[j] + blue[j])
    diffuse = 0.0
    for channel in range(3):
        diffuse += math.sqrt(moment[3 * channel] ** 2 + moment[3 * channel + 1] ** 2 + moment[3 * channel + 2] ** 2)
    mean /= max(whole, real(1e-30))
    diffuse *= 4.0 / math.pi
    if displayed:
        diffuse *= _BOTH_COSINES
        knee = real(dark) * (mean + real(diffuse)) + real(diffuse)
    else:
        knee = mean + real(diffuse)
    if not knee > real(0.0):
        return
    for j in range(nodes.shape[1]):
        # A filter's negative weights can make the target negative.
        share = knee / (max(red[j] + green[j] + blue[j], real(0.0)) + knee)
        weight[j] = measure[j] * (share * np.sqrt(share) if displayed else share)


@kernel
def add_squares(nodes, share):
    """WEIGHT += MEASURE ``share`` <T,T>_WEIGHT / <T,T>_MEASURE: beside the weighted error, ``share`` of the squared
    one, each relative to its own norm of the target."""
    red, green, blue, weight, measure = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT], nodes[MEASURE]
    weighted, plain = real(0.0), real(0.0)
    for j in range(nodes.shape[1]):
        square = red[j] * red[j] + green[j] * green[j] + blue[j] * blue[j]
        weighted += weight[j] * square
        plain += measure[j] * square
    if not plain > real(0.0):
        return
    factor = real(share) * weighted / plain
    for j in range(nodes.shape[1]):
        weight[j] += factor * measure[j]


@kernel
def set_diffuse_error(table, moment, norm, form):
    """``form`` (6,) <- A (xx, yy, zz, xy, xz, yz) of the error n' A n that a normal n causes in diffuse light.

    The normal of the lobe shades the diffuse colour too: a lobe that leans towards a bright bevel leaves the diffuse
    light behind. Bumps reflect g.l of a channel from the direction l, g = sum_i w_i d_i n_i, and the level d n.l with
    d = g.n, so e = g - (g.n) n is missing, |e|^2 = |g|^2 - (g.n)^2. In units of a lobe (times 4 (n.v) / pi, since a
    lobe is shaded over 4 (n.v)) the mean square over cosine-distributed l and v is
    16 / pi^2 E[v_z^2] E[(e.l)^2] = 16 / pi^2 (1 / 2) (|e|^2 / 4) for e across the normal of the texture. It counts with
    the mean weight of the nodes, over the target's norm as their errors do.

    ``moment`` as in ``weigh_as_seen``; ``norm``: <T,T> over all sizes; 0 for fits that do not see diffuse light.
    """
    for k in range(6):
        form[k] = 0.0
    if not norm > 0.0:
        return
    factor = 0.0
    for s in range(table.lights.shape[0]):
        weight = segment(table, s)[WEIGHT]
        for j in range(weight.size):
            factor += weight[j]
    factor *= _DIFFUSE_ERROR / norm
    for channel in range(3):
        x, y, z = moment[3 * channel], moment[3 * channel + 1], moment[3 * channel + 2]
        form[0] += factor * (y * y + z * z)
        form[1] += factor * (x * x + z * z)
        form[2] += factor * (x * x + y * y)
        form[3] -= factor * x * y
        form[4] -= factor * x * z
        form[5] -= factor * y * z


@kernel
def weigh_absolutely(nodes, values, red_scale, green_scale, blue_scale):
    """WEIGHT <- MEASURE knee / sqrt(|T - F|^2 + knee^2) with F = scale * values."""
    red, green, blue, weight, measure = nodes[RED], nodes[GREEN], nodes[BLUE], nodes[WEIGHT], nodes[MEASURE]
    knee = _knee_squared(nodes)
    if not knee > real(0.0):
        return
    r, g, b = real(red_scale), real(green_scale), real(blue_scale)
    for j in range(nodes.shape[1]):
        d_r, d_g, d_b = red[j] - r * values[j], green[j] - g * values[j], blue[j] - b * values[j]
        weight[j] = measure[j] * np.sqrt(knee / (d_r * d_r + d_g * d_g + d_b * d_b + knee))
