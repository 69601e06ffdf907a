"""brdffit: MIP pyramids of materials that keep their appearance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from brdffit.pipeline import bake

__version__ = "0.1.0"
__all__ = ["__version__", "bake"]


def __getattr__(name: str) -> Any:
    # Imported on demand: `brdffit --help` must not pay for Numba and OpenImageIO.
    if name == "bake":
        from brdffit.pipeline import bake

        return bake
    raise AttributeError(f"module 'brdffit' has no attribute {name!r}")
