"""Small random pyramids for the tests of what is written."""

from __future__ import annotations

import numpy as np

from brdffit.fitting.options import FitOptions
from brdffit.footprint import filter_pyramid, get_pixel_filter
from brdffit.methods import Level, Pyramid
from brdffit.roughness import log_from_tensor, tensor_from_log
from brdffit.svbrdf import Svbrdf, level_sizes


def random_svbrdf(size=(24, 40), seed=0, slope=0.3, lowest=0.2, **extra) -> Svbrdf:
    """Random normals, anisotropic tensors and colours whose specular is that of the metallic-roughness model."""
    random = np.random.default_rng(seed)
    normal = np.concatenate([slope * random.standard_normal((*size, 2)), np.ones((*size, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    angle, ratio = random.uniform(0, np.pi, size), random.uniform(0, 1.5, size)
    mean = 4.0 * np.log(random.uniform(lowest, 0.7, size))
    half, c = ratio * np.cos(2 * angle), ratio * np.sin(2 * angle)
    base_color, metallic = random.uniform(0.1, 0.9, (*size, 3)), random.uniform(0, 1, (*size, 1))
    return Svbrdf(
        normal=normal.astype(np.float32),
        log_roughness=np.stack([mean + half, mean - half, c], axis=-1).astype(np.float32),
        specular=(0.04 * (1 - metallic) + base_color * metallic).astype(np.float32),
        diffuse=(base_color * (1 - metallic)).astype(np.float32),
        **extra,
    )


def averaged_pyramid(base: Svbrdf, levels=None, method="naive", **options) -> Pyramid:
    """Every channel box-averaged (the tensor, not its logarithm), normals made unit again."""
    sizes = level_sizes(base.size, levels)
    box = get_pixel_filter("box")

    def averaged(array):
        return filter_pyramid(np.ascontiguousarray(array, np.float32), sizes, box, base.wrap)

    tensors = averaged(tensor_from_log(base.log_roughness))
    normals, specular, diffuse = averaged(base.normal), averaged(base.specular), averaged(base.diffuse)
    shapes = averaged(base.shape[..., None]) if base.shape is not None else [None] * len(sizes)
    made = []
    for k in range(len(sizes)):
        svbrdf = base.replace(
            normal=normals[k] / np.linalg.norm(normals[k], axis=-1, keepdims=True),
            log_roughness=log_from_tensor(tensors[k]),
            specular=specular[k],
            diffuse=diffuse[k],
            shape=None if base.shape is None else shapes[k][..., 0],
            occlusion=None,
            height=None,
        )
        made.append(Level(svbrdf, seconds=0.1 * k))
    return Pyramid(method, FitOptions(levels=levels, **options), made)
