"""The network of the method ``learned``: from features of a footprint to a correction of its closed form."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.learned.kernels.moments import (
    DEVIATION,
    FEATURES,
    FIRST_ODD,
    SECOND_ODD,
    SHARPEST,
    TENSORS,
    features_of,
)
from brdffit.learned.kernels.saying import ALIKE, FARTHEST, LOG_MOST, MOST, OUTPUTS, Said
from brdffit.learned.residual import CORRECTIONS, compose
from brdffit.nets.layers import DenseChain
from brdffit.nets.weights import read_weights, shaped

KIND = "learned"
#: Weights that the program ships.
SHIPPED = Path(__file__).parent / "weights" / "learned-ggx.npz"


def difference(features: NDArray) -> NDArray:
    """Factor (n,) of corrections, from features (n, FEATURES): 0 where all lobes of a footprint are equal, up to 1.

    The closed form is exact where they are equal. The factor is x / (x + ``ALIKE``), with x the share of the normals'
    covariance in the widened tensor, summed over its axes, plus measures of how far the lobes differ in size.
    """
    by_normals = np.maximum(2.0 - features[:, TENSORS] - features[:, TENSORS + 1], 0.0)
    x = by_normals + features[:, DEVIATION] + np.maximum(features[:, SHARPEST], 0.0)
    return x / (x + ALIKE)


#: Share of the training's features at either end that its range leaves out, and the range's margin by its width.
_OUTLIERS, _MARGIN = 1e-4, 0.5


class Prediction(NamedTuple):
    """Lobes of n texels.

    Attributes:
        theta: (n, 5) slopes and log tensor.
        factor: (n,) scale over the filtered colour.
        covered: (n,) bool, whether all features lie in the range of the training data.
    """

    theta: NDArray
    factor: NDArray
    covered: NDArray


class ResidualNetwork:
    """A chain of dense layers on normalised features.

    Attributes:
        hidden: sizes of the hidden layers.
        mean, deviation: (FEATURES,) of the training data.
        low, high: (FEATURES,) range of the training data.
        chain: the layers.
    """

    def __init__(self, hidden: tuple[int, ...], rng: np.random.Generator) -> None:
        self.hidden = hidden
        # The last layer starts at 0, so that an untrained network returns the closed form.
        self.chain = DenseChain((FEATURES, *hidden, OUTPUTS), rng, last_gain=0.0)
        self.mean, self.deviation = np.zeros(FEATURES), np.ones(FEATURES)
        self.low, self.high = np.full(FEATURES, -np.inf), np.full(FEATURES, np.inf)

    def cover(self, features: NDArray) -> None:
        """Set normalisation and range from training features (n, FEATURES).

        Axes have no sense, so features that change sign with an axis have mean 0 and a symmetric range. Quantiles keep
        a few outliers from widening the range. The margin is wide: inputs are cut at ``FARTHEST`` deviations, and on
        texels of held-out sets just outside the range the network is still 2 to 4 dB better than its closed form.
        """
        odd = sorted({*FIRST_ODD, *SECOND_ODD})
        self.mean = features.mean(axis=0)
        self.mean[odd] = 0.0
        self.deviation = np.sqrt(np.square(features - self.mean).mean(axis=0)) + 1e-3
        low, high = np.quantile(features, (_OUTLIERS, 1.0 - _OUTLIERS), axis=0)
        high[odd] = np.maximum(-low[odd], high[odd])
        low[odd] = -high[odd]
        margin = _MARGIN * (high - low) + 1e-3
        self.low, self.high = low - margin, high + margin

    def normalised(self, features: NDArray) -> NDArray:
        """Inputs (n, FEATURES) float32 of the chain."""
        return np.clip((features - self.mean) / self.deviation, -FARTHEST, FARTHEST).astype(np.float32)

    def predict(self, moments: NDArray, glows: NDArray) -> Prediction:
        """Lobes of footprints with these moments (n, MOMENTS) and glows (n,), float64 (see ``moments.glow``)."""
        features, closed = features_of(moments, glows)
        out = self.chain.forward(self.normalised(features)) * difference(features)[:, None]
        out = np.clip(out, -MOST, MOST)
        covered = np.all((features >= self.low) & (features <= self.high), axis=1)
        factor = np.exp(np.clip(out[:, CORRECTIONS], -LOG_MOST, LOG_MOST))
        return Prediction(compose(closed, out[:, :CORRECTIONS]), factor, covered)

    def said(self, log_low: float, round_lobes: bool, free: bool, up: float) -> Said:
        """The network and the bounds of its results, as the kernel takes them (see ``Said``)."""
        layers = [[layer.ins, layer.outs, layer.weights.start, layer.bias.start] for layer in self.chain.layers]
        table = np.array(layers, np.int64)
        return Said(
            self.chain.weights, table, self.mean, 1.0 / self.deviation, self.low, self.high, int(table[:, 1].max()),
            log_low, float(round_lobes), float(free), up,
        )  # fmt: skip

    def arrays(self) -> dict[str, NDArray]:
        """The arrays of a file of weights, by name."""
        return {
            "chain": self.chain.weights, "mean": self.mean, "deviation": self.deviation, "low": self.low,
            "high": self.high,
        }  # fmt: skip

    def architecture(self) -> dict[str, Any]:
        """Sizes of the layers, for the meta of a file of weights."""
        return {"features": FEATURES, "hidden": list(self.hidden), "outputs": OUTPUTS}

    @classmethod
    def of(cls, arrays: dict[str, NDArray], meta: dict[str, Any], path: Path) -> ResidualNetwork:
        """The network with the weights of a file.

        Raises:
            InputError: when they are of another architecture.
        """
        hidden = tuple(int(size) for size in meta.get("architecture", {}).get("hidden", ()))
        made = cls(hidden, np.random.default_rng(0))
        made.chain.weights[:] = shaped(arrays, "chain", made.chain.weights.shape, path)
        for name in ("mean", "deviation", "low", "high"):
            setattr(made, name, shaped(arrays, name, (FEATURES,), path).astype(np.float64))
        return made


@cache
def load_network(path: Path = SHIPPED) -> tuple[ResidualNetwork, dict[str, Any]]:
    """The network of a file, which is read once, and its meta.

    Raises:
        InputError: when the file cannot be read or is of another kind or shape.
    """
    arrays, meta = read_weights(path, KIND)
    return ResidualNetwork.of(arrays, meta, path), meta
