"""The error on a screen under lights with a size as training data: what the default fit minimises, of footprints.

Beside the tables of ``tables``, which hold the half-angle error under point lights. A texel has nodes for every size of
light, weighted as a displayed picture weighs errors (``brdffit.fitting.losses``), and the scale of a lobe is bounded as
that of the default fit, so that a lobe that is too wide or too narrow for its energy counts as wrong.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import kernel, numba_type, types
from brdffit.fitting.batch import model_kernels
from brdffit.fitting.losses import set_diffuse_error, weigh_as_seen
from brdffit.fitting.scoring import aim, share_out, target_norm
from brdffit.halfangle import lights
from brdffit.halfangle.albedo import albedo_of, albedo_of_lobes
from brdffit.halfangle.apparent_lobe import (
    DIFFUSE_MOMENT,
    Base,
    Strata,
    example_base,
    example_strata,
    gather_lobes,
    normalise_mixture,
)
from brdffit.halfangle.closed_forms import light_lobes, widen_lobes
from brdffit.halfangle.lights import BASE_BLUR, EVALUATION, evaluate_table, points_of, segment, sizes_of, table_of
from brdffit.halfangle.objective import (
    BOUNDED,
    DIFFUSE,
    DIFFUSE_FORM,
    HELD,
    LOG_LOW,
    SCALE,
    SCALE_HIGH,
    SCALE_LOW,
    SETTINGS,
    TARGET,
    log_normalisation_type,
    moments_type,
)
from brdffit.halfangle.quadrature import (
    H_X,
    H_Y,
    H_Z,
    LOBE_COLUMNS,
    WEIGHT,
    WIDE_AXES,
    frame_lobes,
    lattice,
    normalise_shapes,
    place_nodes,
    tabulate_type,
    weigh_nodes,
)
from brdffit.learned.kernels.moments import CLOSED, DARK, FEATURES, MOMENTS
from brdffit.learned.kernels.tables import EXPONENT, STEP, add_closed_form, one_closed_form, recentred
from brdffit.nets.doubles import EIGHT
from brdffit.roughness import DEFAULT_MIN_ROUGHNESS

#: The lights of the default fit, nodes of a texel for each size, and bounds of the scale over the filtered colour.
LIGHTS, NODES, BOUNDS = "mixed", 48, (0.91, 1.09)
#: Most sizes of light.
_SIZES = 3
_ROWS = (H_X, H_Y, H_Z, WEIGHT, TARGET)


class Shown(NamedTuple):
    """Footprints of n texels.

    ``nodes`` (n, sizes, 5, NODES) float32: h, weight, weighted target relative to the filtered colour; ``scale`` (n,):
    |colour|^2 / <T,T>; ``albedo`` (n,): light of an even sky that the footprint's lobes reflect, see
    ``halfangle.albedo``; ``form`` (n, 6): error of normals in diffuse light; ``glow`` (n,): see ``moments.glow``.
    """

    nodes: NDArray
    scale: NDArray
    albedo: NDArray
    form: NDArray
    glow: NDArray

    def __len__(self) -> int:
        return len(self.scale)

    def is_finite(self) -> NDArray:
        """Which texels (n,) hold finite numbers only."""
        return (
            np.isfinite(self.nodes).all(axis=(1, 2, 3)) & np.isfinite(self.scale) & np.isfinite(self.form).all(axis=1)
        )

    def rows(self, index: NDArray | slice) -> Shown:
        """Some of its texels."""
        return Shown(*(part[index] for part in self))

    @staticmethod
    def joined(tables: list[Shown]) -> Shown:
        """One table of several."""
        return Shown(*(np.concatenate(parts) for parts in zip(*tables, strict=True)))


@cache
def _sizes() -> NDArray:
    from brdffit.models import get_model

    blur = get_model("ggx").blur
    return sizes_of(LIGHTS, blur, blur)


@kernel
def show_rows(
    base, strata, columns, rows, scale_x, scale_y, moments, gathered, lobes, table, out, scale, albedo, form, glow,
    tabulate_kernel, source_log_normalisation,
):  # fmt: skip
    """Fill a ``Shown`` for texels as ``tabulate_rows`` places them; ``moments`` (n, MOMENTS) give the closed forms.

    ``gathered``, ``lobes`` (room, LOBE_COLUMNS) and ``table`` are scratch.
    """
    eightfold, feature, closed = np.zeros(MOMENTS * EIGHT), np.zeros(FEATURES * EIGHT), np.zeros(CLOSED * EIGHT)
    diffuse_moment, colour, setting = np.zeros(DIFFUSE_MOMENT), np.zeros(3), np.zeros(SETTINGS)
    for i in range(columns.size):
        here = recentred(strata, scale_x[i], scale_y[i])
        count, _ = gather_lobes(base, here, STEP, columns[i], rows[i], gathered, diffuse_moment)
        red, green, blue, _ = normalise_mixture(gathered, count)
        colour[0], colour[1], colour[2] = max(red, 1e-9), max(green, 1e-9), max(blue, 1e-9)
        albedo[i] = albedo_of_lobes(gathered, count, base.isotropic)
        bright = 0.0
        for k in range(3):
            x, y, z = diffuse_moment[3 * k], diffuse_moment[3 * k + 1], diffuse_moment[3 * k + 2]
            bright += math.sqrt(x * x + y * y + z * z)
        glow[i] = math.log(bright / max(red + green + blue, 1e-9) + DARK)
        one_closed_form(moments[i], eightfold, feature, closed)
        for s in range(table.lights.shape[0]):
            for j in range(count):
                for k in range(WIDE_AXES):
                    lobes[j, k] = gathered[j, k]
            light = table.lights[s, BASE_BLUR]
            widen_lobes(lobes, count, base.isotropic, base.widening, light)
            add_closed_form(lobes, count, closed)
            light_lobes(lobes, count, count + 1, False, light)
            normalise_shapes(lobes, count, base.has_shape, source_log_normalisation)
            frame_lobes(lobes, count, False)
            nodes = segment(table, s)
            place_nodes(lobes, count, points_of(table, s), EXPONENT, nodes)
            tabulate_kernel(lobes, count, False, base.grey, nodes)
            weigh_nodes(nodes)
            weigh_as_seen(nodes, diffuse_moment, True)
        share_out(table)
        norm = max(target_norm(table), 1e-30)
        set_diffuse_error(table, diffuse_moment, norm, form[i])
        setting[HELD] = BOUNDED
        aim(table, colour, norm, setting)
        scale[i] = setting[SCALE]
        for s in range(table.lights.shape[0]):
            nodes = segment(table, s)
            for k in range(NODES):
                out[i, s, 0, k], out[i, s, 1, k], out[i, s, 2, k] = nodes[H_X, k], nodes[H_Y, k], nodes[H_Z, k]
                out[i, s, 3, k], out[i, s, 4, k] = nodes[WEIGHT, k], nodes[TARGET, k]


@kernel
def shown_rows(
    tables, index, scales, albedos, forms, theta, log_low, low, high, table, error, gradient, scale, weight,
    moments_kernel, log_normalisation,
):  # fmt: skip
    """Error on a screen of lobes theta (n, 5) at their best bounded scale, against texels ``index`` of a ``Shown``.

    ``gradient`` (n, 5) by theta; ``scale`` (n,): the scale that the default fit gives such a lobe, over the filtered
    colour, between ``low`` and ``high``: the best times the light that it loses to masking; ``weight`` (n,) of the
    square of a scale's error. ``table`` is scratch.
    """
    setting, work, full, slope = np.zeros(SETTINGS), np.zeros(EVALUATION), np.zeros(6), np.zeros(6)
    setting[HELD], setting[LOG_LOW], setting[SCALE_LOW], setting[SCALE_HIGH] = BOUNDED, log_low, low, high
    for i in range(index.size):
        t = index[i]
        for s in range(table.lights.shape[0]):
            nodes = segment(table, s)
            for k in range(NODES):
                nodes[H_X, k], nodes[H_Y, k], nodes[H_Z, k] = tables[t, s, 0, k], tables[t, s, 1, k], tables[t, s, 2, k]
                nodes[WEIGHT, k], nodes[TARGET, k] = tables[t, s, 3, k], tables[t, s, 4, k]
        setting[SCALE] = scales[t]
        for k in range(DIFFUSE_FORM):
            setting[DIFFUSE + k] = forms[t, k]
        for p in range(5):
            full[p] = theta[i, p]
        error[i] = 1.0 + evaluate_table(full, table, setting, moments_kernel, log_normalisation, slope, work)
        best = min(max(work[0] / max(work[1], 1e-30), low), high)
        rendered = albedos[t] / max(albedo_of(full), 0.01) if albedos[t] > 0.0 else 1.0
        scale[i] = min(max(rendered * best, low), high)
        weight[i] = work[1] * setting[SCALE]
        for p in range(5):
            gradient[i, p] = slope[p]


def _scratch() -> lights.Table:
    return table_of([lattice(NODES)] * len(_sizes()), _sizes())


@cache
def _showing_kernel() -> Any:
    """``show_rows`` compiled for function-typed arguments: it reaches the disk cache."""
    index, line, square = np.zeros(1, np.int64), np.zeros(1), np.zeros((1, 1))
    data = (
        example_base(), example_strata(), index, index, line, line, square, square, square, _scratch(),
        np.zeros((1, 1, 1, 1), np.float32), line, line, square, line,
    )  # fmt: skip
    show_rows.compile((*map(numba_type, data), tabulate_type(types.float32), log_normalisation_type))
    show_rows.disable_compile()
    return show_rows


@cache
def _shown_kernel() -> Any:
    """``shown_rows``, likewise."""
    index, line, square = np.zeros(1, np.int64), np.zeros(1), np.zeros((1, 1))
    data = (
        np.zeros((1, 1, 1, 1), np.float32), index, line, line, square, square, 0.0, 0.0, 0.0, _scratch(), line, square,
        line, line,
    )  # fmt: skip
    shown_rows.compile((*map(numba_type, data), moments_type(types.float32), log_normalisation_type))
    shown_rows.disable_compile()
    return shown_rows


def show(base: Base, strata: Strata, x: NDArray, y: NDArray, room: int, moments: NDArray) -> Shown:
    """Footprints centred at (x[i], y[i]) base texels, as ``tabulate``; ``moments`` (n, MOMENTS) of each."""
    kernels, texels = model_kernels("ggx", "ggx"), len(x)
    columns, rows = np.arange(texels, dtype=np.int64) % 65536, np.arange(texels, dtype=np.int64) // 65536
    made = Shown(
        np.zeros((texels, len(_sizes()), len(_ROWS), NODES), np.float32), np.zeros(texels), np.zeros(texels),
        np.zeros((texels, DIFFUSE_FORM)), np.zeros(texels),
    )  # fmt: skip
    _showing_kernel()(
        base, strata, columns, rows, np.asarray(x) / (columns + 0.5), np.asarray(y) / (rows + 0.5), moments,
        np.zeros((room, LOBE_COLUMNS)), np.zeros((room, LOBE_COLUMNS)), _scratch(), *made, kernels.tabulate,
        kernels.source_log_normalisation,
    )  # fmt: skip
    return made


class ShownErrors(NamedTuple):
    """What ``shown_rows`` fills."""

    error: NDArray
    gradient: NDArray
    scale: NDArray
    weight: NDArray


def shown_errors(shown: Shown, index: NDArray, theta: NDArray) -> ShownErrors:
    """Errors on a screen and gradients of lobes theta (n, 5) at rows ``index`` (n,)."""
    kernels, texels = model_kernels("ggx", "ggx"), len(index)
    found = ShownErrors(np.zeros(texels), np.zeros((texels, 5)), np.zeros(texels), np.zeros(texels))
    _shown_kernel()(
        shown.nodes, index, shown.scale, shown.albedo, shown.form, np.ascontiguousarray(theta),
        4.0 * math.log(DEFAULT_MIN_ROUGHNESS), *BOUNDS, _scratch(), *found, kernels.moments, kernels.log_normalisation,
    )  # fmt: skip
    return found
