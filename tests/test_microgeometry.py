"""Traced height fields against closed cases, a search of all triangles, and the laws of light."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from brdffit.errors import InputError
from brdffit.microgeometry.heightfield import HeightField, maximum_pyramid
from brdffit.microgeometry.kernels.traversal import meet_rows
from brdffit.microgeometry.queries import Queries, read_queries, write_queries
from brdffit.microgeometry.tracer import NO_EFFECTS, Effects, Microgeometry
from brdffit.models.microfacet import brdf
from brdffit.roughness import tensor_from_log
from brdffit.svbrdf import Svbrdf
from brdffit.textures.encoding import height_gradient, normals_from_gradient
from brdffit.textures.patterns import frequencies, noise

#: Standard errors of a mean that a law may be off by: 1 in 30,000 of correct runs.
SIGMAS = 4.2


def bumps(size, rms=2.0, seed=0):
    fx, fy = frequencies(size)
    return rms * noise(size, np.random.default_rng(seed), np.exp(-0.5 * (np.hypot(fx, fy) / 6.0) ** 2))


def material(height, diffuse=0.5, specular=0.04, alpha=0.3, normal=None, **fields):
    ones = np.ones((*height.shape, 3), np.float32)
    log = np.zeros_like(ones)
    log[..., :2] = 2.0 * np.log(alpha)
    if normal is None:
        normal = normals_from_gradient(height_gradient(height, "tile")).astype(np.float32)
    return Svbrdf(
        normal, log, ones * np.float32(specular), ones * np.float32(diffuse), height=height.astype(np.float32), **fields
    )


def hemisphere(rng, count, least=0.0):
    z = least + (1.0 - least) * rng.random(count)
    angle = 2.0 * np.pi * rng.random(count)
    across = np.sqrt(1.0 - z * z)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)


def toward(degrees, azimuth=0.0):
    a, b = np.radians(degrees), np.radians(azimuth)
    return np.array([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)])


def all_triangles(height, reach):
    """(T, 3, 3) corners of the mesh, repeated so far to every side."""
    rows, columns = height.shape
    j, i = np.mgrid[-reach : rows + reach, -reach : columns + reach]

    def at(j, i):
        return np.stack([i, j, height[j % rows, i % columns]], axis=-1).reshape(-1, 3)

    a, b, c, d = at(j, i), at(j, i + 1), at(j + 1, i), at(j + 1, i + 1)
    return np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, c, d], axis=1)]).astype(float)


def first_hit(triangles, origin, direction):
    """Moeller and Trumbore 1997, every triangle: distance of the first hit, or -1."""
    a, ab, ac = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(direction, ac)
    determinant = (ab * p).sum(axis=1)
    per = 1.0 / np.where(np.abs(determinant) < 1e-14, np.inf, determinant)
    s = origin - a
    u = (s * p).sum(axis=1) * per
    q = np.cross(s, ab)
    v = (q @ direction) * per
    t = (ac * q).sum(axis=1) * per
    inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9) & (t > 1e-9) & (determinant != 0.0)
    return t[inside].min() if inside.any() else -1.0


@pytest.mark.parametrize("shape", [(16, 16), (12, 7), (2, 5)])
def test_rays_meet_what_a_search_of_all_triangles_finds(shape):
    rng = np.random.default_rng(3)
    height = (rng.random(shape) * 3.0).astype(np.float32)
    maxima, levels = maximum_pyramid(height)
    reach = 34
    triangles = all_triangles(height, reach)
    count = 200
    origin = np.stack([rng.random(count) * shape[1], rng.random(count) * shape[0], np.full(count, 3.5)], axis=1)
    # The lowest go 32 texels far, down from the top or up to it.
    down, up = hemisphere(rng, count, 0.11) * [1, 1, -1], hemisphere(rng, count, 0.11)
    # Straight down, along an axis, and along the diagonal of the cells.
    down[0], down[1], down[2], down[3] = (0, 0, -1), (0.8, 0, -0.6), (0, -0.8, -0.6), (0.6, 0.6, -0.52915)
    up[0], up[1], up[2] = (0, 0, 1), (0.96, 0, 0.28), (0, -0.96, 0.28)
    found = np.empty((count, 5))
    meet_rows(height, maxima, levels, origin, down, found)
    expected = np.array([first_hit(triangles, o, d) for o, d in zip(origin, down, strict=True)])
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-6)
    # From where they met, on upwards: into light or shadow.
    start = origin + found[:, :1] * down + [0.0, 0.0, 1e-4]
    start[:, :2] %= shape[1], shape[0]
    meet_rows(height, maxima, levels, start, up, found)
    expected = np.array([first_hit(triangles, o, d) for o, d in zip(start, up, strict=True)])
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-6)
    assert 10 < (expected > 0).sum() < count - 10


def test_maxima_bound_every_block_of_sizes_that_are_no_power_of_two():
    height = np.random.default_rng(0).random((11, 6)).astype(np.float32)
    maxima, levels = maximum_pyramid(height)
    cells = maxima[: height.size].reshape(height.shape)
    for k, (begin, rows, columns) in enumerate(levels):
        for j in range(rows):
            for i in range(columns):
                block = cells[j << k : (j + 1) << k, i << k : (i + 1) << k]
                assert maxima[begin + j * columns + i] == block.max()
    assert maxima[-1] == height.max()


def test_a_flat_plane_is_exactly_the_brdf():
    rng = np.random.default_rng(1)
    flat = material(np.full((8, 8), 5.0), specular=0.3)
    for each in ("ggx", "beckmann"):
        traced = Microgeometry.of(flat.replace(model=each), Effects(bounces=3))
        assert any("the same everywhere" in note for note in traced.notes)
        light, view = hemisphere(rng, 500), hemisphere(rng, 500)
        texel = [np.repeat(array.reshape(-1, 3)[:1], 500, axis=0) for array in (
            flat.normal, tensor_from_log(flat.log_roughness), flat.specular, flat.diffuse)]  # fmt: skip
        expected = brdf(*texel, view, light, model=each)
        found = traced.reflect(rng.random((500, 2)) * 8, view, light, 0)
        np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-6)
        asked = traced.query(rng.random((500, 2)) * 8, np.full(500, 3.0), light, view, 0)
        np.testing.assert_allclose(asked, expected / light[:, 2:], rtol=2e-4, atol=1e-6)


def test_without_effects_it_is_the_brdf_of_the_maps():
    rng = np.random.default_rng(2)
    base = material(bumps(32), specular=0.2)
    at = rng.integers(0, 32, (400, 2))
    light, view = hemisphere(rng, 400), hemisphere(rng, 400)
    texel = [array[at[:, 1], at[:, 0]] for array in (
        base.normal, tensor_from_log(base.log_roughness), base.specular, base.diffuse)]  # fmt: skip
    facing = (texel[0] * view).sum(axis=1) > 1e-3
    found = Microgeometry.of(base, NO_EFFECTS).reflect(at + 0.5, view, light, 0)
    expected = brdf(*texel, view, light)
    np.testing.assert_allclose(found[facing], expected[facing], rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("view", [toward(0), toward(60, 30)])
def test_a_white_furnace_loses_no_energy(view):
    """Albedo 1 and light from everywhere: every point sends radiance 1 in every direction, between its hills too."""
    rng = np.random.default_rng(4)
    field = HeightField.of(material(bumps(32, 3.0), diffuse=1.0, specular=0.0), shading="geometry")
    count = 40000
    light, position = hemisphere(rng, count), rng.random((count, 2)) * 32
    radiance = {}
    for bounces in (0, 60):
        found = Microgeometry(field, Effects(bounces=bounces)).reflect(position, np.tile(view, (count, 1)), light, 5)
        per_sample = 2.0 * np.pi * found[:, 0].astype(float)
        radiance[bounces] = per_sample.mean()
        error = per_sample.std() / np.sqrt(count)
    assert abs(radiance[60] - 1.0) < SIGMAS * error
    assert radiance[0] < 0.9


def test_nothing_shines_more_than_it_is_lit():
    rng = np.random.default_rng(5)
    field = HeightField.of(material(bumps(32, 2.0), diffuse=1.0, specular=0.5, alpha=0.2), shading="geometry")
    count = 40000
    view = np.tile(toward(50, 10), (count, 1))
    found = Microgeometry(field, Effects(bounces=20)).reflect(
        rng.random((count, 2)) * 32, view, hemisphere(rng, count), 6
    )
    per_sample = 2.0 * np.pi * found[:, 0].astype(float)
    assert per_sample.mean() < 1.0 + SIGMAS * per_sample.std() / np.sqrt(count)


def test_shadow_of_a_step_is_as_long_as_geometry_says():
    height = np.zeros((4, 64), np.float32)
    height[:, :16] = 4.0
    flat = np.zeros((4, 64, 3), np.float32)
    flat[..., 2] = 1.0
    field = HeightField.of(material(height, diffuse=1.0, specular=0.0, normal=flat), shading="geometry")
    traced = Microgeometry(field, Effects(displacement=False))
    column = np.linspace(17.0, 63.0, 461)
    position = np.stack([column, np.full(461, 1.7)], axis=1)
    for degrees in (30.0, 60.0):
        # Light from the left, over the edge of the step at texel centre 15 (column 15.5).
        light = np.tile(toward(degrees, 180.0), (461, 1))
        found = traced.reflect(position, np.tile(toward(0), (461, 1)), light, 0)[:, 0]
        lit = np.cos(np.radians(degrees)) / np.pi
        end = 15.5 + 4.0 * np.tan(np.radians(degrees))
        sure = (np.abs(column - end) > 0.05) & (column < 62.4)
        np.testing.assert_allclose(found[sure], np.where(column > end, lit, 0.0)[sure], atol=1e-6)
    # From above the light's own side nothing is hidden; y is up, so rows of a wall above shade those below.
    turned = Microgeometry(HeightField.of(material(np.ascontiguousarray(height.T), 1.0, 0.0)), traced.effects)
    position = np.stack([np.full(20, 1.7), np.linspace(17.0, 36.0, 20)], axis=1)
    sideways = np.tile(toward(0), (20, 1))
    above = turned.reflect(position, sideways, np.tile(toward(80.0, 90.0), (20, 1)), 0)
    below = turned.reflect(position, sideways, np.tile(toward(80.0, -90.0), (20, 1)), 0)
    assert np.all(above[2:] == 0.0) and np.all(below[2:] > 0.0)


def test_a_light_of_a_size_has_a_penumbra_and_the_same_mean():
    height = np.zeros((2, 64), np.float32)
    height[:, :16] = 4.0
    field = HeightField.of(material(height, diffuse=1.0, specular=0.0), shading="geometry")
    count = 4000
    position = np.tile([15.5 + 4.0, 0.9], (count, 1))
    light, view = np.tile(toward(45, 180), (count, 1)), np.tile(toward(0), (count, 1))
    found = Microgeometry(field, Effects(displacement=False), light_size=10.0).reflect(position, view, light, 0)[:, 0]
    # The edge of the shadow sees half of the disc.
    assert 0.4 < (found > 0.0).mean() < 0.6
    far = Microgeometry(field, Effects(displacement=False), light_size=10.0).reflect(position + [20, 0], view, light, 0)
    expected = np.cos(np.radians(45)) / np.pi * 0.5 * (1.0 + np.cos(np.radians(5)))
    assert abs(far[:, 0].mean() - expected) < SIGMAS * far[:, 0].std() / np.sqrt(count)


def test_parallax_moves_a_stripe_by_its_height_over_the_slope_of_the_view():
    """A stripe of colour on a plateau, seen at 45 degrees: it appears as far off as it is above the mean height."""
    height = np.zeros((2, 64), np.float32)
    height[:, 20:44] = 6.0
    base = material(height, specular=0.0)
    base.diffuse[:] = 0.0
    base.diffuse[:, 30] = 1.0
    traced = Microgeometry.of(base, Effects(shadowing=False))
    column = np.linspace(0, 64, 641)
    position = np.stack([column, np.full(641, 1.0)], axis=1)
    up = np.tile(toward(0), (641, 1))
    for azimuth, sign in ((0.0, 1.0), (180.0, -1.0)):
        found = traced.reflect(position, np.tile(toward(45, azimuth), (641, 1)), up, 0)[:, 0]
        centre = (found * column).sum() / found.sum()
        # A viewer to the right: the ray to a point above the plane crosses the plane left of it.
        assert abs(centre - (30.5 - sign * (6.0 - height.mean()))) < 1e-3


def test_parallax_is_the_way_to_the_point_that_is_seen():
    """Without shadows, what is seen at a point of the plane is what maps have where the parallax leads to."""
    source = material(np.hstack([bumps(32, 1.5)] * 2), diffuse=0.2)
    rng = np.random.default_rng(12)
    position, view = rng.uniform(0, 40, (400, 2)), hemisphere(rng, 400, 0.3)
    shown = Microgeometry.of(source, Effects(True, False, 0))
    moved = position + shown.parallax(position, view)
    assert np.abs(moved - position).max() > 1.0
    flat = Microgeometry.of(source, NO_EFFECTS)
    light = np.tile(toward(10, 20), (400, 1))
    np.testing.assert_allclose(
        shown.reflect(position, view, light, 1), flat.reflect(moved, view, light, 1), rtol=1e-4, atol=1e-6
    )


def test_it_repeats_and_does_not_depend_on_the_number_of_threads():
    rng = np.random.default_rng(7)
    base = material(bumps(24))
    count = 20000
    position = rng.random((count, 2)) * 24
    light, view, sigma = hemisphere(rng, count), hemisphere(rng, count, 0.1), rng.random(count) * 4
    effects = Effects(bounces=2)
    results = [
        Microgeometry.of(base, effects, light_size=2.0, threads=n).query(position, sigma, light, view, 11)
        for n in (1, 2, 3)
    ]
    assert np.array_equal(results[0], results[1]) and np.array_equal(results[0], results[2])
    other = Microgeometry.of(base, effects, light_size=2.0).query(position, sigma, light, view, 12)
    assert not np.array_equal(results[0], other)
    direct = Microgeometry.of(base)
    again = direct.reflect(position + [24 * 5, -24 * 3], view, light, 11)
    np.testing.assert_allclose(again, direct.reflect(position, view, light, 11), atol=1e-5)


def test_it_is_reciprocal_in_the_mean():
    """Averaged over the plane, with bounces: M(l, v) = M(v, l), by Helmholtz."""
    rng = np.random.default_rng(8)
    field = HeightField.of(material(bumps(32, 3.0), diffuse=0.8, specular=0.1), shading="geometry")
    traced = Microgeometry(field, Effects(bounces=4))
    count = 60000
    position, sigma = rng.random((count, 2)) * 32, np.zeros(count)
    a, b = np.tile(toward(65, 20), (count, 1)), np.tile(toward(25, 200), (count, 1))
    there, back = traced.query(position, sigma, a, b, 1)[:, 0], traced.query(position, sigma, b, a, 2)[:, 0]
    error = np.hypot(there.std(), back.std()) / np.sqrt(count)
    assert abs(there.mean() - back.mean()) < SIGMAS * error


def test_a_footprint_is_a_gaussian():
    """A linear ramp of colour has its own value in the mean; its variance is that of the Gaussian."""
    base = material(np.zeros((64, 64)), specular=0.0)
    base.diffuse[:] = np.linspace(0, 1, 64, dtype=np.float32)[None, :, None]
    count = 20000
    up = np.tile(toward(0), (count, 1))
    found = Microgeometry.of(base).query(np.full((count, 2), 32.0), np.full(count, 4.0), up, up, 3)[:, 0] * np.pi * 63
    assert abs(found.mean() - 31.5) < SIGMAS * 4.0 / np.sqrt(count)
    assert abs(found.std() - 4.0) < SIGMAS * 4.0 / np.sqrt(2 * count)


def test_a_normal_map_that_repeats_the_height_is_the_normal_and_another_one_stands_on_it():
    height, detail = bumps(32), bumps(32, 0.5, seed=9)
    own = material(height)
    assert np.array_equal(HeightField.of(own).packed.texels[:, :3], own.normal.reshape(-1, 3))
    doubled = HeightField.of(own, amplitude=2.0)
    expected = normals_from_gradient(2.0 * height_gradient(height, "tile")).reshape(-1, 3)
    np.testing.assert_allclose(doubled.packed.texels[:, :3], expected, atol=1e-5)
    assert doubled.span == pytest.approx(2.0 * np.ptp(height), rel=1e-5)
    other = HeightField.of(
        material(height, normal=normals_from_gradient(height_gradient(detail, "tile")).astype(np.float32))
    )
    expected = normals_from_gradient(height_gradient(height + detail, "tile")).reshape(-1, 3)
    np.testing.assert_allclose(other.packed.texels[:, :3], expected, atol=1e-5)
    assert any("slopes add" in note for note in other.notes)


def test_what_cannot_be_traced_is_refused_in_a_sentence(monkeypatch):
    base = material(bumps(16))
    with pytest.raises(InputError, match="needs a height map"):
        HeightField.of(base.replace(height=None))
    with pytest.raises(InputError, match="not finite"):
        HeightField.of(base, amplitude=float("nan"))
    monkeypatch.setattr("brdffit.microgeometry.heightfield.free_memory", lambda: 1000)
    with pytest.raises(InputError, match="needs about .* GiB of memory"):
        HeightField.of(base)
    # Where the system does not tell how much is free, nothing is refused.
    monkeypatch.setattr("brdffit.microgeometry.heightfield.free_memory", lambda: None)
    assert HeightField.of(base).height.shape == (16, 16)


def test_measured_queries_are_read_as_written_and_others_refused(tmp_path):
    rng = np.random.default_rng(0)
    light, view = hemisphere(rng, 9), hemisphere(rng, 9)
    queries = Queries(rng.random((9, 2)), rng.random(9), light, view, rng.random((9, 3)), (4, 8))
    write_queries(tmp_path / "good.npz", queries)
    found = read_queries(tmp_path / "good.npz")
    assert found.size == (4, 8)
    for one, other in zip(found[:5], queries[:5], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)
    for changes, word in (
        ({"view": -view}, "below the plane"),
        ({"value": rng.random((9, 1))}, r"expected \(9, 3\)"),
        ({"sigma": np.full(9, np.nan)}, "no finite number"),
        ({"size": np.array([4.5, 8.0])}, "height and width"),
    ):
        write_queries(tmp_path / "bad.npz", queries._replace(**changes))
        with pytest.raises(InputError, match=word):
            read_queries(tmp_path / "bad.npz")
    (tmp_path / "bad.npz").write_bytes(b"PK no archive")
    with pytest.raises(InputError, match="holds no queries"):
        read_queries(tmp_path / "bad.npz")


@pytest.mark.slow
def test_the_tracer_comes_from_the_disk_in_a_second_process():
    """It is compiled for kernels as values: for the kernels themselves each process would compile it anew."""
    code = "from brdffit.microgeometry import tracer\nprint(sum(tracer.reflect_loop().stats.cache_misses.values()))"
    command = [sys.executable, "-c", code]
    for _ in range(2):
        found = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parent.parent)
    assert found.stdout.strip() == "0"
