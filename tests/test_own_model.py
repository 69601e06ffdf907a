"""A lobe model of the user's own: what it becomes when its file, or one that it stands on, is edited."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

_MODEL = """
from brdffit._jit import inline
from brdffit.models import Model
from own_helper import factor

@inline
def profile(q, C, s):
    return {times} * factor() / ((q + C) * (q + C))

@inline
def profile_gradient(q, C, s):
    g = profile(q, C, s)
    return g, -2.0 * g / (q + C), -2.0 * g / (q + C), 0.0

@inline
def log_normalisation(s):
    return 0.0, 0.0

MODEL = Model("own", "one of the user's own", profile, profile_gradient, log_normalisation, "none")
"""
_HELPER = """
from brdffit._jit import inline

FACTOR = {factor}

@inline
def factor():
    return FACTOR
"""
_VALUE = """
import numpy as np
from brdffit._jit import specialise
from brdffit.halfangle.objective import lobe_values
from brdffit.halfangle.quadrature import NODE_ROWS
from brdffit.models import get_model

model = get_model("own")
kernel = specialise(lobe_values, "_own", profile=model.profile)
nodes, values = np.zeros((NODE_ROWS, 1), np.float32), np.zeros(1, np.float32)
nodes[2] = 1.0
theta = np.array([0.0, 0.0, -2.0, -2.0, 0.0, 0.0])
kernel(theta, nodes, model.log_normalisation, values, np.zeros(16))
print(float(values[0]))
"""


@pytest.fixture
def value(tmp_path):
    """What a new process makes of the lobe's peak, with the two files written anew; compiled kernels are kept."""
    package = tmp_path / "package"
    info = package / "own-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[brdffit.models]\nown = own_lobe:MODEL\n")

    def run(times, factor):
        (package / "own_lobe.py").write_text(_MODEL.format(times=times))
        (package / "own_helper.py").write_text(_HELPER.format(factor=factor))
        path = os.pathsep.join([str(package), str(ROOT)])
        told = subprocess.run(
            [sys.executable, "-B", "-c", _VALUE], capture_output=True, text=True, check=True,
            env={**os.environ, "PYTHONPATH": path, "BRDFFIT_CACHE": str(tmp_path / "cache")},
        )  # fmt: skip
        return float(told.stdout)

    return run


@pytest.mark.slow
def test_an_edited_model_gives_its_new_values_in_the_next_process(value):
    first = value(1.0, 1.0)
    assert value(1.0, 1.0) == first
    assert value(100.0, 1.0) == pytest.approx(100.0 * first, rel=1e-5)
    # An edit of what the model's file imports counts as well.
    assert value(100.0, 3.0) == pytest.approx(300.0 * first, rel=1e-5)
