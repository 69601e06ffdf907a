"""The networks behind the method ``latent`` (Kemppinen et al. 2023): a code whose linear filtering is prefiltering.

    theta_level = D(downsample(E(theta)))

The encoder E has six layers of 3x3, the decoder D four of 1x1, both DenseNets that add 16 maps a layer; the code has 64
channels. Inputs are whitened by the training set's mean and covariance, and outputs are put back. The lobe's tensor is
the exponential of what is said, so that it is always positive definite; its normal is said by x and y alone and lifted
to the hemisphere.

Differences from the paper: inputs are normal (2), log tensor (3), the log of the specular luminance, and ten products
of these whose averages LEAN needs (squares of the normal, tensor, luminance times normal), which layers of 3x3 would
take long to find; the sixth output is the log of the scale over the filtered colour, so that hues are filtered
linearly; and the networks start as plain averaging: the code's first channels are the inputs, the outputs are these.
"""

from __future__ import annotations

import copy
from concurrent.futures import Executor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.nets.layers import DenseNet
from brdffit.nets.vectors import LANES, PIXELS
from brdffit.nets.weights import read_weights, shaped
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf

KIND = "latent"
#: Weights that the program ships.
SHIPPED = Path(__file__).parent / "weights" / "latent-ggx.npz"
INPUTS, PLAIN, CODE, OUTPUTS = 16, 6, 64, 6
ENCODER_DEPTH, DECODER_DEPTH = 6, 4
#: Outputs: x and y of the normal, log tensor, log of the scale over the filtered colour.
NORMAL, TENSOR, FACTOR = slice(0, 2), slice(2, 5), 5
#: Longest x and y of a normal: beyond it is cut to this before it is lifted.
LONGEST = 0.995
#: Below this a specular colour is black.
_DARK = 1e-3
#: Side of a tile that is encoded at once, and how far a texel of the code sees.
_TILE, _APRON = 96, ENCODER_DEPTH
_ROWS = 8192


def inputs_of(normal: NDArray, log_roughness: NDArray, luminance: NDArray) -> NDArray:
    """The encoder's input (H, W, INPUTS), before whitening, of normals (H, W, 3), log tensors and luminance (H, W)."""
    x, y = normal[..., 0], normal[..., 1]
    light = np.maximum(luminance, 0.0)
    alpha = np.exp(0.25 * (log_roughness[..., 0] + log_roughness[..., 1]))
    sigma = tensor_from_log(log_roughness)
    channels = (x, y, *np.moveaxis(log_roughness, -1, 0), np.log(light + np.float32(_DARK)), x * x, x * y, y * y)
    return np.stack(
        [*channels, *np.moveaxis(sigma, -1, 0), light, light * x, light * y, alpha], axis=-1, dtype=np.float32
    )


