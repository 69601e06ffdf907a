"""The records of a comparison, written and read as JSON; the page is drawn from them alone.

Pictures lie beside the records as PNG files and are named by their path relative to them. Decibels are capped at 99
(JSON has no infinity); a figure that was not measured is null.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.files.atomic import first_other

#: Raised when an older program could not draw newer records.
FORMAT = 1
RECORDS, PAGE, PICTURES = "records.json", "index.html", "pictures"
#: Ratio of the two alphas that the maps of anisotropy show as full.
MOST_ANISOTROPY = 32.0
#: Ending of the name under which the fit is shown with level 0 as authored.
KEPT_SUFFIX = ", level 0 kept"
#: Group of views that show one level each at an angle.
LEVEL_GROUP = "level"
#: Lighting of views that methods draw through a filtered probe; their reference is under the environment itself.
PROBE_LIGHTING = "environment through a probe"
#: Decibels of no error at all.
MOST_DB = 99.0


class Record(msgspec.Struct, forbid_unknown_fields=True):
    """Base of all records."""


class Figures(Record, kw_only=True):
    """Figures of one picture against its reference; see ``brdffit.render.metrics``.

    ``mse``: mean squared error of linear radiance, in views of a traced height, whose light gives a white matt plane
    the radiance 1; else None.
    """

    snr_db: float
    relative_l2: float
    flip_hdr: float
    flip_ldr: float
    ssim: float
    energy_kept: float
    mse: float | None = None


class Shot(Record, kw_only=True):
    """One picture by one method.

    ``change`` is its mean change per frame over that of the reference, where the view moves.
    """

    method: str
    picture: str
    figures: Figures | None = None
    change: float | None = None


class View(Record, kw_only=True):
    """One scene under one lighting, by the reference and by every method.

    ``group`` gathers views under one heading ("distance", "scene", "motion", "level 0", "level"); ``distance`` is
    "near", "mid", "far" or empty; ``exposure`` is the factor before the tone curve, the same for all its pictures.
    """

    key: str
    group: str
    title: str
    lighting: str
    distance: str = ""
    level: float | None = None
    exposure: float = 1.0
    reference: str
    shots: list[Shot]


class LevelFigures(Record, kw_only=True):
    """One MIP level by one method.

    ``half_angle_snr_db``: of the lobe alone, against the dense rule. ``pair_snr_db``: of the whole BRDF over random
    pairs of light and viewer. Both are means of relative squared errors over the same random texels of a level.
    """

    level: int
    size: tuple[int, int]
    half_angle_snr_db: float | None = None
    energy_kept: float | None = None
    pair_snr_db: float | None = None


class MethodResult(Record, kw_only=True):
    """One method on one set.

    ``maps``: a strip of its levels, roughness above anisotropy, as grey values; "" where it bakes no lobes.
    """

    method: str
    seconds: float
    levels: list[LevelFigures]
    maps: str
    notes: list[str] = []


class Skipped(Record, kw_only=True):
    """A method that could not bake a set, and its own sentence why."""

    method: str
    reason: str


class LobeView(Record, kw_only=True):
    """The apparent lobe of one texel over projected half vectors, with each method's lobe.

    Luminance, relative to the peak of the apparent lobe. ``grids`` are float16 of (side, side), row 0 at the top, over
    the square of half width ``extent`` about ``centre`` (h_x, h_y); ``cuts`` are float16 of (2, side) through the peak
    along ``axis`` (a unit vector) and across it. Keys are methods and "reference".
    """

    level: int
    column: int
    row: int
    u: float
    v: float
    side: int
    centre: tuple[float, float]
    extent: float
    peak: float
    peak_at: tuple[float, float]
    axis: tuple[float, float]
    grids: dict[str, bytes]
    cuts: dict[str, bytes]
    snr_db: dict[str, float]


class SetResult(Record, kw_only=True):
    """One texture set.

    ``distances``: level of near, mid and far. ``overview``: where the texels of the lobes lie. ``viewer``: page of the
    viewer, or "".
    """

    name: str
    size: tuple[int, int]
    wrap: str
    distances: dict[str, int]
    methods: list[MethodResult]
    skipped: list[Skipped]
    views: list[View]
    lobes: list[LobeView]
    overview: str
    maps_levels: int
    seconds: dict[str, float]
    inputs: dict[str, str] = {}
    notes: list[str] = []
    viewer: str = ""


class MethodInfo(Record, kw_only=True):
    """A method's name and summary; ``fit`` marks the one that the others are compared with."""

    name: str
    summary: str
    fit: bool = False


