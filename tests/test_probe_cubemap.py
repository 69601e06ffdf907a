"""Laws of cube maps: solid angles, seams, orientation, and the first pass with its transpose."""

import numpy as np
import pytest
from probes_support import downsampled, lamps, latlong, write_exr

from brdffit.errors import InputError
from brdffit.files.image_io import write_png
from brdffit.probes.cubemap import (
    directions,
    face_coordinates,
    halved,
    look_up,
    look_up_trilinear,
    mean_radiance,
    pad,
    solid_angles,
)
from brdffit.probes.downsampling import Layout
from brdffit.probes.kernels.cube import face_of, face_point
from brdffit.probes.kernels.pyramid import pull_level
from brdffit.probes.reading import CELLS, CENTRES, Surroundings, as_cube, read_surroundings, reoriented

#: The 48 ways to put the axes in another order and direction.
SYMMETRIES = [
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in [(0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]
    for signs in np.array(np.meshgrid([1, -1], [1, -1], [1, -1])).T.reshape(-1, 3)
]


@pytest.mark.parametrize("n", [1, 2, 16, 128])
def test_solid_angles_fill_the_sphere(n):
    assert 6.0 * solid_angles(n).sum() == pytest.approx(4.0 * np.pi, rel=1e-12)


def test_directions_and_face_coordinates_are_inverse():
    n = 8
    face, u, v = face_coordinates(directions(n))
    centre = (2.0 * np.arange(n) + 1.0) / n - 1.0
    np.testing.assert_array_equal(face, np.broadcast_to(np.arange(6)[:, None, None], (6, n, n)))
    np.testing.assert_allclose(u, np.broadcast_to(centre, (6, n, n)), atol=1e-12)
    np.testing.assert_allclose(v, np.broadcast_to(-centre[:, None], (6, n, n)), atol=1e-12)
    # The compiled ones say the same.
    rng = np.random.default_rng(0)
    for d in rng.normal(size=(50, 3)):
        f, s, t = face_of(*d)
        assert np.allclose(np.array(face_point(f, s, t)) * np.abs(d).max(), d)
        assert (f, s, t) == pytest.approx(tuple(float(each) for each in face_coordinates(d)))


def test_the_lookup_order_is_that_of_opengl():
    """Table 3.21 of OpenGL 4.6: +X has sc = -z, tc = -y; +Y has sc = x, tc = z; -Z has sc = -x, tc = -y."""
    for direction, face, sc, tc in (
        ((1.0, 0.2, 0.3), 0, -0.3, -0.2),
        ((-1.0, 0.2, 0.3), 1, 0.3, -0.2),
        ((0.2, 1.0, 0.3), 2, 0.2, 0.3),
        ((0.2, -1.0, 0.3), 3, 0.2, -0.3),
        ((0.2, 0.3, 1.0), 4, 0.2, -0.3),
        ((0.2, 0.3, -1.0), 5, -0.2, -0.3),
    ):
        f, u, v = face_coordinates(np.array(direction))
        assert (int(f), float(u), float(-v)) == pytest.approx((face, sc, tc))


def test_a_border_holds_the_texels_beyond_the_edge():
    """A smooth function of direction goes on smoothly into the border: no edge is turned or swapped."""
    n = 16
    way = np.array([0.3, -0.5, 0.8])
    cube = directions(n) @ way
    padded = pad(cube[..., None])[..., 0]
    steps = np.abs(np.diff(padded[:, :, 1:-1], axis=1)).max()
    inside = np.abs(np.diff(cube, axis=1)).max()
    assert steps < 1.1 * inside
    corner = padded[:, 0, 0]
    assert np.all(np.abs(corner - padded[:, 1, 1]) < 2.0 * inside)


def test_seamless_lookups_are_continuous_and_meet_the_texels():
    cube = lamps(16)
    np.testing.assert_allclose(look_up(cube, directions(16)), cube, rtol=1e-5)
    # Just on both sides of the edge between +X and +Y.
    z = np.linspace(-0.9, 0.9, 40)
    one, other = (
        np.stack([np.ones(40), np.full(40, 1.0 - 1e-7), z], -1),
        np.stack([np.full(40, 1.0 - 1e-7), np.ones(40), z], -1),
    )
    np.testing.assert_allclose(look_up(cube, one), look_up(cube, other), rtol=2e-2, atol=1e-3)
    levels = [cube, halved(cube)]
    middle = look_up_trilinear(levels, one, np.full(40, 0.5))
    np.testing.assert_allclose(middle, 0.5 * (look_up(cube, one) + look_up(levels[1], one)), rtol=1e-6)


def test_halving_keeps_the_energy():
    cube = lamps(32)
    np.testing.assert_allclose(mean_radiance(halved(cube)), mean_radiance(cube), rtol=1e-6)


@pytest.mark.parametrize("kind", ["quadratic", "exact"])
def test_a_constant_passes_every_downsampling(kind):
    np.testing.assert_allclose(downsampled(np.full((6, 16, 16, 1), 0.7), kind), 0.7, rtol=1e-12)


def test_the_compiled_pyramid_is_the_plain_one():
    layout = Layout(32)
    image = np.random.default_rng(0).random((6, 32, 32))
    flat, plain = layout.build(image), image[..., None]
    for level in range(1, 6):
        plain = downsampled(plain)
        np.testing.assert_allclose(layout.interior(flat, level), plain[..., 0], atol=1e-14)
    means = layout.interior(layout.build(image, box=True), 5)
    np.testing.assert_allclose(means.ravel(), image.mean(axis=(1, 2)), rtol=1e-12)


def test_four_reads_come_near_the_exact_sixteen():
    image = np.random.default_rng(0).random((6, 32, 32, 1))
    four, sixteen = downsampled(image), downsampled(image, "exact")
    assert 1e-4 < np.abs(four - sixteen).mean() < 0.02


@pytest.mark.parametrize("level", [1, 3, 5])
def test_pushing_is_the_transpose_of_pulling(level):
    layout, rng = Layout(32), np.random.default_rng(level)
    coarse, fine = np.zeros(layout.offsets[-1]), np.zeros(layout.offsets[-1])
    n = layout.sizes[level]
    layout.interior(coarse, level)[...] = rng.random((6, n, n))
    layout.interior(fine, level - 1)[...] = rng.random((6, 2 * n, 2 * n))
    layout.pad(coarse, level)
    layout.push(coarse, level)
    layout.pad(fine, level - 1)
    pull_level(fine, layout.offsets[level - 1], layout.offsets[level], n, layout.weights[level])
    pushed = (layout.interior(coarse, level - 1) * layout.interior(fine, level - 1)).sum()
    pulled = (layout.interior(coarse, level) * layout.interior(fine, level)).sum()
    assert pushed == pytest.approx(pulled, rel=1e-12)


@pytest.mark.parametrize("matrix", SYMMETRIES)
def test_the_first_pass_follows_the_cube_when_it_is_turned(matrix):
    image = np.random.default_rng(1).random((6, 16, 16, 1))
    np.testing.assert_allclose(
        downsampled(reoriented(image, matrix)), reoriented(downsampled(image), matrix), atol=1e-14
    )


def test_a_lat_long_picture_comes_out_where_its_directions_are(tmp_path):
    cube = as_cube(Surroundings(tmp_path, "latlong", latlong()), 16)
    np.testing.assert_allclose(cube, 1.0 + directions(16), atol=0.03)


@pytest.mark.parametrize("centre", CENTRES)
def test_the_middle_of_a_picture_looks_where_it_is_told(centre):
    picture = np.zeros((64, 128, 3), np.float32)
    picture[:, 64:70] = 1.0  # right of the middle
    cube = as_cube(Surroundings(None, "latlong", picture), 32, centre)
    x, z = CENTRES[centre]
    ahead, right = np.array([x, 0.0, z]), np.array([-z, 0.0, x])
    turned = ahead + 0.15 * right
    assert look_up(cube, turned)[0] > 0.9
    assert look_up(cube, ahead - 0.15 * right)[0] < 0.1


def test_turning_goes_from_x_to_minus_z():
    picture = latlong()
    turned = as_cube(Surroundings(None, "latlong", picture), 16, degrees=90.0)
    # What lay along +X (red) lies along -Z now.
    assert look_up(turned, np.array([0.0, 0.0, -1.0]))[0] > 1.9
    of_cube = as_cube(Surroundings(None, "cube", as_cube(Surroundings(None, "latlong", picture), 16)), 16, degrees=90.0)
    np.testing.assert_allclose(of_cube, turned, atol=0.05)


def test_energy_of_a_lat_long_picture_is_kept():
    rng = np.random.default_rng(0)
    picture = rng.random((64, 128, 3)).astype(np.float32) ** 8
    edge = np.cos(np.linspace(0.0, np.pi, 65))
    mean = (picture * (edge[:-1] - edge[1:])[:, None, None]).sum(axis=(0, 1)) / 256.0
    np.testing.assert_allclose(mean_radiance(as_cube(Surroundings(None, "latlong", picture), 32)), mean, rtol=5e-3)


@pytest.mark.parametrize("layout", CELLS)
def test_crosses_and_strips_are_told_by_their_shape(tmp_path, layout):
    cube = (1.0 + directions(8)).astype(np.float32)
    picture = np.zeros((*8 * (1 + np.max(CELLS[layout], axis=0)), 3))
    for face, (r, c) in enumerate(CELLS[layout]):
        turned = face == 5 and layout == "vertical-cross"
        picture[8 * r : 8 * r + 8, 8 * c : 8 * c + 8] = cube[face][::-1, ::-1] if turned else cube[face]
    write_exr(tmp_path / "environment.exr", picture)
    read = read_surroundings(tmp_path / "environment.exr")
    assert read.layout == layout
    np.testing.assert_allclose(as_cube(read, 8), cube, atol=1e-6)


def test_six_faces_in_a_folder(tmp_path):
    cube = (1.0 + directions(8)).astype(np.float32)
    for name, face in zip(("px", "nx", "py", "ny", "pz", "nz"), cube, strict=True):
        write_exr(tmp_path / f"sky_{name}.exr", face)
    np.testing.assert_allclose(read_surroundings(tmp_path).pixels, cube)
    (tmp_path / "sky_ny.exr").unlink()
    with pytest.raises(InputError, match="lacks the face ny"):
        read_surroundings(tmp_path)


def test_what_is_no_environment_is_refused_in_a_sentence(tmp_path):
    write_exr(tmp_path / "odd.exr", np.ones((30, 50, 3)))
    with pytest.raises(InputError, match="50x30, expected a lat-long"):
        read_surroundings(tmp_path / "odd.exr")
    picture = np.ones((16, 32, 3))
    picture[3, 4, 1], picture[5, 6, 0] = np.nan, -1.0
    write_exr(tmp_path / "bad.exr", picture)
    with pytest.raises(InputError, match="1 not finite and 1 negative"):
        read_surroundings(tmp_path / "bad.exr")
    read = read_surroundings(tmp_path / "bad.exr", clamp=True)
    assert np.isfinite(read.pixels).all() and read.pixels.min() == 0.0 and "clamped" in read.notes[-1]


def test_a_picture_that_repeats_its_border_is_seen(tmp_path):
    picture = np.random.default_rng(0).random((16, 32, 3)).astype(np.float32)
    picture[:, -1] = picture[:, 0]
    write_exr(tmp_path / "border.exr", picture)
    assert read_surroundings(tmp_path / "border.exr").on_border
    write_exr(tmp_path / "plain.exr", np.random.default_rng(0).random((16, 32, 3)))
    assert not read_surroundings(tmp_path / "plain.exr").on_border


def test_eight_bits_are_read_and_said_to_have_little_range(tmp_path):
    write_png(tmp_path / "sky.png", np.full((32, 64, 3), 188, np.uint8))
    read = read_surroundings(tmp_path / "sky.png")
    np.testing.assert_allclose(read.pixels, 0.5028865, rtol=1e-4)
    assert any("8 bits" in note and "clipped" in note for note in read.notes)
