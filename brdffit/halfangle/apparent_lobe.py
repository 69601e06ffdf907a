"""The base lobes that one footprint averages: samples of the bilinearly reconstructed base under the pixel filter.

A renderer interpolates the stored textures: normals (then made unit length), perceptual roughness (or the log tensor
where the base is anisotropic) and linear colours. The footprint is cut into strata with one sample each. A hash jitters
samples of strata no narrower than texels, so that these do not alias with the texel grid, alike on every machine.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import kernel, part
from brdffit.footprint import PixelFilter
from brdffit.halfangle.albedo import diffuse_fresnel
from brdffit.halfangle.frame import tensor_of_log
from brdffit.halfangle.patch import (
    alike,
    angle_across,
    arc_of,
    between,
    bilinear,
    bilinear_of,
    corners,
    edges,
    four_of,
    hash_of,
    in_one_patch,
    inside,
    leaned,
    least,
    most,
    narrowed,
    narrowest,
    part_of_arc,
    reflecting,
    slopes_of,
    spread_tensor,
    unit,
    weighed,
    weighted,
    weights_of,
    wrapped,
)
from brdffit.halfangle.quadrature import ALPHA_SQUARED, GAIN, MIXTURE, SHAPE, SPECULAR, SPREAD, TENSOR
from brdffit.models import get_model
from brdffit.roughness import perceptual_from_log_tensor
from brdffit.svbrdf import Svbrdf

# Ratio of the brightest to the darkest texel of a patch above which its gradient of colour is taken into account.
_COLOURED = 1.05
#: Entries of a footprint's diffuse moment, see ``gather_lobes``.
DIFFUSE_MOMENT = 12
# Most samples of a stratum along one axis: a mirror of alpha 0.002 beside a wall would need too many.
_MOST_CUTS = 16
# Squared turn of the normal from texel to texel above which it turns much faster in the middle of a patch than at its
# ends (by a tenth), and most cuts there, under lights with a size.
_WIDE_TURN, _MOST_WIDE_CUTS = 0.1, 48
# A footprint that needs more samples than there is room for is gathered again with a longer step.
_STEP_RETRIES, _STEP_GROWTH = 3, 1.1


class Base(NamedTuple):
    """The base as kernels read it: arrays of ``Svbrdf``, ``perceptual`` (H, W) float32, and two fields of ``Model``."""

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
    widening: tuple[float, float, float] = (2.0, 2.0, 0.0)
    averages: bool = False


class Strata(NamedTuple):
    """Where the samples of a level's footprints lie.

    ``x`` and ``y``: stratum centres relative to the footprint's centre, in base texels; ``weight_x`` and ``weight_y``
    sum to 1; ``jitter_x`` and ``jitter_y``: width of the jitter in base texels (0: none); ``scale_x`` and ``scale_y``:
    base texels per texel of the level; ``seed`` of the jitter, another one for each level; ``merge``: how many lobe
    widths the normal may turn across the strata between four texels for one sample to represent them all (0: never);
    ``light``: alpha^2 that the smallest light adds to every lobe (0: a point); ``scatter``: whether a stratum that the
    normal turns across too quickly is sampled at a random point instead of being cut.
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
    merge: float = 0.0
    light: float = 0.0
    scatter: bool = False

    @property
    def samples(self) -> int:
        """How many samples one footprint takes."""
        return len(self.x) * len(self.y)


def example_base() -> Base:
    """A base of one texel; kernels are compiled for the types of its fields."""
    image, plane = np.zeros((1, 1, 3), np.float32), np.zeros((1, 1), np.float32)
    return Base(
        normal=image, perceptual=plane, log_roughness=image, specular=image, diffuse=image, shape=plane,
        default_shape=0.0, isotropic=True, grey=False, has_diffuse=False, has_shape=False, tile=True,
    )  # fmt: skip


def example_strata() -> Strata:
    """Strata of one sample; kernels are compiled for the types of their fields."""
    line = np.zeros(1)
    return Strata(line, line, line, line, jitter_x=0.0, jitter_y=0.0, scale_x=1.0, scale_y=1.0, seed=0)


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
        widening=get_model(svbrdf.model).widening,
        averages=get_model(svbrdf.model).averages,
    )


def _plain(array: NDArray) -> NDArray:
    """The array as float32, contiguous and writable, the only type that kernels are compiled for; copied if needed."""
    return np.require(array, np.float32, ["C", "W"])


