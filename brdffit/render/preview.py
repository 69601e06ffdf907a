"""One picture that shows what a bake gains: naive MIPs, the fit and the reference, lit at three distances.

Each ball shows one MIP level, one texel a pixel, as a camera sees it that has moved away until a pixel covers 2^level
base texels: the texture repeats more often the farther it is. The reference lights the base itself at many points
under each pixel and averages what they reflect, so it knows nothing of pyramids.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from brdffit.methods import Pyramid
from brdffit.render import lettering, shading
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf, level_sizes

#: MIP levels shown, near to far.
LEVELS = (1, 3, 5)
BALL = 224
_MARGIN, _GAP, _HEADER, _CAPTION = 28, 26, 64, 34
_BACKGROUND = np.array([0.010, 0.011, 0.014], np.float32)
_INK, _DIM = (236, 238, 242), (140, 146, 156)
#: Sub-samples along each side of a pixel's footprint: two for each base texel, at most this many.
_MOST_SUBSAMPLES = 12
_CHUNK = 1 << 15

#: Lights: direction (x right, y up, z to the viewer), irradiance RGB, alpha by which its size widens every highlight.
_LIGHTS = (
    ((-0.55, 0.60, 0.58), (3.1, 2.95, 2.7), 0.05),
    ((0.85, -0.05, 0.30), (0.75, 0.95, 1.25), 0.08),
)
#: Radiance of the surroundings straight above and straight below; between them it goes linearly.
_SKY, _GROUND = (0.42, 0.46, 0.52), (0.10, 0.09, 0.085)

_PROFILES = {"ggx": shading.ggx_profile}


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
) -> NDArray:
    """The comparison picture.

    Args:
        base: what the pyramids were baked from.
        naive: its averaged channels.
        fit: the pyramid to show.
        title: name of the set.
        levels: MIP levels shown, near to far; those that a pyramid lacks are left out (one is always shown).
        ball: diameter of a ball in pixels.
        base_profile: lobe of ``base`` and ``naive``; None takes it by the model's name (GGX, else Beckmann, which is
            what the other models tend to).
        fit_profile: lobe of ``fit``.

    Returns:
        (H, W, 3) uint8, sRGB.
    """
    depth = min(len(naive), len(fit))
    shown = [level for level in levels if level < depth] or [depth - 1]
    scene = _Scene(ball)
    base_profile = base_profile or profile_of(base.model)
    fit_profile = fit_profile or profile_of(fit.model)
    balls = []
    for mip_level in shown:
        size = level_sizes(base.size)[mip_level]
        balls.append(
            [
                light_level(naive[mip_level].svbrdf, scene, base_profile),
                light_level(fit[mip_level].svbrdf, scene, fit_profile),
                light_reference(base, size, scene, base_profile),
            ]
        )
    exposure = 0.24 / max(float(np.mean([row[2].mean() for row in balls])), 1e-6)
    return _compose(balls, shown, scene, exposure, fit.method, title)


def profile_of(model: str) -> shading.Profile:
    """The lobe of a model, for a picture: GGX, or Beckmann for the others, which are close to it."""
    return _PROFILES.get(model, shading.beckmann_profile)


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
            (local(direction), np.asarray(colour, np.float32), np.float32(alpha**2)) for direction, colour, alpha in _LIGHTS
        ]

    def texels(self, size: tuple[int, int]) -> NDArray:
        """Index into a level's texels (row by row) for each pixel; the texture repeats."""
        return self.rows % size[0] * size[1] + self.columns % size[1]


def light_level(level: Svbrdf, scene: _Scene, profile: shading.Profile) -> NDArray:
    """Radiance (pixels, 3) of the ball from the texels of one MIP level."""
    texels = scene.texels(level.size)
    parameters = [level.normal, tensor_from_log(level.log_roughness), level.specular, level.diffuse]
    planar = [np.moveaxis(array.reshape(-1, 3)[texels].T[:, :, None], 0, -1) for array in parameters]
    shape = None if level.shape is None else level.shape.reshape(-1)[texels][:, None]
    return np.concatenate(
        [
            _radiance(scene, pixels, [array[pixels] for array in planar], profile, None if shape is None else shape[pixels])
            for pixels in _chunks(len(texels), 1)
        ]
    )


