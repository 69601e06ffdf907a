"""Brute force: every texel of the source weighed by the lobe; the reference of everything else."""

from __future__ import annotations

from brdffit._jit import kernel

#: Texels of the source that are read at once: 112 KiB.
_PIECE = 2048


@kernel
def weigh_all(normals, alpha, source, first, last, out, totals):
    """Sums over the source of K times solid angle times radiance (q, 3), and of K times solid angle (q,).

    ``source`` is (7, texels): unit direction, solid angle, radiance; normals (q, 3) first to last are done. K = (1 - d)
    / (alpha^2 + m d)^2 of d = 1 - n.l, which comes from |n - l|^2 / 2, for 1 - n.l cancels near the peak.
    """
    square = alpha * alpha
    m = 0.5 * (1.0 - square)
    x, y, z, angle = source[0], source[1], source[2], source[3]
    red, green, blue = source[4], source[5], source[6]
    out[first:last] = 0.0
    totals[first:last] = 0.0
    # A piece of the source stays in the cache for all normals.
    for begin in range(0, x.shape[0], _PIECE):
        end = min(begin + _PIECE, x.shape[0])
        for q in range(first, last):
            nx, ny, nz = normals[q, 0], normals[q, 1], normals[q, 2]
            total, r, g, b = 0.0, 0.0, 0.0, 0.0
            for t in range(begin, end):
                dx, dy, dz = x[t] - nx, y[t] - ny, z[t] - nz
                far = 0.5 * (dx * dx + dy * dy + dz * dz)
                p = square + m * far
                weight = max(1.0 - far, 0.0) * angle[t] / (p * p)
                total += weight
                r += weight * red[t]
                g += weight * green[t]
                b += weight * blue[t]
            totals[q] += total
            out[q, 0] += r
            out[q, 1] += g
            out[q, 2] += b
