"""Options of a comparison, and the protocol of its listener."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from numpy.typing import NDArray

from brdffit.appearance import Truth
from brdffit.fitting.options import FitOptions
from brdffit.methods import Material, Method, get_method, method_names, one_of
from brdffit.options import BakeOptions, known_options, make_options, refuse_unknown
from brdffit.render.lights import Lights
from brdffit.render.terms import Terms
from brdffit.report.records import PROBE_LIGHTING

#: Makes a truth of what a set holds.
MakeTruth = Callable[[Material], Truth]
SMALL_LIGHTS, LAMPS, ENVIRONMENT = LIGHTINGS = "small lights", "lamps", "environment"
#: The environment through an engine's filtered probe: its views stand beside those of the environment itself.
THROUGH_PROBE = PROBE_LIGHTING


@dataclass(frozen=True)
class CompareOptions:
    """The options of a comparison.

    Attributes:
        methods: their names, in the order of the tables, see ``variant``; empty takes all that are installed.
        pixels: side of the pictures.
        frames: number of frames of the slow rotation.
        texels: random texels of a level that are measured.
        pairs: of light and viewer at each of them; few of them meet the peak of a sharp lobe.
        lobes: texels whose lobes are shown, at each of three levels.
        samples: preset of the reference, see ``render_reference``.
        environment: an equirectangular picture in linear radiance (.hdr, .exr), or None for the one that ships.
        lights: the small lights; None takes ``lights.few()``.
        lit: lightings of the pictures, of ``LIGHTINGS``.
        terms: terms of the BRDF that are simulated.
        unread: roles of maps that the fit is not given; the reference and the baselines see all.
        options: of the bake, each for those methods that have it, see ``brdffit methods NAME``.
        reading: how a folder is read, see ``read_texture_set``.
        through_probe: engine whose probe lights the views of the environment once more (`brdffit probe --for`), or
            None.
        viewer: write a page of the viewer for each set, which the report links.
        truth: makes, of a set as it was read, the truth that pictures and pairs of light and viewer are compared with;
            None for the SVBRDF.
    """

    methods: tuple[str, ...] = ()
    pixels: int = 192
    frames: int = 128
    texels: int = 64
    pairs: int = 1024
    lobes: int = 5
    samples: str = "standard"
    environment: str | None = None
    lights: Lights | None = None
    lit: tuple[str, ...] = LIGHTINGS
    terms: Terms = field(default_factory=Terms)
    unread: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)
    reading: Mapping[str, Any] = field(default_factory=dict)
    through_probe: str | None = None
    viewer: bool = False
    truth: MakeTruth | None = None

    @classmethod
    def of(
        cls,
        *,
        methods: Iterable[str] = (),
        quick: bool = False,
        environment: str | None = None,
        reading: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> CompareOptions:
        """As the command line says it; ``quick`` is the preset for a look: small pictures, few samples, draft fit.

        Raises:
            UnknownNameError: for a method or option that does not exist.
        """
        names = tuple(dict.fromkeys(name for each in methods for name in each.split(",") if name))
        for name in names:
            variant(name, {})
        small: dict[str, Any] = {}
        if quick:
            small = {"pixels": 96, "frames": 32, "texels": 16, "pairs": 256, "lobes": 3, "samples": "draft"}
        refuse_unknown({name: variant(name, {})[0].options for name in names or method_names()}, options)
        if quick:
            options = {"quality": "draft"} | options
        return cls(methods=names, environment=environment, reading=reading or {}, options=options, **small)

    @property
    def shared(self) -> FitOptions:
        """The options that all methods are measured by: pixel filter, density, reach, threads."""
        return make_options(FitOptions, known_options(FitOptions, self.options), "'bfgs'")


#: Words that may follow a method's name after "+": the same method with another option.
VARIANTS: dict[str, dict[str, Any]] = {
    "held": {"specular": "held"},
    "free": {"specular": "free"},
    "isotropic": {"lobe": "isotropic"},
    "mean": {"normal": "mean"},
    "l1": {"loss": "l1"},
    "relative": {"loss": "relative"},
    "refined": {"refine": True},
    "l2": {"loss": "l2"},
    "seen": {"loss": "seen"},
    "displayed": {"loss": "displayed"},
    "bounded": {"specular": "bounded"},
    "point": {"lights": "point"},
    "mixed": {"lights": "mixed"},
    "lamps": {"lights": "lamp"},
    "energy": {"specular": "free", "energy": 1.0},
}


def variant(name: str, options: Mapping[str, Any]) -> tuple[Method, BakeOptions]:
    """The method that a name such as "bfgs" or "bfgs+held" stands for, and the options it bakes with.

    Raises:
        UnknownNameError: for a method or a variant that does not exist, or an option that the method does not have.
    """
    base, *words = name.split("+")
    method = get_method(base)
    own: dict[str, Any] = {}
    for word in words:
        own |= VARIANTS[one_of("variant of a method", word, tuple(VARIANTS))]
    return method, make_options(method.options, known_options(method.options, options) | own, f"'{base}'")


class Listener(Protocol):
    """Receives the progress of a comparison."""

    def phase(self, text: str) -> None:
        """A phase begins; ``text`` describes it."""

    def __call__(self, level: int, done: int, total: int) -> None:
        """``done`` of ``total`` texels of a level are baked."""


#: Pictures by path relative to the records: (h, w) or (h, w, 3) uint8.
PictureFiles = dict[str, NDArray]
