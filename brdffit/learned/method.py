"""The methods ``learned`` and ``latent``: a network says at once what the fit would search for."""

from __future__ import annotations

import dataclasses
import math
import os
import time
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.fitting.batch import ModelKernels, Output, fit_texels, fitting_kernel, make_output, model_kernels
from brdffit.fitting.method import level_rules, search_settings
from brdffit.fitting.options import QUALITIES, FitOptions
from brdffit.fitting.presets import get_quality
from brdffit.fitting.status import CLOSED_FORM, KEPT, NO_SPECULAR
from brdffit.footprint import filter_channels, get_pixel_filter, iter_pyramid
from brdffit.halfangle.apparent_lobe import Base, base_of
from brdffit.halfangle.density import DENSITY_EXPONENTS
from brdffit.learned.gathering import Gathered, diffuse_rows, gather, pooled
from brdffit.learned.latent import (
    FACTOR,
    NORMAL,
    TENSOR,
    decode_image,
    encode_image,
    lifted,
    load_networks,
)
from brdffit.learned.latent import SHIPPED as LATENT
from brdffit.learned.network import SHIPPED as LEARNED
from brdffit.learned.network import load_network
from brdffit.methods import Level, LobeMethod, Material, Progress, Pyramid
from brdffit.models import get_model
from brdffit.options import LobeOptions, option
from brdffit.svbrdf import Svbrdf, level_sizes

_MODEL = "ggx"
#: Of the option ``weights``: those that the program ships.
_SHIPPED = "shipped"
_TEXELS_PER_PIECE = 8192
#: Levels of no more texels keep their moments, of which the next are made: 400 bytes a texel.
_MOST_KEPT = 1 << 18
#: Scales are never corrected by more than this factor's log.
_MOST_FACTOR = 2.0


@dataclass(frozen=True)
class LatentOptions(LobeOptions):
    """Options of the method ``latent``."""

    group: ClassVar[str] = "latent"

    specular: str = option(
        "free", "the network's scale of the lobe, or hold the filtered colour", names=("free", "held")
    )
    weights: str = option(_SHIPPED, "a file of `brdffit learn latent`, or those shipped")


@dataclass(frozen=True)
class LearnedOptions(LobeOptions):
    """Options of the method ``learned``."""

    group: ClassVar[str] = "learned"

    specular: str = option(
        "free", "the network's scale of the lobe, or hold the filtered colour", names=("free", "held")
    )
    quality: str = option("standard", "of the fit of texels unlike all training", names=QUALITIES)
    weights: str = option(_SHIPPED, "a file of `brdffit learn learned`, or those shipped")


def check_asked(name: str, svbrdf: Svbrdf, options: LobeOptions) -> list[str]:
    """Notes on what the networks were not trained for.

    Raises:
        InputError: for another lobe model, or numbers that are not finite.
    """
    for model in (svbrdf.model, options.model):
        if model != _MODEL:
            raise InputError(f"The weights of method '{name}' are for the lobe model '{_MODEL}', not for '{model}'.")
    if not svbrdf.is_finite():
        raise InputError("The SVBRDF holds numbers that are not finite; every texel must be a finite number.")
    notes = []
    if options.pixel_filter != "box":
        notes.append(f"The networks of method '{name}' were trained with the box filter, not '{options.pixel_filter}'.")
    if options.density != "cosine":
        notes.append(f"The networks of method '{name}' were trained for cosine-distributed lights and viewers.")
    return notes


def bounded(tensor: NDArray, options: LobeOptions) -> NDArray:
    """Log tensors (n, 3) with eigenvalues between the roughness floor and 1; of round lobes if these are asked for."""
    low = 4.0 * math.log(options.min_roughness)
    mean, half, off = 0.5 * (tensor[:, 0] + tensor[:, 1]), 0.5 * (tensor[:, 0] - tensor[:, 1]), tensor[:, 2]
    if options.lobe == "isotropic":
        half, off = np.zeros_like(half), np.zeros_like(off)
    radius = np.hypot(half, off)
    major, minor = np.clip(mean + radius, low, 0.0), np.clip(mean - radius, low, 0.0)
    mean, shrink = 0.5 * (major + minor), 0.5 * (major - minor) / np.where(radius > 0.0, radius, 1.0)
    return np.stack([mean + shrink * half, mean - shrink * half, shrink * off], axis=1)


def _weights(name: str, shipped: Path) -> Path:
    return shipped if name == _SHIPPED else Path(name)


def _fit_options(options: LearnedOptions) -> FitOptions:
    """The same options as the fit has them; the network knows point lights alone, so its fits do too."""
    ours = dataclasses.asdict(options)
    same = {each.name: ours[each.name] for each in dataclasses.fields(FitOptions) if each.name in ours}
    return FitOptions(**{"lights": "point", **same})


