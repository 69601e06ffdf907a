"""Kernels of the learned modes: moments, tables of the objective, interpolation; an edit here compiles them anew."""
