"""Random numbers by counting: each is a hash of seed, index and dimension, the same whatever the threads.

The hash is the finaliser of SplitMix64 (Steele, Lea and Flood 2014), of which the weights of a sequence are multiples.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline

_STEP = np.uint64(0x9E3779B97F4A7C15)
_PER = 2.0**-53


@inline
def mixed(x):
    """SplitMix64's mix of a 64-bit word."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@inline
def key_of(seed, index):
    """The word that stands for one sample of one seed."""
    return mixed(mixed(np.uint64(seed) + _STEP) ^ (np.uint64(index) * _STEP))


@inline
def uniform(key, dimension):
    """The number in [0, 1) of one dimension of a sample."""
    return np.float64(np.int64(mixed(key + np.uint64(dimension + 1) * _STEP) >> np.uint64(11))) * _PER


@inline
def gaussian_pair(first, second):
    """Two independent normal numbers of two uniform ones (Box and Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - first))
    return radius * math.cos(2.0 * math.pi * second), radius * math.sin(2.0 * math.pi * second)


@inline
def about(axis_x, axis_y, axis_z, cosine, azimuth):
    """The unit vector at an angle (by its cosine) and azimuth about a unit axis.

    The frame is that of Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6(1), 2017.
    """
    sign = 1.0 if axis_z >= 0.0 else -1.0
    a = -1.0 / (sign + axis_z)
    b = axis_x * axis_y * a
    across = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    s, t = across * math.cos(azimuth), across * math.sin(azimuth)
    return (
        s * (1.0 + sign * axis_x * axis_x * a) + t * b + cosine * axis_x,
        s * sign * b + t * (sign + axis_y * axis_y * a) + cosine * axis_y,
        -s * sign * axis_x - t * axis_y + cosine * axis_z,
    )
