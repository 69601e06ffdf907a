"""Olano and North 1997, "Normal Distribution Mapping": a Gaussian on the normals of a footprint, filtered linearly.

Each texel stores the mean and the covariance of the unit normals under it, as first and second moments (three numbers
and six), which average linearly. No other filter here is linear: levels, trilinear look-ups and footprints of any shape
all give the exact moments. Base roughness enters the covariance, as the gloss of the surface does in the paper: a lobe
of Sigma adds Sigma / 2 in the tangent plane and the mean of both axes along the normal, because a Gaussian of variance
a^2 / 2 around a unit normal n, restricted to the sphere, is

    exp(-|h - n|^2 / a^2) = exp(-2 (1 - h.n) / a^2),

a von Mises-Fisher lobe, and to first order Beckmann's with alpha = a. A pixel is shaded from the distribution itself,

    D(h) = exp(-(h - m)' C^-1 (h - m) / 2) / Z,   C = E[n n' + S] - m m',   Z such that the integral of D (h.n) is 1,

n the direction of m, with the same masking, Fresnel and diffuse terms as every other method. There is no roughness map:
normals that lie on an arc stay on an arc here, where one lobe would fill it. Z has no closed form; it is a sum over a
fixed rule in the slopes of a GGX lobe of the same width, whose tails are longer than the Gaussian's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import Lookups, trilinear
from brdffit.footprint import get_pixel_filter, iter_pyramid
from brdffit.machine import core_count
from brdffit.methods import Baked, Image, Material, Progress
from brdffit.options import BakeOptions
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf, level_sizes

#: Channels of a stored texel: mean normal, second moments (XX, YY, ZZ, XY, YZ, XZ), specular and diffuse colour.
_MEAN, _MOMENTS, _SPECULAR, _DIFFUSE = slice(0, 3), slice(3, 9), slice(9, 12), slice(12, 15)
#: Rings and spokes of the rule for Z.
_RINGS, _SPOKES = 16, 16


class Distribution(NamedTuple):
    """The distributions of n pixels, float64.

    Attributes:
        mean: (n, 3) mean normal m, shorter than 1. inverse: (n, 3, 3) C^-1.
        log_normalisation: (n,) -log Z.
        normal: (n, 3) direction of the mean. tensor: (n, 3) Sigma of a lobe of the same width, (XX, YY, XY).
        specular, diffuse: (n, 3).
    """

    mean: NDArray
    inverse: NDArray
    log_normalisation: NDArray
    normal: NDArray
    tensor: NDArray
    specular: NDArray
    diffuse: NDArray


@dataclass(frozen=True)
class NormalDistributions:
    """MIP levels of moments, an ``Appearance``.

    Attributes:
        images: (h, w, 15) float32 of each level.
        base_size: (height, width) of level 0.
        wrap: "tile" or "clamp".
        least_variance: of the Gaussian along any axis.
    """

    images: Sequence[NDArray]
    base_size: tuple[int, int]
    wrap: str
    least_variance: float

    @cached_property
    def levels(self) -> Sequence[NDArray]:
        """The images: as many as there are levels."""
        return self.images

    def look_up(self, lookups: Lookups) -> Distribution:
        """The distribution of each pixel."""
        texels = trilinear(self.images, lookups, self.base_size, self.wrap).astype(np.float64)
        mean, moments = texels[:, _MEAN], texels[:, _MOMENTS]
        covariance = moments[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2]]] - mean[:, :, None] * mean[:, None, :]
        # A difference of single-precision averages may come out indefinite: eigenvalues are held at the floor.
        values, vectors = np.linalg.eigh(covariance)
        values = np.maximum(values, self.least_variance)
        covariance = np.einsum("nik,nk,njk->nij", vectors, values, vectors)
        inverse = np.einsum("nik,nk,njk->nij", vectors, 1.0 / values, vectors)
        length = np.linalg.norm(mean, axis=1, keepdims=True)
        normal = np.where(length > 1e-6, mean / np.maximum(length, 1e-6), np.array([0.0, 0.0, 1.0]))
        frame = _frames(normal)
        across = np.einsum("nki,nij,nlj->nkl", frame[:, :2], covariance, frame[:, :2])
        tensor = 2.0 * np.stack([across[:, 0, 0], across[:, 1, 1], across[:, 0, 1]], axis=-1)
        log_normalisation = _log_normalisation(mean, inverse, frame, tensor)
        return Distribution(
            mean, inverse, log_normalisation, normal, tensor, np.maximum(texels[:, _SPECULAR], 0.0),
            np.maximum(texels[:, _DIFFUSE], 0.0),
        )  # fmt: skip

    def evaluate(self, texels: Distribution, view: NDArray, light: NDArray) -> NDArray:
        """See ``brdffit.appearance.Appearance``."""
        from brdffit.models.microfacet import brdf  # numba

        half = light + view
        half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
        density = np.exp(_exponent(half - texels.mean, texels.inverse) + texels.log_normalisation)
        return brdf(texels.normal, texels.tensor, texels.specular, texels.diffuse, view, light, density=density)

    def sample(self, texels: Distribution, view: NDArray, u: NDArray) -> NDArray:
        """See ``Appearance``: from the GGX lobe of the same width."""
        from brdffit.models.microfacet import draw, share_of_lobe

        return draw(texels.normal, texels.tensor, share_of_lobe(texels.specular, texels.diffuse), view, u)

    def pdf(self, texels: Distribution, view: NDArray, light: NDArray) -> NDArray:
        """See ``Appearance``."""
        from brdffit.models.microfacet import drawn_density, share_of_lobe

        share = share_of_lobe(texels.specular, texels.diffuse)
        return drawn_density(texels.normal, texels.tensor, share, view, light)


class NormalDistributionMapping:
    """Mean and covariance of normals, filtered linearly and shaded from their Gaussian."""

    name = "ndm"
    summary = "Gaussian on the normals, mean and covariance filtered linearly (Olano & North 1997); no roughness map"
    options: ClassVar[type[BakeOptions]] = BakeOptions

    def prepare(self, material: Material, options: Any) -> None:
        """Do nothing: there is nothing to prepare."""

    def bake(self, material: Material, options: Any, progress: Progress | None = None) -> Baked:
        """Bake a material, see ``brdffit.methods.Method``."""
        svbrdf = material.svbrdf.over_black()
        image = moments_of(svbrdf)
        sizes = level_sizes(svbrdf.size, options.levels)
        kept = 1 if options.keep_level_0 else 0
        images = [image] * kept
        pixel_filter = get_pixel_filter(options.pixel_filter)
        # Groups of channels are filtered in parallel, each by one thread.
        parts = [np.ascontiguousarray(image[..., part]) for part in (_MEAN, _MOMENTS, _SPECULAR, _DIFFUSE)]
        with ThreadPoolExecutor(options.threads or core_count()) as pool:
            pyramids = [iter_pyramid(part, sizes[kept:], pixel_filter, svbrdf.wrap) for part in parts]
            for mip_level in range(kept, len(sizes)):
                images.append(np.concatenate(list(pool.map(next, pyramids)), axis=-1))
                if progress is not None:
                    count = sizes[mip_level][0] * sizes[mip_level][1]
                    progress(mip_level, count, count)
        appearance = NormalDistributions(images, svbrdf.size, svbrdf.wrap, 0.5 * options.min_roughness**4)
        notes = [] if svbrdf.model == "beckmann" else [f"The {svbrdf.model} lobes of the base are taken as Gaussians."]
        return Baked(self.name, options, appearance, None, notes, _stored(images))


def moments_of(svbrdf: Svbrdf) -> NDArray:
    """Channels (H, W, 15) float32 that are averaged: mean normal, second moments, specular and diffuse colour."""
    normal = svbrdf.normal.astype(np.float64)
    tensor = tensor_from_log(svbrdf.log_roughness).astype(np.float64)
    rows = normal.reshape(-1, 3)
    tangent, bitangent, up = np.moveaxis(_frames(rows).reshape(*svbrdf.size, 3, 3), -2, 0)
    xx, yy, xy = np.moveaxis(0.5 * tensor, -1, 0)
    out = np.empty((*svbrdf.size, 15), np.float32)
    out[..., _MEAN], out[..., _SPECULAR], out[..., _DIFFUSE] = svbrdf.normal, svbrdf.specular, svbrdf.diffuse
    for k, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))):
        spread = xx * tangent[..., i] * tangent[..., j] + yy * bitangent[..., i] * bitangent[..., j]
        spread += xy * (tangent[..., i] * bitangent[..., j] + bitangent[..., i] * tangent[..., j])
        spread += 0.5 * (xx + yy) * up[..., i] * up[..., j]
        out[..., 3 + k] = normal[..., i] * normal[..., j] + spread
    return out


def _stored(images: Sequence[NDArray]) -> list[Image]:
    sizes = [image.shape[:2] for image in images]

    def of(part: slice) -> Any:
        return lambda k, rows: images[k][rows, :, part]

    return [
        Image("mean-normal", ("X", "Y", "Z"), sizes, of(_MEAN)),
        Image("normal-moments", ("XX", "YY", "ZZ", "XY", "YZ", "XZ"), sizes, of(_MOMENTS)),
        Image("specular", ("R", "G", "B"), sizes, of(_SPECULAR)),
        Image("diffuse", ("R", "G", "B"), sizes, of(_DIFFUSE)),
    ]


def _frames(normal: NDArray) -> NDArray:
    """Rows tangent, bitangent, normal (n, 3, 3): the images of x, y and z under the shortest rotation from z to n."""
    x, y, z = normal.T
    k = 1.0 / np.maximum(1.0 + z, 1e-6)
    frame = np.empty((len(normal), 3, 3))
    frame[:, 0] = np.stack([1.0 - x * x * k, -x * y * k, -x], axis=-1)
    frame[:, 1] = np.stack([-x * y * k, 1.0 - y * y * k, -y], axis=-1)
    frame[:, 2] = normal
    return frame


def _exponent(off: NDArray, inverse: NDArray) -> NDArray:
    """-(h - m)' C^-1 (h - m) / 2 of ``off`` = h - m (n, 3)."""
    x, y, z = off.T
    square = x * x * inverse[:, 0, 0] + y * y * inverse[:, 1, 1] + z * z * inverse[:, 2, 2]
    return -0.5 * square - (x * y * inverse[:, 0, 1] + y * z * inverse[:, 1, 2] + x * z * inverse[:, 0, 2])


