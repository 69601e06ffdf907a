"""A folder of maps, and the shared real sets where they are present."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from numpy.typing import NDArray
from pictures import write_image

REAL_SETS = Path(__file__).resolve().parents[2].parent / "shared" / "materials"


@pytest.fixture(scope="session")
def real_sets() -> Path:
    """The folder of real texture sets."""
    if not (REAL_SETS / "materials.json").exists():
        pytest.skip("needs the real texture sets in ../shared/materials")
    return REAL_SETS


@pytest.fixture
def make_folder(tmp_path: Path) -> Callable[..., Path]:
    """Write images by file name into a folder; a value is pixels, or (pixels, kind)."""

    def make(name: str = "material", **files: NDArray | tuple[NDArray, str]) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        for key, value in files.items():
            stem, _, suffix = key.rpartition("__")
            pixels, kind = value if isinstance(value, tuple) else (value, "uint8")
            write_image(folder / f"{stem}.{suffix}", pixels, kind)
        return folder

    return make
