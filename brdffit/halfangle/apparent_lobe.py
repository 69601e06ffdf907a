"""The base lobes that one footprint averages: samples of the bilinearly reconstructed base under the pixel filter.

A renderer interpolates what the textures store: unit normals (then normalised), perceptual roughness (or the log tensor
where the base is anisotropic) and linear colours. The footprint is cut into strata, one sample each; where strata are
wider than texels the sample is jittered inside its stratum by a hash, so that no texel grid beats against the strata,
and the result is the same on every machine.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import inline, kernel
from brdffit.footprint import PixelFilter
from brdffit.halfangle.frame import tangent_frame
from brdffit.halfangle.quadrature import ALPHA_SQUARED, LOG_TENSOR, MIXTURE, NORMALISATION, SHAPE, SPECULAR, SPREAD
from brdffit.roughness import perceptual_from_log_tensor
from brdffit.svbrdf import Svbrdf

# Samples of one stratum and axis at most: a mirror of alpha 0.002 beside a wall wants more than anyone can pay.
_MOST_CUTS = 16
# A footprint that asks for more samples than there is room for is gathered again with a longer step.
_STEP_RETRIES, _STEP_GROWTH = 3, 1.1
# Share of the nodes that a guard draws.
_GUARD_SHARE = 0.25


class Base(NamedTuple):
    """The base as kernels read it; arrays as in Svbrdf, ``perceptual`` (H, W) float32."""

    normal: NDArray
    perceptual: NDArray
    log_roughness: NDArray
    specular: NDArray
    diffuse: NDArray
    shape: NDArray
    default_shape: float
    isotropic: bool
    grey: bool
    has_diffuse: bool
    has_shape: bool
    tile: bool


class Strata(NamedTuple):
    """Where the samples of a level's footprints lie.

    ``x`` and ``y``: stratum centres relative to the footprint's centre, in base texels; ``weight_x`` and ``weight_y``
    sum to 1; ``jitter_x`` and ``jitter_y``: width of the jitter in base texels (0: none); ``scale_x`` and ``scale_y``:
    base texels per texel of the level; ``seed`` tells levels apart.
    """

    x: NDArray
    y: NDArray
    weight_x: NDArray
    weight_y: NDArray
    jitter_x: float
    jitter_y: float
    scale_x: float
    scale_y: float
    seed: int

    @property
    def samples(self) -> int:
        """How many samples one footprint takes."""
        return len(self.x) * len(self.y)


def base_of(svbrdf: Svbrdf, default_shape: float = 0.0) -> Base:
    """Pack an Svbrdf for the kernels (no array is copied unless its type differs)."""
    log_roughness = _plain(svbrdf.log_roughness)
    isotropic = bool(np.array_equal(log_roughness[..., 0], log_roughness[..., 1]) and not np.any(log_roughness[..., 2]))
    specular = _plain(svbrdf.specular)
    none = np.zeros((1, 1), np.float32)
    return Base(
        normal=_plain(svbrdf.normal),
        perceptual=perceptual_from_log_tensor(log_roughness) if isotropic else none,
        log_roughness=log_roughness,
        specular=specular,
        diffuse=_plain(svbrdf.diffuse),
        shape=none if svbrdf.shape is None else _plain(svbrdf.shape),
        default_shape=default_shape,
        isotropic=isotropic,
        grey=all(np.array_equal(specular[..., 0], specular[..., k]) for k in (1, 2)),
        has_diffuse=bool(np.any(svbrdf.diffuse)),
        has_shape=svbrdf.shape is not None,
        tile=svbrdf.wrap == "tile",
    )


def _plain(array: NDArray) -> NDArray:
    """float32, contiguous and writable: the one array type that kernels are compiled for (copied only if it is not)."""
    return np.require(array, np.float32, ["C", "W"])


def strata(
    pixel_filter: PixelFilter,
    base_size: tuple[int, int],
    level_size: tuple[int, int],
    per_texel: int,
    most: int,
    seed: int,
) -> Strata:
    """Strata of a level's footprints: ``per_texel`` a base texel and axis, at most ``most`` an axis."""
    axes = []
    for base, level in zip(base_size, level_size, strict=True):
        scale = base / level
        width = 2.0 * pixel_filter.radius * scale
        count = 1 if base == 1 else min(max(1, math.ceil(width * per_texel - 1e-9)), most)
        offset = (np.arange(count) + 0.5) / count * width - 0.5 * width
        weight = np.asarray(pixel_filter.weight(offset / scale), dtype=np.float64)
        stratum = width / count
        axes.append((offset, weight / weight.sum(), stratum if stratum > 1.0 else 0.0, scale))
    (y, weight_y, jitter_y, scale_y), (x, weight_x, jitter_x, scale_x) = axes
    return Strata(x, y, weight_x, weight_y, jitter_x, jitter_y, scale_x, scale_y, seed)


