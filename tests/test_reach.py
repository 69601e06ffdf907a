"""Levels that cameras reach: the laws of perspective."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from brdffit.planning.description import Camera, SceneFile, Surface
from brdffit.planning.reach import GRAZING, pixel_width, reached_levels, shown_turn
from brdffit.render import scenes

SIZE = (512, 512)
TOP = 9
distances = st.floats(0.1, 100.0)


def camera(distance=10.0, tilt=0.0, **others):
    return Camera(distance=distance, tilt=tilt, **others)


def reach(cameras, surface=None, size=SIZE):
    surface = surface or Surface(set="x", texel_size=0.005)
    cameras = cameras if isinstance(cameras, tuple) else (cameras,)
    return reached_levels(SceneFile(surfaces=(surface,), cameras=cameras), surface, size)


def at_ratio(ratio, **others):
    """A camera whose pixels are ``ratio`` texels of 5 mm wide."""
    return camera(0.005 * ratio / pixel_width(camera(), 1.0), **others)


def clamped(level):
    return min(max(level, 0), TOP)


@given(distances)
def test_twice_the_distance_is_one_level_more(distance):
    near, far = reach(camera(distance)), reach(camera(2.0 * distance))
    assert far.ratio_low == pytest.approx(2.0 * near.ratio_low)
    levels = math.floor(math.log2(near.ratio_low)), math.ceil(math.log2(near.ratio_low))
    assert (near.first, near.last) == tuple(map(clamped, levels))
    assert (far.first, far.last) == tuple(clamped(level + 1) for level in levels)


@given(distances)
def test_twice_the_resolution_is_one_level_less(distance):
    coarse = reach(camera(distance, resolution=(960, 540)))
    fine = reach(camera(distance, resolution=(1920, 1080)))
    assert coarse.ratio_high == pytest.approx(2.0 * fine.ratio_high)


@given(distances)
def test_a_tilt_of_60_degrees_is_one_level_more(distance):
    assert reach(camera(distance, tilt=60.0)).ratio_high == pytest.approx(2.0 * reach(camera(distance)).ratio_high)


@given(st.floats(0.01, 50.0), st.integers(1, 4096))
def test_repetitions_and_texel_size_agree(repetitions, width):
    size = (64, width)
    by_repetition = reach(camera(), Surface(set="x", repetitions=repetitions), size)
    by_texel = reach(camera(), Surface(set="x", texel_size=1.0 / (repetitions * width)), size)
    assert (by_repetition.first, by_repetition.last) == (by_texel.first, by_texel.last)
    assert by_repetition.ratio_high == pytest.approx(by_texel.ratio_high)


def test_a_wider_view_has_wider_pixels():
    assert pixel_width(camera(field_of_view=90.0), 3.0) == pytest.approx(2.0 * 3.0 / 1920)


@pytest.mark.parametrize(
    "ratio, levels",
    [(0.3, (0, 0)), (1.0, (0, 0)), (1.5, (0, 1)), (4.0, (2, 2)), (5.0, (2, 3)), (400.0, (8, 9)), (9000.0, (TOP, TOP))],
)
def test_levels_below_and_above_are_read(ratio, levels):
    found = reach(at_ratio(ratio))
    assert (found.first, found.last) == levels
    assert found.ratio_low == found.ratio_high == pytest.approx(ratio)


def test_ranges_and_cameras_are_joined():
    both = reach((Camera(distance=(1.0, 4.0), tilt=(0.0, 60.0), name="near"), at_ratio(300.0, name="far")))
    one, other = reach(Camera(distance=1.0, tilt=0.0)), reach(at_ratio(300.0))
    assert (both.first, both.last) == (one.first, other.last)
    assert (both.ratio_low, both.ratio_high) == (one.ratio_low, other.ratio_high)
    assert "'near'" in both.sentence and "'far'" in both.sentence
    alone = reach(Camera(distance=(1.0, 4.0), tilt=(0.0, 60.0)))
    assert alone.ratio_high == pytest.approx(4.0 * 2.0 * alone.ratio_low)


def test_the_sentence_says_levels_and_texels():
    assert reach(at_ratio(5.0)).sentence == "A pixel spans 5 to 5 texels: levels 2 to 3 of 0 to 9."
    assert reach(at_ratio(4.0)).sentence == "A pixel spans 4 to 4 texels: level 2 of 0 to 9."


@pytest.mark.parametrize("tilt", [0.0, 30.0, 70.0])
def test_the_level_is_that_of_the_renderer(tilt):
    """The footprint of a tilted plane, by the definition that pictures are rendered with."""
    found = reach(at_ratio(3.0, tilt=tilt))
    scene = scenes.plane(SIZE, 0.0, (1, 1))
    scene.axes[...] = 3.0 * np.diag([1.0, 1.0 / math.cos(math.radians(tilt))])
    assert math.log2(found.ratio_high) == pytest.approx(float(scenes.level_of_detail(scene)[0, 0]), rel=1e-5)


def test_a_curved_surface_turns_as_a_ball_that_is_met_by_rays():
    """Against the intersection of the corner's ray with the ball."""
    eye = Camera(field_of_view=40.0, resolution=(1600, 1200))
    across, up = math.tan(math.radians(20.0)), math.tan(math.radians(20.0)) * 0.75
    ray = np.array([across, up, 1.0]) / np.linalg.norm([across, up, 1.0])
    for distance, radius in ((1.0, 4.0), (0.5, 10.0), (2.0, 30.0)):
        centre = np.array([0.0, 0.0, distance + radius])
        along = ray @ centre
        hit = (along - math.sqrt(along**2 - centre @ centre + radius**2)) * ray
        normal = (hit - centre) / radius
        assert float(shown_turn(eye, distance, radius)) == pytest.approx(math.degrees(math.acos(-normal[2])))


def test_little_curvature_is_none_and_a_small_ball_shows_its_rim():
    eye, flat = camera(2.0, tilt=10.0), reach(camera(2.0, tilt=10.0))
    assert shown_turn(eye, 2.0, None) == 0.0
    almost = reach(eye, Surface(set="x", texel_size=0.005, radius=1e6))
    assert almost.ratio_high == pytest.approx(flat.ratio_high, rel=1e-5)
    small = reach(eye, Surface(set="x", texel_size=0.005, radius=0.05))
    grazing = math.cos(math.radians(10.0)) / math.cos(math.radians(GRAZING))
    assert small.ratio_high == pytest.approx(flat.ratio_high * grazing)
    assert small.ratio_low == pytest.approx(flat.ratio_low * math.cos(math.radians(10.0)))
    # A camera that looks at a flat surface more steeply than that is believed.
    steep = reach(camera(2.0, tilt=85.0), Surface(set="x", texel_size=0.005, radius=0.05))
    assert steep.ratio_high == pytest.approx(reach(camera(2.0, tilt=85.0)).ratio_high)


@given(st.floats(0.01, 100.0), st.floats(0.01, 100.0), st.floats(1.0, 3.0))
def test_more_of_a_ball_is_seen_from_farther_and_of_a_smaller_one(distance, radius, factor):
    turn = shown_turn(Camera(), np.array([distance, factor * distance]), radius)
    # Where a sine is near 1 its angle is known to the root of the rounding alone, 1e-6 degrees.
    assert 0.0 <= turn[0] <= turn[1] + 1e-5 and turn[1] <= 90.0 + 1e-9
    assert shown_turn(Camera(), distance, factor * radius) <= turn[0] + 1e-5
