"""What a library must survive: kills at random moments, a cluster that loses workers, a thousand sets."""

from __future__ import annotations

import json
import os
import random
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from library_support import contents, make_library, whole_sets, write_maps

from brdffit.errors import InputError
from brdffit.library.run import run_library

ROOT = Path(__file__).parent.parent
resource = pytest.importorskip("resource")
QUICK = {"quality": "draft", "levels": 2}
OPTIONS = ["--quality", "draft", "--set", "levels=2"]
LEAN = ["--method", "lean", "--set", "levels=2"]  # a closed form knows no quality
KILLS = 20


def start(root, output, *options, usual=OPTIONS):
    program = "import sys; from brdffit.cli import main; sys.argv[0] = 'brdffit'; main()"
    command = [sys.executable, "-c", program, "library", root, "-o", output, *usual, *options]
    environment = os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{Path(__file__).parent}"}
    return subprocess.Popen(
        [str(part) for part in command], env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )


def workers_of(process: int) -> list[int]:
    """Worker processes, without the tracker of resources that Python starts beside them."""
    found = []
    for child in Path(f"/proc/{process}/task/{process}/children").read_text().split():
        try:
            if "spawn_main" in Path(f"/proc/{child}/cmdline").read_text():
                found.append(int(child))
        except OSError:
            continue
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="workers are found by /proc")
def test_killed_again_and_again_it_ends_with_the_same_bytes(tmp_path):
    """SIGKILL of the run, and of a worker, at random moments, KILLS times each; then an undisturbed end."""
    make_library(tmp_path / "in", count=40, size=16)
    run_library(tmp_path / "in", tmp_path / "undisturbed", **QUICK)
    began = time.perf_counter()
    assert start(tmp_path / "in", tmp_path / "timed").wait() == 0
    whole = time.perf_counter() - began
    moments, output = random.Random(6), tmp_path / "out"
    killed = {"run": 0, "worker": 0}
    progress = []
    while killed["run"] < KILLS:
        again = ["--force"] if moments.random() < 0.5 else []
        process = start(tmp_path / "in", output, *again)
        try:
            while not workers_of(process.pid) and process.poll() is None:
                time.sleep(0.02)
            for _ in range(moments.randrange(3)):
                time.sleep(moments.uniform(0.0, 1.5))
                workers = workers_of(process.pid) if process.poll() is None else []
                if workers:
                    os.kill(moments.choice(workers), signal.SIGKILL)
                    killed["worker"] += 1
            time.sleep(moments.uniform(0.0, 2.0))
            if process.poll() is None:
                process.kill()
                killed["run"] += 1
        finally:
            process.kill()
            process.communicate()
        progress.append(whole_sets(output))
    assert killed["worker"] >= KILLS // 2
    summary = run_library(tmp_path / "in", output, **QUICK)
    assert not summary.failures
    assert contents(output) == contents(tmp_path / "undisturbed")
    assert not [path for path in output.rglob("*") if path.name.startswith(".")]
    # On a busy machine a run is killed before its first set is done, every time.
    assert max(progress) > 0 or whole > 5.0


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="workers are found by /proc")
def test_a_run_gets_on_though_its_workers_are_killed(tmp_path):
    """One run, whose workers die every second: it ends by itself, and all is baked."""
    make_library(tmp_path / "in", count=30, size=16)
    run_library(tmp_path / "in", tmp_path / "undisturbed", **QUICK)
    process = start(tmp_path / "in", tmp_path / "out")
    killed, moments = 0, random.Random(7)
    while process.poll() is None:
        time.sleep(moments.uniform(0.5, 1.5))
        workers = workers_of(process.pid) if process.poll() is None and killed < KILLS else []
        if workers:
            os.kill(moments.choice(workers), signal.SIGKILL)
            killed += 1
    said, _ = process.communicate()
    record = json.loads((tmp_path / "out" / "library.json").read_text())
    # Three deaths at one set are possible, if unlikely: then it is named.
    assert killed >= 2 and process.returncode == (1 if record["failed"] else 0), said
    assert len(record["sets"]) + len(record["failed"]) == 30
    run_library(tmp_path / "in", tmp_path / "out", **QUICK)
    assert contents(tmp_path / "out") == contents(tmp_path / "undisturbed")


def test_a_scheduler_that_does_not_answer(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    from brdffit.library import cluster

    monkeypatch.setattr(cluster, "_TIMEOUT", 0.5)
    make_library(tmp_path / "in", count=1)
    with pytest.raises(InputError, match=r"'tcp://127.0.0.1:9' does not answer .* expected the address of a Dask"):
        run_library(tmp_path / "in", tmp_path / "out", method="lean", levels=1, scheduler="tcp://127.0.0.1:9")


def test_dask_is_optional(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    make_library(tmp_path / "in", count=1)
    with pytest.raises(InputError, match=r"needs Dask, which is not installed: pip install 'brdffit\[cluster\]'"):
        run_library(tmp_path / "in", tmp_path / "out", method="lean", levels=1, scheduler="tcp://127.0.0.1:9")


@pytest.fixture
def cluster(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), str(Path(__file__).parent)]))
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
    ) as started:
        yield started


