"""Networks: chains of dense layers, and DenseNets of convolutions; all weights of a network are one vector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from brdffit.nets.convolution import (
    convolve,
    convolve_back,
    from_blocks,
    rectify_back,
    to_blocks,
    transposed_weights,
    weigh_back,
)
from brdffit.nets.vectors import LANES, PIXELS

#: Slope of the leaky rectifier below 0.
SLOPE = 0.1
#: Rows of a batch that go through a chain together, so that their features fit a core's cache.
_ROWS = 1024


@dataclass(frozen=True)
class Layer:
    """A convolution with a leaky rectifier, and the place of its weights in the network's vector.

    Attributes:
        ins, outs: blocks of 16 channels of input and output.
        reach: the filter's side is 2 reach + 1.
        slope: of the rectifier below 0; 1 for a linear layer.
        first: index of its first weight.
    """

    ins: int
    outs: int
    reach: int
    slope: float
    first: int

    @property
    def weights(self) -> slice:
        """Range of its weights."""
        return slice(self.first, self.first + self.outs * (2 * self.reach + 1) ** 2 * self.ins * LANES * LANES)

    @property
    def bias(self) -> slice:
        """Range of its bias, which follows its weights."""
        return slice(self.weights.stop, self.weights.stop + self.outs * LANES)

    def blocks_of(self, vector: NDArray) -> NDArray:
        """A view of its weights in the network's vector: (outs, side * side, ins, 16 of input, 16 of output)."""
        side = 2 * self.reach + 1
        return vector[self.weights].reshape(self.outs, side * side, self.ins, LANES, LANES)

    def forward(self, vector: NDArray, x: NDArray, y: NDArray, y_at: int, shape: tuple[int, int], margin: int) -> None:
        """Write the output for x to y[y_at:]; ``shape`` is (height, width), see ``convolution.convolve``."""
        convolve(
            x, vector[self.weights], vector[self.bias], y, y_at, *shape, margin, self.ins, self.outs, self.reach,
            np.float32(self.slope),
        )  # fmt: skip

    def backward(
        self, vector: NDArray, gradient: NDArray, x: NDArray, y: NDArray, y_at: int, dx: NDArray | None, dy: NDArray,
        dy_at: int, shape: tuple[int, int], margin: int,
    ) -> None:  # fmt: skip
        """Add to the gradient of its weights, and to dx unless that is None; dy[dy_at:] becomes dL/dz."""
        if self.slope != 1.0:
            size = self.outs * (shape[0] + 2 * margin) * (shape[1] + 2 * margin) * LANES
            rectify_back(y, y_at, dy, dy_at, size, np.float32(self.slope))
        place = (*shape, margin, self.ins, self.outs, self.reach)
        weigh_back(dy, dy_at, x, gradient[self.weights], gradient[self.bias], *place)
        if dx is not None:
            convolve_back(dy, dy_at, transposed_weights(vector[self.weights]), dx, *place)


