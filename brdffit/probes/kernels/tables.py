"""The second pass of Manson and Sloan 2016: taps from polynomials, and the error of the preimage with its gradient.

A table of one level is (5, terms, 3 taps): parameters x, y, z, level and weight; polynomial terms in theta and phi; the
taps of the axes X, Y, Z in a row. Around the texel direction z the frame of an axis a is x = normalised a x z and
y = z x x; a tap looks up the direction p = x_i x + y_i y + z_i z at the level l_i + 3/4 log2(1 + u^2 + v^2), where u, v
are p's face coordinates (the Jacobian of equation 4 taken out).

The preimage C of a texel is what each texel of the base weighs in it: taps are splatted into the pyramid and pushed to
the base by the transpose of the first pass. With E = sum sqrt((C/s - B)^2 + e^2) - e, s the sum of weights, the
transpose of pushing is the ordinary pyramid of g = dE/d(C/s): a tap's derivative by its weight is a trilinear read of
it, by its position the gradient of that read, by its level the difference of two levels.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel
from brdffit.probes.kernels.cube import bilinear_corner, face_of, face_point
from brdffit.probes.kernels.pyramid import fold_level, pad_level, pull_level, push_level

#: What is kept of a tap: face, u, v, level, weight, column in the table, then derivatives (see ``place_taps``).
TAP_FACE, TAP_U, TAP_V, TAP_LEVEL, TAP_WEIGHT, TAP_COLUMN = 0, 1, 2, 3, 4, 5
#: du by x, y, z; dv by x, y, z; dlevel by u and v; the frame's weight; the polynomial terms.
TAP_DU, TAP_DV, TAP_DLEVEL_DU, TAP_DLEVEL_DV, TAP_FRAME, TAP_TERMS = 6, 9, 12, 13, 14, 15
TAP_FIELDS = 21


@inline
def frame_terms(point, axis, terms):
    """Weight of the frame of an axis at a point of the cube, and the polynomial terms: 1, t, p, t^2, t p, p^2.

    t and p are theta^2 and phi^2 (figure 6): theta runs from -1 to 1 across each side face around the axis, phi from
    pole to pole with reflection at the edges of the top and bottom faces.
    """
    first, second = point[(axis + 1) % 3], point[(axis + 2) % 3]
    across = max(abs(first), abs(second))
    weight = min(max(4.0 * across - 3.0, 0.0), 1.0)
    along = abs(point[axis])
    theta = min(abs(first), abs(second)) / max(across, 1e-9)
    # On a side face the larger coordinate across is 1 and phi is the one along; on the top it is the other way.
    phi = across if along >= 1.0 else along
    t, p = theta * theta, phi * phi
    terms[0], terms[1], terms[2], terms[3], terms[4], terms[5] = 1.0, t, p, t * t, t * p, p * p
    return weight


@kernel
def place_taps(table, face, u, v, taps):
    """Fill ``taps`` (3 N, TAP_FIELDS) for the texel at (u, v) of a face; returns how many there are."""
    count, term_count = table.shape[2] // 3, table.shape[1]
    px, py, pz = face_point(face, u, v)
    point = (px, py, pz)
    length = math.sqrt(px * px + py * py + pz * pz)
    zx, zy, zz = px / length, py / length, pz / length
    terms = np.empty(6)
    k = 0
    for axis in range(3):
        frame = frame_terms(point, axis, terms)
        if frame <= 0.0:
            continue
        ax, ay, az = 1.0 * (axis == 0), 1.0 * (axis == 1), 1.0 * (axis == 2)
        xx, xy, xz = ay * zz - az * zy, az * zx - ax * zz, ax * zy - ay * zx
        scale = 1.0 / math.sqrt(xx * xx + xy * xy + xz * xz)
        xx, xy, xz = xx * scale, xy * scale, xz * scale
        yx, yy, yz = zy * xz - zz * xy, zz * xx - zx * xz, zx * xy - zy * xx
        for tap in range(count):
            column = axis * count + tap
            a, b, c, level, weight = 0.0, 0.0, 0.0, 0.0, 0.0
            for e in range(term_count):
                a += table[0, e, column] * terms[e]
                b += table[1, e, column] * terms[e]
                c += table[2, e, column] * terms[e]
                level += table[3, e, column] * terms[e]
                weight += table[4, e, column] * terms[e]
            x, y, z = xx * a + yx * b + zx * c, xy * a + yy * b + zy * c, xz * a + yz * b + zz * c
            g, s, t = face_of(x, y, z)
            square = 1.0 + s * s + t * t
            row = taps[k]
            row[TAP_FACE], row[TAP_U], row[TAP_V] = g, s, t
            row[TAP_LEVEL] = level + 0.75 * math.log2(square)
            row[TAP_WEIGHT], row[TAP_COLUMN], row[TAP_FRAME] = weight * frame, column, frame
            # u = e_u . p / (e_m . p): its gradient is (e_u - u e_m) / (e_m . p), e_m the outward axis of the face.
            mx, my, mz = face_point(g, 0.0, 0.0)
            ux, uy, uz = face_point(g, 1.0, 0.0)
            vx, vy, vz = face_point(g, 0.0, 1.0)
            per = 1.0 / (mx * x + my * y + mz * z)
            ux, uy, uz = (ux - mx - s * mx) * per, (uy - my - s * my) * per, (uz - mz - s * mz) * per
            vx, vy, vz = (vx - mx - t * mx) * per, (vy - my - t * my) * per, (vz - mz - t * mz) * per
            row[TAP_DU], row[TAP_DV] = ux * xx + uy * xy + uz * xz, vx * xx + vy * xy + vz * xz
            row[TAP_DU + 1], row[TAP_DV + 1] = ux * yx + uy * yy + uz * yz, vx * yx + vy * yy + vz * yz
            row[TAP_DU + 2], row[TAP_DV + 2] = ux * zx + uy * zy + uz * zz, vx * zx + vy * zy + vz * zz
            slope = 1.5 / (math.log(2.0) * square)
            row[TAP_DLEVEL_DU], row[TAP_DLEVEL_DV] = slope * s, slope * t
            for e in range(6):
                row[TAP_TERMS + e] = terms[e]
            k += 1
    return k


@inline
def level_between(level, first, last):
    """The finer of the two levels around a level of detail, and the share of the coarser one."""
    clamped = min(max(level, 1.0 * first), 1.0 * last)
    below = min(int(clamped), last - 1)
    return below, clamped - below


@kernel
def splat(flat, offsets, sizes, face, u, v, level, weight):
    """Add ``weight`` times the bilinear weights at (u, v) to a level, its border included."""
    n = sizes[level]
    i, j, right, down = bilinear_corner(u, v, n)
    at = offsets[level] + (face * (n + 2) + j) * (n + 2) + i
    flat[at] += weight * (1.0 - right) * (1.0 - down)
    flat[at + 1] += weight * right * (1.0 - down)
    flat[at + n + 2] += weight * (1.0 - right) * down
    flat[at + n + 3] += weight * right * down


@kernel
def read(flat, offsets, sizes, face, u, v, level):
    """Bilinear value of a level at (u, v), and its derivatives by u and v."""
    n = sizes[level]
    i, j, right, down = bilinear_corner(u, v, n)
    at = offsets[level] + (face * (n + 2) + j) * (n + 2) + i
    a, b, c, d = flat[at], flat[at + 1], flat[at + n + 2], flat[at + n + 3]
    top, bottom = a + (b - a) * right, c + (d - c) * right
    across = (b - a) * (1.0 - down) + (d - c) * down
    return top + (bottom - top) * down, across * 0.5 * n, (top - bottom) * 0.5 * n


@inline
def gather(taps, count, pyramids, offsets, sizes):
    """Red, green and blue of flat pyramids (3, ...), read trilinearly at the taps: their weighted mean."""
    red, green, blue, total = 0.0, 0.0, 0.0, 0.0
    for k in range(count):
        below, share = level_between(taps[k, TAP_LEVEL], 0, len(sizes) - 1)
        face, u, v, weight = int(taps[k, TAP_FACE]), taps[k, TAP_U], taps[k, TAP_V], taps[k, TAP_WEIGHT]
        total += weight
        for e in range(2):
            part = weight * (share if e else 1.0 - share)
            m = sizes[below + e]
            column, row, right, down = bilinear_corner(u, v, m)
            at = offsets[below + e] + (face * (m + 2) + row) * (m + 2) + column
            w00, w01 = part * (1.0 - right) * (1.0 - down), part * right * (1.0 - down)
            w10, w11 = part * (1.0 - right) * down, part * right * down
            p = pyramids[0]
            red += w00 * p[at] + w01 * p[at + 1] + w10 * p[at + m + 2] + w11 * p[at + m + 3]
            p = pyramids[1]
            green += w00 * p[at] + w01 * p[at + 1] + w10 * p[at + m + 2] + w11 * p[at + m + 3]
            p = pyramids[2]
            blue += w00 * p[at] + w01 * p[at + 1] + w10 * p[at + m + 2] + w11 * p[at + m + 3]
    return red / total, green / total, blue / total


@kernel
def splat_taps(taps, count, flat, offsets, sizes, base):
    """Add the trilinear weights of the taps to levels from ``base`` on; returns the sum of the taps' weights."""
    total = 0.0
    for k in range(count):
        below, share = level_between(taps[k, TAP_LEVEL], base, len(sizes) - 1)
        face, u, v, weight = int(taps[k, TAP_FACE]), taps[k, TAP_U], taps[k, TAP_V], taps[k, TAP_WEIGHT]
        splat(flat, offsets, sizes, face, u, v, below, weight * (1.0 - share))
        splat(flat, offsets, sizes, face, u, v, below + 1, weight * share)
        total += weight
    return total