class Learned(LobeMethod):
    """Closed form plus a network's correction; what training did not cover is fitted."""

    name = "learned"
    summary = "closed form and a network's correction of it; texels unlike all training are fitted"
    options = LearnedOptions

    def prepare(self, material: Material, options: LearnedOptions) -> None:
        """Compile, and read the weights.

        Raises:
            InputError: for a file that holds no weights of this method.
        """
        fitting_kernel(32)
        model_kernels(_MODEL, _MODEL)
        flat = np.zeros((1, 1, 3), np.float32)
        tiny = Svbrdf(flat + np.array([0, 0, 1], np.float32), flat - 1.0, flat + 0.5, flat + 0.5)
        self.bake_lobes(tiny, dataclasses.replace(options, model=_MODEL))

    def bake_lobes(self, svbrdf: Svbrdf, options: LearnedOptions, progress: Progress | None = None) -> Pyramid:
        """Say every level from the moments of its footprints.

        Raises:
            InputError: for another lobe model than the weights', or numbers that are not finite.
            UnknownNameError: for an unknown model, pixel filter or quality.
        """
        notes = check_asked(self.name, svbrdf, options)
        base, model = base_of(svbrdf), get_model(_MODEL)
        search = search_settings(_fit_options(options), get_quality(options.quality), base, model, model)
        kernels = model_kernels(_MODEL, _MODEL)
        pyramid = Pyramid(self.name, options, [], notes)
        fitted, sizes = 0, level_sizes(svbrdf.size, options.levels)
        found: Gathered | None = None
        with ThreadPoolExecutor(options.threads or os.cpu_count()) as pool:
            for mip_level, size in enumerate(sizes):
                started = time.perf_counter()
                if mip_level == 0 and options.keep_level_0:
                    level = Level(svbrdf.replace(height=None), status=np.full(size, KEPT, np.uint8))
                else:
                    finer = sizes[mip_level - 1] if mip_level else size
                    nested = found is not None and finer == (2 * size[0], 2 * size[1]) and options.pixel_filter == "box"
                    known = pooled(found, finer) if nested and found is not None else None
                    level, count, found = _level(
                        base, svbrdf, options, search, kernels, mip_level, size, known, pool, progress
                    )
                    fitted += count
                level.seconds = time.perf_counter() - started
                pyramid.levels.append(level)
        texels = sum(math.prod(level.svbrdf.size) for level in pyramid.levels)
        if fitted:
            pyramid.notes.append(
                f"{fitted} of {texels} texels ({100.0 * fitted / texels:.1f}%) are unlike what the network was trained "
                "on; they were fitted."
            )
        return pyramid


