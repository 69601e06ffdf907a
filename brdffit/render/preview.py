"""One picture that shows what a bake gains: naive MIPs, the fit and the reference, lit at three distances.

Each ball shows one MIP level, one texel a pixel, as a camera sees it that has moved away until a pixel covers 2^level
base texels: the texture repeats more often the farther it is. The reference lights the base itself at many points
under each pixel and averages what they reflect, so it knows nothing of pyramids.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from brdffit.methods import Pyramid
from brdffit.render import lettering, shading
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf, level_sizes

#: MIP levels shown, near to far.
LEVELS = (1, 3, 5)
BALL = 208
_MARGIN, _GAP, _HEADER, _CAPTION = 28, 26, 64, 34
_BACKGROUND = np.array([0.010, 0.011, 0.014], np.float32)
_INK, _DIM = (236, 238, 242), (140, 146, 156)
#: Sub-samples along each side of a pixel's footprint: two for each base texel, at most this many.
_MOST_SUBSAMPLES = 10
#: Base texels along a side that the reference looks at; of a larger base a crop is shown.
_MOST_BASE_TEXELS = 1024
_CHUNK = 1 << 15

#: Lights: direction (x right, y up, z to the viewer), irradiance RGB, alpha by which its size widens every highlight.
_LIGHTS = (
    ((-0.55, 0.60, 0.58), (3.2, 3.1, 2.9), 0.06),
    ((0.85, -0.05, 0.30), (0.9, 1.1, 1.4), 0.10),
)
#: Radiance of the surroundings straight above and straight below; between them it goes linearly.
_SKY, _GROUND = np.array((0.19, 0.19, 0.20), np.float32), np.array((0.030, 0.029, 0.027), np.float32)


def make_preview(
    base: Svbrdf,
    naive: Pyramid,
    fit: Pyramid,
    *,
    title: str = "",
    levels: Sequence[int] = LEVELS,
    ball: int = BALL,
    base_profile: shading.Profile | None = None,
    fit_profile: shading.Profile | None = None,
    threads: int | None = None,
) -> NDArray:
    """The comparison picture.

    Args:
        base: what the pyramids were baked from.
        naive: its averaged channels.
        fit: the pyramid to show.
        title: name of the set.
        levels: MIP levels shown, near to far; those that a pyramid lacks are left out (one is always shown).
        ball: diameter of a ball in pixels.
        base_profile: lobe of ``base`` and ``naive``; None takes it by the model's name.
        fit_profile: lobe of ``fit``.
        threads: worker threads; None takes one a core, at most four. The picture does not depend on it.

    Returns:
        (H, W, 3) uint8, sRGB.
    """
    threads = threads or min(4, os.cpu_count() or 1)
    depth = min(len(naive), len(fit))
    shown = [level for level in levels if level < depth] or [depth - 1]
    scene = _Scene(ball)
    base_profile = base_profile or profile_of(base.model)
    fit_profile = fit_profile or profile_of(fit.model)
    balls = []
    for mip_level in shown:
        size = level_sizes(base.size)[mip_level]
        window = _window(base.size, size, ball)
        balls.append(
            [
                light_level(naive[mip_level].svbrdf, window, scene, base_profile),
                light_level(fit[mip_level].svbrdf, window, scene, fit_profile),
                light_reference(base, size, window, scene, base_profile, threads),
            ]
        )
    exposure = 0.36 / max(float(np.mean([row[2].mean() for row in balls])), 1e-6)
    return _compose(balls, shown, scene, exposure, fit.method, title)


def _window(base: tuple[int, int], size: tuple[int, int], ball: int) -> tuple[int, int]:
    """How many rows and columns of a level are shown: as many as the ball has, or as a crop of the base has."""
    rows, columns = (
        min(level, ball, max(1, _MOST_BASE_TEXELS * level // full)) for full, level in zip(base, size, strict=True)
    )
    return rows, columns


def profile_of(model: str) -> shading.Profile:
    """The lobe of a model; a model that is not ours is shown as Beckmann, which narrow lobes tend to."""
    return shading.PROFILES.get(model, shading.beckmann_profile)


class _Scene:
    """A ball seen from afar: for each pixel of its disc, directions in the ball's own frame.

    The texture is laid onto it from the front, so one pixel is one texel everywhere.
    """

    def __init__(self, ball: int) -> None:
        self.ball = ball
        at = (np.arange(ball, dtype=np.float32) + 0.5) / ball * 2.0 - 1.0
        x, y = np.meshgrid(at, -at)
        radius = np.sqrt(x * x + y * y)
        # A pixel of soft rim, and no pixel whose surface stands edge-on.
        self.coverage = np.clip((1.0 - radius) * ball / 2.0, 0.0, 1.0)
        self.rows, self.columns = np.nonzero(self.coverage > 0.0)
        inside = np.minimum(radius, 0.985) / np.maximum(radius, 1e-6)
        x, y = (x * inside)[self.rows, self.columns], (y * inside)[self.rows, self.columns]
        surface = shading.components(x, y, np.sqrt(1.0 - x * x - y * y))

        def local(direction: Sequence[float]) -> NDArray:
            vector = np.asarray(direction, np.float32)
            return shading.into_frame(np.broadcast_to(vector / np.linalg.norm(vector), surface.shape), surface)

        self.view = local((0.0, 0.0, 1.0))
        self.up = local((0.0, 1.0, 0.0))
        self.lights = [
            (local(direction), np.asarray(colour, np.float32), np.float32(alpha**2))
            for direction, colour, alpha in _LIGHTS
        ]

    def texels(self, size: tuple[int, int], window: tuple[int, int]) -> NDArray:
        """Index into a level's texels (row by row) for each pixel; the level's first ``window`` texels repeat."""
        return self.rows % window[0] * size[1] + self.columns % window[1]


def light_level(level: Svbrdf, window: tuple[int, int], scene: _Scene, profile: shading.Profile) -> NDArray:
    """Radiance (pixels, 3) of the ball from the texels of one MIP level."""
    texels = scene.texels(level.size, window)
    packed = _packed(level).reshape(level.size[0] * level.size[1], -1)
    return np.concatenate(
        [_radiance(scene, pixels, packed[texels[pixels]].T[:, :, None], profile) for pixels in _chunks(len(texels), 1)]
    )


def light_reference(
    base: Svbrdf,
    size: tuple[int, int],
    window: tuple[int, int],
    scene: _Scene,
    profile: shading.Profile,
    threads: int | None = None,
) -> NDArray:
    """Radiance (pixels, 3) of the ball, each pixel the mean over its footprint of what the base reflects there.

    ``size`` is the level's, ``window`` how many of its texels are shown.
    """
    texels = scene.texels(size, window)
    # Pixels that show the same texel lie together, so its footprint is looked up once.
    order = np.argsort(texels, kind="stable")
    scale = base.size[0] / size[0], base.size[1] / size[1]
    side = int(min(max(2, np.ceil(2 * max(scale))), _MOST_SUBSAMPLES))
    around = np.ix_(*[_neighbourhood(base, axis, math.ceil(window[axis] * scale[axis])) for axis in (0, 1)])
    packed = _packed(base.replace(**{name: array[around] for name, array in base.arrays().items()}))
    radiance = np.empty((len(texels), 3), np.float32)

    def light_chunk(chunk: slice) -> None:
        pixels = order[chunk]
        needed, where = np.unique(texels[pixels], return_inverse=True)
        samples = _bilinear(packed, needed, size[1], scale, side)
        radiance[pixels] = _radiance(scene, pixels, np.moveaxis(samples[where], -1, 0), profile)

    # numpy lets go of the interpreter lock in its loops; each pixel is the sum of its own samples, whoever adds them.
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(light_chunk, _chunks(len(texels), side * side)))
    return radiance


def _neighbourhood(base: Svbrdf, axis: int, texels: int) -> NDArray:
    """Indices of the first ``texels`` base texels along an axis and of one more at each end, as the base wraps."""
    index = np.arange(-1, texels + 1)
    return index % base.size[axis] if base.wrap == "tile" else np.clip(index, 0, base.size[axis] - 1)


def _packed(svbrdf: Svbrdf) -> NDArray:
    """All parameters of a texel side by side, (H, W, 12 or 13): a look-up costs one cache line, not five."""
    arrays = [svbrdf.normal, svbrdf.log_roughness, svbrdf.specular, svbrdf.diffuse]
    if svbrdf.shape is not None:
        arrays.append(svbrdf.shape[..., None])
    return np.ascontiguousarray(np.concatenate(arrays, axis=-1))


def _bilinear(packed: NDArray, texels: NDArray, level_width: int, scale: tuple[float, float], side: int) -> NDArray:
    """Parameters at side x side points under each of a level's texels, (texels, side^2, C).

    The base is bilinear between its texel centres; ``packed`` begins one texel before it.
    """
    row, column = np.divmod(texels, level_width)
    offset = (np.arange(side) + 0.5) / side
    y = ((row[:, None] + offset) * scale[0] + 0.5)[:, :, None]
    x = ((column[:, None] + offset) * scale[1] + 0.5)[:, None, :]
    top, left = y.astype(np.int32), x.astype(np.int32)
    down, right = (y - top).astype(np.float32), (x - left).astype(np.float32)
    flat = packed.reshape(-1, packed.shape[2])
    first = top * packed.shape[1] + left
    samples = flat[first] * ((1.0 - down) * (1.0 - right))[..., None]
    samples += flat[first + 1] * ((1.0 - down) * right)[..., None]
    samples += flat[first + packed.shape[1]] * (down * (1.0 - right))[..., None]
    samples += flat[first + packed.shape[1] + 1] * (down * right)[..., None]
    return samples.reshape(len(texels), side * side, -1)


def _radiance(scene: _Scene, pixels: NDArray | slice, packed: NDArray, profile: shading.Profile) -> NDArray:
    """Mean radiance (n, 3) of n pixels over their samples; packed parameters are (C, n, samples)."""
    parameters = np.moveaxis(np.ascontiguousarray(packed[:12]).reshape(4, 3, *packed.shape[1:]), 1, -1)
    normal, tensor = shading.normalise(parameters[0]), tensor_from_log(parameters[1])
    specular, under = parameters[2], parameters[3] * shading.under_specular(parameters[2])
    shape = packed[12] if len(packed) > 12 else None
    view = scene.view[pixels][:, None]
    of_view = shading.into_frame(view, normal)
    total = _surroundings(view, scene.up[pixels][:, None], of_view[..., 2], normal, tensor, specular, under)
    for direction, colour, size in scene.lights:
        # The light's size widens every lobe alike: a soft box, not a point that no texture could be judged by.
        widened = shading.components(tensor[..., 0] + size, tensor[..., 1] + size, tensor[..., 2])
        light = direction[pixels][:, None]
        plain, peak, matt = shading.brdf_terms(light, of_view, view, normal, widened, specular, profile, shape)
        lit = _weighted_mean(plain, specular) + peak.mean(axis=1)[:, None] + _weighted_mean(matt, under)
        # The ball shadows itself where the light is below its own horizon.
        facing = np.clip(light[:, 0, 2:] * 8.0 + 0.5, 0.0, 1.0)
        total += lit * facing * (colour * np.pi)
    return total


def _surroundings(
    view: NDArray, up: NDArray, facing: NDArray, normal: NDArray, tensor: NDArray, specular: NDArray, under: NDArray
) -> NDArray:
    """Reflection of surroundings whose radiance is linear in the direction's height: (n, 3), the mean over samples.

    A linear radiance stays linear under any lobe; blur only flattens its slope, by 2/3 for the diffuse part and by
    about 1 / (1 + alpha^2) for the specular one.
    """
    middle, slope = 0.5 * (_SKY + _GROUND), 0.5 * (_SKY - _GROUND)
    height = shading.dot(up, normal)
    mirrored = 2.0 * facing * height - shading.dot(up, view)
    mirrored /= 1.0 + 0.5 * (tensor[..., 0] + tensor[..., 1])
    grazing = shading.schlick(facing) * shading.rim(specular)
    plain = 1.0 - grazing
    gloss = middle * _weighted_mean(plain, specular) + slope * _weighted_mean(plain * mirrored, specular)
    peak = middle * grazing.mean(axis=1)[:, None] + slope * (grazing * mirrored).mean(axis=1)[:, None]
    matt = middle * under.mean(axis=1) + slope * (2.0 / 3.0) * _weighted_mean(height, under)
    return gloss + peak + matt


def _weighted_mean(weight: NDArray, colour: NDArray) -> NDArray:
    """Mean over samples of weight (n, samples) times colour (n, samples, 3): (n, 3)."""
    sums = [np.einsum("ps,ps->p", weight, colour[..., i]) for i in range(3)]
    return np.stack(sums, axis=-1) / np.float32(weight.shape[1])


def _chunks(pixels: int, samples: int) -> Iterator[slice]:
    step = max(1, _CHUNK // samples)
    for start in range(0, pixels, step):
        yield slice(start, min(start + step, pixels))


def _displayed(radiance: NDArray) -> NDArray:
    """Linear radiance to display values in [0, 1]: Reinhard's curve with white at 4, then sRGB."""
    radiance = np.maximum(radiance, 0.0)
    mapped = np.clip(radiance * (1.0 + radiance / 16.0) / (1.0 + radiance), 0.0, 1.0)
    return np.where(mapped <= 0.0031308, 12.92 * mapped, 1.055 * np.power(mapped, 1.0 / 2.4) - 0.055)