@kernel
def preimage(flat, offsets, sizes, borders, weights, base, taps, count):
    """What the texels of level ``base`` weigh in a texel with these taps; returns the sum of weights, not divided out.

    ``flat`` is overwritten; the result stands in the interior of level ``base``.
    """
    flat[offsets[base] :] = 0.0
    total = splat_taps(taps, count, flat, offsets, sizes, base)
    for level in range(len(sizes) - 1, base, -1):
        edge, edge_source, corner, corner_source = borders[level]
        fold_level(flat, offsets[level], edge, edge_source, corner, corner_source)
        pad_level(flat, offsets[level], edge, edge_source, corner, corner_source)
        push_level(flat, offsets[level - 1], offsets[level], sizes[level], weights[level])
    edge, edge_source, corner, corner_source = borders[base]
    fold_level(flat, offsets[base], edge, edge_source, corner, corner_source)
    return total


@kernel
def texel_error(flat, offsets, sizes, borders, weights, base, taps, count, wanted, smoothing, with_gradient, gradient):
    """Smoothed L1 distance of the preimage from ``wanted`` (6 n n,); adds to ``gradient`` (5, terms, 3 N) if asked."""
    last, n = len(sizes) - 1, sizes[base]
    total = preimage(flat, offsets, sizes, borders, weights, base, taps, count)
    inverse, square = 1.0 / total, smoothing * smoothing
    error, along = 0.0, 0.0
    for face in range(6):
        for j in range(n):
            at = offsets[base] + (face * (n + 2) + j + 1) * (n + 2) + 1
            row, goal = flat[at : at + n], wanted[(face * n + j) * n : (face * n + j + 1) * n]
            for i in range(n):
                difference = row[i] * inverse - goal[i]
                size = math.sqrt(difference * difference + square)
                slope = difference / max(size, 1e-300)
                error += size - smoothing
                along += slope * row[i]
                row[i] = slope
    if not with_gradient:
        return error
    for level in range(base, last + 1):
        edge, edge_source, corner, corner_source = borders[level]
        if level > base:
            pull_level(flat, offsets[level - 1], offsets[level], sizes[level], weights[level])
        pad_level(flat, offsets[level], edge, edge_source, corner, corner_source)
    for k in range(count):
        row = taps[k]
        below, share = level_between(row[TAP_LEVEL], base, last)
        face, u, v = int(row[TAP_FACE]), row[TAP_U], row[TAP_V]
        fine, fine_u, fine_v = read(flat, offsets, sizes, face, u, v, below)
        coarse, coarse_u, coarse_v = read(flat, offsets, sizes, face, u, v, below + 1)
        by_level = 0.0
        if base < row[TAP_LEVEL] < last:
            by_level = coarse - fine
        weight = row[TAP_WEIGHT] * inverse
        by_u = weight * (fine_u + (coarse_u - fine_u) * share + by_level * row[TAP_DLEVEL_DU])
        by_v = weight * (fine_v + (coarse_v - fine_v) * share + by_level * row[TAP_DLEVEL_DV])
        by_weight = (fine + (coarse - fine) * share - along * inverse) * inverse * row[TAP_FRAME]
        column = int(row[TAP_COLUMN])
        for e in range(gradient.shape[1]):
            term = row[TAP_TERMS + e]
            for axis in range(3):
                gradient[axis, e, column] += (by_u * row[TAP_DU + axis] + by_v * row[TAP_DV + axis]) * term
            gradient[3, e, column] += by_level * weight * term
            gradient[4, e, column] += by_weight * term
    return error


