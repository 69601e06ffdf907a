"""An output folder is the old one or the new one, whatever happens in between."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from export_support import averaged_pyramid, random_svbrdf

from brdffit.errors import OutputError
from brdffit.export import pictures
from brdffit.export import writing as export
from brdffit.export.manifest import build_manifest
from brdffit.export.writing import check_writable, write_baked
from brdffit.files import atomic
from brdffit.methods import Baked

needs_permissions = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="the superuser may write anywhere"
)


def write(folder, seed=0, size=(8, 8), **options):
    baked = Baked.of_lobes(averaged_pyramid(random_svbrdf(size, seed=seed)))
    return write_baked(baked, folder, name="set", manifest=build_manifest(baked, name="set"), **options)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("exchange", [True, False], ids=["one call", "two renames"])
def test_a_second_bake_replaces_the_first(tmp_path, monkeypatch, exchange):
    if not exchange:
        monkeypatch.setattr(atomic, "_exchange", lambda one, other: False)
    folder = tmp_path / "deep" / "set"
    first = write(folder)
    before = contents(folder)
    second = write(folder, seed=1)
    assert first["stable_digest"] != second["stable_digest"]
    assert contents(folder).keys() == before.keys() and contents(folder) != before
    assert list(folder.parent.iterdir()) == [folder]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), OutputError("Full."), KeyboardInterrupt()])
@pytest.mark.parametrize("writer", ["write_png", "write_mip_exr", "file_sha256"])
@pytest.mark.parametrize("there_before", [True, False])
def test_a_failure_in_the_middle_leaves_what_was_there(tmp_path, monkeypatch, error, writer, there_before):
    folder = tmp_path / "set"
    if there_before:
        write(folder)
    before = contents(tmp_path)
    module = pictures if writer == "write_png" else export
    original, calls = getattr(module, writer), []

    def fails_the_second_time(*args, **kwargs):
        calls.append(args)
        if len(calls) == 2:
            raise error
        return original(*args, **kwargs)

    monkeypatch.setattr(module, writer, fails_the_second_time)
    with pytest.raises(KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else OutputError) as raised:
        write(folder, seed=1)
    assert len(calls) >= 2  # files are written beside each other
    if isinstance(error, OSError):
        assert "No space left on device" in str(raised.value) and str(folder) in str(raised.value)
    assert contents(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == (["set"] if there_before else [])


@pytest.mark.parametrize("missing", [None, 10000, 50], ids=["nearly all", "the end of an EXR file", "its last bytes"])
def test_a_full_disk_leaves_what_was_there(tmp_path, missing):
    """The system's own limit on the size of a file stands in for the disk: real writers, a real failure."""
    resource = pytest.importorskip("resource")
    folder = tmp_path / "set"
    write(folder, seed=1, size=(64, 64))
    sizes = {name: len(data) for name, data in contents(folder).items()}
    largest = max(sizes, key=sizes.__getitem__)
    assert largest.endswith(".exr")
    most_bytes = 600 if missing is None else sizes[largest] - missing
    write(folder)
    before = contents(tmp_path)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, hard))
    try:
        with pytest.raises(OutputError) as raised:
            write(folder, seed=1, size=(64, 64))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert f"'{folder}" in str(raised.value) and "brdffit-new" not in str(raised.value)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("preset", "writer"), [("unreal", "write_dds"), ("three", "write_ktx2"), ("gltf", "write_glb")]
)
def test_a_disk_that_fills_up_within_a_container_leaves_what_was_there(tmp_path, monkeypatch, preset, writer):
    if preset == "gltf":
        pytest.importorskip("alktx2", reason="the extra [basis] is not installed")
    folder = tmp_path / "set"
    write(folder, preset=preset)
    before = contents(tmp_path)

    def fills_the_disk(file, *args, **kwargs):
        file.write(b"half of it")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pictures, writer, fills_the_disk)
    with pytest.raises(OutputError, match="No space left on device"):
        write(folder, seed=1, preset=preset)
    assert contents(tmp_path) == before


def test_a_failed_exchange_leaves_what_was_there(tmp_path, monkeypatch):
    folder = tmp_path / "set"
    write(folder)
    before = contents(tmp_path)
    monkeypatch.setattr(atomic, "_exchange", lambda one, other: False)
    rename = Path.rename

    def refuses_the_new_one(self, target):
        if "brdffit-new" in self.name:
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", refuses_the_new_one)
    with pytest.raises(OutputError, match="Input/output error"):
        write(folder, seed=1)
    assert contents(tmp_path) == before


# Background jobs of a shell ignore SIGINT, and children inherit that: the child asks for Python's own handler.
_SLOW_BAKE = """
import os, signal, sys, time
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.path[:0] = [sys.argv[1], sys.argv[2]]
from brdffit.export import pictures as export
from test_export_atomic import write
original = export.write_png
def slowly(path, pixels, **options):
    original(path, pixels, **options)
    os.write(1, b"written\\n")  # whole, though two threads write pictures
    time.sleep(2)  # a level; whoever is interrupted ends the pictures at hand
export.write_png = slowly
write(sys.argv[3], seed=1)
"""


