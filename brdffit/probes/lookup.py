"""Error of an engine's look-up against the exact lobe, and levels fitted to minimise it.

A shader reads the levels trilinearly at a level of detail that depends on roughness. Texels with exact values do not
make that read most accurate: between two levels it mixes two lobes, and at a coarse level it widens a narrow one. The
fit changes the texels of all levels but level 0 so that trilinear reads at random directions and levels of detail come
closest to the exact radiance. It minimises the relative L1 error at each roughness by iteratively reweighted least
squares, with a small penalty that keeps texels near their exact values.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, cg

from brdffit.probes.cubemap import border, corners, look_up_trilinear
from brdffit.probes.curves import Curve
from brdffit.probes.tables import texel_directions
from brdffit.probes.tree import Tree, tau_for
from brdffit.roughness import alpha_from_perceptual

#: Perceptual roughnesses at which the error is measured, and random directions for each.
ROUGHNESSES = np.linspace(0.05, 1.0, 12)
DIRECTIONS = 1500
#: Tolerance of the tree that stands for the exact radiance.
_EXACT = 0.001
#: Levels of detail sampled between two levels, share of the texels sampled at each, and the fewest samples.
_PLACES, _SHARE, _FEWEST = 4, 0.5, 3000
_REWEIGHTINGS, _STEPS, _HOLD = 4, 30, 0.02


def random_directions(count: int, seed: int) -> NDArray:
    """(count, 3) unit vectors, even over the sphere."""
    at = np.random.default_rng(seed).normal(size=(count, 3))
    return at / np.linalg.norm(at, axis=1, keepdims=True)


def lookup_errors(
    tree: Tree, levels: list[NDArray], curve: Curve, threads: int = 1, count: int = DIRECTIONS
) -> NDArray:
    """(12,) relative L1 error of a shader's look-up at each of ROUGHNESSES, over ``count`` random directions."""
    out = []
    for index, roughness in enumerate(ROUGHNESSES):
        at = random_directions(count, 100 + index)
        exact = tree.filtered(at, float(alpha_from_perceptual(roughness)), tau_for(_EXACT), threads)
        lod = np.full(count, float(curve.level(np.array(roughness))))
        out.append(np.abs(look_up_trilinear(levels, at, lod) - exact).sum() / exact.sum())
    return np.array(out)


def fitted_to_lookup(
    source: NDArray, levels: list[NDArray], curve: Curve, threads: int = 1
) -> tuple[list[NDArray], float, float]:
    """Levels fitted to the look-up, and the mean error of the look-up before and after, on directions of its own.

    Where the fit does not lower that error, the levels are returned unchanged.

    Args:
        source: (6, N, N, 3) cube map that the levels come from.
        levels: cube maps (6, n, n, 3), exact at their texels; level 0 is not changed.
        curve: roughness curve of the engine.
        threads: workers.
    """
    tree = Tree(source)
    before = float(lookup_errors(tree, levels, curve, threads).mean())
    matrices, wanted, weights = _samples(tree, levels, curve, threads)
    system = sparse.vstack(matrices).tocsr()
    goal, weight = np.concatenate(wanted), np.concatenate(weights)
    start = np.concatenate([level.reshape(-1, 3) for level in levels]).astype(np.float64)
    # Level 0 is not fitted: move its columns to the right-hand side.
    known = levels[0].shape[1] ** 2 * 6
    goal = goal - system[:, :known] @ start[:known]
    system, first = system[:, known:].tocsr(), start[known:]
    fitted = np.stack([_robust(system, goal[:, c], weight, first[:, c]) for c in range(3)], axis=1)
    ends = np.cumsum([level.shape[1] ** 2 * 6 for level in levels[1:]])
    texels = np.split(np.maximum(fitted, 0.0).astype(np.float32), ends[:-1])
    out = [levels[0], *(each.reshape(level.shape) for each, level in zip(texels, levels[1:], strict=True))]
    after = float(lookup_errors(tree, out, curve, threads).mean())
    return (out, before, after) if after < before else (levels, before, before)


