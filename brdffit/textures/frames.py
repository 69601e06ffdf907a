"""Where in its own picture a map is read: texture transforms, and maps that are scaled or turned against each other.

A frame is the affine map x' = A x + b from texture coordinates to those of the picture, both with (0, 0) at the upper
left corner and (1, 1) at the lower right one. Maps that share a frame belong together as they are, whatever it is: the
renderer applies it to all. Maps of different frames are brought to one of them. That one must be such that every other
repeats a whole number of times across it, or the result would not tile: A of each against it must hold integers.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: How far an entry of A may be from an integer.
_INTEGER = 1e-4


@dataclass(frozen=True)
class Frame:
    """x' = A x + b: ``linear`` are the rows of A, ``offset`` is b."""

    linear: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))
    offset: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, linear: NDArray, offset: NDArray) -> Frame:
        """The frame of arrays (2, 2) and (2,)."""
        (a, b), (c, d) = np.asarray(linear, np.float64).tolist()
        x, y = np.asarray(offset, np.float64).tolist()
        return cls(((a, b), (c, d)), (x, y))

    @property
    def arrays(self) -> tuple[NDArray, NDArray]:
        """A (2, 2) and b (2,)."""
        return np.array(self.linear), np.array(self.offset)

    def after(self, first: Frame) -> Frame:
        """This frame applied to what ``first`` gives."""
        (a, b), (c, d) = self.arrays, first.arrays
        return Frame.of(a @ c, a @ d + b)

    def inverse(self) -> Frame | None:
        """The frame back; None where A is singular."""
        linear, offset = self.arrays
        if abs(float(np.linalg.det(linear))) < 1e-9:
            return None
        back = np.linalg.inv(linear)
        return Frame.of(back, -back @ offset)

    def flipped(self) -> Frame:
        """The same with both vertical axes turned over: from coordinates with (0, 0) at the lower left, or to them."""
        linear, offset = self.arrays
        turn, move = np.diag([1.0, -1.0]), np.array([0.0, 1.0])
        return Frame.of(turn @ linear @ turn, turn @ (linear @ move + offset) + move)

    @property
    def is_identity(self) -> bool:
        """Whether it changes nothing, but for rounding."""
        linear, offset = self.arrays
        return bool(np.abs(linear - np.eye(2)).max() < 1e-9 and np.abs(offset).max() < 1e-9)

    @property
    def is_integer(self) -> bool:
        """Whether A holds integers and is not singular, so that what tiles still tiles after it."""
        linear, _ = self.arrays
        return bool(np.abs(linear - np.rint(linear)).max() < _INTEGER and abs(np.linalg.det(linear)) > 0.5)


IDENTITY = Frame()


def gltf_frame(offset: Sequence[float], rotation: float, scale: Sequence[float]) -> Frame:
    """The frame of KHR_texture_transform; ``rotation`` in radians, counter-clockwise, after the scale."""
    sine, cosine = math.sin(rotation), math.cos(rotation)
    turn = np.array([[cosine, sine], [-sine, cosine]])
    return Frame.of(turn @ np.diag(np.asarray(scale, np.float64)), np.asarray(offset, np.float64))


def common_frame(frames: Sequence[Frame]) -> Frame | None:
    """The first of ``frames`` in which every other repeats a whole number of times; None if there is none."""
    for candidate in dict.fromkeys(frames):
        back = candidate.inverse()
        if back is not None and all(frame.after(back).is_integer for frame in frames):
            return candidate
    return None


def size_in(frame: Frame, size: tuple[int, int]) -> tuple[int, int]:
    """(height, width) at which a picture of ``size`` is read through ``frame`` without loss of detail.

    A picture that is not turned keeps its proportions, or it would go with no other map.
    """
    linear = np.abs(np.rint(frame.arrays[0]))
    if linear[0, 1] == 0.0 and linear[1, 0] == 0.0:
        times = max(1, int(linear.max()))
        return times * size[0], times * size[1]
    width = max(linear[0, 0] * size[1], linear[1, 0] * size[0])
    height = max(linear[1, 1] * size[0], linear[0, 1] * size[1])
    return max(1, int(height)), max(1, int(width))


def read_through(frame: Frame, pixels: NDArray, wrap: str = "tile") -> NDArray:
    """Pixels (H, W, C) of a picture read through ``frame``, bilinearly, at ``size_in`` of it."""
    if frame == IDENTITY or pixels.shape[:2] == (1, 1):
        return pixels
    height, width = size_in(frame, pixels.shape[:2])  # type: ignore[arg-type]
    linear, offset = frame.arrays
    x, y = (np.arange(width) + 0.5) / width, (np.arange(height) + 0.5)[:, None] / height
    across = (linear[0, 0] * x + linear[0, 1] * y + offset[0]) * pixels.shape[1] - 0.5
    down = (linear[1, 0] * x + linear[1, 1] * y + offset[1]) * pixels.shape[0] - 0.5
    # Rounding must not smear a read that falls on texel centres.
    across, down = (np.where(np.abs(c - np.rint(c)) < 1e-6, np.rint(c), c) for c in (across, down))
    column, row = np.floor(across).astype(np.int64), np.floor(down).astype(np.int64)
    right, below = (across - column)[..., None].astype(np.float32), (down - row)[..., None].astype(np.float32)

    def at(rows: NDArray, columns: NDArray) -> NDArray:
        if wrap == "tile":
            return pixels[rows % pixels.shape[0], columns % pixels.shape[1]]
        return pixels[rows.clip(0, pixels.shape[0] - 1), columns.clip(0, pixels.shape[1] - 1)]

    above = at(row, column) * (1.0 - right) + at(row, column + 1) * right
    return above * (1.0 - below) + (at(row + 1, column) * (1.0 - right) + at(row + 1, column + 1) * right) * below


def turn_of(frame: Frame) -> NDArray:
    """(2, 2): how vectors in the picture, y up, turn when it is read through ``frame``; scales are left out.

    A picture that is turned takes its bumps along: a slope along the picture's axis x' becomes one along A^-1 x'.
    """
    linear, _ = frame.arrays
    flip = np.diag([1.0, -1.0])
    back = np.linalg.inv(flip @ linear @ flip)
    return back / np.maximum(np.linalg.norm(back, axis=0), 1e-12)
