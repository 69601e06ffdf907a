"""What a comparison is asked to do, and who listens."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from numpy.typing import NDArray

from brdffit.baking import bake_options
from brdffit.methods import BakeOptions, Method, get_method, one_of
from brdffit.render.lights import Lights
from brdffit.render.terms import Terms

SMALL_LIGHTS, ENVIRONMENT = LIGHTINGS = "small lights", "environment"


@dataclass(frozen=True)
class Ask:
    """What is compared, and how closely.

    Attributes:
        methods: their names, in the order of the tables, see ``variant``; empty takes all that are installed.
        pixels: side of the pictures.
        frames: of the slow rotation.
        texels: random texels of a level that are measured.
        pairs: of light and viewer at each of them; few of them meet the peak of a sharp lobe.
        lobes: texels whose lobes are shown, at each of three levels.
        samples: preset of the reference.
        environment: an equirectangular picture in linear radiance (.hdr, .exr), or None for the one that ships.
        lights: the small lights; None: those of the renderer.
        lit: what lights the pictures, in turn.
        terms: of the BRDF that are simulated.
        unread: roles of maps that the fit is not given; the reference and the baselines see all.
        options: of the bake, see ``BakeOptions``.
        reading: how a folder is read, see ``read_texture_set``.
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
    options: BakeOptions = field(default_factory=BakeOptions)
    reading: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        *,
        methods: Iterable[str] = (),
        quick: bool = False,
        environment: str | None = None,
        reading: Mapping[str, Any] | None = None,
        **options: Any,
    ) -> Ask:
        """As the command line says it; ``quick`` is the preset for a look: small pictures, few samples, draft fit.

        Raises:
            UnknownNameError: for a method or option that does not exist.
        """
        names = tuple(dict.fromkeys(name for each in methods for name in each.split(",") if name))
        for name in names:
            variant(name, BakeOptions())
        small: dict[str, Any] = {}
        if quick:
            small = {"pixels": 96, "frames": 32, "texels": 16, "pairs": 256, "lobes": 3, "samples": "draft"}
            options = {"quality": "draft"} | options
        return cls(
            methods=names, environment=environment, reading=reading or {}, options=bake_options(None, options), **small
        )


#: Words that may follow a method's name after "+": the same method with another option.
VARIANTS: dict[str, dict[str, Any]] = {
    "held": {"specular": "held"},
    "free": {"specular": "free"},
    "isotropic": {"lobe": "isotropic"},
    "mean": {"normal": "mean"},
    "l1": {"loss": "l1"},
    "relative": {"loss": "relative"},
    "refined": {"refine": True},
}


def variant(name: str, options: BakeOptions) -> tuple[Method, BakeOptions]:
    """The method that a name such as "bfgs" or "bfgs+held" stands for, and the options it bakes with.

    Raises:
        UnknownNameError: for a method or a variant that does not exist.
    """
    method, *words = name.split("+")
    for word in words:
        options = dataclasses.replace(options, **VARIANTS[one_of("variant of a method", word, tuple(VARIANTS))])
    return get_method(method), options


class Listener(Protocol):
    """Who wants to know how far a comparison is."""

    def phase(self, text: str) -> None:
        """Something begins."""

    def __call__(self, level: int, done: int, total: int) -> None:
        """So many texels of a level are baked."""


#: Pictures by path relative to the records: (h, w) or (h, w, 3) uint8.
PictureFiles = dict[str, NDArray]
