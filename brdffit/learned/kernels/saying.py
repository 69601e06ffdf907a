"""What the method ``learned`` says of footprints, in one pass: features, the network, the corrected lobe.

Eight texels at a time in features and lobes, eight texels by sixteen neurons in the network; nothing of it leaves the
core's cache. The lobe is made of both closed forms and the correction as ``residual`` has it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import inline, kernel
from brdffit.halfangle.closed_forms import STEEPEST_SLOPE
from brdffit.learned.kernels.footprints import (
    BLENDS,
    CHANNELS,
    COLOUR,
    COLUMNS,
    DARKEST,
    DIFFUSE,
    ENERGY,
    PLANE,
    SUMS,
    blend_rows,
    pool_columns,
    sample_columns,
)
from brdffit.learned.kernels.moments import (
    CLOSED,
    DEVIATION,
    FEATURES,
    FIRST,
    GATE,
    GLOW,
    LOG_TENSOR,
    OTHER,
    ROOTS,
    SECOND,
    SHARPEST,
    SMALLER,
    TENSORS,
    TURN,
    features,
    glow,
)
from brdffit.nets.convolution import convolve
from brdffit.nets.doubles import EIGHT, all_of, chosen, eight, exponential, greatest, least, put, root
from brdffit.nets.vectors import LANES, PIXELS, load, multiply_add8, repeated8, stored8

#: Normalised features beyond this are cut: a network says nothing sensible of what it has never seen.
FARTHEST = 4.0
#: Corrections beyond the first are cut, and the log of the scale over the filtered colour beyond the second: a level
#: keeps the energy, as the default fit does by the same bounds.
MOST, LOG_MOST = 4.0, math.log(1.09)
#: Where lobes differ by less than this, corrections fade.
ALIKE = 0.05
#: How much of the gate's argument a correction of 1 is, and beyond what it is cut.
GATE_GAIN, MOST_GATE = 4.0, 30.0
#: Outputs of the network: the correction, the log of the scale over the filtered colour.
OUTPUTS = 7
#: Where the factors of corrections stand, after the outputs.
DIFFER = OUTPUTS * PLANE
#: Columns of a texel's result: normal, log tensor, specular, diffuse, whether training covered it, whether any light.
RESULT = 14
COVERED, SOME = 12, 13


class Said(NamedTuple):
    """A network and the bounds of its results, as the kernel reads them.

    ``weights`` flat; ``layers`` (n, 4): blocks in and out, and where weights and bias stand; ``mean``, ``inverse``,
    ``low``, ``high`` (FEATURES,): 1 / deviation, and the range that training covered; ``widest``: blocks of the widest
    layer; ``log_low``: of eigenvalues; ``round``: 1 to take round lobes; ``free``: 1 to take the network's scale;
    ``up``: weight of z in the diffuse fit (see ``diffuse_scale``).
    """

    weights: NDArray
    layers: NDArray
    mean: NDArray
    inverse: NDArray
    low: NDArray
    high: NDArray
    widest: int
    log_low: float
    round: float
    free: float
    up: float


@inline
def bounded(a, b, c, log_low, round_lobe):
    """A log tensor with eigenvalues within ``log_low`` and 0, round where ``round_lobe`` is 1."""
    mean, half, off = 0.5 * (a + b), 0.5 * (a - b) * (1.0 - round_lobe), c * (1.0 - round_lobe)
    radius = root(half * half + off * off)
    major = least(greatest(mean + radius, log_low), 0.0)
    minor = least(greatest(mean - radius, log_low), 0.0)
    mean, shrink = 0.5 * (major + minor), 0.5 * (major - minor) / greatest(radius, 1e-12)
    return mean + shrink * half, mean - shrink * half, shrink * off


@inline
def normalise(feature, i, said, inputs, result):
    """Normalised features of eight texels as planes (FEATURES, PLANE), and whether all lie in the covered range."""
    inside = all_of(1.0)
    for k in range(FEATURES):
        value = eight(feature, k * PLANE + i)
        inside = least(inside, least(value - said.low[k], said.high[k] - value))
        put(inputs, k * PLANE + i, least(greatest((value - said.mean[k]) * said.inverse[k], -FARTHEST), FARTHEST))
    put(result, COVERED * PLANE + i, inside)


@inline
def glow_of(rows, at):
    """``glow`` of eight footprints whose sums begin at ``at``."""
    energy = eight(rows, at + COLOUR * PLANE) + eight(rows, at + (COLOUR + 1) * PLANE)
    energy = energy + eight(rows, at + (COLOUR + 2) * PLANE)
    return glow(
        diffuse_length(rows, at + DIFFUSE * PLANE), diffuse_length(rows, at + (DIFFUSE + 3) * PLANE),
        diffuse_length(rows, at + (DIFFUSE + 6) * PLANE), energy,
    )  # fmt: skip


@inline
def diffuse_length(rows, at):
    """Length of the sum of a channel's diffuse colour times normal, of eight footprints."""
    x, y, z = eight(rows, at), eight(rows, at + PLANE), eight(rows, at + 2 * PLANE)
    return root(x * x + y * y + z * z)


