"""Importance sampling with a level for each sample (Krivanek and Colbert 2008; Manson and Sloan 2016, equation 4)."""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel
from brdffit.probes.kernels.cube import face_of, face_point
from brdffit.probes.kernels.tables import TAP_FACE, TAP_FIELDS, TAP_LEVEL, TAP_U, TAP_V, TAP_WEIGHT, gather


@inline
def tangents(nx, ny, nz):
    """Two unit vectors across a unit normal."""
    ux, uz = (0.0, 1.0) if abs(nz) < 0.999 else (1.0, 0.0)
    tx, ty, tz = -uz * ny, uz * nx - ux * nz, ux * ny
    scale = 1.0 / math.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx * scale, ty * scale, tz * scale
    return tx, ty, tz, ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx


@kernel
def place_samples(samples, face, u, v, texel_area, taps):
    """Fill ``taps`` (samples, TAP_FIELDS) for the texel at (u, v) of a face.

    Samples are x, y, z in the frame of the normal and the solid angle each stands for; a texel's is texel_area J, J =
    (1 + u^2 + v^2)^(-3/2).
    """
    px, py, pz = face_point(face, u, v)
    scale = 1.0 / math.sqrt(px * px + py * py + pz * pz)
    nx, ny, nz = px * scale, py * scale, pz * scale
    tx, ty, tz, bx, by, bz = tangents(nx, ny, nz)
    for k in range(samples.shape[0]):
        x = tx * samples[k, 0] + bx * samples[k, 1] + nx * samples[k, 2]
        y = ty * samples[k, 0] + by * samples[k, 1] + ny * samples[k, 2]
        z = tz * samples[k, 0] + bz * samples[k, 1] + nz * samples[k, 2]
        g, s, t = face_of(x, y, z)
        row = taps[k]
        row[TAP_FACE], row[TAP_U], row[TAP_V], row[TAP_WEIGHT] = g, s, t, samples[k, 2]
        row[TAP_LEVEL] = 0.5 * math.log2(samples[k, 3] / texel_area) + 0.75 * math.log2(1.0 + s * s + t * t)


@kernel
def filter_by_importance(samples, n, first, last, pyramids, offsets, sizes, out):
    """Texels of rows first to last (over all faces) of a level (6, n, n, 3) from flat pyramids (3, ...)."""
    taps = np.empty((samples.shape[0], TAP_FIELDS))
    for line in range(first, last):
        face, j = line // n, line % n
        for i in range(n):
            u, v = (2.0 * i + 1.0) / n - 1.0, 1.0 - (2.0 * j + 1.0) / n
            place_samples(samples, face, u, v, 4.0 / (sizes[0] * sizes[0]), taps)
            red, green, blue = gather(taps, samples.shape[0], pyramids, offsets, sizes)
            out[face, j, i, 0], out[face, j, i, 1], out[face, j, i, 2] = red, green, blue
