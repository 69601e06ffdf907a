"""Parameters of a neural material, their evaluation for batches of queries, and their gradients.

A batch is cut into ``PARTS`` parts, whatever the number of threads. Each part has its own gradients, which are summed
in a fixed order, so the same seed gives the same bytes for any number of threads (on one kind of processor).
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from brdffit.machine import core_count
from brdffit.neural.kernels.dense import LAYERS, MATRIX, NARROW, ONE, PITCH, ROWS, TRANSPOSED, UNITS
from brdffit.neural.kernels.material import (
    OUTPUTS,
    OWN_COLOUR,
    PLAIN_INPUTS,
    QUERY,
    TILTED_INPUTS,
    decode_part,
    look_up_part,
    train_part,
)
from brdffit.neural.kernels.offset import OFFSET_INPUTS, guide_part
from brdffit.neural.kernels.textures import CHANNELS, KEPT, TEXEL, gather_parts
from brdffit.neural.pyramid import Layout

#: Parts of a batch, each with gradients of its own.
PARTS = 8
#: Feature of the width of a lobe at first: that of an alpha of 0.03.
_NARROW = 1.73
#: Shift by an offset of 1 for a view of slope 1, as a share of the longer side of the tile.
_REACH = 0.05


@dataclass(frozen=True)
class Design:
    """Architecture of a material.

    Attributes:
        size: (height, width) of level 0 in texels, powers of two.
        tilted: whether the decoder gets directions relative to a frame of each texel, a tilt and a width, instead of
            those of light and view as they are, and whether its masks are added to the texel's own colour.
        with_offset: whether the pyramid is read at a learned parallax offset.
    """

    size: tuple[int, int]
    tilted: bool = True
    with_offset: bool = True

    @property
    def layers(self) -> dict[str, list[tuple[int, int]]]:
        """(inputs, outputs) of the layers of each network."""
        ins = TILTED_INPUTS if self.tilted else PLAIN_INPUTS
        hidden = [(UNITS, UNITS)] * (LAYERS - 2)
        networks = {"decoder": [(ins, UNITS), *hidden, (UNITS, OUTPUTS)]}
        if self.with_offset:
            networks["offset"] = [(OFFSET_INPUTS, UNITS), *hidden, (UNITS, 1)]
        return networks

    @property
    def weights(self) -> int:
        """Number of weights and biases of the networks."""
        return sum((ins + 1) * outs for layers in self.layers.values() for ins, outs in layers)


class Network:
    """The parameters: textures without repeated texels, and networks in the layout of the kernels.

    Attributes:
        design: the architecture.
        layout, base: layouts of the pyramid and of the offset texture.
        pyramid: flat float32, 8 numbers for each texel of all levels; the eighth is 0.
        offset_texture: the same for one texture of the size of level 0.
        decoder, offset: (LAYERS * MATRIX,) float32.
    """

    def __init__(self, design: Design, seed: int = 0) -> None:
        self.design = design
        self.layout, self.base = Layout(design.size), Layout(design.size, 1)
        rng = np.random.default_rng([seed, 1])
        self.pyramid = _texels(self.layout, rng)
        if design.tilted:
            self.pyramid[2::TEXEL] += _NARROW
        self.offset_texture = _texels(self.base, rng)
        self.decoder = np.zeros(LAYERS * MATRIX, np.float32)
        self.offset = np.zeros(LAYERS * MATRIX, np.float32)
        for name, layers in Design(design.size, design.tilted).layers.items():
            gain = {"decoder": 0.5, "offset": 0.1}[name]
            for k, (ins, outs) in enumerate(layers):
                drawn = rng.standard_normal((ins, outs)) * np.sqrt(2.0 / ins) * (gain if k == LAYERS - 1 else 1.0)
                if name == "decoder" and design.tilted:
                    _begin_white(drawn, k)
                self.put(name, k, drawn, np.zeros(outs))

    def put(self, name: str, layer: int, weight: NDArray, bias: NDArray) -> None:
        """Set the weights (inputs, outputs) and the bias (outputs,) of a layer of the network ``name``."""
        matrix = getattr(self, name)[layer * MATRIX : (layer + 1) * MATRIX].reshape(UNITS + 1, PITCH)
        ins, outs = weight.shape
        matrix[:ins, :outs], matrix[ins, :outs] = weight, bias
        if layer < LAYERS - 1:
            matrix[ins, ONE] = 1.0

    def taken(self, name: str, layer: int) -> tuple[NDArray, NDArray]:
        """The weights (inputs, outputs) and the bias (outputs,) of a layer."""
        ins, outs = self.design.layers[name][layer]
        matrix = getattr(self, name)[layer * MATRIX : (layer + 1) * MATRIX].reshape(UNITS + 1, PITCH)
        return matrix[:ins, :outs], matrix[ins, :outs]

    @property
    def reach(self) -> NDArray:
        """(2,) float32: shift in texels, across and down, by an offset of 1 for a view of slope 1."""
        return np.full(2, _REACH * max(self.design.size), np.float32)

    def parameters(self) -> dict[str, NDArray]:
        """Arrays that are trained, by name."""
        found = {"pyramid": self.pyramid, "decoder": self.decoder}
        if self.design.with_offset:
            found |= {"offset_texture": self.offset_texture, "offset": self.offset}
        return found


def _begin_white(weight: NDArray, layer: int) -> None:
    """Change the first weights of a tilted decoder so that its light is white and the texel's own colour is its hue.

    Otherwise a drawn network has a hue of its own in each direction, which training hardly forgets. The three colours
    begin alike, the masks near those of the texel, and hidden units nearly blind to its colour.
    """
    if layer == 0:
        weight[OWN_COLOUR : OWN_COLOUR + 3] *= 0.1
    if layer == LAYERS - 1:
        weight[:, 1:3] = weight[:, :1]
        weight[:, 3:] *= 0.1


def _texels(layout: Layout, rng: np.random.Generator) -> NDArray:
    texels = np.zeros((layout.learned // TEXEL, TEXEL), np.float32)
    texels[:, :CHANNELS] = 0.1 * rng.standard_normal((len(texels), CHANNELS))
    return texels.reshape(-1)


class Scratch:
    """Buffers of one part of a batch."""

    def __init__(self) -> None:
        def blocks(count: int, pitch: int) -> tuple[NDArray, ...]:
            return tuple(np.zeros(ROWS * pitch, np.float32) for _ in range(count))

        self.rows = blocks(6, NARROW)
        self.hidden, self.offset_hidden, self.d_hidden = blocks(3, PITCH), blocks(3, PITCH), blocks(2, PITCH)
        self.transposed = tuple(np.zeros(LAYERS * TRANSPOSED, np.float32) for _ in range(2))
        corners = tuple(np.zeros((ROWS, 4), np.int64) for _ in range(2))
        fractions = tuple(np.zeros((ROWS, 2 * KEPT), np.float32) for _ in range(2))
        shifts = tuple(np.zeros(2 * ROWS, np.float32) for _ in range(2))
        self.places = (corners[0], fractions[0], corners[1], fractions[1], *shifts)


class Reader:
    """A network prepared for reading: its textures, blurred and in the layout of the kernels.

    Args:
        network: the parameters.
        threads: workers; None for all cores. No result depends on their number.
    """

    def __init__(self, network: Network, threads: int | None = None) -> None:
        self.network = network
        self.pool = ThreadPoolExecutor(threads or core_count())
        self.scratch = [Scratch() for _ in range(PARTS)]
        self.pyramid = np.zeros(network.layout.floats, np.float32)
        self.offset_texture = np.zeros(network.base.floats, np.float32)
        self.refresh(0.0)

    def refresh(self, sigma: float, of_offset: float | None = None, *, as_stored: bool = False) -> None:
        """Copy the network's textures, blurred by a Gaussian of ``sigma`` texels of level 0.

        ``of_offset`` is that of the offset texture, if it is another; ``as_stored`` rounds to float16, as files do.
        """
        network = self.network
        self.sigma, self.of_offset = sigma, sigma if of_offset is None else of_offset
        jobs = [
            self.pool.submit(network.layout.read_through, network.pyramid, self.sigma, self.pyramid),
            self.pool.submit(network.base.read_through, network.offset_texture, self.of_offset, self.offset_texture),
        ]
        for job in jobs:
            job.result()
        if as_stored:
            for texture in (self.pyramid, self.offset_texture):
                texture[:] = texture.astype(np.float16)

    def in_parts(self, count: int, work: Callable[[int, int, int], None]) -> None:
        """Call work(part, first, last) for each of PARTS ranges of ``count`` items, on all threads."""
        edges = [count * k // PARTS for k in range(PARTS + 1)]
        list(self.pool.map(lambda k: work(k, edges[k], edges[k + 1]), range(PARTS)))

    def look_up(self, queries: NDArray) -> NDArray:
        """(n, 8) float32 features of queries (n, QUERY); lights are not used."""
        padded = _padded(queries)
        found = np.zeros((len(padded), TEXEL), np.float32)
        network = self.network

        def work(part: int, first: int, last: int) -> None:
            own = self.scratch[part]
            look_up_part(
                first, last, padded, network.layout.rooms, self.pyramid, self.offset_texture, network.offset,
                network.reach, network.design.with_offset, own.rows[0], own.hidden, own.rows[1], own.places[0],
                own.places[1], own.places[4], found,
            )  # fmt: skip

        self.in_parts(len(padded) // ROWS, work)
        return found[: len(queries)]

    def decode(self, features: NDArray, queries: NDArray) -> NDArray:
        """(n, 3) float32 outputs for features (n, 8) and the directions of queries (n, QUERY)."""
        padded, features = _padded(queries), _padded(features)
        colour = np.zeros((len(padded), 3), np.float32)

        def work(part: int, first: int, last: int) -> None:
            own = self.scratch[part]
            decode_part(
                first, last, features, padded, self.network.decoder, self.network.design.tilted, own.rows[0],
                own.hidden, own.rows[1], colour,
            )  # fmt: skip

        self.in_parts(len(padded) // ROWS, work)
        return colour[: len(queries)]

    def predict(self, queries: NDArray) -> NDArray:
        """(n, 3) float32 outputs for queries (n, QUERY): ``look_up``, then ``decode``."""
        return self.decode(self.look_up(queries), queries)


def _padded(rows: NDArray) -> NDArray:
    """Rows as float32, the last one repeated to fill whole blocks."""
    rows = np.ascontiguousarray(rows, np.float32)
    missing = -len(rows) % ROWS
    return rows if not missing else np.concatenate([rows, np.repeat(rows[-1:], missing, axis=0)])


class Learner(Reader):
    """A reader that also computes losses and gradients of batches, through the adjoint of the last blur."""

    def __init__(self, network: Network, threads: int | None = None) -> None:
        super().__init__(network, threads)
        sizes = {
            "pyramid": network.layout.floats, "decoder": network.decoder.size,
            "offset_texture": network.base.floats, "offset": network.offset.size,
        }  # fmt: skip
        self.parts = {name: np.zeros(PARTS * size, np.float32) for name, size in sizes.items()}
        self.sums = {name: np.zeros(size, np.float32) for name, size in sizes.items()}

    def accumulate(
        self, queries: NDArray, targets: NDArray, logarithmic: bool, learn_offset: bool = True
    ) -> tuple[float, dict[str, NDArray]]:
        """The loss of a batch, averaged over queries and channels, and its gradient by each of ``parameters``.

        Args:
            queries: (n, QUERY) float32, n a multiple of ROWS.
            targets: (n, 3) float32.
            logarithmic: the paper's loss on logarithms; otherwise a loss that noise in the targets does not bias.
            learn_offset: whether the offset module gets gradients, too.
        """
        network = self.network

        def work(part: int, first: int, last: int, losses: NDArray) -> None:
            own, mine = self.scratch[part], self._gradients_of(part)
            train_part(
                first, last, queries, targets, network.layout.rooms, self.pyramid, self.offset_texture, network.decoder,
                network.offset, network.reach, network.design.tilted, network.design.with_offset,
                learn_offset, logarithmic,
                mine["pyramid"], mine["offset_texture"], mine["decoder"], mine["offset"], own.rows, own.hidden,
                own.offset_hidden, own.d_hidden, own.transposed, own.places, losses,
            )  # fmt: skip

        names = tuple(name for name in network.parameters() if learn_offset or "offset" not in name)
        return self._gathered(work, len(queries), 3 * len(queries), names)

    def guide(self, queries: NDArray, shifts: NDArray) -> tuple[float, dict[str, NDArray]]:
        """The loss of the offset module alone on a batch, and its gradient by each of that module's parameters.

        Args:
            queries: (n, QUERY) float32, n a multiple of ROWS; their lights and levels are not used.
            shifts: (n, 2) float32, from the position to the point that is seen, across and down in texels of level 0.
        """
        network = self.network

        def work(part: int, first: int, last: int, losses: NDArray) -> None:
            own, mine = self.scratch[part], self._gradients_of(part)
            guide_part(
                first, last, queries, shifts, network.layout.rooms, self.offset_texture, network.offset, network.reach,
                mine["offset_texture"], mine["offset"], own.rows, own.offset_hidden, own.d_hidden, own.transposed,
                own.places, losses,
            )  # fmt: skip

        return self._gathered(work, len(queries), len(queries), ("offset_texture", "offset"))

    def _gradients_of(self, part: int) -> dict[str, NDArray]:
        return {name: self.parts[name][part * len(each) : (part + 1) * len(each)] for name, each in self.sums.items()}

    def _gathered(
        self, work: Callable[[int, int, int, NDArray], None], count: int, terms: int, names: tuple[str, ...]
    ) -> tuple[float, dict[str, NDArray]]:
        """Mean loss over ``terms``, and its gradients: sums of those that ``work`` adds to for each part."""
        losses = np.zeros((PARTS, 8))
        self.in_parts(count // ROWS, lambda part, first, last: work(part, first, last, losses[part]))
        for name in names:
            size = len(self.sums[name])
            self.in_parts(size, lambda _, first, last, name=name: self._sum(name, first, last))  # type: ignore[misc]
        scale = np.float32(1.0 / terms)
        gradients = {name: self.sums[name] * scale for name in names}
        for name, layout, sigma in (
            ("pyramid", self.network.layout, self.sigma), ("offset_texture", self.network.base, self.of_offset),
        ):  # fmt: skip
            if name in names:
                gradients[name] = layout.pull_back(gradients[name], sigma)
        return float(losses[:, 0].sum()) * float(scale), gradients

    def _sum(self, name: str, first: int, last: int) -> None:
        gather_parts(self.parts[name], PARTS, first, last, self.sums[name])


__all__ = ["PARTS", "QUERY", "Design", "Learner", "Network", "Reader"]
