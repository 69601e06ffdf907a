"""Training of the method ``latent``: one augmented crop a step, with the loss at points between texels and levels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import LUMINANCE
from brdffit.learned.crops import LEVELS, SIDE, TEXELS, Crop, Source, make_crop
from brdffit.learned.judging import figure_of, judged_patches
from brdffit.learned.latent import (
    CODE,
    DECODER_DEPTH,
    ENCODER_DEPTH,
    FORMS,
    INPUTS,
    KIND,
    MODELS,
    OUTPUTS,
    LatentNetworks,
    inputs_of,
)
from brdffit.learned.latent_losses import FLOOR, LIGHTS, LOSSES, exact_loss, rendering_loss
from brdffit.learned.tasks import SetsTask
from brdffit.methods import one_of
from brdffit.nets.adam import Adam
from brdffit.nets.layers import Network
from brdffit.svbrdf import Svbrdf

#: Iterations of the paper's training.
PAPER_STEPS = 310_000
#: Number of crops that steps draw from, and mean number of steps after which one of them is replaced.
CROPS, _STEPS_A_CROP = 1000, 15
# Learning rate; the paper's 5e-5 is for one noisy sample a pixel, and the exact objective allows a larger one.
_RATE, _WARM_STEPS, _HALVINGS = 3e-4, 100, 6.2
_TOLD = {
    "exact": f"mean of log(e + {FLOOR}), e the half-angle error of the interpolated lobe at its best scale",
    "paper": f"relative L2, denominator held, {LIGHTS} lights and viewers, one sample a pixel",
}


class LatentTask(SetsTask):
    """The networks and the crops that they are trained on. A resumed training starts from the first crops again.

    Args:
        sources, held_out: see ``SetsTask``.
        seed: of initial weights and crops.
        crops: number of crops that steps draw from.
        loss: "exact", or "paper".
        form: of the decoders' outputs, see ``latent``.

    Attributes:
        highest: learning rate that is reached after the first steps; it may be set before the training.
    """

    kind = KIND

    def __init__(
        self, sources: Sequence[str | Path], held_out: Sequence[str | Path], seed: int, crops: int = CROPS,
        loss: str = LOSSES[0], form: str = FORMS[0],
    ) -> None:  # fmt: skip
        super().__init__(sources, held_out)
        rng = np.random.default_rng(seed)
        self.loss, self.highest = one_of("loss", loss, LOSSES), _RATE
        self.networks_ = LatentNetworks(rng, one_of("form", form, FORMS))
        self.sets = [Source(each) for each in self.sources]
        self.crops = [self._make_crop(rng) for _ in range(crops)]
        self.networks_.whiten_by(np.concatenate([crop.inputs.reshape(-1, INPUTS) for crop in self.crops[:256]]))
        self.judged = judged_patches(self.judging, rng)

    def networks(self) -> dict[str, Network]:
        """Encoders and decoders."""
        return dict(self.networks_.networks())

    def _make_crop(self, rng: np.random.Generator) -> Crop:
        return make_crop(self.sets, rng, exact=self.loss == "exact")

    def optimiser(self, size: int) -> Adam:
        """Adam with the paper's parameters."""
        return Adam(size, (0.95, 0.95), 1e-6)

    def rate(self, step: int, done: float) -> float:
        """Rises over the first steps, then is halved as many times as in the paper, whatever the training's length."""
        return self.highest * min(1.0, (step + 1) / _WARM_STEPS) * 0.5 ** int(done * _HALVINGS)

    def accumulate(self, rng: np.random.Generator) -> float:
        """Add the gradient of one crop; returns its loss."""
        if rng.integers(_STEPS_A_CROP) == 0:
            self.crops[rng.integers(len(self.crops))] = self._make_crop(rng)
        crop = self.crops[rng.integers(len(self.crops))]
        return learn_crop(self.networks_, crop, rng if self.loss == "paper" else None)

    def figure(self) -> float:
        """Mean over sets and levels of the SNR in dB, on held-out sets."""
        return figure_of(self.judged, lambda svbrdf: say_levels(self.networks_, svbrdf))

    def arrays(self) -> dict[str, NDArray]:
        """Arrays of the networks."""
        return self.networks_.arrays()

    def meta(self) -> dict[str, Any]:
        """Provenance."""
        return {
            "architecture": {
                "inputs": INPUTS, "code": CODE, "outputs": OUTPUTS, "encoder": ENCODER_DEPTH, "decoder": DECODER_DEPTH,
                "form": self.networks_.form, "models": list(MODELS),
            },
            "loss": _TOLD[self.loss],
            **self.provenance(),
            "steps_of_the_paper": PAPER_STEPS,
        }  # fmt: skip


def pooled(code: NDArray) -> NDArray:
    """(H / 2, W / 2, C) means over 2 x 2 texels of a code (H, W, C)."""
    height, width, channels = code.shape
    return code.reshape(height // 2, 2, width // 2, 2, channels).mean(axis=(1, 3))


def spread_back(by_code: NDArray) -> NDArray:
    """The transpose of ``pooled``."""
    return np.repeat(np.repeat(by_code, 2, axis=0), 2, axis=1) * np.float32(0.25)


def learn_crop(networks: LatentNetworks, crop: Crop, rng: np.random.Generator | None = None) -> float:
    """Mean loss of a crop over all decoders; adds to the gradients of the crop's encoder and of all decoders.

    With ``rng`` it is the paper's loss, otherwise the exact one.
    """
    codes = [networks.encode(crop.inputs, crop.model)]
    for _ in range(LEVELS - 1):
        codes.append(pooled(codes[-1]))
    flat = np.concatenate([code.reshape(-1, CODE) for code in codes])
    total, by_code, lobe = 0.0, np.zeros_like(flat), networks.filtered(flat)
    for model in networks.decoders:
        said = networks.decode(flat, model, lobe)
        loss, by_said = exact_loss(said, crop, model) if rng is None else rendering_loss(said, crop, model, rng)
        by_code += networks.decode_back(by_said, model)
        total += loss / len(networks.decoders)
    gradient = None
    end = TEXELS
    for level in reversed(range(LEVELS)):
        side = SIDE >> level
        here = by_code[end - side * side : end].reshape(side, side, CODE)
        gradient = here if gradient is None else here + spread_back(gradient)
        end -= side * side
    networks.encode_back(np.ascontiguousarray(gradient), crop.model)
    return total


def say_levels(networks: LatentNetworks, svbrdf: Svbrdf) -> list[NDArray]:
    """Outputs (h * w, OUTPUTS) of the levels of a patch, down to the first with an odd side."""
    inputs = inputs_of(svbrdf.normal, svbrdf.log_roughness, svbrdf.specular @ LUMINANCE)
    code, levels = networks.encode(inputs), []
    while True:
        levels.append(networks.decode(code.reshape(-1, CODE)))
        if code.shape[0] % 2 or code.shape[1] % 2:
            return levels
        code = pooled(code)
