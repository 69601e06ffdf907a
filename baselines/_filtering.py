"""The common part of the baselines: channels are filtered linearly under the pixel filter, then finished by a formula.

All baselines average colours, occlusion and shape linearly. Each adds the channels that its tool stores and a formula
from their averages to the level's normal and roughness.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.footprint import get_pixel_filter, iter_pyramid
from brdffit.machine import core_count
from brdffit.methods import Level, LobeMethod, Progress, Pyramid
from brdffit.models import Model, get_model
from brdffit.options import LobeOptions
from brdffit.roughness import alpha_squared_from_perceptual, perceptual_from_log_tensor, tensor_from_log
from brdffit.svbrdf import LEAST_WEIGHT, Svbrdf, level_sizes

#: Rounding of averaged single-precision unit vectors, as a share of their squared length. It is subtracted from
#: variances, or a flat mirror (alpha^2 = 4e-6) would come out dull.
SINGLE_NOISE = 4.0 * float(np.finfo(np.float32).eps)

#: Texels of a block of rows that is worked on at once: its temporaries fit a core's cache.
BLOCK_TEXELS = 1 << 14

_UP = np.array([0.0, 0.0, 1.0], dtype=np.float32)


@dataclass(frozen=True)
class LevelContext:
    """The place of a level in the pyramid, and the bounds of its roughness.

    Attributes:
        mip_level: 0 is the finest.
        chain_length: levels of the full chain down to 1x1, even if fewer are baked.
        scale: base texels per texel of this level, (down, across).
        wrap: "tile" or "clamp".
        isotropic: whether the lobe must come out isotropic.
        least_alpha_squared: least alpha^2; the largest is 1.
    """

    mip_level: int
    chain_length: int
    scale: tuple[float, float]
    wrap: str
    isotropic: bool
    least_alpha_squared: float


class FilteringMethod(LobeMethod):
    """A method that filters channels and finishes each level by a closed form; subclasses define both."""

    #: Whether the tool leaves level 0 as authored, whatever the options say.
    leaves_level_0 = False

    def channels(self, svbrdf: Svbrdf, notes: list[str]) -> dict[str, NDArray]:
        """Channels to filter besides the colours: (H, W, C) float32 arrays by name. May add sentences to ``notes``."""
        raise NotImplementedError

    def finish(self, filtered: Mapping[str, NDArray], context: LevelContext) -> tuple[NDArray, NDArray]:
        """Unit normals and log roughness tensors, both (h, w, 3), from a block of rows of the filtered channels."""
        raise NotImplementedError

    def finish_level(
        self, filtered: Mapping[str, NDArray], context: LevelContext, pool: Executor
    ) -> tuple[NDArray, NDArray]:
        """``finish`` for a whole level, a block of rows at a time."""
        height, width = next(iter(filtered.values())).shape[:2]
        normal = np.empty((height, width, 3), dtype=np.float32)
        log_roughness = np.empty_like(normal)
        rows = max(1, BLOCK_TEXELS // width)

        def finish_rows(start: int) -> None:
            part = slice(start, start + rows)
            block = {name: image[part] for name, image in filtered.items()}
            normal[part], log_roughness[part] = self.finish(block, context)

        for _ in pool.map(finish_rows, range(0, height, rows)):
            pass
        return normal, log_roughness

    def bake_lobes(self, svbrdf: Svbrdf, options: LobeOptions, progress: Progress | None = None) -> Pyramid:
        """Bake ``svbrdf`` into a pyramid.

        Raises:
            brdffit.errors.InputError: when the method needs something that the SVBRDF lacks.
            brdffit.errors.UnknownNameError: for an unknown model or pixel filter.
        """
        # NumPy and SciPy release the GIL; blocks are independent, so the result does not depend on the threads.
        with ThreadPoolExecutor(options.threads or core_count()) as pool:
            return self._bake(svbrdf, options, progress, pool)

    def _bake(self, svbrdf: Svbrdf, options: LobeOptions, progress: Progress | None, pool: Executor) -> Pyramid:
        model, pixel_filter = get_model(options.model), get_pixel_filter(options.pixel_filter)
        started = time.perf_counter()
        notes: list[str] = []
        own = self.channels(svbrdf, notes)
        carried = _carried_channels(svbrdf, model)
        sizes = level_sizes(svbrdf.size, options.levels)
        kept = 1 if options.keep_level_0 or self.leaves_level_0 else 0
        # Normals, roughness and scalars are weighted by opacity; colours come weighted already.
        weight = None if svbrdf.opacity is None else svbrdf.opacity[..., None]
        scalars = {name: carried.pop(name) for name in ("occlusion", "shape") if name in carried}
        weighed = own | scalars
        if weight is not None:
            weighed = {name: image * weight for name, image in weighed.items()}
            carried["opacity"] = weight
        images = weighed | carried
        pyramids = [iter_pyramid(image, sizes[kept:], pixel_filter, svbrdf.wrap) for image in images.values()]
        levels: list[Level] = []
        for mip_level, (height, width) in enumerate(sizes):
            if mip_level < kept:
                level = svbrdf
            else:
                context = LevelContext(
                    mip_level=mip_level,
                    chain_length=len(level_sizes(svbrdf.size)),
                    scale=(svbrdf.size[0] / height, svbrdf.size[1] / width),
                    wrap=svbrdf.wrap,
                    isotropic=model.isotropic or options.lobe == "isotropic",
                    least_alpha_squared=options.min_roughness**4,
                )
                filtered = dict(zip(images, pool.map(next, pyramids), strict=True))
                if weight is not None:
                    share = np.maximum(filtered["opacity"], np.float32(LEAST_WEIGHT))
                    filtered |= {name: filtered[name] / share for name in weighed}
                normal, log_roughness = self.finish_level({name: filtered[name] for name in own}, context, pool)
                colours: dict[str, Any] = {name: _in_range(name, filtered[name]) for name in scalars | carried}
                level = Svbrdf(normal, log_roughness, wrap=svbrdf.wrap, **colours)
                level.alpha, level.cutoff = svbrdf.alpha, svbrdf.cutoff
            levels.append(Level(_relabelled(level, model), seconds=time.perf_counter() - started))
            started = time.perf_counter()
            if progress is not None:
                progress(mip_level, height * width, height * width)
        return Pyramid(self.name, options, levels, notes)


def _carried_channels(svbrdf: Svbrdf, model: Model) -> dict[str, NDArray]:
    """Channels that every baseline averages linearly: colours, and occlusion and shape where there are any."""
    channels = {"specular": svbrdf.specular, "diffuse": svbrdf.diffuse}
    if svbrdf.occlusion is not None:
        channels["occlusion"] = svbrdf.occlusion[..., None]
    if svbrdf.shape is not None and model.shape_bounds is not None:
        channels["shape"] = svbrdf.shape[..., None]
    return channels


def _in_range(name: str, image: NDArray) -> NDArray:
    """Colours clamped to 0 (Mitchell's filter has negative weights); scalars as (h, w), occlusion in [0, 1]."""
    if name in ("specular", "diffuse"):
        return np.maximum(image, 0.0)
    return np.clip(image[..., 0], 0.0, 1.0) if name == "occlusion" else image[..., 0]


def _relabelled(svbrdf: Svbrdf, model: Model) -> Svbrdf:
    """``svbrdf`` as a level of ``model``: with a shape where the model has one, and without the height."""
    shape = None
    if model.shape_bounds is not None:
        default = np.full(svbrdf.size, model.default_shape, dtype=np.float32)
        shape = default if svbrdf.shape is None else svbrdf.shape
    return svbrdf.replace(model=model.name, shape=shape, height=None)


def is_isotropic(svbrdf: Svbrdf) -> bool:
    """Whether every lobe is exactly isotropic."""
    log_tensor = svbrdf.log_roughness
    return not log_tensor[..., 2].any() and np.array_equal(log_tensor[..., 0], log_tensor[..., 1])


def roughness_channels(svbrdf: Svbrdf) -> NDArray:
    """Perceptual roughness and, where lobes are anisotropic, the deviator of the log tensor: (H, W, 1 or 3).

    A tool that averages a roughness map and an anisotropy map averages these.
    """
    log_tensor = svbrdf.log_roughness
    perceptual = perceptual_from_log_tensor(log_tensor)
    if is_isotropic(svbrdf):
        return perceptual[..., None]
    half_difference = 0.5 * (log_tensor[..., 0] - log_tensor[..., 1])
    return np.stack([perceptual, half_difference, log_tensor[..., 2]], axis=-1)


def mean_alpha_squared(filtered: NDArray, context: LevelContext) -> NDArray:
    """alpha^2 of the averaged perceptual roughness (filtered ``roughness_channels``), at or above the floor."""
    return np.maximum(alpha_squared_from_perceptual(np.maximum(filtered[..., 0], 0.0)), context.least_alpha_squared)


def log_tensor_of(alpha_squared: NDArray, filtered: NDArray, context: LevelContext) -> NDArray:
    """Log tensor (..., 3) with sqrt(det) = ``alpha_squared`` and the averaged deviator of ``roughness_channels``.

    Eigenvalues are held between the floor and 1.
    """
    mean = np.log(np.clip(alpha_squared, context.least_alpha_squared, 1.0))
    if context.isotropic or filtered.shape[-1] == 1:
        return np.stack([mean, mean, np.zeros_like(mean)], axis=-1)
    half, off = filtered[..., 1], filtered[..., 2]
    radius = np.hypot(half, off)
    least = np.log(context.least_alpha_squared)
    major, minor = np.clip(mean + radius, least, 0.0), np.clip(mean - radius, least, 0.0)
    mean = 0.5 * (major + minor)
    shrink = 0.5 * (major - minor) / np.where(radius > 0, radius, 1.0)
    return np.stack([mean + shrink * half, mean - shrink * half, shrink * off], axis=-1)


def log_of_bounded_tensor(tensor: NDArray, context: LevelContext) -> NDArray:
    """Log tensor (..., 3) of Sigma (..., 3) as (XX, YY, XY), float64, eigenvalues held between the floor and 1.

    Sigma may be indefinite (Mitchell's negative weights). If the context is isotropic, the lobe keeps the determinant.
    """
    mean, half = 0.5 * (tensor[..., 0] + tensor[..., 1]), 0.5 * (tensor[..., 0] - tensor[..., 1])
    off = tensor[..., 2]
    radius = np.sqrt(half * half + off * off)
    # Eigenvalues in double precision, since mean - radius cancels; single precision suffices for their logarithms.
    major = np.log(np.clip(mean + radius, context.least_alpha_squared, 1.0).astype(np.float32))
    minor = np.log(np.clip(mean - radius, context.least_alpha_squared, 1.0).astype(np.float32))
    log_mean = np.float32(0.5) * (major + minor)
    out = np.empty(tensor.shape, dtype=np.float32)
    if context.isotropic:
        out[..., 0] = out[..., 1] = log_mean
        out[..., 2] = 0.0
        return out
    quotient = 0.5 * (major - minor) / np.maximum(radius, np.finfo(np.float64).tiny)
    half *= quotient
    np.add(log_mean, half, out=out[..., 0], casting="same_kind")
    np.subtract(log_mean, half, out=out[..., 1], casting="same_kind")
    np.multiply(quotient, off, out=out[..., 2], casting="same_kind")
    return out


def unit_normal_and_length(mean_normal: NDArray) -> tuple[NDArray, NDArray]:
    """Unit mean normals (..., 3), z where the mean is 0, and the length r (...) of the mean in [0, 1], 1 within
    rounding."""
    squared = np.einsum("...i,...i->...", mean_normal, mean_normal)
    length = np.sqrt(squared)
    some = length > 1e-6
    normal = np.where(some[..., None], mean_normal / np.where(some, length, 1.0)[..., None], _UP)
    variance = np.maximum(1.0 - squared - SINGLE_NOISE, 0.0) / (1.0 - SINGLE_NOISE)
    return normal, np.sqrt(np.maximum(1.0 - variance, 0.0))


def tensor_channels(svbrdf: Svbrdf) -> NDArray:
    """The roughness tensor (H, W, 3) as (XX, YY, XY), or alpha^2 (H, W, 1) where every lobe is isotropic."""
    if is_isotropic(svbrdf):
        return np.exp(svbrdf.log_roughness[..., :1])
    return tensor_from_log(svbrdf.log_roughness)


def with_three_channels(tensor: NDArray) -> NDArray:
    """Filtered ``tensor_channels`` as (..., 3) float64, a copy."""
    if tensor.shape[-1] == 3:
        return tensor.astype(np.float64)
    out = np.zeros((*tensor.shape[:-1], 3))
    out[..., :2] = tensor
    return out
