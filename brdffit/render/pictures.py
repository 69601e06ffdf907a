"""Pictures of an appearance: linear radiance, each pixel read once and shaded under all lights.

A pyramid of lobes is drawn by compiled loops. Whatever else is an ``Appearance`` is drawn by one path in numpy: a loop
over lights, and under an environment multiple importance sampling (Veach and Guibas 1995, balance heuristic) of the
environment's directions and of the appearance's own. Directional lights and directions of an environment below the
plane of the texture light nothing, as in the half-angle density.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import Appearance, LobePyramid, Lookups
from brdffit.errors import InputError
from brdffit.methods import Pyramid
from brdffit.render._environment_kernels import LIGHT_X
from brdffit.render._footprints import PIXELS_PER_PIECE, run_in_threads
from brdffit.render._packing import environment_pyramid_loop, pack_levels, pyramid_loop
from brdffit.render.environment import Environment
from brdffit.render.lighting import Lit, Pixels, passes
from brdffit.render.lights import Lights
from brdffit.render.scenes import Scene, level_of_detail
from brdffit.render.terms import Terms
from brdffit.svbrdf import Svbrdf

#: Directions of either kind that a half of a picture takes: in the compiled loops, and in the path in numpy.
_DIRECTIONS, _PLAIN_DIRECTIONS = 512, 64
#: Added to the seeds of blocks, so that they exceed those of a reference and the samples of both are independent.
_PART = 1 << 24
#: Pixels that the path in numpy draws at a time.
_PIXELS = 2048

#: What can be drawn: an appearance, a pyramid of a method, or MIP levels from level 0 down.
Drawable = Appearance | Pyramid | Sequence[Svbrdf]


def render_appearance(
    appearance: Drawable,
    scene: Scene,
    lights: Lights | None = None,
    *,
    environment: Environment | None = None,
    terms: Terms = Terms(),  # noqa: B008
    lamps: str = "sampled",
    threads: int | None = None,
) -> NDArray:
    """The picture of an appearance: linear radiance (h, w, 3) float32.

    Args:
        appearance: what is drawn, see ``brdffit.appearance``.
        scene: what the camera sees, of a base of the appearance's size.
        lights, environment: what lights it; the few small lights where neither is given.
        terms: terms of the BRDF that are lit; only a pyramid of lobes can leave some out.
        lamps: how lights that have a size are drawn, "sampled" or "widened" (of a pyramid of lobes), see
            ``render_halves``.
        threads: worker threads; None takes one a core. The picture does not depend on it.

    Raises:
        InputError: when the scene was made for a base of another size, or for terms that cannot be left out.
    """
    return render_appearance_halves(
        appearance, scene, lights, environment=environment, terms=terms, lamps=lamps, threads=threads
    ).mean(axis=0)


def render_appearance_halves(
    appearance: Drawable,
    scene: Scene,
    lights: Lights | None = None,
    *,
    environment: Environment | None = None,
    terms: Terms = Terms(),  # noqa: B008
    lamps: str = "sampled",
    directions: int = _PLAIN_DIRECTIONS,
    threads: int | None = None,
) -> NDArray:
    """Two independent estimates (2, h, w, 3) float32 that the picture is the mean of; equal under lights alone.

    Arguments and errors as in ``render_appearance``; ``directions``: of light that has a size, of either kind and for
    each half, where the path in numpy draws.
    """
    appearance = appearance_of(appearance)
    if tuple(appearance.base_size) != tuple(scene.base_size):
        raise InputError(
            f"The scene was made for a base of {scene.base_size} texels, but level 0 has {appearance.base_size}."
        )
    pixels = Pixels(scene)
    detail = level_of_detail(scene)[pixels.rows, pixels.columns].astype(np.float64)
    lit = Lit.by(lights, environment, terms, lamps)
    if isinstance(appearance, LobePyramid):
        found = _draw_lobes(appearance, scene, pixels, detail, lit, threads)
    elif terms == Terms():
        found = _draw(appearance, scene, pixels, detail, lit, directions, threads)
    else:
        raise InputError("Only a pyramid of lobes can be drawn without some terms of its BRDF.")
    halves = np.zeros((2, *scene.pixels, 3), np.float32)
    halves[:, pixels.rows, pixels.columns] = found
    return halves


def appearance_of(given: Drawable) -> Appearance:
    """A pyramid or a list of levels as an appearance; an appearance is returned as it is."""
    if isinstance(given, Pyramid):
        return LobePyramid([level.svbrdf for level in given.levels])
    return LobePyramid(list(given)) if isinstance(given, Sequence) else given


def _draw_lobes(
    pyramid: LobePyramid, scene: Scene, pixels: Pixels, detail: NDArray, lit: Lit, threads: int | None
) -> NDArray:
    """Both halves (2, n, 3) of the pixels of a pyramid of lobes, by the compiled loops."""
    levels = pyramid.levels
    detail = np.clip(detail, 0.0, len(levels) - 1.0)
    # Only the levels that are seen are packed.
    finest, coarsest = math.floor(detail.min(initial=len(levels) - 1.0)), math.ceil(detail.max(initial=0.0))
    packed = pack_levels(levels[finest : max(coarsest, finest) + 1])
    detail -= finest
    base_size = np.array(scene.base_size[::-1], np.float64)
    # The part that both halves share, then each half's own.
    found = np.zeros((3, len(detail), 3))
    each_pass = passes(lit, packed.model, pixels.key, pixels.view, pixels.frame, pyramid_loop, environment_pyramid_loop)

    def work(part: slice) -> int:
        for one in each_pass:
            for target in (1, 2) if one.sampled else (0,):
                one.loop(
                    packed.texels, packed.levels, packed.tile, pixels.centre[part], base_size, detail[part],
                    *one.of_pixels(part), *one.data, *((_DIRECTIONS, _PART + target) if one.sampled else ()),
                    found[target, part], *one.kernels,
                )  # fmt: skip
        return part.stop - part.start

    step = PIXELS_PER_PIECE
    jobs = [(slice(i, min(i + step, len(detail))),) for i in range(0, len(detail), step)]
    run_in_threads(work, jobs, threads, None, len(detail))
    return found[1:] + found[0]


def _draw(
    appearance: Appearance, scene: Scene, pixels: Pixels, detail: NDArray, lit: Lit, directions: int,
    threads: int | None,
) -> NDArray:  # fmt: skip
    """Both halves (2, n, 3) of the pixels of any appearance."""
    axes = scene.axes[pixels.rows, pixels.columns]
    lookups = Lookups(pixels.centre, np.ascontiguousarray(axes, np.float64), detail, pixels.view)
    found = np.zeros((2, len(detail), 3))
    discs = lit.discs

    def work(part: slice) -> int:
        view, frame = pixels.view[part], pixels.frame[part]
        seen = Seen(appearance, appearance.look_up(lookups.part(part)), view)
        for radius, lights in () if lit.lights is None else lit.lights.by_radius():
            if radius == 0.0:
                found[:, part] += _under_points(seen, frame, lights)
        sized: list[tuple[Lights | Environment, NDArray]] = [(discs, frame)] if discs is not None else []
        if lit.environment is not None:
            sized.append((lit.environment, lit.environment.turned(frame)))
        for number, (light, turned) in enumerate(sized):
            for half in (0, 1):
                # Seeded by what it draws, so that threads do not matter.
                random = np.random.default_rng([part.start, number, half])
                found[half, part] += _sampled(seen, turned, light, directions, random)
        return len(view)

    jobs = [(slice(i, min(i + _PIXELS, len(detail))),) for i in range(0, len(detail), _PIXELS)]
    run_in_threads(work, jobs, threads, None, len(detail))
    return found


class Seen(NamedTuple):
    """An appearance, what was read of it for n pixels, and their view (n, 3)."""

    appearance: Appearance
    texels: Any
    view: NDArray

    def reflected(self, light: NDArray) -> NDArray:
        """BRDF times cosine (n, 3) under directions (n, 3); 0 below the plane of the texture."""
        found = np.asarray(self.appearance.evaluate(self.texels, self.view, light), np.float64)
        return np.where(light[:, 2:] > 0.0, found, 0.0)


def _under_points(seen: Seen, frame: NDArray, lights: Lights) -> NDArray:
    """Radiance (n, 3) under directional lights."""
    found = np.zeros((len(frame), 3))
    for direction, irradiance in zip(lights.direction, lights.irradiance, strict=True):
        found += irradiance * seen.reflected(frame @ direction.astype(np.float64))
    return found


def _sampled(
    seen: Seen, frame: NDArray, light: Environment | Lights, directions: int, random: np.random.Generator
) -> NDArray:
    """Radiance (n, 3) under light that has a size: the mean of f L / (p_l + p_a) over directions of either density."""
    found = np.zeros((len(frame), 3))
    count = len(frame)
    # Any run of the table is well spread; each pixel reads another.
    table = light.table.T.astype(np.float64)
    run = random.integers(len(table), size=count)
    # Jittered along the first number, so that a pixel's directions are spread over the lobe.
    u = random.random((directions, count, 2))
    u[..., 0] = (u[..., 0] + np.argsort(random.random(u.shape[:2]), axis=0)) / directions
    for i in range(directions):
        of_light = table[(run + i) % len(table), LIGHT_X:]
        towards = np.einsum("nij,nj->ni", frame, of_light[:, :3])
        of_lobe = np.asarray(seen.appearance.sample(seen.texels, seen.view, u[i]), np.float64)
        looked_up = light.look_up(np.einsum("nji,nj->ni", frame, of_lobe))
        for direction, radiance, density in ((towards, of_light[:, 3:6], of_light[:, 6]), (of_lobe, *looked_up)):
            density = density + seen.appearance.pdf(seen.texels, seen.view, direction)
            found += seen.reflected(direction) * radiance / np.maximum(density, 1e-20)[:, None]
    return found / directions
