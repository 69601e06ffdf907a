"""The default fit, under lights with a size, over all cases of the catalogue: what its lobes must be whatever the case.

The other laws measure by the half-angle error under point lights, which only a fit for point lights minimises.
"""

import numpy as np
import pytest

from brdffit.fitting.options import FitOptions
from brdffit.fitting.status import FALLBACK, STATUSES
from brdffit.roughness import eigenvalues_of_log
from hard_cases.catalogue import CASES, Case, sample_level

#: The wall of a bounded scale, with what float32 rounds.
MOST_SCALE = 1.1 * (1.0 + 1e-4)


def fit_by_default(case: Case, model: str):
    return sample_level(case.make(model), case.level, FitOptions(model=model, **case.options)).fit()[1]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name.replace(" ", "-"))
def test_lobes_are_finite_and_within_bounds(case):
    for model in case.only or ("ggx",):
        output = fit_by_default(case, model)
        for array in output:
            assert np.isfinite(array).all(), model
        major, minor = eigenvalues_of_log(output.log_roughness)
        least = case.options.get("min_roughness", FitOptions().min_roughness)
        assert major.max() <= 1 + 1e-4 and minor.min() >= least**4 * (1 - 1e-4), model
        np.testing.assert_allclose(np.linalg.norm(output.normal, axis=1), 1.0, atol=1e-5)
        assert (output.normal[:, 2] > 0).all() and (output.specular >= 0).all(), model
        assert (output.status < len(STATUSES)).all(), model
        # Normals below the horizon, which reading lifts, may leave a texel without an answer: it says so.
        assert case.unread or not (output.status == FALLBACK).any(), model
        if not case.options.keys() & {"pixel_filter", "specular"}:
            assert output.specular.max() <= MOST_SCALE * case.make(model).specular.max(), model
