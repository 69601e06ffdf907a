"""Share the rows of an image among threads; the kernels that fill them release the interpreter lock."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def over_rows(work: Callable[[int, int], None], rows: int, threads: int) -> None:
    """Call ``work(first, last)`` for ranges that together cover all rows; the ranges must not depend on each other."""
    pieces = min(rows, 8 * threads) if threads > 1 else 1
    edges = [rows * k // pieces for k in range(pieces + 1)]
    if threads == 1:
        work(0, rows)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))
