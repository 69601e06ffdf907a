"""Pictures of a set by the reference and by every method, and what is measured on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import Appearance, Truth
from brdffit.comparison.options import ENVIRONMENT, LAMPS, LIGHTINGS, SMALL_LIGHTS, THROUGH_PROBE
from brdffit.comparison.probe_lit import picture_through_probe
from brdffit.probes.shading import ProbeLight
from brdffit.render import lights as light_sets
from brdffit.render import metrics, scenes
from brdffit.render.environment import Environment
from brdffit.render.lights import Lights
from brdffit.render.pictures import render_appearance_halves
from brdffit.render.reference import Reference, render_halves
from brdffit.render.scenes import Scene
from brdffit.render.terms import Terms
from brdffit.report.records import Figures, Shot, View, capped
from brdffit.svbrdf import Svbrdf, level_sizes

#: MIP levels at which a set is seen (Kemppinen et al. 2023, figure 5), clamped to the levels that it has.
DISTANCES = {"near": 0, "mid": 3, "far": 7}
#: Between level 0 and level 1, where the paper looks at motion (figures 4 and 6), and its rotation a frame, in radians.
_MOTION_LEVEL, _ROTATION = 0.5, np.radians(0.1)
_HALF_PIXEL = (0.5, 0.0)
#: Columns of pixels over which the change by the rotation is measured.
_COLUMNS = 6
#: How much the change by half a pixel is amplified in its pictures.
_AMPLIFIED = 2.0
_MOST_CHANGE = 999.0


@dataclass(frozen=True)
class Studio:
    """The settings that all pictures of a comparison share.

    Attributes:
        pixels: side of a picture; two thirds of it under lamps and the environment.
        frames: number of frames of the slow rotation.
        samples: preset of the reference ("draft", "standard", "fine"), see ``render_reference``.
        environment: around the surface.
        lights: the small lights.
        lamps: lights that have a size.
        probe: an engine's probe of the environment, by which views of the environment are drawn once more; None for
            none.
        lit: lightings of the pictures, of ``LIGHTINGS``; moving and slanted views have the first, the sphere the last.
        terms: terms of the BRDF that are simulated.
        reach: first and last level that are seen; None: all.
        pixel_filter: pixel filter of the reference.
        threads: None takes all cores.
    """

    pixels: int
    frames: int
    samples: str
    environment: Environment
    lights: Lights
    lamps: Lights = field(default_factory=light_sets.lamps)
    probe: ProbeLight | None = None
    lit: tuple[str, ...] = LIGHTINGS
    terms: Terms = field(default_factory=Terms)
    reach: tuple[int, int] | None = None
    pixel_filter: str = "box"
    threads: int | None = None

    def reference(self, base: Svbrdf | Truth, scene: Scene, lit: str) -> Reference:
        """The reference picture with its halves.

        Under an environment or lamps it takes the samples of a draft: they cost ten times as much there, and the halves
        keep their noise out of the squared errors.
        """
        return render_halves(
            base, scene, self._lights(lit), environment=self._environment(lit), terms=self.terms,
            pixel_filter=self.pixel_filter, samples=self.samples if lit == SMALL_LIGHTS else "draft",
            threads=self.threads,
        )  # fmt: skip

    def method(self, levels: Sequence[Svbrdf] | Appearance, scene: Scene, lit: str) -> NDArray:
        """Two independent estimates (2, h, w, 3) of linear radiance; their mean is the picture."""
        return render_appearance_halves(
            levels, scene, self._lights(lit), environment=self._environment(lit), terms=self.terms, threads=self.threads
        )

    def _lights(self, lit: str) -> Lights | None:
        return {SMALL_LIGHTS: self.lights, LAMPS: self.lamps}.get(lit)

    def _environment(self, lit: str) -> Environment | None:
        return self.environment if lit == ENVIRONMENT else None


#: Levels of a pyramid by the name of the method, finest first.
Pyramids = Mapping[str, Sequence[Svbrdf]]
#: Results as they are drawn: levels of lobes, or an appearance, by the name of the method.
Drawn = Mapping[str, Sequence[Svbrdf] | Appearance]
#: announce(what): a picture is about to be rendered.
Announce = Callable[[str], None]


def distances_of(
    size: tuple[int, int], levels: int | None = None, reach: tuple[int, int] | None = None
) -> dict[str, int]:
    """Level of near, mid and far for a base of this size; distances that fall together are kept.

    ``reach``: first and last level that are seen; they are then near and far.
    """
    last = len(level_sizes(size, levels)) - 1
    if reach is not None:
        first, last = min(reach[0], last), min(reach[1], last)
        return dict(zip(DISTANCES, (first, (first + last) // 2, last), strict=True))
    return {name: min(level, last) for name, level in DISTANCES.items()}


class Still(NamedTuple):
    """A still view: what is seen, at which level (None: several) and distance ("" where that is not one of them), and
    what lights it."""

    key: str
    group: str
    title: str
    scene: Scene
    lit: str
    distance: str = ""
    level: float | None = None


def still_views(base_size: tuple[int, int], depth: int, studio: Studio) -> list[Still]:
    """The still views of a base (h, w) of ``depth`` levels: near, mid and far by each light, slanted, and a sphere."""
    levels = distances_of(base_size, depth, studio.reach)
    main, last = studio.lit[0], studio.lit[-1]
    views = []
    for lit in studio.lit:
        for distance, level in levels.items():
            scene, title = scenes.plane(base_size, level, _pixels(studio, lit)), f"Plane, {distance} (level {level})"
            key = f"{distance}-{_slug(lit)}"
            views.append(Still(key, "distance", f"{title}, {lit}", scene, lit, distance, float(level)))
    slanted = scenes.slanted(base_size, (studio.pixels, studio.pixels))
    # Level 2, where some bumps have become gloss; clamped to the levels that are seen.
    sphere = scenes.sphere(base_size, min(max(2, levels["near"]), levels["far"]), _pixels(studio, ENVIRONMENT))
    for scene, lit, title in ((slanted, main, "Slanted plane through all levels"), (sphere, last, "Sphere")):
        views.append(Still(scene.name, "scene", f"{title}, {lit}", scene, lit, "", scene.level))
    return views


def all_views(
    base: Svbrdf | Truth,
    pyramids: Drawn,
    kept: Pyramids,
    depth: int,
    studio: Studio,
    announce: Announce = lambda what: None,
) -> Iterator[tuple[View, dict[str, NDArray]]]:
    """Every view of a set with its pictures by name ("reference" and methods), displayed, (h, w, 3) float32 in [0, 1].

    Args:
        base: the set, or another truth that it is compared with.
        pyramids: of the methods; a result without lobes is its appearance.
        kept: pyramids whose level 0 is as authored; they are seen where level 0 is.
        depth: how many levels all of them have.
        studio: pixels, lights and samples.
    """
    near, main = distances_of(base.size, depth, studio.reach)["near"], studio.lit[0]
    views = still_views(base.size, depth, studio)
    first: dict[str, NDArray] = {}  # what half a pixel is held against
    for still in (each for each in views if each.group == "distance"):
        announce(f"{still.distance}, {still.lit}")
        taken = take(base, {**pyramids, **kept} if still.level == 0 else pyramids, still.scene, still.lit, studio)
        if still.distance == "near" and still.lit == main:
            first = taken.pictures()
        yield from _seen(still, taken, pyramids, studio)

    announce("half a pixel")
    shown = {**pyramids, **kept} if near == 0 else pyramids
    moved = scenes.plane(base.size, near, _pixels(studio, main), shift=_HALF_PIXEL)
    yield _shift_view(first, take(base, shown, moved, main, studio).pictures(), near, main)

    announce("slow rotation")
    yield _rotation_view(base, shown, studio, near)

    for still in (each for each in views if each.group == "scene"):
        announce(still.scene.name)
        yield from _seen(still, take(base, pyramids, still.scene, still.lit, studio), pyramids, studio)


def _seen(
    still: Still, taken: Taken, pyramids: Drawn, studio: Studio
) -> Iterator[tuple[View, dict[str, NDArray]]]:  # fmt: skip
    """The view of a still, and once more through the probe where that is asked for and the environment lights it."""
    view = view_of(still, taken)
    yield view, pictures_of(taken, view.exposure)
    if studio.probe is None or still.lit != ENVIRONMENT:
        return
    lobes = {name: levels for name, levels in pyramids.items() if isinstance(levels, Sequence)}
    pictures = {
        name: picture_through_probe(levels, still.scene, studio.probe, studio.environment)
        for name, levels in lobes.items()
    }
    halves = {name: np.stack([picture, picture]) for name, picture in pictures.items()}
    title = still.title.replace(ENVIRONMENT, f"{THROUGH_PROBE} ({studio.probe.preset})")
    through = Taken(taken.reference, halves)
    view = view_of(still._replace(key=f"{still.key}-probe", title=title, lit=THROUGH_PROBE), through)
    yield view, pictures_of(through, view.exposure)


def _pixels(studio: Studio, lit: str) -> tuple[int, int]:
    """(h, w) of a still picture: smaller under light that has a size, where a pixel costs ten times as much."""
    side = studio.pixels if lit == SMALL_LIGHTS else studio.pixels * 2 // 3
    return side, side


def figures_of(picture: NDArray, reference: Reference, exposure: float) -> Figures:
    """``metrics.compare_pictures`` as a record of finite numbers; what is not finite counts as the worst.

    ``picture``: (2, h, w, 3), its halves.
    """
    found = metrics.compare_pictures(picture, reference.radiance, exposure, reference.halves)
    return Figures(
        snr_db=capped(found.snr_db),
        relative_l2=_held(found.relative_l2, _MOST_CHANGE),
        flip_hdr=_held(found.flip_hdr, 1.0),
        flip_ldr=_held(found.flip_ldr, 1.0),
        ssim=-_held(-found.ssim, 1.0),
        energy_kept=_held(found.energy_kept, _MOST_CHANGE),
    )


def _held(value: float, most: float) -> float:
    return float(min(value, most)) if np.isfinite(value) else most


@dataclass(frozen=True)
class Taken:
    """One scene under one lighting: the reference, and halves (2, h, w, 3) of pictures by name of the method."""

    reference: Reference
    methods: dict[str, NDArray]

    def pictures(self) -> dict[str, NDArray]:
        """Linear pictures by name, the reference first."""
        return {
            "reference": self.reference.radiance,
            **{name: each.mean(axis=0) for name, each in self.methods.items()},
        }


def pictures_of(taken: Taken, exposure: float) -> dict[str, NDArray]:
    """All pictures of a scene as they are displayed."""
    return _displayed(taken.pictures(), exposure)


def take(base: Svbrdf | Truth, pyramids: Drawn, scene: Scene, lit: str, studio: Studio) -> Taken:
    """Render a scene under one lighting: the reference, and every method's picture."""
    methods = {name: studio.method(levels, scene, lit) for name, levels in pyramids.items()}
    return Taken(studio.reference(base, scene, lit), methods)


