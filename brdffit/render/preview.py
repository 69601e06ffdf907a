"""One picture that shows what a bake gains: averaged MIPs, the baked ones and the reference, lit at three distances.

Each ball shows one MIP level, one texel a pixel, as a camera sees it that has moved away until a pixel covers 2^level
base texels: the texture repeats more often the farther it is. The reference is that of every other picture, see
``reference``: it knows nothing of pyramids.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from brdffit.render import metrics
from brdffit.render.ball import Part, lit_balls, over_background, reference_balls
from brdffit.render.pictures import Drawable, appearance_of
from brdffit.svbrdf import Svbrdf, level_sizes

#: MIP levels shown, near to far.
LEVELS = (1, 3, 5)
#: Diameter of a ball in pixels.
BALL = 208
_MARGIN, _GAP, _LEFT, _HEADER, _CAPTION = 28, 26, 84, 64, 46
_BACKGROUND = np.array([0.010, 0.011, 0.014], np.float32)
_INK, _DIM = (236, 238, 242), (140, 146, 156)
#: Mean luminance of the reference's balls, before the curve.
_KEY = 0.36
_DISTANCES = {1: ("far",), 2: ("near", "far"), 3: ("near", "middle", "far")}


class _Row(NamedTuple):
    """One distance: its level, and of before, after and reference two estimates (2, n, n, 3) each."""

    level: int
    balls: list[NDArray]


def make_preview(
    base: Svbrdf,
    before: Drawable,
    after: Drawable,
    *,
    title: str = "",
    name: str = "",
    levels: Sequence[int] = LEVELS,
    ball: int = BALL,
    threads: int | None = None,
) -> NDArray:
    """The comparison picture.

    Args:
        base: what was baked.
        before: the averaged channels of ``base``.
        after: the result that is shown beside them.
        title: name of the set.
        name: of the method; "" takes it from ``after``.
        levels: MIP levels shown, near to far; those that do not exist are left out (one is always shown).
        ball: diameter of a ball in pixels.
        threads: worker threads; None takes one a core. The picture does not depend on it.

    Returns:
        (H, W, 3) uint8, sRGB.
    """
    name = name or getattr(after, "method", "")
    depth = min(_depth(each, base.size) for each in (before, after))
    shown = [level for level in levels if level < depth] or [depth - 1]
    part = Part.of(base.size, max(shown))
    columns = [lit_balls(each, shown, ball, part, threads=threads) for each in (before, after)]
    columns.append(reference_balls(base, shown, ball, part, threads=threads))
    rows = [_Row(level, [column[k] for column in columns]) for k, level in enumerate(shown)]
    mean = float(np.mean([row.balls[2].mean() for row in rows])) * 4.0 / np.pi
    return _compose(rows, _KEY / max(mean, 1e-6), ("averaged", _heading(name), "reference"), title)


def _depth(drawn: Drawable, size: tuple[int, int]) -> int:
    """The number of levels of a result; of an appearance without ``levels``, all down to 1x1."""
    levels = getattr(appearance_of(drawn), "levels", None)
    return len(level_sizes(size)) if levels is None else len(levels)


def _heading(name: str) -> str:
    """A method's name as shown; our own method has the program's name."""
    return "brdffit" if name in ("bfgs", "") else name.rpartition(":")[2]


def _compose(rows: Sequence[_Row], exposure: float, names: Sequence[str], title: str) -> NDArray:
    """Balls with their captions on a dark ground."""
    ball = rows[0].balls[0].shape[1]
    width = _MARGIN + _LEFT + 3 * ball + 2 * _GAP + _MARGIN
    height = _HEADER + len(rows) * (ball + _CAPTION) + _MARGIN
    ground = np.round(255.0 * metrics.tone_map(_BACKGROUND / exposure, exposure)).astype(np.uint8)
    picture = Image.fromarray(np.broadcast_to(ground, (height, width, 3)).copy())
    draw = ImageDraw.Draw(picture)
    lefts = [_MARGIN + _LEFT + column * (ball + _GAP) for column in range(3)]
    for name, left in zip(names, lefts, strict=True):
        draw.text((left + ball // 2, _HEADER // 2), name, _INK, _fitting(name, ball), anchor="mm")
    distances = _DISTANCES.get(len(rows), ("",) * len(rows))
    for number, (row, distance) in enumerate(zip(rows, distances, strict=True)):
        top = _HEADER + number * (ball + _CAPTION)
        draw.text((_MARGIN, top + ball // 2 - 10), distance, _INK, _font(18), anchor="lm")
        draw.text((_MARGIN, top + ball // 2 + 12), f"level {row.level}", _DIM, _font(13), anchor="lm")
        ground_radiance = _BACKGROUND / exposure
        shown = [metrics.tone_map(over_background(each.mean(axis=0), ground_radiance), exposure) for each in row.balls]
        for column, (left, displayed) in enumerate(zip(lefts, shown, strict=True)):
            picture.paste(Image.fromarray(np.round(255.0 * displayed).astype(np.uint8)), (left, top))
            if column < 2:
                for line, text in enumerate(_figures(row.balls[column], row.balls[2], displayed, shown[2])):
                    at = left + ball // 2, top + ball + 12 + 15 * line
                    draw.text(at, text, _DIM, _fitting(text, ball, 13), anchor="mm")
    draw.text((_MARGIN, height - _MARGIN // 2 - 2), title, _DIM, _fitting(title, width - 2 * _MARGIN, 13), anchor="lm")
    return np.asarray(picture)


def _figures(halves: NDArray, reference: NDArray, displayed: NDArray, displayed_reference: NDArray) -> tuple[str, str]:
    """How far a ball is from its reference: in the light that reaches the eye, and in what is displayed.

    The SNR of the linear radiance weighs highlights, where most of the light is; the RMS of the displayed values weighs
    the dark parts as much; FLIP is what an eye notices when it flips between both.
    """
    snr = metrics.snr_db_of_halves(halves, reference)
    disc = np.pi / 4.0  # the rest of the square is the same ground in both
    off = float(np.sqrt(np.square(displayed - displayed_reference).mean() / disc))
    flip = metrics.flip_ldr(displayed, displayed_reference)
    return f"SNR {min(snr, 99.0):.1f} dB", f"displayed {100.0 * off:.1f}% off, FLIP {flip:.3f}"


@cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def _fitting(text: str, width: int, size: int = 24) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """The largest font up to ``size`` in which a line of text fits into ``width`` pixels, but never less than 8."""
    while size > 8 and _font(size).getlength(text) > width:
        size -= 1
    return _font(size)
