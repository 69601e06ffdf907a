"""Apparent lobes of a few texels, and each method's lobe beside them (Kemppinen et al. 2023, figure 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import LUMINANCE
from brdffit.fitting.batch import model_kernels
from brdffit.halfangle.apparent_lobe import DIFFUSE_MOMENT, base_of, gather_lobes, normalise_mixture
from brdffit.halfangle.closed_forms import widen_lobes
from brdffit.halfangle.measure import DENSE_ROOM, DENSE_STEP, dense_strata
from brdffit.halfangle.quadrature import (
    BLUE,
    GAIN,
    H_X,
    H_Z,
    LOBE_COLUMNS,
    MIXTURE,
    NODE_ROWS,
    NORMAL,
    NORMALISATION,
    RED,
    SHAPE,
    SPECULAR,
    TENSOR,
    frame_lobes,
)
from brdffit.models import Model, get_model
from brdffit.report.records import LobeView, capped, pack
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf

#: Cells along a side of a grid, and points of a cut.
SIDE = 49
#: Samples of a footprint along an axis.
_SAMPLES = (16, 64)
#: The window holds this share of the base lobes' peaks, and so many lobe widths beyond.
_SHOWN, _REACH = 0.8, 2.0
_LEAST_EXTENT, _MOST_EXTENT = 0.015, 0.95


@cache
def model_of(name: str) -> Model:
    """``get_model``, cached by name, since it reads the entry points of the whole installation."""
    return get_model(name)


def lobe_view(
    svbrdf: Svbrdf,
    levels: Mapping[str, Svbrdf],
    mip_level: int,
    texel: tuple[int, int],
    *,
    pixel_filter: str,
    errors: Mapping[str, float],
) -> LobeView:
    """Apparent lobe of one texel (column, row) of a level and the lobes that methods put there.

    Every lobe, the truth's too, is blurred by one cell of the grid: base lobes narrower than a cell would otherwise
    fall between its points.

    Args:
        svbrdf: the base.
        levels: the level as each method has it.
        mip_level, texel: which.
        pixel_filter: of the footprint.
        errors: SNR in dB of each method's lobe at this texel.
    """
    size = next(iter(levels.values())).size
    base_lobes = _footprint_lobes(svbrdf, size, texel, pixel_filter)
    own = {name: _own_lobe(level, texel) for name, level in levels.items()}
    centre, extent, axis = _window(base_lobes)
    cell = 2.0 * extent / (SIDE - 1)
    blur = (0.5 * cell) ** 2
    _blur(base_lobes, blur)
    for lobe in own.values():
        _blur(lobe, blur)

    step = np.linspace(-extent, extent, SIDE)
    grid_x, grid_y = np.meshgrid(centre[0] + step, centre[1] - step)
    source = svbrdf.model

    def luminance(x: NDArray, y: NDArray) -> dict[str, NDArray]:
        values = {"reference": _values(base_lobes, source, x, y)}
        return values | {name: _values(lobe, levels[name].model, x, y) for name, lobe in own.items()}

    grids = luminance(grid_x, grid_y)
    top = int(np.argmax(grids["reference"]))
    peak_at = float(grid_x.flat[top]), float(grid_y.flat[top])
    lines = np.array([axis, (-axis[1], axis[0])])
    cuts = luminance(peak_at[0] + lines[:, :1] * step, peak_at[1] + lines[:, 1:] * step)
    peak = float(grids["reference"].flat[top])
    unit = peak if peak > 0.0 else 1.0
    return LobeView(
        level=mip_level,
        column=texel[0],
        row=texel[1],
        u=(texel[0] + 0.5) / size[1],
        v=(texel[1] + 0.5) / size[0],
        side=SIDE,
        centre=centre,
        extent=extent,
        peak=peak,
        peak_at=peak_at,
        axis=(float(axis[0]), float(axis[1])),
        grids={name: pack(values / unit) for name, values in grids.items()},
        cuts={name: pack(values / unit) for name, values in cuts.items()},
        snr_db={name: capped(value) for name, value in errors.items()},
    )


def representative_texels(errors: NDArray, columns: NDArray, rows: NDArray, count: int) -> list[tuple[int, int]]:
    """Texels (column, row) at even quantiles of an error, from the least to the most: neither the best nor the worst
    can hide."""
    order = np.argsort(errors, kind="stable")
    chosen = np.unique(np.linspace(0, len(order) - 1, count).round().astype(int))
    return [(int(columns[order[i]]), int(rows[order[i]])) for i in chosen]


def same_place(texel: tuple[int, int], size: Sequence[int], other_size: Sequence[int]) -> tuple[int, int]:
    """The texel (column, row) of another level that holds the centre of a texel; sizes are (height, width)."""
    column = (texel[0] + 0.5) / size[1] * other_size[1]
    row = (texel[1] + 0.5) / size[0] * other_size[0]
    return min(int(column), other_size[1] - 1), min(int(row), other_size[0] - 1)


def _footprint_lobes(svbrdf: Svbrdf, size: tuple[int, int], texel: tuple[int, int], pixel_filter: str) -> NDArray:
    """Base lobes (n, LOBE_COLUMNS) of a footprint, all with a full tensor."""
    model = model_of(svbrdf.model)
    base = base_of(svbrdf, model.default_shape)
    rule = dense_strata(svbrdf.size, size, pixel_filter, _SAMPLES)
    lobes = np.zeros((DENSE_ROOM * rule.samples + 1, LOBE_COLUMNS))
    count, _ = gather_lobes(base, rule, DENSE_STEP, texel[0], texel[1], lobes, np.zeros(DIFFUSE_MOMENT))
    normalise_mixture(lobes, count)
    # Full tensors for all, whether or not a sample's part of the footprint spreads.
    widen_lobes(lobes, count, base.isotropic, base.widening)
    return lobes[:count]


def _own_lobe(level: Svbrdf, texel: tuple[int, int]) -> NDArray:
    """A texel of a pyramid as one base lobe (1, LOBE_COLUMNS)."""
    column, row = texel
    lobe = np.zeros((1, LOBE_COLUMNS))
    lobe[0, NORMAL : NORMAL + 3] = level.normal[row, column]
    lobe[0, TENSOR : TENSOR + 3] = tensor_from_log(level.log_roughness[row, column])
    lobe[0, SHAPE] = model_of(level.model).default_shape if level.shape is None else level.shape[row, column]
    lobe[0, SPECULAR : SPECULAR + 3] = level.specular[row, column]
    lobe[0, MIXTURE] = lobe[0, GAIN] = 1.0
    return lobe


def _window(lobes: NDArray) -> tuple[tuple[float, float], float, NDArray]:
    """Centre and half width of the square of projected half vectors that shows the lobes, and their long axis.

    Medians, not moments: a few steep normals at the edge of a plate would stretch the window over empty space.
    """
    weight = np.abs(lobes[:, MIXTURE])
    weight = weight / weight.sum()
    flat = lobes[:, 0:2]
    centre = np.array([_quantile(flat[:, k], weight, 0.5) for k in range(2)])
    away = flat - centre
    distance = np.hypot(*away.T)
    tensor = lobes[:, TENSOR : TENSOR + 3]
    width = _quantile(np.sqrt(tensor[:, 0] + tensor[:, 1]), weight, 0.5)
    extent = float(np.clip(_quantile(distance, weight, _SHOWN) + _REACH * width, _LEAST_EXTENT, _MOST_EXTENT))
    # GGX has no variance; half its alpha^2 is that of the Beckmann lobe of the same width.
    inside = weight * (distance < extent)
    xx, yy, xy = (inside @ (0.5 * tensor[:, k]) for k in range(3))
    spread = (away * inside[:, None]).T @ away + np.array([[xx, xy], [xy, yy]])
    # The window stays on the disk of projected unit vectors.
    centre = centre * min(1.0, (1.0 - extent) / max(float(np.hypot(*centre)), 1e-9))
    return (float(centre[0]), float(centre[1])), extent, np.linalg.eigh(spread)[1][:, 1]


def _quantile(values: NDArray, weight: NDArray, share: float) -> float:
    """The value below which this share of the weight (sum 1) lies."""
    order = np.argsort(values)
    at = np.searchsorted(np.cumsum(weight[order]), share)
    return float(values[order[min(int(at), len(order) - 1)]])


def _blur(lobes: NDArray, alpha_squared: float) -> None:
    """Widen all lobes by this much alpha^2, in place."""
    lobes[:, TENSOR : TENSOR + 2] += alpha_squared


def _values(lobes: NDArray, model_name: str, x: NDArray, y: NDArray) -> NDArray:
    """Luminance of a sum of lobes at projected half vectors; 0 outside the unit disk."""
    model = model_of(model_name)
    height = 1.0 - x * x - y * y
    nodes = np.zeros((NODE_ROWS, x.size), np.float32)
    nodes[H_X : H_Z + 1] = np.stack([x, y, np.sqrt(np.maximum(height, 0.0))]).reshape(3, -1)
    table = np.zeros((len(lobes) + 1, LOBE_COLUMNS))
    table[:-1] = lobes
    # The table ends with the defensive lobe of the fit; its weight is 0 here.
    table[-1, 2] = table[-1, TENSOR] = table[-1, TENSOR + 1] = 1.0
    shapes, which = np.unique(table[:, SHAPE], return_inverse=True)
    constants = np.exp([model.log_normalisation(float(shape))[0] for shape in shapes])[which]
    table[:, NORMALISATION] = constants * table[:, GAIN]
    table[-1, SPECULAR : SPECULAR + 3] = table[-1, MIXTURE] = 0.0
    frame_lobes(table, len(lobes), False)
    model_kernels(model_name, model_name).tabulate(table, len(lobes), False, False, nodes)
    values = np.einsum("c,cn->n", LUMINANCE, nodes[RED : BLUE + 1]).reshape(x.shape)
    return np.where(height > 0.0, np.maximum(values, 0.0), 0.0)
