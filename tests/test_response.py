"""The table of how the best lobe answers to the spread of a footprint's lobes."""

import numpy as np
import pytest

from brdffit.fitting.batch import model_kernels
from brdffit.halfangle.closed_forms import widening_at
from brdffit.halfangle.density import DENSITY_EXPONENTS
from brdffit.halfangle.response import (
    ALPHAS,
    ANSWERS,
    COSINES,
    MOMENT_ORDERS,
    OFF_PLANE,
    ROW,
    SECOND,
    THIRD,
    response_of,
)
from brdffit.models import get_model, model_names

#: Models without a shape of their own, which the table is for.
MODELS = [name for name in model_names() if get_model(name).shape_bounds is None]


def table(model, exponent=3, **free):
    kernels = model_kernels(model, model)
    found = {"turns": True, "stretches": True, "held": False} | free
    return response_of(kernels.values, kernels.log_normalisation, exponent, **found).table


def answers(row):
    """{orders of the moment: answers}"""
    return dict(zip(MOMENT_ORDERS, row[: THIRD * ANSWERS].reshape(THIRD, ANSWERS), strict=True))


def test_the_sharp_ggx_lobe_answers_as_derived_on_paper():
    row = table("ggx")[0, -1]
    found = answers(row)
    # Scale, t1, t2, log alpha^2, stretch along, across; a sharp lobe's curvature on the sphere is left: 3 percent.
    expected = {
        (2, 0, 0): (0.4, 0, 0, 2.0, 1.5, 0),
        (0, 2, 0): (0.4, 0, 0, 2.0, -1.5, 0),
        (1, 1, 0): (0, 0, 0, 0, 0, 3.0),
        (1, 0, 1): (0, -1.0, 0, 0, 0, 0),
        (0, 0, 2): (-0.2, 0, 0, -0.5, 0, 0),
        # E[t^2 t] turns the normal by -6/7 of it, of which one axis alone is three quarters in (3, 0, 0), and so on.
        (3, 0, 0): (0, -6 / 7, 0, 0, 0, 0),
    }
    for orders, values in expected.items():
        assert found[orders] == pytest.approx(values, rel=0.05, abs=0.02), orders
    # Normals of covariance c I leave 0.274 c^2.
    off = row[OFF_PLANE:].reshape(SECOND, SECOND)
    assert off[0, 0] + off[2, 2] + 2.0 * off[0, 2] == pytest.approx(0.274, rel=0.1)


@pytest.mark.parametrize("model", MODELS)
def test_widening_of_each_model_is_what_its_sharpest_lobe_answers(model):
    found = answers(table(model)[0, -1])
    size, stretch, gain = get_model(model).widening
    # One axis of variance 1: half of it is mean, half deviation. The power is the scale's over the log determinant's.
    assert 2.0 * found[2, 0, 0][3] == pytest.approx(size, rel=0.05)
    assert 2.0 * found[2, 0, 0][4] == pytest.approx(stretch, rel=0.05)
    assert found[2, 0, 0][0] / (2.0 * found[2, 0, 0][3]) == pytest.approx(gain, abs=0.005)


def test_ggx_widens_less_where_it_is_not_sharp_as_the_table_says():
    size, stretch, _ = get_model("ggx").widening
    for row, alpha in zip(table("ggx")[:, -1], ALPHAS, strict=True):
        found = answers(row)[2, 0, 0] if np.isfinite(row[0]) else None
        at_alpha = widening_at.py_func((size, stretch, 0.0), alpha * alpha)
        if alpha <= 0.7 and found is not None:
            assert at_alpha[0] == pytest.approx(2.0 * found[3], rel=0.1)
        if alpha <= 0.4 and found is not None:
            assert at_alpha[1] == pytest.approx(2.0 * found[4], rel=0.1)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("density", DENSITY_EXPONENTS)
def test_mirrored_footprints_have_mirrored_answers(model, density):
    """Across the tilt all is even or odd: what answers to an odd moment in t2 has an odd part there, and only there."""
    rows = table(model, DENSITY_EXPONENTS[density]).reshape(-1, ROW)
    for row in rows[np.isfinite(rows[:, 0])]:
        for orders, found in answers(row).items():
            even, odd = found[[0, 1, 3, 4]], found[[2, 5]]
            # Values are of single precision, and third differences divide by 0.002.
            assert np.abs(even if orders[1] % 2 else odd).max() < 1e-3 * (np.abs(found).max() + 1.0)


@pytest.mark.parametrize("model", MODELS)
def test_the_table_ends_before_the_horizon(model):
    known = np.isfinite(table(model)[..., 0])
    assert known[0].all() and known[ALPHAS < 0.5, -1].all()
    assert not known[-1, COSINES < 0.9].any()


def test_what_is_not_free_answers_to_nothing():
    assert all(found[0] == 0.0 for found in answers(table("ggx", held=True)[3, 3]).values())
    assert all(not found[1:3].any() for found in answers(table("ggx", turns=False)[3, 3]).values())
    assert all(not found[4:].any() for found in answers(table("ggx", stretches=False)[3, 3]).values())
