"""The comparison: bake by every method, render, measure; records come out, nothing is drawn."""
