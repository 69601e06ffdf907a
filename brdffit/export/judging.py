"""How much of a lobe pictures keep: the SNR of what is stored against what was baked, at random texels.

Both lobes are evaluated under random directions: views with the density of the cosine, lights drawn from either lobe
alternately and divided by the mixture of both densities (Veach and Guibas 1995), so that the error of a stored lobe is
seen whether it is too narrow or too wide.  SNR = 10 log10 of sum (f n.l)^2 / sum (f n.l - g n.l)^2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import LobePyramid, Lobes
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf

#: Random texels of a level, and pairs of directions for each.
TEXELS, PAIRS = 256, 32
#: SNR in dB that is reported where nothing is lost.
HIGHEST_DB = 99.0


def random_places(size: tuple[int, int], mip_level: int) -> tuple[NDArray, NDArray]:
    """(rows, columns) of up to TEXELS texels of a level, the same in every run; all of them where they are few."""
    count = size[0] * size[1]
    chosen = np.arange(count)
    if count > TEXELS:
        chosen = np.sort(np.random.default_rng(mip_level).choice(count, TEXELS, replace=False))
    return chosen // size[1], chosen % size[1]


def texels_of(svbrdf: Svbrdf, places: tuple[NDArray, NDArray]) -> Svbrdf:
    """The texels at some places, as an SVBRDF of one column."""
    return svbrdf.replace(**{name: array[places][:, None] for name, array in svbrdf.arrays().items()})


def signal_to_noise(baked: Svbrdf, stored: Svbrdf, lobe_alone: bool = False) -> float:
    """SNR in dB of two SVBRDFs of the same size, over all their texels; HIGHEST_DB at most.

    Args:
        baked, stored: the baked SVBRDF, and the one that a picture holds; both are evaluated with the model of
            ``baked``.
        lobe_alone: compare normals and roughness, with a specular colour of 1 and nothing diffuse.
    """
    appearance = LobePyramid([baked])
    true, seen = _lobes(baked, lobe_alone), _lobes(stored, lobe_alone)
    if true.shape is not None:
        seen = seen._replace(shape=true.shape)
    true, seen = _repeated(true), _repeated(seen)
    count = len(true.normal)
    random = np.random.default_rng(0)
    view = _cosine_directions(random.random((count, 2)))
    u, by_true = random.random((count, 2)), (np.arange(count) % 2 == 0)[:, None]
    light = np.where(by_true, appearance.sample(true, view, u), appearance.sample(seen, view, u))
    density = 0.5 * (appearance.pdf(true, view, light) + appearance.pdf(seen, view, light))
    weight = (1.0 / np.maximum(density, 1e-12))[:, None]
    f = appearance.evaluate(true, view, light).astype(np.float64)
    g = appearance.evaluate(seen, view, light).astype(np.float64)
    signal, noise = float((weight * f * f).sum()), float((weight * np.square(f - g)).sum())
    if signal <= 0.0 or noise <= signal * 10.0 ** (-HIGHEST_DB / 10.0):
        return HIGHEST_DB
    return 10.0 * float(np.log10(signal / noise))


def degrees_between(one: NDArray, other: NDArray) -> NDArray:
    """Angles (...) in degrees between unit vectors (..., 3); precise also where they are small."""
    half = 0.5 * np.linalg.norm(one.astype(np.float64) - other, axis=-1)
    return np.degrees(2.0 * np.arcsin(np.minimum(half, 1.0)))


def _lobes(svbrdf: Svbrdf, lobe_alone: bool) -> Lobes:
    count = svbrdf.size[0] * svbrdf.size[1]
    specular, diffuse = svbrdf.specular.reshape(count, 3), svbrdf.diffuse.reshape(count, 3)
    if lobe_alone:
        specular, diffuse = np.ones_like(specular), np.zeros_like(diffuse)
    tensor = tensor_from_log(svbrdf.log_roughness).reshape(count, 3)
    shape = None if svbrdf.shape is None else svbrdf.shape.reshape(count)
    return Lobes(svbrdf.normal.reshape(count, 3), tensor, specular, diffuse, shape)


def _repeated(lobes: Lobes) -> Lobes:
    """Each lobe PAIRS times."""
    shape = None if lobes.shape is None else np.repeat(lobes.shape, PAIRS)
    normal, tensor, specular, diffuse = (np.repeat(each, PAIRS, axis=0) for each in lobes[:4])
    return Lobes(normal, tensor, specular, diffuse, shape)


def _cosine_directions(u: NDArray) -> NDArray:
    radius, angle = np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - u[:, 0])], axis=-1)
