"""The networks of the method ``latent`` (Kemppinen et al. 2023): filtering their code linearly prefilters the lobes.

    theta_level = D(downsample(E(theta)))

The encoder E has six layers of 3x3, the decoder D four of 1x1, both DenseNets that add 16 maps a layer; the code has 64
channels. Inputs are whitened by the training set's mean and covariance. The decoder outputs the log of the lobe's
tensor, which is therefore always positive definite, and x and y of its normal, which are lifted to the hemisphere. As
in the paper's section 3.5 there is an encoder for each lobe model of the base and a decoder for each lobe model of the
levels; all of them share one code, so any pair can be combined.

Two forms of the outputs:

- ``absolute``, the paper's: whitened normal and log tensor, mapped back by mean and covariance. Its initial weights
  average: the code's first channels are the inputs and the outputs equal them; all of them are trained.
- ``correction``, which we ship: the code's first 16 channels remain the inputs, so a filtered code always holds their
  averages, from which ``filtered_lobe`` computes LEAN's lobe. The decoder outputs a correction of that lobe: x and y in
  units of the lobe's width, and the log tensor. Networks predict absolute normals with a small error, but a sharp lobe
  needs them to a hundredth; after equal training this form was 3 dB better on held-out sets.

Further differences from the paper: besides normal (2), log tensor (3) and log luminance, the inputs contain ten
products of these, whose averages LEAN needs and which 3x3 layers learn slowly; the sixth output is the log of the scale
over the filtered colour, so that hues are filtered linearly.
"""

from __future__ import annotations

import copy
from concurrent.futures import Executor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import LUMINANCE
from brdffit.errors import InputError
from brdffit.nets.layers import DenseNet
from brdffit.nets.vectors import LANES, PIXELS
from brdffit.nets.weights import read_weights, shaped
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf

