"""Levels that no pixel reads: each channel is averaged by itself, as the naive baseline does, at hardly any cost."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from brdffit.fitting.options import FitOptions
from brdffit.footprint import get_pixel_filter, iter_pyramid
from brdffit.models import Model
from brdffit.roughness import perceptual_from_log_tensor
from brdffit.svbrdf import LEAST_WEIGHT, Svbrdf


def averaged_levels(
    svbrdf: Svbrdf, sizes: Sequence[tuple[int, int]], options: FitOptions, target: Model
) -> Iterator[Svbrdf]:
    """Yield levels of these sizes, finest first, with colours, occlusion, perceptual roughness and normals averaged.

    Mean normals are made unit length again. The spread of the normals is lost, and roughness is not weighted by the
    energy that each texel reflects.
    """
    own = {"normal": svbrdf.normal, "roughness": _roughness(svbrdf)}
    if svbrdf.occlusion is not None:
        own["occlusion"] = svbrdf.occlusion[..., None]
    if svbrdf.shape is not None and target.shape_bounds:
        own["shape"] = svbrdf.shape[..., None]
    weight = None if svbrdf.opacity is None else svbrdf.opacity[..., None]
    images = {name: image if weight is None else image * weight for name, image in own.items()}
    images |= {"specular": svbrdf.specular} | ({} if weight is None else {"opacity": weight})
    if svbrdf.diffuse.any():
        images["diffuse"] = svbrdf.diffuse
    pixel_filter = get_pixel_filter(options.pixel_filter)
    pyramids = [iter_pyramid(image, sizes, pixel_filter, svbrdf.wrap) for image in images.values()]
    for size in sizes:
        found = {name: next(pyramid) for name, pyramid in zip(images, pyramids, strict=True)}
        if weight is not None:
            found |= {name: found[name] / np.maximum(found["opacity"], LEAST_WEIGHT) for name in own}
        shape = None
        if target.shape_bounds:
            shape = found["shape"][..., 0] if "shape" in found else np.full(size, target.default_shape, np.float32)
        occlusion = found.get("occlusion")
        # Mitchell's negative weights can leave colours below 0 and occlusion out of its range.
        yield Svbrdf(
            normal=_unit(found["normal"]),
            log_roughness=_log_tensor(found["roughness"], options, target),
            specular=np.maximum(found["specular"], 0.0),
            diffuse=np.maximum(found["diffuse"], 0.0) if "diffuse" in found else np.zeros((*size, 3), np.float32),
            model=target.name,
            wrap=svbrdf.wrap,
            shape=shape,
            occlusion=None if occlusion is None else np.clip(occlusion[..., 0], 0.0, 1.0),
            opacity=found["opacity"][..., 0] if weight is not None else None,
            alpha=svbrdf.alpha,
            cutoff=svbrdf.cutoff,
        )


def _roughness(svbrdf: Svbrdf) -> NDArray:
    """Perceptual roughness and the deviator of the log tensor (H, W, 3), or (H, W, 1) where the deviator is 0."""
    a, b, c = np.moveaxis(svbrdf.log_roughness, 2, 0)
    perceptual = perceptual_from_log_tensor(svbrdf.log_roughness)
    if np.array_equal(a, b) and not c.any():
        return perceptual[..., None]
    return np.stack([perceptual, 0.5 * (a - b), c], axis=2)


def _log_tensor(roughness: NDArray, options: FitOptions, target: Model) -> NDArray:
    """Log tensors (h, w, 3) of averaged ``_roughness``; eigenvalues of Sigma lie between the roughness floor and 1."""
    lowest = 4.0 * np.log(options.min_roughness)
    mean = np.clip(4.0 * np.log(np.maximum(roughness[..., 0], 1e-6)), lowest, 0.0)
    if roughness.shape[2] == 1 or options.lobe == "isotropic" or target.isotropic:
        return np.stack([mean, mean, np.zeros_like(mean)], axis=2).astype(np.float32)
    half, off = roughness[..., 1], roughness[..., 2]
    radius = np.hypot(half, off)
    major, minor = np.clip(mean + radius, lowest, 0.0), np.clip(mean - radius, lowest, 0.0)
    mean, shrink = 0.5 * (major + minor), 0.5 * (major - minor) / np.where(radius > 0.0, radius, 1.0)
    return np.stack([mean + shrink * half, mean - shrink * half, shrink * off], axis=2).astype(np.float32)


def _unit(mean: NDArray) -> NDArray:
    """Unit normals (h, w, 3) of mean normals; (0, 0, 1) where opposite normals cancel."""
    length = np.linalg.norm(mean, axis=2, keepdims=True)
    some = length > 1e-6
    return np.where(some, mean / np.where(some, length, 1.0), np.array([0.0, 0.0, 1.0], np.float32))
