"""A quadtree over each face: nodes are taken whole where a bound on what that costs is small enough.

A node holds the mean radiance L of its texels, their deviation sd, the solid angle A, the unit centroid of directions,
the angle rho that holds all of its corners, and the mean squared chord R2 from the centroid. Taking it whole replaces
sum(A_i K_i L_i) by K' A L, with K' the node's mean of K to second order: K(c) + R2/4 Laplacian K, where on the sphere
Laplacian K = (1 - c^2) K'' - 2 c K'. What is lost is the covariance of K and L within the node, at most
A (Kmax - Kmin)/2 sd, and the error e of K' itself, which moves sum(K L)/sum(K) by A e |L - R|, R being the result:
without that term dark nodes spoil the denominator. e is taken as half of what the correction adds. A node is taken when

    A ((Kmax - Kmin)/2 sd + |correction| |L - R| / 2)  <  tau |R| integral(K),

with K's extremes at the cosines cos(theta -+ rho), and opened otherwise; texels are the leaves.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import kernel

#: Fields of a node, float32.
NODE_FIELDS = 11


@kernel
def filter_by_tree(normals, alpha, integral, nodes, offsets, top, tau, estimate, first, last, out, counts):
    """Radiance (q, 3) around normals first to last; ``estimate`` (q, 3) is R; ``counts`` gets nodes taken.

    ``nodes`` (all nodes, NODE_FIELDS): centroid 3, A, cos rho, sin rho, sd, R2/4, radiance 3; level k of the tree
    begins at offsets[k], texels first; roots are the nodes of level ``top``.
    """
    one, zero, half, two = np.float32(1.0), np.float32(0.0), np.float32(0.5), np.float32(2.0)
    square = np.float32(alpha * alpha)
    m = np.float32(0.5 * (1.0 - alpha * alpha))
    node, level = np.empty(128, np.int64), np.empty(128, np.int64)
    side = int(math.sqrt((offsets[1] - offsets[0]) / 6.0) + 0.5)
    roots = 6 * (side >> top) ** 2
    for q in range(first, last):
        nx, ny, nz = np.float32(normals[q, 0]), np.float32(normals[q, 1]), np.float32(normals[q, 2])
        er, eg, eb = np.float32(estimate[q, 0]), np.float32(estimate[q, 1]), np.float32(estimate[q, 2])
        size = math.sqrt(er * er + eg * eg + eb * eb) + np.float32(1e-20)
        limit = np.float32(tau * integral) * size
        total, red, green, blue = 0.0, 0.0, 0.0, 0.0
        taken = 0
        for root in range(roots):
            node[0], level[0] = offsets[top] + root, top
            stack = 1
            while stack > 0:
                stack -= 1
                t, k = node[stack], level[stack]
                dx, dy, dz = nodes[t, 0] - nx, nodes[t, 1] - ny, nodes[t, 2] - nz
                far = half * (dx * dx + dy * dy + dz * dz)
                area = nodes[t, 3]
                c = one - far
                p = square + m * far
                if k == 0:
                    if c > zero:
                        weight = area * c / (p * p)
                        total += weight
                        red += weight * nodes[t, 8]
                        green += weight * nodes[t, 9]
                        blue += weight * nodes[t, 10]
                        taken += 1
                    continue
                cos_rho, sin_rho = nodes[t, 4], nodes[t, 5]
                sine = math.sqrt(max(far * (two - far), zero))
                nearest = one
                if c < cos_rho:
                    nearest = c * cos_rho + sine * sin_rho
                if nearest <= zero:
                    continue
                farthest = max(c * cos_rho - sine * sin_rho, zero)
                near_p, far_p = square + m * (one - nearest), square + m * (one - farthest)
                largest = nearest / (near_p * near_p)
                spread = largest - farthest / (far_p * far_p)
                above, per = max(c, zero), one / p
                per2 = per * per
                value = above * per2
                slope = per2 + two * m * above * per2 * per
                bend = np.float32(4.0) * m * per2 * per + np.float32(6.0) * m * m * above * per2 * per2
                correction = nodes[t, 7] * (sine * sine * bend - two * c * slope)
                wrong = half * min(abs(correction), spread)
                if farthest <= zero:
                    # The horizon cuts the node: its mean is anything between.
                    correction = zero
                    wrong = half * spread
                lr, lg, lb = nodes[t, 8] - er, nodes[t, 9] - eg, nodes[t, 10] - eb
                apart = math.sqrt(lr * lr + lg * lg + lb * lb)
                if area * (half * spread * nodes[t, 6] + wrong * apart) < limit:
                    weight = area * min(max(value + correction, zero), largest)
                    total += weight
                    red += weight * nodes[t, 8]
                    green += weight * nodes[t, 9]
                    blue += weight * nodes[t, 10]
                    taken += 1
                else:
                    n = side >> k
                    place = t - offsets[k]
                    face, row, column = place // (n * n), place // n % n, place % n
                    child = offsets[k - 1] + (face * 2 * n + 2 * row) * 2 * n + 2 * column
                    node[stack], node[stack + 1], node[stack + 2], node[stack + 3] = (
                        child, child + 1, child + 2 * n, child + 2 * n + 1
                    )  # fmt: skip
                    level[stack], level[stack + 1], level[stack + 2], level[stack + 3] = k - 1, k - 1, k - 1, k - 1
                    stack += 4
        out[q, 0], out[q, 1], out[q, 2] = red / total, green / total, blue / total
        counts[q] = taken
