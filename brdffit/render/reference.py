"""The truth, and what a pyramid makes of it: pictures in linear radiance, and errors over random lights and viewers.

The truth is texture-space shading (Kemppinen et al. 2023, equations 2 and 3): every point of the base, interpolated
bilinearly between its texels, is shaded with the pixel's own light and view directions, and what it reflects is
averaged under the pixel filter, GT(x, l, v) = (p * f(theta, l, v))(x). A pyramid is shaded once a pixel, with the
trilinear value of its levels.

The average is taken over strata of the footprint, one point jittered inside each by a hash of footprint and stratum: no
texel grid beats against the strata, the estimate has no bias at any number of samples, and the picture is the same
whatever the threads. Two such sets, independent of each other, make a picture, and their difference gives the picture's
own error. Pixels that show the same part of a texture that repeats share their samples.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import Truth
from brdffit.errors import InputError
from brdffit.footprint import PixelFilter, get_pixel_filter
from brdffit.methods import one_of
from brdffit.render._footprints import (
    Budget,
    Progress,
    Rule,
    equal_samples,
    group_footprints,
    pieces,
    run_in_threads,
    sample_count,
    strata_rule,
)
from brdffit.render._packing import (
    Packed,
    environment_reference_loop,
    pack_base,
    reference_loop,
)
from brdffit.render.environment import Environment
from brdffit.render.lighting import Lit, Pixels, passes
from brdffit.render.lights import Lights
from brdffit.render.pairs import pair_errors
from brdffit.render.points import directions_per_point, picture_of_points
from brdffit.render.scenes import Scene
from brdffit.render.terms import Terms
from brdffit.svbrdf import Svbrdf

__all__ = ["SAMPLES", "Budget", "Progress", "Reference", "pair_errors", "render_halves", "render_reference"]


class Samples(NamedTuple):
    """A preset: the noise aimed at, as SNR in dB of the picture, the samples to begin with, and the limits of cost.

    Some pixels at random are rendered with ``budget`` first; what their noise lacks decides how many times as many
    samples the picture takes. ``cost`` bounds them, in samples shaded (see ``_cost``), since a picture whose pixels
    share no footprints could take any time; but not below ``least`` times the budget.
    """

    noise_db: float
    budget: Budget
    cost: float
    least: float


#: What ``samples`` of a reference may be called.
SAMPLES = {
    "draft": Samples(25.0, Budget(128, 8, 1024), 1.5e8, 0.25),
    "standard": Samples(35.0, Budget(256, 16, 4096), 6e8, 0.25),
    "fine": Samples(45.0, Budget(1024, 64, 16384), 1e10, 0.25),
}
#: Cost of making a sample, of shading one from two directions of an environment, and of evaluating a truth at a point
#: under one light; the unit is shading a sample under a few lights.
_FILL_COST, _ENVIRONMENT_COST, _POINT_COST = 16.0, 6.0, 32.0
_PILOT_PIXELS = 768

#: Under light that has a size: samples of a footprint at least, of an SVBRDF and of any other truth.
_LEAST_DIRECTIONS, _LEAST_POINTS = 1024, 256


class Reference(NamedTuple):
    """A reference picture and what is known of its own noise.

    Attributes:
        radiance: (h, w, 3) float32, linear.
        halves: (2, h, w, 3) float32, the two independent estimates that it is the mean of. For any other picture M the
            mean of (M - halves[0]) (M - halves[1]) is its squared error against the truth, free of the halves' noise.
    """

    radiance: NDArray
    halves: NDArray

    @property
    def squared_error(self) -> NDArray:
        """(h, w, 3) float32, estimate of the picture's own squared error: a quarter of the squared difference."""
        return 0.25 * np.square(self.halves[0] - self.halves[1])

    @property
    def noise_db(self) -> float:
        """The picture's own SNR in dB; infinite where both halves agree."""
        return _db(float(np.sum(self.squared_error, dtype=np.float64)), self.halves)


