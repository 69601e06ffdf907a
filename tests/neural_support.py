"""A slow oracle of the neural material in float64, and a source of queries that is a formula."""

import math

import numpy as np

from brdffit.neural.network import Network


def texels(flat, sizes):
    """Levels (h, w, 7) float64 of a flat texture of 8 floats a texel."""
    found, first = [], 0
    for height, width in sizes:
        found.append(flat[first : first + height * width * 8].reshape(height, width, 8)[..., :7].astype(float))
        first += height * width * 8
    return found


def circulant(sigma, length):
    """A periodic Gaussian as a matrix, by summing it over many periods."""
    if sigma < 0.2 or length == 1:
        return np.eye(length)
    at = np.arange(-math.ceil(4 * sigma), math.ceil(4 * sigma) + 1)
    weights = np.exp(-0.5 * (at / sigma) ** 2)
    matrix = np.zeros((length, length))
    for row in range(length):
        np.add.at(matrix[row], (row + at) % length, weights / weights.sum())
    return matrix


def blurred(levels, sigma, size):
    made = []
    for level in levels:
        height, width = level.shape[:2]
        down, across = circulant(sigma * height / size[0], height), circulant(sigma * width / size[1], width)
        made.append(np.einsum("ij,kl,jlc->ikc", down, across, level))
    return made


def bilinear(level, x, y):
    height, width = level.shape[:2]
    i, j = math.floor(x - 0.5), math.floor(y - 0.5)
    a, b = x - 0.5 - i, y - 0.5 - j
    corner = lambda row, column: level[row % height, column % width]  # noqa: E731
    upper = (1 - a) * corner(j, i) + a * corner(j, i + 1)
    return (1 - b) * upper + b * ((1 - a) * corner(j + 1, i) + a * corner(j + 1, i + 1))


def chain(network: Network, name, values):
    for layer in range(4):
        weight, bias = network.taken(name, layer)
        values = values @ weight.astype(float) + bias
        values = np.maximum(values, 0) if layer < 3 else values
    return values


def shift_of(network: Network, query, sigma=0.0):
    """The parallax offset (2,) of one query, across and down in texels of level 0."""
    x, y, _, _, _, vx, vy = query[:7].astype(float)
    texture = blurred(texels(network.offset_texture, network.base.sizes), sigma, network.design.size)[0]
    depth = chain(network, "offset", np.concatenate([bilinear(texture, x, y), [vx, vy]]))[0]
    return network.reach * np.array([vx, -vy]) * depth / max(math.sqrt(max(1 - vx * vx - vy * vy, 0)), 0.6)


def predicted(network: Network, query, sigma=0.0):
    """p (3,), not clamped at 0, of one query."""
    design = network.design
    height, width = design.size
    x, y, detail, lx, ly, vx, vy = query[:7].astype(float)
    lz, vz = (math.sqrt(max(1 - a * a - b * b, 0)) for a, b in ((lx, ly), (vx, vy)))
    pyramid = blurred(texels(network.pyramid, network.layout.sizes), sigma, design.size)
    if design.with_offset:
        across, down = shift_of(network, query, sigma)
        x, y = x + across, y + down
    fine = min(int(detail), len(pyramid) - 2)
    part = detail - fine
    features = sum(
        weight * bilinear(level, x * level.shape[1] / width, y * level.shape[0] / height)
        for weight, level in ((1 - part, pyramid[fine]), (part, pyramid[fine + 1]))
    )
    directions = [lx, ly, vx, vy]
    if design.tilted:
        half = np.array([lx + vx, ly + vy, lz + vz])
        half /= np.linalg.norm(half)
        u = half[:2] + features[:2] * half[2]
        along = [z - features[0] * a - features[1] * b for a, b, z in ((lx, ly, lz), (vx, vy, vz))]
        directions = [
            2 * u[0],
            2 * u[1],
            vx,
            vy,
            -0.25 * math.log(u @ u + math.exp(-4 * min(max(features[2], -0.5), 2.5))),
            *along,
        ]
    out = chain(network, "decoder", np.concatenate([features, directions]))
    masks = out[3:] + features[3:6] if design.tilted else out[3:]
    return (np.exp(out[:3]) - 1) * (0.1 + 1 / (1 + np.exp(-masks)))


class CheckeredDepth:
    """A checker of two lobes of GGX on normals tilted to either side, some texels below the plane, unfiltered noise.

    What is seen from v at u is the checker at u moved against v by its depth: parallax that an offset can follow.
    """

    def __init__(self, size=32, depth=2.0, alpha=(0.25, 0.4), colour=((0.6, 0.3, 0.2), (0.1, 0.3, 0.5))):
        self.size, self.depth, self.alpha, self.colour = (size, size), depth, alpha, np.array(colour)

    def query(self, position, sigma, light, view, seed):
        """See ``QuerySource``: M of one point under each filter."""
        rng = np.random.default_rng(seed)
        at = position + rng.standard_normal(position.shape) * np.asarray(sigma)[:, None]
        at = at - self.depth * view[:, :2] / view[:, 2:] * np.array([1.0, -1.0])
        cell = np.floor(at / (self.size[0] / 4)).astype(int).sum(axis=1) % 2
        half = light + view
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        tilt = np.where(cell == 1, 0.25, -0.25)
        normal = np.stack([tilt, np.zeros_like(tilt), np.sqrt(1 - tilt**2)], axis=1)
        alpha2 = np.array(self.alpha)[cell] ** 2
        cosine = (half * normal).sum(axis=1)
        lobe = alpha2 / (math.pi * ((cosine**2) * (alpha2 - 1) + 1) ** 2)
        facing = np.maximum((light * normal).sum(axis=1), 0.0)
        radiance = facing[:, None] * (self.colour[cell] / math.pi + 0.04 * lobe[:, None])
        return (radiance / light[:, 2:]).astype(np.float32)
