"""How the pixels of a file lie: set upright by its orientation, and which of its channels are meant."""

from __future__ import annotations

from numpy.typing import NDArray


def upright(pixels: NDArray, orientation: int) -> NDArray:
    """Stored pixels (H, W, C) as the picture is meant: Exif orientations 1 to 8."""
    if orientation >= 5:
        pixels = pixels.transpose(1, 0, 2)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return pixels


def default_layer(names: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[int, ...], str]:
    """Channel names without their layer, indices of those that are read (() for all), and what is left out."""
    layers = list(dict.fromkeys(name.rpartition(".")[0] for name in names))
    chosen = "" if "" in layers else (layers[0] if layers else "")
    indices = [k for k, name in enumerate(names) if name.rpartition(".")[0] == chosen]
    plain = [names[k].rpartition(".")[2] for k in indices]
    if {"R", "G", "B"} <= set(plain):
        # Depth and what else stands beside colours is no channel of a map.
        indices = [indices[plain.index(letter)] for letter in "RGBA" if letter in plain]
        plain = [names[k].rpartition(".")[2] for k in indices]
    if indices == list(range(len(names))):
        return tuple(plain), (), ""
    left = [name for k, name in enumerate(names) if k not in indices]
    return tuple(plain), tuple(indices), f" holds more channels ({', '.join(left[:8])}), which are left out."
