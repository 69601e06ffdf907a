"""A quadtree over each face: nodes are taken whole where a bound on what that costs is small enough.

A node holds the mean radiance L of its texels, their deviation sd, the solid angle A, the angle rho from its centroid
that holds all of its corners, and two unit centroids of directions, each with the mean squared chord R2 from it: one
weighted by solid angle, one by solid angle times radiance (the sum of its channels). About the first the node's mean of
K is, to second order, k = K(c) + R2/4 Laplacian K, where on the sphere Laplacian K = (1 - c^2) K'' - 2 c K'. The same
about the second is q, the mean of K over its light: sum(A_i K_i L_i) is taken as A q L. The first order of the
covariance of K and L is in q, wherever in the node the light is; of one bright texel q is K itself. Where the node is
wider than the lobe q can be wrong by more than the covariance, and is held to its bound about k. The test does not
make use of q: it takes what is lost as the whole covariance, at most A (Kmax - Kmin)/2 sd, and the error e of k as
half of what the correction adds. The error of q is e times the ratio s of the two R2.

The sum of A k misses the integral I of K, which is known, by a sum of errors A e whose signs agree (K is convex but
at its peak): divided out, it would make texels near a lamp too bright, their dark tails being what lacks. The lack is
given to where it may come from instead: with X = sum(A e s L) / sum(A e),

    R = (sum A q L + (I - sum A k) X) / I,

which keeps constants, and an error A e of one node moves R by A e (L - X) / I. A node is taken when

    A ((Kmax - Kmin)/2 sd + e |L - X|)  <  tau |R| I,

with K's extremes at the cosines cos(theta -+ rho), and opened otherwise; texels are the leaves. R and X come from a
coarser pass, whose X leans to dark nodes, for one bright node in doubt would be all of the mean. Where the sum over
all texels is not known, R = sum(A q L)/sum(A k) and X = R.
"""

from __future__ import annotations

import math

import numpy as np

from brdffit._jit import inline, kernel

#: Fields of a node, float32.
NODE_FIELDS = 15
#: Nodes that are darker than this times the result count alike where X leans to the dark ones.
_FAINT = np.float32(0.03)


@inline
def lobe_and_correction(far, square, m, quarter):
    """K and R2/4 times its Laplacian at 1 - n.l = ``far``; ``quarter`` is R2/4, ``square`` alpha^2 (see probes.lobe).

    With p = alpha^2 + m far and c = n.l: K = c/p^2, K' = 1/p^2 + 2 m c/p^3, K'' = 4 m/p^3 + 6 m^2 c/p^4.
    """
    one, two = np.float32(1.0), np.float32(2.0)
    c, per = one - far, one / (square + m * far)
    above, per2 = max(c, np.float32(0.0)), per * per
    slope = per2 + two * m * above * per2 * per
    bend = np.float32(4.0) * m * per2 * per + np.float32(6.0) * m * m * above * per2 * per2
    return above * per2, quarter * (far * (two - far) * bend - two * c * slope)