@inline
def _hash(a, b, c, d):
    """A 32-bit mix of four integers (murmur3's finaliser over a linear combination)."""
    h = np.uint32(a) * np.uint32(0x9E3779B1) ^ np.uint32(b) * np.uint32(0x85EBCA77)
    h = h ^ np.uint32(c) * np.uint32(0xC2B2AE3D) ^ np.uint32(d) * np.uint32(0x27D4EB2F)
    h = np.uint32(h ^ (h >> np.uint32(16))) * np.uint32(0x85EBCA6B)
    h = np.uint32(h ^ (h >> np.uint32(13))) * np.uint32(0xC2B2AE35)
    return np.uint32(h ^ (h >> np.uint32(16)))


@inline
def _index(i, size, tile):
    """Texel index beyond the border: wrapped or clamped."""
    if 0 <= i < size:
        return i
    if tile:
        return i % size
    return min(max(i, 0), size - 1)


@kernel
def gather_lobes(base, strata, step, column, row, lobes, diffuse_moment):
    """Fill ``lobes`` with the footprint of texel (column, row); returns (how many, mean relative spread).

    ``step`` is how many lobe widths the normal may turn from one sample to the next. Where that asks for more samples
    than ``lobes`` has room for (one row is left for the defensive lobe), all of the footprint is sampled with a longer
    step: were the room given to whoever comes first, one side of the footprint would be sharp and the other blurred.
    """
    room = lobes.shape[0] - 1
    for _ in range(_STEP_RETRIES):
        count, spread, wanted = _gather(base, strata, step, column, row, lobes, diffuse_moment)
        if wanted <= room:
            break
        step *= _STEP_GROWTH * math.sqrt(wanted / room)
    return count, spread