@kernel
def table_error(table, texels, shares, wanted, smoothing, flat, layout, base, with_gradient, gradient, errors):
    """Mean smoothed L1 distance over texels (T, 3: face, u, v) of weights ``shares`` that sum to one.

    ``gradient`` (5, terms, 3 N) is overwritten if asked for; ``errors`` (T,) gets the distance of each texel.
    """
    offsets, sizes, borders, weights = layout
    taps = np.empty((table.shape[2], TAP_FIELDS))
    own = np.empty(table.shape)
    gradient[:] = 0.0
    mean = 0.0
    for q in range(texels.shape[0]):
        count = place_taps(table, int(texels[q, 0]), texels[q, 1], texels[q, 2], taps)
        own[:] = 0.0
        errors[q] = texel_error(
            flat, offsets, sizes, borders, weights, base, taps, count, wanted[q], smoothing, with_gradient, own
        )
        mean += shares[q] * errors[q]
        if with_gradient:
            gradient += shares[q] * own
    return mean


@kernel
def filter_by_table(table, n, first, last, pyramids, offsets, sizes, out):
    """Texels of rows first to last (over all faces) of a level (6, n, n, 3) from flat pyramids (3, ...)."""
    taps = np.empty((table.shape[2], TAP_FIELDS))
    for line in range(first, last):
        face, j = line // n, line % n
        for i in range(n):
            count = place_taps(table, face, (2.0 * i + 1.0) / n - 1.0, 1.0 - (2.0 * j + 1.0) / n, taps)
            red, green, blue = gather(taps, count, pyramids, offsets, sizes)
            # Weights may be negative.
            out[face, j, i, 0], out[face, j, i, 1], out[face, j, i, 2] = max(red, 0.0), max(green, 0.0), max(blue, 0.0)
