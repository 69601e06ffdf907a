"""The error over all pairs of l and v by Monte Carlo, and by the half-angle integral; values and times of both.

The Monte Carlo side is written in NumPy from the definition of GGX. The only kernel that it shares with the integral is
the one that gathers the lobes of the footprint.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.materials import load_procedural
from benchmarks.record import Section, Target
from brdffit.fitting.batch import model_kernels
from brdffit.fitting.options import FitOptions
from brdffit.halfangle.apparent_lobe import DIFFUSE_MOMENT, Base, Strata, base_of, gather_lobes
from brdffit.halfangle.measure import dense_strata, lobe_parameters, measure_rows, random_texels, target_table
from brdffit.halfangle.quadrature import ALPHA_SQUARED, LOBE_COLUMNS, NODE_ROWS, SPECULAR, lattice
from brdffit.methods import get_method
from brdffit.svbrdf import Svbrdf

#: Standard errors within which Monte Carlo must agree: four are exceeded by chance once in 15,000 texels.
AGREEMENT = 4.0
_NODES, _SAMPLES = 4096, (8, 8)
_PAIRS_AT_ONCE = 20_000


class Estimate(NamedTuple):
    """An integral, its standard error (0 where there is none), and the seconds it took."""

    value: float
    error: float
    seconds: float


def measure_integrals(quick: bool) -> Section:
    """Measure LEAN's lobe on level 2 of a rough set: Monte Carlo draws few half vectors inside a sharp lobe."""
    section = Section(
        "integrals",
        "Four dimensions against two",
        "Mean squared error of LEAN's lobe against the filtered lobes over cosine-distributed l and v (Monte Carlo, "
        "with its standard error), and the half-angle integral of the same footprint samples.",
    )
    svbrdf = load_procedural("hammered-metal", 256)
    level = get_method("lean").bake_lobes(svbrdf, FitOptions(lights="point", levels=3))[2].svbrdf
    columns, rows = random_texels(level.size, 3 if quick else 8, seed=4)
    pairs = 400_000 if quick else 2_000_000
    for column, row in zip(columns, rows, strict=True):
        chance, integral = compare(svbrdf, level, int(column), int(row), pairs)
        section.rows.append(
            {
                "texel": f"{column},{row}",
                "4-D": chance.value,
                "standard error": chance.error,
                "2-D": integral.value,
                "difference in standard errors": (chance.value - integral.value) / chance.error,
                "4-D s": chance.seconds,
                "2-D s": integral.seconds,
                "times faster": chance.seconds / integral.seconds,
            }
        )
    worst = max(abs(row["difference in standard errors"]) for row in section.rows)
    section.targets.append(
        Target("4-D against 2-D, in standard errors", f"<= {AGREEMENT:g}", f"{worst:.1f}", worst <= AGREEMENT)
    )
    return section


def compare(svbrdf: Svbrdf, level: Svbrdf, column: int, row: int, pairs: int) -> tuple[Estimate, Estimate]:
    """Estimates of sum_c <(T_c - rho_c D)^2> for one texel of an isotropic GGX base: Monte Carlo in 4-D, and in 2-D."""
    base = base_of(svbrdf)
    strata = dense_strata(svbrdf.size, level.size, "box", _SAMPLES)
    theta = lobe_parameters(level, np.array([column]), np.array([row]))
    scale = level.specular[[row], [column]].astype(np.float64)
    chance = _by_chance(base, strata, column, row, theta[0], scale[0], pairs)
    return chance, _by_integral(base, strata, column, row, theta, scale)


def _by_integral(base: Base, strata: Strata, column: int, row: int, theta: NDArray, scale: NDArray) -> Estimate:
    kernels = model_kernels("ggx", "ggx")
    points = lattice(_NODES)
    error, energy = np.zeros((1, 1)), np.zeros((1, 1))
    at = (np.array([column]), np.array([row]))
    seconds = []
    for _ in range(4):  # the first one compiles
        start = time.perf_counter()
        measure_rows(base, strata, points, *at, 3, theta[None], scale[None], error, energy, kernels.tabulate,
                     kernels.values, kernels.log_normalisation, kernels.source_log_normalisation)  # fmt: skip
        seconds.append(time.perf_counter() - start)
    lobes, nodes = np.zeros((strata.samples + 1, LOBE_COLUMNS)), np.zeros((NODE_ROWS, _NODES), np.float32)
    norm = target_table(base, strata, points, column, row, 3, 0.0, lobes, nodes, np.zeros(64), kernels.tabulate,
                        kernels.source_log_normalisation)[3]  # fmt: skip
    return Estimate(float(error[0, 0] * norm), 0.0, sorted(seconds[1:])[1])


def _by_chance(
    base: Base, strata: Strata, column: int, row: int, theta: NDArray, scale: NDArray, pairs: int
) -> Estimate:
    """Plain Monte Carlo over l and v."""
    start = time.perf_counter()
    lobes = np.zeros((strata.samples + 1, LOBE_COLUMNS))
    count, _ = gather_lobes(base, strata, 0.0, column, row, lobes, np.zeros(DIFFUSE_MOMENT))
    lobes = lobes[:count]
    random = np.random.default_rng((column, row))
    total = squared = 0.0
    done = 0
    while done < pairs:
        some = min(_PAIRS_AT_ONCE, pairs - done)
        half = _cosine_directions(random, some) + _cosine_directions(random, some)
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        cos = half @ lobes[:, 0:3].T
        alpha2 = lobes[:, ALPHA_SQUARED]
        # GGX with an isotropic tensor, by its definition; a lobe ends at its own horizon.
        values = np.where(cos > 0.0, alpha2 / (np.pi * (1.0 + (alpha2 - 1.0) * cos**2) ** 2), 0.0)
        target = values @ lobes[:, SPECULAR : SPECULAR + 3]
        errors = ((target - _anisotropic_ggx(half, theta)[:, None] * scale) ** 2).sum(axis=1)
        total += float(errors.sum())
        squared += float((errors**2).sum())
        done += some
    mean = total / pairs
    deviation = np.sqrt(max(squared / pairs - mean * mean, 0.0) / pairs)
    return Estimate(mean, float(deviation), time.perf_counter() - start)


def _cosine_directions(random: np.random.Generator, count: int) -> NDArray:
    """(count, 3) unit vectors with density (z.v) / pi."""
    u, angle = random.random(count), 2.0 * np.pi * random.random(count)
    radius = np.sqrt(u)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - u)], axis=1)


def _anisotropic_ggx(half: NDArray, theta: NDArray) -> NDArray:
    """D(h) of theta by definition: 1 / (pi sqrt(det Sigma) (u' Sigma^-1 u + (n.h)^2)^2)."""
    normal = np.array([-theta[0], -theta[1], 1.0]) / np.sqrt(1.0 + theta[0] ** 2 + theta[1] ** 2)
    # The shortest rotation from z to n.
    x, y, z = normal
    tangents = np.array([[1 - x * x / (1 + z), -x * y / (1 + z), -x], [-x * y / (1 + z), 1 - y * y / (1 + z), -y]])
    eigenvalues, vectors = np.linalg.eigh([[theta[2], theta[4]], [theta[4], theta[3]]])
    scaled = (half @ tangents.T) @ vectors * np.exp(-0.5 * eigenvalues)
    cos = half @ normal
    values = np.exp(-0.5 * eigenvalues.sum()) / (np.pi * ((scaled**2).sum(axis=1) + cos**2) ** 2)
    return np.where(cos > 0.0, values, 0.0)
