"""Slow, plain oracles in float64 numpy: lobes as the papers print them, dense grids, footprints sampled by hand.

Nothing here calls a kernel of the program, so that the two can disagree.
"""

import math

import numpy as np

MODELS = ["ggx", "beckmann", "generalised-beckmann", "blinn-phong", "ashikhmin-shirley"]


def unit(vector):
    vector = np.asarray(vector, dtype=np.float64)
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def normal_of_slopes(m_x, m_y):
    return unit(np.stack(np.broadcast_arrays(-np.asarray(m_x, float), -np.asarray(m_y, float), 1.0), axis=-1))


def shortest_rotation(normal):
    """Rodrigues' rotation that takes z to ``normal`` (3,): axis z x n, angle between them."""
    axis = np.cross([0.0, 0.0, 1.0], normal)
    sine, cosine = np.linalg.norm(axis), normal[2]
    if sine < 1e-300:
        return np.eye(3)
    x, y, z = axis / sine
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + sine * cross + (1 - cosine) * cross @ cross


def tensor(log_tensor):
    """exp of [[a, c], [c, b]] by its eigenvectors."""
    a, b, c = log_tensor
    values, vectors = np.linalg.eigh([[a, c], [c, b]])
    return vectors @ np.diag(np.exp(values)) @ vectors.T


def lobe(model, h, normal, log_tensor, shape=0.0):
    """D(h; n, Sigma) at half vectors (..., 3), 0 below the lobe's own horizon."""
    local = h @ shortest_rotation(normal)
    x, c = local[..., :2], local[..., 2]
    sigma = tensor(log_tensor)
    root = math.sqrt(np.linalg.det(sigma))
    inverse = np.linalg.inv(sigma)
    cos = np.maximum(c, 1e-9)
    sin2 = np.sum(x * x, axis=-1)
    q = np.einsum("...i,ij,...j", x, inverse, x)
    if model == "ggx":
        value = 1 / (math.pi * root * (q + cos**2) ** 2)
    elif model == "beckmann":
        value = np.exp(-q / cos**2) / (math.pi * root * cos**4)
    elif model == "generalised-beckmann":
        power = math.exp(shape)
        value = np.exp(-((q / cos**2) ** power)) / (math.pi * root * cos**4 * math.gamma(1 + 1 / power))
    elif model == "blinn-phong":
        p = 2 / log_tensor_scale(log_tensor) - 2
        value = (p + 2) / (2 * math.pi) * cos**p
    else:
        # Exponents p_u and p_v along the axes of the tensor: x'Px with P = 2 Sigma^-1 - 2 I.
        exponent = np.einsum("...i,ij,...j", x, 2 * inverse - 2 * np.eye(2), x)
        log_cos = 0.5 * np.log1p(-np.minimum(sin2, 1 - 1e-18))
        ratio = np.where(sin2 > 1e-14, log_cos / np.maximum(sin2, 1e-14), -0.5)
        value = np.exp(exponent * ratio) / (math.pi * root)
    return np.where(c > 0, value, 0.0)


def log_tensor_scale(log_tensor):
    """alpha^2 of an isotropic log tensor."""
    return math.exp(0.5 * (log_tensor[0] + log_tensor[1]))


def log_tensor_of(alpha_major, alpha_minor, angle=0.0):
    """(a, b, c) of a tensor with these alphas, the major axis at ``angle``."""
    l1, l2 = 2 * math.log(alpha_major), 2 * math.log(alpha_minor)
    c, s = math.cos(angle), math.sin(angle)
    return np.array([l1 * c * c + l2 * s * s, l1 * s * s + l2 * c * c, (l1 - l2) * c * s])


