"""Neural materials on disk, and as an ``Appearance`` that the renderer draws.

The file is an .npz with ``meta`` (see ``brdffit.nets.weights``). In float16 it holds ``pyramid.0``, ``pyramid.1`` ...
(h, w, 7) and ``offset_texture`` (h, w, 7); in float32 ``decoder.0.weight`` (inputs, outputs), ``decoder.0.bias``
(outputs,) and so on for each layer, and likewise ``offset.0.weight`` ... ``own_colour`` of the meta tells that features
3 to 5 are added to the masks (``kernels.material``); tilted designs before had none of that, and are refused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import Lookups
from brdffit.errors import InputError
from brdffit.nets.weights import read_weights, shaped
from brdffit.neural.kernels.textures import CHANNELS, TEXEL
from brdffit.neural.network import QUERY, Design, Network, Reader
from brdffit.neural.questions import RADIUS, SIGMA, within_disc

#: Kind of the files of weights.
KIND = "neural material"
#: Standard deviation of the renderer's box filter, in pixels.
_PIXEL_SIGMA = 1.0 / math.sqrt(12.0)
_LARGEST = 1 << 14


class Features(NamedTuple):
    """Features of n pixels: ``values`` (n, 8) float32, and ``view`` (n, 2), x and y of the directions to the viewer."""

    values: NDArray
    view: NDArray


@dataclass
class NeuralMaterial:
    """A trained material as an ``Appearance`` (see ``brdffit.appearance``), in two stages.

    ``look_up`` reads the textures at the offset that the view gives, once for all lights; ``evaluate`` decodes the
    features for a light.

    Attributes:
        network: textures and weights.
        on_plane: whether the decoder gives pi M, the paper's quantity, or else pi M times the light's cosine (M as in
            ``microgeometry.queries``).
        meta: provenance.
        base: (height, width) in whose texels positions are given; None for those of level 0.
        wrap: always "tile".
    """

    network: Network
    on_plane: bool
    meta: Mapping[str, Any]
    base: tuple[int, int] | None = None
    wrap: str = "tile"

    @property
    def base_size(self) -> tuple[int, int]:
        """(height, width) in texels of the base."""
        return self.base or self.network.design.size

    @cached_property
    def reader(self) -> Reader:
        """The network, prepared for reading."""
        return Reader(self.network)

    def look_up(self, lookups: Lookups) -> Features:
        """See ``Appearance``: the features at the offset positions."""
        size = self.network.design.size
        scale = np.array(size[::-1]) / np.array(self.base_size[::-1])
        queries = np.zeros((len(lookups.position), QUERY), np.float32)
        # The tile repeats; float32 would be too coarse for positions far from its origin.
        queries[:, :2] = np.mod(lookups.position * scale, size[::-1])
        # The Gaussian with the standard deviation of the pixel's box.
        queries[:, 2] = lookups.detail + math.log2(_PIXEL_SIGMA / SIGMA * math.sqrt(scale.prod()))
        view = within_disc(lookups.view[:, :2])
        queries[:, 5:7] = view
        return Features(self.reader.look_up(queries), view)

    def evaluate(self, texels: Features, view: NDArray, light: NDArray) -> NDArray:
        """See ``Appearance``. Directions beyond 78.5 degrees from the normal are decoded as at 78.5 degrees."""
        queries = np.zeros((len(light), QUERY), np.float32)
        queries[:, 3:5], queries[:, 5:7] = within_disc(light[:, :2]), texels.view
        found = self.reader.decode(texels.values, queries)
        height = light[:, 2].astype(np.float32)
        lowest = np.float32(math.sqrt(1.0 - RADIUS * RADIUS))
        factor = np.maximum(height, 0.0) if self.on_plane else np.clip(height / lowest, 0.0, 1.0)
        return np.where(view[:, 2:] > 0.0, found * (factor / np.float32(math.pi))[:, None], np.float32(0.0))

    def sample(self, texels: Features, view: NDArray, u: NDArray) -> NDArray:
        """See ``Appearance``: cosine-distributed directions."""
        radius, angle = np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - u[:, 0])], axis=1)

    def pdf(self, texels: Features, view: NDArray, light: NDArray) -> NDArray:
        """See ``Appearance``: the cosine over pi."""
        return np.maximum(light[:, 2], 0.0) / np.pi


def arrays_of(reader: Reader) -> dict[str, NDArray]:
    """The arrays of a file of a network, by name: its textures with the reader's blur, in float16, and its weights."""
    network = reader.network

    def stored(level: NDArray) -> NDArray:
        return level[:, :-1, :CHANNELS].astype(np.float16)

    found = {f"pyramid.{k}": stored(level) for k, level in enumerate(network.layout.levels(reader.pyramid))}
    if network.design.with_offset:
        found["offset_texture"] = stored(network.base.levels(reader.offset_texture)[0])
    for name, layers in network.design.layers.items():
        for k in range(len(layers)):
            weight, bias = network.taken(name, k)
            found[f"{name}.{k}.weight"], found[f"{name}.{k}.bias"] = weight.copy(), bias.copy()
    return found


def meta_of(network: Network, on_plane: bool) -> dict[str, Any]:
    """Entries of the meta that reading the arrays needs."""
    design = network.design
    return {
        "kind": KIND, "size": list(design.size), "tilted": design.tilted, "with_offset": design.with_offset,
        "own_colour": design.tilted, "on_plane": on_plane, "weights": design.weights,
    }  # fmt: skip


def read_material(path: Path, base: tuple[int, int] | None = None) -> NeuralMaterial:
    """The material of a file.

    Args:
        path: an .npz that training wrote.
        base: (height, width) in whose texels positions are given; None for those of level 0.

    Raises:
        InputError: when the file cannot be read, is damaged, or is no neural material.
    """
    arrays, meta = read_weights(path, KIND)
    network = Network(_design_of(meta, path))
    for k, (height, width) in enumerate(network.layout.sizes):
        level = shaped(arrays, f"pyramid.{k}", (height, width, CHANNELS), path)
        bounds = network.layout.bounds
        network.pyramid[bounds[k] : bounds[k + 1]].reshape(height, width, TEXEL)[..., :CHANNELS] = level
    if network.design.with_offset:
        level = shaped(arrays, "offset_texture", (*network.design.size, CHANNELS), path)
        network.offset_texture.reshape(*network.design.size, TEXEL)[..., :CHANNELS] = level
    for name, layers in network.design.layers.items():
        for k, (ins, outs) in enumerate(layers):
            weight = shaped(arrays, f"{name}.{k}.weight", (ins, outs), path)
            network.put(name, k, weight, shaped(arrays, f"{name}.{k}.bias", (outs,), path))
    return NeuralMaterial(network, bool(meta.get("on_plane")), meta, base)


def _design_of(meta: Mapping[str, Any], path: Path) -> Design:
    size = meta.get("size")
    sound = isinstance(size, list) and len(size) == 2 and all(isinstance(each, int) for each in size)
    if not sound or not all(0 < each <= _LARGEST and each & (each - 1) == 0 for each in size or ()):
        raise InputError(f"The weights '{path}' give the size {size}, expected two powers of two up to {_LARGEST}.")
    assert isinstance(size, list)
    if meta.get("tilted") and not meta.get("own_colour"):
        raise InputError(f"The weights '{path}' are of an older design, without colours of texels: learn them again.")
    return Design((size[0], size[1]), bool(meta.get("tilted")), bool(meta.get("with_offset")))
