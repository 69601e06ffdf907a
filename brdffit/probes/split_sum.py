"""The table of the split sum: scale and bias of F0 over (n.v, roughness), and the error of the split itself.

For GGX with height-correlated Smith masking and Schlick's Fresnel (Karis 2013; Lagarde and de Rousiers 2014):
(scale, bias) = E[(1 - F) W], E[F W] with F = (1 - v.h)^5 and W = 4 V (n.l) (v.h) / (n.h) over half vectors drawn from
D (n.h). At n.v = 1 and alpha = 1 their sum is 1 - ln 2.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from brdffit.probes.cubemap import halved, look_up_trilinear, resized
from brdffit.probes.lobe import half_angles
from brdffit.probes.lookup import random_directions
from brdffit.probes.tree import Tree, tau_for
from brdffit.roughness import alpha_from_perceptual

_RADIAL, _AROUND = 96, 48


def scale_and_bias(cosine: NDArray, alpha: float) -> NDArray:
    """(..., 2) scale and bias at n.v = ``cosine`` (...), by Gauss-Legendre points in the distribution function of D."""
    node, weight = np.polynomial.legendre.leggauss(_RADIAL)
    turn, share = np.polynomial.legendre.leggauss(_AROUND)
    u = 0.5 * (node + 1.0)
    # Nodes gather at grazing half vectors, where masking changes fastest.
    u, weight = 1.0 - (1.0 - u) ** 2, 0.5 * weight * 2.0 * (1.0 - u)
    azimuth, share = 0.5 * np.pi * (turn + 1.0), 0.5 * share
    cos_h = np.sqrt((1.0 - u) / (1.0 + (alpha * alpha - 1.0) * u))[:, None]
    sin_h = np.sqrt(np.maximum(1.0 - cos_h**2, 0.0))
    nv = np.maximum(np.asarray(cosine, np.float64), 1e-4)[..., None, None]
    sin_v = np.sqrt(np.maximum(1.0 - nv * nv, 0.0))
    vh = np.maximum(sin_v * sin_h * np.cos(azimuth) + nv * cos_h, 0.0)
    nl = np.maximum(2.0 * vh * cos_h - nv, 0.0)
    value = _weight(nv, nl, vh, cos_h, alpha) * weight[:, None] * share
    fresnel = (1.0 - vh) ** 5
    return np.stack([((1.0 - fresnel) * value).sum(axis=(-1, -2)), (fresnel * value).sum(axis=(-1, -2))], axis=-1)


def _weight(nv: NDArray | float, nl: NDArray, vh: NDArray, nh: NDArray, alpha: float) -> NDArray:
    """W of the cosines n.v, n.l, v.h and n.h."""
    square = alpha * alpha
    lit = nl * np.sqrt(square + (1.0 - square) * nv * nv) + nv * np.sqrt(square + (1.0 - square) * nl * nl)
    visibility = 0.5 / np.maximum(lit, 1e-12)
    return 4.0 * visibility * nl * vh / nh


@lru_cache(maxsize=2)
def dfg_table(size: int = 64) -> NDArray:
    """(size, size, 2) float32 scale and bias: columns n.v, rows perceptual roughness, at (k + 1/2)/size; read only."""
    at = (np.arange(size) + 0.5) / size
    alphas = np.maximum(alpha_from_perceptual(at), 1e-4).tolist()
    table = np.stack([scale_and_bias(at, alpha) for alpha in alphas]).astype(np.float32)
    table.setflags(write=False)
    return table


def split_errors(cubes: list[NDArray], count: int, threads: int = 1) -> dict[str, list]:
    """Relative L1 of the split sum against the true integral, over ``count`` random viewers, for F0 = 1.

    The truth is E[L(l) W] over half vectors drawn from D (n.h); the radiance of each sample is read from a box-filtered
    pyramid at the level of its solid angle. The split sum is radiance filtered by K around the mirrored direction,
    times E[W].

    Returns:
        "roughness" and "cosines" (n.v) that were measured, and "errors", a row for each roughness, averaged over cubes.
    """
    cosines, roughnesses, samples = (0.95, 0.7, 0.4, 0.2), (0.2, 0.6, 1.0), 512
    index = np.arange(samples)
    u, turn = (index + 0.5) / samples, 2.0 * np.pi * (index * 0.6180339887498949 % 1.0)
    normal = random_directions(count, 7)
    side = np.cross(normal, random_directions(count, 8))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    frame = np.stack([side, np.cross(normal, side), normal])
    errors = np.zeros((len(roughnesses), len(cosines)))
    for cube in cubes:
        chain, tree = [resized(cube, min(cube.shape[1], 128))], Tree(cube)
        while chain[-1].shape[1] > 1:
            chain.append(halved(chain[-1]))
        texel = 4.0 * np.pi / (6 * chain[0].shape[1] ** 2)
        for a, roughness in enumerate(roughnesses):
            alpha = float(alpha_from_perceptual(np.asarray(roughness)))
            angle, density = half_angles(u, alpha)
            half = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=1)
            for b, nv in enumerate(cosines):
                view = np.array([np.sqrt(1.0 - nv * nv), 0.0, nv])
                vh, nh = half @ view, half[:, 2]
                light = 2.0 * vh[:, None] * half - view
                above = (light[:, 2] > 0.0) & (vh > 0.0)
                weight = np.where(above, _weight(nv, np.maximum(light[:, 2], 0.0), vh, nh, alpha), 0.0) / samples
                # A sample stands for 4 v.h / (N D n.h) of solid angle.
                angle_of_sample = 4.0 * np.maximum(vh, 1e-3) / (samples * density * nh)
                level = 0.5 * np.log2(np.maximum(angle_of_sample / texel, 1.0))
                true = np.zeros((count, 3))
                for k in np.flatnonzero(above):
                    at = np.tensordot(light[k], frame, 1)
                    true += weight[k] * look_up_trilinear(chain, at, np.full(count, level[k]))
                mirrored = np.tensordot([-view[0], 0.0, nv], frame, 1)
                split = tree.filtered(mirrored, alpha, tau_for(0.005), threads) * weight.sum()
                errors[a, b] += np.abs(split - true).sum() / true.sum() / len(cubes)
    return {"roughness": list(roughnesses), "cosines": list(cosines), "errors": errors.round(4).tolist()}