def _samples(tree: Tree, levels: list[NDArray], curve: Curve, threads: int) -> tuple[list, list, list]:
    """Blocks of rows: trilinear weights over all texels of all levels, exact radiance, and the weight of each row."""
    sizes = [level.shape[1] for level in levels]
    matrices, wanted, weights = [], [], []
    for below in range(len(levels) - 1):
        for place in range(_PLACES):
            share = (place + 0.5) / _PLACES
            at = _jittered_directions(sizes[max(below, 1)], 1000 * below + place)
            count = len(at)
            alpha = float(alpha_from_perceptual(curve.roughness(np.array(below + share))))
            exact = tree.filtered(at, max(alpha, 1e-3), tau_for(_EXACT), threads)
            blocks: list = [sparse.csr_matrix((count, 6 * n * n)) for n in sizes]
            blocks[below] = (1.0 - share) * _bilinear(at, sizes[below])
            blocks[below + 1] = share * _bilinear(at, sizes[below + 1])
            matrices.append(sparse.hstack(blocks))
            wanted.append(exact)
            # Relative error: every roughness counts the same, whatever its number of directions.
            weights.append(np.full(count, 1.0 / max(float(exact.sum()), 1e-30)))
    return matrices, wanted, weights


def _jittered_directions(n: int, seed: int) -> NDArray:
    """(k, 3) unit directions, jittered within evenly drawn texels of a level of n^2: few lamps are missed by chance."""
    rng = np.random.default_rng(seed)
    times = max(1, int(np.ceil(_FEWEST / (6 * n * n))))
    wanted = np.concatenate([rng.permutation(6 * n * n) for _ in range(times)])
    wanted = wanted[: max(int(_SHARE * len(wanted)), min(_FEWEST, len(wanted)))]
    face, row, column = wanted // (n * n), wanted // n % n, wanted % n
    u = 2.0 * (column + rng.random(len(wanted))) / n - 1.0
    v = 1.0 - 2.0 * (row + rng.random(len(wanted))) / n
    return texel_directions(np.stack([face, u, v], axis=1))


def _bilinear(direction: NDArray, n: int) -> sparse.csr_matrix:
    """(directions, 6 n^2) weights of a seamless bilinear read."""
    face, j, i, down, right = corners(direction, n)
    m = n + 2
    corner = (face * m + j) * m + i
    columns = np.stack([corner, corner + 1, corner + m, corner + m + 1], axis=1)
    values = np.stack([(1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down], axis=1)
    rows = np.repeat(np.arange(len(direction)), 4)
    shape = (len(direction), 6 * m * m)
    return sparse.csr_matrix((values.ravel(), (rows, columns.ravel())), shape) @ _padding(n)


def _padding(n: int) -> sparse.csr_matrix:
    """(6 (n + 2)^2, 6 n^2) matrix from the texels of a cube map to its padded faces, see ``cubemap.pad``."""
    m, where = n + 2, border(n)
    inside = np.arange(6 * m * m).reshape(6, m, m)[:, 1:-1, 1:-1].ravel()
    number = np.full(6 * m * m, -1)
    number[inside] = np.arange(6 * n * n)
    rows = np.concatenate([inside, where.edge, np.repeat(where.corner, 3)])
    columns = number[np.concatenate([inside, where.edge_source, where.corner_source.ravel()])]
    values = np.concatenate([np.ones(len(inside) + len(where.edge)), np.full(3 * len(where.corner), 1.0 / 3.0)])
    return sparse.csr_matrix((values, (rows, columns)), (6 * m * m, 6 * n * n))


def _robust(system: sparse.csr_matrix, goal: NDArray, weight: NDArray, start: NDArray) -> NDArray:
    """Minimise sum weight |system x - goal| near ``start``: conjugate gradients on the reweighted normal equations.

    The preconditioner is the diagonal of the system, which the penalty's weights ``hold`` are proportional to.
    """
    x, square = start.copy(), (len(start), len(start))
    smallest = 1e-3 * float(np.average(np.abs(goal), weights=weight)) + 1e-30
    for _ in range(_REWEIGHTINGS):
        residual = goal - system @ x
        each = weight / np.maximum(np.abs(residual), smallest)
        # The penalty is a fraction of the weight of a texel's own samples; a texel without samples stays as it is.
        hold = _HOLD * np.asarray(system.multiply(system).T @ each).ravel() + 1e-9 * float(each.max())

        def normal(way: NDArray, each: NDArray = each, hold: NDArray = hold) -> NDArray:
            return system.T @ (each * (system @ way)) + hold * way

        right = system.T @ (each * residual) + hold * (start - x)
        diagonal = sparse.diags_array(1.0 / (hold * (1.0 + 1.0 / _HOLD)))
        x += cg(LinearOperator(square, matvec=normal), right, rtol=1e-12, maxiter=_STEPS, M=diagonal)[0]
    return x