def _blocks(channels: int) -> int:
    return -(-channels // LANES)


class Network:
    """Weights (n,) float32 of some layers, and their gradient.

    Initial weights are those of He et al. 2015; weights of padding channels and biases are 0.
    """

    def __init__(self) -> None:
        self.layers: list[Layer] = []
        self.weights = np.zeros(0, np.float32)
        self.gradient = np.zeros(0, np.float32)

    def _allocate(self, layers: list[Layer], used: list[tuple[int, int, float]], rng: np.random.Generator) -> None:
        """``used``: for each layer, channels in and out without padding, and a factor of the initial weights."""
        self.layers = layers
        self.weights = np.zeros(layers[-1].bias.stop, np.float32)
        self.gradient = np.zeros_like(self.weights)
        for layer, (ins, outs, gain) in zip(layers, used, strict=True):
            taps = (2 * layer.reach + 1) ** 2
            drawn = rng.standard_normal((taps, ins, outs)) * gain * np.sqrt(2.0 / (taps * ins))
            padded = np.zeros((taps, layer.ins * LANES, layer.outs * LANES), np.float32)
            padded[:, :ins, :outs] = drawn
            layer.blocks_of(self.weights)[:] = padded.reshape(taps, layer.ins, LANES, layer.outs, LANES).transpose(
                3, 0, 1, 2, 4
            )


class DenseChain(Network):
    """Dense layers one after another, leaky rectifiers after all but the last: rows (n, ins) to rows (n, outs).

    Args:
        sizes: channels of input, hidden layers and output.
        rng: draws the initial weights.
        last_gain: factor of the last layer's initial weights; 0 makes the initial output 0.
    """

    def __init__(self, sizes: tuple[int, ...], rng: np.random.Generator, last_gain: float = 1.0) -> None:
        super().__init__()
        self.sizes = sizes
        layers, used = [], []
        first = 0
        for k, (ins, outs) in enumerate(zip(sizes, sizes[1:], strict=False)):
            last = k == len(sizes) - 2
            layers.append(Layer(_blocks(ins), _blocks(outs), 0, 1.0 if last else SLOPE, first))
            used.append((ins, outs, last_gain if last else 1.0))
            first = layers[-1].bias.stop
        self._allocate(layers, used, rng)
        self.kept: list[list[NDArray]] = []

    def forward(self, rows: NDArray, keep: bool = False) -> NDArray:
        """Outputs (n, outs) float32 of rows (n, ins); with ``keep``, ``self.kept`` gets what ``backward`` needs."""
        out = np.empty((len(rows), self.sizes[-1]), np.float32)
        self.kept = []
        for start in range(0, len(rows), _ROWS):
            part = rows[start : start + _ROWS]
            shape = (1, -(-len(part) // PIXELS) * PIXELS)
            image = np.zeros((*shape, part.shape[1]), np.float32)
            image[0, : len(part)] = part
            features = [to_blocks(image, 0)]
            for layer in self.layers:
                made = np.empty(layer.outs * shape[1] * LANES, np.float32)
                layer.forward(self.weights, features[-1], made, 0, shape, 0)
                features.append(made)
            out[start : start + len(part)] = from_blocks(made, self.layers[-1].outs, *shape, 0)[
                0, : len(part), : out.shape[1]
            ]
            if keep:
                self.kept.append(features)
        return out

    def backward(self, d_out: NDArray, kept: list[list[NDArray]] | None = None, to_rows: bool = False) -> NDArray:
        """Add to the gradient, from dL/d(output) (n, outs).

        Args:
            d_out: for the outputs of the last ``forward`` with ``keep``, or of the one that ``kept`` is from.
            kept: ``self.kept`` of an earlier ``forward``.
            to_rows: whether to return dL/d(rows) (n, ins); otherwise an empty array is returned.
        """
        by_rows = np.zeros((len(d_out) if to_rows else 0, self.sizes[0]), np.float32)
        for k, features in enumerate(self.kept if kept is None else kept):
            part = d_out[k * _ROWS : (k + 1) * _ROWS]
            shape = (1, -(-len(part) // PIXELS) * PIXELS)
            image = np.zeros((*shape, part.shape[1]), np.float32)
            image[0, : len(part)] = part
            dy = to_blocks(image, 0)
            for i in reversed(range(len(self.layers))):
                layer = self.layers[i]
                dx = np.zeros(layer.ins * shape[1] * LANES, np.float32) if i or to_rows else None
                layer.backward(self.weights, self.gradient, features[i], features[i + 1], 0, dx, dy, 0, shape, 0)
                if dx is not None:
                    dy = dx
            if to_rows:
                rows = from_blocks(dy, self.layers[0].ins, *shape, 0)[0, : len(part), : self.sizes[0]]
                by_rows[k * _ROWS : k * _ROWS + len(part)] = rows
        return by_rows


class DenseNet(Network):
    """A DenseNet (Huang et al. 2017): each layer reads the input and all earlier layers and adds 16 channels.

    Args:
        ins, outs: channels of input and output.
        depth: layers of 16 channels with leaky rectifiers; a linear 1x1 head follows.
        reach: 1 for 3x3 filters, 0 for 1x1.
        rng: draws the initial weights.
        head_gain: factor of the head's initial weights.
    """

    def __init__(
        self, ins: int, outs: int, depth: int, reach: int, rng: np.random.Generator, head_gain: float = 1.0
    ) -> None:
        super().__init__()
        self.ins, self.outs, self.reach, self.depth = ins, outs, reach, depth
        blocks = _blocks(ins)
        layers, used, first = [], [], 0
        for i in range(depth):
            layers.append(Layer(blocks + i, 1, reach, SLOPE, first))
            # Weights of channels that pad the input are drawn too but see zeros, so the variance is scaled up.
            used.append(((blocks + i) * LANES, LANES, np.sqrt((blocks + i) * LANES / (ins + i * LANES))))
            first = layers[-1].bias.stop
        layers.append(Layer(blocks + depth, _blocks(outs), 0, 1.0, first))
        used.append(((blocks + depth) * LANES, outs, head_gain * np.sqrt(0.5)))
        self._allocate(layers, used, rng)
        self._features = np.zeros(0, np.float32)

    def forward(self, image: NDArray) -> NDArray:
        """(H, W, outs) of an image (H, W, ins), W a multiple of 8; keeps what ``backward`` needs."""
        height, width = image.shape[:2]
        margin, blocks = self.reach, _blocks(self.ins)
        plane = (height + 2 * margin) * (width + 2 * margin) * LANES
        features = np.zeros((blocks + self.depth) * plane, np.float32)
        features[: blocks * plane] = to_blocks(image, margin)
        for i, layer in enumerate(self.layers[:-1]):
            layer.forward(self.weights, features, features, (blocks + i) * plane, (height, width), margin)
        head = self.layers[-1]
        made = np.zeros(head.outs * plane, np.float32)
        head.forward(self.weights, features, made, 0, (height, width), margin)
        self._features = features
        return from_blocks(made, head.outs, height, width, margin)[..., : self.outs]

    def backward(self, d_out: NDArray) -> NDArray:
        """dL/d(image) (H, W, ins) from dL/d(output) (H, W, outs) of the last ``forward``; adds to the gradient."""
        height, width = d_out.shape[:2]
        margin, blocks, shape = self.reach, _blocks(self.ins), d_out.shape[:2]
        plane = (height + 2 * margin) * (width + 2 * margin) * LANES
        features, d_features = self._features, np.zeros_like(self._features)
        self.layers[-1].backward(
            self.weights, self.gradient, features, features, 0, d_features, to_blocks(d_out, margin), 0, shape, margin
        )
        for i in reversed(range(self.depth)):
            at = (blocks + i) * plane
            self.layers[i].backward(
                self.weights, self.gradient, features, features, at, d_features, d_features, at, shape, margin
            )
        return from_blocks(d_features[: blocks * plane], blocks, height, width, margin)[..., : self.ins]
