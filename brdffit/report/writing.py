"""A comparison on the disk: records, pictures and page, all of them or nothing."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.files.atomic import check_writable, replacing
from brdffit.files.image_io import read_image, write_png
from brdffit.report.page import render_page
from brdffit.report.records import (
    PAGE,
    RECORDS,
    Comparison,
    Report,
    foreign_file,
    picture_names,
    read_records,
    to_json,
    viewer_pages,
)


def check_report_folder(folder: str | os.PathLike[str]) -> None:
    """See that a report can be written there, before hours of work.

    Raises:
        OutputError: when it cannot, or when the folder holds what no comparison wrote.
    """
    check_writable(Path(folder), foreign_file)


def write_report(
    comparison: Comparison,
    pictures: Mapping[str, NDArray],
    folder: str | os.PathLike[str],
    viewer: Mapping[str, str] | None = None,
) -> Path:
    """Write records, pictures and pages; what was there before stays until all is done. Returns the page's path.

    Args:
        comparison, pictures, viewer: see ``Report``.
        folder: of the report.

    Raises:
        OutputError: when it cannot be written.
    """
    names = picture_names(comparison)
    pages = viewer or {}
    comparison = msgspec.structs.replace(comparison, files=sorted([PAGE, *names, *pages]))
    with replacing(Path(folder), foreign_file) as fresh:
        for name in names:
            path = fresh / name
            path.parent.mkdir(parents=True, exist_ok=True)
            write_png(path, pictures[name])
        for name, text in pages.items():
            path = fresh / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        # Records before the page: the page can be drawn again from them.
        (fresh / RECORDS).write_bytes(to_json(comparison))
        (fresh / PAGE).write_text(render_page(comparison, pictures), encoding="utf-8")
    return Path(folder) / PAGE


def read_report(records: str | os.PathLike[str]) -> Report:
    """Records with their pictures and pages from the disk; ``records`` is the JSON file or its folder.

    Raises:
        InputError: when a file is missing, or is not of a comparison.
    """
    path = Path(records)
    path = path / RECORDS if path.is_dir() else path
    comparison = read_records(path)
    pictures = {}
    for name in picture_names(comparison):
        pixels = np.round(255.0 * read_image(_beside(path, name)).pixels).astype(np.uint8)
        pictures[name] = pixels[..., 0] if pixels.shape[2] == 1 else pixels[..., :3]
    viewer = {}
    for name in viewer_pages(comparison):
        try:
            viewer[name] = _beside(path, name).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"'{path}' names the page '{name}', which cannot be read: {error}.") from error
    return Report(comparison, pictures, viewer)


def _beside(records: Path, name: str) -> Path:
    """Path of a file that records name."""
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise InputError(f"'{records}' names the file '{name}', expected one beside it.")
    return records.parent / name