@kernel
def filter_by_tree(
    normals, alpha, integrals, known, nodes, offsets, top, tau, final, estimate, first, last, out, counts
):
    """Radiance R and X (q, 6) around normals first to last; ``estimate`` (q, 6) holds both from a coarser pass.

    ``integrals`` (q,) is I, the sum of A K over all texels, if that is ``known``; ``final`` says whether this is the
    last pass; ``counts`` gets nodes taken.

    ``nodes`` (all nodes, NODE_FIELDS): centroid 3, A, cos rho, sin rho, sd, R2/4, radiance 3, centroid of radiance 3,
    its R2/4; level k of the tree begins at offsets[k], texels first; roots are the nodes of level ``top``.
    """
    one, zero, half, two = np.float32(1.0), np.float32(0.0), np.float32(0.5), np.float32(2.0)
    square = np.float32(alpha * alpha)
    m = np.float32(0.5 * (1.0 - alpha * alpha))
    node, level = np.empty(128, np.int64), np.empty(128, np.int64)
    side = int(math.sqrt((offsets[1] - offsets[0]) / 6.0) + 0.5)
    roots = 6 * (side >> top) ** 2
    for q in range(first, last):
        nx, ny, nz = np.float32(normals[q, 0]), np.float32(normals[q, 1]), np.float32(normals[q, 2])
        integral = integrals[q]
        red, green, blue = np.float32(estimate[q, 0]), np.float32(estimate[q, 1]), np.float32(estimate[q, 2])
        size = math.sqrt(red * red + green * green + blue * blue) + np.float32(1e-20)
        limit, faint = np.float32(tau * integral) * size, _FAINT * size
        # What X is guessed to be.
        x = 3 if known else 0
        er, eg, eb = np.float32(estimate[q, x]), np.float32(estimate[q, x + 1]), np.float32(estimate[q, x + 2])
        total, red, green, blue = 0.0, 0.0, 0.0, 0.0
        doubts, doubt_red, doubt_green, doubt_blue = 1e-30, 0.0, 0.0, 0.0
        darks, dark_red, dark_green, dark_blue = 1e-30, 0.0, 0.0, 0.0
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
                if k == 0:
                    p = square + m * far
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
                value, correction = lobe_and_correction(far, square, m, nodes[t, 7])
                wrong = half * min(abs(correction), spread)
                if farthest <= zero:
                    # The horizon cuts the node: its mean is anything between.
                    correction = zero
                    wrong = half * spread
                lr, lg, lb = nodes[t, 8] - er, nodes[t, 9] - eg, nodes[t, 10] - eb
                apart = math.sqrt(lr * lr + lg * lg + lb * lb)
                if area * (half * spread * nodes[t, 6] + wrong * apart) < limit:
                    mean = min(max(value + correction, zero), largest)
                    total += area * mean
                    dx, dy, dz = nodes[t, 11] - nx, nodes[t, 12] - ny, nodes[t, 13] - nz
                    value, correction = lobe_and_correction(
                        half * (dx * dx + dy * dy + dz * dz), square, m, nodes[t, 14]
                    )
                    if farthest <= zero:
                        correction = zero
                    # No farther from the node's mean than the bound of the covariance allows.
                    light = math.sqrt(
                        nodes[t, 8] * nodes[t, 8] + nodes[t, 9] * nodes[t, 9] + nodes[t, 10] * nodes[t, 10]
                    )
                    most = half * spread * nodes[t, 6] / (light + np.float32(1e-30))
                    value = min(max(value + correction, zero), largest)
                    weight = area * min(max(value, mean - most), mean + most)
                    red += weight * nodes[t, 8]
                    green += weight * nodes[t, 9]
                    blue += weight * nodes[t, 10]
                    bright = nodes[t, 8] + nodes[t, 9] + nodes[t, 10]
                    doubt = area * wrong
                    dark = doubt / ((bright + faint) * (bright + faint))
                    darks += dark
                    doubts += doubt
                    share = nodes[t, 14] / max(nodes[t, 7], np.float32(1e-30))
                    dark *= share
                    doubt *= share
                    dark_red += dark * nodes[t, 8]
                    dark_green += dark * nodes[t, 9]
                    dark_blue += dark * nodes[t, 10]
                    doubt_red += doubt * nodes[t, 8]
                    doubt_green += doubt * nodes[t, 9]
                    doubt_blue += doubt * nodes[t, 10]
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
        out[q, 3], out[q, 4], out[q, 5] = dark_red / darks, dark_green / darks, dark_blue / darks
        if known and doubts > 1e-20:
            xr, xg, xb = out[q, 3], out[q, 4], out[q, 5]
            if final:
                xr, xg, xb = doubt_red / doubts, doubt_green / doubts, doubt_blue / doubts
            lack = integral - total
            red, green, blue, total = red + lack * xr, green + lack * xg, blue + lack * xb, integral
        out[q, 0], out[q, 1], out[q, 2] = max(red / total, 0.0), max(green / total, 0.0), max(blue / total, 0.0)
        counts[q] = taken
