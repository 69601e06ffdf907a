"""Textures in and out: what lies on disk, and its decoding to the program's own terms."""
