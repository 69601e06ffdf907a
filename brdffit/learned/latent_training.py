"""Training of the method ``latent``: one augmented crop a step, judged between texels and levels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.halfangle.apparent_lobe import base_of
from brdffit.learned.crops import LEVELS, SIDE, TEXELS, Crop, Source, make_crop
from brdffit.learned.data import level_strata, read_set, set_digest
from brdffit.learned.latent import (
    CODE,
    DECODER_DEPTH,
    ENCODER_DEPTH,
    FACTOR,
    INPUTS,
    KIND,
    NORMAL,
    OUTPUTS,
    TENSOR,
    LatentNetworks,
    inputs_of,
    lift_back,
    lifted,
    luminance_of,
)
from brdffit.learned.tables import Table, errors_of, tabulate
from brdffit.nets.adam import Adam
from brdffit.nets.layers import Network

#: Iterations of the paper's training.
PAPER_STEPS = 310_000
#: Crops that are at hand; one of them is replaced by a fresh one every so many steps, in the mean.
CROPS, _STEPS_A_CROP = 1000, 15
# The paper's 5e-5 is for one noisy sample a pixel; the exact objective bears more.
_RATE, _WARM_STEPS, _HALVINGS = 3e-4, 100, 6.2
_FLOOR = 0.1
_STEEPEST = 3.0
_MOST_FACTOR = 2.0
#: Patches of each held-out set, and their size; texels near a patch's border are not judged.
_PATCHES, _PATCH, _BORDER = 2, 64, 8


class LatentTask:
    """Networks and their crops. A training that is resumed begins with the first crops again.

    Args:
        sources: sets to train on.
        held_out: sets for the figure; with none, the training sets.
        seed: of initial weights and crops.
        crops: at hand at once.
    """

    kind = KIND

    def __init__(
        self, sources: Sequence[str | Path], held_out: Sequence[str | Path], seed: int, crops: int = CROPS
    ) -> None:
        rng = np.random.default_rng(seed)
        self.sources, self.held_out = [Path(each) for each in sources], [Path(each) for each in held_out]
        self.networks_ = LatentNetworks(rng)
        self.sets = [Source(each) for each in self.sources]
        self.crops = [make_crop(self.sets, rng) for _ in range(crops)]
        self.networks_.whiten_by(np.concatenate([crop.inputs.reshape(-1, INPUTS) for crop in self.crops[:256]]))
        self.judged = [patch for each in (self.held_out or self.sources) for patch in judged_patches(each, rng)]

    def networks(self) -> dict[str, Network]:
        """Both."""
        return {"encoder": self.networks_.encoder, "decoder": self.networks_.decoder}

    def optimiser(self, size: int) -> Adam:
        """As in the paper."""
        return Adam(size, (0.95, 0.95), 1e-6)

    def rate(self, step: int, done: float) -> float:
        """Halved as often as in the paper, whatever the training's length."""
        return _RATE * min(1.0, (step + 1) / _WARM_STEPS) * 0.5 ** int(done * _HALVINGS)

    def accumulate(self, rng: np.random.Generator) -> float:
        """One crop."""
        if rng.integers(_STEPS_A_CROP) == 0:
            self.crops[rng.integers(len(self.crops))] = make_crop(self.sets, rng)
        return learn_crop(self.networks_, self.crops[rng.integers(len(self.crops))])

    def figure(self) -> float:
        """Mean over sets and levels of the SNR."""
        errors: dict[tuple[str, int], list[NDArray]] = {}
        for patch in self.judged:
            for level, error in patch.errors(self.networks_).items():
                errors.setdefault((patch.name, level), []).append(error)
        return float(np.mean([-10.0 * np.log10(np.mean(np.concatenate(each))) for each in errors.values()]))

    def arrays(self) -> dict[str, NDArray]:
        """Of the networks."""
        return self.networks_.arrays()

    def meta(self) -> dict[str, Any]:
        """Provenance."""
        return {
            "architecture": {
                "inputs": INPUTS, "code": CODE, "outputs": OUTPUTS, "encoder": ENCODER_DEPTH, "decoder": DECODER_DEPTH
            },
            "loss": f"mean of log(e + {_FLOOR}), e the half-angle error of the interpolated lobe at its best scale",
            "training_sets": {each.name: set_digest(each) for each in self.sources},
            "held_out_sets": [each.name for each in self.held_out],
            "steps_of_the_paper": PAPER_STEPS,
            "licence": "trained on CC0-1.0 texture sets",
        }  # fmt: skip


