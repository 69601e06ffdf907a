"""The method ``mipnet``: each texel is predicted from four texels of the level before; colours are averaged."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from brdffit.fitting.status import KEPT
from brdffit.footprint import get_pixel_filter, iter_pyramid
from brdffit.learned import asked
from brdffit.learned.asked import check_asked, level_of, told_of, weights_path
from brdffit.learned.latent import lifted
from brdffit.learned.mipnet import SHIPPED, TEXEL, MipNetwork, load_mipnet, taken
from brdffit.learned.mipnet_training import texels_of
from brdffit.methods import Level, LobeMethod, Material, Progress, Pyramid
from brdffit.options import LobeOptions, option
from brdffit.svbrdf import Svbrdf, level_sizes

_ROWS = 8192


@dataclass(frozen=True)
class MipnetOptions(LobeOptions):
    """Options of the method ``mipnet``."""

    group: ClassVar[str] = "mipnet"

    weights: str = option(asked.SHIPPED, "a file of `brdffit learn mipnet`, or those shipped")


class Mipnet(LobeMethod):
    """A network from four texels to one, after Gauthier et al. 2022; as theirs, it does not filter level 0."""

    name = "mipnet"
    summary = "normals and roughness of a level by a network from the level before (after MIPNet, Gauthier et al. 2022)"
    options = MipnetOptions

    def prepare(self, material: Material, options: MipnetOptions) -> None:
        """Compile, and read the weights.

        Raises:
            InputError: for a file that holds no weights of this method.
        """
        network, _ = load_mipnet(weights_path(options.weights, SHIPPED))
        network.forward(np.zeros((1, 4, TEXEL)))

    def trained(self, options: MipnetOptions) -> str:
        """How its weights were made."""
        return told_of(load_mipnet(weights_path(options.weights, SHIPPED))[1])

    def bake_lobes(self, svbrdf: Svbrdf, options: MipnetOptions, progress: Progress | None = None) -> Pyramid:
        """Predict every level from the one before.

        Raises:
            InputError: for another lobe model than the weights', or numbers that are not finite.
            UnknownNameError: for an unknown model or pixel filter.
        """
        pyramid = Pyramid(self.name, options, [], check_asked(self.name, svbrdf, options, ("ggx",)))
        network, _ = load_mipnet(weights_path(options.weights, SHIPPED))
        sizes, pixel_filter = level_sizes(svbrdf.size, options.levels), get_pixel_filter(options.pixel_filter)
        image = texels_of(svbrdf.normal, svbrdf.log_roughness)
        colours = {"specular": svbrdf.specular, "diffuse": svbrdf.diffuse}
        if svbrdf.occlusion is not None:
            colours["occlusion"] = svbrdf.occlusion[..., None]
        started = time.perf_counter()
        with ThreadPoolExecutor(options.threads or os.cpu_count()) as pool:
            pyramids = [iter_pyramid(each, sizes[1:], pixel_filter, svbrdf.wrap) for each in colours.values()]
            for mip_level, (height, width) in enumerate(sizes):
                if mip_level == 0:
                    level = Level(svbrdf.replace(height=None), status=np.full((height, width), KEPT, np.uint8))
                else:
                    image = _said(network, taken(image, (height, width)), pool).reshape(height, width, TEXEL)
                    filtered = dict(zip(colours, pool.map(next, pyramids), strict=True))
                    specular, diffuse = (np.maximum(filtered[name], 0.0) for name in ("specular", "diffuse"))
                    normal, tensor = lifted(image[..., :2]), image[..., 2:]
                    level = Level(level_of(normal, tensor, specular, diffuse, filtered, svbrdf, options))
                level.seconds = time.perf_counter() - started
                started = time.perf_counter()
                pyramid.levels.append(level)
                if progress is not None:
                    progress(mip_level, height * width, height * width)
        return pyramid


def _said(network: MipNetwork, four: NDArray, pool: ThreadPoolExecutor) -> NDArray:
    """Texels (n, TEXEL) predicted from four each (n, 4, TEXEL), on all threads."""
    out = np.empty((len(four), TEXEL))

    def work(first: int) -> None:
        out[first : first + _ROWS] = network.forward(four[first : first + _ROWS])[0]

    for _ in pool.map(work, range(0, len(four), _ROWS)):
        pass
    return out
