"""One block of queries through the whole material, forward and backward (Kuznetsov et al. 2021, equation 8).

    r = F_off(T_off(u), v),     u' = u + r H(v),     H(v) = reach (v_x, -v_y) / max(v_z, 0.6),
    f = P(u', level),           o = F(f, directions),      p = (exp(o_c) - 1) (0.1 + sigmoid(m_c)),  c = r, g, b.

Rows of textures go down, +Y up: hence the sign. The factor of the sigmoid is the "shadow mask" of the authors' code.
As printed, m_c = o_{3 + c} and the directions are (l_x, l_y, v_x, v_y).

Seen from the texel's own frame, m_c = o_{3 + c} + f_{3 + c}: the texel's own colour multiplies the light, which four
layers learn late, since a false hue costs little of the loss. Where o_{3 + c} is large the colour is white, as that
of a highlight. The frame is a tilt t = (f_0, f_1) and a width of its lobe w = exp(-4 f_2), so that a sharp lobe has a
simple place: with the half vector h, u = h_xy + t h_z and g = u_x^2 + u_y^2, the directions are

    (2 u_x, 2 u_y, v_x, v_y, -ln(g + w) / 4, l_z - t . l_xy, v_z - t . v_xy):

u is 0 where h is the normal of slopes t, a lobe of GGX with alpha^2 = w is w / (g + w)^2 up to h_z, whose logarithm is
linear in f_2 and the fifth of these, and the last two are cosines to that normal, up to its length. By t: du = h_z dt,
d(l_z - t . l_xy) = -l_xy dt; by f_2: d(-ln(g + w) / 4) = w / (g + w) df_2; by f_{3 + c}, beside what goes through the
decoder: dp = dp/dm_c df_{3 + c}.

Losses of a channel, with target y: (ln(1 + p) - ln(1 + y))^2 as the paper, with p at least -0.2; or its linearised
form (p - y)^2 / (1 + p)^2 with the denominator held, whose gradient at p = E[y] has the mean 0 whatever the noise of
y: one sample of a target is enough, where the logarithm's fixed point lies below the mean.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel
from brdffit.neural.kernels.dense import LAYERS, MATRIX, NARROW, PITCH, ROWS, UNITS, chain_back, forward, transpose
from brdffit.neural.kernels.offset import OFFSET_INPUTS, height_of, offset_back, offset_block
from brdffit.neural.kernels.textures import CHANNELS, by_position, interpolate, scatter, spread

_F = np.float32
#: Columns of a query: x, y in texels of level 0, level, light x and y, view x and y, and one that is not read.
QUERY = 8
#: Outputs of the decoder: three colours, three masks.
OUTPUTS = 6
#: Inputs of the decoder as printed, and seen from a learned tilt.
PLAIN_INPUTS, TILTED_INPUTS = CHANNELS + 4, CHANNELS + 7
#: Features that are a texel's own colour: the first of three. Read by ``guidance`` and ``network``, too.
OWN_COLOUR = 3
#: The mask of m_c = -infinity; that of +infinity is larger by 1.
LEAST_MASK = 0.1
_LEAST_MASK = _F(LEAST_MASK)
#: Bounds of f_2: lobes of an alpha between 0.007 and 2.7.
_WIDEST, _NARROWEST = _F(-0.5), _F(2.5)
_LEAST = _F(-0.2)


@inline
def _sigmoid(x):
    return _F(1.0) / (_F(1.0) + math.exp(-x))


@inline
def _width(feature):
    """w of a texel."""
    return math.exp(_F(-4.0) * min(max(feature, _WIDEST), _NARROWEST))


@inline
def _bounded(x):
    """What is exponentiated: within what colours need."""
    return min(max(x, _F(-3.0)), _F(7.0))


@kernel
def direct(tilted, queries, start, inputs):
    """Put the directions of a block, and the 1 behind them, beside its features."""
    zero, one = _F(0.0), _F(1.0)
    for i in range(ROWS):
        lx, ly, vx, vy = queries[start + i, 3], queries[start + i, 4], queries[start + i, 5], queries[start + i, 6]
        at = i * NARROW + CHANNELS
        if not tilted:
            inputs[at], inputs[at + 1], inputs[at + 2], inputs[at + 3], inputs[at + 4] = lx, ly, vx, vy, one
            for k in range(5, NARROW - CHANNELS):
                inputs[at + k] = zero
            continue
        lz, vz = height_of(lx, ly), height_of(vx, vy)
        hx, hy, hz = lx + vx, ly + vy, lz + vz
        scale = one / math.sqrt(max(hx * hx + hy * hy + hz * hz, _F(1e-12)))
        hz = hz * scale
        t0, t1 = inputs[i * NARROW], inputs[i * NARROW + 1]
        ux, uy = hx * scale + t0 * hz, hy * scale + t1 * hz
        inputs[at], inputs[at + 1], inputs[at + 2], inputs[at + 3] = _F(2.0) * ux, _F(2.0) * uy, vx, vy
        inputs[at + 4] = _F(-0.25) * math.log(ux * ux + uy * uy + _width(inputs[i * NARROW + 2]))
        inputs[at + 5] = lz - t0 * lx - t1 * ly
        inputs[at + 6] = vz - t0 * vx - t1 * vy
        inputs[at + 7] = one
        inputs[at + 8] = zero


@kernel
def direct_back(queries, start, inputs, d_out, d_inputs):
    """Add what goes round the decoder to dL/df: through directions in a texel's own frame, and through its colour."""
    for i in range(ROWS):
        for c in range(3):
            d_inputs[i * NARROW + OWN_COLOUR + c] += d_out[i * NARROW + 3 + c]
        lx, ly, vx, vy = queries[start + i, 3], queries[start + i, 4], queries[start + i, 5], queries[start + i, 6]
        at, own = i * NARROW + CHANNELS, i * NARROW
        hx, hy, hz = lx + vx, ly + vy, height_of(lx, ly) + height_of(vx, vy)
        hz = hz / math.sqrt(max(hx * hx + hy * hy + hz * hz, _F(1e-12)))
        ux, uy = _F(0.5) * inputs[at], _F(0.5) * inputs[at + 1]
        width = _width(inputs[own + 2])
        by_sum = d_inputs[at + 4] / (ux * ux + uy * uy + width)
        by_log = _F(-0.5) * by_sum
        if _WIDEST < inputs[own + 2] < _NARROWEST:
            d_inputs[own + 2] += width * by_sum
        d_inputs[own] += hz * (_F(2.0) * d_inputs[at] + by_log * ux) - lx * d_inputs[at + 5] - vx * d_inputs[at + 6]
        d_inputs[own + 1] += (
            hz * (_F(2.0) * d_inputs[at + 1] + by_log * uy) - ly * d_inputs[at + 5] - vy * d_inputs[at + 6]
        )


