"""Laws of the tables: the gradient against differences, symmetry, what shipped tables err by, and making one."""

import json

import numpy as np
import pytest
from probes_support import exact_level, lamps, relative_l1

from brdffit.errors import InputError, UnknownNameError
from brdffit.probes.curves import get_curve
from brdffit.probes.downsampling import ColourPyramid
from brdffit.probes.kernels.tables import TAP_FIELDS, TAP_LEVEL, TAP_WEIGHT, place_taps
from brdffit.probes.table_files import load_table, make_table, shipped_tables
from brdffit.probes.table_fit import TableRequest, held_out_goal, importance_start
from brdffit.probes.table_symmetry import SYMMETRIES, fold, free_taps, orbits, unfold
from brdffit.probes.tables import Goal, filtered_by_table, texels_of

ALPHAS = get_curve("activision", 7, 128).alphas()


def some_table(terms=3, taps=4, seed=0):
    rng = np.random.default_rng(seed)
    table = rng.normal(size=(5, terms, 3 * taps))
    table[2] = np.abs(table[2]) + 1.0
    table[3:, 1:] *= 0.1
    table[3, 0], table[4, 0] = rng.uniform(2.0, 5.0, 3 * taps), rng.uniform(0.3, 1.0, 3 * taps)
    return table


@pytest.mark.parametrize("terms", [1, 3, 6])
def test_the_gradient_is_that_of_the_error(terms):
    table = some_table(terms)
    texels = texels_of(16)[np.random.default_rng(1).choice(1536, 6, replace=False)]
    goal = Goal.of(texels, ALPHAS[3], base=1)
    _, gradient = goal.error_and_gradient(table, 1e-4)
    rng, step = np.random.default_rng(2), 1e-5
    for _ in range(24):
        index = tuple(rng.integers(0, size) for size in table.shape)
        up, down = table.copy(), table.copy()
        up[index] += step
        down[index] -= step
        difference = (goal.error(up, 1e-4) - goal.error(down, 1e-4)) / (2.0 * step)
        assert gradient[index] == pytest.approx(difference, abs=1e-6)


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_folding_is_the_transpose_of_unfolding(symmetry):
    rng = np.random.default_rng(0)
    free, gradient = rng.normal(size=(5, 3, free_taps(symmetry, 4))), rng.normal(size=(5, 3, 12))
    assert (unfold(free, symmetry) * gradient).sum() == pytest.approx((free * fold(gradient, symmetry)).sum())


@pytest.mark.parametrize("symmetry, orbit_count", [("axes", 32), ("mirror", 20)])
def test_one_texel_of_each_orbit_is_enough(symmetry, orbit_count):
    count = free_taps(symmetry, 4)
    table = unfold(some_table(3, 4)[:, :, :count], symmetry)
    texels, shares = orbits(texels_of(4), symmetry)
    assert len(texels) == orbit_count and shares.sum() == 96
    whole = Goal.of(texels_of(4), ALPHAS[5], base=2).error(table)
    assert Goal.of(texels, ALPHAS[5], shares, base=2).error(table) == pytest.approx(whole, rel=1e-6)
    # A table without the tie errs differently: the orbits are no accident.
    other = some_table(3, 4)
    assert Goal.of(texels, ALPHAS[5], shares, 2).error(other) != pytest.approx(
        Goal.of(texels_of(4), ALPHAS[5], base=2).error(other), rel=1e-6
    )


def test_39_of_48_frames_are_at_work():
    """Figure 5: 36 of 64 tiles of a face see two frames, 28 see three (n = 64: no texel centre on a rim)."""
    taps = np.empty((3, TAP_FIELDS))
    table = some_table(1, 1)
    counts = [place_taps(table, int(f), u, v, taps) for f, u, v in texels_of(64)[: 64 * 64]]
    assert np.mean(counts) == pytest.approx(39.0 / 16.0)


def test_a_tap_at_the_texel_is_an_identity():
    """x = y = 0, z = 1 at level 0: the texel itself, whichever frames are at work; constants stay at any weight."""
    table = np.zeros((5, 1, 3))
    table[2], table[4] = 1.0, 1.0
    taps = np.empty((3, TAP_FIELDS))
    assert place_taps(table, 0, 0.0, 0.0, taps) == 2
    assert taps[0, TAP_LEVEL] == 0.0 and taps[0, TAP_WEIGHT] == 1.0
    table[3] = -5.0  # the offset of the Jacobian is clamped away
    cube = lamps(128)
    np.testing.assert_allclose(filtered_by_table(ColourPyramid.of(cube), 128, table), cube, rtol=1e-5, atol=1e-5)
    constant = ColourPyramid.of(np.full((6, 128, 128, 3), 0.3))
    np.testing.assert_allclose(filtered_by_table(constant, 64, some_table(3)), 0.3, rtol=1e-6)