@kernel
def _gather(base, strata, step, column, row, lobes, diffuse_moment):
    """``gather_lobes`` for one step; returns also how many samples it asks for.

    SPECULAR columns hold filter weight times colour, MIXTURE the filter weight alone (they sum to 1).
    ``diffuse_moment`` (9,) receives sum_i w_i d_ic n_i as (channel, axis).

    A stratum across which the normal turns by more than ``step`` lobe widths is cut into as many samples an axis as
    that takes, for point samples would turn a smooth streak of normals into separate needles; never more in all than
    ``lobes`` has room for (one row is left for the defensive lobe). What a sample's part of the stratum still spreads
    is noted in SPREAD, and its mean in units of the lobe's width is returned. Inside a stratum the base is one bilinear
    patch (strata end at texel centres where sizes divide evenly), so edges and slopes of the patch say how far it
    turns. Strata wider than a texel are sampled at random points: they are not cut, and nothing is left out.
    """
    height, width = base.normal.shape[0], base.normal.shape[1]
    centre_x = (column + 0.5) * strata.scale_x - 0.5
    centre_y = (row + 0.5) * strata.scale_y - 0.5
    size_x = strata.x[1] - strata.x[0] if strata.x.size > 1 else 0.0
    size_y = strata.y[1] - strata.y[0] if strata.y.size > 1 else 0.0
    jittered = strata.jitter_x > 0.0 or strata.jitter_y > 0.0
    cut = step > 0.0 and not jittered
    # Normals of a bilinear patch, n00 n10 n01 n11; they stand in the row that the defensive lobe takes later.
    patch = lobes[lobes.shape[0] - 1]
    diffuse_moment[:] = 0.0
    mean_spread = 0.0
    count, wanted = 0, 0
    left = strata.x.size * strata.y.size
    for gy in range(strata.y.size):
        for gx in range(strata.x.size):
            left -= 1
            x = centre_x + strata.x[gx]
            y = centre_y + strata.y[gy]
            if jittered:
                bits = _hash(strata.seed, row * 65536 + column, gy, gx)
                x += strata.jitter_x * ((bits & np.uint32(0xFFFF)) / 65536.0 - 0.5)
                y += strata.jitter_y * ((bits >> np.uint32(16)) / 65536.0 - 0.5)
            x0, y0 = math.floor(x), math.floor(y)
            i0, i1 = _index(int(x0), width, base.tile), _index(int(x0) + 1, width, base.tile)
            j0, j1 = _index(int(y0), height, base.tile), _index(int(y0) + 1, height, base.tile)
            for k in range(3):
                patch[k], patch[3 + k] = base.normal[j0, i0, k], base.normal[j0, i1, k]
                patch[6 + k], patch[9 + k] = base.normal[j1, i0, k], base.normal[j1, i1, k]
            cuts_x, cuts_y = 1, 1
            wanted += 1
            spreads = False
            if cut:
                edge_x = size_x * size_x * max(_distance(patch, 0, 3), _distance(patch, 6, 9))
                edge_y = size_y * size_y * max(_distance(patch, 0, 6), _distance(patch, 3, 9))
                narrow = _narrowest(base, i0, i1, j0, j1)
                spreads = edge_x + edge_y > 1e-3 * narrow
                if edge_x > step * step * narrow or edge_y > step * step * narrow:
                    cuts_x = min(math.ceil(math.sqrt(edge_x / narrow) / step), _MOST_CUTS)
                    cuts_y = min(math.ceil(math.sqrt(edge_y / narrow) / step), _MOST_CUTS)
                    cuts_x, cuts_y = max(cuts_x, 1), max(cuts_y, 1)
                    wanted += cuts_x * cuts_y - 1
                    room = lobes.shape[0] - 1 - count - left
                    while cuts_x * cuts_y > room:
                        if cuts_x > cuts_y:
                            cuts_x = (cuts_x + 1) // 2
                        else:
                            cuts_y = (cuts_y + 1) // 2
            weight = strata.weight_x[gx] * strata.weight_y[gy] / (cuts_x * cuts_y)
            part_x, part_y = size_x / cuts_x, size_y / cuts_y
            for sub_y in range(cuts_y):
                for sub_x in range(cuts_x):
                    fx = x - x0 + (sub_x + 0.5 - 0.5 * cuts_x) * part_x
                    fy = y - y0 + (sub_y + 0.5 - 0.5 * cuts_y) * part_y
                    w00, w10, w01, w11 = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
                    n0 = w00 * patch[0] + w10 * patch[3] + w01 * patch[6] + w11 * patch[9]
                    n1 = w00 * patch[1] + w10 * patch[4] + w01 * patch[7] + w11 * patch[10]
                    n2 = w00 * patch[2] + w10 * patch[5] + w01 * patch[8] + w11 * patch[11]
                    length = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
                    if length > 1e-6:
                        n0, n1, n2 = n0 / length, n1 / length, n2 / length
                    else:
                        n0, n1, n2, length = 0.0, 0.0, 1.0, 1.0
                    lobes[count, 0], lobes[count, 1], lobes[count, 2] = n0, n1, n2
                    if base.isotropic:
                        r = w00 * base.perceptual[j0, i0] + w10 * base.perceptual[j0, i1]
                        r += w01 * base.perceptual[j1, i0] + w11 * base.perceptual[j1, i1]
                        lobes[count, ALPHA_SQUARED] = (r * r) * (r * r)
                    else:
                        for k in range(3):
                            lobes[count, LOG_TENSOR + k] = _bilinear(
                                base.log_roughness, i0, i1, j0, j1, k, w00, w10, w01, w11
                            )
                    lobes[count, SHAPE] = base.default_shape
                    if base.has_shape:
                        s = w00 * base.shape[j0, i0] + w10 * base.shape[j0, i1]
                        lobes[count, SHAPE] = s + w01 * base.shape[j1, i0] + w11 * base.shape[j1, i1]
                    for k in range(3):
                        colour = _bilinear(base.specular, i0, i1, j0, j1, k, w00, w10, w01, w11)
                        lobes[count, SPECULAR + k] = weight * colour
                    lobes[count, MIXTURE] = weight
                    lobes[count, SPREAD], lobes[count, SPREAD + 1], lobes[count, SPREAD + 2] = 0.0, 0.0, 0.0
                    if spreads:
                        trace = _spread(lobes, count, patch, fx, fy, part_x / length, part_y / length)
                        mean_spread += weight * min(trace / narrow, 1.0)
                    if base.has_diffuse:
                        for k in range(3):
                            d = weight * _bilinear(base.diffuse, i0, i1, j0, j1, k, w00, w10, w01, w11)
                            diffuse_moment[3 * k] += d * n0
                            diffuse_moment[3 * k + 1] += d * n1
                            diffuse_moment[3 * k + 2] += d * n2
                    count += 1
    return count, mean_spread, wanted


