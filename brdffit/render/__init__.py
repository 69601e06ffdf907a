"""Lighting what a pyramid holds: shading in plain numpy, and the picture that compares a bake with the truth."""
