"""Cube maps: directions and solid angles of texels, neighbours across edges, coarser levels, and look-ups.

A cube map is an array (6, n, n) or (6, n, n, channels): faces +X -X +Y -Y +Z -Z, row 0 at the top, in the order and
orientation in which OpenGL, Direct3D, Vulkan and KTX2 look it up; +Y is up. The texel in column i and row j of a face
has its centre at u = (2i + 1)/n - 1, v = 1 - (2j + 1)/n.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FACES = ("+X", "-X", "+Y", "-Y", "+Z", "-Z")


def face_points(u: NDArray, v: NDArray) -> NDArray:
    """(6, ..., 3) points of the cube of half side 1 at (u, v) of every face."""
    u, v = np.broadcast_arrays(u, v)
    one = np.ones_like(u, dtype=np.float64)
    faces = ((one, v, -u), (-one, v, u), (u, one, -v), (u, -one, v), (u, v, one), (-u, v, -one))
    return np.stack([np.stack(face, axis=-1) for face in faces])


@lru_cache(maxsize=16)
def directions(n: int) -> NDArray:
    """(6, n, n, 3) float64 unit directions of the texel centres; read only."""
    centre = (2.0 * np.arange(n) + 1.0) / n - 1.0
    points = face_points(centre[None, :], -centre[:, None])
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    points.setflags(write=False)
    return points


@lru_cache(maxsize=16)
def solid_angles(n: int) -> NDArray:
    """(n, n) float64 solid angles of the texels of one face, exact: six times their sum is 4 pi; read only.

    The rectangle from the centre of a face to (u, v) has the solid angle atan2(u v, sqrt(1 + u^2 + v^2)).
    """
    edge = 2.0 * np.arange(n + 1) / n - 1.0
    u, v = np.meshgrid(edge, edge)
    corner = np.arctan2(u * v, np.sqrt(1.0 + u * u + v * v))
    angles = corner[1:, 1:] - corner[1:, :-1] - corner[:-1, 1:] + corner[:-1, :-1]
    angles.setflags(write=False)
    return angles


def face_coordinates(direction: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Face (int), u and v of directions (..., 3), which need not have unit length."""
    size = np.abs(direction)
    axis = np.argmax(size, axis=-1)
    major = np.take_along_axis(direction, axis[..., None], -1)[..., 0]
    face = 2 * axis + (major <= 0.0)
    scaled = direction / np.abs(major)[..., None]
    x, y, z = scaled[..., 0], scaled[..., 1], scaled[..., 2]
    u = np.choose(face, [-z, z, x, x, x, -x])
    v = np.choose(face, [y, y, -z, z, y, y])
    return face, u, v


class Border(NamedTuple):
    """Sources of the border texels of padded faces, as flat indices into an array (6, n + 2, n + 2).

    Attributes:
        edge: (24 n,) border texels other than corners.
        edge_source: (24 n,) the interior texel of the neighbouring face that each of them copies.
        corner: (24,) corners of the border.
        corner_source: (24, 3) the three interior texels around that corner of the cube, of which each is the mean.
    """

    edge: NDArray
    edge_source: NDArray
    corner: NDArray
    corner_source: NDArray


@lru_cache(maxsize=16)
def border(n: int) -> Border:
    """The border of faces of n^2 texels."""
    m = n + 2
    row, column = np.meshgrid(np.arange(m), np.arange(m), indexing="ij")
    on_edge = ((row == 0) | (row == m - 1)) ^ ((column == 0) | (column == m - 1))
    u, v = (2.0 * column[on_edge] - 1.0) / n - 1.0, 1.0 - (2.0 * row[on_edge] - 1.0) / n
    # Move the point to just beyond the edge: the coordinate along the edge then decides the neighbour's texel.
    over = 1.0 + 1e-6 / n
    face, u, v = face_coordinates(face_points(np.clip(u, -over, over), np.clip(v, -over, over)))
    i = np.clip(((u + 1.0) * 0.5 * n).astype(int), 0, n - 1)
    j = np.clip(((1.0 - v) * 0.5 * n).astype(int), 0, n - 1)
    texel = np.arange(6 * m * m).reshape(6, m, m)
    source = texel.copy()
    source[:, on_edge] = (face * m + j + 1) * m + i + 1
    r, c = np.array([0, 0, m - 1, m - 1]), np.array([0, m - 1, 0, m - 1])
    inner_r, inner_c = np.clip(r, 1, n), np.clip(c, 1, n)
    around = np.stack([source[:, inner_r, inner_c], source[:, inner_r, c], source[:, r, inner_c]], axis=-1)
    return Border(texel[:, on_edge].ravel(), source[:, on_edge].ravel(), texel[:, r, c].ravel(), around.reshape(24, 3))


