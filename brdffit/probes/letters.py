"""Pictures of the faces of a cube map with their names on them, which show whether a file is turned or mirrored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from brdffit.probes.cubemap import FACES, face_coordinates, face_points, latlong_directions, look_up
from brdffit.probes.picture import Sheet, exposure_of, toned
from brdffit.probes.reading import CELLS

#: Texels along a face, pixels between faces, and pixels of a line of text.
_SIZE, _GAP, _TITLE = 128, 4, 18
#: Points (u, v) beyond the right and the upper edge of a face.
_OVER = ((np.array(1.5), np.array(0.0)), (np.array(0.0), np.array(1.5)))
_COLOURS = np.array(
    [[0.9, 0.25, 0.2], [0.45, 0.1, 0.1], [0.3, 0.8, 0.3], [0.1, 0.4, 0.15], [0.3, 0.45, 0.95], [0.12, 0.18, 0.5]]
)


def lettered_cube(n: int = _SIZE) -> NDArray:
    """(6, n, n, 3) float32: each face in its own colour with its name, legible for a viewer inside the cube.

    Stored faces show the letters mirrored: a viewer who looks along -Z, +Y up, has +X on the right, where the stored
    face -Z has its left edge.
    """
    font = ImageFont.load_default(n // 2)
    faces = []
    for name, colour in zip(FACES, _COLOURS, strict=True):
        stencil = Image.new("L", (n, n), 0)
        draw = ImageDraw.Draw(stencil)
        draw.text((n // 2, n // 2), name, fill=255, font=font, anchor="mm")
        draw.rectangle((0, 0, n - 1, n - 1), outline=96)
        ink = np.asarray(stencil, np.float32)[:, ::-1, None] / 255.0
        faces.append((1.0 - ink) * colour.astype(np.float32) + ink)
    return np.stack(faces).astype(np.float32)


def draw_faces(cube: NDArray, path: Path, title: str) -> None:
    """Draw a cube map (6, n, n, 3) as a cross, each face with its name, and as a lat-long picture below.

    Faces are drawn as files hold them, u to the right and v up: mirrored, compared with what a viewer inside the cube
    sees. Each name is followed by the faces beyond its right and its upper edge.

    Args:
        cube: radiance of any size; it is drawn at 128 pixels a face.
        path: the PNG file.
        title: text at the top.
    """
    exposure, n = exposure_of(cube), _SIZE
    sheet = Sheet(4 * (n + _GAP) + _GAP, 5 * n + 5 * _GAP + 2 * _TITLE)
    sheet.text(_GAP, 3, title)
    for face, (row, column) in enumerate(CELLS["horizontal-cross"]):
        x, y = _GAP + column * (n + _GAP), _TITLE + row * (n + _GAP)
        sheet.put(x, y, np.asarray(Image.fromarray(toned(cube[face], exposure)).resize((n, n), Image.Resampling.BOX)))
        right, up = (FACES[int(face_coordinates(face_points(*way)[face])[0])] for way in _OVER)
        sheet.text(x + 3, y + 2, f"{FACES[face]}  right {right}, up {up}", outlined=True)
    height = _TITLE + 3 * (n + _GAP)
    sheet.text(_GAP, height + 2, "looked up as stored: lat-long, the middle along -Z, +X a quarter to the right", 200)
    sheet.put(_GAP, height + _TITLE, toned(look_up(cube, latlong_directions(2 * n)), exposure))
    sheet.write(path)
