"""What the tests of probes share: small environments with lamps, and exact levels."""

import numpy as np

from brdffit.probes.cubemap import directions
from brdffit.probes.direct import filtered_exactly, packed_source


def lamps(n, seed=0, bright=2000.0):
    """(6, n, n, 3): a soft sky, a darker floor, and a few bright texels."""
    rng = np.random.default_rng(seed)
    up = directions(n)[..., 1:2]
    sky = 0.3 + 0.4 * np.maximum(up, 0.0) * np.array([0.7, 0.9, 1.2]) + 0.1 * rng.random((6, n, n, 3))
    for _ in range(5):
        f, j, i = rng.integers(6), rng.integers(n), rng.integers(n)
        sky[f, j, i] += bright * rng.random(3)
    return sky.astype(np.float32)


def exact_level(cube, n, alpha):
    return filtered_exactly(packed_source(cube), directions(n).reshape(-1, 3), alpha).reshape(6, n, n, 3)


def relative_l1(picture, exact):
    return float(np.abs(picture - exact).sum() / exact.sum())
