"""Directions and face coordinates of a cube map, as OpenGL, Direct3D, Vulkan and KTX2 look it up.

Faces +X -X +Y -Y +Z -Z; u to the right and v up in [-1, 1] on each.
"""

from __future__ import annotations

import math

from brdffit._jit import inline, kernel


@inline
def face_point(face, u, v):
    """The point of the cube of half side 1 at (u, v) of a face."""
    if face == 0:
        return 1.0, v, -u
    if face == 1:
        return -1.0, v, u
    if face == 2:
        return u, 1.0, -v
    if face == 3:
        return u, -1.0, v
    if face == 4:
        return u, v, 1.0
    return -u, v, -1.0


@inline
def face_of(x, y, z):
    """Face, u and v of a direction that need not have unit length."""
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        if x > 0.0:
            return 0, -z / ax, y / ax
        return 1, z / ax, y / ax
    if ay >= az:
        if y > 0.0:
            return 2, x / ay, -z / ay
        return 3, x / ay, z / ay
    if z > 0.0:
        return 4, x / az, y / az
    return 5, -x / az, y / az


@inline
def bilinear_corner(u, v, n):
    """Column and row in a padded face (n + 2 squared) of the first of four texels around (u, v), and two fractions."""
    x, y = (u + 1.0) * 0.5 * n + 0.5, (1.0 - v) * 0.5 * n + 0.5
    i, j = min(max(int(x), 0), n), min(max(int(y), 0), n)
    return i, j, x - i, y - j


@kernel
def average_equirect(picture, border, centre_x, centre_z, samples, first, last, out):
    """Mean radiance of the texels of rows first to last (counted over all faces) of ``out`` (6, n, n, 3).

    ``picture`` (H, W, 3) is constant inside its pixels; with ``border`` its outer pixel centres lie on the border. Its
    middle column looks along (centre_x, 0, centre_z). ``samples`` squared points a texel, weighted by solid angle.
    """
    height, width = picture.shape[0], picture.shape[1]
    n = out.shape[1]
    for line in range(first, last):
        face, j = line // n, line % n
        for i in range(n):
            red, green, blue, total = 0.0, 0.0, 0.0, 0.0
            for b in range(samples):
                v = 1.0 - 2.0 * (j + (b + 0.5) / samples) / n
                for a in range(samples):
                    u = 2.0 * (i + (a + 0.5) / samples) / n - 1.0
                    x, y, z = face_point(face, u, v)
                    square = 1.0 + u * u + v * v
                    weight = 1.0 / (square * math.sqrt(square))
                    # Right of the centre (sine) and along it (cosine), seen from above.
                    ahead, right = x * centre_x + z * centre_z, -x * centre_z + z * centre_x
                    column = math.atan2(right, ahead) / (2.0 * math.pi) + 0.5
                    row = math.acos(y / math.sqrt(square)) / math.pi
                    if border:
                        p, q = int(column * (width - 1) + 0.5), int(row * (height - 1) + 0.5)
                    else:
                        p, q = int(column * width), int(row * height)
                    p, q = min(max(p, 0), width - 1), min(max(q, 0), height - 1)
                    red += weight * picture[q, p, 0]
                    green += weight * picture[q, p, 1]
                    blue += weight * picture[q, p, 2]
                    total += weight
            out[face, j, i, 0] = red / total
            out[face, j, i, 1] = green / total
            out[face, j, i, 2] = blue / total
