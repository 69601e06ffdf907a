"""Geometry of a lobe: tangent frames, slopes, eigenvalues of the log roughness tensor."""

from __future__ import annotations

import math

from brdffit._jit import inline


@inline
def tangent_frame(x, y, z):
    """Tangent t and bitangent b of the unit normal (x, y, z), z > -1: the images of the x and y axes under the shortest
    rotation from the z axis to the normal. Returns (t_x, t_y, t_z, b_x, b_y, b_z)."""
    k = 1.0 / (1.0 + z)
    xy = -x * y * k
    return 1.0 - x * x * k, xy, -x, xy, 1.0 - y * y * k, -y


@inline
def eigen_log(a, b, c):
    """Eigenvalues l1 >= l2 of [[a, c], [c, b]] and (cos, sin) of the angle of the first eigenvector.

    An isotropic tensor has no direction; (1, 0) is returned and no result depends on it.
    """
    mean = 0.5 * (a + b)
    half = 0.5 * (a - b)
    radius = math.sqrt(half * half + c * c)
    if radius < 1e-12:
        return mean, mean, 1.0, 0.0
    # Half-angle formulas, cos^2 = (1 + half / radius) / 2; the larger of cos and sin is computed without cancellation.
    larger = radius + abs(half)
    scale = 1.0 / math.sqrt(2.0 * radius * larger)
    cos, sin = (larger * scale, c * scale) if half >= 0.0 else (c * scale, larger * scale)
    return mean + radius, mean - radius, cos, sin


@inline
def lobe_frame(n_x, n_y, n_z, a, b, c, frame):
    """Fill ``frame`` (9,) with the rows u1, u2, n that transform h to scaled coordinates.

    u_i = exp(-l_i / 2) v_i are the tangent-plane axes along the eigenvectors of the tensor, scaled so that
    q = (u1.h)^2 + (u2.h)^2. Returns (l1, l2, cos, sin) of ``eigen_log`` and the two scales exp(-l_i / 2).
    """
    l1, l2, cos, sin = eigen_log(a, b, c)
    s1, s2 = scaled_frame(n_x, n_y, n_z, l1, l2, cos, sin, frame)
    return l1, l2, cos, sin, s1, s2


@inline
def scaled_frame(n_x, n_y, n_z, l1, l2, cos, sin, frame):
    """``lobe_frame`` of a tensor given by its log eigenvalues and first eigenvector; returns the two scales."""
    t_x, t_y, t_z, b_x, b_y, b_z = tangent_frame(n_x, n_y, n_z)
    s1 = math.exp(-0.5 * l1)
    s2 = math.exp(-0.5 * l2)
    frame[0] = s1 * (cos * t_x + sin * b_x)
    frame[1] = s1 * (cos * t_y + sin * b_y)
    frame[2] = s1 * (cos * t_z + sin * b_z)
    frame[3] = s2 * (cos * b_x - sin * t_x)
    frame[4] = s2 * (cos * b_y - sin * t_y)
    frame[5] = s2 * (cos * b_z - sin * t_z)
    frame[6] = n_x
    frame[7] = n_y
    frame[8] = n_z
    return s1, s2


@inline
def tensor_of_log(a, b, c):
    """Roughness tensor (xx, yy, xy) of its matrix logarithm."""
    l1, l2, cos, sin = eigen_log(a, b, c)
    e1, e2 = math.exp(l1), math.exp(l2)
    return e1 * cos * cos + e2 * sin * sin, e1 * sin * sin + e2 * cos * cos, (e1 - e2) * cos * sin


@inline
def half_powers(xx, yy, xy):
    """Sigma^(1/2) and Sigma^(-1/2), each (xx, yy, xy), and sqrt(det Sigma), without an angle.

    By Cayley and Hamilton, Sigma^(1/2) = (Sigma + r I) / sqrt(tr Sigma + 2 r), r = sqrt(det Sigma).
    """
    root = math.sqrt(max(xx * yy - xy * xy, 1e-24))
    scale = 1.0 / math.sqrt(xx + yy + 2.0 * root)
    inverse = scale / root
    return (
        (scale * (xx + root), scale * (yy + root), scale * xy),
        (inverse * (yy + root), inverse * (xx + root), -inverse * xy),
        root,
    )