def _level(
    base: Base, svbrdf: Svbrdf, options: LearnedOptions, search: Any, kernels: ModelKernels, mip_level: int,
    size: tuple[int, int], known: Gathered | None, pool: Executor, progress: Progress | None,
) -> tuple[Level, int, Gathered | None]:  # fmt: skip
    """One level, how many of its texels were fitted, and the moments of the level unless it is too large to keep them.

    ``known``: its moments, if they were made of the level before.
    """
    network, _ = load_network(_weights(options.weights, LEARNED))
    pixel_filter = get_pixel_filter(options.pixel_filter)
    gathered = level_rules(pixel_filter, svbrdf.size, size, mip_level, get_quality("draft"))
    rules = level_rules(pixel_filter, svbrdf.size, size, mip_level, get_quality(options.quality))
    texels = size[0] * size[1]
    output = make_output(texels)
    kept = known if known is not None or texels > _MOST_KEPT else Gathered.empty(texels)
    counts = []

    def work(first: int) -> None:
        index = np.arange(first, min(first + _TEXELS_PER_PIECE, texels))
        part = Output(*(array[first : first + len(index)] for array in output))
        columns, rows = index % size[1], index // size[1]
        here = slice(first, first + len(index))
        if known is not None:
            found = known.rows(here)
        else:
            found = gather(base, gathered.strata, gathered.room, columns, rows)
            if kept is not None:
                for whole, piece in zip(kept.rows(here), found, strict=True):
                    whole[:] = piece
        said = network.predict(found.moments)
        normal = np.concatenate([-said.theta[:, :2], np.ones((len(index), 1))], axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        part.normal[:] = normal
        part.log_roughness[:] = bounded(said.theta[:, 2:], options)
        factor = 1.0 if options.specular == "held" else said.factor[:, None]
        part.specular[:] = found.colour * factor * found.some[:, None]
        if base.has_diffuse:
            diffuse_rows(found.diffuse, normal, DENSITY_EXPONENTS[options.density], part.diffuse)
        part.status[:] = np.where(found.some, CLOSED_FORM, NO_SPECULAR)
        strange = np.flatnonzero(~said.covered & found.some)
        if len(strange):
            fresh = make_output(len(strange))
            fit_texels(base, rules, columns[strange], rows[strange], search, fresh, kernels)
            for mine, theirs in zip(part, fresh, strict=True):
                mine[strange] = theirs
        counts.append(len(strange))
        if progress is not None:
            progress(mip_level, min(first + len(index), texels), texels)

    for _ in pool.map(work, range(0, texels, _TEXELS_PER_PIECE)):
        pass
    return Level(_image_of(output, size, svbrdf, options), output.status.reshape(size)), sum(counts), kept


def _image_of(output: Output, size: tuple[int, int], svbrdf: Svbrdf, options: LobeOptions) -> Svbrdf:
    """A level of flat outputs; occlusion is averaged."""
    occlusion = svbrdf.occlusion
    if occlusion is not None:
        chosen = get_pixel_filter(options.pixel_filter)
        occlusion = np.clip(filter_channels(occlusion[..., None], size, chosen, svbrdf.wrap)[..., 0], 0.0, 1.0)
    return Svbrdf(
        normal=output.normal.reshape(*size, 3), log_roughness=output.log_roughness.reshape(*size, 3),
        specular=output.specular.reshape(*size, 3), diffuse=output.diffuse.reshape(*size, 3), model=_MODEL,
        wrap=svbrdf.wrap, occlusion=occlusion,
    )  # fmt: skip


class Latent(LobeMethod):
    """Kemppinen et al. 2023: encode, filter the code linearly, decode every level."""

    name = "latent"
    summary = "encoder, linear filtering of a learned code, decoder (Kemppinen et al. 2023)"
    options = LatentOptions

    def prepare(self, material: Material, options: LatentOptions) -> None:
        """Compile, and read the weights.

        Raises:
            InputError: for a file that holds no weights of this method.
        """
        flat = np.zeros((1, 1, 3), np.float32)
        tiny = Svbrdf(flat + np.array([0, 0, 1], np.float32), flat - 1.0, flat + 0.5, flat + 0.5)
        self.bake_lobes(tiny, dataclasses.replace(options, model=_MODEL))

    def bake_lobes(self, svbrdf: Svbrdf, options: LatentOptions, progress: Progress | None = None) -> Pyramid:
        """Encode the base once and decode every level.

        Raises:
            InputError: for another lobe model than the weights', or numbers that are not finite.
            UnknownNameError: for an unknown model or pixel filter.
        """
        notes = check_asked(self.name, svbrdf, options)
        networks, _ = load_networks(_weights(options.weights, LATENT))
        pyramid = Pyramid(self.name, options, [], notes)
        sizes = level_sizes(svbrdf.size, options.levels)
        pixel_filter = get_pixel_filter(options.pixel_filter)
        exponent = DENSITY_EXPONENTS[options.density]
        # Level 0 of the code is filtered already: the encoder was trained so.
        images = {"specular": svbrdf.specular}
        if svbrdf.diffuse.any():
            images |= {f"diffuse {k}": svbrdf.diffuse[..., k : k + 1] * svbrdf.normal for k in range(3)}
        if svbrdf.occlusion is not None:
            images["occlusion"] = svbrdf.occlusion[..., None]
        with ThreadPoolExecutor(options.threads or os.cpu_count()) as pool:
            started = time.perf_counter()
            code = encode_image(networks, svbrdf, pool)
            codes = iter_pyramid(code, sizes[1:], pixel_filter, svbrdf.wrap)
            pyramids = {name: iter_pyramid(image, sizes, pixel_filter, svbrdf.wrap) for name, image in images.items()}
            for mip_level, size in enumerate(sizes):
                here = code if mip_level == 0 else next(codes)
                filtered = dict(zip(pyramids, pool.map(next, pyramids.values()), strict=True))
                if mip_level == 0 and options.keep_level_0:
                    level = Level(svbrdf.replace(height=None), status=np.full(size, KEPT, np.uint8))
                else:
                    level = Level(_decoded(decode_image(networks, here, pool), filtered, svbrdf, options, exponent))
                level.seconds = time.perf_counter() - started
                started = time.perf_counter()
                pyramid.levels.append(level)
                if progress is not None:
                    progress(mip_level, math.prod(size), math.prod(size))
        return pyramid


def _decoded(
    said: NDArray, filtered: dict[str, NDArray], svbrdf: Svbrdf, options: LatentOptions, exponent: int
) -> Svbrdf:
    """A level of the decoder's outputs (h, w, OUTPUTS) and filtered colours."""
    size = said.shape[:2]
    normal = lifted(said[..., NORMAL])
    specular = np.maximum(filtered["specular"], 0.0)
    if options.specular != "held":
        specular = specular * np.exp(np.clip(said[..., FACTOR : FACTOR + 1], -_MOST_FACTOR, _MOST_FACTOR))
    diffuse = np.zeros((*size, 3), np.float32)
    if "diffuse 0" in filtered:
        moments = np.concatenate([filtered[f"diffuse {k}"] for k in range(3)], axis=2).reshape(-1, 9)
        diffuse_rows(moments.astype(np.float64), normal.reshape(-1, 3), exponent, diffuse.reshape(-1, 3))
    occlusion = filtered.get("occlusion")
    return Svbrdf(
        normal=normal.astype(np.float32),
        log_roughness=bounded(said[..., TENSOR].reshape(-1, 3), options).reshape(*size, 3).astype(np.float32),
        specular=specular.astype(np.float32), diffuse=diffuse, model=_MODEL, wrap=svbrdf.wrap,
        occlusion=None if occlusion is None else np.clip(occlusion[..., 0], 0.0, 1.0),
    )  # fmt: skip