def light_reference(base: Svbrdf, size: tuple[int, int], scene: _Scene, profile: shading.Profile) -> NDArray:
    """Radiance (pixels, 3) of the ball, each pixel the mean over its footprint of what the base reflects there."""
    texels = scene.texels(size)
    # Pixels that show the same texel lie together, so its footprint is looked up once.
    order = np.argsort(texels, kind="stable")
    scale = max(base.size[0] / size[0], base.size[1] / size[1])
    side = int(min(max(2, np.ceil(2 * scale)), _MOST_SUBSAMPLES))
    radiance = np.empty((len(texels), 3), np.float32)
    for chunk in _chunks(len(texels), side * side):
        pixels = order[chunk]
        needed, where = np.unique(texels[pixels], return_inverse=True)
        arrays = _footprint(base, size, needed, side)
        shape = arrays.pop(4)[..., 0][where] if base.shape is not None else None
        planar = [np.moveaxis(np.moveaxis(array, -1, 0)[:, where], 0, -1) for array in arrays]
        radiance[pixels] = _radiance(scene, pixels, planar, profile, shape)
    return radiance


def _footprint(base: Svbrdf, size: tuple[int, int], texels: NDArray, side: int) -> list[NDArray]:
    """Normal, tensor, specular, diffuse (and shape) at side x side points under each texel: (texels, side^2, ...).

    The base is bilinear between its texel centres, in what textures store; normals are made unit again.
    """
    row, column = np.divmod(texels, size[1])
    offset = (np.arange(side) + 0.5) / side
    y = ((row[:, None] + offset) * (base.size[0] / size[0]) - 0.5)[:, :, None]
    x = ((column[:, None] + offset) * (base.size[1] / size[1]) - 0.5)[:, None, :]
    corners = []
    for at, length in ((y, base.size[0]), (x, base.size[1])):
        low = np.floor(at).astype(int)
        pair = (low % length, (low + 1) % length) if base.wrap == "tile" else np.clip((low, low + 1), 0, length - 1)
        corners.append((pair, (at - low).astype(np.float32)))
    (rows, down), (columns, right) = corners
    indices = [r * base.size[1] + c for r in rows for c in columns]
    weights = [(v * h)[..., None] for v in (1.0 - down, down) for h in (1.0 - right, right)]

    def fetch(array: NDArray) -> NDArray:
        flat = array.reshape(base.size[0] * base.size[1], -1)
        total = sum(weight * flat[index] for weight, index in zip(weights, indices, strict=True))
        return np.asarray(total).reshape(len(texels), side * side, -1)

    arrays = [
        shading.normalise(fetch(base.normal)),
        tensor_from_log(fetch(base.log_roughness)),
        fetch(base.specular),
        fetch(base.diffuse),
    ]
    return arrays if base.shape is None else [*arrays, fetch(base.shape)]


def _radiance(
    scene: _Scene, pixels: NDArray | slice, parameters: list[NDArray], profile: shading.Profile, shape: NDArray | None
) -> NDArray:
    """Mean radiance (n, 3) of n pixels over their samples; parameters are (n, samples, 3)."""
    normal, tensor, specular, diffuse = parameters
    view = scene.view[pixels][:, None]
    total = _surroundings(view, scene.up[pixels][:, None], normal, tensor, specular, diffuse)
    for direction, colour, size in scene.lights:
        # The light's size widens every lobe alike: a soft box, not a point that no texture could be judged by.
        widened = tensor + np.array([size, size, 0.0], np.float32)
        light = direction[pixels][:, None]
        lit = shading.brdf(light, view, normal, widened, specular, diffuse, profile=profile, shape=shape)
        # The ball shadows itself where the light is below its own horizon.
        facing = np.clip(light[..., 2] * 8.0 + 0.5, 0.0, 1.0)[..., 0]
        total = total + lit.mean(axis=1) * facing[:, None] * (colour * np.pi)
    return total


