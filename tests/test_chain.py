"""Footprints that are merged from those of the level before: what they keep, and that a bake and a sample agree."""

import numpy as np
import pytest

from brdffit.fitting.chain import Chain, first_of_chain, footprints_of, parts_of, unions
from brdffit.fitting.method import NonlinearFit
from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample
from brdffit.fitting.status import NO_SPECULAR
from brdffit.footprint import filter_channels, get_pixel_filter
from brdffit.halfangle.apparent_lobe import DIFFUSE_MOMENT
from brdffit.halfangle.footprints import AVERAGE, COLOUR, STORED, Footprints, thin
from brdffit.halfangle.quadrature import LOBE_COLUMNS, MIXTURE, SPECULAR
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf, level_sizes

MOST = 1 << 16


def rough(size, seed=0, spread=0.3, black=None):
    """Independent normals, roughness and colours; nothing is reflected where ``black``."""
    random = np.random.default_rng(seed)
    normal = np.dstack([*(spread * random.standard_normal((2, *size))), np.ones(size)])
    perceptual = random.uniform(0.2, 0.8, size)
    specular = random.uniform(0.1, 1.0, (*size, 3))
    if black is not None:
        specular[black] = 0.0
    return Svbrdf(
        normal=(normal / np.linalg.norm(normal, axis=2, keepdims=True)).astype(np.float32),
        log_roughness=log_tensor_from_perceptual(perceptual.astype(np.float32)),
        specular=specular.astype(np.float32),
        diffuse=random.uniform(0.0, 0.5, (*size, 3)).astype(np.float32),
        model="ggx",
    )


def every_texel(size):
    rows, columns = np.indices(size).reshape(2, -1)
    return columns, rows


def chain_of(svbrdf, level, quality="standard"):
    """(sample of the whole level, its chain without a bound of the lobes, the search)."""
    sample = LevelSample(svbrdf, level, *every_texel(level_sizes(svbrdf.size)[level]), FitOptions(quality=quality))
    rules, search = sample.settings()
    return sample, rules.chain._replace(most=(MOST,) * len(rules.chain.sizes)), search


def footprints(svbrdf, level, quality="standard"):
    sample, chain, search = chain_of(svbrdf, level, quality)
    return footprints_of(sample.base, chain, search.step, search.cell, sample.columns, sample.rows), sample


def of(found: Footprints, i: int):
    """The stored lobes of one footprint."""
    return found.lobes[found.first[i] : found.first[i + 1]].astype(np.float64)


@pytest.mark.parametrize("size", [(32, 32), (32, 16), (24, 40)])
def test_a_chain_begins_where_sides_do_not_divide(size):
    sizes = level_sizes(size)
    for level in range(2, len(sizes)):
        first = first_of_chain(sizes, level)
        assert 2 <= first <= level
        assert all(f % c == 0 for k in range(first + 1, level + 1) for f, c in zip(sizes[k - 1], sizes[k], strict=True))
        assert first == 2 or any(f % c for f, c in zip(sizes[first - 1], sizes[first], strict=True))
    assert first_of_chain(sizes, 1) is None


@pytest.mark.parametrize(("size", "level"), [((32, 32), 2), ((32, 32), 4), ((64, 8), 5)])
def test_colours_are_those_of_the_exact_filter(size, level):
    base = rough(size)
    found, sample = footprints(base, level)
    # Bumps count with Fresnel's share of their diffuse light, which is 1 where none is tilted.
    upright, _ = footprints(base.replace(normal=np.zeros_like(base.normal) + np.float32([0.0, 0.0, 1.0])), level)
    assert (found.sums[:, 9:DIFFUSE_MOMENT] <= upright.sums[:, 9:DIFFUSE_MOMENT]).all()
    for image, have in (
        (base.specular, found.sums[:, COLOUR:AVERAGE]),
        (base.diffuse, upright.sums[:, 9:DIFFUSE_MOMENT]),
    ):
        exact = filter_channels(image, sample.size, get_pixel_filter("box"), "tile").reshape(-1, 3)
        assert have == pytest.approx(exact, rel=2e-5)
    lobes = np.add.reduceat(found.lobes[:, 5:8], found.first[:-1])
    assert lobes == pytest.approx(found.sums[:, COLOUR:AVERAGE], rel=1e-5)
    assert np.add.reduceat(found.lobes[:, 8], found.first[:-1]) == pytest.approx(1.0, abs=1e-5)


def test_a_union_keeps_the_moments_of_its_parts():
    """Mean normal, mean alpha^2 and E[slope slope'] + C of a union are the means of its parts, by energy."""
    base = rough((16, 16), spread=0.02)
    sample, chain, search = chain_of(base, 3)
    parts = parts_of(sample.base, chain, search.step, search.cell, sample.columns, sample.rows)
    found = unions(parts, chain, search.cell)
    assert np.diff(found.first).mean() < 3 * np.diff(parts.first).mean(), (
        "some cells must be shared, or nothing is tested"
    )
    energy = parts.sums[:, COLOUR:AVERAGE].sum(axis=1)

    def moments(lobes):
        """Of slopes: mean (2), covariance and second moments (3); normals are nearly vertical here."""
        w, s = lobes[:, 8], lobes[:, 0:2] / lobes[:, 2:3]
        second = [s[:, 0] ** 2, s[:, 1] ** 2, s[:, 0] * s[:, 1]]
        return np.array(
            [*(w @ s), *(w @ (a + 0.5 * b) for a, b in zip(second, lobes[:, 9:12].T, strict=True)), w @ lobes[:, 3]]
        )

    for i in range(len(found)):
        own = range(4 * i, 4 * i + 4)
        share = energy[own] / energy[own].sum()
        mean = share @ [moments(of(parts, j)) for j in own]
        have = moments(of(found, i))
        assert have[:2] == pytest.approx(mean[:2], abs=2e-6)
        assert have[2:5] == pytest.approx(mean[2:5], abs=0.01 * (mean[2] + mean[3]))
        assert have[5] == pytest.approx(mean[5], rel=1e-6)


