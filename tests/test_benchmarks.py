"""The benchmarks say what they measured: samples are those of whole bakes, integrals agree, verdicts follow figures."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))  # the benchmarks are not installed

from benchmarks import bakes, closed_times, effects, integrals, qualities, roofline  # noqa: E402
from benchmarks.__main__ import main  # noqa: E402
from benchmarks.accuracy import CLOSED_FORMS, compare_set, targets  # noqa: E402
from benchmarks.materials import NAMED, accuracy_sets, load_procedural, tiled, write_tiled  # noqa: E402
from benchmarks.record import Section, Target, as_markdown, machine, table  # noqa: E402
from brdffit.files.image_io import read_image  # noqa: E402
from brdffit.fitting.effects import kernels_of  # noqa: E402
from brdffit.fitting.method import NonlinearFit  # noqa: E402
from brdffit.fitting.options import FitOptions  # noqa: E402
from brdffit.fitting.sampling import LevelSample  # noqa: E402
from brdffit.halfangle import objective, quadrature  # noqa: E402
from brdffit.halfangle.measure import lobe_parameters  # noqa: E402
from brdffit.methods import get_method  # noqa: E402
from brdffit.models import get_model  # noqa: E402
from brdffit.textures.procedural import make_set  # noqa: E402
from brdffit.tradeoff.run import Size  # noqa: E402
from brdffit.tradeoff.seen import Rule  # noqa: E402


@pytest.fixture(scope="module")
def hammered():
    return load_procedural("hammered-metal", 32)


def row(name="ice-002", level=1, **figures):
    """A row of the accuracy table in which everything is well unless said otherwise."""
    return {"set": name, "level": level, **dict.fromkeys(CLOSED_FORMS, 10.0), "standard": 14.0, "gap": 0.02,
            "margin": 4.0} | figures  # fmt: skip


def test_chance_and_integral_agree(hammered):
    """The 4-D Monte Carlo integral over l and v is the 2-D one over h, for each of a few texels."""
    level = get_method("lean").bake_lobes(hammered, FitOptions(lights="point", levels=3))[2].svbrdf
    for column, texel_row in ((0, 0), (3, 5)):
        chance, integral = integrals.compare(hammered, level, column, texel_row, pairs=60_000)
        assert abs(chance.value - integral.value) < integrals.AGREEMENT * chance.error
        assert chance.error < 0.3 * integral.value  # or anything would agree


def test_times_are_of_each_method(hammered):
    found = closed_times.medians(hammered, ("lean", "naive"), 2)
    assert list(found) == ["lean", "naive"] and all(seconds > 0.0 for seconds in found.values())


def test_a_sample_is_fitted_as_in_a_whole_bake(hammered):
    columns, rows = np.array([0, 5, 7, 3]), np.array([6, 0, 7, 2])
    options = FitOptions(lights="point", levels=3)
    whole = get_method("bfgs").bake_lobes(hammered, options)[2].svbrdf
    (theta, scale), _ = LevelSample(hammered, 2, columns, rows, options).fit()
    assert np.array_equal(scale, whole.specular[rows, columns])
    assert theta == pytest.approx(lobe_parameters(whole, columns, rows), abs=1e-6)


def test_no_method_beats_the_oracle(hammered):
    """On every level, by the measuring rule, which is not the oracle's own: hence the small allowance."""
    found = compare_set("hammered-metal", hammered, texels=6, qualities=("standard",), levels=2)
    assert [each["level"] for each in found] == [0, 1]
    for each in found:
        assert all(each["oracle"] >= each[name] - 0.1 for name in (*CLOSED_FORMS, "standard", "held"))
        assert each["gap"] == each["oracle"] - each["standard"]


def test_verdicts_follow_the_figures():
    good = [row(name) for name in NAMED]
    assert [each.passed for each in targets(good)] == [True, True, True]
    assert [each.passed for each in targets([*good, row(level=0, gap=0.3)])] == [False, True, True]
    assert [each.passed for each in targets([*good, row(level=0, toksvig=14.5)])] == [True, False, True]
    assert targets([row(name, margin=1.0) for name in NAMED])[2].passed is False
    # Level 0 is no part of the margin, and sets that were not measured prove nothing.
    assert targets([*good, row(level=0, margin=-50.0)])[2].passed is True
    assert targets(good[:2])[2].passed is None


def test_the_worst_case_is_named():
    gap, lead, _ = targets([row(), row("coarse-sand", 4, gap=0.7), row("ground-054", 2, naive=13.5)])
    assert "0.70 (coarse-sand, level 4)" in gap.found
    assert "missed on 1 of 3" in gap.found
    assert "0.50 (ground-054, level 2)" in lead.found


def test_a_tiled_set_is_more_of_the_same(hammered, tmp_path):
    """In memory and on disk: its levels are the levels, tiled."""
    naive = get_method("naive")
    one, four = (
        naive.bake_lobes(svbrdf, FitOptions(lights="point", levels=3))[2].svbrdf
        for svbrdf in (hammered, tiled(hammered, 2))
    )
    for name, array in one.arrays().items():
        expected = np.tile(array, (2, 2) + (1,) * (array.ndim - 2))
        assert getattr(four, name) == pytest.approx(expected, abs=1e-6)
    source = make_set("hammered-metal", tmp_path / "small", 16)
    for path in write_tiled(source, tmp_path / "large", 2).iterdir():
        assert np.array_equal(read_image(path).pixels, np.tile(read_image(source / path.name).pixels, (2, 2, 1)))