KIND = "latent"
#: Weights that the program ships.
SHIPPED = Path(__file__).parent / "weights" / "latent.npz"
#: Lobe models of bases and levels: each has an encoder and a decoder.
MODELS = ("ggx", "beckmann")
FORMS = ("correction", "absolute")
INPUTS, PLAIN, CODE, OUTPUTS = 16, 6, 64, 6
ENCODER_DEPTH, DECODER_DEPTH = 6, 4
#: Outputs: x and y of the normal, log tensor, log of the scale over the filtered colour.
NORMAL, TENSOR, FACTOR = slice(0, 2), slice(2, 5), 5
#: Largest length of (x, y) of a normal; longer ones are shortened to it before they are lifted.
LONGEST = 0.995
#: Shares of the decoder's correction that are applied at levels 0 to 4; beyond, all of it. The loss averages logs of
#: errors, that is it looks at typical texels, while the mean error of a level is that of its worst ones, to which too
#: large a correction does harm. Each share is the best on patches of the training sets in steps of 0.15 (mean error;
#: levels 1 to 3: 22.9, 22.6 and 22.4 dB instead of 21.2, 21.5 and 21.7).
SHARES = (0.85, 0.3, 0.5, 0.7, 0.85)
#: Added to luminance before its log is taken.
_DARK = 1e-3
#: Side of a tile that is encoded at once, and the radius in texels of the encoder's receptive field.
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
    """Encoders, decoders and whitening.

    Attributes:
        form: what outputs mean, one of ``FORMS``.
        encoders, decoders: by lobe model.
        mean: (INPUTS,) mean of the inputs over the training set.
        whiten: (INPUTS, INPUTS) matrix that whitens inputs: the inverse square root of the covariance of the first
            PLAIN, and one over the standard deviation of the products.
        colour: (PLAIN, PLAIN) square root of that covariance, which undoes the whitening.
        whitened_back: (INPUTS, INPUTS) inverse of ``whiten``.
    """

    def __init__(self, rng: np.random.Generator, form: str = FORMS[0]) -> None:
        self.form = form
        self.encoders = {model: DenseNet(INPUTS, CODE, ENCODER_DEPTH, 1, rng) for model in MODELS}
        self.decoders = {model: DenseNet(CODE, OUTPUTS, DECODER_DEPTH, 0, rng) for model in MODELS}
        self.mean, self.whiten, self.colour = np.zeros(INPUTS), np.eye(INPUTS), np.eye(PLAIN)
        self.whitened_back: NDArray = np.eye(INPUTS)
        self._width = np.ones((0, 1))
        self._start_as_averaging()

    def _start_as_averaging(self) -> None:
        for encoder in self.encoders.values():
            head = encoder.layers[-1].blocks_of(encoder.weights)
            head[0, ..., :INPUTS] = 0.0
            head[0, 0, 0, :INPUTS, :INPUTS] = np.eye(INPUTS)
        for decoder in self.decoders.values():
            head = decoder.layers[-1].blocks_of(decoder.weights)
            head *= np.float32(0.05)
            if self.form == "absolute":
                head[0, 0, 0, :, :OUTPUTS] = np.eye(LANES, OUTPUTS)  # the rest is small
                head[..., FACTOR] = 0.0

    def whiten_by(self, samples: NDArray) -> None:
        """Set mean and whitening from training inputs (n, INPUTS)."""
        self.mean = samples.mean(axis=0, dtype=np.float64)
        plain = np.cov(samples[:, :PLAIN].T.astype(np.float64)) + 1e-3 * np.eye(PLAIN)
        values, vectors = np.linalg.eigh(plain)
        self.whiten = np.diag(1.0 / (samples.std(axis=0, dtype=np.float64) + 1e-3))
        self.whiten[:PLAIN, :PLAIN] = (vectors / np.sqrt(values)) @ vectors.T
        self.colour = (vectors * np.sqrt(values)) @ vectors.T
        self.whitened_back = np.linalg.inv(self.whiten)

    def encode(self, inputs: NDArray, model: str = MODELS[0]) -> NDArray:
        """Code (H, W, CODE) of inputs (H, W, INPUTS) of a base of this model; W is a multiple of 8.

        Beyond the border the encoder sees zeros.
        """
        return self.encoders[model].forward(((inputs - self.mean) @ self.whiten).astype(np.float32))

    def encode_back(self, by_code: NDArray, model: str = MODELS[0]) -> None:
        """Add to the encoder's gradient from dL/d(code) (H, W, CODE) of the last ``encode``."""
        encoder = self.encoders[model]
        encoder.backward(by_code)
        if self.form == "correction":  # the head's first 16 channels must keep copying the inputs
            head = encoder.layers[-1]
            head.blocks_of(encoder.gradient)[0] = 0.0
            encoder.gradient[head.bias][:LANES] = 0.0

    def decode(self, code: NDArray, model: str = MODELS[0], lobe: NDArray | None = None, share: float = 1.0) -> NDArray:
        """Outputs (n, OUTPUTS) float64 of codes (n, CODE): normal, log tensor and factor of lobes of this model.

        ``lobe`` (n, 5): the result of ``filtered`` for this code, if it is known; ``share``: of a correction that is
        applied.
        """
        padded = -(-len(code) // PIXELS) * PIXELS
        image = np.zeros((1, padded, CODE), np.float32)
        image[0, : len(code)] = code
        said = self.decoders[model].forward(image)[0, : len(code)].astype(np.float64)
        if self.form == "correction":
            lobe = self.filtered(code) if lobe is None else lobe
            said *= share
            self._width = np.exp(0.25 * (lobe[:, 2:3] + lobe[:, 3:4]))
            said[:, NORMAL] *= self._width
            said[:, :FACTOR] += lobe
            return said
        # The factor is output as it is. In its place luminance counts as its mean while the others are mapped back.
        factor = said[:, FACTOR].copy()
        said[:, FACTOR] = 0.0
        said = said @ self.colour + self.mean[:PLAIN]
        said[:, FACTOR] = factor
        return said

    def decode_back(self, by_said: NDArray, model: str = MODELS[0]) -> NDArray:
        """dL/d(code) (n, CODE) from dL/d(outputs); adds to the decoder's gradient, of the last ``decode``.

        The derivative of the filtered lobe by the code is left out, since the channels that it reads are not trained.
        """
        by_out = by_said.copy()
        if self.form == "correction":
            by_out[:, NORMAL] *= self._width
        else:
            by_out[:, FACTOR] = 0.0
            by_out = by_out @ self.colour.T
            by_out[:, FACTOR] = by_said[:, FACTOR]
        padded = -(-len(by_out) // PIXELS) * PIXELS
        image = np.zeros((1, padded, OUTPUTS), np.float32)
        image[0, : len(by_out)] = by_out
        return self.decoders[model].backward(image)[0, : len(by_out)]

    def filtered(self, code: NDArray) -> NDArray:
        """``filtered_lobe`` (n, 5) of the inputs that are copied in the first channels of codes (n, CODE)."""
        return filtered_lobe(code[:, :INPUTS] @ self.whitened_back + self.mean)

    def networks(self) -> dict[str, DenseNet]:
        """All networks, by the names of their weights in a file."""
        return {
            **{f"encoder.{model}": each for model, each in self.encoders.items()},
            **{f"decoder.{model}": each for model, each in self.decoders.items()},
        }

    def arrays(self) -> dict[str, NDArray]:
        """The arrays of a file of weights, by name."""
        weights = {name: each.weights for name, each in self.networks().items()}
        return weights | {"mean": self.mean, "whiten": self.whiten, "colour": self.colour}

    @classmethod
    def of(cls, arrays: dict[str, NDArray], meta: dict[str, Any], path: Path) -> LatentNetworks:
        """The networks with the weights of a file.

        Raises:
            InputError: when they have another form or shape.
        """
        form = meta.get("architecture", {}).get("form")
        if form not in FORMS:
            raise InputError(f"The weights '{path}' are of the form '{form}', expected one of {', '.join(FORMS)}.")
        made = cls(np.random.default_rng(0), form)
        for name, network in made.networks().items():
            network.weights[:] = shaped(arrays, name, network.weights.shape, path)
        made.mean = shaped(arrays, "mean", (INPUTS,), path)
        made.whiten = shaped(arrays, "whiten", (INPUTS, INPUTS), path)
        made.colour = shaped(arrays, "colour", (PLAIN, PLAIN), path)
        made.whitened_back = np.linalg.inv(made.whiten)
        return made


def filtered_lobe(filtered: NDArray) -> NDArray:
    """(n, 5) x and y of the normal, and log tensor, of LEAN's lobe, from filtered inputs (n, INPUTS) float64.

    The normal has the mean of x and y. The tensor is E[Sigma] + 2 J Cov J' in the tangent plane, where a change d of x
    and y is J d, J = I + (1 / n_z - 1) e e' with e the direction of the tilt. Its eigenvalues are clipped to [1e-6, 1].
    """
    x, y = filtered[:, 0], filtered[:, 1]
    xx, yy = np.maximum(filtered[:, 6] - x * x, 0.0), np.maximum(filtered[:, 8] - y * y, 0.0)
    xy = filtered[:, 7] - x * y
    squared = np.minimum(x * x + y * y, LONGEST**2)
    k = (1.0 / np.sqrt(1.0 - squared) - 1.0) / np.maximum(squared, 1e-12)
    j_xx, j_xy, j_yy = 1.0 + k * x * x, k * x * y, 1.0 + k * y * y
    a_xx, a_xy = j_xx * xx + j_xy * xy, j_xx * xy + j_xy * yy
    a_yx, a_yy = j_xy * xx + j_yy * xy, j_xy * xy + j_yy * yy
    s_xx = filtered[:, 9] + 2.0 * (a_xx * j_xx + a_xy * j_xy)
    s_yy = filtered[:, 10] + 2.0 * (a_yx * j_xy + a_yy * j_yy)
    s_xy = filtered[:, 11] + 2.0 * (a_xx * j_xy + a_xy * j_yy)
    mean, half = 0.5 * (s_xx + s_yy), 0.5 * (s_xx - s_yy)
    radius = np.hypot(half, s_xy)
    major, minor = np.log(np.clip(mean + radius, 1e-6, 1.0)), np.log(np.clip(mean - radius, 1e-6, 1.0))
    mean, stretch = 0.5 * (major + minor), 0.5 * (major - minor) / np.maximum(radius, 1e-12)
    return np.stack([x, y, mean + stretch * half, mean - stretch * half, stretch * s_xy], axis=1)


@cache
def load_networks(path: Path = SHIPPED) -> tuple[LatentNetworks, dict[str, Any]]:
    """The networks of a file, which is read once, and its meta.

    Raises:
        InputError: when the file cannot be read or is of another kind, form or shape.
    """
    arrays, meta = read_weights(path, KIND)
    return LatentNetworks.of(arrays, meta, path), meta


def encode_image(networks: LatentNetworks, svbrdf: Svbrdf, pool: Executor) -> NDArray:
    """Code (H, W, CODE) float32 of a whole texture, tile by tile, each with the encoder's receptive field around it."""
    height, width = svbrdf.size
    code = np.empty((height, width, CODE), np.float32)
    inner = _TILE - 2 * _APRON

    def indices(first: int, size: int) -> NDArray:
        i = np.arange(first - _APRON, first - _APRON + _TILE)
        return i % size if svbrdf.wrap == "tile" else np.clip(i, 0, size - 1)

    def work(corner: tuple[int, int]) -> None:
        rows, columns = indices(corner[0], height), indices(corner[1], width)
        part = np.ix_(rows, columns)
        inputs = inputs_of(svbrdf.normal[part], svbrdf.log_roughness[part], svbrdf.specular[part] @ LUMINANCE)
        # Each worker needs features of its own; the weights are shared.
        own = copy.copy(networks)
        own.encoders = {svbrdf.model: copy.copy(networks.encoders[svbrdf.model])}
        made = own.encode(inputs, svbrdf.model)
        end_row, end_column = min(corner[0] + inner, height), min(corner[1] + inner, width)
        code[corner[0] : end_row, corner[1] : end_column] = made[
            _APRON : _APRON + end_row - corner[0], _APRON : _APRON + end_column - corner[1]
        ]

    corners = [(y, x) for y in range(0, height, inner) for x in range(0, width, inner)]
    for _ in pool.map(work, corners):
        pass
    return code


def decode_image(
    networks: LatentNetworks, code: NDArray, pool: Executor, model: str = MODELS[0], share: float = 1.0
) -> NDArray:
    """Outputs (h, w, OUTPUTS) float32 of a level's code (h, w, CODE), for lobes of this model.

    ``share``: of a correction that is applied.
    """
    flat = code.reshape(-1, CODE)
    out = np.empty((len(flat), OUTPUTS), np.float32)

    def work(first: int) -> None:
        own = copy.copy(networks)
        own.decoders = {model: copy.copy(networks.decoders[model])}
        out[first : first + _ROWS] = own.decode(flat[first : first + _ROWS], model, share=share)

    for _ in pool.map(work, range(0, len(flat), _ROWS)):
        pass
    return out.reshape(*code.shape[:2], OUTPUTS)


def lifted(xy: NDArray) -> NDArray:
    """Unit normals (..., 3) from their x and y (..., 2), which are first shortened to at most ``LONGEST``."""
    length = np.linalg.norm(xy, axis=-1, keepdims=True)
    inside = xy * np.minimum(1.0, LONGEST / np.maximum(length, 1e-12))
    z = np.sqrt(1.0 - np.square(inside).sum(axis=-1, keepdims=True))
    return np.concatenate([inside, z], axis=-1)
