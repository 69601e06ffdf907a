"""A height map traced as geometry: parallax, masking, shadows and interreflection, which no map of lobes can show.

``heightfield`` defines the surface, ``kernels.traversal`` intersects it with rays and ``kernels.paths`` follows light
on it. ``tracer`` makes it a truth that pictures are compared with, and a source of queries (``queries``) that a neural
material is trained on.
"""
