"""Convolution of images in blocks of 16 channels, forward and backward; a dense layer is a 1x1 convolution.

An image of C channels is stored as (ceil(C / 16), height + 2 m, width + 2 m, 16) float32, flat, with a margin m of
zeros (m >= r for filters of side 2 r + 1); the width is a multiple of ``PIXELS``. Weights are stored as
(outs, side * side, ins, 16 of input, 16 of output), outs and ins counting blocks:

    y[p, o] = f(bias[o] + sum_{d, c} x[p + d, c] w[o, d, c]),     f(z) = z, or slope * z where z < 0.

Backward, with g = dL/dz: dL/dx[p, c] = sum_{d, o} w[o, d, c] g[p - d, o],  dL/dw[o, d, c] = sum_p x[p + d, c] g[p, o].
The margin of every array stays zero, so all sums run over the interior.
"""

from __future__ import annotations

import numpy as np

from brdffit._jit import kernel
from brdffit.nets.vectors import (
    LANES,
    PIXELS,
    add,
    leak,
    load,
    loaded8,
    loaded16,
    multiply_add8,
    multiply_add16,
    repeated8,
    store,
    stored8,
    stored16,
)

_BLOCK = LANES * LANES
_TILE = PIXELS * LANES


@kernel
def convolve(x, weights, bias, y, y_at, height, width, margin, ins, outs, reach, slope):
    """Write ``outs`` blocks of y from flat index ``y_at`` on, from the first ``ins`` blocks of x.

    x and y may be one array if the blocks do not overlap.
    """
    pitch, side = width + 2 * margin, 2 * reach + 1
    plane = (height + 2 * margin) * pitch
    for o in range(outs):
        for row in range(height):
            for column in range(0, width, PIXELS):
                sums = repeated8(bias, o * LANES)
                for b in range(ins):
                    for dy in range(side):
                        for dx in range(side):
                            corner = (row + dy + margin - reach) * pitch + column + dx + margin - reach
                            pixel = (b * plane + corner) * LANES
                            weight = ((o * side * side + dy * side + dx) * ins + b) * _BLOCK
                            for c in range(LANES):
                                sums = multiply_add8(sums, x, pixel + c, LANES, load(weights, weight + c * LANES))
                target = y_at + (o * plane + (row + margin) * pitch + column + margin) * LANES
                stored8(sums, y, target, LANES, slope)


@kernel
def convolve_back(dy, dy_at, transposed, dx, height, width, margin, ins, outs, reach):
    """Add dL/dx to the first ``ins`` blocks of dx, from dL/dz at dy[dy_at:].

    dx and dy may be one array if the blocks do not overlap. ``transposed`` is from ``transposed_weights``.
    """
    pitch, side, one = width + 2 * margin, 2 * reach + 1, np.float32(1.0)
    plane = (height + 2 * margin) * pitch
    for b in range(ins):
        for row in range(height):
            for column in range(0, width, PIXELS):
                target = (b * plane + (row + margin) * pitch + column + margin) * LANES
                sums = loaded8(dx, target, LANES)
                for o in range(outs):
                    for ky in range(side):
                        for kx in range(side):
                            corner = (row + margin + reach - ky) * pitch + column + margin + reach - kx
                            pixel = dy_at + (o * plane + corner) * LANES
                            weight = ((o * side * side + ky * side + kx) * ins + b) * _BLOCK
                            for c in range(LANES):
                                sums = multiply_add8(sums, dy, pixel + c, LANES, load(transposed, weight + c * LANES))
                stored8(sums, dx, target, LANES, one)


@kernel
def weigh_back(dy, dy_at, x, d_weights, d_bias, height, width, margin, ins, outs, reach):
    """Add dL/dw and dL/dbias."""
    pitch, side, one = width + 2 * margin, 2 * reach + 1, np.float32(1.0)
    plane = (height + 2 * margin) * pitch
    for o in range(outs):
        for ky in range(side):
            for kx in range(side):
                for b in range(ins):
                    weight = ((o * side * side + ky * side + kx) * ins + b) * _BLOCK
                    sums = loaded16(d_weights, weight, LANES)
                    for row in range(height):
                        source = (b * plane + (row + ky + margin - reach) * pitch + kx + margin - reach) * LANES
                        target = dy_at + (o * plane + (row + margin) * pitch + margin) * LANES
                        for column in range(width):
                            shift = column * LANES
                            sums = multiply_add16(sums, x, source + shift, 1, load(dy, target + shift))
                    stored16(sums, d_weights, weight, LANES, one)
        total = load(d_bias, o * LANES)
        for row in range(height):
            target = dy_at + (o * plane + (row + margin) * pitch + margin) * LANES
            for column in range(width):
                total = add(total, load(dy, target + column * LANES))
        store(d_bias, o * LANES, total)


@kernel
def rectify_back(y, y_at, dy, dy_at, size, slope):
    """Turn ``size`` numbers of dL/dy into dL/dz, in place: multiply by ``slope`` where y is not positive."""
    for i in range(0, size, LANES):
        store(dy, dy_at + i, leak(load(dy, dy_at + i), load(y, y_at + i), slope))


def transposed_weights(weights: np.ndarray) -> np.ndarray:
    """Flat weights with every 16 x 16 block transposed."""
    return np.ascontiguousarray(weights.reshape(-1, LANES, LANES).transpose(0, 2, 1)).reshape(-1)


def to_blocks(image: np.ndarray, margin: int) -> np.ndarray:
    """An image (H, W, C) as flat blocks with a margin of zeros; channels that pad the last block are 0."""
    height, width, channels = image.shape
    blocks = -(-channels // LANES)
    out = np.zeros((blocks, height + 2 * margin, width + 2 * margin, LANES), np.float32)
    inside = out[:, margin : margin + height, margin : margin + width]
    for b in range(blocks):
        part = image[..., b * LANES : (b + 1) * LANES]
        inside[b, ..., : part.shape[2]] = part
    return out.reshape(-1)


def from_blocks(flat: np.ndarray, blocks: int, height: int, width: int, margin: int) -> np.ndarray:
    """The inverse of ``to_blocks``: (H, W, 16 * blocks)."""
    image = flat.reshape(blocks, height + 2 * margin, width + 2 * margin, LANES)
    inside = image[:, margin : margin + height, margin : margin + width]
    return np.ascontiguousarray(inside.transpose(1, 2, 0, 3)).reshape(height, width, blocks * LANES)