@pytest.mark.parametrize(
    "number",
    [signal.SIGKILL, *(pytest.param(each, marks=pytest.mark.slow) for each in (signal.SIGTERM, signal.SIGINT))],
    ids=["kill", "term", "int"],
)
def test_a_killed_bake_leaves_what_was_there(tmp_path, number):
    folder = tmp_path / "set"
    write(folder)
    before = contents(folder)
    tests = Path(__file__).parent
    command = [sys.executable, "-c", _SLOW_BAKE, str(tests.parent), str(tests), str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout.readline() == b"written\n"
        # While a run is at work, another one must not sweep its folder away.
        write(folder)
        assert len(list(tmp_path.iterdir())) == 2
        process.send_signal(number)
        process.wait(timeout=20)
    assert process.returncode != 0
    assert contents(folder) == before
    left = [path for path in tmp_path.iterdir() if path != folder]
    assert len(left) == (1 if number == signal.SIGKILL else 0)
    write(folder)
    assert list(tmp_path.iterdir()) == [folder]


def test_a_run_killed_between_two_renames_is_repaired(tmp_path):
    folder = tmp_path / "set"
    write(folder)
    before = contents(folder)
    folder.rename(tmp_path / ".set.brdffit-old-1-0")
    with pytest.raises(ZeroDivisionError), atomic.replacing(folder, lambda _: None):
        raise ZeroDivisionError
    assert contents(folder) == before
    assert list(tmp_path.iterdir()) == [folder]


def test_files_that_are_not_ours_are_not_replaced(tmp_path):
    folder = tmp_path / "set"
    write(folder)
    (folder / "mips" / "notes.txt").write_text("mine")
    before = contents(folder)
    for attempt in (lambda: check_writable(folder), lambda: write(folder, seed=1)):
        with pytest.raises(OutputError, match="holds 'mips/notes.txt', which brdffit did not write"):
            attempt()
    assert contents(folder) == before


@pytest.mark.parametrize("manifest", [None, "", "[]", '{"files": 3, "format": 1}', '{"format": null, "files": {}}'])
def test_a_folder_without_a_manifest_of_ours_is_not_replaced(tmp_path, manifest):
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "holiday.png").write_bytes(b"x")
    if manifest is not None:
        (folder / "manifest.json").write_text(manifest)
    with pytest.raises(OutputError, match=r"holiday\.png"):
        check_writable(folder)


def test_an_empty_folder_is_used(tmp_path):
    folder = tmp_path / "set"
    folder.mkdir()
    check_writable(folder)
    write(folder)
    assert json.loads((folder / "manifest.json").read_text())["name"] == "set"


def test_a_link_to_a_folder_stays_a_link(tmp_path):
    (tmp_path / "disk").mkdir()
    link = tmp_path / "set"
    link.symlink_to(tmp_path / "disk", target_is_directory=True)
    write(link)
    write(link, seed=1)
    assert link.is_symlink() and (tmp_path / "disk" / "normal.exr").exists()


def test_a_file_where_the_folder_should_be(tmp_path):
    (tmp_path / "file").write_text("x")
    for folder, found in ((tmp_path / "file", "is a file"), (tmp_path / "file" / "set", "is a file|Not a directory")):
        with pytest.raises(OutputError, match=found) as raised:
            check_writable(folder)
        assert str(folder) in str(raised.value)
        with pytest.raises(OutputError):
            write(folder)
    assert (tmp_path / "file").read_text() == "x"


@needs_permissions
def test_a_folder_that_may_not_be_written(tmp_path):
    locked = tmp_path / "locked"
    locked.mkdir()
    locked.chmod(0o555)
    with pytest.raises(OutputError, match="Permission denied"):
        check_writable(locked / "set")
    with pytest.raises(OutputError, match="Permission denied"):
        write(locked / "set")


def test_a_system_that_refuses_is_told_in_a_sentence(tmp_path, monkeypatch):
    def refuses(self, *args, **kwargs):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuses)
    with pytest.raises(OutputError, match=r"set' cannot be written: Permission denied\.$"):
        check_writable(tmp_path / "set")


def test_the_room_on_the_disk_is_asked_for_before_the_work(tmp_path):
    check_writable(tmp_path / "set", (64, 64))
    with pytest.raises(OutputError, match=r"needs about \d+ MiB, but its disk has \d+ MiB free"):
        check_writable(tmp_path / "set", (1 << 22, 1 << 22))
    assert not list(tmp_path.iterdir())


def test_checking_leaves_nothing_behind(tmp_path):
    check_writable(tmp_path / "not" / "yet" / "there")
    assert not list(tmp_path.iterdir())