@inline
def _distance(patch, a, b):
    """Squared distance of two texels' normals, from entries a and b of the patch on."""
    d_x, d_y, d_z = patch[a] - patch[b], patch[a + 1] - patch[b + 1], patch[a + 2] - patch[b + 2]
    return d_x * d_x + d_y * d_y + d_z * d_z


@inline
def _narrowest(base, i0, i1, j0, j1):
    """Smallest alpha^2 of the four texels of a bilinear patch."""
    if base.isotropic:
        r = min(
            min(base.perceptual[j0, i0], base.perceptual[j0, i1]), min(base.perceptual[j1, i0], base.perceptual[j1, i1])
        )
        return (r * r) * (r * r)
    least = 1e30
    for k in range(4):
        j, i = (j0 if k < 2 else j1), (i0 if k % 2 == 0 else i1)
        a, b, c = base.log_roughness[j, i, 0], base.log_roughness[j, i, 1], base.log_roughness[j, i, 2]
        least = min(least, min(a, b) - abs(c))
    return math.exp(least)


@inline
def _spread(lobes, i, patch, fx, fy, size_x, size_y):
    """Note in SPREAD what the spread of normals across the sample's part adds to its tensor; returns the trace.

    Across a part of a smooth normal field the slopes are spread evenly over a parallelogram with edges g_x and g_y, so
    their covariance is (g_x g_x' + g_y g_y') / 12 and, to second order, the tensor grows by twice that: the rule of
    LEAN (Olano and Baker 2010), within one part of one stratum.
    """
    t_x, t_y, t_z, b_x, b_y, b_z = tangent_frame(lobes[i, 0], lobes[i, 1], lobes[i, 2])
    xx, yy, xy = 0.0, 0.0, 0.0
    for axis in range(2):
        f = fy if axis == 0 else fx
        size = size_x if axis == 0 else size_y
        near, far = (3, 6) if axis == 0 else (6, 3)
        d_x = size * ((1.0 - f) * (patch[near] - patch[0]) + f * (patch[9] - patch[far]))
        d_y = size * ((1.0 - f) * (patch[near + 1] - patch[1]) + f * (patch[10] - patch[far + 1]))
        d_z = size * ((1.0 - f) * (patch[near + 2] - patch[2]) + f * (patch[11] - patch[far + 2]))
        u, v = t_x * d_x + t_y * d_y + t_z * d_z, b_x * d_x + b_y * d_y + b_z * d_z
        xx += u * u / 6.0
        yy += v * v / 6.0
        xy += u * v / 6.0
    lobes[i, SPREAD], lobes[i, SPREAD + 1], lobes[i, SPREAD + 2] = xx, yy, xy
    return xx + yy


