"""The displayed or balanced error of lobes under the default lights, in plain numpy: for grey, isotropic GGX bases.

    E = mean over sizes s of int |T_s - rho F_s|^2 v_s w(h) dh / int |T_s|^2 v_s w(h) dh, v_s = (k_s / (T_s + k_s))^1.5,

k_s = D + b (mean T_s + D), b = 1/2 or ``dark``, D = 16 d / (9 pi) of the diffuse albedo d, T_s and F_s widened by
a_s^2 = 0.74 (r_s / 2)^2 (the heads of brdffit/halfangle/lights.py and brdffit/fitting/losses.py); with ``squares`` w,
(E + w S) / (1 + w), S as E with v_s = 1. No kernel of the program is called, and
nothing is shared with the fit: samples of the footprint and half vectors are random.

The footprint is a random sample, so T is noisy at each half vector. The noise adds the same to the error of every lobe,
so *differences* of errors are right in the mean whatever the number of samples.
"""

from __future__ import annotations

import math

import nlopt
import numpy as np
from lobe_oracle import bilinear, unit

from brdffit._jit import kernel

#: Angular radii (degrees) of the default lights, and GGX's blur: what they add to alpha^2.
RADII, BLUR = (2.0, 10.0, 40.0), 0.74
SQUARES = tuple(BLUR * math.radians(0.5 * radius) ** 2 for radius in RADII)
#: The walls of a bounded scale, relative to the filtered colour, and of alpha.
LEAST_SCALE, MOST_SCALE = 0.9, 1.1
LEAST_ALPHA, MOST_ALPHA = 0.002, 1.0
# Shares of the half vectors that are drawn from the footprint's lobes and from the lobes that are compared; the rest
# follows the cosine, so that nothing hides.
_FROM_TARGET, _FROM_LOBES = 0.5, 0.25


def footprint(base, level_size, row, column, side, rng):
    """(normals, alpha^2) of ``side`` x ``side`` stratified random samples of a box footprint."""
    scale = base.size[0] // level_size[0]
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side), indexing="ij"), -1)
    at = (cells + rng.random((side, side, 2))).reshape(-1, 2) / side
    y, x = scale * (row + at[:, 0]), scale * (column + at[:, 1])
    return unit(bilinear(base.normal, y, x)), bilinear(np.exp(base.log_roughness[..., 0] / 4), y, x) ** 4


def knee_of(mean, diffuse, dark=0.5):
    """k of a mean of T and the diffuse albedo of each channel."""
    beside = 16 / (9 * math.pi) * 3 * diffuse
    return beside + dark * (mean + beside)


def share_of_norm(weight, shape):
    """Weights with which the square of ``shape`` sums to 1."""
    return weight / (weight * shape * shape).sum()


def ggx(cos, alpha_squared):
    """D of isotropic lobes at n.h, 0 below their horizon."""
    root = 1 + cos * cos * (alpha_squared - 1)
    return np.where(cos > 0, alpha_squared / (math.pi * root * root), 0)


@kernel
def mixture(h, normals, alpha_squared):
    """Means over the footprint's samples of D and of D (n.h), at half vectors (N, 3): the one loop that is compiled."""
    values, drawn = np.zeros(h.shape[0]), np.zeros(h.shape[0])
    one, none, pi = np.float32(1), np.float32(0), np.float32(math.pi)
    x, y, z = normals[:, 0].copy(), normals[:, 1].copy(), normals[:, 2].copy()
    for j in range(h.shape[0]):
        h_x, h_y, h_z = h[j, 0], h[j, 1], h[j, 2]
        total, weighed = none, none
        for i in range(x.size):
            cos = max(h_x * x[i] + h_y * y[i] + h_z * z[i], none)
            root = one + cos * cos * (alpha_squared[i] - one)
            value = alpha_squared[i] / (root * root) if cos > none else none
            total += value
            weighed += value * cos
        values[j], drawn[j] = total / (pi * x.size), weighed / (pi * x.size)
    return values, drawn


class Lobe:
    """A normal (3,) and the tensor (2, 2) of a log tensor (3,), in the frame that the shortest turn of z gives."""

    def __init__(self, normal, log_tensor):
        self.normal, self.log_tensor = np.asarray(normal, float), np.asarray(log_tensor, float)
        a, b, c = self.log_tensor
        mean, half = 0.5 * (a + b), 0.5 * (a - b)
        radius = math.hypot(half, c)
        # exp(mean I + K) with K^2 = radius^2 I.
        even = math.exp(mean) * math.cosh(radius)
        odd = math.exp(mean) * (math.sinh(radius) / radius if radius > 1e-9 else 1.0)
        self.tensor = np.array([[even + odd * half, odd * c], [odd * c, even - odd * half]])

    def values(self, h, square):
        """GGX at half vectors (N, 3), with ``square`` I added to the tensor; 0 below the lobe's horizon."""
        n_x, n_y, n_z = self.normal
        flat = n_x * h[:, 0] + n_y * h[:, 1]
        back = flat / (1 + n_z) + h[:, 2]
        x, y, z = h[:, 0] - n_x * back, h[:, 1] - n_y * back, flat + n_z * h[:, 2]
        xx, yy, xy = self.tensor[0, 0] + square, self.tensor[1, 1] + square, self.tensor[0, 1]
        determinant = xx * yy - xy * xy
        root = (yy * x * x - 2 * xy * x * y + xx * y * y) / determinant + z * z
        return np.where(z > 0, 1 / (math.pi * math.sqrt(determinant) * root * root), 0)

    def draw(self, square, count, rng):
        """``count`` half vectors with density D (n.h)."""
        root = np.linalg.cholesky(self.tensor + square * np.eye(2))
        return around(self.normal, polar(rng, count) @ root.T)