def test_the_preimage_is_what_filtering_does():
    """Radiance filtered by a table is the sum of the preimage and the source: one lamp, seen by both."""
    table = some_table(3)
    cube = np.zeros((6, 128, 128, 3), np.float32)
    cube[4, 60:64, 70:72] = 1.0
    texels = texels_of(8)
    goal = Goal(texels, np.full(len(texels), 1.0 / len(texels)), np.zeros((len(texels), 6 * 128**2), np.float32))
    # Against nothing the error is the L1 norm of the preimage: one, where no weight is negative.
    np.testing.assert_allclose(goal.errors(table), 1.0, rtol=1e-9)
    lamp = np.zeros((1, 6, 128, 128), np.float32)
    lamp[0, 4, 60:64, 70:72] = 1e3
    against = Goal(texels[::5], np.ones(len(texels[::5])), np.repeat(lamp.reshape(1, -1), len(texels[::5]), axis=0))
    # |C - 1000| on the lamp and C elsewhere: the share of the lamp is what is missing from 8000 + 1.
    share = (8000.0 + 1.0 - against.errors(table)) / 2.0
    filtered = filtered_by_table(ColourPyramid.of(cube), 8, table)[..., 0].ravel()[::5]
    np.testing.assert_allclose(filtered, share, atol=1e-6)


def test_importance_sampled_starts_lie_on_the_sphere_above_the_horizon():
    start = importance_start(8, 24, 0.4, np.random.default_rng(0))[:, 0]
    np.testing.assert_allclose(np.square(start[:3]).sum(axis=0), 1.0, atol=1e-3)
    assert start[2].min() > 0.0 and start[3].min() >= 0.0 and start[4].min() > 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_tables())
def test_shipped_tables_err_as_they_say(name):
    table = load_table(name)
    for number, level in table.levels.items():
        alpha = 1.0 if table.curve == "irradiance" else ALPHAS[number]
        assert held_out_goal(level.size, alpha).error(level.table) == pytest.approx(level.error, abs=2e-4)


def test_a_shipped_table_filters_a_real_picture():
    table = load_table("ggx-const-8")
    cube = lamps(128, bright=5.0)
    for level in (3, 4, 5, 6):
        filtered = filtered_by_table(ColourPyramid.of(cube), 128 >> level, table.tables[level])
        assert relative_l1(filtered, exact_level(cube, 128 >> level, ALPHAS[level])) < 0.05


@pytest.mark.slow
def test_a_table_is_made_gone_on_with_and_the_same_again(tmp_path):
    """All levels with one start each; a file that lacks levels is gone on with; another request is refused."""
    request = TableRequest(2, "const", starts=2, texels=4)
    told = []
    made = make_table(tmp_path / "a.json", request, "activision", "test", listener=told.append)
    assert made.is_whole and all(0.05 < level.error < 1.0 for level in made.levels.values())
    record = json.loads((tmp_path / "a.json").read_text())
    kept = [each for each in record["levels"] if each["level"] != 6]
    (tmp_path / "b.json").write_text(json.dumps({**record, "levels": kept}))
    again = make_table(tmp_path / "b.json", request, "activision", "test")
    np.testing.assert_array_equal(again.tables[6], made.tables[6])
    with pytest.raises(InputError, match="asked for otherwise"):
        make_table(tmp_path / "b.json", TableRequest(2, "const", starts=3, texels=4), "activision", "test")


def test_unknown_and_damaged_tables_are_refused(tmp_path):
    with pytest.raises(UnknownNameError, match="ggx-const-8"):
        load_table("ggx-const-88")
    level = {"level": 6, "size": 2, "error": 0.1, "seconds": 1.0, "history": [], "table": np.zeros((5, 1, 23)).tolist()}
    for levels in ([level], [{}]):
        record = {"taps": 8, "terms": "const", "curve": "activision", "levels": levels}
        (tmp_path / "damaged.json").write_text(json.dumps(record))
        with pytest.raises(InputError, match="is no whole table"):
            load_table(tmp_path / "damaged.json")


def test_a_search_refuses_to_begin_with_what_does_not_fit(tmp_path):
    for request in (TableRequest(16, "quadratic"), TableRequest(8, "const")):
        with pytest.raises(InputError, match="'ggx-quadratic-8' has 8 taps of quadratic terms"):
            make_table(tmp_path / "a.json", request, "activision", "test", [load_table("ggx-quadratic-8")])
    assert not list(tmp_path.iterdir())