def strata(
    pixel_filter: PixelFilter,
    base_size: tuple[int, int],
    level_size: tuple[int, int],
    per_texel: int,
    most: int,
    seed: int,
    merge: float = 0.0,
) -> Strata:
    """Strata of a level's footprints: ``per_texel`` along each axis of a base texel, at most ``most`` along an axis."""
    axes = []
    for base, level in zip(base_size, level_size, strict=True):
        scale = base / level
        width = 2.0 * pixel_filter.radius * scale
        count = 1 if base == 1 else min(max(1, math.ceil(width * per_texel - 1e-9)), most)
        offset = (np.arange(count) + 0.5) / count * width - 0.5 * width
        weight = np.asarray(pixel_filter.weight(offset / scale), dtype=np.float64)
        # On texel centres alone, samples would see independent normals spread 9/4 as much as their interpolation does.
        jitter = width / count if base > 1 and width >= count else 0.0
        axes.append((offset, weight / weight.sum(), jitter, scale))
    (y, weight_y, jitter_y, scale_y), (x, weight_x, jitter_x, scale_x) = axes
    return Strata(x, y, weight_x, weight_y, jitter_x, jitter_y, scale_x, scale_y, seed, merge)


@kernel
def gather_lobes(base, strata, step, column, row, lobes, diffuse_moment):
    """Fill ``lobes`` with the footprint of texel (column, row); returns (how many, mean relative spread).

    ``step`` is how many lobe widths the normal may turn from one sample to the next. If that needs more samples than
    ``lobes`` has room for (one row is left for the defensive lobe), the whole footprint is sampled again with a longer
    step: first come, first served would leave one side of the footprint sharp and blur the other.
    """
    room = lobes.shape[0] - 1
    for _ in range(_STEP_RETRIES):
        count, spread, wanted = _gather(base, strata, step, column, row, lobes, diffuse_moment)
        if wanted <= room:
            break
        step *= _STEP_GROWTH * math.sqrt(wanted / room)
    return count, spread


