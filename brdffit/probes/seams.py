"""Seams: whether errors of a filtered level step more across the edges of a cube than just inside of them.

A ratio of one level of one environment says little: it hangs on whether the brightest lamp's largest error lies in the
row at an edge (up to 2) or in the one behind (near 0). A seam is what is left of that when lamps lie anywhere, hence
the environment is turned about random axes, and steps are summed over the turns.
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
    """Sums of the steps (absolute differences) of a cube map (6, n, n) across its edges, and just inside of them."""
    padded, across, beside = pad(values), 0.0, 0.0
    for quarter in range(4):
        turned = np.rot90(padded, quarter, axes=(1, 2))[:, :, 1:-1]
        across += float(np.abs(turned[:, 1] - turned[:, 0]).sum())
        beside += float(np.abs(turned[:, 2] - turned[:, 1]).sum())
    return across, beside


def seam_ratios(
    cube: NDArray, requests: Sequence[LevelRequest], options: FilterOptions, turns: int, seed: int = 0
) -> dict[int, float]:
    """Steps of the relative error across edges over those beside them, for each level, summed over ``turns``.

    Args:
        cube: (6, N, N, 3) environment; the first turn leaves it as it is.
        requests: levels of one lobe a texel.
        options: how they are filtered; they are not measured first.
        turns: how many orientations.
        seed: of the orientations.
    """
    sums = {request.level: np.zeros(2) for request in requests}
    for number, rotation in enumerate(Rotation.random(turns, rng=np.random.default_rng(seed))):
        at = directions(cube.shape[1])
        turned = cube if number == 0 else look_up(cube, at @ rotation.as_matrix()).astype(np.float32)
        source = packed_source(turned)
        for request, level in zip(requests, filter_levels(turned, requests, options, measure=False), strict=True):
            normals = directions(request.n).reshape(-1, 3)
            exact = filtered_exactly(source, normals, request.alpha, options.threads).sum(axis=1)
            error = level.radiance.reshape(-1, 3).sum(axis=1) / np.maximum(exact, 1e-30) - 1.0
            sums[request.level] += edge_steps(error.reshape(6, request.n, request.n))
    return {level: float(across / max(beside, 1e-30)) for level, (across, beside) in sums.items()}
