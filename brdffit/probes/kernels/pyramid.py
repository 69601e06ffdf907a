"""The first pass of Manson and Sloan 2016: coarser levels by quadratic B-splines, and its transpose.

All levels lie in one flat array: level k at ``offset[k]``, six padded faces of (n + 2)^2 with n = base >> k. A coarse
texel is the weighted mean of four bilinear reads at 3/4 of a fine texel from its centre, which cover 4x4 fine texels by
(1, 3, 3, 1)/8 along each axis. The weights of the four reads, (4, n + 2, n + 2) in the order left-top, right-top,
left-bottom, right-bottom, hang on the texel. They are padded by mirroring: the read of a texel beyond the edge that
falls on this face is the mirror image of the read of the texel before the edge that falls on the next.
"""

from __future__ import annotations

from brdffit._jit import kernel


@kernel
def pad_level(flat, start, edge, edge_source, corner, corner_source):
    """Fill the border of one level."""
    for k in range(edge.shape[0]):
        flat[start + edge[k]] = flat[start + edge_source[k]]
    for k in range(corner.shape[0]):
        a, b, c = corner_source[k, 0], corner_source[k, 1], corner_source[k, 2]
        flat[start + corner[k]] = (flat[start + a] + flat[start + b] + flat[start + c]) * (1.0 / 3.0)


@kernel
def fold_level(flat, start, edge, edge_source, corner, corner_source):
    """The transpose of ``pad_level``: what was added to the border goes to where its texels come from."""
    for k in range(corner.shape[0]):
        third = flat[start + corner[k]] * (1.0 / 3.0)
        for e in range(3):
            flat[start + corner_source[k, e]] += third
        flat[start + corner[k]] = 0.0
    for k in range(edge.shape[0]):
        flat[start + edge_source[k]] += flat[start + edge[k]]
        flat[start + edge[k]] = 0.0


@kernel
def pull_level(flat, fine_start, coarse_start, n, weights):
    """Texels of a coarse level (n^2 a face) from the padded finer one; its own border is left as it is."""
    fine_row, coarse_row = 2 * n + 2, n + 2
    for face in range(6):
        for j in range(n):
            # Rows 2j - 1 to 2j + 2 of the fine face, which is padded by one.
            top = fine_start + (face * fine_row + 2 * j) * fine_row
            r0 = flat[top : top + fine_row]
            r1 = flat[top + fine_row : top + 2 * fine_row]
            r2 = flat[top + 2 * fine_row : top + 3 * fine_row]
            r3 = flat[top + 3 * fine_row : top + 4 * fine_row]
            into = coarse_start + (face * coarse_row + j + 1) * coarse_row + 1
            for i in range(n):
                k = 2 * i
                a0, a1 = r0[k] + 3.0 * r0[k + 1], 3.0 * r0[k + 2] + r0[k + 3]
                b0, b1 = r1[k] + 3.0 * r1[k + 1], 3.0 * r1[k + 2] + r1[k + 3]
                c0, c1 = r2[k] + 3.0 * r2[k + 1], 3.0 * r2[k + 2] + r2[k + 3]
                d0, d1 = r3[k] + 3.0 * r3[k + 1], 3.0 * r3[k + 2] + r3[k + 3]
                left_top, right_top = a0 + 3.0 * b0, a1 + 3.0 * b1
                left_bottom, right_bottom = 3.0 * c0 + d0, 3.0 * c1 + d1
                upper = weights[0, j + 1, i + 1] * left_top + weights[1, j + 1, i + 1] * right_top
                lower = weights[2, j + 1, i + 1] * left_bottom + weights[3, j + 1, i + 1] * right_bottom
                flat[into + i] = (upper + lower) * 0.0625


@kernel
def push_level(flat, fine_start, coarse_start, n, weights):
    """The transpose of ``pull_level``: adds the padded coarse level to the interior of the finer one.

    A fine texel in an even column lies 1/4 coarse texel left of a centre: 3/4 of that texel's left read and 1/4 of the
    right read of the one before.
    """
    fine_row, coarse_row = 2 * n + 2, n + 2
    for face in range(6):
        for fine_j in range(2 * n):
            j = fine_j // 2
            odd = fine_j % 2
            # The near coarse row gives its own half with 3/4, the far one (above or below) its other half with 1/4.
            near, far = j + 1, j + 2 * odd
            near_read, far_read = (2, 0) if odd else (0, 2)
            near_at = coarse_start + (face * coarse_row + near) * coarse_row
            far_at = coarse_start + (face * coarse_row + far) * coarse_row
            c_near, c_far = flat[near_at : near_at + coarse_row], flat[far_at : far_at + coarse_row]
            near_left, near_right = weights[near_read, near], weights[near_read + 1, near]
            far_left, far_right = weights[far_read, far], weights[far_read + 1, far]
            at = fine_start + (face * fine_row + fine_j + 1) * fine_row + 1
            fine = flat[at : at + 2 * n]
            for i in range(n):
                own = 9.0 * near_left[i + 1] * c_near[i + 1] + 3.0 * far_left[i + 1] * c_far[i + 1]
                before = 3.0 * near_right[i] * c_near[i] + far_right[i] * c_far[i]
                fine[2 * i] += (own + before) * 0.0625
                own = 9.0 * near_right[i + 1] * c_near[i + 1] + 3.0 * far_right[i + 1] * c_far[i + 1]
                after = 3.0 * near_left[i + 2] * c_near[i + 2] + far_left[i + 2] * c_far[i + 2]
                fine[2 * i + 1] += (own + after) * 0.0625
