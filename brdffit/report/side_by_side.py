"""One picture of a set: a row for each method and the reference, columns near, mid and far, as Kemppinen et al. 2023,
fig. 7."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from brdffit.report.records import Comparison, SetResult, View
from brdffit.report.summary import DISTANCES, GROUPS, fit_name, view_of

#: Most pixels along the side of a cell: the middle of a view, or all of it, enlarged by a whole factor where that fits.
CELL = 176
_GAP, _LEFT, _HEADER, _CAPTION, _CAPTION_WIDTH = 6, 92, 30, 18, 120
_INK, _DIM, _GROUND = (17, 24, 39), (107, 114, 128), (255, 255, 255)
#: Methods from plain averages to the fit; others come before the fit, in their own order.
_ORDER = ("naive", "lean", "vmf", "mipnet", "latent", "learned")


def ordered(comparison: Comparison, result: SetResult) -> list[str]:
    """The methods of a set from the simplest to the fit."""
    there, fit = [each.method for each in result.methods], fit_name(comparison)
    known = [name for name in _ORDER if name in there and name != fit]
    others = [name for name in there if name not in known and name != fit]
    return known + others + [name for name in there if name == fit]


def side_by_side(
    comparison: Comparison, result: SetResult, pictures: Mapping[str, NDArray], lighting: str
) -> NDArray | None:
    """The picture (h, w, 3) uint8 of a set under one lighting; None where a distance was not drawn.

    Args:
        comparison: the records.
        result: those of the set.
        pictures: (h, w, 3) uint8 by the paths that the records name.
        lighting: see ``summary.GROUPS``.
    """
    views = {distance: view_of(result, lighting, distance) for distance in DISTANCES}
    columns = {distance: view for distance, view in views.items() if view is not None}
    return _composed(columns, ordered(comparison, result), pictures) if len(columns) == len(DISTANCES) else None


def all_side_by_side(
    comparison: Comparison, result: SetResult, pictures: Mapping[str, NDArray]
) -> list[tuple[str, NDArray]]:
    """(lighting, picture) of every lighting that a set was drawn under at all distances."""
    lightings = [lit for _, lit in GROUPS if lit is not None]
    made = [(lit, side_by_side(comparison, result, pictures, lit)) for lit in lightings]
    return [(lit, picture) for lit, picture in made if picture is not None]


def _composed(columns: Mapping[str, View], methods: Sequence[str], pictures: Mapping[str, NDArray]) -> NDArray:
    from PIL import Image, ImageDraw, ImageFont

    names = [*methods, "reference"]
    widest = max(max(pictures[view.reference].shape[:2]) for view in columns.values())
    side = min(CELL, widest * max(1, CELL // widest))
    # Captions need some width, however small the cells are.
    across, step = max(side, _CAPTION_WIDTH) + _GAP, side + _CAPTION + _GAP
    size = (_LEFT + len(columns) * across, _HEADER + len(names) * step)
    sheet = Image.new("RGB", size, _GROUND)
    draw, font, small = ImageDraw.Draw(sheet), ImageFont.load_default(15), ImageFont.load_default(12)
    for row, name in enumerate(names):
        draw.text((4, _HEADER + row * step + side // 2), name, _INK, font, anchor="lm")
    for column, (distance, view) in enumerate(columns.items()):
        left = _LEFT + column * across
        head = distance if view.level is None else f"{distance}, level {view.level:g}"
        draw.text((left + side // 2, _HEADER // 2), head, _INK, font, anchor="mm")
        shots = {shot.method: shot for shot in view.shots}
        for row, name in enumerate(names):
            shot, top = shots.get(name), _HEADER + row * step
            if shot is None and name != names[-1]:
                continue
            path = view.reference if shot is None else shot.picture
            sheet.paste(Image.fromarray(cropped(pictures[path], side)), (left, top))
            if shot is not None and shot.figures is not None:
                text = f"{shot.figures.snr_db:.1f} dB, FLIP {shot.figures.flip_ldr:.3f}"
                draw.text((left + side // 2, top + side + _CAPTION // 2), text, _DIM, small, anchor="mm")
    return np.asarray(sheet)


def cropped(picture: NDArray, side: int = CELL) -> NDArray:
    """The middle (side, side, 3) of a picture, which is first repeated pixel by pixel while it is smaller; what it does
    not reach is white."""
    if picture.ndim == 2:
        picture = np.repeat(picture[..., None], 3, axis=2)
    larger = max(1, side // max(picture.shape[:2]))
    picture = picture.repeat(larger, axis=0).repeat(larger, axis=1)
    out = np.full((side, side, 3), 255, np.uint8)
    spare = [picture.shape[axis] - side for axis in (0, 1)]
    source = tuple(slice(max(0, each // 2), max(0, each // 2) + side) for each in spare)
    part = picture[source]
    top, left = ((side - part.shape[axis]) // 2 for axis in (0, 1))
    out[top : top + part.shape[0], left : left + part.shape[1]] = part
    return out
