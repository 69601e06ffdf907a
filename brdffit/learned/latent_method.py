"""The method ``latent``: encode the base once, filter its code linearly, decode every level."""

from __future__ import annotations

import math
import os
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from brdffit.fitting.status import KEPT
from brdffit.footprint import get_pixel_filter, iter_pyramid
from brdffit.halfangle.density import DENSITY_EXPONENTS
from brdffit.learned import asked
from brdffit.learned.asked import MOST_FACTOR, check_asked, level_of, tiny_base, told_of, weights_path
from brdffit.learned.kernels.gathering import diffuse_rows
from brdffit.learned.latent import (
    FACTOR,
    MODELS,
    NORMAL,
    SHARES,
    SHIPPED,
    TENSOR,
    decode_image,
    encode_image,
    lifted,
    load_networks,
)
from brdffit.methods import Level, LobeMethod, Material, Progress, Pyramid
from brdffit.options import LobeOptions, option
from brdffit.svbrdf import Svbrdf, level_sizes


@dataclass(frozen=True)
class LatentOptions(LobeOptions):
    """Options of the method ``latent``."""

    group: ClassVar[str] = "latent"

    specular: str = option(
        "free", "the network's scale of the lobe, or hold the filtered colour", names=("free", "held")
    )
    weights: str = option(asked.SHIPPED, "a file of `brdffit learn latent`, or those shipped")


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
        self.bake_lobes(tiny_base(), options)

    def trained(self, options: LatentOptions) -> str:
        """How its weights were made."""
        return told_of(load_networks(weights_path(options.weights, SHIPPED))[1])

    def bake_lobes(self, svbrdf: Svbrdf, options: LatentOptions, progress: Progress | None = None) -> Pyramid:
        """Encode the base once and decode every level.

        Raises:
            InputError: for another lobe model than the weights', or numbers that are not finite.
            UnknownNameError: for an unknown model or pixel filter.
        """
        notes = check_asked(self.name, svbrdf, options, MODELS)
        networks, _ = load_networks(weights_path(options.weights, SHIPPED))
        pyramid = Pyramid(self.name, options, [], notes)
        sizes = level_sizes(svbrdf.size, options.levels)
        pixel_filter = get_pixel_filter(options.pixel_filter)
        exponent = DENSITY_EXPONENTS[options.density]
        # The code at level 0 is not filtered: the decoder was trained to return lobes of filtered texels from it.
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
                    share = SHARES[mip_level] if mip_level < len(SHARES) else 1.0
                    said = decode_image(networks, here, pool, options.model, share)
                    level = Level(_decoded(said, filtered, svbrdf, options, exponent))
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
        specular = specular * np.exp(np.clip(said[..., FACTOR : FACTOR + 1], -MOST_FACTOR, MOST_FACTOR))
    diffuse = np.zeros((*size, 3), np.float32)
    if "diffuse 0" in filtered:
        moments = np.concatenate([filtered[f"diffuse {k}"] for k in range(3)], axis=2).reshape(-1, 9)
        diffuse_rows(moments.astype(np.float64), normal.reshape(-1, 3), exponent, diffuse.reshape(-1, 3))
    return level_of(normal, said[..., TENSOR], specular, diffuse, filtered, svbrdf, options)
