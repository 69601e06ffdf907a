"""The table of what is seen: counts follow figures, crops are parts of their set, records are read back."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

sys.path.insert(0, str(Path(__file__).parent.parent))  # the benchmarks are not installed

from benchmarks import best_lobe, materials, seen
from benchmarks.seen_summary import summary, verdicts
from brdffit.textures.procedural import make_set


def figures(snr=20.0, flip=0.1, ssim=0.9, energy=1.0):
    return {"snr": snr, "flip": flip, "ssim": ssim, "energy": energy, "displayed": 0.05}


def view(**changed):
    """Figures of every column of a view, alike but for those that are told."""
    return {name: figures() for name in ("bfgs", "lean", "vmf", "toksvig", "naive")} | changed


def test_a_view_is_held_against_filters_and_averages_apart():
    reached = verdicts(view(bfgs=figures(flip=0.09), naive=figures(flip=0.05)), "bfgs")
    assert reached["first"] and reached["FLIP"] and not reached["FLIP of averages"]
    reached = verdicts(view(lean=figures(snr=22.0)), "bfgs")
    assert not reached["first"] and reached["1 dB behind"]
    assert not reached["or level"] and not reached["and in FLIP"]
    reached = verdicts(view(lean=figures(snr=22.0, flip=0.05)), "bfgs")
    assert reached["1 dB behind"] and reached["and in FLIP"]
    reached = verdicts(view(naive=figures(snr=20.03)), "bfgs")
    assert reached["or level"] and not reached["first"]
    # Nobody sees what is beyond 40 dB.
    reached = verdicts(view(bfgs=figures(snr=41.0), lean=figures(snr=55.0)), "bfgs")
    assert reached["first"] and not reached["1 dB behind"]


def test_the_summary_counts_and_names_the_losers():
    views = {"near": view(bfgs=figures(snr=30.0)), "far": view(bfgs=figures(snr=15.0, ssim=0.5))}
    records = [
        {"set": "a", "column": name, "seconds": 1.0, "energy": [1.0, 0.8],
         "views": {key: each[name] for key, each in views.items()}}
        for name in view()
    ]  # fmt: skip
    section, losing = summary(records, "bfgs")
    row = section.rows[0]
    assert (row["column"], row["views"], row["first"], row["1 dB behind"]) == ("bfgs", 2, 1, 1)
    assert row["levels kept"] == "1 of 2" and row["least energy"] == 0.8
    assert [(each["view"], each["dB"]) for each in losing] == [("far", -5.0)]
    assert {target.name: target.passed for target in section.targets}["energy of every level"] is False


def test_a_crop_is_a_part_of_its_set(tmp_path):
    folder = make_set("hammered-metal", tmp_path / "set", 64)
    whole, part = materials.load(folder), materials.crop("a", folder, 16)
    assert part.size == (16, 16)
    rows = [r for r in range(0, 64, 16) for c in range(0, 64, 16)
            if np.array_equal(whole.normal[r : r + 16, c : c + 16], part.normal)]  # fmt: skip
    assert len(rows) == 1
    assert materials.crop("a", folder, 128).size == (64, 64)


@pytest.fixture
def small(monkeypatch, tmp_path):
    folder = make_set("glossy-tiles", tmp_path / "set", 16)
    monkeypatch.setattr(seen, "every_set", lambda materials: {"tiles": folder})
    monkeypatch.setattr(seen, "_PIXELS", 12)
    return tmp_path / "out"


def test_a_run_goes_on_where_it_ended(small):
    def run(*arguments):
        result = CliRunner().invoke(seen.main, ["-o", str(small), "--threads", "1", *arguments])
        assert result.exit_code == 0, result.output
        return result.output

    run("--column", "naive", "--column", "lean")
    first = {path.name: path.read_bytes() for path in (small / "tiles").iterdir()}
    text = run("--column", "naive", "--column", "vmf", "--column", "toksvig", "--column", "lean")
    assert all((small / "tiles" / name).read_bytes() == before for name, before in first.items())
    record = json.loads((small / "tiles/vmf.json").read_text())
    assert len(record["views"]) == 11 and len(record["energy"]) == 5
    assert "What is seen" in text and (small / "summary.md").is_file()


def test_a_lobe_is_its_parameters(tmp_path):
    base = materials.load(make_set("brushed-metal", tmp_path / "set", 16))
    texel = best_lobe._texel(base, 3, 5)
    again = best_lobe.texel_of(best_lobe.parameters(texel), texel)
    for name, array in texel.arrays().items():
        # A black diffuse colour has no logarithm: it is held a little above.
        np.testing.assert_allclose(getattr(again, name), array, rtol=1e-4, atol=2e-5, err_msg=name)


def test_a_search_finds_a_lobe_that_is_there(monkeypatch, tmp_path):
    """A base of one lobe everywhere: the truth is that lobe, and a search from a rougher one finds it again."""
    monkeypatch.setattr(best_lobe, "_SIDE", 6)
    base = materials.load(make_set("hammered-metal", tmp_path / "set", 16))
    one = base.replace(**{
        name: np.ascontiguousarray(np.broadcast_to(array[4, 4], array.shape)) for name, array in base.arrays().items()
    })  # fmt: skip
    monkeypatch.setattr(seen, "crop", lambda name, path: one)
    bench = seen.Bench("one", None, tmp_path / "out", 1)
    view = next(each for each in bench.views if each.key == "mid-small-lights")
    patch = best_lobe.Patch(bench, view, int(view.level), 0, 0)
    right = best_lobe._texel(one, 4, 4)
    assert patch.errors(right)[0] < 1e-6
    rougher = right.replace(log_roughness=right.log_roughness + np.float32([0.6, 0.6, 0.0]))
    worse = patch.errors(rougher)[0]
    texel = best_lobe.best(lambda tried: patch.errors(tried)[0], [rougher], 600)
    assert patch.errors(texel)[0] < 0.05 * worse


def test_pyramids_between_two_tell_who_is_at_fault(monkeypatch, tmp_path):
    """The truth is the closed form's pyramid: it is right in all views, so a fit that is rougher is at fault. Where
    only its other views are wrong in the closed form, no pyramid between them serves all, and the lobe is at fault."""
    base = materials.load(make_set("hammered-metal", tmp_path / "set", 16))
    one = base.replace(**{
        name: np.ascontiguousarray(np.broadcast_to(array[4, 4], array.shape)) for name, array in base.arrays().items()
    })  # fmt: skip
    one = one.replace(log_roughness=np.broadcast_to(np.float32([-2.0, -2.0, 0.0]), one.log_roughness.shape).copy())
    monkeypatch.setattr(seen, "crop", lambda name, path: one)
    bench = seen.Bench("one", None, tmp_path / "out", 1)
    view = next(each for each in bench.views if each.key == "slanted")
    right = best_lobe.baked_levels(bench, ("naive",))["naive"]
    rougher = [each.replace(log_roughness=each.log_roughness + np.float32([0.6, 0.6, 0.0])) for each in right]
    row = best_lobe._between(bench, view, {"bfgs": rougher, "naive": right}, ("bfgs", "naive"))
    assert row["at fault"] == "fit" and row["best lobe"] == row["best lobe of all views"] > row["fit"] + 1.0
    half = best_lobe.mixed(rougher[0], right[0], 0.5)
    np.testing.assert_allclose(half.log_roughness, right[0].log_roughness + np.float32([0.3, 0.3, 0.0]), atol=1e-6)
    # The same references but for the slanted view, whose truth is now the rougher pyramid's picture.
    picture = bench.studio.method(rougher, view.scene, view.lit)
    bench.references[view.key] = best_lobe.Reference(picture.mean(axis=0), picture)
    row = best_lobe._between(bench, view, {"bfgs": right, "naive": rougher}, ("bfgs", "naive"))
    assert row["at fault"] == "lobe"