class LatentNetworks:
    """Encoder, decoder and whitening.

    Attributes:
        mean: (INPUTS,) of the training set.
        whiten: (INPUTS, INPUTS): the first PLAIN by the inverse square root of their covariance, products by their
            deviation.
        colour: (PLAIN, PLAIN), the square root of that covariance.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self.encoder = DenseNet(INPUTS, CODE, ENCODER_DEPTH, 1, rng)
        self.decoder = DenseNet(CODE, OUTPUTS, DECODER_DEPTH, 0, rng)
        self.mean, self.whiten, self.colour = np.zeros(INPUTS), np.eye(INPUTS), np.eye(PLAIN)
        self._start_as_averaging()

    def _start_as_averaging(self) -> None:
        head = self.encoder.layers[-1].blocks_of(self.encoder.weights)
        head[0, ..., :INPUTS] = 0.0
        head[0, 0, 0, :INPUTS, :INPUTS] = np.eye(INPUTS)
        head = self.decoder.layers[-1].blocks_of(self.decoder.weights)
        head *= np.float32(0.05)
        head[0, 0, 0, :, :OUTPUTS] = np.eye(LANES, OUTPUTS)  # the rest is small
        head[..., FACTOR] = 0.0

    def whiten_by(self, samples: NDArray) -> None:
        """Take mean and covariance from inputs (n, INPUTS) of training."""
        self.mean = samples.mean(axis=0, dtype=np.float64)
        plain = np.cov(samples[:, :PLAIN].T.astype(np.float64)) + 1e-3 * np.eye(PLAIN)
        values, vectors = np.linalg.eigh(plain)
        self.whiten = np.diag(1.0 / (samples.std(axis=0, dtype=np.float64) + 1e-3))
        self.whiten[:PLAIN, :PLAIN] = (vectors / np.sqrt(values)) @ vectors.T
        self.colour = (vectors * np.sqrt(values)) @ vectors.T

    def encode(self, inputs: NDArray) -> NDArray:
        """Code (H, W, CODE) of inputs (H, W, INPUTS), W a multiple of 8, zeros beyond the border."""
        return self.encoder.forward(((inputs - self.mean) @ self.whiten).astype(np.float32))

    def encode_back(self, by_code: NDArray) -> None:
        """Add to the encoder's gradient, of the last ``encode``."""
        self.encoder.backward(by_code)

    def decode(self, code: NDArray) -> NDArray:
        """Outputs (n, OUTPUTS) float64 of codes (n, CODE)."""
        padded = -(-len(code) // PIXELS) * PIXELS
        image = np.zeros((1, padded, CODE), np.float32)
        image[0, : len(code)] = code
        out = self.decoder.forward(image)[0, : len(code)].astype(np.float64)
        # The scale's log is said as it is; the whitened colour stands where it stood, at its mean.
        said = out.copy()
        said[:, FACTOR] = 0.0
        said = said @ self.colour + self.mean[:PLAIN]
        said[:, FACTOR] = out[:, FACTOR]
        return said

    def decode_back(self, by_said: NDArray) -> NDArray:
        """dL/d(code) (n, CODE) from dL/d(outputs); adds to the decoder's gradient, of the last ``decode``."""
        by_out = by_said.copy()
        by_out[:, FACTOR] = 0.0
        by_out = by_out @ self.colour.T
        by_out[:, FACTOR] = by_said[:, FACTOR]
        padded = -(-len(by_out) // PIXELS) * PIXELS
        image = np.zeros((1, padded, OUTPUTS), np.float32)
        image[0, : len(by_out)] = by_out
        return self.decoder.backward(image)[0, : len(by_out)]

    def arrays(self) -> dict[str, NDArray]:
        """All that must be kept, for ``write_weights``."""
        return {
            "encoder": self.encoder.weights, "decoder": self.decoder.weights, "mean": self.mean,
            "whiten": self.whiten, "colour": self.colour,
        }  # fmt: skip

    @classmethod
    def of(cls, arrays: dict[str, NDArray], path: Path) -> LatentNetworks:
        """The networks that these weights are of.

        Raises:
            InputError: when they have another shape.
        """
        made = cls(np.random.default_rng(0))
        made.encoder.weights[:] = shaped(arrays, "encoder", made.encoder.weights.shape, path)
        made.decoder.weights[:] = shaped(arrays, "decoder", made.decoder.weights.shape, path)
        made.mean = shaped(arrays, "mean", (INPUTS,), path)
        made.whiten = shaped(arrays, "whiten", (INPUTS, INPUTS), path)
        made.colour = shaped(arrays, "colour", (PLAIN, PLAIN), path)
        return made


@cache
def load_networks(path: Path = SHIPPED) -> tuple[LatentNetworks, dict[str, Any]]:
    """The networks of a file, read once, and its meta.

    Raises:
        InputError: for a file that is none of its kind.
    """
    arrays, meta = read_weights(path, KIND)
    return LatentNetworks.of(arrays, path), meta


def luminance_of(specular: NDArray) -> NDArray:
    """Luminance (H, W) of specular colours, that the networks see."""
    return specular @ np.array([0.2126, 0.7152, 0.0722], np.float32)


def encode_image(networks: LatentNetworks, svbrdf: Svbrdf, pool: Executor) -> NDArray:
    """Code (H, W, CODE) float32 of a whole texture, tile by tile with all that a tile's texels see around it."""
    height, width = svbrdf.size
    code = np.empty((height, width, CODE), np.float32)
    inner = _TILE - 2 * _APRON

    def indices(first: int, size: int) -> NDArray:
        i = np.arange(first - _APRON, first - _APRON + _TILE)
        return i % size if svbrdf.wrap == "tile" else np.clip(i, 0, size - 1)

    def work(corner: tuple[int, int]) -> None:
        rows, columns = indices(corner[0], height), indices(corner[1], width)
        part = np.ix_(rows, columns)
        inputs = inputs_of(svbrdf.normal[part], svbrdf.log_roughness[part], luminance_of(svbrdf.specular[part]))
        # A worker's own features; the weights are shared.
        own = copy.copy(networks)
        own.encoder = copy.copy(networks.encoder)
        made = own.encode(inputs)
        end_row, end_column = min(corner[0] + inner, height), min(corner[1] + inner, width)
        code[corner[0] : end_row, corner[1] : end_column] = made[
            _APRON : _APRON + end_row - corner[0], _APRON : _APRON + end_column - corner[1]
        ]

    corners = [(y, x) for y in range(0, height, inner) for x in range(0, width, inner)]
    for _ in pool.map(work, corners):
        pass
    return code


def decode_image(networks: LatentNetworks, code: NDArray, pool: Executor) -> NDArray:
    """Outputs (h, w, OUTPUTS) float32 of a level's code (h, w, CODE)."""
    flat = code.reshape(-1, CODE)
    out = np.empty((len(flat), OUTPUTS), np.float32)

    def work(first: int) -> None:
        own = copy.copy(networks)
        own.decoder = copy.copy(networks.decoder)
        out[first : first + _ROWS] = own.decode(flat[first : first + _ROWS])

    for _ in pool.map(work, range(0, len(flat), _ROWS)):
        pass
    return out.reshape(*code.shape[:2], OUTPUTS)


def lifted(xy: NDArray) -> NDArray:
    """Unit normals (..., 3) of their x and y (..., 2), cut to the disc of radius ``LONGEST``."""
    length = np.linalg.norm(xy, axis=-1, keepdims=True)
    inside = xy * np.minimum(1.0, LONGEST / np.maximum(length, 1e-12))
    z = np.sqrt(1.0 - np.square(inside).sum(axis=-1, keepdims=True))
    return np.concatenate([inside, z], axis=-1)


def lift_back(xy: NDArray, by_normal: NDArray) -> NDArray:
    """dL/d(xy) (..., 2) from dL/d(normal) (..., 3).

    Within the disc z = sqrt(1 - x^2 - y^2), dz/d(xy) = -xy / z. Beyond, the length is cut, only the direction counts:
    d(cut)/d(xy) = (LONGEST / r) (I - xy xy' / r^2).
    """
    normal = lifted(xy)
    by = by_normal[..., :2] - by_normal[..., 2:] * normal[..., :2] / normal[..., 2:]
    length = np.linalg.norm(xy, axis=-1, keepdims=True)
    along = (by * xy).sum(axis=-1, keepdims=True) * xy / np.maximum(length * length, 1e-12)
    return np.where(length > LONGEST, (by - along) * LONGEST / np.maximum(length, 1e-12), by)
