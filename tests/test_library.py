"""A library is baked as its sets would be one by one, and only what has changed is baked again."""

from __future__ import annotations

import importlib
import json
import os
import platform
import re
import shutil
import threading
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from library_support import contents, make_library, write_maps

from brdffit import pipeline
from brdffit.cli import main
from brdffit.errors import InputError
from brdffit.files.image_io import read_image, write_png
from brdffit.library import bake, state, store
from brdffit.library.page import write_page
from brdffit.library.run import _tasks, run_library
from brdffit.pipeline import bake_to_folder

#: What makes a bake quick: closed forms, two levels.
QUICK = {"method": "lean", "levels": 2}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A library of four sets and its output, by two workers."""
    folder = tmp_path_factory.mktemp("library")
    make_library(folder / "in")
    summary = run_library(folder / "in", folder / "out", workers=2, **QUICK)
    return folder / "in", folder / "out", summary


@pytest.fixture
def library(made, tmp_path):
    """A copy of it, to be changed."""
    for source, name in zip(made[:2], ("in", "out"), strict=True):
        shutil.copytree(source, tmp_path / name)  # keeps the dates of files
    return tmp_path / "in", tmp_path / "out"


def reasons(root, output, **options):
    return run_library(root, output, dry_run=True, **(QUICK | options)).plan.reasons


def test_all_sets_are_baked_where_they_lie(made):
    root, output, summary = made
    keys = ["deep/set0", "deep/set2", "set1", "set3"]
    assert sorted(outcome.key for outcome in summary.outcomes) == keys and not summary.failures
    assert sorted(path.parent.relative_to(output).as_posix() for path in output.rglob("manifest.json")) == keys
    assert {path.name for path in output.iterdir()} == {"deep", "set1", "set3", "library.json", "index.html"}
    assert summary.texels == 5 * sum(side * side for side in (8, 12, 16, 8)) // 4


def test_each_set_is_as_the_single_bake_makes_it(made, tmp_path):
    """One road: the same files but the thumbnail, the same manifest but what speaks of it and of the request."""
    root, output, _ = made
    for key in ("deep/set2", "set1"):
        bake_to_folder(root / key, tmp_path, preview=False, **QUICK)
        alone, ours = contents(tmp_path / key.rpartition("/")[2]), contents(output / key)
        thumbnail = ours.pop("preview.png")
        assert alone.keys() == ours.keys() and thumbnail
        manifests = [files.pop("manifest.json") for files in (alone, ours)]
        assert alone == ours
        for manifest in manifests:
            manifest.pop("stable_digest")
        manifests[1]["files"].pop("preview.png")
        assert manifests[1].pop("request")["name"] == key.rpartition("/")[2]
        assert manifests[0] == manifests[1]


def test_bytes_do_not_depend_on_the_workers(made, tmp_path):
    """One worker here, two there."""
    root, output, _ = made
    run_library(root, tmp_path / "out", workers=1, **QUICK)
    assert contents(tmp_path / "out") == contents(output)


def test_what_is_up_to_date_is_skipped(library):
    root, output = library
    before = {path: path.stat().st_mtime_ns for path in output.rglob("*.exr")}
    summary = run_library(root, output, **QUICK)
    assert not summary.outcomes and len(summary.plan.skipped) == 4
    os.utime(root / "set1" / "Set_Color.png")  # its date alone
    assert not reasons(root, output)
    assert {path: path.stat().st_mtime_ns for path in output.rglob("*.exr")} == before


def test_a_change_that_size_and_date_hide_is_seen(library):
    root, output = library
    path = root / "set1" / "Set_Color.png"
    stat, data = path.stat(), bytearray(path.read_bytes())
    data[-20] ^= 1
    path.write_bytes(data)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert path.stat().st_size == stat.st_size and path.stat().st_mtime_ns == stat.st_mtime_ns
    assert reasons(root, output) == {"set1": "other inputs"}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda root, output: write_maps(root / "set1", seed=9, roles=("AO",)), "other inputs"),
        (lambda root, output: (root / "set1" / "Set_Color.png").unlink(), "other inputs"),
        (lambda root, output: (output / "set1" / "normal.exr").unlink(), "incomplete"),
        (lambda root, output: (output / "set1" / "normal.exr").write_bytes(b"cut"), "incomplete"),
        (lambda root, output: (output / "set1" / "manifest.json").write_bytes(b"{"), "new"),
        (lambda root, output: shutil.rmtree(output / "set1"), "new"),
    ],
    ids=["a map more", "a map less", "a file gone", "a file cut", "a manifest cut", "all gone"],
)
def test_a_changed_set_is_seen_alone(library, change, reason):
    root, output = library
    change(root, output)
    assert reasons(root, output) == {"set1": reason}


@pytest.mark.parametrize("change", ["a map more", "a file cut"])
def test_what_was_redone_is_up_to_date(library, change):
    root, output = library
    if change == "a map more":
        write_maps(root / "set1", seed=9, roles=("AO",))
    else:
        (output / "set1" / "normal.exr").write_bytes(b"cut")
    summary = run_library(root, output, workers=1, **QUICK)
    assert [outcome.key for outcome in summary.outcomes] == ["set1"] and not summary.failures
    assert not reasons(root, output)


OTHERS = {
    "levels": 1, "bits": 16, "preset": "godot", "method": "vmf", "wrap": "clamp", "lobe": "isotropic", "normal_y": "gl",
    "height_scale": 2.0, "denoise_normals": True, "model": "beckmann", "min_roughness": 0.1, "pixel_filter": "gaussian",
}  # fmt: skip


@pytest.mark.parametrize("name", OTHERS)
def test_other_options_redo_all(made, name):
    found = reasons(*made[:2], **{name: OTHERS[name]})
    assert len(found) == 4 and set(found.values()) == {"other options"}


def test_another_program_or_version_redoes_all(made, monkeypatch):
    root, output, _ = made
    monkeypatch.setattr(state, "versions", lambda: {"brdffit": "0.0.0"})
    assert set(reasons(root, output).values()) == {"another version"}
    monkeypatch.undo()
    (task,) = [each for key, each in _tasks(root, str(output), None, QUICK).items() if key == "set1"]
    folder = store.open_store(str(output))
    manifest = store.manifest_of(folder, "set1")

    def size_of(name):
        return folder.size(f"set1/{name}")

    assert state.reason_to_bake(task, manifest, size_of) is None
    assert state.reason_to_bake(replace(task, code="other sources"), manifest, size_of) == "another version"


def test_the_sources_that_matter_are_hashed():
    assert state.code_digest("bfgs") == state.code_digest("bfgs") != state.code_digest("library_support:Fails")


def test_a_model_of_the_users_own_is_part_of_what_is_compared(tmp_path, monkeypatch):
    source = tmp_path / "own_model.py"
    kernels = ("profile", "profile_gradient", "log_normalisation")
    source.write_text("".join(f"def {name}(*values):\n    return 1.0\n" for name in kernels))
    monkeypatch.syspath_prepend(tmp_path)
    own = importlib.import_module("own_model")
    monkeypatch.setattr(pipeline, "get_model", lambda name: own)
    before = state.code_digest("lean", "own")
    source.write_text(source.read_text().replace("1.0", "100.0"))
    state.code_digest.cache_clear()  # as in the next process
    assert state.code_digest("lean", "own") != before


def test_force_only_and_shards(made):
    root, output, _ = made
    assert set(reasons(root, output, force=True).values()) == {"forced"}
    assert list(reasons(root, output, force=True, only=["deep/*", "nothing"])) == ["deep/set0", "deep/set2"]
    with pytest.raises(InputError, match="has a place that matches nothing; places are like 'deep/set0'"):
        reasons(root, output, only=["nothing"])
    for parts in (1, 2, 3, 7):
        shards = [list(reasons(root, output, force=True, shard=(part + 1, parts))) for part in range(parts)]
        assert sorted(key for shard in shards for key in shard) == ["deep/set0", "deep/set2", "set1", "set3"]


def test_a_root_without_sets_and_an_output_that_is_the_root_are_told(tmp_path):
    with pytest.raises(InputError, match="holds no texture set, expected folders of textures"):
        run_library(tmp_path, tmp_path / "out")
    write_maps(tmp_path / "set")
    with pytest.raises(InputError, match="both the library and its output"):
        run_library(tmp_path, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"set"}


def test_a_dry_run_writes_nothing(made, tmp_path):
    result = CliRunner().invoke(main, ["library", str(made[0]), "-o", str(tmp_path / "out"), "--dry-run"])
    assert result.exit_code == 0 and "4 sets would be baked" in result.output
    assert not (tmp_path / "out").exists()


def test_bad_sets_are_named_and_good_ones_baked(library):
    root, output = library
    shutil.rmtree(output)
    path = root / "set1" / "Set_Color.png"
    path.write_bytes(path.read_bytes()[:-30])
    write_maps(root / "flat", roles=("Color", "Roughness"))
    write_maps(root / "sizes")
    write_png(root / "sizes" / "Set_Color.png", np.arange(120, dtype=np.uint8).reshape(8, 5, 3))
    options = ["--method", "lean", "--set", "levels=2", "--workers", "1"]
    result = CliRunner().invoke(main, ["library", str(root), "-o", str(output), *options])
    assert result.exit_code == 1
    record = json.loads((output / "library.json").read_text())
    assert sorted(record["sets"]) == ["deep/set0", "deep/set2", "set3"]
    assert sorted(record["failed"]) == ["flat", "set1", "sizes"] and not record["missing"]
    assert "truncated" in record["failed"]["set1"] and "no normal map" in record["failed"]["flat"]
    assert "same proportions" in record["failed"]["sizes"]
    for key, sentence in record["failed"].items():
        assert f"- {key}: {sentence}" in result.stdout and sentence.endswith(".")
    assert "set1" in (output / "index.html").read_text()
    # Mended, it is baked; the others of the library stand.
    write_maps(root / "set1", seed=1, size=12)
    CliRunner().invoke(main, ["library", str(root), "-o", str(output), *options, "--only", "set1"])
    record = json.loads((output / "library.json").read_text())
    assert sorted(record["failed"]) == ["flat", "sizes"] and "set1" in record["sets"]


def test_a_set_that_no_longer_can_be_baked_keeps_what_it_had_but_is_named(library):
    root, output = library
    before = contents(output / "set1")
    path = root / "set1" / "Set_Color.png"
    path.write_bytes(path.read_bytes()[:-30])
    assert set(run_library(root, output, workers=1, **QUICK).failures) == {"set1"}
    assert contents(output / "set1") == before
    record = json.loads((output / "library.json").read_text())
    assert "set1" in record["failed"] and "set1" not in record["sets"]


def test_files_that_change_while_they_are_read_are_told(made, monkeypatch):
    root, output, _ = made
    task = _tasks(root, str(output), None, QUICK)["set1"]
    monkeypatch.setattr(pipeline, "to_svbrdf", lambda *arguments, **options: os.utime(root / "set1" / "Set_Color.png"))
    with pytest.raises(InputError, match="changed while they were read"):
        bake.read_set(task)


def test_the_page_holds_all_it_shows(made):
    page = (made[1] / "index.html").read_text()
    assert page.count("data:image/png;base64,") == 4
    assert "http" not in page and "<link" not in page and 'src="data:' in page
    for key in ("deep/set0", "set3"):
        assert f'href="{key}/manifest.json"' in page


def test_a_name_in_the_page_is_no_markup(tmp_path):
    record = {"sets": {}, "failed": {"<s>&": "It's <i>bad</i>."}, "missing": ["<u>"], "volatile": {"seconds": {}}}
    write_page(store.open_store(str(tmp_path)), record, {})
    page = (tmp_path / "index.html").read_text()
    assert not [tag for tag in ("<s>", "<i>", "<u>") if tag in page] and "&lt;s&gt;&amp;" in page


def test_the_thumbnail_shows_that_a_bake_is_not_an_average(made):
    pixels = read_image(made[1] / "deep" / "set2" / "preview.png").pixels
    height, width = pixels.shape[:2]
    before, after = pixels[:, : width // 2 - 4], pixels[:, width // 2 + 4 :]
    assert before.shape == after.shape == (height, height, 3)
    assert before.max() > after.max() + 0.02  # bumps become gloss: the highlight is wider and weaker
    assert abs(before[0, 0] - after[0, 0]).max() == 0.0


def test_leftovers_of_killed_runs_are_swept_and_those_of_living_ones_are_not(library):
    root, output = library
    dead = output / "deep" / ".set0.brdffit-new-1-1"
    dead.mkdir()
    (dead / "half.exr").write_bytes(b"")
    host = re.sub("[^A-Za-z0-9]", "_", platform.node())
    (output / f".library.json.{host}-999999999.part").write_text("")
    alive = output / f".index.html.{host}-{os.getppid()}.part"
    alive.write_text("")
    gone = output / "deep" / "set2"
    gone.rename(output / "deep" / ".set2.brdffit-old-1-1")  # killed between two renames
    assert not run_library(root, output, **QUICK).outcomes
    assert gone.is_dir() and alive.exists()
    assert not [path for path in output.rglob(".*") if path != alive]


def test_runs_from_a_thread(library):
    """No handler of signals can be set there; the run does without."""
    root, output = library
    found = []
    thread = threading.Thread(target=lambda: found.append(run_library(root, output, **QUICK)))
    thread.start()
    thread.join()
    assert len(found[0].plan.skipped) == 4


def test_results_at_an_address(library, tmp_path):
    fsspec = pytest.importorskip("fsspec")
    root, output = library
    address = f"file://{tmp_path}/elsewhere"
    assert not run_library(root, address, workers=1, **QUICK).failures
    assert contents(tmp_path / "elsewhere") == contents(output)
    assert not reasons(root, address)
    # Whole is what has a manifest.
    fsspec.filesystem("file").rm(f"{tmp_path}/elsewhere/set1/manifest.json")
    assert reasons(root, address) == {"set1": "new"}


@pytest.mark.parametrize("shard", ["0/3", "4/3", "1", "a/b"])
def test_a_shard_is_a_part_of_a_whole(made, shard):
    result = CliRunner().invoke(main, ["library", str(made[0]), "--shard", shard])
    assert result.exit_code == 2 and "of the form i/n" in result.output
