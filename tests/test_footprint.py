"""Laws of the pixel filter: unit integral, partition of unity, unions of footprints, symmetries; and a slow oracle."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad

from brdffit.errors import UnknownNameError
from brdffit.footprint import PIXEL_FILTERS, axis_matrix, filter_channels, filter_pyramid, get_pixel_filter
from brdffit.svbrdf import level_sizes

#: Sums in single precision of some tens of terms.
SINGLE = 2e-6

filters = pytest.mark.parametrize("name", PIXEL_FILTERS)
wraps = pytest.mark.parametrize("wrap", ["tile", "clamp"])
SIZES = [(1, 1), (2, 1), (5, 5), (5, 2), (7, 3), (16, 4), (37, 37), (37, 18), (64, 1), (100, 12)]


def random_image(height, width, channels=2, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (height, width, channels)).astype(np.float32)


@filters
def test_profile_is_even_and_integrates_to_one_over_its_support(name):
    pixel_filter = get_pixel_filter(name)
    kinks = pixel_filter.kinks
    integral = sum(quad(lambda x: float(pixel_filter.weight(x)), a, b, epsabs=1e-13)[0] for a, b in pairwise(kinks))
    assert integral == pytest.approx(1, abs=1e-12)
    x = np.linspace(0, 3, 200)
    np.testing.assert_array_equal(pixel_filter.weight(x), pixel_filter.weight(-x))
    assert not pixel_filter.weight(np.array([pixel_filter.radius + 1e-9, 5.0])).any()


def test_mitchell_is_smooth_and_negative_in_its_rim():
    weight = get_pixel_filter("mitchell").weight
    for joint in (1.0, 2.0):
        assert weight(joint - 1e-7) == pytest.approx(float(weight(joint + 1e-7)), abs=1e-6)
    assert weight(0.0) == pytest.approx(8 / 9) and weight(1.5) < 0


def test_unknown_filter_names_the_nearest():
    with pytest.raises(UnknownNameError, match="did you mean 'gaussian'"):
        get_pixel_filter("gausian")


@filters
@wraps
@pytest.mark.parametrize("base, level", SIZES)
def test_rows_sum_to_one(name, wrap, base, level):
    matrix = axis_matrix(get_pixel_filter(name), base, level, wrap)
    assert matrix.shape == (level, base)
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-14)


def test_box_at_level_0_is_the_tent_over_one_texel():
    row = axis_matrix(get_pixel_filter("box"), 8, 8, "tile").toarray()[3]
    np.testing.assert_allclose(row, [0, 0, 1 / 8, 3 / 4, 1 / 8, 0, 0, 0], atol=1e-15)


@filters
@wraps
@pytest.mark.parametrize("base, level", [(5, 5), (5, 2), (7, 3), (12, 3), (9, 1)])
def test_weights_are_the_integral_of_filter_times_bilinear_base(name, wrap, base, level):
    """Oracle: adaptive quadrature over the base as a renderer interpolates it, extended by its wrap mode."""
    pixel_filter = get_pixel_filter(name)
    texels = random_image(1, base, 1)[0, :, 0].astype(np.float64)
    index = np.arange(-6 * base, 7 * base)
    extended = texels[index % base if wrap == "tile" else np.clip(index, 0, base - 1)]
    scale = base / level
    matrix = axis_matrix(pixel_filter, base, level, wrap).toarray()
    for x in (0, level // 2, level - 1):
        centre = (x + 0.5) * scale
        breaks = np.union1d(index + 0.5, centre + scale * np.array(pixel_filter.kinks))
        breaks = breaks[np.abs(breaks - centre) <= pixel_filter.radius * scale + 1e-12]

        def integrand(t, centre=centre):
            return float(pixel_filter.weight((t - centre) / scale)) * np.interp(t, index + 0.5, extended)

        value = sum(quad(integrand, a, b, epsabs=1e-12)[0] for a, b in pairwise(breaks))
        assert matrix[x] @ texels == pytest.approx(value / scale, abs=1e-10)


@filters
@wraps
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (6, 1), (5, 7), (16, 8), (40, 33), (64, 64)])
def test_channels_are_filtered_by_the_axis_matrices(name, wrap, shape):
    """Blocks, stencils and precisions are only ways to compute A_y image A_x'."""
    pixel_filter, image = get_pixel_filter(name), random_image(*shape)
    for size in level_sizes(shape):
        down = axis_matrix(pixel_filter, shape[0], size[0], wrap).toarray()
        across = axis_matrix(pixel_filter, shape[1], size[1], wrap).toarray()
        expected = np.einsum("yi,xj,ijc->yxc", down, across, image)
        result = filter_channels(image, size, pixel_filter, wrap)
        assert result.dtype == np.float32
        np.testing.assert_allclose(result, expected, atol=SINGLE)


@filters
@wraps
@pytest.mark.parametrize("shape", [(16, 8), (1, 8), (13, 6), (100, 12), (32, 32)])
def test_pyramid_equals_filtering_every_level_from_the_base(name, wrap, shape):
    """For the box: the footprint of level k+1 is the union of footprints of level k."""
    pixel_filter, image, sizes = get_pixel_filter(name), random_image(*shape, seed=1), level_sizes(shape)
    for size, level in zip(sizes, filter_pyramid(image, sizes, pixel_filter, wrap), strict=True):
        np.testing.assert_allclose(level, filter_channels(image, size, pixel_filter, wrap), atol=SINGLE)


@filters
@wraps
def test_constants_stay_to_the_last_digits_however_large_the_footprint(name, wrap):
    image = np.full((3, 3000, 1), 0.7, dtype=np.float32)
    for level in filter_pyramid(image, level_sizes((3, 3000)), get_pixel_filter(name), wrap):
        np.testing.assert_allclose(level, np.float32(0.7), rtol=1e-6)


@filters
@wraps
def test_mirroring_and_transposing_commute_with_filtering(name, wrap):
    pixel_filter, image = get_pixel_filter(name), random_image(12, 20, seed=2)
    level = filter_channels(image, (5, 10), pixel_filter, wrap)
    np.testing.assert_allclose(
        filter_channels(image[:, ::-1], (5, 10), pixel_filter, wrap), level[:, ::-1], atol=SINGLE
    )
    transposed = filter_channels(image.transpose(1, 0, 2), (10, 5), pixel_filter, wrap)
    np.testing.assert_allclose(transposed, level.transpose(1, 0, 2), atol=SINGLE)


@filters
def test_tiled_texture_may_be_rolled_by_whole_pixels(name):
    pixel_filter, image = get_pixel_filter(name), random_image(24, 24, seed=3)
    level = filter_channels(image, (8, 8), pixel_filter, "tile")
    rolled = filter_channels(np.roll(image, (3, 6), axis=(0, 1)), (8, 8), pixel_filter, "tile")
    np.testing.assert_allclose(rolled, np.roll(level, (1, 2), axis=(0, 1)), atol=SINGLE)


@filters
def test_clamped_ramp_stays_a_ramp_in_the_middle(name):
    """Filter and tent are symmetric: a linear function passes unchanged where the border does not reach."""
    ramp = np.tile(np.arange(64, dtype=np.float32)[None, :, None], (4, 1, 1))
    level = filter_channels(ramp, (4, 16), get_pixel_filter(name), "clamp")[0, 3:-3, 0]
    np.testing.assert_allclose(level, (np.arange(16)[3:-3] + 0.5) * 4 - 0.5, rtol=SINGLE)