def pad(cube: NDArray) -> NDArray:
    """(6, n + 2, n + 2, ...) of a cube map (6, n, n, ...): each face with a border of its neighbours' texels."""
    n = cube.shape[1]
    padded = np.zeros((6, n + 2, n + 2, *cube.shape[3:]), cube.dtype)
    padded[:, 1:-1, 1:-1] = cube
    where = border(n)
    flat = padded.reshape(6 * (n + 2) ** 2, *cube.shape[3:])
    flat[where.edge] = flat[where.edge_source]
    flat[where.corner] = flat[where.corner_source].mean(axis=1)
    return padded


def corners(direction: NDArray, n: int) -> tuple[NDArray, NDArray, NDArray, NDArray, NDArray]:
    """Face, row and column of the first of four texels of padded faces of n^2, and the fractions down and right."""
    face, u, v = face_coordinates(direction)
    x, y = (u + 1.0) * 0.5 * n + 0.5, (1.0 - v) * 0.5 * n + 0.5
    i, j = np.clip(x.astype(int), 0, n), np.clip(y.astype(int), 0, n)
    return face, j, i, y - j, x - i


def look_up(cube: NDArray, direction: NDArray) -> NDArray:
    """Bilinear value of a cube map (6, n, n, channels) in directions (..., 3), seamless across edges."""
    padded = pad(cube)
    face, j, i, down, right = corners(direction, cube.shape[1])
    right, down = right[..., None], down[..., None]
    top = padded[face, j, i] * (1.0 - right) + padded[face, j, i + 1] * right
    bottom = padded[face, j + 1, i] * (1.0 - right) + padded[face, j + 1, i + 1] * right
    return top * (1.0 - down) + bottom * down


def look_up_trilinear(levels: list[NDArray], direction: NDArray, level: NDArray) -> NDArray:
    """Trilinear value (..., channels) of the levels of a cube map in directions (..., 3).

    ``level`` (...) is the level of detail; it is clamped to [0, len(levels) - 1].
    """
    level = np.clip(level, 0.0, len(levels) - 1.0)
    below = np.minimum(level.astype(int), max(len(levels) - 2, 0))
    out = np.zeros((*direction.shape[:-1], levels[0].shape[-1]))
    for index, cube in enumerate(levels):
        weight = np.where(below == index, 1.0 - (level - below), np.where(below + 1 == index, level - below, 0.0))
        chosen = weight > 0.0
        if chosen.any():
            out[chosen] += weight[chosen, None] * look_up(cube, direction[chosen])
    return out


def halved(cube: NDArray) -> NDArray:
    """The cube map of half the size; each texel is the mean of four, weighted by solid angle, which keeps energy."""
    n = cube.shape[1]
    angle = solid_angles(n)[..., None]
    shape = (6, n // 2, 2, n // 2, 2, cube.shape[3])
    total = (cube * angle).reshape(shape).sum(axis=(2, 4))
    weight = np.broadcast_to(angle, (n, n, 1)).reshape(1, n // 2, 2, n // 2, 2, 1).sum(axis=(2, 4))
    return (total / weight).astype(cube.dtype)


def resized(cube: NDArray, n: int) -> NDArray:
    """The cube map with faces of n^2 texels: means over texels where it shrinks, repeated texels where it grows.

    Raises:
        ValueError: when neither size is a power of two times the other.
    """
    while cube.shape[1] > n and cube.shape[1] % 2 == 0:
        cube = halved(cube)
    while cube.shape[1] < n:
        cube = cube.repeat(2, axis=1).repeat(2, axis=2)
    if cube.shape[1] != n:
        raise ValueError(f"a cube map of {cube.shape[1]} texels cannot become one of {n} by halving or doubling")
    return cube


def mean_radiance(cube: NDArray) -> NDArray:
    """(channels,) float64 mean over the sphere of a cube map (6, n, n, channels)."""
    angle = solid_angles(cube.shape[1])
    return np.einsum("fjic,ji->c", cube.astype(np.float64), angle) / (4.0 * np.pi)


def latlong_directions(height: int) -> NDArray:
    """(height, 2 height, 3) unit directions of the pixels of a lat-long picture, its middle column along -Z."""
    polar = (np.arange(height) + 0.5) / height * np.pi
    azimuth = ((np.arange(2 * height) + 0.5) / height - 1.0) * np.pi
    level = np.sin(polar)[:, None]
    x, z = level * np.sin(azimuth), -level * np.cos(azimuth)
    return np.stack([x, np.broadcast_to(np.cos(polar)[:, None], x.shape), z], axis=-1)
