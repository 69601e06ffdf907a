"""Training of a neural material: random queries, textures under a blur that shrinks, a figure on held-out queries.

As the paper (``paper=True``): a fixed set of queries of 64 samples each, directions as they are, a loss on logarithms,
and a blur of 8 texels at first, halved with every ninth of the training. By default the decoder gets directions
relative to a frame of the texel; a surface that is traced tells frames, colours and offset (``guidance``); the loss is
not biased by noise, so that one sample a query is enough; new queries are made all the time, each used in a few steps
since tracing takes longer than learning; and the blur ends at half of the training.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.machine import free_memory
from brdffit.microgeometry.queries import Queries, QuerySource, TracedSource
from brdffit.nets.adam import Adam
from brdffit.neural.guidance import held_texels, set_texels, true_shifts
from brdffit.neural.kernels.dense import LAYERS, MATRIX, ROWS
from brdffit.neural.kernels.material import QUERY
from brdffit.neural.material import KIND, arrays_of, meta_of
from brdffit.neural.measured import Measured
from brdffit.neural.network import PARTS, Design, Learner, Network
from brdffit.neural.questions import Answers, batch_of, directions, error_of, random_queries

#: Learning rates of networks and of textures, and the factor that they fall by in the second half.
_RATE, _TEXTURE_RATE, _LAST = 3e-3, 1e-2, 0.01
#: The paper's learning rate, for networks and textures.
_PAPER_RATE = 1e-3
#: Steps for each new batch, and largest number of batches that are kept to draw from.
_LEARNED, _KEPT = 4, 12
#: Queries for each texel, and samples for each query, of the paper's fixed set.
_PAPER_QUERIES, _PAPER_SAMPLES = 220, 64
#: One in how many queries teaches a guided offset.
_GUIDES = 4
#: Standard deviation of the blur at first, in texels of level 0, and where the surface guides.
_BLUR, _GUIDED_BLUR = 8.0, 2.0
#: Held-out queries of each level, and samples of each.
_JUDGED, _JUDGED_SAMPLES = 4096, 64
_SEED_OF_FIGURE = 1 << 40


@dataclass
class Trained:
    """One array of parameters and its gradient, as the training loop takes them."""

    weights: NDArray
    gradient: NDArray


class Held:
    """Held-out queries of each level with their truths: means of many samples, or measurements.

    Args:
        answers: gives the truths.
        size: (height, width) of level 0.
        count: queries of each level.
        samples: of each query.
        on_plane: whether answers are pi M instead of pi M times the light's cosine.
    """

    def __init__(
        self, answers: Answers | Measured, size: tuple[int, int], count: int, samples: int, on_plane: bool
    ) -> None:
        self.queries: list[NDArray] = []
        self.truth: list[NDArray] = []
        self.on_plane = on_plane
        for level in range(max(size).bit_length()):
            if isinstance(answers, Measured):
                queries, truth = answers.judged(level)
                self.queries.append(queries)
                self.truth.append(truth)
                continue
            rng = np.random.default_rng([_SEED_OF_FIGURE, level])
            self.queries.append(random_queries(count, size, rng, float(level)))
            self.truth.append(answers.twice(self.queries[-1], _SEED_OF_FIGURE + 1000 * level, samples))

    def errors(self, learner: Learner) -> tuple[NDArray, NDArray]:
        """(levels,) mean squared errors and mean squares of the truth; a white surface facing the light has value 1."""
        found = []
        for queries, truth in zip(self.queries, self.truth, strict=True):
            factor = directions(queries)[0][:, 2:] if self.on_plane else 1.0
            found.append(error_of(learner.predict(queries) * factor, truth * factor))
        error, power = np.array(found).T
        return error, power


class NeuralTask:
    """Training of one material: a ``Task`` of ``brdffit.nets.training``.

    Args:
        source: answers queries, or holds measured ones.
        size: (height, width) of level 0, powers of two.
        seed: of initial weights, queries and batches.
        paper: train as in the paper, see the module.
        with_offset: whether a parallax offset is learned.
        threads: workers; None for all cores. No result depends on their number.
        named: entries for the meta of the file that name the source.

    Raises:
        InputError: when memory does not suffice, or there are too few measured queries.
    """

    kind = KIND

    def __init__(
        self, source: QuerySource | Queries, size: tuple[int, int], seed: int = 0, *, paper: bool = False,
        with_offset: bool = True, threads: int | None = None, named: Mapping[str, Any] | None = None,
    ) -> None:  # fmt: skip
        check_memory(size)
        self.paper, self.seed, self.named = paper, seed, named or {}
        self.network = Network(Design(size, not paper, with_offset), seed)
        self.learner = Learner(self.network, threads)
        self.answers: Answers | Measured
        if isinstance(source, Queries):
            self.answers = Measured(source, size, paper)
        else:
            self.answers = Answers(source, size, on_plane=paper)
        self.trained = {name: Trained(each, np.zeros_like(each)) for name, each in self.network.parameters().items()}
        self.held = Held(self.answers, size, _JUDGED, _JUDGED_SAMPLES, paper)
        #: The surface that guides offset, frames and colours; without one, the loss of the colours teaches them.
        self.guide = source if isinstance(source, TracedSource) and not paper else None
        if self.guide is not None:
            set_texels(self.guide, self.network)
        self.batches: dict[int, tuple[NDArray, NDArray]] = {}
        texels, self.count = size[0] * size[1], len(batch_of(size, np.random.default_rng(0)))
        self.kept = max(1, round(_PAPER_QUERIES * texels / self.count))
        if not paper:
            self.kept = max(_LEARNED, min(_KEPT, (256 << 20) // (4 * texels * 4 * (QUERY + 3))))
        self.step, self.done = 0, 0.0

    @property
    def settings(self) -> dict[str, Any]:
        """What a training must have in common with the checkpoint that it continues from, besides seed and shapes."""
        design = meta_of(self.network, self.paper)
        return {name: design[name] for name in ("size", "with_offset", "own_colour")} | {"paper": self.paper}

    def networks(self) -> Mapping[str, Any]:
        """Textures and weights, by name."""
        return self.trained

    def optimiser(self, size: int) -> Adam:
        """Adam. Textures get a larger rate than networks, except in the paper's training."""
        if self.paper:
            return _Scaled(size, _PAPER_RATE / _RATE, (0.9, 0.999))
        return _Scaled(size, 1.0 if size == LAYERS * MATRIX else _TEXTURE_RATE / _RATE, (0.9, 0.99))

    def rate(self, step: int, done: float) -> float:
        """Constant for the first half, then falling geometrically; in the paper's training constant throughout."""
        self.step, self.done = step, done
        if self.paper:
            return _RATE
        return _RATE * (1.0 if done < 0.5 else _LAST ** ((done - 0.5) / 0.5))

    @property
    def blur(self) -> float:
        """Standard deviation of the textures' blur now, in texels of level 0."""
        first = _BLUR if self.guide is None else _GUIDED_BLUR
        return first * 2.0 ** (-(9.0 if self.paper else 12.0) * self.done)

    def accumulate(self, rng: np.random.Generator) -> float:
        """Set the gradients to those of one batch; returns its loss."""
        self._refresh()
        number = self._number(rng)
        queries, targets = self.batch(number)
        loss, gradients = self.learner.accumulate(queries, targets, self.paper, self.guide is None)
        if self.guide is not None:
            held_texels(gradients["pyramid"])
        if self.guide is not None and self.network.design.with_offset:
            every = _GUIDES if len(queries) >= _GUIDES * ROWS else 1
            asked = np.ascontiguousarray(queries[self.step % every :: every])
            gradients |= self.learner.guide(asked, true_shifts(self.guide, self.network.design.size, asked))[1]
        for name, gradient in gradients.items():
            self.trained[name].gradient = gradient
        return loss

    def _refresh(self, as_stored: bool = False) -> None:
        """Blur the textures as they are to be now; an offset that is guided has no noise to be kept from."""
        self.learner.refresh(self.blur, None if self.guide is None else 0.0, as_stored=as_stored)

    def _number(self, rng: np.random.Generator) -> int:
        """Number of the batch of this step: a new one every ``_LEARNED`` steps, otherwise one that is kept."""
        if self.paper:
            return self.step % self.kept
        newest = self.step // _LEARNED
        return newest if self.step % _LEARNED == 0 else max(newest - int(rng.integers(self.kept)), 0)

    def batch(self, number: int) -> tuple[NDArray, NDArray]:
        """Queries and targets of a batch, which depend on its number alone.

        The last few batches are kept; in the paper's training all of them.
        """
        if isinstance(self.answers, Measured):
            return self.answers.batch(self.count, np.random.default_rng([self.seed, 2, number]))
        if number not in self.batches:
            queries = batch_of(self.network.design.size, np.random.default_rng([self.seed, 2, number]))
            samples = _PAPER_SAMPLES if self.paper else 1
            seed = (self.seed << 24) + number * samples
            self.batches[number] = queries, self.answers.to(queries, seed, samples)
            if not self.paper:
                for old in [each for each in self.batches if each <= number - self.kept]:
                    del self.batches[old]
        return self.batches[number]

    def figure(self) -> float:
        """Mean over levels of the SNR in dB on held-out queries, with the textures as they are stored."""
        self._refresh(as_stored=True)
        error, power = self.held.errors(self.learner)
        return float(np.mean(10.0 * np.log10(power / np.maximum(error, 1e-12))))

    def arrays(self) -> dict[str, NDArray]:
        """Arrays of the material, with its textures under the present blur."""
        self._refresh()
        return arrays_of(self.learner)

    def meta(self) -> dict[str, Any]:
        """Provenance, and the error of each level."""
        self._refresh(as_stored=True)
        error, power = self.held.errors(self.learner)
        return {
            **meta_of(self.network, self.paper),
            **self.named,
            "model": "neural",
            "paper": self.paper,
            "guided": self.guide is not None,
            "seed": self.seed,
            "mse_by_level": [float(f"{each:.4g}") for each in error],
            "snr_db_by_level": [
                round(10.0 * math.log10(p / max(e, 1e-12)), 2) for p, e in zip(power, error, strict=True)
            ],
        }


