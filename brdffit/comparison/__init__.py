"""The comparison: bake by every method, render, measure; records come out, nothing is drawn."""

from brdffit.comparison.ask import Ask, Listener
from brdffit.comparison.compare import PictureFiles, compare

__all__ = ["Ask", "Listener", "PictureFiles", "compare"]
