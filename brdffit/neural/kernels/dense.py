"""Dense layers of up to 31 units on blocks of ``ROWS`` queries, forward and backward by hand.

Features of a block are rows of floats; the column behind a layer's inputs holds 1, so that the bias is one more row of
its weights: with x' = (x, 1),

    z = x' W,    y = max(z, 0) or z;      dL/dW = x'^T dL/dz,    dL/dx = (dL/dz) W^T.

A layer's weights are a matrix of ``MATRIX`` = 26 x 32 numbers, row k the weights of input k, the row behind the inputs
the bias; what is beyond them is 0. A hidden layer's column ``ONE`` makes the 1 of the next: its bias there is 1.
Eight rows by 16 units are summed in registers at a time (see ``brdffit.nets.vectors``).
"""

from __future__ import annotations

import numpy as np

from brdffit._jit import kernel
from brdffit.nets.vectors import (
    LANES,
    leak,
    load,
    loaded13,
    loaded16,
    multiply_add8,
    multiply_add13,
    multiply_add16,
    repeated8,
    store,
    stored8,
    stored13,
    stored16,
)

#: Queries of a block: its features stay in the first two caches of a core.
ROWS = 64
#: Layers of each network.
LAYERS = 4
#: Units of a hidden layer.
UNITS = 25
#: The column of hidden features that holds 1.
ONE = UNITS
#: Floats of a row of hidden features and of weights.
PITCH = 32
#: Floats of a row of inputs, and of outputs.
NARROW = LANES
#: Floats of a layer's weights.
MATRIX = (UNITS + 1) * PITCH
#: Floats of a layer's transposed weights.
TRANSPOSED = PITCH * PITCH


@kernel
def forward(weights, at, ins, blocks, x, x_pitch, y, y_pitch, slope):
    """y = x' W, through max(z, 0) if ``slope`` is 0, and as it is if that is 1; ``blocks`` of 16 units."""
    for row in range(0, ROWS, 8):
        for block in range(blocks):
            first = at + block * LANES
            sums = repeated8(weights, first + ins * PITCH)
            for k in range(ins):
                sums = multiply_add8(sums, x, row * x_pitch + k, x_pitch, load(weights, first + k * PITCH))
            stored8(sums, y, row * y_pitch + block * LANES, y_pitch, slope)


@kernel
def backward(transposed, at, outs, blocks, dy, dy_pitch, dx, dx_pitch):
    """dx = dy W^T without the bias, from ``outs`` columns of dy into ``blocks`` of 16 columns of dx."""
    one = np.float32(1.0)
    for row in range(0, ROWS, 8):
        for block in range(blocks):
            first = at + block * LANES
            sums = repeated8(transposed, first + (PITCH - 1) * PITCH)
            for j in range(outs):
                sums = multiply_add8(sums, dy, row * dy_pitch + j, dy_pitch, load(transposed, first + j * PITCH))
            stored8(sums, dx, row * dx_pitch + block * LANES, dx_pitch, one)


@kernel
def rectify_back(y, dy):
    """Hidden dL/dz from dL/dy, in place: 0 where y is 0."""
    zero = np.float32(0.0)
    for i in range(0, ROWS * PITCH, LANES):
        store(dy, i, leak(load(dy, i), load(y, i), zero))


@kernel
def weigh_hidden(gradient, at, blocks, x, dy, dy_pitch):
    """Add dL/dW of a layer that reads hidden features."""
    one = np.float32(1.0)
    for block in range(blocks):
        for k in range(0, UNITS + 1, 13):
            first = at + k * PITCH + block * LANES
            sums = loaded13(gradient, first, PITCH)
            for row in range(ROWS):
                sums = multiply_add13(sums, x, row * PITCH + k, 1, load(dy, row * dy_pitch + block * LANES))
            stored13(sums, gradient, first, PITCH, one)


@kernel
def weigh_inputs(gradient, at, x, dy):
    """Add dL/dW of a first layer; what stands beyond its inputs must be 0."""
    one = np.float32(1.0)
    for block in range(2):
        first = at + block * LANES
        sums = loaded16(gradient, first, PITCH)
        for row in range(ROWS):
            sums = multiply_add16(sums, x, row * NARROW, 1, load(dy, row * PITCH + block * LANES))
        stored16(sums, gradient, first, PITCH, one)


@kernel
def transpose(weights, layers, ins, transposed):
    """W^T of each layer, without biases; all else 0. ``ins`` are the inputs of the first layer."""
    for i in range(layers * TRANSPOSED):
        transposed[i] = np.float32(0.0)
    for layer in range(layers):
        for k in range(ins if layer == 0 else UNITS):
            for j in range(UNITS):
                transposed[layer * TRANSPOSED + j * PITCH + k] = weights[layer * MATRIX + k * PITCH + j]


@kernel
def chain_back(transposed, gradient, outs, inputs, hidden, d_out, d_hidden, d_inputs):
    """Backward through the four layers of either network."""
    weigh_hidden(gradient, 3 * MATRIX, 1, hidden[2], d_out, NARROW)
    backward(transposed, 3 * TRANSPOSED, outs, 2, d_out, NARROW, d_hidden[0], PITCH)
    rectify_back(hidden[2], d_hidden[0])
    weigh_hidden(gradient, 2 * MATRIX, 2, hidden[1], d_hidden[0], PITCH)
    backward(transposed, 2 * TRANSPOSED, UNITS, 2, d_hidden[0], PITCH, d_hidden[1], PITCH)
    rectify_back(hidden[1], d_hidden[1])
    weigh_hidden(gradient, MATRIX, 2, hidden[0], d_hidden[1], PITCH)
    backward(transposed, TRANSPOSED, UNITS, 2, d_hidden[1], PITCH, d_hidden[0], PITCH)
    rectify_back(hidden[0], d_hidden[0])
    weigh_inputs(gradient, 0, inputs, d_hidden[0])
    backward(transposed, 0, UNITS, 1, d_hidden[0], PITCH, d_inputs, NARROW)