class Comparison(Record, kw_only=True):
    """All of it: what was asked, what it ran on, what was found."""

    format: int = FORMAT
    created: str
    command: str
    machine: dict[str, str | int | float | None]
    options: dict[str, str | int | float | bool | None]
    methods: list[MethodInfo]
    sets: list[SetResult]
    seconds: float
    files: list[str] = []


def capped(decibels: float) -> float:
    """Decibels within plus and minus `MOST_DB`; not a number counts as the worst."""
    return -MOST_DB if np.isnan(decibels) else float(min(max(decibels, -MOST_DB), MOST_DB))


def pack(values: NDArray) -> bytes:
    """float16 bytes of an array, as LobeView keeps them; what float16 cannot hold is held at its largest number."""
    return np.clip(values, 0.0, 65504.0).astype("<f2").tobytes()


def unpack(data: bytes, shape: tuple[int, ...]) -> NDArray:
    """The array (float32) of ``pack``."""
    return np.frombuffer(data, "<f2").reshape(shape).astype(np.float32)


def to_json(comparison: Comparison) -> bytes:
    """Records as JSON text, one line break at the end."""
    return msgspec.json.format(msgspec.json.encode(comparison), indent=1) + b"\n"


def read_records(path: str | Path) -> Comparison:
    """Records of a file written by ``to_json``.

    Raises:
        InputError: when it cannot be read, or is no comparison of this format.
    """
    path = Path(path)
    try:
        text = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"'{path}' cannot be read: {error.strerror}; expected the {RECORDS} of a comparison."
        ) from error
    try:
        # The format is checked first: an error about an unknown field of a later one would be less clear.
        found = json.loads(text)["format"]
        if found != FORMAT:
            raise InputError(f"'{path}' is of format {found}, expected {FORMAT}: compare again, or update brdffit.")
        return msgspec.json.decode(text, type=Comparison)
    except (ValueError, KeyError, TypeError, msgspec.MsgspecError) as error:
        raise InputError(f"'{path}' is no record of a comparison ({error}); expected a {RECORDS}.") from error


def picture_names(comparison: Comparison) -> list[str]:
    """Every picture that the records name, each once."""
    names: dict[str, None] = {}
    for each in comparison.sets:
        names[each.overview] = None
        names.update((result.maps, None) for result in each.methods if result.maps)
        for view in each.views:
            names[view.reference] = None
            names.update((shot.picture, None) for shot in view.shots)
    return list(names)


def viewer_pages(comparison: Comparison) -> list[str]:
    """Every page of the viewer that the records name."""
    return [each.viewer for each in comparison.sets if each.viewer]


class Report(NamedTuple):
    """What a report folder holds besides the page, which is drawn from it.

    Attributes:
        comparison: the records.
        pictures: (h, w) or (h, w, 3) uint8 by the paths that the records name.
        viewer: text of the viewer's pages by the paths that the records name.
    """

    comparison: Comparison
    pictures: Mapping[str, NDArray]
    viewer: Mapping[str, str]


def foreign_file(folder: Path) -> str | None:
    """A file of ``folder`` that no comparison wrote, as a relative path; None when all of it is ours, or empty."""
    try:
        listed: Mapping[str, object] = json.loads((folder / RECORDS).read_text(encoding="utf-8"))
        ours = {RECORDS, *map(str, listed["files"])}  # type: ignore[call-overload]
    except (OSError, ValueError, KeyError, TypeError):
        ours = set()
    return first_other(folder, ours)
