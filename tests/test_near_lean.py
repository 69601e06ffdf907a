"""Where LEAN's lobe has a far smaller squared error, the fit's lobe moves towards it, and no further than it must."""

import functools
import math

import numpy as np
import pytest
from hard_cases.catalogue import surface
from hard_cases.displayed_oracle import Lobe, Target, footprint

from brdffit.fitting.near_lean import FIRST_LEVEL, WITHIN, within_of
from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample
from brdffit.halfangle.measure import random_texels

LEVEL, TEXELS = 3, 24
#: Samples of the oracle's footprints along an axis, its half vectors, and how closely its errors agree with the fit's.
SIDE, NODES, AGREE = 64, 8192, 1.15


def brushed():
    """Scratches whose slopes end at once, at 0.1: a lobe that is short enough to be dark beyond them misses them."""
    slopes = np.zeros((64, 64, 2))
    slopes[..., 1] = np.repeat(np.random.default_rng(0).uniform(-0.1, 0.1, (64, 16)), 4, axis=1)
    return surface((64, 64), slopes=slopes, alpha=0.04)


def worn():
    """Flat metal, rough where it is worn: LEAN's mean of alpha^2 is the worse lobe."""
    return surface((64, 64), alpha=np.where(np.random.default_rng(0).random((64, 64)) < 0.3, 0.5, 0.08))


@functools.cache
def fits(make):
    """(base, sample, outputs: as the search found it, as it is, LEAN's lobes)."""
    base = make()
    sample = LevelSample(base, LEVEL, *random_texels((8, 8), TEXELS, seed=0), FitOptions(), threads=1)
    rules, search = sample.settings()
    # Under a bound that nothing keeps every lobe moves all the way.
    outputs = [sample.fit(settings=(rules, search._replace(within=c)))[1] for c in (0.0, search.within, 1e-9)]
    return base, sample, outputs


@functools.cache
def squared_errors():
    """(TEXELS, 3): squared errors of what was found, of the fit and of LEAN's lobe, by an oracle of their own."""
    base, sample, outputs = fits(brushed)
    rng, errors, colour = np.random.default_rng(1), [], float(base.specular.mean())
    for i, (row, column) in enumerate(zip(sample.rows, sample.columns, strict=True)):
        lobes = [Lobe(each.normal[i], each.log_roughness[i]) for each in outputs]
        scales = [float(each.specular[i].mean()) / colour for each in outputs]
        normals, alpha_squared = footprint(base, sample.size, row, column, SIDE, rng)
        target = Target(normals, alpha_squared, colour, 0.0, lobes, NODES, rng, squares=1e6)
        errors.append([target.error(*each) for each in zip(lobes, scales, strict=True)])
    return np.array(errors)


def test_lobes_are_within_the_bound_of_leans_where_they_were_beyond_it():
    found, fit, lean = squared_errors().T
    beyond = found > AGREE * WITHIN * lean
    assert beyond.mean() > 0.5
    assert (fit[beyond] < AGREE * WITHIN * (lean[beyond] + 1e-3)).all()
    assert (fit[beyond] < found[beyond]).all()


def test_lobes_move_no_further_than_they_must():
    found, fit, lean = squared_errors().T
    beyond = found > AGREE * WITHIN * lean
    assert (fit[beyond] > WITHIN * lean[beyond] / AGREE).all()


def test_parameters_and_scale_are_moved_together():
    """All are on the line between the lobe that was found and LEAN's, at the same share of the way."""
    _, _, outputs = fits(brushed)
    found, fit, lean = (np.column_stack([each.log_roughness, each.specular]) for each in outputs)
    way = np.square(lean - found).sum(axis=1)
    share = ((fit - found) * (lean - found)).sum(axis=1) / way
    assert (share > 0.1).mean() > 0.5 and (share < 1.001).all()
    np.testing.assert_allclose(fit, found + share[:, None] * (lean - found), atol=2e-3)


def test_nothing_moves_where_leans_lobe_is_worse():
    _, _, (found, fit, _) = fits(worn)
    for one, other in zip(found, fit, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("loss", ["displayed", "l2", "seen"])
def test_other_losses_keep_what_the_search_found(loss):
    assert within_of(loss, FIRST_LEVEL) == 0.0
    assert within_of("balanced", FIRST_LEVEL - 1) == 0.0
    assert math.isclose(within_of("balanced", FIRST_LEVEL), WITHIN)
