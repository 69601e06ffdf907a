"""An image file read a few rows at a time, where all of it would take too much memory."""

from __future__ import annotations

from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.files.image_io import as_said, error_of, one_line, open_reader


class ImageRows:
    """An image file that is read a few rows at a time; close it, or use it in a ``with`` statement.

    Raises:
        InputError: as ``read_info``, and for a picture that is stored turned, whose rows are no rows of the file.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._reader, self.info = open_reader(self._path, self._path)
        if self.info.orientation != 1:
            self.close()
            raise InputError(f"'{path}' is stored turned, expected a picture that is stored upright, to read its rows.")
        self._reader.seek_subimage(self.info.part, 0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def read(self, first: int, last: int) -> NDArray[np.float32]:
        """Rows ``first`` to ``last`` (excluded) as ``read_image`` has them, (rows, W, C).

        Raises:
            InputError: when they are truncated or damaged.
        """
        spec = self._reader.spec()
        count, tall = spec.nchannels, spec.tile_height
        top, bottom = first, last
        if tall:
            top, bottom = first // tall * tall, min(-(-last // tall) * tall, spec.height)
            left, right = spec.x, spec.x + spec.width
            pixels = self._reader.read_tiles(
                self.info.part, 0, left, right, spec.y + top, spec.y + bottom, 0, 1, 0, count, "float"
            )
        else:
            pixels = self._reader.read_scanlines(self.info.part, 0, spec.y + top, spec.y + bottom, 0, 0, count, "float")
        problem = error_of(self._reader) if self._reader.has_error else ""
        if pixels is None or problem:
            raise InputError(
                f"'{self._path}' is truncated or damaged in rows {first} to {last} ({one_line(problem)}), expected "
                f"{self.info.width}x{self.info.height} pixels."
            )
        rows = np.asarray(pixels, dtype=np.float32).reshape(bottom - top, spec.width, count)
        return np.ascontiguousarray(as_said(self.info, rows[first - top : last - top]))