def pooled(code: NDArray) -> NDArray:
    """Means of 2 x 2 texels."""
    height, width, channels = code.shape
    return code.reshape(height // 2, 2, width // 2, 2, channels).mean(axis=(1, 3))


def spread_back(by_code: NDArray) -> NDArray:
    """The transpose of ``pooled``."""
    return np.repeat(np.repeat(by_code, 2, axis=0), 2, axis=1) * np.float32(0.25)


def learn_crop(networks: LatentNetworks, crop: Crop) -> float:
    """Mean loss of a crop's footprints; adds to the gradients of encoder and decoder."""
    codes = [networks.encode(crop.inputs)]
    for _ in range(LEVELS - 1):
        codes.append(pooled(codes[-1]))
    said = networks.decode(np.concatenate([code.reshape(-1, CODE) for code in codes]))
    loss, by_said = interpolated_loss(said, crop)
    by_code = networks.decode_back(by_said)
    gradient = None
    end = TEXELS
    for level in reversed(range(LEVELS)):
        side = SIDE >> level
        here = by_code[end - side * side : end].reshape(side, side, CODE)
        gradient = here if gradient is None else here + spread_back(gradient)
        end -= side * side
    networks.encode_back(np.ascontiguousarray(gradient))
    return loss


def interpolated_loss(said: NDArray, crop: Crop) -> tuple[float, NDArray]:
    """Mean loss of what trilinear filtering makes of outputs (TEXELS, OUTPUTS), and its gradient by them.

    Filtered are unit normals, log tensors and scales' logs. With v the mean of normals, the slopes are -v_xy / v_z.
    """
    points = len(crop.taps)
    normal = lifted(said[:, NORMAL])
    whole = np.concatenate([normal, said[:, 2:]], axis=1)
    mean = np.einsum("nt,ntc->nc", crop.shares, whole[crop.taps])
    v, tensor = mean[:, :3], mean[:, 3:6]
    theta = np.concatenate([-v[:, :2] / v[:, 2:], tensor], axis=1)
    found = errors_of(crop.table, np.arange(points), theta)
    fine = np.isfinite(found.error) & np.isfinite(found.gradient).all(axis=1)
    error = np.where(fine, np.maximum(found.error, 0.0), 1.0)
    weight = np.where(fine, 1.0 / (error + _FLOOR), 0.0)
    by_theta = np.where(fine[:, None], found.gradient, 0.0) * weight[:, None]
    by_mean = np.zeros((points, 7))
    by_mean[:, :2] = -by_theta[:, :2] / v[:, 2:]
    by_mean[:, 2] = (by_theta[:, :2] * v[:, :2]).sum(axis=1) / v[:, 2] ** 2
    by_mean[:, 3:6] = by_theta[:, 2:]
    # Normals are known to a lobe's width: in those units no texel may pull too hard.
    width = np.exp(0.25 * (tensor[:, :1] + tensor[:, 1:2]))
    length = np.sqrt((np.square(by_mean[:, :3]) * width**2).sum(axis=1) + np.square(by_mean[:, 3:6]).sum(axis=1))
    by_mean[:, :6] *= np.minimum(1.0, _STEEPEST / np.maximum(length, 1e-12))[:, None]
    factor = np.clip(mean[:, 6], -_MOST_FACTOR, _MOST_FACTOR)
    scale = crop.table.colour * np.exp(factor)
    by_scale = 2.0 * np.clip(found.weight * weight * (scale - found.scale) * scale, -1.0, 1.0)
    by_mean[:, 6] = np.where(fine, by_scale, 0.0)
    by_mean /= points
    spread = (crop.shares[:, :, None] * by_mean[:, None, :]).reshape(-1, 7)
    flat = crop.taps.reshape(-1)
    by_whole = np.stack([np.bincount(flat, spread[:, k], TEXELS) for k in range(7)], axis=1)
    by_said = np.empty((TEXELS, OUTPUTS))
    by_said[:, NORMAL] = lift_back(said[:, NORMAL], by_whole[:, :3])
    by_said[:, TENSOR] = by_whole[:, 3:6]
    by_said[:, FACTOR] = by_whole[:, 6]
    return float(np.mean(np.log(error + _FLOOR))), by_said


class JudgedPatch:
    """A patch of a held-out set and the footprints of its texels at some levels, away from its border."""

    levels = (1, 2, 3)

    def __init__(self, name: str, inputs: NDArray, tables: dict[int, tuple[NDArray, Table]]) -> None:
        self.name, self.inputs, self.tables = name, inputs, tables

    def errors(self, networks: LatentNetworks) -> dict[int, NDArray]:
        """Error (n,) of the texels judged, a level."""
        code, out = networks.encode(self.inputs), {}
        for level in range(1, max(self.levels) + 1):
            code = pooled(code)
            if level not in self.tables:
                continue
            index, table = self.tables[level]
            said = networks.decode(code.reshape(-1, CODE)[index])
            normal = lifted(said[:, NORMAL])
            theta = np.concatenate([-normal[:, :2] / normal[:, 2:], said[:, TENSOR]], axis=1)
            found = errors_of(table, np.arange(len(table)), theta)
            scale = table.colour * np.exp(np.clip(said[:, FACTOR], -_MOST_FACTOR, _MOST_FACTOR))
            out[level] = np.clip(found.error, 0.0, 5.0) + found.weight * (scale - found.scale) ** 2
        return out


def judged_patches(source: Path, rng: np.random.Generator) -> list[JudgedPatch]:
    """Some patches of a set."""
    svbrdf = read_set(source)
    base, patches = base_of(svbrdf), []
    for _ in range(_PATCHES):
        top, left = (_PATCH * int(rng.integers(0, size // _PATCH)) for size in svbrdf.size)
        part = (slice(top, top + _PATCH), slice(left, left + _PATCH))
        inputs = inputs_of(svbrdf.normal[part], svbrdf.log_roughness[part], luminance_of(svbrdf.specular[part]))
        tables = {}
        for level in JudgedPatch.levels:
            side, edge = _PATCH >> level, max(1, _BORDER >> level)
            rows, columns = (p.reshape(-1) for p in np.mgrid[edge : side - edge, edge : side - edge])
            rule, room = level_strata(svbrdf.size, level)
            scale = 1 << level
            table = tabulate(base, rule, left + (columns + 0.5) * scale, top + (rows + 0.5) * scale, room)
            if len(table) == len(rows):
                tables[level] = rows * side + columns, table
        patches.append(JudgedPatch(source.name, inputs, tables))
    return patches