@kernel
def first_layer(inputs, weights, bias, y, count, ins, outs, slope):
    """The first layer, of planes (FEATURES, PLANE): ``convolve`` without bringing the inputs into blocks."""
    for o in range(outs):
        for column in range(0, count, PIXELS):
            sums = repeated8(bias, o * LANES)
            for k in range(FEATURES):
                weight = load(weights, ((o * ins + k // LANES) * LANES + k % LANES) * LANES)
                sums = multiply_add8(sums, inputs, k * PLANE + column, 1, weight)
            stored8(sums, y, (o * count + column) * LANES, LANES, slope)


@kernel
def ask(said, inputs, hidden, other, count, out):
    """The network's outputs for ``count`` texels, from ``inputs`` (FEATURES, PLANE) to ``out`` (OUTPUTS, PLANE)."""
    last, x, y = said.layers.shape[0] - 1, hidden, other
    for layer in range(last + 1):
        ins, outs, first, bias = (
            said.layers[layer, 0], said.layers[layer, 1], said.layers[layer, 2], said.layers[layer, 3]
        )  # fmt: skip
        slope = np.float32(1.0) if layer == last else np.float32(0.1)
        if layer == 0:
            first_layer(inputs, said.weights[first:bias], said.weights[bias:], x, count, ins, outs, slope)
            continue
        convolve(x, said.weights[first:bias], said.weights[bias:], y, 0, 1, count, 0, ins, outs, 0, slope)
        x, y = y, x
    for k in range(OUTPUTS):
        for i in range(count):
            out[k * PLANE + i] = x[i * LANES + k]


@kernel
def say(rows, at, count, said, scratch, feature, closed, inputs, hidden, other, result):
    """Fill ``result`` (RESULT, PLANE) of ``count`` (a multiple of 8, at most PLANE) texels whose sums begin at ``at``.

    ``scratch`` (OUTPUTS + 1, PLANE), ``feature``, ``closed`` float64; ``inputs`` (FEATURES, PLANE), ``result`` float32;
    ``hidden``, ``other`` float32 blocks.
    """
    for i in range(0, count, EIGHT):
        energy = greatest(eight(rows, at + i + ENERGY * PLANE), 1e-30)
        features(rows, at + i, PLANE, 1.0 / energy, feature, closed, i, PLANE)
        put(feature, GLOW * PLANE + i, glow_of(rows, at + i))
        normalise(feature, i, said, inputs, result)
        by_normals = greatest(
            2.0 - eight(feature, TENSORS * PLANE + i) - eight(feature, (TENSORS + 1) * PLANE + i), 0.0
        )
        differ = by_normals + eight(feature, DEVIATION * PLANE + i)
        differ = differ + greatest(eight(feature, SHARPEST * PLANE + i), 0.0)
        put(scratch, DIFFER + i, differ / (differ + ALIKE))
    ask(said, inputs, hidden, other, count, scratch)
    for i in range(0, count, EIGHT):
        differ = eight(scratch, DIFFER + i)
        d0 = least(greatest(eight(scratch, i) * differ, -MOST), MOST)
        d1 = least(greatest(eight(scratch, PLANE + i) * differ, -MOST), MOST)
        d2 = least(greatest(eight(scratch, 2 * PLANE + i) * differ, -MOST), MOST)
        d3 = least(greatest(eight(scratch, 3 * PLANE + i) * differ, -MOST), MOST)
        d4 = least(greatest(eight(scratch, 4 * PLANE + i) * differ, -MOST), MOST)
        turn = least(greatest(eight(scratch, 5 * PLANE + i) * differ, -MOST), MOST) * GATE_GAIN
        turn = least(greatest(turn + eight(closed, GATE * PLANE + i), -MOST_GATE), MOST_GATE)
        gate = 1.0 / (1.0 + exponential(0.0 - turn))
        factor = exponential(said.free * least(greatest(eight(scratch, 6 * PLANE + i) * differ, -LOG_MOST), LOG_MOST))
        small = exponential(0.5 * gate * eight(closed, SMALLER * PLANE + i))
        root1 = d0 * small * eight(closed, ROOTS * PLANE + i)
        root2 = d1 * small * eight(closed, (ROOTS + 1) * PLANE + i)
        v_x = eight(closed, i) + gate * eight(closed, OTHER * PLANE + i)
        v_y = eight(closed, PLANE + i) + gate * eight(closed, (OTHER + 1) * PLANE + i)
        v_z = eight(closed, 2 * PLANE + i) + gate * eight(closed, (OTHER + 2) * PLANE + i)
        v_x = v_x + root1 * eight(closed, FIRST * PLANE + i) + root2 * eight(closed, SECOND * PLANE + i)
        v_y = v_y + root1 * eight(closed, (FIRST + 1) * PLANE + i)
        v_y = v_y + root2 * eight(closed, (SECOND + 1) * PLANE + i)
        v_z = v_z + root1 * eight(closed, (FIRST + 2) * PLANE + i)
        v_z = v_z + root2 * eight(closed, (SECOND + 2) * PLANE + i)
        flat = v_x * v_x + v_y * v_y
        v_z = greatest(v_z, root(flat) * (1.0 / STEEPEST_SLOPE))
        shrink = 1.0 / root(flat + v_z * v_z)
        n_x, n_y, n_z = v_x * shrink, v_y * shrink, v_z * shrink
        cos, sin = eight(closed, TURN * PLANE + i), eight(closed, (TURN + 1) * PLANE + i)
        cc, ss, cs = cos * cos, sin * sin, cos * sin
        a = eight(closed, LOG_TENSOR * PLANE + i) + cc * d2 + ss * d3 - 2.0 * cs * d4
        b = eight(closed, (LOG_TENSOR + 1) * PLANE + i) + ss * d2 + cc * d3 + 2.0 * cs * d4
        c = eight(closed, (LOG_TENSOR + 2) * PLANE + i) + cs * (d2 - d3) + (cc - ss) * d4
        a = a + gate * eight(closed, (OTHER + 3) * PLANE + i)
        b = b + gate * eight(closed, (OTHER + 4) * PLANE + i)
        c = c + gate * eight(closed, (OTHER + 5) * PLANE + i)
        a, b, c = bounded(a, b, c, said.log_low, said.round)
        put(result, i, n_x)
        put(result, PLANE + i, n_y)
        put(result, 2 * PLANE + i, n_z)
        put(result, 3 * PLANE + i, a)
        put(result, 4 * PLANE + i, b)
        put(result, 5 * PLANE + i, c)
        bright = eight(rows, at + i + COLOUR * PLANE) + eight(rows, at + i + (COLOUR + 1) * PLANE)
        bright = bright + eight(rows, at + i + (COLOUR + 2) * PLANE)
        lit = chosen(bright - 4.0 * DARKEST, all_of(1.0), all_of(0.0))
        put(result, SOME * PLANE + i, lit)
        factor = factor * lit
        length = 1.0 / (n_x * n_x + n_y * n_y + said.up * n_z * n_z)
        for k in range(3):
            put(result, (6 + k) * PLANE + i, factor * eight(rows, at + i + (COLOUR + k) * PLANE))
            d = at + i + (DIFFUSE + 3 * k) * PLANE
            light = n_x * eight(rows, d) + n_y * eight(rows, d + PLANE) + said.up * n_z * eight(rows, d + 2 * PLANE)
            put(result, (9 + k) * PLANE + i, greatest(light * length, 0.0))


@kernel
def interleave(planes, at, count, out, to):
    """Write three planes (3, PLANE) that begin at ``at`` as triples from out[to] on."""
    for i in range(count):
        out[to + 3 * i] = planes[at + i]
        out[to + 3 * i + 1] = planes[at + PLANE + i]
        out[to + 3 * i + 2] = planes[at + 2 * PLANE + i]


@kernel
def hand_over(result, at, count, first, has_diffuse, normal, log_roughness, specular, diffuse, strange, some):
    """Texels ``first`` and on of a level, whose images are flat, from ``result``."""
    interleave(result, at, count, normal, 3 * first)
    interleave(result, at + 3 * PLANE, count, log_roughness, 3 * first)
    interleave(result, at + 6 * PLANE, count, specular, 3 * first)
    if has_diffuse:
        interleave(result, at + 9 * PLANE, count, diffuse, 3 * first)
    for i in range(count):
        lit = result[at + SOME * PLANE + i] > 0.0
        some[first + i] = lit
        strange[first + i] = lit and not result[at + COVERED * PLANE + i] > 0.0


@kernel
def say_rows(
    base, tiles, tiles_row, first_row, rows, width, said, pooled, pooled_row, normal, log_roughness, specular, diffuse,
    strange, some,
):  # fmt: skip
    """Rows ``first_row`` (even) and on of a level ``width`` texels wide, whose images are flat.

    Their sums stand in ``tiles``, which begin with row ``tiles_row`` (even); where that is empty, the level is level 0
    and they come from the base. Those of the next level go to ``pooled``, which begins with row ``pooled_row`` (even),
    unless that is empty: half the size, both sides even.
    """
    from_base, pitch = tiles.size == 0, width + 2 + COLUMNS
    blended = np.zeros(BLENDS * CHANNELS * pitch if from_base else 1, np.float32)
    plain, sums = np.zeros_like(blended), np.zeros(SUMS * PLANE if from_base else 1)
    scratch, feature, closed = np.zeros((OUTPUTS + 1) * PLANE), np.zeros(FEATURES * PLANE), np.zeros(CLOSED * PLANE)
    inputs = np.zeros(FEATURES * PLANE, np.float32)
    hidden, other = np.zeros(said.widest * LANES * PLANE, np.float32), np.zeros(said.widest * LANES * PLANE, np.float32)
    result = np.zeros(RESULT * PLANE, np.float32)
    across = (width + COLUMNS - 1) // COLUMNS
    source, at = (sums if from_base else tiles), 0
    for row in range(first_row, first_row + rows, 2):
        pair = min(2, first_row + rows - row)
        if from_base:
            blend_rows(base, row, row == first_row, plain, blended, pitch)
        for first in range(0, width, COLUMNS):
            count = min(COLUMNS, width - first)
            padded = (count + EIGHT - 1) // EIGHT * EIGHT
            if from_base:
                sample_columns(blended, pitch, first, padded, base.isotropic, base.has_diffuse, sums)
            else:
                at = ((row - tiles_row) // 2 * across + first // COLUMNS) * SUMS * PLANE
            whole = padded == COLUMNS and pair == 2
            if whole:
                say(source, at, PLANE, said, scratch, feature, closed, inputs, hidden, other, result)
            for r in range(pair):
                if not whole:
                    say(source, at + r * COLUMNS, padded, said, scratch, feature, closed, inputs, hidden, other, result)
                hand_over(
                    result, r * COLUMNS if whole else 0, count, (row + r) * width + first, base.has_diffuse,
                    normal, log_roughness, specular, diffuse, strange, some,
                )  # fmt: skip
            if pooled.size:
                to = row // 2 - pooled_row
                pool_columns(source, at, count, base.has_diffuse, pooled, to, first // 2, width // 2)
