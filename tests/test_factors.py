"""Factors of a glTF material: pictures divided by them decode to the same lobes, and 8 bits keep more of those."""

import numpy as np
import pytest
from export_support import random_svbrdf

from brdffit.export.channels import Channels, decode
from brdffit.export.factors import Factors, factors_of
from brdffit.export.judging import degrees_between, signal_to_noise
from brdffit.export.pictures import Drawing
from brdffit.export.presets import PRESETS


def stored(level, factors, bits):
    """A level drawn as the pictures of glTF in so many bits (None: floats), and decoded."""
    drawing = Drawing([level], PRESETS["gltf"])
    drawing.factors = factors
    channels = {}
    for picture in PRESETS["gltf"].pictures:
        (codes,), (clipped,) = drawing.draw(picture, False, bits)
        assert clipped == 0
        scale = 1.0 if bits is None else 2.0**bits - 1.0
        channels |= {name: codes[..., place] / scale for place, name in enumerate(picture.channels)}
    return decode(channels, "gl", factors)


@pytest.mark.parametrize("slope", [0.02, 0.3, 1.5])
def test_what_is_divided_decodes_to_the_same(slope):
    level = random_svbrdf((16, 16), slope=slope, lowest=0.2)
    factors = factors_of([level])
    assert signal_to_noise(level, stored(level, factors, None), lobe_alone=True) > 60.0
    assert degrees_between(level.normal, stored(level, factors, None).normal).max() < 0.01


@pytest.mark.parametrize("slope", [0.01, 0.05])
def test_codes_of_flat_normals_are_finer(slope):
    level = random_svbrdf((32, 32), slope=slope, lowest=0.2)
    plain, divided = (
        degrees_between(level.normal, stored(level, each, 8).normal).mean() for each in (Factors(), factors_of([level]))
    )
    assert divided < 0.3 * plain


def test_steep_normals_are_no_worse():
    level = random_svbrdf((32, 32), slope=2.0, lowest=0.2)
    plain, divided = (
        degrees_between(level.normal, stored(level, each, 8).normal).mean() for each in (Factors(), factors_of([level]))
    )
    assert divided <= 1.05 * plain


def test_factors_are_within_what_gltf_allows():
    flat = random_svbrdf((4, 4), lowest=0.2)
    flat = flat.replace(
        normal=np.broadcast_to(np.float32([0, 0, 1]), (4, 4, 3)).copy(), log_roughness=np.zeros((4, 4, 3), np.float32)
    )
    found = factors_of([flat])
    assert found.roughness == 1.0 and found.strength == 1.0 and 0.0 < found.normal <= 1.0
    wide = factors_of([random_svbrdf((8, 8), slope=3.0, lowest=0.6)])
    assert all(0.0 < value <= 1.0 for value in (wide.normal, wide.roughness, wide.strength))
    # A lobe wider than glTF can say is held at 1, with its factor.
    assert factors_of([flat.replace(log_roughness=flat.log_roughness + np.float32([1, 1, 0]))]).roughness == 1.0


def test_what_no_factor_says_is_stored_as_it_is():
    level = random_svbrdf((8, 8))
    for name in ("normal_x", "normal_y", "normal_z", "gltf_roughness", "gltf_strength"):
        np.testing.assert_array_equal(Channels(level)[name], Channels(level, factors=Factors())[name])
