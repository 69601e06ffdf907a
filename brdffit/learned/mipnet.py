"""The network of the method ``mipnet``: four texels to one, level by level (after Gauthier et al. 2022, MIPNet).

It predicts the normal and the tensor of a texel from those of the four texels below it; colours are averaged linearly.
Each level is made from the predictions of the one before, so the network is trained through all levels at once. It is
smaller than the paper's: two hidden layers of 64 instead of 512, and no height among the inputs. Normals are measured
in widths of the mean lobe. With xy the normal's x and y, and abc the log tensor,

    inputs: m the mean of the four, b_k (k = 1, 2, 3) their sums with the signs of a 2x2 Haar basis, over 4, and
        w = exp((m_a + m_b) / 4) the width of the mean lobe: asinh(b_k xy / w), b_k abc, m_xy, m_abc;
    outputs d: xy = m_xy + w d_xy, shortened to the disc of radius LONGEST; log tensor = m_abc + d_abc.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.learned.latent import LONGEST
from brdffit.nets.layers import DenseChain
from brdffit.nets.weights import read_weights, shaped

KIND = "mipnet"
#: Weights that the program ships.
SHIPPED = Path(__file__).parent / "weights" / "mipnet-ggx.npz"
#: Numbers of a texel: x and y of its normal, log tensor.
TEXEL = 5
HIDDEN = (64, 64)
INPUTS = 20
#: Signs of the four texels (row by row) in the three Haar functions, over 4.
_HAAR = np.array([[1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0], [1.0, -1.0, -1.0, 1.0]]) / 4.0


class Step(NamedTuple):
    """What ``MipNetwork.backward`` needs of a level.

    Attributes:
        sums: (n, 3, TEXEL) Haar sums.
        width: (n,) widths of the mean lobes.
        out: (n, TEXEL) outputs of the chain.
        uncut: (n, 2) xy before they are shortened.
        kept: what the chain keeps.
    """

    sums: NDArray
    width: NDArray
    out: NDArray
    uncut: NDArray
    kept: list[list[NDArray]]


class MipNetwork:
    """The chain of dense layers; with its initial weights it averages."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.chain = DenseChain((INPUTS, *HIDDEN, TEXEL), rng, last_gain=0.0)

    def forward(self, four: NDArray, keep: bool = False) -> tuple[NDArray, Step]:
        """Texels (n, TEXEL) float64 from four each (n, 4, TEXEL), and, with ``keep``, what ``backward`` needs."""
        mean, sums = four.mean(axis=1), np.einsum("kf,nfc->nkc", _HAAR, four)
        width = np.exp(0.25 * (mean[:, 2] + mean[:, 3]))
        spread = np.arcsinh(sums[:, :, :2] / width[:, None, None])
        rows = np.concatenate([spread.reshape(-1, 6), sums[:, :, 2:].reshape(-1, 9), mean], axis=1)
        out = self.chain.forward(rows.astype(np.float32), keep=keep).astype(np.float64)
        uncut = mean[:, :2] + width[:, None] * out[:, :2]
        length = np.linalg.norm(uncut, axis=1, keepdims=True)
        xy = uncut * np.minimum(1.0, LONGEST / np.maximum(length, 1e-12))
        texel = np.concatenate([xy, mean[:, 2:] + out[:, 2:]], axis=1)
        return texel, Step(sums, width, out, uncut, self.chain.kept)

    def backward(self, by_texel: NDArray, step: Step) -> NDArray:
        """dL/d(four) (n, 4, TEXEL) from dL/d(texels); adds to the gradient.

        With v = b_k xy / w, d asinh(v) = dv / sqrt(1 + v^2); and dw = w (dm_a + dm_b) / 4.
        """
        width = step.width[:, None]
        by_xy = by_texel[:, :2]
        length = np.linalg.norm(step.uncut, axis=1, keepdims=True)
        e = step.uncut / np.maximum(length, 1e-12)
        by_xy = np.where(
            length > LONGEST,
            (by_xy - (by_xy * e).sum(axis=1, keepdims=True) * e) * LONGEST / np.maximum(length, 1e-12), by_xy,
        )  # fmt: skip
        by_mean = np.concatenate([by_xy, by_texel[:, 2:]], axis=1)
        by_width = (by_xy * step.out[:, :2]).sum(axis=1)
        by_out = np.concatenate([by_xy * width, by_texel[:, 2:]], axis=1)
        by_rows = self.chain.backward(by_out.astype(np.float32), step.kept, to_rows=True).astype(np.float64)
        v = step.sums[:, :, :2] / width[:, None]
        by_v = by_rows[:, :6].reshape(-1, 3, 2) / np.sqrt(1.0 + v * v)
        by_sums = np.concatenate([by_v / width[:, None], by_rows[:, 6:15].reshape(-1, 3, 3)], axis=2)
        by_width = by_width - (by_v * v).sum(axis=(1, 2)) / step.width
        by_mean = by_mean + by_rows[:, 15:]
        by_mean[:, 2:4] += (0.25 * by_width * step.width)[:, None]
        return 0.25 * by_mean[:, None] + np.einsum("kf,nkc->nfc", _HAAR, by_sums)

    def arrays(self) -> dict[str, NDArray]:
        """The arrays of a file of weights, by name."""
        return {"chain": self.chain.weights}

    @classmethod
    def of(cls, arrays: dict[str, NDArray], path: Path) -> MipNetwork:
        """The network with the weights of a file.

        Raises:
            InputError: when they have another shape.
        """
        made = cls(np.random.default_rng(0))
        made.chain.weights[:] = shaped(arrays, "chain", made.chain.weights.shape, path)
        return made


@cache
def load_mipnet(path: Path = SHIPPED) -> tuple[MipNetwork, dict[str, Any]]:
    """The network of a file, which is read once, and its meta.

    Raises:
        InputError: when the file cannot be read or is of another kind or shape.
    """
    arrays, meta = read_weights(path, KIND)
    return MipNetwork.of(arrays, path), meta


def fours(image: NDArray) -> NDArray:
    """(h / 2 * w / 2, 4, C) blocks of 2x2 texels of an image (h, w, C) of even size, row by row."""
    height, width, channels = image.shape
    blocks = image.reshape(height // 2, 2, width // 2, 2, channels).transpose(0, 2, 1, 3, 4)
    return blocks.reshape(-1, 4, channels)


def fours_back(blocks: NDArray, size: tuple[int, int]) -> NDArray:
    """The inverse of ``fours``: an image of this size."""
    height, width = size
    image = blocks.reshape(height // 2, width // 2, 2, 2, -1).transpose(0, 2, 1, 3, 4)
    return image.reshape(height, width, -1)


def taken(image: NDArray, size: tuple[int, int]) -> NDArray:
    """(n, 4, C) four texels of an image for each texel of a level of ``size``, row by row.

    They are its 2x2 block; where the image has an odd side, the texels nearest to it.
    """
    pairs = []
    for before, after in zip(image.shape[:2], size, strict=True):
        first = np.minimum(np.arange(after) * before // after, before - 1)
        pairs.append((first, np.minimum(first + 1, before - 1) if before > after else first))
    (top, bottom), (left, right) = pairs
    corners = [image[rows][:, columns] for rows in (top, bottom) for columns in (left, right)]
    return np.stack([corner.reshape(-1, image.shape[2]) for corner in corners], axis=1)
