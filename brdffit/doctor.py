"""Which hard cases a texture set holds, where, and what the fit does about them: data for the command ``doctor``.

The base is searched as a whole, in its own texels or in the footprints of a level; of each case the worst texels are
fitted and measured, and of each level a random sample, with the settings that a bake would have.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError
from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample
from brdffit.fitting.status import FALLBACK, ITERATION_LIMIT, STATUS_NAMES
from brdffit.halfangle.apparent_lobe import Base, base_of
from brdffit.halfangle.measure import random_texels, snr
from brdffit.methods import DEFAULT, get_method
from brdffit.models import get_model
from brdffit.options import make_options
from brdffit.pipeline import read_set
from brdffit.roughness import eigenvalues_of_log
from brdffit.svbrdf import Svbrdf, level_sizes
from brdffit.textures import encoding
from brdffit.textures.relief import moved_by_noise
from brdffit.textures.texture_set import TextureSet

#: Slope from which a normal is steep (76 degrees); multiple of the least z up to which it lies on the horizon.
STEEP_SLOPE, ON_THE_HORIZON = 4.0, 1.01
#: Turn between neighbouring normals, in lobe widths, from which a highlight falls apart; ratio of the alphas of a
#: footprint from which sharp lobes lie beside wide ones.
NEEDLE_WIDTHS, SHARP_TO_WIDE = 6.0, 5.0
#: Share of a footprint's specular from which one texel dominates it; distance between mean normals, in lobe widths,
#: from which colour or brightness goes with the normal.
BRIGHT_SHARE, COLOUR_WIDTHS = 0.5, 0.5
#: Perceptual roughness that counts as one, sum of specular RGB as none, length of a stored normal as short, and spread
#: of a normal map (in code steps) as dither.
ROUGH, BLACK, SHORT, DITHER = 0.98, 1e-4, 0.95, 4.0
#: Turn of a normal by the code noise of its map, in lobe widths, from which it is reported.
CODE_WIDTHS = 0.25
#: Share of the texels below which a case is not reported.
LEAST_SHARE = 1e-4
#: Level of the footprints of 2x2 and of 8x8 texels that are searched.
_NEAR, _WIDE = 1, 3
_WORST = 12
# Random texels of a level, and of levels from _DEEP on, whose footprints need far more samples.
_TEXELS, _DEEP_TEXELS, _DEEP = 128, 24, 4
_NODES, _SAMPLES = 1024, (16, 128)
#: The fit is called mistaken where the measured error is this many times its own figure, and this much above it.
MISTAKEN_TIMES, MISTAKEN_BY = 2.0, 0.05
#: Loss of specular energy from which it is reported.
ENERGY_LOST = 0.1


@dataclass
class Treatment:
    """What the fit made of some texels: how many, statuses by name, SNR in dB as the fit sees it and as measured.

    ``energy_kept`` is the mean of rho over the filtered colour; ``mistaken`` counts texels whose measured error is far
    above the fit's own figure.
    """

    texels: int
    statuses: dict[str, int]
    own_db: float | None
    measured_db: float | None
    energy_kept: float | None = None
    mistaken: int = 0


@dataclass
class Finding:
    """A hard case of a set.

    Attributes:
        case: its name.
        level: of the texels that are counted; 0 is the base.
        texels, share: how many texels of that level, and which part of it.
        worst: (level, column, row) of the worst ones, the worst first.
        meaning: one sentence on its effect on a baked pyramid.
        treatment: what the fit made of the worst ones; None where nothing is fitted.
    """

    case: str
    level: int
    texels: int
    share: float
    worst: list[tuple[int, int, int]]
    meaning: str
    treatment: Treatment | None = None


@dataclass
class LevelTreatment:
    """A level: (width, height) and what was made of a sample of its texels, or of all, if a manifest says so."""

    level: int
    width: int
    height: int
    treatment: Treatment


@dataclass
class Diagnosis:
    """The findings, levels and options of one set; ``advice`` and ``notes`` are sentences."""

    name: str
    width: int
    height: int
    options: dict[str, Any]
    findings: list[Finding] = field(default_factory=list)
    levels: list[LevelTreatment] = field(default_factory=list)
    advice: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def to_json(self) -> str:
        """As JSON, one line break at the end; an SNR without error is null."""
        return json.dumps(dataclasses.asdict(self), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def diagnose(
    source: str | os.PathLike[str] | TextureSet | Svbrdf, *, manifest: str | os.PathLike[str] | None = None,
    reading: Mapping[str, Any] | None = None, phase: Callable[[str], None] | None = None, **options: Any,
) -> Diagnosis:  # fmt: skip
    """Look for hard cases in a set.

    Args:
        source: a folder of textures, a .gltf, .glb or .mtlx file, a TextureSet or an Svbrdf.
        manifest: manifest.json of a bake of it: its options and statuses are taken instead of a sample's.
        reading: arguments of ``read_texture_set``.
        phase: called when a phase begins, with "reading", "compiling" or "looking".
        options: fields of ``FitOptions``; they win over the manifest's.

    Raises:
        InputError: for a set or a manifest that cannot be read.
        UnknownNameError: for an unknown option or name.
    """
    record = _read_manifest(manifest) if manifest is not None else None
    asked = make_options(FitOptions, {**record["options"], **options} if record else options, "'bfgs'")
    tell = phase or (lambda name: None)
    tell("reading")
    read = read_set(source, reading or {}, asked)
    texture_set, svbrdf = read.texture_set, read.material.svbrdf
    if not svbrdf.is_finite():
        raise InputError("The SVBRDF holds numbers that are not finite; every texel must be a finite number.")
    height, width = svbrdf.size
    diagnosis = Diagnosis(
        name=read.name, width=width, height=height,
        options={name: getattr(asked, name) for name in ("model", "quality", "pixel_filter", "specular", "lobe")},
        notes=read.notes,
    )  # fmt: skip
    if texture_set is not None and "normal" in texture_set.maps:
        diagnosis.findings += _stored_normals(texture_set, svbrdf)
    diagnosis.findings += _base_texels(svbrdf, asked) + _footprints(svbrdf)
    if width & (width - 1) or height & (height - 1):
        diagnosis.notes.append(
            f"{width}x{height} is no power of two: footprints of some levels overlap their neighbours by parts of a "
            f"texel, which is filtered as it stands; block compression and some engines want powers of two."
        )
    # Colours weighted by opacity, as a bake has them.
    svbrdf = svbrdf.weighted()
    base = base_of(svbrdf, get_model(svbrdf.model).default_shape)
    tell("compiling")
    get_method(DEFAULT).prepare(read.material, asked)
    tell("looking")
    for finding in diagnosis.findings:
        if finding.worst:
            places = np.array(finding.worst, np.int64)
            level = int(places[0, 0])
            finding.treatment = _treat(svbrdf, base, level, places[:, 1].copy(), places[:, 2].copy(), asked)
    for level, size in enumerate(level_sizes(svbrdf.size, asked.levels)):
        treatment = _recorded(record["levels"][level]) if record and level < len(record["levels"]) else None
        if treatment is None:
            texels = _TEXELS if level < _DEEP else _DEEP_TEXELS
            treatment = _treat(svbrdf, base, level, *random_texels(size, texels, seed=level), asked)
        diagnosis.levels.append(LevelTreatment(level, size[1], size[0], treatment))
    diagnosis.advice = _advice(diagnosis)
    return diagnosis


def _read_manifest(path: str | os.PathLike[str]) -> dict[str, Any]:
    try:
        record = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"'{path}' cannot be read: {error.strerror}.") from error
    except ValueError as error:
        raise InputError(f"'{path}' is not JSON, expected the manifest.json of a bake.") from error
    known = {each.name for each in dataclasses.fields(FitOptions)}
    if not (isinstance(record, dict) and isinstance(record.get("options"), dict) and record.get("levels")):
        raise InputError(f"'{path}' has no options and levels, expected the manifest.json of a bake.")
    return {"options": {k: v for k, v in record["options"].items() if k in known}, "levels": record["levels"]}


def _recorded(level: Mapping[str, Any]) -> Treatment | None:
    if "statuses" not in level:
        return None
    return Treatment(level["texels"], level["statuses"], level.get("residual_snr_db"), level.get("snr_db"),
                     level.get("energy_kept"))  # fmt: skip


# What the base holds


def _found(case: str, level: int, badness: NDArray, limit: float, meaning: str) -> list[Finding]:
    """A finding of the texels (H, W) of a level whose badness is above a limit, if there are enough of them."""
    bad = badness > limit
    count = int(np.count_nonzero(bad))
    if not count or count < LEAST_SHARE * bad.size:
        return []
    where = np.flatnonzero(bad)
    worst = where[np.argsort(-badness.ravel()[where], kind="stable")[:_WORST]]
    width = badness.shape[1]
    places = [(level, int(at % width), int(at // width)) for at in worst]
    return [Finding(case, level, count, count / bad.size, places, meaning)]


def _stored_normals(texture_set: TextureSet, svbrdf: Svbrdf) -> list[Finding]:
    """Findings in the normal map as stored: short vectors, and noise of its codes."""
    named = texture_set.maps["normal"]
    pixels, noise = named.read()
    if pixels.shape[2] < 2:
        return []
    vectors, _ = named.vectors(pixels)
    found, texels = [], pixels.shape[0] * pixels.shape[1]
    spread = float(vectors[:, :, :2].std())
    moved = moved_by_noise(texture_set)
    if moved.shape == svbrdf.size and not texture_set.denoise_normals:
        _, minor = eigenvalues_of_log(svbrdf.log_roughness)
        found += _found("normals that their codes cannot tell", 0, moved / np.sqrt(minor), CODE_WIDTHS,
                        f"Noise of the map's codes turns them by more than {CODE_WIDTHS:g} widths of their lobes, and "
                        f"widens the levels: --denoise-normals takes it away.")  # fmt: skip
    if 0.0 < spread < DITHER * noise.step and texture_set.denoise_normals:
        found.append(Finding("flat map that dithers", 0, texels, 1.0, [],
                             "The normal map moves by no more than its codes can tell and is read as flat, as asked; "
                             "at its word it would widen the lobe."))  # fmt: skip
    if vectors.shape[2] == 3 and float(np.ptp(vectors[:, :, 2])) > 0.0:
        length = np.sqrt(np.einsum("ijk,ijk->ij", vectors, vectors))
        short = int(np.count_nonzero(length < SHORT))
        if float(length.mean()) < SHORT:
            found.append(Finding("short normals", 0, short, short / texels, [],
                                 f"The stored normals have a mean length of {float(length.mean()):.2f}, expected 1: "
                                 f"they were averaged or squeezed before, and what spread that hides is lost; they are "
                                 f"brought to length 1."))  # fmt: skip
    return found


def _base_texels(svbrdf: Svbrdf, options: FitOptions) -> list[Finding]:
    """Texels that are hard by themselves."""
    normal, specular = svbrdf.normal, svbrdf.specular.sum(axis=2)
    major, minor = eigenvalues_of_log(svbrdf.log_roughness)
    z = np.maximum(normal[:, :, 2], 1e-3)
    slope = np.hypot(normal[:, :, 0], normal[:, :, 1]) / z
    horizon = normal[:, :, 2] <= ON_THE_HORIZON * encoding.MIN_NORMAL_Z
    roughness = np.sqrt(np.sqrt(minor))
    floor = options.min_roughness
    # Among texels that are equally bad, those whose neighbours turn most rank worst: a flat mirror is no trouble.
    turn = _turn(normal)
    return [
        *_found("normals on the horizon", 0, np.where(horizon, 1.0 + turn, 0.0), 0.5,
                "They stand on edge: slopes of hundreds, which no method that averages slopes (LEAN) survives."),
        *_found("steep normals", 0, np.where(horizon, 0.0, slope), STEEP_SLOPE,
                "Steeper than 76 degrees: their lobes are cut by the horizon, and methods that average slopes suffer."),
        *_found("mirrors at the roughness floor", 0, np.where(roughness <= floor * 1.001, 1.0 + turn, 0.0), 0.5,
                f"Perceptual roughness {floor:g}, the floor: any bump beside them makes separate needles of light."),
        *_found("roughness one", 0, np.where(np.sqrt(np.sqrt(major)) >= ROUGH, 1.0 + turn, 0.0), 0.5,
                "As wide as a lobe may be: bumps cannot widen it further, so some of their effect is lost."),
        *_found("strong anisotropy", 0, major / minor, 100.0, "Axes of alpha^2 differ by more than 100:1."),
        *_found("no specular", 0, np.where(specular <= BLACK, 1.0, 0.0), 0.5,
                "They reflect nothing specularly: nothing is fitted there, and their normals count for nothing in the "
                "levels above."),
    ]  # fmt: skip


def _turn(normal: NDArray) -> NDArray:
    """(H, W): the chords from a normal to those of its right and lower neighbours, added; none beyond the border."""
    turn = np.zeros(normal.shape[:2], np.float32)
    for axis in (0, 1):
        if normal.shape[axis] > 1:
            step = np.sqrt(np.square(np.diff(normal, axis=axis)).sum(axis=2))
            turn[tuple(slice(None, -1) if each == axis else slice(None) for each in (0, 1))] += step
    return turn


def _blocks(image: NDArray, side: int) -> NDArray:
    """(h, w, side * side, C): the texels of each block of an image (H, W, C); a remainder at the border is left out."""
    height, width = (extent // side for extent in image.shape[:2])
    blocks = image[: height * side, : width * side].reshape(height, side, width, side, image.shape[2])
    return blocks.transpose(0, 2, 1, 3, 4).reshape(height, width, side * side, image.shape[2])


def _footprints(svbrdf: Svbrdf) -> list[Finding]:
    """Footprints that are hard because of what they bring together."""
    _, minor = eigenvalues_of_log(svbrdf.log_roughness)
    alpha = np.sqrt(minor)
    found: list[Finding] = []
    if min(svbrdf.size) >= 2**_NEAR:
        normals, narrow = _blocks(svbrdf.normal, 2**_NEAR), _blocks(alpha[..., None], 2**_NEAR)[..., 0].min(axis=2)
        apart = np.sqrt(np.square(normals - normals.mean(axis=2, keepdims=True)).sum(axis=3)).max(axis=2)
        found += _found("needles", _NEAR, 2.0 * apart / narrow, NEEDLE_WIDTHS,
                        f"Neighbouring normals differ by more than {NEEDLE_WIDTHS:g} widths of their lobes: the "
                        f"highlight is a streak or falls apart, and one lobe can only smear over it.")  # fmt: skip
    if min(svbrdf.size) < 2**_WIDE:
        return found
    specular = _blocks(svbrdf.specular, 2**_WIDE)
    normals, alphas = _blocks(svbrdf.normal, 2**_WIDE), _blocks(alpha[..., None], 2**_WIDE)[..., 0]
    energy = specular.sum(axis=3)
    total = np.maximum(energy.sum(axis=2), 1e-12)
    lit = energy.sum(axis=2) > 3.0 * BLACK
    # The second narrowest and the second widest of 64 texels, so that a lone speck does not count.
    ordered = np.sort(alphas, axis=2)
    found += _found("sharp lobes beside wide ones", _WIDE, ordered[:, :, -2] / ordered[:, :, 1], SHARP_TO_WIDE,
                    "Glossy and rough texels under one footprint: the fit follows the sharp ones, whose peak is high, "
                    "and the wide gloss around them is lost.")  # fmt: skip
    found += _found("single bright texels", _WIDE, np.where(lit, energy.max(axis=2) / total, 0.0), BRIGHT_SHARE,
                    "One texel in 64 holds more than half of the specular: the level takes that texel's normal and "
                    "roughness.")  # fmt: skip
    means = [_mean_normal(normals, specular[..., channel]) for channel in (0, 2)]
    off = np.sqrt(np.square(means[0] - means[1]).sum(axis=2)) / np.median(alphas, axis=2)
    found += _found("colour that goes with the normal", _WIDE, np.where(lit, off, 0.0), COLOUR_WIDTHS,
                    "Red and blue lean different ways by more than half a lobe's width: a level has one normal for "
                    "both, so a coloured rim is lost.")  # fmt: skip
    plain = _mean_normal(normals, np.ones_like(energy))
    off = np.sqrt(np.square(_mean_normal(normals, energy) - plain).sum(axis=2)) / np.median(alphas, axis=2)
    found += _found("brightness that goes with the normal", _WIDE, np.where(lit, off, 0.0), COLOUR_WIDTHS,
                    "The bright texels lean another way than the rest by more than half a lobe's width: the fitted "
                    "normal follows the light, averaged normals do not.")  # fmt: skip
    return found


def _mean_normal(normals: NDArray, weights: NDArray) -> NDArray:
    """(h, w, 3) means of normals (h, w, n, 3) with weights (h, w, n); not brought to length."""
    return np.einsum("hwn,hwnc->hwc", weights, normals) / np.maximum(weights.sum(axis=2), 1e-12)[..., None]


# What the fit does about it


def _treat(
    svbrdf: Svbrdf, base: Base, level: int, columns: NDArray, rows: NDArray, options: FitOptions
) -> Treatment:  # fmt: skip
    height, width = level_sizes(svbrdf.size, level + 1)[level]
    columns, rows = np.minimum(columns, width - 1), np.minimum(rows, height - 1)
    sample = LevelSample(svbrdf, level, columns, rows, options, base=base, threads=options.threads)
    lobes, output = sample.fit()
    (error,), (energy,) = sample.measure([lobes], nodes=_NODES, samples=_SAMPLES)
    statuses = {STATUS_NAMES[k]: int(n) for k, n in enumerate(np.bincount(output.status)) if n}
    own = output.residual.astype(np.float64)
    mistaken = int(np.count_nonzero(error > MISTAKEN_TIMES * own + MISTAKEN_BY))
    return Treatment(len(sample), statuses, _decibel(own), _decibel(error), round(float(energy.mean()), 3), mistaken)


def _decibel(error: NDArray) -> float | None:
    value = snr(error)
    return None if math.isinf(value) else round(min(value, 99.0), 1)


def _advice(diagnosis: Diagnosis) -> list[str]:
    """Sentences on what to do, from the worst treatment."""
    sentences = []
    treatments = [each.treatment for each in diagnosis.findings if each.treatment is not None]
    treatments += [each.treatment for each in diagnosis.levels]
    failed = sum(each.statuses.get(STATUS_NAMES[FALLBACK], 0) for each in treatments)
    stopped = sum(each.statuses.get(STATUS_NAMES[ITERATION_LIMIT], 0) for each in treatments)
    mistaken = sum(each.mistaken for each in treatments)
    texels = sum(each.texels for each in treatments)
    if failed:
        sentences.append(f"The search failed for {failed} of {texels} texels looked at; they hold their closed form.")
    if stopped:
        sentences.append(f"{stopped} of {texels} searches were stopped at their limit: try --quality fine.")
    if mistaken:
        sentences.append(f"{mistaken} of {texels} lobes looked at are worse than the fit believes: try --quality fine.")
    levels = [each for each in diagnosis.levels if each.treatment.measured_db is not None]
    if levels:
        hardest = min(levels, key=lambda each: each.treatment.measured_db or 0.0)
        sentences.append(f"The hardest level is {hardest.level}, at {hardest.treatment.measured_db:.1f} dB.")
    least = min(diagnosis.levels, key=lambda each: each.treatment.energy_kept or 1.0)
    kept = least.treatment.energy_kept
    if kept is not None and kept < 1.0 - ENERGY_LOST:
        sentences.append(
            f"The free scale of the lobe keeps {kept:.0%} of the specular energy at level {least.level}: "
            f"--set fit.specular=held keeps all of it, at a lower SNR."
        )
    return sentences
