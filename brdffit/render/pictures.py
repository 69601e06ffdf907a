"""Pictures of an appearance: linear radiance, each pixel read once and shaded under all lights.

A pyramid of lobes is drawn by compiled loops. Whatever else is an ``Appearance`` is drawn by one path in numpy: a loop
over lights, and under an environment multiple importance sampling (Veach and Guibas 1995, balance heuristic) of the
environment's directions and of the appearance's own. Directional lights and directions of an environment below the
plane of the texture light nothing, as in the half-angle density.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import Appearance, LobePyramid, Lookups
from brdffit.errors import InputError
from brdffit.methods import Pyramid
from brdffit.render import lights as light_sets
from brdffit.render._environment_kernels import LIGHT_X, LIGHT_Z
from brdffit.render._footprints import PIXELS_PER_PIECE, run_in_threads
from brdffit.render._packing import environment_pyramid_loop, pack_levels, pyramid_loop
from brdffit.render.environment import Environment
from brdffit.render.lighting import Pixels, lightings
from brdffit.render.lights import Lights
from brdffit.render.scenes import Scene, level_of_detail
from brdffit.render.terms import Terms
from brdffit.svbrdf import Svbrdf

#: Blocks of directions of either kind, and directions of either kind in the path in numpy, for each of two halves.
_BLOCKS, _DIRECTIONS = 1, 64
#: Pixels that the path in numpy draws at a time.
_PIXELS = 4096

#: What can be drawn: an appearance, a pyramid of a method, or MIP levels from level 0 down.
Drawable = Appearance | Pyramid | Sequence[Svbrdf]


def render_appearance(
    appearance: Drawable,
    scene: Scene,
    lights: Lights | None = None,
    *,
    environment: Environment | None = None,
    terms: Terms = Terms(),  # noqa: B008
    threads: int | None = None,
) -> NDArray:
    """The picture of an appearance: linear radiance (h, w, 3) float32.

    Args:
        appearance: what is drawn, see ``brdffit.appearance``.
        scene: what the camera sees, of a base of the appearance's size.
        lights, environment: what lights it; the few small lights where neither is given.
        terms: terms of the BRDF that are lit; only a pyramid of lobes can leave some out.
        threads: worker threads; None takes one a core. The picture does not depend on it.

    Raises:
        InputError: when the scene was made for a base of another size, or for terms that cannot be left out.
    """
    return render_appearance_halves(
        appearance, scene, lights, environment=environment, terms=terms, threads=threads
    ).mean(axis=0)


def render_appearance_halves(
    appearance: Drawable,
    scene: Scene,
    lights: Lights | None = None,
    *,
    environment: Environment | None = None,
    terms: Terms = Terms(),  # noqa: B008
    threads: int | None = None,
) -> NDArray:
    """Two independent estimates (2, h, w, 3) float32 that the picture is the mean of; equal under lights alone.

    Arguments and errors as in ``render_appearance``.
    """
    appearance = appearance_of(appearance)
    if tuple(appearance.base_size) != tuple(scene.base_size):
        raise InputError(
            f"The scene was made for a base of {scene.base_size} texels, but level 0 has {appearance.base_size}."
        )
    pixels = Pixels(scene)
    detail = level_of_detail(scene)[pixels.rows, pixels.columns].astype(np.float64)
    if lights is None and environment is None:
        lights = light_sets.few()
    if isinstance(appearance, LobePyramid):
        found = _draw_lobes(appearance, scene, pixels, detail, lights, environment, terms, threads)
    elif terms == Terms():
        found = _draw(appearance, scene, pixels, detail, lights, environment)
    else:
        raise InputError("Only a pyramid of lobes can be drawn without some terms of its BRDF.")
    halves = np.zeros((2, *scene.pixels, 3), np.float32)
    halves[:, pixels.rows, pixels.columns] = found
    return halves


def appearance_of(given: Drawable) -> Appearance:
    """The appearance that a pyramid or a list of levels is; an appearance as it is."""
    if isinstance(given, Pyramid):
        return LobePyramid([level.svbrdf for level in given.levels])
    return LobePyramid(list(given)) if isinstance(given, Sequence) else given


def _draw_lobes(
    pyramid: LobePyramid, scene: Scene, pixels: Pixels, detail: NDArray, lights: Lights | None,
    environment: Environment | None, terms: Terms, threads: int | None,
) -> NDArray:  # fmt: skip
    """Both halves (2, n, 3) of the pixels of a pyramid of lobes, by the compiled loops."""
    levels = pyramid.levels
    detail = np.clip(detail, 0.0, len(levels) - 1.0)
    # Only the levels that are seen are packed.
    finest, coarsest = math.floor(detail.min(initial=len(levels) - 1.0)), math.ceil(detail.max(initial=0.0))
    packed = pack_levels(levels[finest : max(coarsest, finest) + 1])
    detail -= finest
    base_size = np.array(scene.base_size[::-1], np.float64)
    found = np.zeros((2, len(detail), 3))
    passes = lightings(lights, environment, packed.model, terms, pyramid_loop, environment_pyramid_loop)

    def work(part: slice) -> int:
        for lighting in passes:
            random = lighting.environment is not None
            for half in (0, 1) if random else (0,):
                before = found[half, part].copy() if not random else None
                blocks = (_BLOCKS, half * _BLOCKS) if random else ()
                lighting.loop(
                    packed.texels, packed.levels, packed.tile, pixels.centre[part], base_size, detail[part],
                    *lighting.pixels(pixels.key[part], pixels.view[part], pixels.frame[part]), *lighting.data, *blocks,
                    found[half, part], *lighting.kernels,
                )  # fmt: skip
                if before is not None:
                    found[1, part] += found[0, part] - before
        return part.stop - part.start

    step = PIXELS_PER_PIECE
    jobs = [(slice(i, min(i + step, len(detail))),) for i in range(0, len(detail), step)]
    run_in_threads(work, jobs, threads, None, len(detail))
    return found


def _draw(
    appearance: Appearance, scene: Scene, pixels: Pixels, detail: NDArray, lights: Lights | None,
    environment: Environment | None,
) -> NDArray:  # fmt: skip
    """Both halves (2, n, 3) of the pixels of any appearance."""
    axes = scene.axes[pixels.rows, pixels.columns]
    lookups = Lookups(pixels.centre, np.ascontiguousarray(axes, np.float64), detail, pixels.view)
    found = np.zeros((2, len(detail), 3))
    for first in range(0, len(detail), _PIXELS):
        part = slice(first, first + _PIXELS)
        view, frame = pixels.view[part], pixels.frame[part]
        texels = appearance.look_up(lookups.part(part))
        if lights is not None:
            found[:, part] += _under_lights(appearance, texels, view, frame, lights)
        if environment is not None:
            for half in (0, 1):
                seed = np.random.default_rng([half, first])
                found[half, part] += _all_around(appearance, texels, view, frame, environment, seed)
    return found


def _under_lights(appearance: Appearance, texels: object, view: NDArray, frame: NDArray, lights: Lights) -> NDArray:
    """Radiance (n, 3) under directional lights."""
    found = np.zeros((len(view), 3))
    for direction, irradiance in zip(lights.direction, lights.irradiance, strict=True):
        light = frame @ direction.astype(np.float64)
        reflected = np.asarray(appearance.evaluate(texels, view, light), np.float64)
        found += np.where(light[:, 2:] > 0.0, irradiance * reflected, 0.0)
    return found


def _all_around(
    appearance: Appearance, texels: object, view: NDArray, frame: NDArray, environment: Environment,
    random: np.random.Generator,
) -> NDArray:  # fmt: skip
    """Radiance (n, 3) under an environment: f L / (p_e + p_a), summed over directions of both densities, over their
    number."""
    frame = environment.turned(frame)
    found = np.zeros((len(view), 3))
    count = len(view)
    # Any run of the table is well spread; each pixel reads another.
    towards = environment.table[LIGHT_X : LIGHT_Z + 1].T.astype(np.float64)
    run = random.integers(len(towards), size=count)
    # Jittered along the first number, so that a pixel's directions are spread over the lobe.
    u = random.random((_DIRECTIONS, count, 2))
    u[..., 0] = (u[..., 0] + np.argsort(random.random((_DIRECTIONS, count)), axis=0)) / _DIRECTIONS
    for i in range(_DIRECTIONS):
        of_lobe = np.asarray(appearance.sample(texels, view, u[i]), np.float64)
        for light in (np.einsum("nij,nj->ni", frame, towards[(run + i) % len(towards)]), of_lobe):
            radiance, density = environment.look_up(np.einsum("nji,nj->ni", frame, light))
            density = density + appearance.pdf(texels, view, light)
            reflected = np.asarray(appearance.evaluate(texels, view, light), np.float64) * radiance
            found += np.where(light[:, 2:] > 0.0, reflected / np.maximum(density, 1e-20)[:, None], 0.0)
    return found / _DIRECTIONS
