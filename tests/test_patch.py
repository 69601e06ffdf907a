"""A sample that stands for a part of a bilinear patch is the lobe nearest to the average over that part."""

import numpy as np
import pytest
from scipy.optimize import minimize
from test_fitting import surface

from brdffit.halfangle.apparent_lobe import DIFFUSE_MOMENT, Strata, base_of, gather_lobes
from brdffit.halfangle.closed_forms import widen_lobes
from brdffit.halfangle.quadrature import GAIN, LOBE_COLUMNS, SPECULAR, TENSOR

ALPHA = 0.02
GRID = np.stack(np.meshgrid(*[np.linspace(-16, 16, 257)] * 2), axis=-1)
PARTS = (np.arange(24) + 0.5) / 24


def lobe(at, tensor):
    """A sharp GGX lobe over the plane of slopes in units of alpha."""
    xx, yy, xy = tensor
    x, y = GRID[..., 0] - at[0], GRID[..., 1] - at[1]
    determinant = xx * yy - xy * xy
    q = (yy * x * x + xx * y * y - 2 * xy * x * y) / determinant
    return 1.0 / (np.pi * np.sqrt(determinant) * (1.0 + q) ** 2)


def missed(target, found):
    """Relative squared error of a lobe of the best scale."""
    return float(1.0 - (target * found).sum() ** 2 / ((target**2).sum() * (found**2).sum()))


def patch(turn_x, turn_y, rougher, brighter=1.0):
    """A base of 2x2 texels: normals turn by so many lobe widths a texel, roughness and colour grow along x."""
    slopes = np.zeros((2, 2, 2))
    slopes[:, 1, 0] += ALPHA * turn_x
    slopes[1, :, 1] += ALPHA * turn_y
    base = surface(size=(2, 2), slopes=slopes - slopes.mean(axis=(0, 1)), alpha=ALPHA).replace(wrap="clamp")
    base.log_roughness[:, 1, :2] += 4.0 * np.log(rougher)
    base.specular[:, 1] *= brighter
    return base


def truth(base):
    """The average over the patch, of slopes and perceptual roughness as a renderer interpolates them."""
    total = 0.0
    normal, perceptual = base.normal.astype(float), np.exp(0.25 * base.log_roughness[..., 0].astype(float))
    for v in PARTS:
        for u in PARTS:
            w = np.array([[(1 - u) * (1 - v), u * (1 - v)], [(1 - u) * v, u * v]])
            n = (w[..., None] * normal).sum(axis=(0, 1))
            alpha2 = ((w * perceptual).sum() ** 2 / ALPHA) ** 2
            total = total + (w * base.specular[..., 0]).sum() * lobe(n[:2] / n[2] / ALPHA, (alpha2, alpha2, 0.0))
    return total / PARTS.size**2


def sample(base):
    """The one sample of the whole patch: where it stands in the plane, its tensor, and its weight."""
    strata = Strata(*(np.array([-0.25, 0.25]),) * 2, *(np.array([0.5, 0.5]),) * 2, 0.0, 0.0, 2.0, 2.0, 0, merge=99.0)
    lobes = np.zeros((8, LOBE_COLUMNS))
    packed = base_of(base)
    count, _ = gather_lobes(packed, strata, 99.0, 0, 0, lobes, np.zeros(DIFFUSE_MOMENT))
    assert count == 1
    widen_lobes(lobes, count, packed.isotropic, packed.widening)
    found = lobes[0]
    return found[:2] / found[2] / ALPHA, found[TENSOR : TENSOR + 3] / ALPHA**2, float(found[SPECULAR] * found[GAIN])


# Excess over the best lobe: small where it may have any scale, a third where its energy is kept (LEAN's: 1 to 2).
@pytest.mark.parametrize(
    "turn_x, turn_y, rougher, brighter, excess",
    [
        (0.3, 0.0, 1.0, 1.0, 0.02), (0.5, 0.0, 1.0, 1.0, 0.05), (1.0, 0.0, 1.0, 1.0, 0.2), (2.0, 0.0, 1.0, 1.0, 0.25),
        (1.0, 1.0, 1.0, 1.0, 0.4), (2.0, 2.0, 1.0, 1.0, 0.4), (0.0, 0.0, 1.09, 1.0, 0.05), (0.3, 0.0, 1.09, 1.0, 0.05),
        (0.5, 0.3, 0.92, 1.0, 0.1), (0.5, 0.0, 1.0, 1.4, 0.05), (0.0, 0.0, 1.09, 1.4, 0.1), (0.5, 0.3, 0.92, 1.4, 0.1),
    ],
)  # fmt: skip
def test_a_sample_misses_the_average_over_its_part_by_hardly_more_than_the_best_lobe(
    turn_x, turn_y, rougher, brighter, excess
):
    base = patch(turn_x, turn_y, rougher, brighter)
    target, (at, tensor, _) = truth(base), sample(base)

    def error(v):
        return missed(target, lobe(v[:2], (np.exp(v[2]), np.exp(v[3]), v[4])))

    start = [*at, *np.log(tensor[:2]), tensor[2]]
    best = minimize(error, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-9, "maxiter": 2000}).fun
    assert error(start) <= best * (1.0 + excess) + 2e-6


@pytest.mark.parametrize("turn", [0.5, 1.0, 2.0, 4.0])
def test_leans_tensor_misses_by_more(turn):
    base = patch(turn, 0.0, 1.0)
    target, (at, tensor, _) = truth(base), sample(base)
    lean = missed(target, lobe(at, (1.0 + 2.0 * turn**2 / 12.0, 1.0, 0.0)))
    assert lean > 1.3 * missed(target, lobe(at, tensor))


@pytest.mark.parametrize("turn", [2.0, 3.5, 5.0])
def test_a_wide_part_has_the_nearest_lobe_that_keeps_its_energy(turn):
    base = patch(turn, 0.0, 1.0)
    target, (at, tensor, _) = truth(base) / base.specular[0, 0, 0], sample(base)

    def error(v):
        return float(((target - lobe(v[:2], (np.exp(v[2]), np.exp(v[3]), 0.0))) ** 2).sum() / (target**2).sum())

    start = [*at, *np.log(tensor[:2])]
    best = minimize(error, start, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-9, "maxiter": 2000}).fun
    assert error(start) <= best * 1.03


def test_the_weight_of_a_narrow_part_follows_the_best_scale():
    base = patch(0.3, 0.3, 1.0)
    target, (at, tensor, weight) = truth(base), sample(base)
    found = lobe(at, tensor)
    assert weight == pytest.approx(float((target * found).sum() / (found**2).sum()), rel=0.002)


@pytest.mark.parametrize("turn", [0.0, 0.5, 1.0, 2.0, 5.0])
@pytest.mark.parametrize("rougher", [1.0, 1.05, 1.09])
def test_no_parts_energy_is_wrong_by_more_than_a_percent(turn, rougher):
    """A lobe's energy is its scale: from afar, where parts overlap, nothing else of them is seen."""
    base = patch(turn, turn, rougher)
    assert sample(base)[2] == pytest.approx(float(base.specular[..., 0].mean()), rel=0.012)


def test_smooth_parts_stay_as_they_are():
    base = patch(0.0, 0.0, 1.0)
    at, tensor, weight = sample(base)
    assert np.abs(at).max() < 1e-6 and tensor == pytest.approx((1.0, 1.0, 0.0), abs=1e-5)
    assert weight == pytest.approx(float(base.specular[0, 0, 0]), rel=1e-6)
