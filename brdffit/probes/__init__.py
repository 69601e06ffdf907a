"""Reflection probes: an environment filtered by lobes of rising roughness into the levels of a cube map.

Source: Manson and Sloan 2016, Fast Filtering of Reflection Probes. The default filter is another one, a quadtree with
an error bound.
"""
