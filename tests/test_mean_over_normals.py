"""A lobe that stands for a part of a footprint is the mean over the part's normals, tails included."""

import numpy as np
import pytest

from brdffit.fitting.batch import model_kernels
from brdffit.halfangle.closed_forms import widen_lobes
from brdffit.halfangle.frame import tangent_frame
from brdffit.halfangle.quadrature import (
    ALPHA_SQUARED,
    DENSITY,
    GAIN,
    LOBE_COLUMNS,
    MEAN,
    NODE_ROWS,
    NORMALISATION,
    RED,
    SPECULAR,
    SPREAD,
    TENSOR,
    frame_lobes,
)
from brdffit.models import get_model

WIDENING = get_model("ggx").widening
# Half vectors around the normal: slopes from a hundredth of alpha to sixty times alpha, and their solid angles.
SLOPES, ANGLES = np.geomspace(0.01, 60.0, 300), np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False) + 0.03


def half_vectors(normal, alpha):
    """(h (n, 3), weights (n,) with the half-angle density, slopes over alpha (n,))."""
    frame = np.array(tangent_frame(*normal))
    r, f = (each.ravel() for each in np.meshgrid(SLOPES * alpha, ANGLES, indexing="ij"))
    h = normal + (r * np.cos(f))[:, None] * frame[:3] + (r * np.sin(f))[:, None] * frame[3:]
    h /= np.linalg.norm(h, axis=1)[:, None]
    return h, np.maximum(h[:, 2], 0.0) ** 3 * r**2 / (1.0 + r**2) ** 1.5, r / alpha


def table(lobes, isotropic, h):
    """T(h) of some lobes; a last, black one is added for the defensive lobe."""
    lobes = np.vstack([lobes, np.zeros((1, LOBE_COLUMNS))])
    lobes[-1, 2] = lobes[-1, TENSOR] = lobes[-1, TENSOR + 1] = 1.0
    nodes = np.zeros((NODE_ROWS, len(h)), np.float32)
    nodes[:3] = h.T
    frame_lobes(lobes, len(lobes) - 1, isotropic)
    model_kernels("ggx", "ggx").tabulate(lobes, len(lobes) - 1, isotropic, True, nodes)
    assert np.all(nodes[DENSITY] >= 0.0)
    return nodes[RED].astype(np.float64)


def lobe(normals, alpha_squared):
    found = np.zeros((len(normals), LOBE_COLUMNS))
    found[:, :3], found[:, ALPHA_SQUARED] = normals, alpha_squared
    found[:, SPECULAR : SPECULAR + 3], found[:, NORMALISATION], found[:, GAIN] = 1.0 / len(normals), 1.0, 1.0
    return found


def both(tilt, alpha, wide, high, turn=0.0, averages=True):
    """(h's weights, slopes, T of lobes on a rectangle of normals, T of the one that stands for it): sides in alphas."""
    normal = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    frame = np.array(tangent_frame(*normal))
    steps = (np.arange(25) + 0.5) / 25 - 0.5
    a, b = (each.ravel() for each in np.meshgrid(wide * alpha * steps, high * alpha * steps, indexing="ij"))
    a, b = np.cos(turn) * a - np.sin(turn) * b, np.sin(turn) * a + np.cos(turn) * b
    normals = normal + a[:, None] * frame[:3] + b[:, None] * frame[3:]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    h, weights, slopes = half_vectors(normal, alpha)
    # Half of the width is the lobe's own, half the light's.
    one = lobe(normal[None], 0.5 * alpha**2)
    one[0, SPREAD : SPREAD + 3] = 2 * np.mean(a * a), 2 * np.mean(b * b), 2 * np.mean(a * b)
    widen_lobes(one, 1, True, WIDENING, 0.5 * alpha**2, averages)
    one[0, NORMALISATION] *= one[0, GAIN]
    return weights, slopes, table(lobe(normals, alpha**2), True, h), table(one, False, h)


def missed(weights, truth, found):
    return float((weights * (truth - found) ** 2).sum() / (weights * truth**2).sum())


# Squared error, and how far the light far away is off: second order, so a side of 2.5 widths is off by more.
@pytest.mark.parametrize(
    "wide, high, error, far", [(1.0, 1.0, 2e-4, 0.01), (2.5, 0.0, 3e-3, 0.05), (2.5, 1.0, 4e-3, 0.05)]
)
@pytest.mark.parametrize("alpha", [0.05, 0.2])
@pytest.mark.parametrize("tilt, turn", [(0.0, 0.0), (0.8, 0.0), (0.8, 0.6)])
def test_it_is_the_mean_and_its_tail_is_right(tilt, turn, alpha, wide, high, error, far):
    weights, slopes, truth, found = both(tilt, alpha, wide, high, turn)
    assert missed(weights, truth, found) < error
    beyond = weights * (slopes > 8.0)
    assert (beyond * found).sum() == pytest.approx((beyond * truth).sum(), rel=far)
    assert (weights * found).sum() == pytest.approx((weights * truth).sum(), rel=0.02)
    # The nearest single lobe misses by ten times as much, mostly because it is too bright far away.
    *_, nearest = both(tilt, alpha, wide, high, turn, averages=False)
    assert missed(weights, truth, nearest) > 5.0 * missed(weights, truth, found)
    assert (beyond * nearest).sum() > 1.15 * (beyond * truth).sum()


@pytest.mark.parametrize("wide, high", [(5.0, 0.0), (5.0, 5.0), (40.0, 0.0), (40.0, 3.0)])
def test_it_stays_positive_where_the_expansion_fails(wide, high):
    weights, _, truth, found = both(0.3, 0.05, wide, high, 0.4)
    assert found.min() > 0.0
    *_, single = both(0.3, 0.05, wide, high, 0.4, averages=False)
    assert missed(weights, truth, found) < missed(weights, truth, single)


def test_point_lights_and_other_models_keep_single_lobes():
    for light, averages in ((0.0, True), (0.01, False)):
        one = lobe(np.array([[0.0, 0.0, 1.0]]), 0.01)
        one[0, SPREAD : SPREAD + 3], one[0, MEAN : MEAN + 3] = 0.01, 7.0
        widen_lobes(one, 1, True, WIDENING, light, averages)
        assert not one[0, MEAN : MEAN + 3].any()
    assert not get_model("beckmann").averages
