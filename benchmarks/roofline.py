"""The share of the machine's peak that kernels and fit reach: operations counted, peak measured in the same run."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from benchmarks.materials import NAMED, load_any, real_sets
from benchmarks.record import Section, Target
from brdffit._jit import kernel
from brdffit.fitting.batch import model_kernels
from brdffit.fitting.presets import get_quality
from brdffit.fitting.sampling import LevelSample
from brdffit.halfangle.apparent_lobe import DIFFUSE_MOMENT, gather_lobes
from brdffit.halfangle.measure import random_texels
from brdffit.halfangle.objective import MOMENTS
from brdffit.halfangle.quadrature import LOBE_COLUMNS, NODE_ROWS, frame_lobes
from brdffit.models import model_names
from brdffit.svbrdf import level_sizes
from brdffit.tradeoff.candidates import fixed_nodes

# Operations a node; an exponential or a division counts as one. Moments: 15 for u, v and c; 3 + 1 for q and C; 5 for
# GGX and its derivatives; 12 for products of these and of the weights; 24 for the sums of the target and of the lobe.
MOMENT_FLOP = 60
# A base lobe at a node: 5 for the chord, 6 for sin^2, cos, q and C, 3 for GGX, 5 for the sums (grey, isotropic).
TABLE_FLOP = 19
_NODES = 512
_LANES, _CHAIN = 64, 16
_TURNS = 60
KERNEL_SHARE, BAKE_SHARE = 0.30, 0.15
_SLOWER = 2.0

#: A function to time, and its number of operations.
Job = tuple[Callable[[], object], float]


@kernel
def _multiply_add(x, rounds, m, c):
    """Chains of a = a * m + c on eight rows of ``x`` (8, lanes): the chains are independent and need little memory.

    m and c are arguments, because a compiler that knew them would fold a chain into one multiply-add.
    """
    for _ in range(rounds):
        for i in range(x.shape[1]):
            p, q, r, s, t, u, v, w = x[0, i], x[1, i], x[2, i], x[3, i], x[4, i], x[5, i], x[6, i], x[7, i]
            for _ in range(_CHAIN):
                p, q, r, s = p * m + c, q * m + c, r * m + c, s * m + c
                t, u, v, w = t * m + c, u * m + c, v * m + c, w * m + c
            x[0, i], x[1, i], x[2, i], x[3, i], x[4, i], x[5, i], x[6, i], x[7, i] = p, q, r, s, t, u, v, w


def measure_roofline(materials: Path, quick: bool) -> Section:
    """Peak of multiply-adds, kernels of every model, and the fit of a level, in one run."""
    section = Section(
        "roofline",
        "Roofline",
        "Float32 operations a second. Peak: chains of multiply-adds that stay in registers and the first cache. "
        f"Moments: value and gradient of the objective, {MOMENT_FLOP} operations a node for GGX (the same count is put "
        f"down for every model, so its column of shares compares times). Bake: {MOMENT_FLOP} a node and evaluation and "
        f"{TABLE_FLOP} a lobe and node, over the time of everything else too. Kernels on one thread, the bake on all.",
    )
    names = {f"moments, {name}": _moments(name) for name in model_names()}
    rates = _rates({"peak, one thread": _peak_work(), **names, "table, ggx": _table()})
    single, full = rates["peak, one thread"], _peak(os.cpu_count() or 1)
    section.rows.append(_row("peak, all threads", full, 1.0))
    section.rows += [_row(what, rate, rate / single) for what, rate in rates.items()]
    shares = []
    real = real_sets(materials)
    for name in ["hammered-metal", *([] if quick else [each for each in NAMED[:2] if each in real])]:
        svbrdf = load_any(name, real.get(name), 1024)
        if isinstance(svbrdf, str):
            section.problems.append(f"{name}: {svbrdf}")
            continue
        for mip_level in (1, 3):
            flop_rate = _bake(svbrdf, mip_level)
            shares.append(flop_rate / full)
            section.rows.append(_row(f"bake, {name}, level {mip_level}", flop_rate, flop_rate / full))
    ggx = rates["moments, ggx"] / single
    slowest = min(model_names(), key=lambda name: rates[f"moments, {name}"])
    ratio = rates["moments, ggx"] / rates[f"moments, {slowest}"]
    section.targets = [
        Target("moments of GGX, share of the peak", f">= {KERNEL_SHARE}", f"{ggx:.2f}", ggx >= KERNEL_SHARE),
        Target("bake, share of the peak", f">= {BAKE_SHARE}", f"worst {min(shares, default=0):.3f}",
               min(shares, default=0) >= BAKE_SHARE),
        Target("slowest model, times GGX", f"<= {_SLOWER}", f"{ratio:.2f} ({slowest})", ratio <= _SLOWER),
    ]  # fmt: skip
    return section


def _row(what: str, rate: float, share: float) -> dict[str, object]:
    return {"what": what, "Gflop/s": rate / 1e9, "share of peak": share}


def _best(work, repeats: int = 5) -> float:  # type: ignore[no-untyped-def]
    """Least seconds of a few runs."""
    took = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        took.append(time.perf_counter() - start)
    return min(took)


def _peak(threads: int) -> float:
    rounds = 20_000
    chains = [np.ones((8, _LANES), np.float32) for _ in range(threads)]
    factor, summand = np.float32(0.999), np.float32(1e-3)
    _multiply_add(chains[0], 1, factor, summand)

    def work() -> None:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(lambda x: _multiply_add(x, rounds, factor, summand), chains))

    return threads * rounds * chains[0].size * _CHAIN * 2 / _best(work)


def _peak_work() -> Job:
    chains, rounds = np.ones((8, _LANES), np.float32), 2_000
    factor, summand = np.float32(0.999), np.float32(1e-3)
    return lambda: _multiply_add(chains, rounds, factor, summand), rounds * chains.size * _CHAIN * 2


def _rates(jobs: dict[str, Job]) -> dict[str, float]:
    """Operations a second of each job. Jobs take turns, so that other load on the machine affects all of them alike."""
    took: dict[str, list[float]] = {what: [] for what in jobs}
    for turn in range(_TURNS):
        for what, (work, _) in jobs.items():
            start = time.perf_counter()
            work()
            if turn:  # the first compiles, or loads
                took[what].append(time.perf_counter() - start)
    return {what: operations / float(np.quantile(took[what], 0.2)) for what, (_, operations) in jobs.items()}


def _moments(model: str) -> Job:
    """The sums for value and gradient of the objective."""
    nodes = np.random.default_rng(0).uniform(0.1, 1.0, (NODE_ROWS, _NODES)).astype(np.float32)
    frame, out = np.array([2.0, 0, 0, 0, 2.0, 0, 0, 0, 1.0]), np.zeros(MOMENTS)
    calls = 500
    arguments = (model_kernels(model, model).moments, nodes, frame, np.float32(0.0), out, calls)
    return lambda: _many_moments(*arguments), calls * _NODES * MOMENT_FLOP


@kernel
def _many_moments(moments, nodes, frame, shape, out, calls):
    for _ in range(calls):
        moments(nodes, frame, shape, out)


@kernel
def _many_tables(tabulate, lobes, count, nodes, calls):
    for _ in range(calls):
        tabulate(lobes, count, True, True, nodes)


def _table() -> Job:
    """The apparent lobe's table."""
    count, calls = 16, 100
    lobes = np.zeros((count + 1, LOBE_COLUMNS))
    lobes[:, 2] = 1.0
    lobes[:, 3:5] = 0.04
    lobes[:, 7:12] = 1.0 / count
    frame_lobes(lobes, count, True)
    nodes = np.random.default_rng(0).uniform(0.1, 1.0, (NODE_ROWS, _NODES)).astype(np.float32)
    arguments = (model_kernels("ggx", "ggx").tabulate, lobes, count, nodes, calls)
    return lambda: _many_tables(*arguments), calls * (count + 1) * _NODES * TABLE_FLOP


def _bake(svbrdf, mip_level: int) -> float:  # type: ignore[no-untyped-def]
    """Operations a second of the fit of a level's texels, on all threads."""
    size = level_sizes(svbrdf.size, mip_level + 1)[mip_level]
    sample = LevelSample(svbrdf, mip_level, *random_texels(size, 16384 >> (2 * mip_level - 2), seed=5))
    # One rule for every texel, so that nodes can be counted.
    quality = fixed_nodes(get_quality("standard"), get_quality("standard").nodes[0])
    settings = sample.settings(quality=quality)
    rules, search = settings
    lobes, moment = np.zeros((rules.room + 1, LOBE_COLUMNS)), np.zeros(DIFFUSE_MOMENT)
    counts = [
        gather_lobes(sample.base, rules.strata, search.step, column, row, lobes, moment)[0]
        for column, row in zip(sample.columns[:500], sample.rows[:500], strict=True)
    ]
    _, output = sample.fit(settings=settings)
    nodes = rules.points[0][0].shape[1]
    flop = float(output.evaluations.sum()) * nodes * MOMENT_FLOP
    flop += len(sample) * float(np.mean(counts)) * nodes * TABLE_FLOP
    return flop / _best(lambda: sample.fit(settings=settings), repeats=3)
