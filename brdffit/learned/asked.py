"""Shared by the learned methods: checks of the options against the training, files of weights, bounds of outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.options import LobeOptions
from brdffit.roughness import clipped_log
from brdffit.svbrdf import Svbrdf

#: Value of the option ``weights`` for the weights that the program ships.
SHIPPED = "shipped"
#: Largest absolute log of the factor by which a network may correct the scale of a lobe.
MOST_FACTOR = 2.0


def check_asked(name: str, svbrdf: Svbrdf, options: LobeOptions, models: Sequence[str]) -> list[str]:
    """Check a base and options against what the networks were trained for; returns notes on lesser differences.

    Args:
        name: of the method.
        svbrdf: the base.
        options: of the bake.
        models: lobe models that the networks know.

    Raises:
        InputError: for another lobe model, or numbers that are not finite.
    """
    for model in (svbrdf.model, options.model):
        if model not in models:
            known = " and ".join(f"'{each}'" for each in models)
            many = "models" if len(models) > 1 else "model"
            raise InputError(f"The weights of method '{name}' are for the lobe {many} {known}, not for '{model}'.")
    if not svbrdf.is_finite():
        raise InputError("The SVBRDF holds numbers that are not finite; every texel must be a finite number.")
    notes = []
    if options.pixel_filter != "box":
        notes.append(f"The networks of method '{name}' were trained with the box filter, not '{options.pixel_filter}'.")
    if options.density != "cosine":
        notes.append(f"The networks of method '{name}' were trained for cosine-distributed lights and viewers.")
    return notes


def bounded(tensor: NDArray, options: LobeOptions) -> NDArray:
    """Log tensors (n, 3) with the eigenvalues of the tensor clipped to [``min_roughness``^4, 1].

    With ``lobe="isotropic"`` they are first made isotropic, with the same determinant.
    """
    if options.lobe == "isotropic":
        mean = 0.5 * (tensor[:, 0] + tensor[:, 1])
        tensor = np.stack([mean, mean, np.zeros_like(mean)], axis=1)
    return clipped_log(tensor, options.min_roughness)


def level_of(
    normal: NDArray, tensor: NDArray, specular: NDArray, diffuse: NDArray, filtered: Mapping[str, NDArray],
    svbrdf: Svbrdf, options: LobeOptions,
) -> Svbrdf:  # fmt: skip
    """A level (h, w) from the predicted lobes.

    Args:
        normal, tensor, specular, diffuse: (h, w, 3); the log tensor is clipped here, see ``bounded``.
        filtered: averaged channels, of which "occlusion" (h, w, 1) is used if it is there.
        svbrdf: the base.
        options: of the bake.
    """
    occlusion = filtered.get("occlusion")
    return Svbrdf(
        normal=normal.astype(np.float32),
        log_roughness=bounded(tensor.reshape(-1, 3), options).reshape(tensor.shape).astype(np.float32),
        specular=specular.astype(np.float32), diffuse=diffuse, model=options.model, wrap=svbrdf.wrap,
        occlusion=None if occlusion is None else np.clip(occlusion[..., 0], 0.0, 1.0),
    )  # fmt: skip


def weights_path(name: str, shipped: Path) -> Path:
    """The file that the option ``weights`` names: ``shipped``, or a path."""
    return shipped if name == SHIPPED else Path(name)


def told_of(meta: Mapping[str, Any]) -> str:
    """Sentences on how weights were trained and which sets were held out, from the meta of their file."""
    sets, seconds = len(meta.get("training_sets", ())), float(meta.get("seconds", 0.0))
    took = f"{seconds / 60.0:.0f} min" if seconds >= 120.0 else f"{seconds:.0f} s"
    return (
        f"Trained before, for {took} on {sets} sets ({meta.get('steps')} steps); this is no part of its seconds. "
        f"Never trained on: {', '.join(meta.get('held_out_sets', ())) or 'none held out'}."
    )


def tiny_base() -> Svbrdf:
    """A base of 3x3 texels to compile with: its size cannot be halved, so the kernels that gather run too."""
    flat = np.zeros((3, 3, 3), np.float32)
    return Svbrdf(flat + np.array([0, 0, 1], np.float32), flat - 1.0, flat + 0.5, flat + 0.5)
