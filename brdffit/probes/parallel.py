"""Share the rows of an image among threads; the kernels that fill them release the interpreter lock."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def default_threads() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def over_rows(work: Callable[[int, int], None], rows: int, threads: int) -> None:
    """Call ``work(first, last)`` for ranges that together cover all rows; the ranges must not depend on each other."""
    pieces = min(rows, 8 * threads) if threads > 1 else 1
    edges = [rows * k // pieces for k in range(pieces + 1)]
    if threads == 1:
        work(0, rows)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))