def render_reference(
    truth: Svbrdf | Truth,
    scene: Scene,
    lights: Lights | None = None,
    *,
    environment: Environment | None = None,
    terms: Terms = Terms(),  # noqa: B008
    lamps: str = "sampled",
    pixel_filter: str = "box",
    samples: int | str | Budget | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> NDArray:
    """The reference picture: linear radiance (h, w, 3) float32. Arguments as in ``render_halves``."""
    return render_halves(
        truth, scene, lights, environment=environment, terms=terms, lamps=lamps, pixel_filter=pixel_filter,
        samples=samples, threads=threads, progress=progress,
    ).radiance  # fmt: skip


def render_halves(
    truth: Svbrdf | Truth,
    scene: Scene,
    lights: Lights | None = None,
    *,
    environment: Environment | None = None,
    terms: Terms = Terms(),  # noqa: B008
    lamps: str = "sampled",
    pixel_filter: str = "box",
    samples: int | str | Budget | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Reference:
    """The reference picture together with the two independent halves it is made of.

    Args:
        truth: the full-resolution SVBRDF, drawn by compiled loops, or any ``Truth``, asked point by point (tens of
            times as slow); its size is that of ``scene.base_size``.
        scene: what the camera sees.
        lights: directional lights; None takes ``lights.few()`` unless an environment is given.
        environment: an ``environment.Environment`` around the surface, or None.
        terms: terms of the BRDF that are lit; only an SVBRDF can leave some out.
        lamps: how lights that have a size are drawn: "sampled", by directions in their discs, or "widened", as points
            under lobes as much wider: a tenth of the time, and close enough for a glance (of an SVBRDF).
        pixel_filter: "box", "gaussian" or "mitchell", in pixels; the scene carries it to the texture.
        samples: of a footprint: a preset's name ("draft", "standard", "fine"; None takes "standard"), see ``Samples``,
            their number, or a ``Budget`` (least, for each base texel of its area, most).
        threads: worker threads; None takes one a core. The picture does not depend on it.
        progress: called with (pixels done, pixels).

    Raises:
        InputError: when the scene was made for a base of another size, the base holds numbers that are not finite, or
            a truth that is no SVBRDF is to leave out terms.
        UnknownNameError: for an unknown pixel filter or preset.
    """
    _check(truth, scene.base_size, terms)
    chosen = get_pixel_filter(pixel_filter)
    drawn: Packed | Truth
    if isinstance(truth, Svbrdf):
        drawn, least = pack_base(truth), _LEAST_DIRECTIONS
    else:
        drawn, least, lamps = truth, _LEAST_POINTS, "sampled"
    lit = Lit.by(lights, environment, terms, lamps)
    least = least if lit.sampled else 1
    if isinstance(samples, int):
        budget = Budget.of(max(samples, least))
    elif isinstance(samples, Budget):
        budget = samples.times(1.0, least)
    else:
        preset = SAMPLES[one_of("number of samples", samples or "standard", tuple(SAMPLES))]
        budget = preset.budget.times(1.0, least)
        pilot = _average(drawn, _some_pixels(scene), lit, chosen, budget, threads, None)
        # Samples are independent: a quarter of the noise power takes four times as many.
        missing = 2.0 ** math.ceil((preset.noise_db - min(pilot.noise_db, 99.0)) / (10.0 * math.log10(2.0)))
        paid = preset.cost / _cost(drawn, scene, preset.budget, lit)
        budget = preset.budget.times(max(min(max(missing, 1.0), paid), preset.least), least)
    return _average(drawn, scene, lit, chosen, budget, threads, progress)


def _average(
    drawn: Packed | Truth, scene: Scene, lit: Lit, pixel_filter: PixelFilter, budget: Budget,
    threads: int | None, progress: Progress | None,
) -> Reference:  # fmt: skip
    """The picture with so many samples a footprint."""
    draw = _picture_of_texels if isinstance(drawn, Packed) else picture_of_points
    halves = draw(drawn, scene, lit, pixel_filter, budget, threads, progress)  # type: ignore[arg-type]
    return Reference(halves.mean(axis=0), halves)


def _picture_of_texels(
    packed: Packed, scene: Scene, lit: Lit, pixel_filter: PixelFilter, budget: Budget,
    threads: int | None, progress: Progress | None,
) -> NDArray:  # fmt: skip
    """Both halves (2, h, w, 3) float32 of the picture of an SVBRDF, with so many samples a footprint."""
    pixels = Pixels(scene)
    footprints = group_footprints(pixels.centre, pixels.axes, scene.base_size, packed.tile)
    of = footprints.order
    of_pixels = pixels.key[of], pixels.view[of], pixels.frame[of]
    each_pass = passes(lit, packed.model, *of_pixels, reference_loop, environment_reference_loop)
    found = np.zeros((2, len(of), 3))

    def work(rule: Rule, part: slice) -> int:
        starts = footprints.starts[part.start : part.stop + 1]
        inside = slice(int(starts[0]), int(starts[-1]))
        for half in (0, 1):
            for one in each_pass:
                one.loop(
                    packed.texels, packed.levels[0], packed.roughness_kind, packed.has_shape, packed.tile,
                    footprints.place[part], starts - starts[0], footprints.key[part],
                    *one.of_pixels(inside), *one.data, *rule, half, found[half, inside], *one.kernels,
                )  # fmt: skip
        return inside.stop - inside.start

    jobs = []
    for part, count in equal_samples(footprints.place, budget):
        rule = strata_rule(pixel_filter, *count)
        jobs += [(rule, piece) for piece in pieces(footprints.starts, part)]
    run_in_threads(work, jobs, threads, progress, len(of))
    halves = np.zeros((2, *scene.pixels, 3), np.float32)
    halves[:, pixels.rows[of], pixels.columns[of]] = found
    return halves


def _cost(drawn: Packed | Truth, scene: Scene, budget: Budget, lit: Lit) -> float:
    """The cost of a picture with this budget, in samples shaded under a few lights."""
    pixels = Pixels(scene)
    if isinstance(drawn, Packed):
        shading, tile = _ENVIRONMENT_COST if lit.sampled else 1.0, drawn.tile
    else:
        shading, tile = _POINT_COST * directions_per_point(lit), False
    footprints = group_footprints(pixels.centre, pixels.axes, scene.base_size, tile)
    samples = 2.0 * sample_count(footprints.place, budget).prod(axis=1)
    return float(samples @ (shading * np.diff(footprints.starts) + _FILL_COST)) + 1.0


def _some_pixels(scene: Scene) -> Scene:
    """A few covered pixels at random, always the same, as a scene of one row."""
    covered = np.flatnonzero(scene.coverage > 0.0)
    chosen = np.sort(np.random.default_rng(0).permutation(covered)[:_PILOT_PIXELS])
    at = np.unravel_index(chosen, scene.pixels)
    arrays = {name: getattr(scene, name)[at][None] for name in ("centre", "axes", "view", "frame", "coverage")}
    return dataclasses.replace(scene, **arrays)


def _check(truth: Svbrdf | Truth, base_size: tuple[int, int], terms: Terms) -> None:
    if tuple(truth.size) != tuple(base_size):
        raise InputError(f"The scene was made for a base of {base_size} texels, but this one has {truth.size}.")
    if not isinstance(truth, Svbrdf):
        if terms != Terms():
            raise InputError("Only an SVBRDF can be rendered without some terms of its BRDF.")
    elif not truth.is_finite():
        raise InputError("The SVBRDF holds numbers that are not finite; every texel must be a finite number.")


def _db(error: float, halves: NDArray) -> float:
    """SNR of a squared error against the product of two halves, whose noise is independent."""
    signal = float(np.sum(halves[0].astype(np.float64) * halves[1]))
    return math.inf if error <= 0.0 else 10.0 * math.log10(max(signal, 1e-300) / error)
