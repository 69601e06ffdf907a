"""Scenes: the cameras and lights of a surface, and a plan of what its bake must compute for them."""
