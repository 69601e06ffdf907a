"""The quantisation noise of a normal map (what its codes cannot tell from a flat map), and the map without it.

An integer normal map with code step q (2/255 at 8 bits) cannot tell a toggle of one code from a flat map; the variance
of a 50/50 toggle is q^2 / 4 on each axis. Each texel has this much variance as a budget, and it is taken from the
detail of a Haar pyramid of the decoded x and y, fine scales first: a map that only dithers between two neighbouring
codes comes out flat at every scale, one with real slopes loses next to nothing. A JPEG stores luma and chroma in whole
codes, so that red and green move by more than a code when these toggle.

It is done only where it is asked for (``denoise_normals``): the map as stored is what an engine shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Code step of a channel that is decoded to [-1, 1], by bit depth.
CODE_STEP = {8: 2.0 / 255.0, 16: 2.0 / 65535.0}
#: How far one code of Y, Cb, Cr moves red and green (ITU-T T.871).
_JPEG_TO_RED, _JPEG_TO_GREEN = (1.0, 0.0, 1.402), (1.0, 0.344136, 0.714136)
#: Headroom for rounding when the detail of a dithering map is compared with the rest of its budget, and with all of it.
_ROUNDING, _ROUNDING_OF_ALL = 1.0 + 1e-3, 1e-4


@dataclass(frozen=True)
class CodeNoise:
    """Quantisation noise of a normal map.

    Attributes:
        step: code step q of a component in [-1, 1]; 0 for float formats, which have no codes.
        variance: of x and y when every stored code toggles, each on its own; the budget of a texel.
        together: of x and y when luma and chroma toggle together; detail below this is noise altogether.
    """

    step: float
    variance: tuple[float, float]
    together: tuple[float, float]


def code_noise(bits: int, is_float: bool, file_format: str) -> CodeNoise:
    """The noise of a normal map stored with ``bits`` per channel; a JPEG's is that of its luma and chroma codes."""
    step = 0.0 if is_float else CODE_STEP.get(bits, 0.0)
    toggle = 0.25 * step * step
    if file_format != "jpeg":
        return CodeNoise(step, (toggle, toggle), (toggle, toggle))
    red, green = np.array(_JPEG_TO_RED), np.array(_JPEG_TO_GREEN)
    apart = (toggle * float(red @ red), toggle * float(green @ green))
    return CodeNoise(step, apart, (toggle * float(red.sum()) ** 2, toggle * float(green.sum()) ** 2))


def flat_as_flat(xy: NDArray, noise: CodeNoise) -> NDArray:
    """Normal components (H, W, 2) where a component that is the same everywhere, and within q / 2 of zero, is zero.

    Integer formats have no code for zero: a map painted flat holds 127 or 128 throughout, and leans by half a code.
    """
    out = xy
    for axis in range(2):
        value = float(xy[0, 0, axis])
        if value != 0.0 and abs(value) <= 0.5 * noise.step * _ROUNDING and float(np.ptp(xy[:, :, axis])) < 1e-6:
            out = out.copy() if out is xy else out
            out[:, :, axis] = 0.0
    return out


def subtract_noise_floor(xy: NDArray, noise: CodeNoise, wrap: str) -> NDArray:
    """Normal components (H, W, 2) in [-1, 1] without what their codes cannot tell from a flat map.

    Args:
        xy: decoded x and y, float32.
        noise: of ``code_noise``; without codes ``xy`` is returned as it is.
        wrap: "tile" or "clamp".

    The mean of each component stays; a map that comes out flat within q / 2 of zero comes out exactly zero.
    """
    if noise.step <= 0.0:
        return xy
    means, gains = [np.ascontiguousarray(np.moveaxis(np.asarray(xy, dtype=np.float32), 2, 0))], []
    budget = np.broadcast_to(np.array(noise.variance, np.float32)[:, None, None], means[0].shape)
    threshold = _ROUNDING * np.array([t / v for t, v in zip(noise.together, noise.variance, strict=True)], np.float32)
    slack = _ROUNDING_OF_ALL * np.array(noise.variance, np.float32)[:, None, None]
    while max(means[-1].shape[1:]) > 1:
        level = _pad_even(means[-1], wrap)
        coarse = _block_mean(level)
        # Not E[x^2] - E[x]^2: at 16 bits the noise lies below the rounding of that difference.
        detail = _block_mean(np.square(level - _repeat(coarse, level.shape[1:])))
        budget = _block_mean(_pad_even(budget, wrap))
        local_detail, local_budget = _mean_3x3(detail, wrap), _mean_3x3(budget, wrap)
        kept = local_detail > threshold[:, None, None] * local_budget + slack
        gains.append(np.sqrt(np.where(kept, 1.0 - local_budget / np.where(kept, local_detail, 1.0), 0.0)))
        budget = budget - np.minimum(detail, budget)
        means.append(coarse)
    out = means.pop()
    for level, gain in zip(reversed(means), reversed(gains), strict=True):
        size = level.shape[1:]
        coarse = _repeat(_block_mean(_pad_even(level, wrap)), size)
        out = _repeat(out, size) + _repeat(gain, size) * (level - coarse)
    return flat_as_flat(np.ascontiguousarray(np.moveaxis(out, 0, 2)), noise)


def _pad_even(array: NDArray, wrap: str) -> NDArray:
    """(C, H, W) with sides padded to even; a side of one texel repeats itself."""
    odd_y, odd_x = array.shape[1] % 2, array.shape[2] % 2
    if not odd_y and not odd_x:
        return array
    return np.pad(array, ((0, 0), (0, odd_y), (0, odd_x)), mode="wrap" if wrap == "tile" else "edge")


def _block_mean(array: NDArray) -> NDArray:
    rows = array[:, 0::2] + array[:, 1::2]
    return 0.25 * (rows[:, :, 0::2] + rows[:, :, 1::2])


def _mean_3x3(array: NDArray, wrap: str) -> NDArray:
    padded = np.pad(array, ((0, 0), (1, 1), (1, 1)), mode="wrap" if wrap == "tile" else "edge")
    rows = padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:]
    return (rows[:, :, :-2] + rows[:, :, 1:-1] + rows[:, :, 2:]) / 9.0


def _repeat(array: NDArray, size: tuple[int, int]) -> NDArray:
    return np.repeat(np.repeat(array, 2, axis=1), 2, axis=2)[:, : size[0], : size[1]]
