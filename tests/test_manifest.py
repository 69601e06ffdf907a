"""The manifest says what was read, asked and written, and two equal bakes have equal digests."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest
from export_support import averaged_pyramid, random_svbrdf

from brdffit.errors import InputError
from brdffit.export.manifest import (
    build_manifest,
    foreign_file,
    level_record,
    stable_digest,
    to_json,
)
from brdffit.export.writing import write_baked
from brdffit.files.image_io import file_sha256
from brdffit.machine import versions
from brdffit.methods import Baked


def bake(folder, threads=None, seconds=1.0, seed=0, inputs=()):
    pyramid = averaged_pyramid(random_svbrdf((12, 20), seed=seed), threads=threads)
    for level in pyramid.levels:
        level.seconds = seconds
    manifest = build_manifest(Baked.of_lobes(pyramid), name="set", inputs=inputs)
    preview = np.zeros((4, 5, 3), np.uint8)
    return write_baked(Baked.of_lobes(pyramid), folder, name="set", preset="gltf", manifest=manifest, preview=preview)


def files(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_same_bake_gives_the_same_bytes_whatever_the_threads_and_the_time(tmp_path):
    one, two = bake(tmp_path / "one", threads=1, seconds=1.0), bake(tmp_path / "two", threads=2, seconds=9.0)
    first, second = files(tmp_path / "one"), files(tmp_path / "two")
    texts = [json.loads(folder.pop("manifest.json")) for folder in (first, second)]
    assert first == second
    assert texts[0].pop("volatile") != texts[1].pop("volatile")
    assert texts[0] == texts[1]
    assert one["stable_digest"] == two["stable_digest"]
    assert bake(tmp_path / "one", seed=1)["stable_digest"] != one["stable_digest"]


def test_the_digest_can_be_checked_from_the_files_alone(tmp_path):
    bake(tmp_path / "set")
    manifest = json.loads((tmp_path / "set" / "manifest.json").read_text())
    assert stable_digest(manifest) == manifest["stable_digest"]
    listed = manifest["files"]
    assert set(listed) == set(files(tmp_path / "set")) - {"manifest.json"}
    assert "preview.png" in listed and "gltf/set.glb" in listed
    for name, said in listed.items():
        data = (tmp_path / "set" / name).read_bytes()
        assert said == {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    manifest["levels"][0]["texels"] += 1
    assert stable_digest(manifest) != manifest["stable_digest"]


def test_a_change_of_any_file_changes_the_digest(tmp_path):
    manifest = dict(bake(tmp_path / "set"))
    manifest["files"] = {**manifest["files"], "normal.exr": {"bytes": 1, "sha256": "0"}}
    assert stable_digest(manifest) != manifest["stable_digest"]


def test_options_and_inputs_are_recorded(tmp_path):
    source = tmp_path / "wood_normal.png"
    source.write_bytes(b"pixels")
    pyramid = averaged_pyramid(random_svbrdf((4, 4)), pixel_filter="mitchell", threads=3)
    manifest = build_manifest(
        Baked.of_lobes(pyramid),
        name="wood",
        inputs=[("normal", source)],
        conventions={"normal_y": "dx"},
        notes=["A sentence."],
    )
    assert manifest["inputs"] == [
        {"role": "normal", "file": "wood_normal.png", "sha256": hashlib.sha256(b"pixels").hexdigest()}
    ]
    assert manifest["options"]["pixel_filter"] == "mitchell" and "threads" not in manifest["options"]
    assert manifest["volatile"]["threads"] == 3
    assert manifest["conventions"] == {"normal_y": "dx"} and manifest["notes"] == ["A sentence."]
    assert [(level["width"], level["height"]) for level in manifest["levels"]] == [(4, 4), (2, 2), (1, 1)]
    assert {"python", "brdffit", "numpy", "scipy", "numba", "OpenImageIO"} <= set(versions())
    assert "unknown" not in versions().values()


def test_a_level_counts_its_statuses_and_adds_what_was_measured():
    level = averaged_pyramid(random_svbrdf((2, 3)))[0]
    level.status = np.array([[0, 0, 2], [2, 2, 7]], np.uint8)
    level.evaluations = np.full((2, 3), 60000, np.uint16)
    level.residual = np.full((2, 3), 0.01, np.float32)
    record = level_record((2, 3), 0, level, ("converged", "stalled", "flat"), {"snr_db": 19.5, "energy_kept": 0.98})
    assert record["statuses"] == {"converged": 2, "flat": 3, "7": 1}
    assert sum(record["statuses"].values()) == record["texels"] == 6
    assert record["evaluations"] == 360000
    assert record["residual_snr_db"] == pytest.approx(20.0, abs=1e-5)
    assert record["snr_db"] == 19.5 and record["energy_kept"] == 0.98
    level.residual[:] = 0.0
    assert level_record((2, 3), 0, level)["residual_snr_db"] is None


def test_closed_forms_have_no_statuses():
    record = level_record((2, 2), 0, averaged_pyramid(random_svbrdf((2, 2)))[0])
    assert set(record) == {"level", "width", "height", "texels"}


def test_json_is_sorted_and_holds_no_nan():
    text = to_json({"b": np.float32(np.inf), "a": (np.int64(1), np.array([0.5])), "c": {"é": float("nan")}})
    assert json.loads(text) == {"a": [1, [0.5]], "b": None, "c": {"é": None}}
    assert list(json.loads(text)) == ["a", "b", "c"] and text.endswith("\n")


def test_what_is_ours_is_told_by_the_manifest(tmp_path):
    bake(tmp_path / "set")
    assert foreign_file(tmp_path / "set") is None
    (tmp_path / "set" / "extra.png").write_bytes(b"")
    assert foreign_file(tmp_path / "set") == "extra.png"


def test_a_digest_is_sha_256_and_an_input_that_is_gone_is_named(tmp_path):
    (tmp_path / "empty").write_bytes(b"")
    assert file_sha256(tmp_path / "empty") == "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"
    with pytest.raises(InputError, match=r"gone\.png' cannot be read: No such file"):
        bake(tmp_path / "set", inputs=[("height", tmp_path / "gone.png")])
