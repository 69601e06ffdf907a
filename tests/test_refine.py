"""Refinement for interpolation: its gradient, that its error only falls, and what a renderer makes of it."""

import dataclasses

import numpy as np
import pytest

from brdffit.fitting.batch import model_kernels
from brdffit.fitting.interpolation import PARAMETERS
from brdffit.fitting.method import NonlinearFit, search_settings
from brdffit.fitting.options import FitOptions
from brdffit.fitting.presets import get_quality
from brdffit.fitting.refine import _Texels, refine_level
from brdffit.fitting.rules import level_rules
from brdffit.fitting.tiles import coloured_tiles, sample_points
from brdffit.footprint import get_pixel_filter
from brdffit.halfangle.apparent_lobe import base_of
from brdffit.halfangle.measure import snr
from brdffit.halfangle.quadrature import lattice
from brdffit.models import get_model
from brdffit.render import scenes
from brdffit.render.lights import many
from brdffit.render.metrics import snr_db_of_halves
from brdffit.render.pictures import render_appearance
from brdffit.render.reference import render_halves
from brdffit.svbrdf import Svbrdf

SIZE = (32, 32)
OPTIONS = FitOptions(lights="point", levels=3, quality="draft", threads=1)

#: Central differences of a sum over some hundred points, each in float32.
GRADIENT = 2e-3
#: What the bumpy base below gains at least at its sample points, in dB (held normals leave the least to gain).
GAIN = 0.1
#: What sampling of the reference leaves open in a rendered SNR, in dB.
RENDERED = 0.1