def test_sets_without_a_folder_of_real_ones(tmp_path):
    assert set(accuracy_sets(tmp_path / "missing", quick=False).values()) == {None}
    for name in (*NAMED[:1], "aaa"):
        (tmp_path / name).mkdir()
    assert list(accuracy_sets(tmp_path, quick=False)) == [NAMED[0], "aaa"]


def test_the_peak_is_measured_on_chains_that_no_compiler_folds():
    # A folded chain rounds once where these round at every step, with or without a rounded product.
    factor, summand = np.float32(0.999), np.float32(1e-3)
    chains = np.random.default_rng(4).random((8, 16), np.float32)
    fused = product = chains.copy()
    for _ in range(roofline._CHAIN):
        fused = (fused.astype(np.float64) * factor + summand).astype(np.float32)
        product = product * factor + summand
    roofline._multiply_add(chains, 1, factor, summand)
    assert np.array_equal(chains, fused) or np.array_equal(chains, product)


def test_a_cut_kernel_has_no_line_of_what_was_cut():
    for template in (objective.moments, objective.lobe_values, quadrature.tabulate):
        assert "HORIZON" in effects.without_lines(template) and "HORIZON" not in effects.without_lines(
            template, HORIZON=False
        )
    moments = effects.without_lines(objective.moments, HORIZON=False, TURNS=False, STRETCHES=False)
    assert not [name for name in ("RIM", "fade", "uc", "uv", "TURNS", "STRETCHES") if f"{name} =" in moments]
    assert "fade" in effects.without_lines(objective.moments)


@pytest.mark.slow
def test_kernels_with_a_switch_off_do_what_kernels_without_its_lines_do(hammered):
    ggx = get_model("ggx")
    for options, switch in (({"horizon": False}, "HORIZON"), ({"lobe": "isotropic"}, "STRETCHES")):
        asked = FitOptions(lights="point", levels=1, **options)
        cut = effects._kernels_without(**{switch: False})
        assert not {each.py_func for each in cut[:3]} & {each.py_func for each in kernels_of(asked, ggx, ggx)[:3]}
        off = NonlinearFit().bake_lobes(hammered, asked)[0].svbrdf
        never = effects._with(cut, lambda asked=asked: NonlinearFit().bake_lobes(hammered, asked))()[0].svbrdf
        np.testing.assert_allclose(off.log_roughness, never.log_roughness, atol=1e-4)
        np.testing.assert_allclose(off.specular, never.specular, rtol=1e-4)


def test_tables_align_and_hold_every_row():
    lines = table([{"set": "a", "dB": 1.0}, {"set": "long name", "dB": None}])
    assert len({len(line) for line in lines}) == 1
    assert lines[2].split("|")[1:3] == [" a         ", " 1.00 "]
    assert " - " in lines[3]


def test_the_command_writes_records_and_shows_the_table(monkeypatch, tmp_path):
    section = Section("integrals", "Title", "Note.", [{"a": 1}], [Target("t", "<= 1", "2", False)], ["A problem."])
    monkeypatch.setattr(integrals, "measure_integrals", lambda quick: section)
    result = CliRunner().invoke(main, ["--quick", "--only", "integrals", "-o", str(tmp_path / "bench")])
    assert result.exit_code == 0, result.output
    record = json.loads((tmp_path / "bench/bench.json").read_text())
    assert record["sections"][0]["targets"][0]["verdict"] == "MISS"
    assert {"commit", "processor", "date", "numba"} <= set(record["machine"])
    text = (tmp_path / "bench/bench.md").read_text()
    assert "MISS" in text and "A problem." in text and text in result.output


def test_the_record_is_json():
    assert json.loads(json.dumps(machine()))
    assert as_markdown({}, []).startswith("# ")


def test_rates_and_times_are_those_of_texels_and_their_seconds():
    """Two levels, and another checkout twice as fast at the second: half its rate there, and the time of all texels."""
    ours = {"size": [2, 4], "levels": [[8, 1e-3], [2, 2e-3]]}
    theirs = {"size": [2, 4], "levels": [[8, 1e-3], [2, 1e-3]]}
    found = bakes.row("set", ours, theirs, True)
    assert found["size"] == "4x2" and found["k/s level 1"] == pytest.approx(0.5)
    assert found["k/s level 4"] == pytest.approx(0.5), "the last level stands in"
    assert found["pyramid s"] == pytest.approx(6e-3)
    assert found["rate, level 1"] == pytest.approx(0.5) and found["time, pyramid"] == pytest.approx(1.2)
    lacking = bakes.row("set", ours, None, True)
    assert list(lacking) == list(found) and lacking["rate, level 1"] is None
    assert "time, pyramid" not in bakes.row("set", ours, None, False)


def test_qualities_are_held_against_the_best_lobe(hammered, monkeypatch):
    monkeypatch.setattr(qualities, "crop", lambda name, path: hammered)
    tiny = Size((64, 32, 16, 8, 4, 4), (8, 8, 4, 4, 4, 4), raced=3, rule=Rule(512, (16, 32)), repeats=1)
    monkeypatch.setattr(qualities, "QUICK", tiny)
    told = CliRunner().invoke(qualities.main, ["--set", "hammered-metal"])
    assert told.exit_code == 0, told.output
    cells = [line.strip("|").split("|") for line in told.output.splitlines()]
    assert [row[0].strip() for row in cells[2:]] == ["hammered-metal", "mean", "worst"]
    figures = np.array([[float(each) for each in row[1:]] for row in cells[2:]])
    assert (figures[:, 2] == 1.0).all(), "times are those of standard"
    assert (figures[:, 1::2] >= -0.05).all(), "no preset is better than the best lobe, but for what the rule resolves"
