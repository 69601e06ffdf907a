"""The parallax offset of a block of queries, forward, backward, and its training by the depths of a traced surface.

See ``material`` for the formulas. Where the surface can be traced, the shift s* from a point of the plane to the point
that is seen is known, and the module can be taught it alone: the loss of a query, in texels of level 0, is

    sqrt(|s - s*|^2 + d^2) - d,      by s:  (s - s*) / sqrt(|s - s*|^2 + d^2).

Close to s* it is a square; far away it grows like the distance, so that beside an edge, where s* jumps, one of the two
sides is learned rather than the middle between them, at which nothing is seen.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel
from brdffit.neural.kernels.dense import (
    LAYERS,
    MATRIX,
    NARROW,
    PITCH,
    ROWS,
    UNITS,
    chain_back,
    forward,
    transpose,
)
from brdffit.neural.kernels.textures import CHANNELS, interpolate, scatter, spread

_F = np.float32
#: Inputs of the offset network.
OFFSET_INPUTS = CHANNELS + 2
_STEEPEST_VIEW = _F(0.6)
#: d, in texels.
_NEAR = _F(0.25)


@inline
def height_of(x, y):
    """z of the direction with these x and y."""
    return math.sqrt(max(_F(1.0) - x * x - y * y, _F(0.0)))


@kernel
def offset_block(network, texture, rooms, queries, start, reach, inputs, hidden, out, shift, places, kept):
    """Where a block reads the pyramid: ``shift`` (2 * ROWS), in texels of level 0; ``reach`` = (x, y) of r = 1."""
    one, zero = _F(1.0), _F(0.0)
    for i in range(2 * ROWS):
        shift[i] = zero
    interpolate(texture, rooms, 1, queries, start, shift, inputs, places, kept)
    for i in range(ROWS):
        at = i * NARROW
        inputs[at + CHANNELS], inputs[at + CHANNELS + 1] = queries[start + i, 5], queries[start + i, 6]
        inputs[at + OFFSET_INPUTS] = one
        for k in range(OFFSET_INPUTS + 1, NARROW):
            inputs[at + k] = zero
    forward(network, 0, OFFSET_INPUTS, 2, inputs, NARROW, hidden[0], PITCH, zero)
    forward(network, MATRIX, UNITS, 2, hidden[0], PITCH, hidden[1], PITCH, zero)
    forward(network, 2 * MATRIX, UNITS, 2, hidden[1], PITCH, hidden[2], PITCH, zero)
    forward(network, 3 * MATRIX, UNITS, 1, hidden[2], PITCH, out, NARROW, one)
    for i in range(ROWS):
        vx, vy = queries[start + i, 5], queries[start + i, 6]
        depth = out[i * NARROW] / max(height_of(vx, vy), _STEEPEST_VIEW)
        shift[2 * i], shift[2 * i + 1] = reach[0] * depth * vx, -reach[1] * depth * vy


@kernel
def offset_back(
    transposed, texture_gradient, gradient, queries, start, reach, inputs, hidden, d_shift, places, kept, d_hidden,
    d_inputs, d_out,
):  # fmt: skip
    """Add the gradients of the offset network and of its texture, from dL/dshift."""
    for i in range(ROWS):
        vx, vy = queries[start + i, 5], queries[start + i, 6]
        by_depth = reach[0] * vx * d_shift[2 * i] - reach[1] * vy * d_shift[2 * i + 1]
        d_out[i * NARROW] = by_depth / max(height_of(vx, vy), _STEEPEST_VIEW)
        for k in range(1, NARROW):
            d_out[i * NARROW + k] = _F(0.0)
    chain_back(transposed, gradient, 1, inputs, hidden, d_out, d_hidden, d_inputs)
    spread(d_inputs)
    scatter(texture_gradient, 1, d_inputs, places, kept)


@kernel
def guide_part(
    first, last, queries, shifts, rooms, texture, network, reach, texture_gradient, gradient, rows, hidden, d_hidden,
    transposed, places, losses,
):  # fmt: skip
    """Add the gradients of the offset module from true shifts (n, 2), for blocks ``first`` to ``last`` of a batch."""
    _, _, d_out, d_inputs, inputs, out = rows
    _, _, corners, fractions, shift, d_shift = places
    transpose(network, LAYERS, OFFSET_INPUTS, transposed[1])
    for block in range(first, last):
        start = block * ROWS
        offset_block(network, texture, rooms, queries, start, reach, inputs, hidden, out, shift, corners, fractions)
        for i in range(ROWS):
            x, y = shift[2 * i] - shifts[start + i, 0], shift[2 * i + 1] - shifts[start + i, 1]
            length = math.sqrt(x * x + y * y + _NEAR * _NEAR)
            losses[0] += length - _NEAR
            d_shift[2 * i], d_shift[2 * i + 1] = x / length, y / length
        offset_back(
            transposed[1], texture_gradient, gradient, queries, start, reach, inputs, hidden, d_shift, corners,
            fractions, d_hidden, d_inputs, d_out,
        )  # fmt: skip
