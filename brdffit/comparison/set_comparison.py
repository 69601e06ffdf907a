"""One texture set through every method, the reference and the metrics."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import Truth
from brdffit.comparison.lobes import lobe_view, model_of, representative_texels, same_place
from brdffit.comparison.maps import map_strip
from brdffit.comparison.options import CompareOptions, Listener, PictureFiles, variant
from brdffit.comparison.traced import tilted_views
from brdffit.comparison.views import Pyramids, Studio, all_views, distances_of
from brdffit.errors import InputError
from brdffit.fitting.batch import model_kernels
from brdffit.halfangle.apparent_lobe import base_of
from brdffit.halfangle.density import DENSITY_EXPONENTS
from brdffit.halfangle.measure import Measured, measure, random_texels, snr
from brdffit.methods import DEFAULT, Baked, LobeMethod, Material
from brdffit.pipeline import Phases, ReadSet, read_set, run
from brdffit.render import metrics, scenes
from brdffit.render.pairs import pair_errors
from brdffit.report.records import (
    KEPT_SUFFIX,
    PICTURES,
    LevelFigures,
    LobeView,
    MethodResult,
    SetResult,
    Skipped,
    View,
    capped,
)
from brdffit.svbrdf import Svbrdf, level_sizes
from brdffit.viewer.page import DRAWN_MODEL, MOST_TEXELS, page_text

#: Levels whose lobes are shown, clamped to those that a set has.
_LOBE_LEVELS = (1, 3, 5)
_MEASURE_NODES, _MEASURE_SAMPLES = 1024, (16, 96)
_NO_LOBES = "It bakes no lobes: half-angle figures, lobes and roughness maps are left out."
#: Side of the picture on which the texels of the lobes are marked, at most.
_OVERVIEW = 256
#: Panels of the viewer between averages and reference: more would be small, and the page large.
_MOST_PANELS = 3


def fit_of(methods: Sequence[str]) -> str:
    """The method that the others are compared with: ours, else the first."""
    return DEFAULT if DEFAULT in methods else methods[0]


class SetComparison:
    """One set: what is read, baked, measured and rendered, with the seconds of each."""

    def __init__(
        self, name: str, source: Any, asked: CompareOptions, methods: Sequence[str], studio: Studio,
        listener: Listener | None,
    ) -> None:  # fmt: skip
        self.name, self.asked, self.methods, self.studio, self.listener = name, asked, methods, studio, listener
        self.seconds: dict[str, float] = {}
        self.pictures: PictureFiles = {}
        self.viewer: dict[str, str] = {}
        self.skipped: list[Skipped] = []
        self.options = asked.shared
        with self._phase("reading"):
            self.read = read_set(source, asked.reading, self.options)
            # What is rendered and measured; a cut-out is composited over black.
            self.base = self.read.material.svbrdf.over_black()
            # What pictures and pairs are compared with.
            self.truth: Svbrdf | Truth = self.base if asked.truth is None else asked.truth(self.read.material)

    def run(self) -> SetResult:
        """Bake, measure and draw the set; returns its records, the pictures stay in ``pictures``."""
        baked, seconds = self._bake()
        lobes_of = {name: each.lobes for name, each in baked.items() if each.lobes is not None}
        pyramids = {name: [level.svbrdf.over_black() for level in pyramid.levels] for name, pyramid in lobes_of.items()}
        # A result that is no pyramid of lobes is drawn by its appearance.
        drawn = {name: pyramids.get(name, each.appearance) for name, each in baked.items()}
        fit = fit_of(list(baked))
        depth = min(len(each.sizes) for each in baked.values())
        kept = self._kept(pyramids[fit], fit) if fit in pyramids else {}
        with self._phase("half-angle error"):
            half_angle = [
                self._measure({name: levels[k] for name, levels in pyramids.items()}, *self._texels(k))
                for k in range(depth)
            ]
        with self._phase("pairs of light and viewer"):
            pairs = self._pairs(pyramids, depth)
        with self._phase("pictures"):
            if self.truth is self.base:
                views = self._stored(all_views(self.truth, drawn, kept, depth, self.studio, self._tell))
            else:
                views = self._stored(tilted_views(self.truth, drawn, depth, self.studio, self._tell))
        with self._phase("lobes"):
            held_against = fit if fit in pyramids else next(iter(pyramids), "")
            lobes = self._lobes(pyramids, half_angle, held_against) if pyramids else []
            overview = self._overview()
        with self._phase("maps"):
            maps = {name: self._store(f"maps-{name}", map_strip(levels)) for name, levels in pyramids.items()}
        sizes = level_sizes(self.base.size, depth)
        results = [
            MethodResult(
                method=name, seconds=seconds[name], maps=maps.get(name, ""),
                notes=result.notes + self._trained(name) + ([] if name in pyramids else [_NO_LOBES]),
                levels=[
                    self._level(k, size, half_angle[k].get(name), pairs[k].get(name)) for k, size in enumerate(sizes)
                ],
            )
            for name, result in baked.items()
        ]  # fmt: skip
        viewer = self._viewer_page(pyramids, fit) if self.asked.viewer else ""
        read = self.read
        return SetResult(
            name=self.name, size=self.base.size, wrap=self.base.wrap, methods=results, skipped=self.skipped,
            distances=distances_of(self.base.size, len(sizes), self.studio.reach), views=views, lobes=lobes,
            overview=overview, maps_levels=len(sizes),
            seconds={name: round(value, 3) for name, value in self.seconds.items()},
            inputs={role: path.name for role, path in read.inputs()},
            notes=read.notes + self._notes_of_truth(), viewer=viewer,
        )  # fmt: skip

    def _stored(self, seen: Iterable[tuple[View, dict[str, NDArray]]]) -> list[View]:
        """Store the pictures of views, and return the views with the paths."""
        views = []
        for view, shown in seen:
            for name, picture in shown.items():
                self._store(f"{view.key}-{name}", picture)
            view.reference = self._path(f"{view.key}-reference")
            for shot in view.shots:
                shot.picture = self._path(f"{view.key}-{shot.method}")
            views.append(view)
        return views

    def _notes_of_truth(self) -> list[str]:
        """Notes for readers where the truth is not the set's SVBRDF."""
        if self.truth is self.base:
            return []
        name = type(self.truth).__name__
        return [
            f"Pictures and pairs of light and viewer are compared with another truth than the maps: {name}. Half-angle "
            "figures are those of the maps' own lobes.",
            *getattr(self.truth, "notes", []),
        ]

    @staticmethod
    def _level(k: int, size: tuple[int, int], measured: Measured | None, pairs: float | None) -> LevelFigures:
        if measured is None:
            return LevelFigures(level=k, size=size)
        return LevelFigures(
            level=k, size=size, pair_snr_db=pairs, energy_kept=float(measured.energy.mean()),
            half_angle_snr_db=capped(snr(measured.error)),
        )  # fmt: skip

    def _bake(self) -> tuple[dict[str, Baked], dict[str, float]]:
        """Results and seconds by method; a method that cannot bake the set is recorded with its sentence."""
        baked: dict[str, Baked] = {}
        seconds: dict[str, float] = {}
        for number, name in enumerate(self.methods):
            method, options = variant(name, self.asked.options)
            base = self.read.material.svbrdf
            base = base.without(self.asked.unread) if name == fit_of(self.methods) else base
            read = ReadSet(self.name, Material(base))
            phases = Phases(self.listener)
            self._tell(f"baking by {name} ({number + 1} of {len(self.methods)})")
            try:
                baked[name] = run(read, method, options, phases)
            except InputError as error:
                self.skipped.append(Skipped(method=name, reason=str(error)))
                continue
            finally:
                for phase, took in phases.seconds.items():
                    self.seconds[phase] = self.seconds.get(phase, 0.0) + took
            seconds[name] = phases.seconds["fitting"]
        if not baked:
            reasons = " ".join(each.reason for each in self.skipped)
            raise InputError(f"No method can bake '{self.name}': {reasons}")
        return baked, seconds

    def _trained(self, name: str) -> list[str]:
        """A method's note on its training, which its seconds do not count."""
        method, options = variant(name, self.asked.options)
        said = method.trained(options) if isinstance(method, LobeMethod) else ""
        return [said] if said else []

    def _kept(self, levels: Sequence[Svbrdf], fit: str) -> Pyramids:
        """The pyramid of the fit with level 0 as authored; empty where it has that level already."""
        if levels[0].model != self.base.model or self.options.keep_level_0:
            return {}
        return {fit + KEPT_SUFFIX: [self.base, *levels[1:]]}

    def _measure(self, level: Mapping[str, Svbrdf], columns: NDArray, rows: NDArray) -> dict[str, Measured]:
        """Half-angle error and energy kept (n,) of each method's version of a level."""
        source, options = model_of(self.base.model), self.options
        base = base_of(self.base, source.default_shape)
        found: dict[str, Measured] = {}
        for names in _by_model(level):
            model = level[names[0]].model
            together = measure(
                base, self.base.size, [level[name] for name in names], columns, rows,
                pixel_filter=options.pixel_filter, exponent=DENSITY_EXPONENTS[options.density],
                kernels=model_kernels(source.name, model), default_shape=model_of(model).default_shape,
                nodes=_MEASURE_NODES, samples=_MEASURE_SAMPLES,
            )  # fmt: skip
            found |= {name: Measured(*(each[m] for each in together)) for m, name in enumerate(names)}
        return {name: found[name] for name in level}

    def _pairs(self, pyramids: Pyramids, depth: int) -> list[dict[str, float]]:
        """Per level and method the SNR in dB of the whole BRDF over random pairs of light and viewer.

        Many pairs take few samples of the footprint each: the samples' noise averages out of ``pair_errors``, and most
        of the variance comes from which pairs meet a highlight.
        """
        figures = []
        options = self.options
        for k in range(depth):
            columns, rows = self._texels(k)
            of_level: dict[str, float] = {}
            for names in _by_model({name: levels[k] for name, levels in pyramids.items()}):
                errors, power = pair_errors(
                    self.truth, [pyramids[name][k] for name in names], columns, rows, pairs=self.asked.pairs, seed=k,
                    terms=self.asked.terms, pixel_filter=options.pixel_filter, samples="draft",
                    threads=options.threads,
                )  # fmt: skip
                of_level |= dict(zip(names, map(capped, metrics.snr_of_errors(errors, power).tolist()), strict=True))
            figures.append(of_level)
        return figures

    def _lobes(self, pyramids: Pyramids, measured: Sequence[Mapping[str, Measured]], fit: str) -> list[LobeView]:
        """Lobes of representative texels: at even quantiles of the fit's error at the middle level, and where they are
        at the other levels."""
        depth = _depth(pyramids)
        shown = list(dict.fromkeys(min(level, depth - 1) for level in _LOBE_LEVELS))
        middle = shown[len(shown) // 2]
        texels = representative_texels(measured[middle][fit].error, *self._texels(middle), self.asked.lobes)
        sizes = level_sizes(self.base.size, depth)
        views = []
        for k in shown:
            level = {name: levels[k] for name, levels in pyramids.items()}
            places = [same_place(texel, sizes[middle], sizes[k]) for texel in texels]
            for place in dict.fromkeys(places):
                found = self._measure(level, np.array([place[0]]), np.array([place[1]]))
                errors = {name: snr(each.error) for name, each in found.items()}
                views.append(
                    lobe_view(self.base, level, k, place, pixel_filter=self.options.pixel_filter, errors=errors)
                )
        return views

    def _viewer_page(self, pyramids: Pyramids, fit: str) -> str:
        """A page of the viewer with the fit and the next methods; returns its path, or "" where it cannot draw them."""
        # The page makes averages itself.
        names = [n for n, levels in pyramids.items() if levels[0].model == DRAWN_MODEL and n != "naive"]
        names.sort(key=lambda name: name != fit)
        if not names or self.base.model != DRAWN_MODEL or max(self.base.size) > MOST_TEXELS:
            return ""
        with self._phase("page of the viewer"):
            path = f"viewer/{self.name}.html"
            shown = names[:_MOST_PANELS]
            note = "" if self.truth is self.base else "The reference is of the maps, not of the traced height."
            self.viewer[path] = page_text(
                self.name, self.base, [(name, pyramids[name]) for name in shown], notes=[note] if note else []
            )
        return path

    def _overview(self) -> str:
        """The whole set once, by the reference under small lights; returns its path."""
        sizes = level_sizes(self.base.size)
        k = next((i for i, size in enumerate(sizes) if max(size) <= _OVERVIEW), len(sizes) - 1)
        scene = scenes.plane(self.base.size, k, sizes[k])
        radiance = self.studio.reference(self.truth, scene, self.studio.lit[0]).radiance
        return self._store("overview", metrics.tone_map(radiance, metrics.exposure_of(radiance)))

    def _texels(self, k: int) -> tuple[NDArray, NDArray]:
        return random_texels(level_sizes(self.base.size)[k], self.asked.texels, seed=k)

    def _path(self, name: str) -> str:
        return f"{PICTURES}/{self.name}/{name.replace(':', '.').replace(' ', '-').replace(',', '')}.png"

    def _store(self, name: str, picture: NDArray) -> str:
        path = self._path(name)
        if picture.dtype != np.uint8:
            # A picture cannot hold NaN; its figures report it.
            picture = np.round(255.0 * np.nan_to_num(picture)).astype(np.uint8)
        self.pictures[path] = picture
        return path

    def _tell(self, what: str) -> None:
        if self.listener is not None:
            self.listener.phase(f"{self.name}: {what}")

    @contextmanager
    def _phase(self, name: str) -> Iterator[None]:
        self._tell(name)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def _by_model(level: Mapping[str, Svbrdf]) -> list[list[str]]:
    """Methods whose versions of a level share a lobe model: one call measures them together."""
    models = dict.fromkeys(each.model for each in level.values())
    return [[name for name, each in level.items() if each.model == model] for model in models]


def _depth(pyramids: Pyramids) -> int:
    return min(len(levels) for levels in pyramids.values())
