"""MaterialX nodes that are exact on pixels, as functions of arrays (h, w, channels) or (1, 1, channels) for constants.

Names, inputs and formulas are those of the MaterialX specification, standard nodes; a node that the standard library
builds from others is not here, its graph is followed instead.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray


def _divide(one: NDArray, other: NDArray) -> NDArray:
    return np.divide(one, other, out=np.zeros(np.broadcast_shapes(one.shape, other.shape)), where=other != 0.0)


def _modulo(one: NDArray, other: NDArray) -> NDArray:
    return one - other * np.floor(_divide(one, other))


def _power(base: NDArray, exponent: NDArray) -> NDArray:
    return np.nan_to_num(np.power(base, exponent), nan=0.0, posinf=0.0, neginf=0.0)


def _clamp(value: NDArray, low: NDArray, high: NDArray) -> NDArray:
    return np.minimum(np.maximum(value, low), high)


def _remap(value: NDArray, inlow: NDArray, inhigh: NDArray, outlow: NDArray, outhigh: NDArray) -> NDArray:
    return outlow + _divide(value - inlow, inhigh - inlow) * (outhigh - outlow)


def _smoothstep(value: NDArray, low: NDArray, high: NDArray) -> NDArray:
    t = np.clip(_divide(value - low, high - low), 0.0, 1.0)
    return np.where(value >= high, 1.0, np.where(value <= low, 0.0, t * t * (3.0 - 2.0 * t)))


def _mix(fg: NDArray, bg: NDArray, mix: NDArray) -> NDArray:
    return fg * mix + bg * (1.0 - mix)


def _blend(of: Callable[[NDArray, NDArray], NDArray]) -> Callable[..., NDArray]:
    def blended(fg: NDArray, bg: NDArray, mix: NDArray) -> NDArray:
        return mix * of(fg, bg) + (1.0 - mix) * bg

    return blended


def _over(fg: NDArray, bg: NDArray, mix: NDArray) -> NDArray:
    return mix * (fg + bg * (1.0 - fg[..., 3:4])) + (1.0 - mix) * bg


def _luminance(value: NDArray, lumacoeffs: NDArray) -> NDArray:
    grey = (value[..., :3] * lumacoeffs).sum(axis=-1, keepdims=True)
    return np.concatenate([np.repeat(grey, 3, axis=-1), value[..., 3:]], axis=-1)


def combine(*parts: NDArray) -> NDArray:
    shape = np.broadcast_shapes(*(part.shape[:2] for part in parts))
    return np.concatenate([np.broadcast_to(part, (*shape, part.shape[2])) for part in parts], axis=2)


def _unpremult(value: NDArray) -> NDArray:
    alpha = value[..., 3:4]
    return np.concatenate([np.where(alpha != 0.0, _divide(value[..., :3], alpha), value[..., :3]), alpha], axis=-1)


def _normalize(value: NDArray) -> NDArray:
    return _divide(value, np.linalg.norm(value, axis=-1, keepdims=True))


def _rgb_to_hsv(rgb: NDArray) -> NDArray:
    """Hue in [0, 1), as MaterialX has it (from Foley and van Dam)."""
    colour = rgb[..., :3]
    high, low = colour.max(axis=-1), colour.min(axis=-1)
    delta = high - low
    safe = np.where(delta > 0.0, delta, 1.0)
    r, g, b = np.moveaxis(colour, -1, 0)
    hue = np.where(r >= high, (g - b) / safe, np.where(g >= high, 2.0 + (b - r) / safe, 4.0 + (r - g) / safe))
    hue = np.where(delta > 0.0, (hue / 6.0) % 1.0, 0.0)
    saturation = np.where(high > 0.0, delta / np.where(high > 0.0, high, 1.0), 0.0)
    return np.concatenate([np.stack([hue, saturation, high], axis=-1), rgb[..., 3:]], axis=-1)


def _hsv_to_rgb(hsv: NDArray) -> NDArray:
    hue, saturation, value = np.moveaxis(hsv[..., :3], -1, 0)
    channels = []
    for offset in (5.0, 3.0, 1.0):
        k = (offset + 6.0 * hue) % 6.0
        channels.append(value - value * saturation * np.clip(np.minimum(k, 4.0 - k), 0.0, 1.0))
    return np.concatenate([np.stack(channels, axis=-1), hsv[..., 3:]], axis=-1)


def _choose(test: Callable[[NDArray, NDArray], NDArray]) -> Callable[..., NDArray]:
    def chosen(value1: NDArray, value2: NDArray, in1: NDArray, in2: NDArray) -> NDArray:
        return np.where(test(value1, value2), in1, in2)

    return chosen


#: Category: names of its inputs in order, and the function of their arrays.
OPERATIONS: dict[str, tuple[tuple[str, ...], Callable[..., NDArray]]] = {
    "constant": (("value",), lambda value: value),
    "dot": (("in",), lambda value: value),
    "convert": (("in",), lambda value: value),
    "add": (("in1", "in2"), np.add),
    "subtract": (("in1", "in2"), np.subtract),
    "multiply": (("in1", "in2"), np.multiply),
    "divide": (("in1", "in2"), _divide),
    "modulo": (("in1", "in2"), _modulo),
    "power": (("in1", "in2"), _power),
    "min": (("in1", "in2"), np.minimum),
    "max": (("in1", "in2"), np.maximum),
    "and": (("in1", "in2"), lambda a, b: np.minimum(a, b)),
    "or": (("in1", "in2"), lambda a, b: np.maximum(a, b)),
    "not": (("in",), lambda value: 1.0 - value),
    "absval": (("in",), np.abs),
    "sign": (("in",), np.sign),
    "floor": (("in",), np.floor),
    "ceil": (("in",), np.ceil),
    "round": (("in",), lambda value: np.floor(value + 0.5)),
    "fract": (("in",), lambda value: value - np.floor(value)),
    "sqrt": (("in",), lambda value: np.sqrt(np.maximum(value, 0.0))),
    "exp": (("in",), np.exp),
    "ln": (("in",), lambda value: np.log(np.maximum(value, 1e-30))),
    "sin": (("in",), np.sin),
    "cos": (("in",), np.cos),
    "tan": (("in",), np.tan),
    "asin": (("in",), lambda value: np.arcsin(np.clip(value, -1.0, 1.0))),
    "acos": (("in",), lambda value: np.arccos(np.clip(value, -1.0, 1.0))),
    "atan2": (("iny", "inx"), np.arctan2),
    "invert": (("in", "amount"), lambda value, amount: amount - value),
    "clamp": (("in", "low", "high"), _clamp),
    "remap": (("in", "inlow", "inhigh", "outlow", "outhigh"), _remap),
    "smoothstep": (("in", "low", "high"), _smoothstep),
    "mix": (("fg", "bg", "mix"), _mix),
    "plus": (("fg", "bg", "mix"), _blend(np.add)),
    "minus": (("fg", "bg", "mix"), _blend(lambda fg, bg: bg - fg)),
    "difference": (("fg", "bg", "mix"), _blend(lambda fg, bg: np.abs(bg - fg))),
    "screen": (("fg", "bg", "mix"), _blend(lambda fg, bg: 1.0 - (1.0 - fg) * (1.0 - bg))),
    "burn": (("fg", "bg", "mix"), _blend(lambda fg, bg: np.where(fg != 0.0, 1.0 - _divide(1.0 - bg, fg), 0.0))),
    "dodge": (("fg", "bg", "mix"), _blend(lambda fg, bg: np.where(fg != 1.0, _divide(bg, 1.0 - fg), 0.0))),
    "over": (("fg", "bg", "mix"), _over),
    "inside": (("in", "mask"), np.multiply),
    "outside": (("in", "mask"), lambda value, mask: value * (1.0 - mask)),
    "premult": (("in",), lambda value: np.concatenate([value[..., :3] * value[..., 3:4], value[..., 3:4]], axis=-1)),
    "unpremult": (("in",), _unpremult),
    "luminance": (("in", "lumacoeffs"), _luminance),
    "rgbtohsv": (("in",), _rgb_to_hsv),
    "hsvtorgb": (("in",), _hsv_to_rgb),
    "combine2": (("in1", "in2"), combine),
    "combine3": (("in1", "in2", "in3"), combine),
    "combine4": (("in1", "in2", "in3", "in4"), combine),
    "dotproduct": (("in1", "in2"), lambda a, b: (a * b).sum(axis=-1, keepdims=True)),
    "crossproduct": (("in1", "in2"), lambda a, b: np.cross(a, b)),
    "magnitude": (("in",), lambda value: np.linalg.norm(value, axis=-1, keepdims=True)),
    "normalize": (("in",), _normalize),
    "ifgreater": (("value1", "value2", "in1", "in2"), _choose(np.greater)),
    "ifgreatereq": (("value1", "value2", "in1", "in2"), _choose(np.greater_equal)),
    "ifequal": (("value1", "value2", "in1", "in2"), _choose(np.equal)),
}
