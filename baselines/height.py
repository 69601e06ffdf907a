"""A common wrong way, shown by Baker (2011, "Spectacular Specular"): filter the height map and derive normals from it.

    n' ~ (-dh/dx, -dh/dy, 1),   h = E[height], central differences between the level's texels

The slopes of an averaged height are averaged slopes: the bumps are smoothed away. Perceptual roughness is averaged as
stored, colours linearly.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray

from baselines._filtering import LevelContext
from baselines.naive import Naive
from brdffit.errors import InputError
from brdffit.svbrdf import Svbrdf


def _derivative(height: NDArray, axis: int, spacing: float, wrap: str) -> NDArray:
    """Central difference along ``axis``; one-sided at a clamped border, 0 where there is only one texel."""
    size = height.shape[axis]
    before, after = np.arange(size) - 1, np.arange(size) + 1
    if wrap == "tile":
        distance = np.full(size, 2)
        before, after = before % size, after % size
    else:
        before, after = np.maximum(before, 0), np.minimum(after, size - 1)
        distance = np.maximum(after - before, 1)
    difference = np.take(height, after, axis) - np.take(height, before, axis)
    divisor = (distance * spacing).astype(np.float32)
    return difference / (divisor[:, None] if axis == 0 else divisor)


class FilteredHeight(Naive):
    """Normals of the filtered height map."""

    name = "height"
    summary = "filter the height map and take normals of that: a common wrong way (needs a height map)"

    def channels(self, svbrdf: Svbrdf, notes: list[str]) -> dict[str, NDArray]:
        """Height and perceptual roughness.

        Raises:
            brdffit.errors.InputError: when there is no height map.
        """
        if svbrdf.height is None:
            raise InputError(
                "Method 'height' filters a height map and this material has none: "
                "give one (--role height=FILE), or choose another method."
            )
        channels = super().channels(svbrdf, notes)
        return {"height": svbrdf.height[..., None], "roughness": channels["roughness"]}

    def finish_level(
        self, filtered: Mapping[str, NDArray], context: LevelContext, pool: Executor
    ) -> tuple[NDArray, NDArray]:
        """Normals from the slopes of the whole level, since slopes need neighbours, then roughness by blocks."""
        height = filtered["height"][..., 0]
        down = _derivative(height, 0, context.scale[0], context.wrap)
        across = _derivative(height, 1, context.scale[1], context.wrap)
        # Rows run downwards, +Y points up.
        normal = np.stack([-across, down, np.ones_like(across)], axis=-1)
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return super().finish_level({"normal": normal, "roughness": filtered["roughness"]}, context, pool)