def _figures(radiance: NDArray, reference: NDArray) -> str:
    """How far a ball is from its reference (pixels, 3): in the light that reaches the eye, and in what is displayed.

    The SNR of the linear radiance weighs highlights, where most of the light is; the RMS of the displayed values weighs
    the dark parts as much.
    """
    power = float(np.square(reference, dtype=np.float64).sum())
    snr = 10.0 * math.log10(power / max(float(np.square(radiance - reference, dtype=np.float64).sum()), 1e-10 * power))
    shown = float(np.sqrt(np.square(_displayed(radiance) - _displayed(reference)).mean()))
    return f"SNR {snr:.1f} DB, DISPLAYED {100.0 * shown:.1f}% OFF"


def _compose(
    balls: list[list[NDArray]], levels: Sequence[int], scene: _Scene, exposure: float, method: str, title: str
) -> NDArray:
    """Balls with their captions on a dark ground."""
    ball = scene.ball
    left = _MARGIN + lettering.width("MIDDLE", 2) + _GAP
    width = left + 3 * ball + 2 * _GAP + _MARGIN
    picture = np.empty((_HEADER + len(balls) * (ball + _CAPTION) + _MARGIN, width, 3), np.uint8)
    picture[:] = np.round(255.0 * _displayed(_BACKGROUND))
    names = ("naive", "brdffit" if method == "bfgs" else method.rpartition(":")[2], "reference")
    for column, name in enumerate(names):
        middle = left + column * (ball + _GAP) + ball // 2
        scale = max((scale for scale in (1, 2, 3) if lettering.width(name, scale) <= ball), default=1)
        lettering.write(picture, name, (24, middle), scale, _INK, centred=True)
    lettering.write(picture, title, (len(picture) - _MARGIN + 6, _MARGIN), 1, _DIM)
    distances = {1: ("FAR",), 2: ("NEAR", "FAR"), 3: ("NEAR", "MIDDLE", "FAR")}.get(len(balls), ("",) * len(balls))
    for row, (lit, level) in enumerate(zip(balls, levels, strict=True)):
        top = _HEADER + row * (ball + _CAPTION)
        lettering.write(picture, distances[row], (top + ball // 2 - 16, _MARGIN), 2, _INK)
        lettering.write(picture, f"LEVEL {level}", (top + ball // 2 + 8, _MARGIN), 1, _DIM)
        reference = lit[2] * exposure
        for column, radiance in enumerate(lit):
            start = left + column * (ball + _GAP)
            coverage = scene.coverage[scene.rows, scene.columns][:, None]
            linear = radiance * exposure * coverage + _BACKGROUND * (1.0 - coverage)
            picture[top + scene.rows, start + scene.columns] = np.round(255.0 * _displayed(linear))
            if column < 2:
                text = _figures(radiance * exposure, reference)
                lettering.write(picture, text, (top + ball + 9, start + ball // 2), 1, _DIM, centred=True)
    return picture