@inline
def _bilinear(image, i0, i1, j0, j1, k, w00, w10, w01, w11):
    """One channel between four texels, in double precision."""
    return w00 * image[j0, i0, k] + w10 * image[j0, i1, k] + w01 * image[j1, i0, k] + w11 * image[j1, i1, k]


@kernel
def normalise_mixture(lobes, count):
    """MIXTURE <- share of each lobe in the reflected energy; returns (mean colour r, g, b, whether any specular).

    Where nothing is reflected the lobes are taken as white, so that normal and roughness still mean something.
    """
    red, green, blue, total = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        red += lobes[i, SPECULAR]
        green += lobes[i, SPECULAR + 1]
        blue += lobes[i, SPECULAR + 2]
        total += abs(lobes[i, SPECULAR]) + abs(lobes[i, SPECULAR + 1]) + abs(lobes[i, SPECULAR + 2])
    some = total > 1e-12
    if not some:
        total = 1e-30
        for i in range(count):
            for k in range(3):
                lobes[i, SPECULAR + k] = lobes[i, MIXTURE]
            total += 3.0 * abs(lobes[i, MIXTURE])
    for i in range(count):
        lobes[i, MIXTURE] = (
            abs(lobes[i, SPECULAR]) + abs(lobes[i, SPECULAR + 1]) + abs(lobes[i, SPECULAR + 2])
        ) / total
    return red, green, blue, some


@kernel
def add_defensive_lobe(lobes, count, share, m_x, m_y, a, b, c):
    """Write a lobe without colour into ``lobes[count]`` and give it ``share`` of the mixture."""
    for i in range(count):
        lobes[i, MIXTURE] *= 1.0 - share
    lobes[count, :] = 0.0
    inverse = 1.0 / math.sqrt(1.0 + m_x * m_x + m_y * m_y)
    lobes[count, 0], lobes[count, 1], lobes[count, 2] = -m_x * inverse, -m_y * inverse, inverse
    lobes[count, LOG_TENSOR], lobes[count, LOG_TENSOR + 1], lobes[count, LOG_TENSOR + 2] = a, b, c
    lobes[count, MIXTURE] = share


@kernel
def add_guard(lobes, count, theta):
    """Insert the lobe ``theta`` (6,) before the defensive one, without colour: it draws nodes and adds nothing.

    The tensors of ``lobes`` must be full ones. It takes the share of the defensive lobe, of all the others alike.
    """
    lobes[count + 1, :] = lobes[count]
    lobes[count, :] = 0.0
    inverse = 1.0 / math.sqrt(1.0 + theta[0] * theta[0] + theta[1] * theta[1])
    lobes[count, 0], lobes[count, 1], lobes[count, 2] = -theta[0] * inverse, -theta[1] * inverse, inverse
    for k in range(3):
        lobes[count, LOG_TENSOR + k] = theta[2 + k]
    lobes[count, SHAPE] = lobes[0, SHAPE]
    for i in range(count + 2):
        lobes[i, MIXTURE] *= 1.0 - _GUARD_SHARE
    lobes[count, MIXTURE] = _GUARD_SHARE


@kernel
def normalise_shapes(lobes, count, has_shape, log_normalisation):
    """NORMALISATION <- K(shape) of every lobe; one value serves all where the base has no shape of its own."""
    k = math.exp(log_normalisation(lobes[0, SHAPE])[0])
    for i in range(count):
        if has_shape:
            k = math.exp(log_normalisation(lobes[i, SHAPE])[0])
        lobes[i, NORMALISATION] = k