@kernel
def decode_block(network, tilted, inputs, hidden, out):
    """o_c and m_c of a block whose features and directions are in ``inputs``."""
    ins = TILTED_INPUTS if tilted else PLAIN_INPUTS
    one, zero = _F(1.0), _F(0.0)
    forward(network, 0, ins, 2, inputs, NARROW, hidden[0], PITCH, zero)
    forward(network, MATRIX, UNITS, 2, hidden[0], PITCH, hidden[1], PITCH, zero)
    forward(network, 2 * MATRIX, UNITS, 2, hidden[1], PITCH, hidden[2], PITCH, zero)
    forward(network, 3 * MATRIX, UNITS, 1, hidden[2], PITCH, out, NARROW, one)
    if tilted:
        for i in range(ROWS):
            for c in range(3):
                out[i * NARROW + 3 + c] += inputs[i * NARROW + OWN_COLOUR + c]


@kernel
def colours(out, start, colour):
    """p of a block, at least 0, into colour[start : start + ROWS]."""
    for i in range(ROWS):
        for c in range(3):
            value = math.exp(_bounded(out[i * NARROW + c])) - _F(1.0)
            mask = _LEAST_MASK + _sigmoid(out[i * NARROW + 3 + c])
            colour[start + i, c] = max(value * mask, _F(0.0))


