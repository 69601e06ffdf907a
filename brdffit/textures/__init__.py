"""Textures in and out: what lies on disk, and its decoding to the program's own terms.

Read with ``texture_set.read_texture_set``, decode with ``conversion.to_svbrdf``.
"""

#: Names of the options that say how a set is read: those of ``reading.read_texture_set`` and of ``TextureSet``.
READING_OPTIONS = ("roles", "normal_y", "wrap", "height_scale", "denoise_normals", "material")