@part
def _gather(base, strata, step, column, row, lobes, diffuse_moment):
    """``gather_lobes`` for one step; returns also how many samples that step needs.

    SPECULAR columns hold filter weight times colour, MIXTURE the filter weight alone (they sum to 1).
    ``diffuse_moment`` (DIFFUSE_MOMENT,) receives sum_i w_i d_ic n_i as (channel, axis), then sum_i w_i d_ic.

    Strata between the same four texels share one bilinear patch, whose edges bound how far the normal turns. Where it
    turns by less than ``strata.merge`` lobe widths across all of them, and roughness and colour hardly change, one
    sample represents them all. Where it turns by more than ``step`` lobe widths across one stratum, the stratum is cut
    into as many samples along each axis as needed, since point samples would turn a smooth streak of normals into
    separate peaks; never into more than ``lobes`` has room for (one row is left for the defensive lobe). The remaining
    spread of normals in a sample's part of the patch goes into SPREAD; its mean in units of the lobe's width is
    returned. Strata as wide as a texel or wider are sampled at random points and are neither merged nor cut.

    With ``strata.scatter`` no stratum is cut: it gets one sample at a random point, which stands for no more than
    ``step`` widths around it. Cutting bounds the error of a footprint of a few patches; among hundreds, the noise of
    random points averages out, while lobes widened by all of a long turn would have tails beyond its ends.
    """
    height, width = base.normal.shape[0], base.normal.shape[1]
    centre_x = (column + 0.5) * strata.scale_x - 0.5
    centre_y = (row + 0.5) * strata.scale_y - 0.5
    size_x = strata.x[1] - strata.x[0] if strata.x.size > 1 else 0.0
    size_y = strata.y[1] - strata.y[0] if strata.y.size > 1 else 0.0
    jittered = strata.jitter_x > 0.0 or strata.jitter_y > 0.0
    none = (0.0, 0.0, 0.0)
    for k in range(DIFFUSE_MOMENT):
        diffuse_moment[k] = 0.0
    roughness, tensors = (0.0, 0.0, 0.0, 0.0), (none, none, none, none)
    rough_x, rough_y, colour_x, colour_y, gain = 0.0, 0.0, 0.0, 0.0, 1.0
    mean_spread, count, wanted = 0.0, 0, 0
    room = lobes.shape[0] - 1 - strata.x.size * strata.y.size
    first_y = 0
    while first_y < strata.y.size:
        many_y = 1 if jittered else in_one_patch(strata.y, centre_y, first_y)
        whole_y, offset_y = weighed(strata.weight_y, first_y, many_y)
        first_x = 0
        while first_x < strata.x.size:
            many_x = 1 if jittered else in_one_patch(strata.x, centre_x, first_x)
            x, y = centre_x, centre_y
            if jittered:
                bits = hash_of(strata.seed, row * 65536 + column, first_y, first_x)
                x += strata.jitter_x * ((bits & np.uint32(0xFFFF)) / 65536.0 - 0.5)
                y += strata.jitter_y * ((bits >> np.uint32(16)) / 65536.0 - 0.5)
            x0, y0 = math.floor(x + strata.x[first_x]), math.floor(y + strata.y[first_y])
            i0, i1 = wrapped(int(x0), width, base.tile), wrapped(int(x0) + 1, width, base.tile)
            j0, j1 = wrapped(int(y0), height, base.tile), wrapped(int(y0) + 1, height, base.tile)
            normals, colours = corners(base.normal, i0, i1, j0, j1), corners(base.specular, i0, i1, j0, j1)
            if base.isotropic:
                roughness = four_of(base.perceptual, i0, i1, j0, j1)
            else:
                tensors = corners(base.log_roughness, i0, i1, j0, j1)
            sums = reflecting(colours)
            coloured = most(sums) > _COLOURED * least(sums)
            # Along each axis: parts that are sampled, strata in a part, and samples that a part is cut into.
            apart_x, apart_y, span_x, span_y, cuts_x, cuts_y = many_x, many_y, 1, 1, 1, 1
            inverse = 0.0
            spreads, scattered, wide, near_x, near_y = False, False, False, 1.0, 1.0
            arc_x, arc_y = (0.0, 1.0), (0.0, 1.0)
            x += strata.x[first_x] - 0.5 * size_x - x0
            y += strata.y[first_y] - 0.5 * size_y - y0
            if step > 0.0 and not jittered:
                inverse = 1.0 / (narrowest(tensors, roughness, base.isotropic) + strata.light)
                # Squared turn across a stratum, in lobe widths.
                turn_x, turn_y = edges(normals)
                wide = strata.light > 0.0 and (turn_x > _WIDE_TURN or turn_y > _WIDE_TURN)
                turn_x, turn_y = size_x * size_x * turn_x * inverse, size_y * size_y * turn_y * inverse
                merge_x = many_x > 1 and many_x * many_x * turn_x < strata.merge * strata.merge
                merge_y = many_y > 1 and many_y * many_y * turn_y < strata.merge * strata.merge
                if (merge_x or merge_y) and alike(sums, tensors, roughness, base.isotropic, strata.light):
                    if merge_x:
                        apart_x, span_x = 1, many_x
                    if merge_y:
                        apart_y, span_y = 1, many_y
                if strata.scatter and (turn_x > step * step or turn_y > step * step):
                    scattered = True
                    near_x, near_y = step / math.sqrt(max(turn_x, 1e-12)), step / math.sqrt(max(turn_y, 1e-12))
                elif turn_x > step * step or turn_y > step * step:
                    if wide:
                        x, y = inside(x, many_x * size_x), inside(y, many_y * size_y)
                        middle_x, middle_y = x + 0.5 * many_x * size_x, y + 0.5 * many_y * size_y
                        a, b, c, d = normals
                        arc_x = arc_of(between(a, c, middle_y), between(b, d, middle_y))
                        arc_y = arc_of(between(a, b, middle_x), between(c, d, middle_x))
                        turn_x = max(turn_x, inverse * angle_across(arc_x, x, size_x, many_x) ** 2)
                        turn_y = max(turn_y, inverse * angle_across(arc_y, y, size_y, many_y) ** 2)
                    most_cuts = _MOST_WIDE_CUTS if wide else _MOST_CUTS
                    cuts_x = max(min(math.ceil(math.sqrt(turn_x) / step), most_cuts), 1)
                    cuts_y = max(min(math.ceil(math.sqrt(turn_y) / step), most_cuts), 1)
                    wanted += apart_x * apart_y * (cuts_x * cuts_y - 1)
                    while cuts_x * cuts_y > 1 and apart_x * apart_y * (cuts_x * cuts_y - 1) > room:
                        if cuts_x > cuts_y:
                            cuts_x = (cuts_x + 1) // 2
                        else:
                            cuts_y = (cuts_y + 1) // 2
                spreads = span_x * span_x * turn_x + span_y * span_y * turn_y > 1e-3
            wanted += apart_x * apart_y
            room += many_x * many_y - apart_x * apart_y * cuts_x * cuts_y
            part_x, part_y = size_x * span_x / cuts_x, size_y * span_y / cuts_y
            if scattered or cuts_x * cuts_y > 1:
                x, y = inside(x, many_x * size_x), inside(y, many_y * size_y)
            wide = wide and cuts_x * cuts_y > 1
            whole_x = 0.0
            if span_x > 1:
                whole_x, offset_x = weighed(strata.weight_x, first_x, many_x)
                x += offset_x * size_x
            if span_y > 1:
                y += offset_y * size_y
            share = 1.0 / (cuts_x * cuts_y)
            own_x, own_y = part_x, part_y
            for k in range(apart_y * cuts_y):
                weight_y = share * (whole_y if span_y > 1 else strata.weight_y[first_y + k // cuts_y])
                fy = y + (k + 0.5) * part_y
                if wide and cuts_y > 1:
                    fy, own_y = part_of_arc(arc_y, y, size_y, k, cuts_y)
                    weight_y *= own_y / part_y
                for m in range(apart_x * cuts_x):
                    weight = weight_y * (whole_x if span_x > 1 else strata.weight_x[first_x + m // cuts_x])
                    fx = x + (m + 0.5) * part_x
                    if wide and cuts_x > 1:
                        fx, own_x = part_of_arc(arc_x, x, size_x, m, cuts_x)
                        weight *= own_x / part_x
                    if scattered:
                        bits = hash_of(strata.seed, row * 65536 + column, first_y + k, first_x + m)
                        fx += part_x * ((bits & np.uint32(0xFFFF)) / 65536.0 - 0.5)
                        fy = y + (k + (bits >> np.uint32(16)) / 65536.0) * part_y
                    lobe = lobes[count]
                    w = weights_of(fx, fy)
                    colour_x, colour_y = 0.0, 0.0
                    n, length = unit(bilinear(normals, w))
                    if scattered:
                        own_x, own_y = min(near_x * length, 1.0) * part_x, min(near_y * length, 1.0) * part_y
                    lobe[0], lobe[1], lobe[2] = n
                    if base.isotropic:
                        r = bilinear_of(roughness, w)
                        rough_x, rough_y = slopes_of(roughness, fx, fy)
                        rough_x, rough_y = rough_x / r, rough_y / r
                        narrower, gain = narrowed(rough_x, rough_y, own_x, own_y)
                        if coloured:
                            colour_x, colour_y = slopes_of(sums, fx, fy)
                            whole = max(bilinear_of(sums, w), 1e-6)
                            colour_x, colour_y = colour_x / whole, colour_y / whole
                            narrower *= weighted(rough_x, rough_y, colour_x, colour_y, own_x, own_y)
                        lobe[ALPHA_SQUARED] = max((r * r) * (r * r) * narrower, least(roughness) ** 4)
                    else:
                        a, b, c = bilinear(tensors, w)
                        lobe[TENSOR], lobe[TENSOR + 1], lobe[TENSOR + 2] = tensor_of_log(a, b, c)
                    lobe[SHAPE] = base.default_shape
                    if base.has_shape:
                        s = w[0] * base.shape[j0, i0] + w[1] * base.shape[j0, i1]
                        lobe[SHAPE] = s + w[2] * base.shape[j1, i0] + w[3] * base.shape[j1, i1]
                    colour = bilinear(colours, w)
                    lobe[SPECULAR], lobe[SPECULAR + 1] = weight * colour[0], weight * colour[1]
                    lobe[SPECULAR + 2] = weight * colour[2]
                    lobe[MIXTURE], lobe[GAIN] = weight, gain
                    lobe[SPREAD], lobe[SPREAD + 1], lobe[SPREAD + 2] = none
                    if spreads:
                        if base.isotropic and (coloured or rough_x * rough_x + rough_y * rough_y > 1e-4):
                            lean_x = own_x * own_x * (colour_x - 4.0 * rough_x)
                            lean_y = own_y * own_y * (colour_y - 4.0 * rough_y)
                            lobe[0], lobe[1], lobe[2] = leaned(n, length, normals, fx, fy, lean_x, lean_y)
                        xx, yy, xy = spread_tensor(n, normals, fx, fy, own_x / length, own_y / length)
                        lobe[SPREAD], lobe[SPREAD + 1], lobe[SPREAD + 2] = xx, yy, xy
                        mean_spread += weight * min((xx + yy) * inverse, 1.0)
                    if base.has_diffuse:
                        d = bilinear(corners(base.diffuse, i0, i1, j0, j1), w)
                        matt = weight * diffuse_fresnel(lobe[2]) if strata.light > 0.0 else weight
                        for axis in range(3):
                            for k in range(3):
                                diffuse_moment[3 * k + axis] += matt * lobe[axis] * d[k]
                            diffuse_moment[9 + axis] += matt * d[axis]
                    count += 1
            first_x += many_x
        first_y += many_y
    return count, mean_spread, wanted


@kernel
def normalise_mixture(lobes, count):
    """MIXTURE <- share of each lobe in the reflected energy; returns (mean colour r, g, b, whether any specular).

    Where nothing is reflected the lobes are taken as white, so that a normal and a roughness can be fitted.
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
