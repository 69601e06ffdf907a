"""Levels to the text of a page that shows them: averaged, baked and true side by side."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from brdffit.errors import InputError
from brdffit.files.image_io import read_image
from brdffit.svbrdf import Svbrdf
from brdffit.viewer.packing import pack_environment, pack_levels

#: The lobe that the page's shader draws.
DRAWN_MODEL = "ggx"
#: Largest side of a page's texture; of larger sets the middle is shown.
MOST_TEXELS = 1024
#: Side above which the page holds no level 0 of the methods: the source's is shown, which leaves a quarter.
_WITH_LEVEL_0 = 512
#: Rows of an environment in the page.
_SKY_ROWS = 128
_KEYS = (
    "Drag or arrow keys: turn; wheel, pinch, + and -: distance; [ and ]: level; d: difference; w: wipe; "
    "space: moving light."
)


def page_text(
    name: str,
    base: Svbrdf,
    panels: Sequence[tuple[str, Sequence[Svbrdf]]],
    *,
    sky: Mapping[str, Any] | None = None,
    notes: Sequence[str] = (),
) -> str:
    """The page: one HTML text that needs no connection.

    Args:
        name: of the set.
        base: its level 0, of the lobe ``DRAWN_MODEL``, at most ``MOST_TEXELS`` a side: averages and reference are made
            of it in the browser.
        panels: name and levels, finest first, of each panel between averages and reference.
        sky: environment, see ``sky_of``; None: one that the page draws.
        notes: sentences below the panels.
    """
    large = max(base.size) > _WITH_LEVEL_0
    said = [
        f"{name}, {base.size[1]}x{base.size[0]}. Averaged: every map filtered for itself, as engines do by default. "
        "The reference averages light over the pixel and settles within seconds.",
        *notes,
        *(["Level 0 of every panel is the source's."] if large else []),
        _KEYS,
    ]
    data = {
        "wrap": base.wrap,
        # Small sets are repeated so that a texel is not larger than the page's pixels.
        "repeat": 1 if large else 2,
        "source": pack_levels([base]),
        "methods": [{"name": each, "levels": pack_levels(levels[1:] if large else levels)} for each, levels in panels],
        "environment": sky,
        "note": " ".join(said),
    }
    # "</" would end the script that holds the data.
    text = json.dumps(data, separators=(",", ":")).replace("</", "<\\/")
    import jinja2

    templates = jinja2.Environment(
        loader=jinja2.PackageLoader("brdffit.viewer"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return templates.get_template("page.html").render(title=f"{name}: MIP levels", data=text)


def middle(svbrdf: Svbrdf) -> Svbrdf:
    """The middle of a set, at most MOST_TEXELS a side."""
    height, width = svbrdf.size
    top, left = max(0, (height - MOST_TEXELS) // 2), max(0, (width - MOST_TEXELS) // 2)
    part = slice(top, top + MOST_TEXELS), slice(left, left + MOST_TEXELS)
    return svbrdf.replace(**{name: np.ascontiguousarray(array[part]) for name, array in svbrdf.arrays().items()})


def sky_of(environment: str) -> dict[str, Any]:
    """An environment, averaged to so many rows that it stays small in the page."""
    pixels = read_image(environment).pixels
    if pixels.shape[2] < 3:
        raise InputError(f"'{environment}' has {pixels.shape[2]} channels, expected an RGB picture of light.")
    step = max(1, pixels.shape[0] // _SKY_ROWS)
    height, width = pixels.shape[0] // step * step, pixels.shape[1] // step * step
    blocks = pixels[:height, :width, :3].reshape(height // step, step, width // step, step, 3)
    return pack_environment(np.maximum(blocks.mean(axis=(1, 3)), 0.0))