def slope_rule(normal, log_tensor, radii=600, angles=96):
    """(h, weights) of a polar rule in the scaled slopes of one lobe: int f(h) dh over the lobe's hemisphere.

    Trapezoid in log radius, 1e-7 to 1e7 widths, and in angle: both converge exponentially for every lobe here. With
    s = Sigma^(1/2) r (cos f, sin f), dh = c^3 sqrt(det Sigma) r dr df.
    """
    t = np.linspace(math.log(1e-7), math.log(1e7), radii)
    f = (np.arange(angles) + 0.5) * 2 * math.pi / angles
    r = np.exp(t)[:, None]
    sigma = tensor(log_tensor)
    values, vectors = np.linalg.eigh(sigma)
    root = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    scaled = np.stack([r * np.cos(f), r * np.sin(f)], axis=-1)
    slopes = scaled @ root
    c = 1 / np.sqrt(1 + np.sum(slopes**2, axis=-1))
    local = np.concatenate([slopes * c[..., None], c[..., None]], axis=-1)
    weights = c**3 * math.sqrt(np.linalg.det(sigma)) * r * r * (t[1] - t[0]) * (f[1] - f[0])
    return (local @ shortest_rotation(normal).T).reshape(-1, 3), np.broadcast_to(weights, c.shape).ravel()


def disc_grid(step):
    """(h, dh) on the upper hemisphere: squares of side ``step`` of the projected hemisphere, dh = dx dy / h_z."""
    x = np.arange(-1 + step / 2, 1, step)
    x, y = np.meshgrid(x, x)
    inside = x * x + y * y < 1
    x, y = x[inside], y[inside]
    z = np.sqrt(1 - x * x - y * y)
    return np.stack([x, y, z], axis=-1), step * step / z


def half_angle_weight(h, density="cosine"):
    """w(h) as maths.md and Baker's integral have them."""
    z = h[..., 2]
    return 2 / math.pi * z**3 if density == "cosine" else z / math.pi


def draw_directions(rng, count, density="cosine"):
    """Directions of the upper hemisphere, uniform or cosine-distributed."""
    u, f = rng.random(count), 2 * math.pi * rng.random(count)
    z = np.sqrt(u) if density == "cosine" else u
    s = np.sqrt(1 - z * z)
    return np.stack([s * np.cos(f), s * np.sin(f), z], axis=-1)


def draw_half_vectors(rng, count, density="cosine"):
    """h of independent l and v."""
    return unit(draw_directions(rng, count, density) + draw_directions(rng, count, density))


def bilinear(image, y, x, wrap="tile"):
    """``image`` (H, W, ...) at texel coordinates where texel (j, i) is centred on (j + 1/2, i + 1/2)."""
    y, x = np.asarray(y) - 0.5, np.asarray(x) - 0.5
    j, i = np.floor(y).astype(int), np.floor(x).astype(int)
    total = 0.0
    for dj in (0, 1):
        for di in (0, 1):
            row, column = j + dj, i + di
            if wrap == "tile":
                row, column = row % image.shape[0], column % image.shape[1]
            else:
                row, column = np.clip(row, 0, image.shape[0] - 1), np.clip(column, 0, image.shape[1] - 1)
            weight = (1 - np.abs(x - i - di)) * (1 - np.abs(y - j - dj))
            total = total + weight.reshape(weight.shape + (1,) * (image.ndim - 2)) * image[row, column].astype(float)
    return total


def box_footprint(svbrdf, level_size, row, column, samples=24):
    """(weights, normals, log tensors, colours) of a box footprint, ``samples`` an axis; an isotropic base."""
    scale_y, scale_x = svbrdf.size[0] / level_size[0], svbrdf.size[1] / level_size[1]
    offset = (np.arange(samples) + 0.5) / samples
    y, x = np.meshgrid((row + offset) * scale_y, (column + offset) * scale_x, indexing="ij")
    y, x = y.ravel(), x.ravel()
    normals = unit(bilinear(svbrdf.normal, y, x, svbrdf.wrap))
    perceptual = bilinear(np.exp(svbrdf.log_roughness[..., 0].astype(float) / 4), y, x, svbrdf.wrap)
    log_alpha2 = 4 * np.log(perceptual)
    log_tensors = np.stack([log_alpha2, log_alpha2, np.zeros_like(log_alpha2)], axis=-1)
    return np.full(len(y), 1 / len(y)), normals, log_tensors, bilinear(svbrdf.specular, y, x, svbrdf.wrap)


def apparent_lobe(model, h, footprint):
    """T_c(h), (N, 3)."""
    total = np.zeros((len(h), 3))
    for weight, normal, log_tensor, colour in zip(*footprint, strict=True):
        total += (weight * lobe(model, h, normal, log_tensor))[:, None] * colour
    return total
