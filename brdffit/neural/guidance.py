"""Parallax, frames and colours that a traced surface gives to a neural material.

A material that learns from colours alone finds these late or not at all. The glints of a sharp lobe move the offset and
the frames at random, since Adam changes a parameter by about its rate in every step, however uncertain the gradient;
and a wrong hue adds little to the loss. A traced surface has a height, normals and colours, so they are taken from it:
the offset is taught the point that each query sees (``kernels.offset``). The frame of a texel is held at the mean
normal under its filter, with a width from the mean alpha^2 and the variance of slopes there. The colour of a texel,
which multiplies the light, is held at the filtered colour of the maps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from brdffit.footprint import filter_channels, get_pixel_filter
from brdffit.microgeometry.queries import TracedSource
from brdffit.neural.kernels.material import LEAST_MASK, OWN_COLOUR
from brdffit.neural.kernels.textures import TEXEL
from brdffit.neural.network import Network
from brdffit.neural.questions import directions
from brdffit.textures.encoding import slopes_of_normals

#: Channels of a texel of the pyramid that the surface gives: its frame and its colour; and the steepest slope taken.
GUIDED = 6
_STEEPEST = 3.0
#: Bounds of a sigmoid that a colour begins with, where it still has a slope.
_DARKEST, _BRIGHTEST = 0.02, 0.98


def true_shifts(source: TracedSource, size: tuple[int, int], queries: NDArray) -> NDArray:
    """(n, 2) float32, from positions of queries (n, QUERY) to what is seen, across and down in texels of level 0."""
    scale = np.array(source.size[::-1], float) / np.array(size[::-1], float)
    found = source.parallax(queries[:, :2].astype(np.float64) * scale, directions(queries)[1])
    return np.ascontiguousarray(found / scale, np.float32)


def set_texels(source: TracedSource, network: Network) -> None:
    """Give each texel of the pyramid the frame and the colour of the surface under its filter (``kernels.material``).

    The width is that of a lobe whose distribution of slopes has the variance of the normals' slopes and of their lobes:
    per axis, half of |m|^2 in the mean less half of the mean's, and alpha^2 / 2 for a lobe of GGX cut where LEAN cuts
    it (Olano and Baker 2010), both times 2 to be an alpha^2. The mask of the colour, with outputs of 0, is its share of
    the largest reflectance of the surface.
    """
    bounds, pixel_filter = network.layout.bounds, get_pixel_filter("gaussian")
    slopes = slopes_of_normals(source.normals)
    both = np.concatenate([slopes, np.square(slopes).sum(axis=2, keepdims=True) + source.alpha2[..., None]], axis=2)
    largest = max(float(source.colour.max()), 1e-6)
    for k, size in enumerate(network.layout.sizes):
        normal = filter_channels(source.normals, size, pixel_filter, "tile")
        moments = filter_channels(both, size, pixel_filter, "tile")
        width = moments[..., 2] - np.square(moments[..., :2]).sum(axis=2)
        texels = network.pyramid[bounds[k] : bounds[k + 1]].reshape(*size, TEXEL)
        texels[..., :2] = -normal[..., :2] / np.maximum(normal[..., 2:], 1.0 / _STEEPEST)
        texels[..., 2] = -0.25 * np.log(np.maximum(width, 1e-4))
        colour = filter_channels(source.colour, size, pixel_filter, "tile") / largest
        sigmoid = np.clip(colour - LEAST_MASK, _DARKEST, _BRIGHTEST)
        texels[..., OWN_COLOUR : OWN_COLOUR + 3] = np.log(sigmoid / (1.0 - sigmoid))


def held_texels(gradient: NDArray) -> NDArray:
    """The gradient of a pyramid, without that of what the surface gives, in place."""
    gradient.reshape(-1, TEXEL)[:, :GUIDED] = 0.0
    return gradient
