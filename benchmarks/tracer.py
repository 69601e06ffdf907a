"""``python -m benchmarks.tracer [SET]``: the cost of tracing a height, beside Embree, and the value of its effects.

Rays start at the height of the highest point and go down to the surface, in directions over the hemisphere. Embree
(embreex, the extra ``tracers``) gets the same triangles, three tiles by three, on one thread as ours. The value of an
effect is the SNR of a close-up without it against one with all effects (20 log10 of signal over difference), 60 degrees
from the normal; two independent estimates keep noise out of it.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from brdffit.microgeometry.heightfield import HeightField
from brdffit.microgeometry.kernels.traversal import meet_rows
from brdffit.microgeometry.tracer import Effects, Microgeometry
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.procedural import make_set
from brdffit.textures.reading import read_texture_set

_RAYS, _SIDE, _SAMPLES, _REPEATS = 200000, 96, 16, 3


def shortest(work: Callable[[], object]) -> float:
    """Seconds of the shortest of some runs; the first run is not counted."""
    runs = []
    for _ in range(_REPEATS + 1):
        start = time.perf_counter()
        work()
        runs.append(time.perf_counter() - start)
    return min(runs[1:])


def rays_down(field: HeightField, count: int) -> tuple[NDArray, NDArray]:
    """Origins at the highest point and directions below it, (n, 3): (column, row, height)."""
    random = np.random.default_rng(0)
    height, width = field.size
    top = float(field.height.max()) + 1e-3
    at = random.random((count, 2)) * (width, height)
    z, angle = 0.2 + 0.8 * random.random(count), 2.0 * math.pi * random.random(count)
    across = np.sqrt(1.0 - z * z)
    return np.column_stack([at, np.full(count, top)]), np.column_stack(
        [across * np.cos(angle), across * np.sin(angle), -z]
    )


def triangles(height: NDArray) -> tuple[NDArray, NDArray]:
    """Vertices and faces of three tiles by three, the second tile at the origin."""
    rows, columns = height.shape
    j, i = np.mgrid[: 3 * rows + 1, : 3 * columns + 1]
    vertices = np.stack([i - columns, j - rows, height[j % rows, i % columns]], axis=-1).reshape(-1, 3)
    a = (np.arange(3 * rows)[:, None] * (3 * columns + 1) + np.arange(3 * columns)).ravel()
    b, c, d = a + 1, a + 3 * columns + 1, a + 3 * columns + 2
    return vertices, np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])


def rays_a_second(field: HeightField) -> tuple[float, float | None, float | None]:
    """Rays a second of ours and of Embree, and the largest difference of distances in texels; None without embreex."""
    origin, direction = rays_down(field, _RAYS)
    found = np.empty((_RAYS, 5))
    ours = shortest(lambda: meet_rows(field.height, field.maxima, field.levels, origin, direction, found))
    try:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh
    except ImportError:
        return _RAYS / ours, None, None
    vertices, faces = triangles(field.height)
    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, vertices.astype(np.float32), faces.astype(np.int32))
    start, towards = origin.astype(np.float32), direction.astype(np.float32)
    theirs = shortest(lambda: scene.run(start, towards))
    distance = scene.run(start, towards, query="DISTANCE")
    apart = np.abs(distance - found[:, 0])
    return _RAYS / ours, _RAYS / theirs, float(np.quantile(apart, 0.999))


def picture(traced: Microgeometry, seed: int) -> NDArray:
    """(n, 3) mean radiance of the pixels of a close-up, 60 degrees from the normal."""
    random = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(_SIDE), np.arange(_SIDE)), axis=-1).reshape(-1, 2)
    view, light = np.array([0.0, -math.sin(math.pi / 3), 0.5]), np.array([-0.6, 0.3, 0.6])
    light /= np.linalg.norm(light)
    total = np.zeros((len(grid), 3))
    for k in range(_SAMPLES):
        at = grid + random.random(grid.shape)
        total += traced.reflect(at, np.tile(view, (len(grid), 1)), np.tile(light, (len(grid), 1)), 1000 * seed + k)
    return total / _SAMPLES


def effects_table(field: HeightField) -> list[tuple[str, float, float | None]]:
    """(effects, nanoseconds a sample, dB of the picture against the one with all)."""
    everything = Effects(bounces=2)
    without = {
        "all": everything,
        "without parallax": dataclasses.replace(everything, displacement=False),
        "without shadowing": dataclasses.replace(everything, shadowing=False),
        "without interreflection": dataclasses.replace(everything, bounces=0),
        "none": Effects(displacement=False, shadowing=False, bounces=0),
    }
    whole = [picture(Microgeometry(field, everything), seed) for seed in (0, 1)]
    rows: list[tuple[str, float, float | None]] = []
    for name, effects in without.items():
        traced = Microgeometry(field, effects)
        seconds = shortest(lambda each=traced: picture(each, 0))  # type: ignore[misc]
        other = [picture(traced, seed) for seed in (0, 1)]
        error = float(((whole[0] - other[0]) * (whole[1] - other[1])).sum())
        power = float((whole[0] * whole[1]).sum())
        db = None if name == "all" or error <= 0.0 else 10.0 * math.log10(power / error)
        rows.append((name, 1e9 * seconds / (_SIDE**2 * _SAMPLES), db))
    return rows


@click.command()
@click.argument("source", required=False, type=click.Path(path_type=Path))
def main(source: Path | None) -> None:
    """Print both tables for SET, or for the shipped pebbles at 256 texels."""
    with tempfile.TemporaryDirectory() as folder:
        field = HeightField.of(
            to_svbrdf(read_texture_set(source or make_set("pebbles", Path(folder) / "pebbles", 256)))
        )
    ours, theirs, apart = rays_a_second(field)
    click.echo(f"rays a second, one thread: ours {ours / 1e6:.2f} M")
    if theirs is not None:
        click.echo(f"Embree on the same mesh: {theirs / 1e6:.2f} M; 999 of 1000 distances agree to {apart:.1e} texels")
    click.echo(f"{'effects':26}{'ns a sample':>12}{'dB':>8}")
    for name, nanoseconds, db in effects_table(field):
        click.echo(f"{name:26}{nanoseconds:12.0f}{'-' if db is None else format(db, '.1f'):>8}")


if __name__ == "__main__":
    main()
