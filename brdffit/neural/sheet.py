"""A contact sheet of a neural material: its levels seen at 45 degrees, beside the truth and their difference."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from brdffit.colour import encode_srgb
from brdffit.files.atomic import fresh_file
from brdffit.files.image_io import write_png
from brdffit.neural.kernels.material import QUERY
from brdffit.neural.material import NeuralMaterial
from brdffit.neural.questions import Answers, directions, error_of

#: Pixels of a picture's side, between pictures, and of a line of text.
_SIDE, _GAP, _TITLE = 144, 6, 18
#: Projected directions (+Y up) of the view, 45 degrees from the normal, and of the light, up and to the left.
_VIEW = (0.0, -math.sqrt(0.5))
_LIGHT = (-0.45, 0.25)
#: Samples of each pixel of the truth.
_SAMPLES = 64
_TIMES = 4.0


class LevelFigures(NamedTuple):
    """Mean squared error of one level's picture, without the noise of the truth, and its SNR in dB."""

    mse: float
    snr_db: float


def level_queries(size: tuple[int, int], level: int, side: int = _SIDE) -> NDArray:
    """Queries (side * side, QUERY) of a picture whose pixels are as wide as a texel of this level.

    The view is orthographic, at 45 degrees from the normal, so a pixel covers 1.41 times as much of the plane down as
    across.
    """
    row, column = np.divmod(np.arange(side * side), side)
    queries = np.zeros((side * side, QUERY), np.float32)
    step = float(1 << level)
    queries[:, 0] = np.mod((column + 0.5) * step, size[1])
    queries[:, 1] = np.mod((row + 0.5) * step * math.sqrt(2.0), size[0])
    queries[:, 2] = level
    queries[:, 3:5], queries[:, 5:7] = _LIGHT, _VIEW
    return queries


def draw_sheet(material: NeuralMaterial, answers: Answers | None, path: Path) -> list[LevelFigures]:
    """Write the sheet as a PNG; without ``answers`` it shows the material alone.

    Args:
        material: what is drawn.
        answers: the truth.
        path: the PNG.

    Returns:
        Figures of each level; empty without ``answers``.

    Raises:
        OutputError: when it cannot be written.
    """
    size = material.network.design.size
    columns, titles, figures = [], [], []
    for level in range(len(material.network.layout.sizes)):
        queries = level_queries(size, level)
        height = directions(queries)[0][:, 2:]
        # Both are scaled so that a white diffuse surface facing the light has the value 1.
        seen = material.reader.predict(queries) * (height if material.on_plane else 1.0)
        shown, title = [seen], f"level {level}"
        if answers is not None:
            truths = answers.twice(queries, 7919 * level, _SAMPLES) * (height if answers.on_plane else 1.0)
            error, power = error_of(seen, truths)
            figures.append(LevelFigures(error, 10.0 * math.log10(power / max(error, 1e-12))))
            true = truths.mean(axis=0)
            shown += [true, _TIMES * np.abs(seen - true)]
            title += f"  {1e3 * error:.2f}e-3"
        columns.append([each.reshape(_SIDE, _SIDE, 3) for each in shown])
        titles.append(title)
    with fresh_file(path) as fresh:
        write_png(fresh, _composed(columns, titles))
    return figures


def _composed(columns: list[list[NDArray]], titles: list[str]) -> NDArray:
    exposure = 0.9 / max(float(np.quantile(np.concatenate([each[0] for each in columns]), 0.995)), 1e-6)
    names = ["neural", "truth", f"{_TIMES:.0f}x difference"][: len(columns[0])]
    pitch = _SIDE + _GAP
    canvas = Image.new("RGB", (_TITLE + pitch * len(columns), _TITLE + pitch * len(names)), (24, 24, 24))
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(11)
    for x, (column, title) in enumerate(zip(columns, titles, strict=True)):
        draw.text((_TITLE + x * pitch, 2), title, (220, 220, 220), font)
        for y, picture in enumerate(column):
            codes = np.rint(255.0 * encode_srgb(np.clip(exposure * picture, 0.0, 1.0))).astype(np.uint8)
            canvas.paste(Image.fromarray(codes), (_TITLE + x * pitch, _TITLE + y * pitch))
    for y, name in enumerate(names):
        label = Image.new("RGB", (_SIDE, _TITLE), (24, 24, 24))
        ImageDraw.Draw(label).text((4, 2), name, (220, 220, 220), font)
        canvas.paste(label.rotate(90, expand=True), (0, _TITLE + y * pitch))
    return np.asarray(canvas)
