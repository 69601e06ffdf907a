"""Importance sampling with a level for each sample (Krivanek and Colbert 2008; Manson and Sloan 2016, equation 4)."""

from __future__ import annotations

import math

from brdffit._jit import inline, kernel
from brdffit.probes.kernels.cube import face_of, face_point
from brdffit.probes.kernels.tables import level_between, read_trilinear, splat


@inline
def tangents(nx, ny, nz):
    """Two unit vectors across a unit normal."""
    ux, uz = (0.0, 1.0) if abs(nz) < 0.999 else (1.0, 0.0)
    tx, ty, tz = -uz * ny, uz * nx - ux * nz, ux * ny
    scale = 1.0 / math.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx * scale, ty * scale, tz * scale
    return tx, ty, tz, ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx


@inline
def sample_at(samples, k, frame, nx, ny, nz, texel_area):
    """Face, u, v and level of detail of sample k: x, y, z in the frame of the normal and its solid angle."""
    tx, ty, tz, bx, by, bz = frame
    x = tx * samples[k, 0] + bx * samples[k, 1] + nx * samples[k, 2]
    y = ty * samples[k, 0] + by * samples[k, 1] + ny * samples[k, 2]
    z = tz * samples[k, 0] + bz * samples[k, 1] + nz * samples[k, 2]
    face, u, v = face_of(x, y, z)
    # A texel's solid angle is texel_area J, J = (1 + u^2 + v^2)^(-3/2).
    level = 0.5 * math.log2(samples[k, 3] / texel_area) + 0.75 * math.log2(1.0 + u * u + v * v)
    return face, u, v, level


@kernel
def splat_samples(samples, nx, ny, nz, flat, offsets, sizes):
    """Add what the samples around a normal weigh to the texels of a pyramid; returns the sum of weights."""
    frame, total = tangents(nx, ny, nz), 0.0
    for k in range(samples.shape[0]):
        weight = samples[k, 2]
        face, u, v, level = sample_at(samples, k, frame, nx, ny, nz, 4.0 / (sizes[0] * sizes[0]))
        below, share = level_between(level, 0, len(sizes) - 1)
        splat(flat, offsets, sizes, face, u, v, below, weight * (1.0 - share))
        splat(flat, offsets, sizes, face, u, v, below + 1, weight * share)
        total += weight
    return total


@kernel
def filter_by_importance(samples, n, first, last, pyramids, offsets, sizes, out):
    """Texels of rows first to last (over all faces) of a level (6, n, n, 3) from flat pyramids (3, ...)."""
    area = 4.0 / (sizes[0] * sizes[0])
    for line in range(first, last):
        face, j = line // n, line % n
        for i in range(n):
            px, py, pz = face_point(face, (2.0 * i + 1.0) / n - 1.0, 1.0 - (2.0 * j + 1.0) / n)
            scale = 1.0 / math.sqrt(px * px + py * py + pz * pz)
            nx, ny, nz = px * scale, py * scale, pz * scale
            frame = tangents(nx, ny, nz)
            red, green, blue, total = 0.0, 0.0, 0.0, 0.0
            for k in range(samples.shape[0]):
                weight = samples[k, 2]
                g, u, v, level = sample_at(samples, k, frame, nx, ny, nz, area)
                below, share = level_between(level, 0, len(sizes) - 1)
                r, q, b = read_trilinear(pyramids, offsets, sizes, g, u, v, below, share)
                total, red, green, blue = total + weight, red + weight * r, green + weight * q, blue + weight * b
            out[face, j, i, 0] = red / total
            out[face, j, i, 1] = green / total
            out[face, j, i, 2] = blue / total