@pytest.mark.slow
@pytest.mark.parametrize("kill", [False, True], ids=["undisturbed", "a worker killed"])
def test_a_cluster_gives_the_same_bytes(tmp_path, cluster, kill):
    make_library(tmp_path / "in", count=12, size=16)
    write_maps(tmp_path / "in" / "flat", roles=("Color", "Roughness"))
    local = run_library(tmp_path / "in", tmp_path / "local", **QUICK)

    class KillOne:
        killed = 0

        def phase(self, name): ...
        def planned(self, plan): ...
        def finished(self, outcome, sizes):
            if kill and not self.killed:
                self.killed = next(iter(cluster.workers.values())).pid
                os.kill(self.killed, signal.SIGKILL)

    listener = KillOne()
    remote = run_library(
        tmp_path / "in", tmp_path / "out", scheduler=cluster.scheduler_address, listener=listener, **QUICK
    )
    assert bool(listener.killed) == kill
    assert set(remote.failures) == set(local.failures) == {"flat"}
    assert len(remote.outcomes) == 12
    assert contents(tmp_path / "out") == contents(tmp_path / "local")


@pytest.mark.slow
def test_what_a_dask_worker_cannot_bake_is_named(tmp_path, cluster):
    """A set that kills its worker each time: Dask gives it up, the others are baked."""
    cluster.scheduler.allowed_failures = 1
    make_library(tmp_path / "in", count=3)
    write_maps(tmp_path / "in" / "odd", size=9)
    options = {"method": "library_support:DiesAlways", "levels": 1}
    summary = run_library(tmp_path / "in", tmp_path / "out", scheduler=cluster.scheduler_address, **options)
    assert set(summary.failures) == {"odd"} and "KilledWorker" in summary.failures["odd"]
    assert len(summary.outcomes) == 4


#: Single bakes of a library, one after another: what its sets cost without it.
ONE_BY_ONE = """
import sys
from pathlib import Path
from brdffit.pipeline import bake_to_folder
for path in sorted(Path(sys.argv[1]).rglob("*_Color.png")):
    bake_to_folder(path.parent, sys.argv[2], preview=False, method="lean", levels=2, threads=1)
"""


def seconds_of_children():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="memory is told by /proc")
def test_many_small_sets_take_flat_memory_and_little_beside_their_bakes(tmp_path):
    """Memory does not grow with the sets that are done; a set costs less than 50 ms of a processor beside its bake.

    Processor time, for other programs on the machine do not change it; what a run of one set takes is told apart, for
    it is the start of processes. BRDFFIT_MANY says how many sets.
    """
    many = int(os.environ.get("BRDFFIT_MANY", "200"))
    make_library(tmp_path / "in", count=many)
    before = seconds_of_children()
    start(tmp_path / "in", tmp_path / "one", "--only", "set1", usual=LEAN).communicate()
    starting = seconds_of_children() - before
    before, clock = seconds_of_children(), time.perf_counter()
    process = start(tmp_path / "in", tmp_path / "out", usual=LEAN)
    sizes: list[int] = []
    while process.poll() is None:
        try:
            pids = [process.pid, *workers_of(process.pid)]
            pages = [int(Path(f"/proc/{pid}/statm").read_text().split()[1]) for pid in pids]
        except (OSError, IndexError):
            continue
        if whole_sets(tmp_path / "out") >= 40:
            sizes.append(sum(pages) * os.sysconf("SC_PAGE_SIZE"))
        time.sleep(0.5)
    process.communicate()
    wall, library = time.perf_counter() - clock, seconds_of_children() - before
    assert process.returncode == 0 and len(sizes) > 5
    command = [sys.executable, "-c", ONE_BY_ONE, str(tmp_path / "in"), str(tmp_path / "alone")]
    subprocess.run(command, check=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    alone = seconds_of_children() - before - library
    overhead = (library - starting - alone) / many
    early, late = max(sizes[: len(sizes) // 2]), max(sizes[len(sizes) // 2 :])
    sys.stdout.write(
        f"\n{many} sets: {wall:.1f} s; {1000 * overhead:.1f} ms of a processor a set beside its bake, "
        f"{1000 * (overhead + starting / many):.1f} with the start of processes; "
        f"memory {early / 2**20:.0f} MiB in the first half, {late / 2**20:.0f} MiB in the second\n"
    )
    assert overhead < 0.05
    assert late < 1.05 * early


@pytest.mark.slow
def test_the_cluster_of_the_documentation(tmp_path):
    pytest.importorskip("distributed")
    text = (ROOT / "docs" / "cluster.md").read_text(encoding="utf-8")
    (program,) = re.findall(r"```python\n(.*?)```", text, re.S)
    (command,) = [line for line in text.splitlines() if line.startswith("brdffit library data/sets")]
    make_library(tmp_path / "data" / "sets", count=2)
    (tmp_path / "cluster.py").write_text(program)
    started = subprocess.Popen(
        [sys.executable, "cluster.py"], cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert started.stdout is not None
        address = started.stdout.readline().strip()
        words = shlex.split(command.replace("tcp://127.0.0.1:8786", address))
        words[0] = str(Path(sys.executable).parent / words[0])
        result = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
        assert "2 sets baked" in result.stdout
    finally:
        started.communicate("\n", timeout=60)
