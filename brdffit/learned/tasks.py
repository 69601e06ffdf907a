"""Shared by the trainings of `learned`, `latent` and `mipnet`: their sets, and the provenance in a file of weights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

from numpy.typing import NDArray

from brdffit.learned.data import set_digest
from brdffit.nets.adam import Adam
from brdffit.nets.layers import Network
from brdffit.nets.training import warm_then_falling


class SetsTask:
    """A training on texture sets.

    Args:
        sources: sets to train on.
        held_out: sets that the figure is measured on; if there are none, it is measured on the training sets.
    """

    def __init__(self, sources: Sequence[str | Path], held_out: Sequence[str | Path]) -> None:
        self.sources, self.held_out = [Path(each) for each in sources], [Path(each) for each in held_out]

    @property
    def judging(self) -> list[Path]:
        """Sets that the figure is measured on."""
        return self.held_out or self.sources

    def provenance(self) -> dict[str, Any]:
        """Names and digests of the sets. It says nothing of their licences, which it cannot know."""
        return {
            "training_sets": {each.name: set_digest(each) for each in self.sources},
            "held_out_sets": [each.name for each in self.held_out],
        }


class ChainTask(SetsTask):
    """A training of one chain of layers, ``network.chain``, with a learning rate from ``rates[0]`` to ``rates[1]``."""

    network: Any
    rates: ClassVar[tuple[float, float]]

    def networks(self) -> dict[str, Network]:
        """The chain of the network."""
        return {"chain": self.network.chain}

    def optimiser(self, size: int) -> Adam:
        """Adam with its default parameters here, betas of 0.9 and 0.99."""
        return Adam(size)

    def rate(self, step: int, done: float) -> float:
        """See ``warm_then_falling``."""
        return warm_then_falling(step, done, *self.rates)

    def arrays(self) -> dict[str, NDArray]:
        """Arrays of the network."""
        return self.network.arrays()