def _surroundings(
    view: NDArray, up: NDArray, normal: NDArray, tensor: NDArray, specular: NDArray, diffuse: NDArray
) -> NDArray:
    """Reflection of surroundings whose radiance is linear in the direction's height: (n, 3), the mean over samples.

    A linear radiance stays linear under any lobe; blur only flattens its slope, by 2/3 for the diffuse part and by
    1 / (1 + alpha^2) for the specular one.
    """
    sky, ground = np.asarray(_SKY, np.float32), np.asarray(_GROUND, np.float32)
    facing = shading.dot(view, normal)
    height = shading.dot(up, normal)
    mirrored = 2.0 * facing * height - shading.dot(up, view)
    mirrored = mirrored / (1.0 + 0.5 * (tensor[..., 0] + tensor[..., 1]))
    grazing = shading.schlick(np.maximum(facing, 0.0), specular)
    out = []
    for i in range(3):
        middle, slope = 0.5 * (sky[i] + ground[i]), 0.5 * (sky[i] - ground[i])
        gloss = (specular[..., i] * (1.0 - grazing) + grazing) * (middle + slope * mirrored)
        matt = diffuse[..., i] * np.maximum(1.0 - specular[..., i], 0.0) * (middle + slope * height * (2.0 / 3.0))
        out.append((gloss + matt).mean(axis=1))
    return np.stack(out, axis=-1)


def _chunks(pixels: int, samples: int) -> Iterator[slice]:
    step = max(1, _CHUNK // samples)
    for start in range(0, pixels, step):
        yield slice(start, min(start + step, pixels))


def _displayed(radiance: NDArray) -> NDArray:
    """Linear radiance to display values in [0, 1]: Reinhard's curve with white at 4, then sRGB."""
    radiance = np.maximum(radiance, 0.0)
    mapped = np.clip(radiance * (1.0 + radiance / 16.0) / (1.0 + radiance), 0.0, 1.0)
    return np.where(mapped <= 0.0031308, 12.92 * mapped, 1.055 * np.power(mapped, 1.0 / 2.4) - 0.055)


def _compose(
    balls: list[list[NDArray]], levels: Sequence[int], scene: _Scene, exposure: float, method: str, title: str
) -> NDArray:
    """Balls with their captions on a dark ground."""
    ball = scene.ball
    left = _MARGIN + lettering.width("MIDDLE", 2) + _GAP
    width = left + 3 * ball + 2 * _GAP + _MARGIN
    picture = np.empty((_HEADER + len(balls) * (ball + _CAPTION) + _MARGIN // 2, width, 3), np.uint8)
    picture[:] = np.round(255.0 * _displayed(_BACKGROUND))
    names = ("NAIVE", f"BRDFFIT: {method}", "REFERENCE")
    for column, name in enumerate(names):
        middle = left + column * (ball + _GAP) + ball // 2
        lettering.write(picture, name, (24, middle), 3 if len(name) < 14 else 2, _INK, centred=True)
    lettering.write(picture, title, (28, _MARGIN), 1, _DIM)
    distances = {1: ("FAR",), 2: ("NEAR", "FAR"), 3: ("NEAR", "MIDDLE", "FAR")}.get(len(balls), ("",) * len(balls))
    for row, (lit, level) in enumerate(zip(balls, levels, strict=True)):
        top = _HEADER + row * (ball + _CAPTION)
        lettering.write(picture, distances[row], (top + ball // 2 - 16, _MARGIN), 2, _INK)
        lettering.write(picture, f"LEVEL {level}", (top + ball // 2 + 8, _MARGIN), 1, _DIM)
        reference = _displayed(lit[2] * exposure)
        for column, radiance in enumerate(lit):
            start = left + column * (ball + _GAP)
            coverage = scene.coverage[scene.rows, scene.columns][:, None]
            linear = radiance * exposure * coverage + _BACKGROUND * (1.0 - coverage)
            picture[top + scene.rows, start + scene.columns] = np.round(255.0 * _displayed(linear))
            if column < 2:
                error = float(np.sqrt(np.square(_displayed(radiance * exposure) - reference).mean()))
                text = f"RMS DIFFERENCE {100.0 * error:.1f}%"
                lettering.write(picture, text, (top + ball + 9, start + ball // 2), 1, _DIM, centred=True)
    return picture