def test_no_cell_is_wider_than_the_samples_of_one_footprint_make_it():
    """Merging unions again widens no cell beyond the grid: twice the covariance of a uniform square is 1/6."""
    base = rough((64, 64), spread=0.3)
    for level in (3, 5):
        found, sample = footprints(base, level)
        light = sample.settings()[0].strata.light
        wide = found.lobes[:, 9:11] / (found.lobes[:, 3:4] + light)
        # A step of the roughness is a factor of 1.5; a mean beyond its cell's border may widen its neighbour's cell.
        assert np.quantile(wide, 0.99) < 1.0


@pytest.mark.parametrize("size", [(32, 32), (40, 24)])
@pytest.mark.parametrize("threads", [1, 3])
def test_a_bake_and_a_sample_agree(size, threads):
    base = rough(size, spread=0.1)
    baked = NonlinearFit().bake_lobes(base, FitOptions(threads=threads))
    for level in range(1, len(baked)):
        columns, rows = every_texel(baked[level].svbrdf.size)
        some = np.random.default_rng(level).permutation(len(columns))[:7]
        (theta, scale), _ = LevelSample(base, level, columns[some], rows[some], threads=2).fit()
        own = baked[level].svbrdf
        assert np.array_equal(theta[:, 2:5].astype(np.float32), own.log_roughness[rows[some], columns[some]])
        assert np.array_equal(scale.astype(np.float32), own.specular[rows[some], columns[some]])


def test_levels_of_a_reach_are_those_of_the_whole():
    base = rough((32, 32), spread=0.1)
    whole = NonlinearFit().bake_lobes(base, FitOptions())
    some = NonlinearFit().bake_lobes(base, FitOptions(reach=(3, 4)))
    for level in (3, 4):
        assert np.array_equal(some[level].svbrdf.log_roughness, whole[level].svbrdf.log_roughness)


def test_what_reflects_nothing_has_no_share():
    black = np.zeros((32, 32), bool)
    black[:16], black[:8, :16] = True, True
    base = rough((32, 32), black=black)
    found, _ = footprints(base, 4)
    lit, _ = footprints(rough((32, 32)), 4)
    # The lower half reflects all; its own footprints are those of a base without black texels, but for the border.
    assert (found.sums[:2, COLOUR:AVERAGE] < 0.1 * lit.sums[:2, COLOUR:AVERAGE]).all()
    baked = NonlinearFit().bake_lobes(rough((32, 32), black=np.ones((32, 32), bool)), FitOptions())
    assert all((level.status == NO_SPECULAR).all() for level in baked.levels[1:])
    assert all(level.svbrdf.is_finite() and not level.svbrdf.specular.any() for level in baked.levels)


def test_thinning_keeps_energy_and_the_mean():
    random = np.random.default_rng(0)
    lobes = np.zeros((5000, LOBE_COLUMNS))
    share = random.exponential(1.0, 5000)
    share[17] = 400.0
    lobes[:, MIXTURE] = share / share.sum()
    lobes[:, 0] = np.cumsum(lobes[:, MIXTURE])
    lobes[:, SPECULAR : SPECULAR + 3] = lobes[:, MIXTURE, None] * np.array([0.5, 1.0, 2.0])
    mean = lobes[:, MIXTURE] @ lobes[:, 0]
    kept = thin(lobes, 5000, 128)
    assert 100 < kept <= 128
    assert lobes[:kept, MIXTURE].sum() == pytest.approx(1.0)
    assert lobes[:kept, SPECULAR : SPECULAR + 3].sum(axis=0) == pytest.approx([0.5, 1.0, 2.0])
    # Equal steps along the mixture: the mean of what grows along it is off by less than one step.
    assert lobes[:kept, MIXTURE] @ lobes[:kept, 0] == pytest.approx(mean, abs=1.0 / 128)
    assert thin(lobes, 10, 10) == 10


def test_the_room_of_a_chain_bounds_what_is_stored():
    base = rough((64, 64), spread=0.4)
    sample, chain, search = chain_of(base, 4)
    bounded = Chain(chain.strata, chain.room, chain.sizes, (50, 40, 30))
    found = footprints_of(sample.base, bounded, search.step, search.cell, sample.columns, sample.rows)
    assert found.most <= 30
    assert found.lobes.shape == (found.first[-1], STORED)
    whole = footprints_of(sample.base, chain, search.step, search.cell, sample.columns, sample.rows)
    assert whole.most > 100
    assert found.sums[:, COLOUR:AVERAGE] == pytest.approx(whole.sums[:, COLOUR:AVERAGE])
