"""What parallax, shadows and interreflection contribute: much in a grazing close-up, nothing without relief."""

import numpy as np
import pytest

from brdffit.fitting.options import FitOptions
from brdffit.planning.description import SceneFile, Surface
from brdffit.planning.effects import BY_NAME
from brdffit.planning.facts import settled
from brdffit.planning.traced import OFF, effects_without, traced_losses, what_maps_lack
from brdffit.planning.trial import Errors, Sample, Shining
from tests.test_microgeometry import bumps, material, toward


def losses_of(base, reach, degrees):
    """Losses of all three for one pair of directions, where lobes are off by a hundredth of the picture's power."""
    view, light = toward(degrees, -90), toward(degrees, 20)

    def draw(texels, pairs, seed, highlights):
        shape = (texels, pairs, 3)
        return np.broadcast_to(view, shape), np.broadcast_to(light, shape), np.ones((texels, pairs))

    sample = Sample(base, FitOptions(), reach, [Shining(0.0, 1.0, draw)], texels=32)
    counts = [len(columns) for columns, _ in sample.texels.values()]
    found = Errors([np.full((1, n), 0.01) for n in counts], [np.ones(n) for n in counts])
    return traced_losses(sample, found, tuple(OFF))


def test_effects_count_where_they_are_seen():
    base = material(bumps(64, 3.0), diffuse=0.7, specular=0.0)
    near, costs = losses_of(base, (0, 0), 60.0)
    far, _ = losses_of(base, (5, 6), 3.0)
    assert near["parallax"].db > 8.0 and near["shadowing"].db > 3.0 and near["interreflection"].db > 0.1
    assert far["parallax"].at_most < 0.5 and far["shadowing"].at_most < 0.5
    assert set(costs) == set(OFF)
    flat, _ = losses_of(material(np.zeros((64, 64))), (0, 2), 60.0)
    assert all(abs(each.db) < 1e-9 for each in flat.values())


def test_effects_are_the_tracers_and_no_map_is_called_to_show_them():
    assert {name for name, effect in BY_NAME.items() if effect.traced} == set(OFF)
    everything = effects_without([])
    assert everything.displacement and everything.shadowing and everything.bounces > 0
    for name in OFF:
        assert effects_without([name]) != everything
    base = material(bumps(64, 3.0), diffuse=0.7, specular=0.0)
    losses, _ = losses_of(base, (0, 0), 60.0)
    (sentence,) = what_maps_lack(losses, ["parallax"], (64, 64), 10**6, 60.0)
    assert "No map shows parallax (" in sentence and "60 s a picture of 1.0 megapixels" in sentence
    assert what_maps_lack(losses, [], (64, 64), 10**6, 60.0) == []


@pytest.mark.parametrize("height", [None, np.zeros((8, 8))])
def test_without_a_height_the_scene_settles_them(height):
    base = material(np.zeros((8, 8)))
    base = base.replace(height=height)
    facts = settled(SceneFile(surfaces=[Surface(set="x")]), base, (0, 1))
    assert all(not facts[name].on and "no height map" in facts[name].why for name in OFF)