@kernel
def loss_back(out, targets, start, logarithmic, d_out):
    """The sum of a block's losses; d_out becomes dL/do_c and dL/dm_c."""
    one, two = _F(1.0), _F(2.0)
    loss = 0.0
    for i in range(ROWS):
        at = i * NARROW
        for k in range(OUTPUTS, NARROW):
            d_out[at + k] = _F(0.0)
        for c in range(3):
            value = math.exp(_bounded(out[at + c]))
            sigmoid = _sigmoid(out[at + 3 + c])
            mask = _LEAST_MASK + sigmoid
            found, target = max((value - one) * mask, _LEAST), targets[start + i, c]
            if logarithmic:
                wrong = math.log(one + found) - math.log(one + target)
                by_found = two * wrong / (one + found)
            else:
                wrong = (found - target) / (one + found)
                by_found = two * wrong / (one + found)
            loss += wrong * wrong
            d_out[at + c] = by_found * mask * value
            d_out[at + 3 + c] = by_found * (value - one) * sigmoid * (one - sigmoid)
    return loss


@kernel
def train_part(
    first, last, queries, targets, rooms, pyramid, offset_texture, decoder, offsets, reach, tilted, with_offset,
    learn_offset, logarithmic, pyramid_gradient, texture_gradient, decoder_gradient, offsets_gradient, rows, hidden,
    offset_hidden, d_hidden, transposed, places, losses,
):  # fmt: skip
    """Add the gradients of blocks ``first`` to ``last`` of a batch, and their losses to losses[0].

    Scratch of one part: ``rows`` six arrays of NARROW columns, ``hidden``, ``offset_hidden`` and ``d_hidden`` of PITCH,
    ``transposed`` two networks, ``places`` what textures keep, and shifts; see ``Scratch``. Offsets get no gradient
    unless ``learn_offset``.
    """
    ins = TILTED_INPUTS if tilted else PLAIN_INPUTS
    inputs, out, d_out, d_inputs, offset_inputs, offset_out = rows
    corners, fractions, offset_corners, offset_fractions, shift, d_shift = places
    transpose(decoder, LAYERS, ins, transposed[0])
    transpose(offsets, LAYERS, OFFSET_INPUTS, transposed[1])
    for i in range(2 * ROWS):
        shift[i] = _F(0.0)
    for block in range(first, last):
        start = block * ROWS
        if with_offset:
            offset_block(
                offsets, offset_texture, rooms, queries, start, reach, offset_inputs, offset_hidden, offset_out, shift,
                offset_corners, offset_fractions,
            )  # fmt: skip
        interpolate(pyramid, rooms, 2, queries, start, shift, inputs, corners, fractions)
        direct(tilted, queries, start, inputs)
        decode_block(decoder, tilted, inputs, hidden, out)
        losses[0] += loss_back(out, targets, start, logarithmic, d_out)
        chain_back(transposed[0], decoder_gradient, OUTPUTS, inputs, hidden, d_out, d_hidden, d_inputs)
        if tilted:
            direct_back(queries, start, inputs, d_out, d_inputs)
        spread(d_inputs)
        scatter(pyramid_gradient, 2, d_inputs, corners, fractions)
        if with_offset and learn_offset:
            by_position(pyramid, d_inputs, corners, fractions, d_shift)
            offset_back(
                transposed[1], texture_gradient, offsets_gradient, queries, start, reach, offset_inputs, offset_hidden,
                d_shift, offset_corners, offset_fractions, d_hidden, d_inputs, d_out,
            )  # fmt: skip


@kernel
def look_up_part(
    first, last, queries, rooms, pyramid, offset_texture, offsets, reach, with_offset, inputs, hidden, out, corners,
    fractions, shift, found,
):  # fmt: skip
    """What depends on the view alone: the 7 features of each query, into found (n, 8)."""
    for i in range(2 * ROWS):
        shift[i] = _F(0.0)
    for block in range(first, last):
        start = block * ROWS
        if with_offset:
            offset_block(
                offsets, offset_texture, rooms, queries, start, reach, inputs, hidden, out, shift, corners, fractions
            )
        interpolate(pyramid, rooms, 2, queries, start, shift, inputs, corners, fractions)
        for i in range(ROWS):
            for c in range(CHANNELS):
                found[start + i, c] = inputs[i * NARROW + c]


@kernel
def decode_part(first, last, features, queries, decoder, tilted, inputs, hidden, out, colour):
    """p for a light each, from features (n, 8), into colour (n, 3)."""
    for block in range(first, last):
        start = block * ROWS
        for i in range(ROWS):
            for c in range(CHANNELS):
                inputs[i * NARROW + c] = features[start + i, c]
        direct(tilted, queries, start, inputs)
        decode_block(decoder, tilted, inputs, hidden, out)
        colours(out, start, colour)