def view_of(still: Still, taken: Taken) -> View:
    """The record of a still view; names of pictures are keys for now, paths later."""
    exposure = metrics.exposure_of(taken.reference.radiance)
    with ThreadPoolExecutor() as pool:  # FLIP, the longest, lets others work meanwhile
        figures = pool.map(lambda picture: figures_of(picture, taken.reference, exposure), taken.methods.values())
        shots = [
            Shot(method=name, picture=name, figures=each) for name, each in zip(taken.methods, figures, strict=True)
        ]
    return View(
        key=still.key, group=still.group, title=still.title, lighting=still.lit, distance=still.distance,
        level=still.level, exposure=exposure, reference="reference", shots=shots,
    )  # fmt: skip


def _displayed(radiance: Mapping[str, NDArray], exposure: float) -> dict[str, NDArray]:
    return {name: metrics.tone_map(picture, exposure) for name, picture in radiance.items()}


def _shift_view(
    first: Mapping[str, NDArray], moved: Mapping[str, NDArray], level: int, lit: str
) -> tuple[View, dict[str, NDArray]]:
    """The change by a shift of half a pixel: pictures of it, and its mean relative to the reference's."""
    exposure = metrics.exposure_of(first["reference"])
    frames = {name: np.stack([first[name], moved[name]]) for name in moved}
    shots = _moving_shots(frames)
    view = View(
        key="shift", group="motion", title=f"Change by half a pixel, level {level}, {lit}", lighting=lit,
        level=float(level), exposure=exposure, reference="reference", shots=shots,
    )  # fmt: skip
    pictures = {}
    for name, pair in frames.items():
        one, other = (metrics.tone_map(frame, exposure) for frame in pair)
        pictures[name] = np.clip(_AMPLIFIED * np.abs(other - one), 0.0, 1.0)
    return view, pictures