class _Scaled(Adam):
    """Adam with a factor on its learning rate."""

    def __init__(self, size: int, factor: float, betas: tuple[float, float]) -> None:
        super().__init__(size, betas, 1e-8)
        self.factor = factor

    def step(self, weights: NDArray, gradient: NDArray, rate: float) -> None:
        """See ``Adam``."""
        super().step(weights, gradient, rate * self.factor)


def needed_memory(size: tuple[int, int]) -> int:
    """Predicted bytes of memory that training a material of this size takes."""
    texels = size[0] * size[1]
    # Two textures of 8 floats, the pyramid a third larger, with their moments, copies, sums and gradients of all parts.
    textures = (8 * 4 * texels * 7 // 3) * (PARTS + 8)
    batch = 4 * texels * 4 * (QUERY + 3)
    return textures + max(min(_KEPT * batch, 256 << 20), _LEARNED * batch) + 4 * batch


def check_memory(size: tuple[int, int]) -> None:
    """Refuse a size whose training does not fit into free memory, before it begins.

    Raises:
        InputError: tells how much memory is needed and how much is free.
    """
    needed, free = needed_memory(size), free_memory()
    if free is not None and needed > free:
        raise InputError(
            f"Training a neural material of {size[1]}x{size[0]} texels needs about {needed / 2**30:.1f} GiB of memory "
            f"and {free / 2**30:.1f} GiB are free: give a smaller --size."
        )
