"""The Pareto front of points in time and accuracy, and the price of each dB along it."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from brdffit.tradeoff.record import Point

#: A way must win this much (dB) to stand on the front behind a faster one: less is noise of the sample.
WORTH = 0.005


def with_front(points: Sequence[Point]) -> list[Point]:
    """The points of one set with ``front`` and ``price`` filled in; order kept.

    Every loss minimises something else than the SNR and every model is a target of its own; all are shown, but only
    ways to the same end (GGX, L2) can be dominated by each other and stand on the front.
    """
    comparable = [point for point in points if on_the_same_ground(point)]
    best, last = float("-inf"), None
    found: dict[int, float | None] = {}
    for point in sorted(comparable, key=lambda each: (each.seconds_per_megatexel, -each.snr_db)):
        if point.snr_db > best + WORTH:
            price = None
            if last is not None:
                price = (point.seconds_per_megatexel - last.seconds_per_megatexel) / (point.snr_db - last.snr_db)
            found[id(point)] = price
            best, last = point.snr_db, point
    return [msgspec.structs.replace(point, front=id(point) in found, price=found.get(id(point))) for point in points]


def on_the_same_ground(point: Point) -> bool:
    """Whether a point aims at the least L2 error of a GGX lobe."""
    return point.group not in ("loss", "model")
