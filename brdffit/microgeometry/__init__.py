"""A height map as geometry: parallax, masking, shadows and interreflection, traced; what no map can show.

``heightfield`` says what surface a material with a height map is, ``kernels.traversal`` where rays meet it and
``kernels.paths`` what they see there; ``tracer`` makes of it a truth that pictures are compared with, and a source of
queries (``queries``) that a neural material is trained on.
"""
