"""Seams: whether errors of a filtered level change more across the edges of a cube than just inside of them.

The ratio for one environment in one orientation says little: it depends on whether the largest error of the brightest
lamp lies in the row at an edge (up to 2) or in the next one (near 0). So the environment is rotated at random, and the
steps are summed over many orientations.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from brdffit.probes.cubemap import directions, look_up, pad
from brdffit.probes.direct import filtered_exactly, packed_source
from brdffit.probes.filtering import FilterOptions, LevelRequest, filter_levels


def edge_steps(values: NDArray) -> tuple[float, float]:
    """Sums of absolute differences between neighbouring texels of (6, n, n): across the edges, and beside them."""
    padded, across, beside = pad(values), 0.0, 0.0
    for quarter in range(4):
        turned = np.rot90(padded, quarter, axes=(1, 2))[:, :, 1:-1]
        across += float(np.abs(turned[:, 1] - turned[:, 0]).sum())
        beside += float(np.abs(turned[:, 2] - turned[:, 1]).sum())
    return across, beside


def seam_ratios(
    cube: NDArray, requests: Sequence[LevelRequest], options: FilterOptions, turns: int
) -> dict[int, float]:
    """Steps of the relative error across edges over those beside them, by number of level; about 1 without seams.

    Args:
        cube: (6, N, N, 3) environment.
        requests: levels with one lobe a texel (``points`` = 1).
        options: how they are filtered, without measuring them.
        turns: orientations that steps are summed over; the first is the environment as it stands.
    """
    sums = {request.level: np.zeros(2) for request in requests}
    for number, rotation in enumerate(Rotation.random(turns, rng=np.random.default_rng(0))):
        at = directions(cube.shape[1])
        turned = cube if number == 0 else look_up(cube, at @ rotation.as_matrix()).astype(np.float32)
        source = packed_source(turned)
        for request, level in zip(requests, filter_levels(turned, requests, options, measure=False), strict=True):
            normals = directions(request.n).reshape(-1, 3)
            exact = filtered_exactly(source, normals, request.alpha, options.threads).sum(axis=1)
            error = level.radiance.reshape(-1, 3).sum(axis=1) / np.maximum(exact, 1e-30) - 1.0
            sums[request.level] += edge_steps(error.reshape(6, request.n, request.n))
    return {level: float(across / max(beside, 1e-30)) for level, (across, beside) in sums.items()}
