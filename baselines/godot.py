"""Godot's ``Image::generate_mipmap_roughness`` as shipped (core/io/image.cpp, MIT; read in its public source).

    R'^2 = E[R]^2 + min(3 / (4 kappa), 0.4^2),   kappa = (3 r - r^3) / (1 - r^2)

As Filament's with another constant and another cap. R is averaged as stored, normals are averaged and made unit length,
colours are averaged linearly, and level 0 is left as authored. (The tool averages whole texels from a summed-area
table; here the user chooses the pixel filter.)
"""

from __future__ import annotations

from baselines.filament import Filament


class Godot(Filament):
    """A capped von Mises-Fisher term in perceptual roughness, larger than Filament's."""

    name = "godot"
    summary = "R^2 + min(0.75/kappa, 0.16) in perceptual roughness, as Godot's importer ships it"
    factor = 0.75
    cap = 0.4**2