def _log_normalisation(mean: NDArray, inverse: NDArray, frame: NDArray, tensor: NDArray) -> NDArray:
    """-log Z (n,): Z is the mean of f(h) / D(h) over half vectors h drawn from D(h) (n.h), D the GGX lobe of the same
    width and f the Gaussian.

    Nodes are midpoints of rings of equal weight and of spokes. f is taken relative to its largest value at a node: a
    narrow one would underflow where m is much shorter than 1.
    """
    xx, yy, xy = tensor.T
    root = np.sqrt(np.maximum(xx * yy - xy * xy, 1e-30))
    l_11 = np.sqrt(xx)
    u = (np.arange(_RINGS) + 0.5) / _RINGS
    exponents, weights = [], []
    for k, first in enumerate(u):
        r = math.sqrt(first / (1.0 - first))
        for j in range(_SPOKES):
            # Spokes of neighbouring rings are rotated by half a step against each other.
            angle = 2.0 * math.pi * (j + 0.5 * (k % 2)) / _SPOKES
            a, b = r * math.cos(angle), r * math.sin(angle)
            s, t = l_11 * a, xy / l_11 * a + root / l_11 * b
            cosine = 1.0 / np.sqrt(1.0 + s * s + t * t)
            local = np.stack([s * cosine, t * cosine, cosine], axis=-1)
            half = np.einsum("nk,nki->ni", local, frame)
            exponents.append(_exponent(half - mean, inverse))
            # D = 1 / (pi root (q + C)^2) with q + C = (n.h)^2 (1 + r^2).
            weights.append(math.pi * root * np.square(cosine * cosine * (1.0 + r * r)))
    exponent, weight = np.array(exponents), np.array(weights)
    largest = exponent.max(axis=0)
    return -largest - np.log((np.exp(exponent - largest) * weight).mean(axis=0))
