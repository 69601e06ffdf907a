"""How a level is sampled: strata of its footprints, nodes of its rules, and the levels it is merged from."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from brdffit.fitting.batch import LevelRules
from brdffit.fitting.chain import Chain, first_of_chain
from brdffit.fitting.presets import Quality
from brdffit.footprint import PixelFilter
from brdffit.halfangle.apparent_lobe import Strata, strata
from brdffit.halfangle.lights import BASE_BLUR, POINT
from brdffit.halfangle.quadrature import lattice
from brdffit.svbrdf import level_sizes

# Footprints of at least so many base texels an axis take so many samples that nodes are cheap: factors of nodes there.
# From 16 texels on two lobes are often nearly as good; with few nodes, noise makes single texels wide, and these shine
# in the dark.
_WIDE_NODES = ((16, 4), (4, 2))
# Samples of a pixel's area from which on the noise of random points averages out, under lights with a size.
_MANY_SAMPLES = 256
# Room for the samples of a chain's first level, in units of that of a level by itself: coarser levels consist of them.
_CHAIN_ROOM = 4
# Share of a rule's nodes for each size of light, the smallest size first; the fewest nodes of a size.
_NODE_SHARES, _FEWEST_NODES = (0.5, 0.25, 0.2, 0.2, 0.2, 0.2), 24


def level_rules(
    pixel_filter: PixelFilter, base_size: tuple[int, int], size: tuple[int, int], mip_level: int, quality: Quality,
    point: bool = False, lights: NDArray = POINT,
) -> LevelRules:  # fmt: skip
    """How a level is sampled; ``point`` takes each base texel alone, unfiltered; ``lights`` as in ``lights.Table``."""
    scale = max(base_size[0] / size[0], base_size[1] / size[1])
    wide = _WIDE_NODES if lights[0, BASE_BLUR] > 0.0 else _WIDE_NODES[1:]
    factor = next((factor for texels, factor in wide if scale >= texels), 1)
    points = tuple(_points(nodes * factor, lights) for nodes in quality.nodes)
    if point:
        one = np.ones(1)
        return LevelRules(Strata(0.0 * one, 0.0 * one, one, one, 0.0, 0.0, 1.0, 1.0, 0), 1, lights, points)
    chosen, room = _strata_of(pixel_filter, base_size, size, mip_level, quality, lights)
    chain = None
    if lights[0, BASE_BLUR] > 0.0 and pixel_filter.name == "box":
        chain = _chain_to(pixel_filter, base_size, size, mip_level, quality, lights)
    return LevelRules(chosen, room, lights, points, chain)


def _strata_of(
    pixel_filter: PixelFilter, base_size: tuple[int, int], size: tuple[int, int], mip_level: int, quality: Quality,
    lights: NDArray,
) -> tuple[Strata, int]:  # fmt: skip
    """Strata of the footprints of a level, and room for their samples."""
    scale = max(base_size[0] / size[0], base_size[1] / size[1])
    pixels = max(1.0, 2.0 * pixel_filter.radius)
    # An even number of strata a texel makes strata end at texel centres, as bilinear patches do.
    per_texel = 2 * max(1, math.ceil(0.5 * quality.least / scale))
    # Lights with a size widen every lobe, so that half as many samples miss no sharp peak of a large footprint.
    sized = lights[0, BASE_BLUR] > 0.0
    most = math.ceil(quality.most * pixels * (0.5 if sized else 1.0))
    chosen = strata(pixel_filter, base_size, size, per_texel, most, mip_level, quality.merge)
    scatter = bool(sized and chosen.samples >= _MANY_SAMPLES * pixels * pixels)
    chosen = chosen._replace(light=float(lights[0, BASE_BLUR]), scatter=scatter)
    return chosen, chosen.samples if scatter else max(quality.room, 2 * chosen.samples)


def continued_by(levels: list[LevelRules]) -> Chain | None:
    """The chain of the second of two levels, if it continues that of the first."""
    chains = [rules.chain for rules in levels]
    if len(chains) == 2 and chains[0] is not None and chains[1] is not None and len(chains[1].sizes) > 1:
        return chains[1]
    return None


def _chain_to(
    pixel_filter: PixelFilter, base_size: tuple[int, int], size: tuple[int, int], mip_level: int, quality: Quality,
    lights: NDArray,
) -> Chain | None:  # fmt: skip
    """The chain of levels from which the footprints of one are merged; None where these are gathered."""
    sizes = level_sizes(base_size, mip_level + 1)
    first = first_of_chain(sizes, mip_level) if len(sizes) > mip_level and sizes[mip_level] == size else None
    if first is None:
        return None
    levels = range(first, mip_level + 1)
    gathered = [_strata_of(pixel_filter, base_size, sizes[k], k, quality, lights) for k in levels]
    (own, room), most = gathered[0], tuple(room for _, room in gathered)
    return Chain(own, _CHAIN_ROOM * room, tuple(sizes[first:]), most)


def _points(nodes: int, lights: NDArray) -> tuple[NDArray, ...]:
    """One point set for each size of light: a single size gets all nodes of a rule, several share them."""
    if len(lights) == 1:
        return (lattice(nodes),)
    return tuple(lattice(max(_FEWEST_NODES, 2 * round(0.5 * nodes * _NODE_SHARES[s]))) for s in range(len(lights)))
