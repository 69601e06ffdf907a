"""Textures in and out: what lies on disk, and its decoding to the program's own terms.

Read with ``texture_set.read_texture_set``, decode with ``conversion.to_svbrdf``.
"""