def polar(rng, count):
    """Slopes (count, 2) of GGX's D (n.h) with the tensor I."""
    u, angle = rng.random(count), 2 * math.pi * rng.random(count)
    return np.sqrt(u / (1 - u))[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)


def around(normal, slopes):
    """Half vectors (n, 3) at slopes (n, 2) in the frames of normals (3,) or (n, 3)."""
    x, y = (slopes / np.sqrt(1 + np.sum(slopes**2, axis=1, keepdims=True))).T
    z = np.sqrt(np.maximum(1 - x * x - y * y, 0))
    n_x, n_y, n_z = np.asarray(normal).T
    flat = (n_x * x + n_y * y) / (1 + n_z)
    return np.stack([x + n_x * (z - flat), y + n_y * (z - flat), n_z * z - n_x * x - n_y * y], -1)


class Target:
    """What a footprint shows of its lobes under each light, on random half vectors.

    Args:
        normals, alpha_squared: (M, 3) and (M,) of the footprint's samples.
        specular: colour of each channel; diffuse: albedo of each channel.
        compared: lobes that half vectors are drawn from as well.
        nodes: half vectors for each size of light.
        dark: share of the mean light in k_s; squares: weight of the squared error beside the displayed one.
    """

    def __init__(self, normals, alpha_squared, specular, diffuse, compared, nodes, rng, dark=0.5, squares=0.0):
        self.sizes = []
        normals = normals.astype(np.float32)
        for square in SQUARES:
            wide = (alpha_squared + square).astype(np.float32)
            many, few = round(_FROM_TARGET * nodes), round(_FROM_LOBES * nodes / len(compared))
            left = nodes - many - few * len(compared)
            pick = rng.integers(0, len(normals), many)
            drawn = [around(normals[pick].astype(float), np.sqrt(wide[pick])[:, None] * polar(rng, many))]
            drawn += [lobe.draw(square, few, rng) for lobe in compared]
            u, angle = rng.random(left), 2 * math.pi * rng.random(left)
            drawn += [np.stack([np.sqrt(u) * np.cos(angle), np.sqrt(u) * np.sin(angle), np.sqrt(1 - u)], -1)]
            h = np.concatenate(drawn)
            h = h[h[:, 2] > 1e-6]  # the others weigh nothing
            # The balance heuristic: each weighs by the density of all that were drawn.
            shape, density = mixture(h.astype(np.float32), normals, wide)
            density *= many
            for lobe in compared:
                density += few * lobe.values(h, square) * np.maximum(h @ lobe.normal, 0)
            measure = 2 / math.pi * h[:, 2] ** 3 / (density + left * h[:, 2] / math.pi)
            light = 3 * specular * shape
            knee = knee_of((measure * light).sum() / measure.sum(), diffuse, dark)
            weight = share_of_norm(measure * (knee / (light + knee)) ** 1.5, shape)
            weight += squares * share_of_norm(measure, shape)
            self.sizes.append((h, shape, weight / (1 + squares) / len(SQUARES), square))

    def error(self, lobe, scale=None):
        """Error of one lobe at this scale relative to the filtered colour, or at the best one within the walls."""
        td = dd = 0.0
        for h, shape, weight, square in self.sizes:
            values = lobe.values(h, square)
            weighted = weight * values
            td += weighted @ shape
            dd += weighted @ values
        return float(at_best_scale(td, dd) if scale is None else 1 - 2 * scale * td + scale * scale * dd)

    def errors(self, normals, alpha_squared):
        """Errors (C, A) of isotropic lobes: each of C normals with each of A widths."""
        td, dd = np.zeros((2, len(normals), len(alpha_squared)))
        for h, shape, weight, square in self.sizes:
            cos = h @ normals.T
            for k, one in enumerate(alpha_squared):
                values = ggx(cos, one + square)
                td[:, k] += (weight * shape) @ values
                dd[:, k] += weight @ (values * values)
        return at_best_scale(td, dd)

    def peaks(self, count):
        """Half vectors (count, 3) where the target is high, spread over the highest tenth."""
        h, shape, _, _ = self.sizes[0]
        order = np.argsort(-shape)[: max(count, len(h) // 10)]
        return h[order[np.linspace(0, len(order) - 1, count).astype(int)]]


def at_best_scale(td, dd):
    """Relative errors where the target's own square is 1."""
    scale = np.clip(td / np.maximum(dd, 1e-30), LEAST_SCALE, MOST_SCALE)
    return 1 - 2 * scale * td + scale * scale * dd


def search(target, start, most):
    """The lobe where NLopt's subplex method, which needs no gradient, ends after ``most`` evaluations."""

    def lobe_of(z):
        return Lobe(unit(np.array([-z[0], -z[1], 1.0])), z[2:])

    bounds = np.array([5.0, 5.0, 0.0, 0.0, 6.0]), np.array([-5.0, -5.0, *[2 * math.log(LEAST_ALPHA)] * 2, -6.0])
    solver = nlopt.opt(nlopt.LN_SBPLX, 5)
    solver.set_min_objective(lambda z, _: target.error(lobe_of(z)))
    solver.set_upper_bounds(bounds[0])
    solver.set_lower_bounds(bounds[1])
    solver.set_initial_step([0.02, 0.02, 0.5, 0.5, 0.2])
    solver.set_maxeval(most)
    begin = np.concatenate([-start.normal[:2] / max(start.normal[2], 0.2), start.log_tensor])
    return lobe_of(solver.optimize(np.clip(begin, bounds[1], bounds[0])))
