"""A method that bakes no lobes: diffuse colour alone, averaged; for the tests of what must do without lobes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from brdffit.appearance import trilinear
from brdffit.footprint import filter_pyramid, get_pixel_filter
from brdffit.methods import Baked, Image
from brdffit.options import BakeOptions, option
from brdffit.svbrdf import level_sizes


@dataclass(frozen=True)
class MattOptions(BakeOptions):
    """One option of its own."""

    group: ClassVar[str] = "matt"

    gain: float = option(1.0, "factor of the colour", above=0.0)


class MattSurface:
    """Lambert's law from MIP levels of a colour."""

    def __init__(self, levels, wrap):
        self.levels, self.wrap, self.base_size = levels, wrap, levels[0].shape[:2]

    def look_up(self, lookups):
        return trilinear(self.levels, lookups, self.base_size, self.wrap)

    def evaluate(self, texels, view, light):
        return texels * (np.maximum(light[:, 2:], 0.0) / np.pi).astype(np.float32)

    def sample(self, texels, view, u):
        radius, angle = np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - u[:, 0])], axis=-1)

    def pdf(self, texels, view, light):
        return np.maximum(light[:, 2], 0.0) / np.pi


class Matt:
    """Average the diffuse colour; there is no lobe."""

    name = "matt"
    summary = "diffuse colour alone, for tests"
    options = MattOptions

    def prepare(self, material, options):
        """Nothing."""

    def bake(self, material, options, progress=None):
        svbrdf = material.svbrdf
        sizes = level_sizes(svbrdf.size, options.levels)
        colour = options.gain * (svbrdf.diffuse + svbrdf.specular)
        levels = filter_pyramid(colour, sizes, get_pixel_filter(options.pixel_filter), svbrdf.wrap)
        image = Image("colour", ("R", "G", "B"), sizes, lambda k, rows: levels[k][rows])
        return Baked(self.name, options, MattSurface(levels, svbrdf.wrap), notes=["It is matt."], stored=[image])
