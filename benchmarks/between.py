"""What to interpolate between texels and levels: Sigma or its logarithm: `python -m benchmarks.between SET...`.

Levels of LEAN and of the fit are rendered twice, with the roughness tensor interpolated as stored (alpha^2) and as its
logarithm, and both pictures are compared with the reference. They differ only between texel centres, so the scenes look
there: half a texel aside, half a level down, a floor that recedes, and a ball. Printed as Markdown: SNR in dB with
alpha^2, and the gain of the logarithm. Of a large set the middle is taken.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.appearance import LobePyramid, Lobes, Lookups
from brdffit.methods import Material, get_method
from brdffit.pipeline import bake_options, read_set
from brdffit.render import scenes
from brdffit.render.metrics import snr_db_of_halves
from brdffit.render.pictures import render_appearance
from brdffit.render.reference import render_halves
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf

#: Largest side in texels, pixels of a picture, samples of a footprint.
SIDE, PIXELS, SAMPLES = 512, (96, 96), 512
METHODS: dict[str, dict[str, Any]] = {"lean": {}, "bfgs": {"quality": "draft"}}


class LogPyramid(LobePyramid):
    """A ``LobePyramid`` that interpolates the logarithm of the tensor."""

    @cached_property
    def images(self) -> list[NDArray]:
        """(h, w, 12) of each level."""
        return [
            np.concatenate([level.normal, level.log_roughness, level.specular, level.diffuse], axis=-1)
            for level in self.levels
        ]

    def look_up(self, lookups: Lookups) -> Lobes:
        """The trilinear value for each pixel, with the exponential of the interpolated logarithm as its tensor."""
        lobes = super().look_up(lookups)
        return lobes._replace(tensor=tensor_from_log(lobes.tensor))


def drawn_in_numpy(pyramid: LobePyramid) -> Any:
    """The same appearance for rendering in numpy: compiled loops would read the levels directly."""
    return SimpleNamespace(
        **{name: getattr(pyramid, name) for name in ("base_size", "look_up", "evaluate", "sample", "pdf")}
    )


def views(size: tuple[int, int]) -> dict[str, scenes.Scene]:
    """Scenes whose pixels lie between texels or levels."""
    return {
        "level 1, half a texel": scenes.plane(size, 1, PIXELS, shift=(0.5, 0.5)),
        "level 1.5": scenes.plane(size, 1.5, PIXELS, shift=(0.3, 0.3)),
        "level 3, half a texel": scenes.plane(size, 3, PIXELS, shift=(0.5, 0.5)),
        "level 3.5": scenes.plane(size, 3.5, PIXELS, shift=(0.3, 0.3)),
        "floor": scenes.slanted(size, PIXELS),
        "ball": scenes.sphere(size, 2.4, PIXELS),
    }


def middle(base: Svbrdf) -> Svbrdf:
    """The middle of a base, at most SIDE texels a side."""
    top, left = (max(0, (side - SIDE) // 2) for side in base.size)
    part = slice(top, top + SIDE), slice(left, left + SIDE)
    return base.replace(**{name: np.ascontiguousarray(array[part]) for name, array in base.arrays().items()})


def rows(source: str) -> list[str]:
    """One row a method: SNR with alpha^2 and the gain of the logarithm, by scene."""
    base = middle(read_set(source, {}, bake_options(get_method("lean"), None, {})).material.svbrdf)
    seen = views(base.size)
    truth = {name: render_halves(base, scene, samples=SAMPLES).halves for name, scene in seen.items()}
    found = []
    for name, given in METHODS.items():
        method = get_method(name)
        pyramid = method.bake(Material(base), bake_options(method, None, given)).lobes
        assert pyramid is not None
        levels: Sequence[Svbrdf] = [level.svbrdf for level in pyramid.levels]
        cells, gains = [], []
        for view, scene in seen.items():
            plain, logarithm = (
                snr_db_of_halves(render_appearance(drawn_in_numpy(kind(levels)), scene), truth[view])
                for kind in (LobePyramid, LogPyramid)
            )
            gains.append(logarithm - plain)
            cells.append(f"{plain:.1f} {gains[-1]:+.1f}")
        found.append("| " + " | ".join([Path(source).name, name, *cells, f"{np.mean(gains):+.2f}"]) + " |")
    return found


def main(sets: list[str]) -> int:
    """Print the table."""
    sys.stdout.write(f"| set | method | {' | '.join(views((SIDE, SIDE)))} | mean gain |\n|---|---{'|---' * 7}|\n")
    for source in sets:
        sys.stdout.write("\n".join(rows(source)) + "\n")
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
