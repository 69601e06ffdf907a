"""Laws of the scenes: footprints of the size they claim, true derivatives, frames that are rotations."""

from __future__ import annotations

import numpy as np
import pytest

from brdffit.render import lights, scenes

SIZE = (64, 128)
#: Directions are single precision.
SINGLE = 2e-6


def all_scenes(**options):
    pixels = (12, 16)
    return {
        "plane": scenes.plane(SIZE, 1, pixels, **options),
        "slanted": scenes.slanted(SIZE, pixels, **options),
        "sphere": scenes.sphere(SIZE, 2, pixels, **options),
    }


@pytest.mark.parametrize("level", [0, 3, 6])
def test_a_pixel_of_the_plane_is_a_texel_of_its_level(level):
    scene = scenes.plane(SIZE, level, (8, 8))
    height, width = max(1, SIZE[0] >> level), max(1, SIZE[1] >> level)
    np.testing.assert_allclose(scene.axes[3, 5], np.diag([SIZE[1] / width, SIZE[0] / height]))
    row, column = np.meshgrid(np.arange(8) + 0.5, np.arange(8) + 0.5, indexing="ij")
    np.testing.assert_allclose(scene.centre[..., 0] * width / SIZE[1], column)
    np.testing.assert_allclose(scene.centre[..., 1] * height / SIZE[0], row)
    np.testing.assert_allclose(scenes.level_of_detail(scene), level, atol=SINGLE)


def test_a_level_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match="expected 0 to 7"):
        scenes.plane(SIZE, 8)


@pytest.mark.parametrize("name", ["plane", "slanted", "sphere"])
def test_axes_are_derivatives_of_the_centre(name):
    step = 1e-5
    scene = all_scenes()[name]
    for axis, shift in enumerate([(step, 0.0), (0.0, step)]):
        slope = (all_scenes(shift=shift)[name].centre - scene.centre) / step
        np.testing.assert_allclose(slope, scene.axes[..., axis], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", ["plane", "slanted", "sphere"])
def test_frames_are_rotations_and_views_are_above_the_surface(name):
    scene = all_scenes(rotation=0.3)[name]
    inside = scene.coverage > 0.0
    frame = scene.frame[inside].astype(float)
    np.testing.assert_allclose(frame @ frame.swapaxes(1, 2), np.broadcast_to(np.eye(3), frame.shape), atol=SINGLE)
    np.testing.assert_allclose(np.linalg.det(frame), 1.0, atol=SINGLE)
    view = scene.view[inside]
    np.testing.assert_allclose(np.linalg.norm(view, axis=1), 1.0, atol=SINGLE)
    assert (view[:, 2] > 0.0).all()


@pytest.mark.parametrize("name", ["plane", "slanted", "sphere"])
def test_rotation_turns_the_lights_and_nothing_else(name):
    still, turned = all_scenes()[name], all_scenes(rotation=0.4)[name]
    for same in ("centre", "axes", "view", "coverage"):
        np.testing.assert_array_equal(getattr(still, same), getattr(turned, same))
    assert np.abs(still.frame - turned.frame).max() > 0.1
    # The axis of the turn stays where it is.
    axis = (0.0, 1.0, 0.0) if name == "slanted" else (0.0, 0.0, 1.0)
    np.testing.assert_allclose(still.frame @ axis, turned.frame @ axis, atol=SINGLE)


@pytest.mark.parametrize("name", ["plane", "slanted", "sphere"])
def test_a_shift_by_a_pixel_is_the_next_pixel(name):
    still, moved = all_scenes()[name], all_scenes(shift=(1.0, 0.0))[name]
    for part in ("centre", "axes", "view", "frame", "coverage"):
        np.testing.assert_allclose(getattr(moved, part)[:, :-1], getattr(still, part)[:, 1:], atol=1e-5)


def test_the_slanted_plane_runs_through_all_levels():
    detail = scenes.level_of_detail(scenes.slanted((1024, 1024), (256, 64)))
    assert detail[-1].max() < 0.2
    assert detail[0].min() > 10.0
    assert (np.diff(detail[:, 0]) < 0.0).all()


def test_the_longer_axis_chooses_the_level():
    scene = scenes.slanted(SIZE, (16, 16))
    expected = np.log2(np.linalg.norm(scene.axes, axis=2).max(axis=2))
    np.testing.assert_allclose(scenes.level_of_detail(scene), expected, rtol=1e-5, atol=1e-6)


def test_lights_are_unit_vectors_and_many_light_a_plane_as_one_sky():
    many = lights.many(4096, seed=3)
    np.testing.assert_allclose(np.linalg.norm(many.direction, axis=1), 1.0, atol=SINGLE)
    # E[n.l] of cosine-distributed directions is 2/3, with a standard error of 0.24 / 64.
    assert (many.irradiance * many.direction[:, 2:]).sum(axis=0) == pytest.approx(np.full(3, np.pi * 2 / 3), rel=0.02)
    with pytest.raises(ValueError, match="no direction is zero"):
        lights.Lights(np.zeros((1, 3)), np.ones((1, 3)))
