"""Reflection probes: an environment filtered by lobes of rising roughness into the levels of a cube map.

After Manson and Sloan 2016 (Fast Filtering of Reflection Probes), with a quadtree of an error bound as the default.
"""