def bumpy(spread=0.12, roughness=0.35, size=SIZE, wrap="tile", seed=5):
    """Smooth bumps of this spread of slopes, from one to four texels wide, with colours that follow the slope."""
    random = np.random.default_rng(seed)
    frequency = np.hypot(*np.meshgrid(*[np.fft.fftfreq(n) for n in size], indexing="ij"))
    spectrum = np.fft.fft2(random.normal(size=(2, *size))) * np.exp(-8.0 * frequency)
    slopes = np.moveaxis(np.fft.ifft2(spectrum).real, 0, 2)
    slopes = spread * slopes / max(slopes.std(), 1e-9)
    normal = np.concatenate([-slopes, np.ones((*size, 1))], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    log_roughness = np.zeros((*size, 3), np.float32)
    log_roughness[..., :2] = 4.0 * np.log(roughness)
    specular = (0.5 + 0.3 * np.tanh(8.0 * slopes[..., :1]) * (1.0, 0.0, -1.0)).astype(np.float32)
    return Svbrdf(normal.astype(np.float32), log_roughness, specular, np.zeros_like(specular), wrap=wrap)


def setting(base, options=OPTIONS, mip_level=1, coarser=None):
    """(packed base, points, rule, search, kernels) of a level, as a bake has them."""
    source, target = get_model(base.model), get_model(options.model)
    quality, packed = get_quality(options.quality), base_of(base, source.default_shape)
    sizes = [(base.size[0] >> k, base.size[1] >> k) for k in (mip_level, mip_level + 1)]
    rules = [
        level_rules(get_pixel_filter(options.pixel_filter), base.size, size, mip_level + k, quality)
        for k, size in enumerate(sizes)
    ]
    points = sample_points(rules[0], sizes[0], rules[1], coarser)
    kernels = model_kernels(source.name, target.name)
    return packed, points, lattice(64), search_settings(options, quality, packed, source, target), kernels


@pytest.fixture(scope="module")
def base():
    return bumpy()


@pytest.fixture(scope="module")
def pyramid(base):
    return NonlinearFit().bake_lobes(base, OPTIONS)


@pytest.fixture(scope="module")
def refined(base):
    return NonlinearFit().bake_lobes(base, dataclasses.replace(OPTIONS, refine=True))


@pytest.mark.parametrize("model", ["ggx", "beckmann"])
@pytest.mark.parametrize("spread", [0.05, 1.0])
def test_gradient_is_that_of_the_error(model, spread):
    """Also where lobes are eccentric, lean far over and meet their horizon, and roughness is outside its bounds."""
    base = bumpy(size=(16, 16), spread=0.05)
    options = dataclasses.replace(OPTIONS, model=model, min_roughness=0.3)
    levels = [level.svbrdf for level in NonlinearFit().bake_lobes(base, options).levels]
    packed, points, rule, search, kernels = setting(base, options, coarser=levels[2])
    block = _Texels(levels[1], packed, points, rule, search, kernels).block((range(2, 6), range(0, 5)))
    random = np.random.default_rng(1)
    theta = block.held[block.core] + spread * random.normal(size=(len(block.core), PARAMETERS)) * ([0.3] * 2 + [1] * 6)
    _, gradient = block.value(theta)
    size = np.abs(gradient).max(axis=0)
    for _ in range(12):
        direction = random.normal(size=theta.shape) / (1e-6 + size)
        step = 1e-3 / np.abs(direction).max()
        slope = (block.value(theta + step * direction)[0] - block.value(theta - step * direction)[0]) / (2.0 * step)
        scale = np.linalg.norm(gradient * direction)
        assert abs(slope - np.sum(gradient * direction)) < GRADIENT * scale


@pytest.mark.parametrize("wraps", [True, False])
@pytest.mark.parametrize("size", [(1, 1), (3, 70), (48, 48), (33, 80)])
def test_tiles_cover_a_level_once_and_those_of_a_colour_share_no_point(size, wraps):
    seen = np.zeros(size, int)
    for tiles in coloured_tiles(size, wraps):
        touched = np.zeros((2 * size[0], 2 * size[1]), int)
        for rows, columns in tiles:
            seen[rows.start : rows.stop, columns.start : columns.stop] += 1
            y, x = (np.arange(2 * part.start - 1, 2 * part.stop) for part in (rows, columns))
            if wraps:
                y, x = np.unique(y % (2 * size[0])), np.unique(x % (2 * size[1]))
            touched[np.ix_(y[y >= 0], x[x >= 0])] += 1
        assert touched.max() <= 1
    assert np.all(seen == 1)


@pytest.mark.parametrize("wrap", ["tile", "clamp"])
def test_even_points_are_texel_centres_and_what_is_exact_there_stays(wrap):
    """A base of one lobe: every level is exact everywhere, and comes back bit by bit."""
    base = bumpy(spread=0.0, size=(16, 16), wrap=wrap)
    plain = NonlinearFit().bake_lobes(base, OPTIONS)
    refined = NonlinearFit().bake_lobes(base, dataclasses.replace(OPTIONS, refine=True))
    for one, other in zip(plain.levels, refined.levels, strict=True):
        for name, array in one.svbrdf.arrays().items():
            assert np.array_equal(array, other.svbrdf.arrays()[name]), name


@pytest.mark.parametrize("wrap", ["tile", "clamp"])
@pytest.mark.parametrize("fit", [{}, {"lobe": "isotropic", "specular": "held"}, {"normal": "mean"}])
def test_error_falls_at_the_points_and_what_is_held_stays(fit, wrap):
    base = bumpy(size=(32, 24), wrap=wrap)
    options = dataclasses.replace(OPTIONS, **fit)
    level = NonlinearFit().bake_lobes(base, options).levels[1].svbrdf
    found = refine_level(level, *setting(base, options), threads=1)
    assert snr(found.after) > snr(found.before) + GAIN
    assert found.svbrdf.is_finite()
    np.testing.assert_allclose(np.linalg.norm(found.svbrdf.normal, axis=2), 1.0, atol=1e-6)
    assert found.svbrdf.specular.min() >= 0.0
    if "lobe" in fit:
        a, b, c = np.moveaxis(found.svbrdf.log_roughness, 2, 0)
        assert np.array_equal(a, b) and not c.any()
        assert np.array_equal(found.svbrdf.specular, level.specular)
    if "normal" in fit:
        np.testing.assert_allclose(found.svbrdf.normal, level.normal, atol=1e-6)


def test_what_is_reported_is_the_error_of_what_is_returned(base, pyramid):
    """The bookkeeping over tiles against one evaluation of the whole level, before and after."""
    given = setting(base, coarser=pyramid[2].svbrdf)
    level = pyramid[1].svbrdf
    found = refine_level(level, *given, threads=2)
    for svbrdf, told in ((level, found.before), (found.svbrdf, found.after)):
        whole = _Texels(svbrdf, *given).block((range(16), range(16)))
        # Slopes go through the stored unit normals: float32.
        assert whole.total(whole.held) == pytest.approx(told.sum(), rel=1e-4)


def test_a_level_worse_than_nothing_is_taken_to_bounds_and_stays_finite():
    """Mirrors on steep slopes beside black texels, levels that a search would leave: finite, bounded, never worse."""
    base = bumpy(spread=1.5, roughness=0.05, size=(16, 16))
    base.specular[::3] = 0.0
    level = NonlinearFit().bake_lobes(base, OPTIONS).levels[1].svbrdf
    level.log_roughness[::2] = (0.0, -12.0, 0.0)
    packed, points, rule, search, kernels = setting(base)
    found = refine_level(level, packed, points, rule, search, kernels, threads=1)
    assert found.svbrdf.is_finite() and found.after.sum() <= found.before.sum()
    moved = np.any(found.svbrdf.log_roughness != level.log_roughness, axis=2)
    eigenvalues = np.linalg.eigvalsh(found.svbrdf.log_roughness[..., [[0, 2], [2, 1]]].astype(np.float64))[moved]
    assert moved.any()
    assert eigenvalues.min() > search.log_low - 1e-4 and eigenvalues.max() < search.log_high + 1e-4


def test_threads_change_nothing(base, refined):
    other = NonlinearFit().bake_lobes(base, dataclasses.replace(OPTIONS, refine=True, threads=2))
    for one, two in zip(refined.levels, other.levels, strict=True):
        for name, array in one.svbrdf.arrays().items():
            assert np.array_equal(array, two.svbrdf.arrays()[name]), name


def test_it_is_off_unless_asked_for_and_says_what_it_did(pyramid, refined):
    assert not FitOptions(lights="point").refine
    assert not [note for note in pyramid.notes if "interpolates" in note]
    assert [note for note in refined.notes if "interpolates" in note]
    assert not np.array_equal(pyramid[1].svbrdf.normal, refined[1].svbrdf.normal)


def test_kept_level_stays_as_authored(base):
    options = dataclasses.replace(OPTIONS, refine=True, keep_level_0=True)
    assert np.array_equal(NonlinearFit().bake_lobes(base, options)[0].svbrdf.normal, base.normal)


@pytest.mark.parametrize("level", [1, 1.5])
def test_rendered_pictures_gain_between_texels(base, pyramid, refined, level):
    """By the renderer, which knows nothing of half-angle integrals: what lies between texels gains."""
    gains = []
    for shift in ((0.0, 0.0), (0.25, 0.25), (0.5, 0.5)):
        scene = scenes.plane(SIZE, level, (16, 16), shift=shift)
        halves = render_halves(base, scene, many(24), samples=1024, threads=1).halves
        before, after = (
            snr_db_of_halves(render_appearance(which, scene, many(24)), halves) for which in (pyramid, refined)
        )
        gains.append(after - before)
    assert gains[2] > -RENDERED and np.mean(gains[1:]) > 0.0