def _rotation_view(base: Svbrdf | Truth, pyramids: Drawn, studio: Studio, near: int) -> tuple[View, dict[str, NDArray]]:
    """A column of pixels while the lights turn slowly, frame beside frame.

    The change is measured over several columns; the one that is shown is that in which the reference moves most.
    """
    level, lit = min(near + _MOTION_LEVEL, len(level_sizes(base.size)) - 1), studio.lit[0]
    parts = [
        scenes.plane(base.size, level, (studio.pixels, 1), (column * studio.pixels / _COLUMNS, 0.0), i * _ROTATION)
        for column in range(_COLUMNS)
        for i in range(studio.frames)
    ]
    taken = take(base, pyramids, scenes.side_by_side(parts), lit, studio).pictures()
    # (frames, columns, pixels, 3)
    shape = (studio.pixels, _COLUMNS, studio.frames, 3)
    frames = {name: picture.reshape(shape).transpose(2, 1, 0, 3) for name, picture in taken.items()}
    moves = [metrics.change_per_frame(frames["reference"][:, column]) for column in range(_COLUMNS)]
    shown = {name: each[:, int(np.argmax(moves))].swapaxes(0, 1) for name, each in frames.items()}
    exposure = metrics.exposure_of(shown["reference"])
    view = View(
        key="rotation", group="motion", lighting=lit, level=level, exposure=exposure, reference="reference",
        title=f"A column over {studio.frames} frames of 0.1 degrees, level {level:g}, {lit}",
        shots=_moving_shots(frames),
    )  # fmt: skip
    return view, _displayed(shown, exposure)


def _moving_shots(frames: Mapping[str, NDArray]) -> list[Shot]:
    return [
        Shot(method=name, picture=name, change=min(metrics.relative_change(each, frames["reference"]), _MOST_CHANGE))
        for name, each in frames.items()
        if name != "reference"
    ]


def _slug(text: str) -> str:
    return text.replace(" ", "-")
