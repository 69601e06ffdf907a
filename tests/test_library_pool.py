"""Workers share cores and memory, are replaced when they die, and end with the run that started them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from library_support import make_library, whole_sets, write_maps

from brdffit.library import pool
from brdffit.library.bake import warm_up
from brdffit.library.pool import BYTES_PER_TEXEL, Job, Pool
from brdffit.library.run import run_library
from brdffit.library.task import Found, Outcome, Task
from brdffit.machine import core_count

ROOT = Path(__file__).parent.parent


def job(index, texels):
    task = Task(Found(f"set{index:03}", Path("set")), "", {}, "naive", "plain", 8, "good", {}, "")
    return Job(task, texels)


class Simulated:
    """Workers without processes: a set takes time in proportion to its texels over its threads; some die."""

    def __init__(self, deaths=()):
        self.deaths, self.clock, self.running, self.log, self.read = dict(deaths), 0.0, {}, [], set()

    def pool(self, cores, workers, memory):
        simulated, made = self, Pool(cores, workers, memory)

        class Worker:
            def __init__(self, context):
                self.pipe, self.now, self.next = self, None, None
                self.process = self
                self.exitcode = -9

            def tell(self, kind, said, *threads):
                if kind == "bake":
                    assert self.now is not None and self.now.task is said
                    simulated.running[self] = (simulated.clock + self.now.texels / threads[0], self.now)
                    busy = [each.now for each in made.workers if each.now is not None]
                    reserved = made._reserved()
                    assert sum(each.threads for each in busy) <= cores
                    assert reserved <= memory or len(busy) == 1
                    simulated.log.append((said.key, threads[0], len(busy)))
                elif kind == "read":
                    assert said.key not in simulated.read
                    simulated.read.add(said.key)
                elif kind == "drop":
                    simulated.read.remove(said)

            def recv(self):
                self_until, current = simulated.running.pop(self)
                simulated.clock = self_until
                if simulated.deaths.get(current.task.key, 0) > 0:
                    simulated.deaths[current.task.key] -= 1
                    simulated.read -= {self.next.task.key} if self.next else set()
                    raise EOFError
                return Outcome(current.task.key, None, current.texels)

            def join(self, *_):
                pass

            def is_alive(self):
                return False

            def close(self):
                pass

        return made, Worker

    def run(self, monkeypatch, jobs, cores, workers, memory):
        made, worker = self.pool(cores, workers, memory)
        monkeypatch.setattr(pool, "Worker", worker)
        monkeypatch.setattr(pool.pipes, "wait", lambda _: [min(self.running, key=lambda each: self.running[each][0])])
        return list(made.run(jobs))


SIZES = st.lists(st.integers(1, 10_000), min_size=1, max_size=30)


@settings(max_examples=150, deadline=None)
@given(SIZES, st.integers(1, 8), st.integers(1, 10), st.integers(1, 40_000))
def test_cores_and_memory_are_never_taken_twice_and_all_is_done(sizes, cores, workers, room):
    """The simulated worker asserts the first at each start; a set larger than the room runs alone."""
    jobs = [job(index, texels) for index, texels in enumerate(sizes)]
    with pytest.MonkeyPatch.context() as patch:
        simulated = Simulated()
        outcomes = simulated.run(patch, jobs, cores, workers, room * BYTES_PER_TEXEL)
    assert sorted(outcome.key for outcome in outcomes) == [each.task.key for each in jobs]
    assert not [outcome for outcome in outcomes if outcome.error]
    assert len(simulated.log) == len(jobs)


@settings(max_examples=100, deadline=None)
@given(SIZES, st.integers(1, 4), st.data())
def test_whoever_dies_all_is_tried_and_ends(sizes, cores, data):
    jobs = [job(index, texels) for index, texels in enumerate(sizes)]
    deaths = {each.task.key: data.draw(st.integers(0, 4)) for each in jobs}
    with pytest.MonkeyPatch.context() as patch:
        outcomes = Simulated(deaths).run(patch, jobs, cores, cores, 20_000 * BYTES_PER_TEXEL)
    assert sorted(outcome.key for outcome in outcomes) == [each.task.key for each in jobs]
    failed = {outcome.key for outcome in outcomes if outcome.error}
    assert failed == {key for key, count in deaths.items() if count >= pool.ATTEMPTS}
    assert all("died 3 times (by SIGKILL)" in outcome.error for outcome in outcomes if outcome.error)


def test_a_giant_gets_the_cores_and_small_sets_one_each(monkeypatch):
    simulated = Simulated()
    simulated.run(monkeypatch, [job(0, 900), *(job(1 + i, 10) for i in range(40))], 8, 8, 1000 * BYTES_PER_TEXEL)
    threads = {key: count for key, count, _ in simulated.log}
    assert threads["set000"] == 7 and threads["set001"] == 1
    assert max(busy for *_, busy in simulated.log) == 8


def test_a_lonely_set_gets_all_cores(monkeypatch):
    simulated = Simulated()
    simulated.run(monkeypatch, [job(0, 10)], 6, 6, 10**9)
    assert simulated.log == [("set000", 6, 1)]


def test_a_set_with_no_room_on_this_machine_is_told_and_the_rest_is_baked(tmp_path):
    make_library(tmp_path / "in", count=2)
    write_maps(tmp_path / "in" / "giant", size=64)
    overhead = core_count() * pool.BYTES_PER_WORKER
    memory = overhead + 1024 * BYTES_PER_TEXEL
    plan = run_library(tmp_path / "in", tmp_path / "out", dry_run=True, memory=memory).plan
    assert set(plan.failures) == {"giant"} and set(plan.reasons) == {"deep/set0", "set1"}
    assert "is 64x64 and needs about" in plan.failures["giant"]


@pytest.fixture
def with_odd_one(tmp_path, monkeypatch):
    """A library with a set on which the methods of library_support misbehave."""
    monkeypatch.setenv("BRDFFIT_TEST_FLAG", str(tmp_path / "flag"))
    make_library(tmp_path / "in", count=3)
    write_maps(tmp_path / "in" / "odd", size=9)
    return tmp_path


@pytest.mark.slow
def test_a_worker_that_dies_is_replaced_and_its_set_tried_again(with_odd_one):
    summary = run_library(with_odd_one / "in", with_odd_one / "out", method="library_support:DiesOnce", workers=2)
    assert not summary.failures and len(summary.outcomes) == 4
    assert (with_odd_one / "flag").exists()
    assert not list((with_odd_one / "out").rglob(".*"))


def test_a_set_that_kills_its_workers_is_set_aside(with_odd_one):
    summary = run_library(with_odd_one / "in", with_odd_one / "out", method="library_support:DiesAlways", workers=2)
    assert set(summary.failures) == {"odd"} and "died 3 times (by SIGKILL)" in summary.failures["odd"]
    assert len(summary.outcomes) == 4 and not list((with_odd_one / "out").rglob(".*"))


@pytest.mark.slow
def test_an_error_of_the_program_stops_one_set_alone(with_odd_one):
    summary = run_library(with_odd_one / "in", with_odd_one / "out", method="library_support:Fails", workers=2)
    assert set(summary.failures) == {"odd"}
    assert "ZeroDivisionError: an error of the program" in summary.failures["odd"]


def start(folder, *options):
    """A run in a process of its own."""
    arguments = ["library", folder / "in", "-o", folder / "out", "--method", "lean", "--set", "levels=2", *options]
    # Background jobs of a shell ignore SIGINT, and children inherit that: an interrupt would do nothing.
    program = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "from brdffit.cli import main; sys.argv[0] = 'brdffit'; main()"
    )
    command = [sys.executable, "-c", program, *map(str, arguments)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def children_of(process: int) -> list[int]:
    return [int(found) for found in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


def wait_for(condition, seconds=60.0):
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


needs_proc = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="children are found by /proc")


@needs_proc
@pytest.mark.parametrize(
    "number",
    [signal.SIGTERM, *(pytest.param(each, marks=pytest.mark.slow) for each in (signal.SIGINT, signal.SIGKILL))],
    ids=lambda number: number.name,
)
def test_no_worker_outlives_its_run_and_only_whole_sets_are_left(tmp_path, number):
    make_library(tmp_path / "in", count=60, size=16)
    process = start(tmp_path)
    # The kernels may have to be compiled first.
    wait_for(lambda: process.poll() is not None or whole_sets(tmp_path / "out") > 2, seconds=600.0)
    assert process.poll() is None, process.communicate()
    workers = children_of(process.pid)
    assert len(workers) >= 2
    process.send_signal(number)
    process.communicate(timeout=60)
    assert process.returncode == {signal.SIGTERM: 143, signal.SIGINT: 130, signal.SIGKILL: -9}[number]
    wait_for(lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers), seconds=20)
    assert 2 < whole_sets(tmp_path / "out") < 60
    if number != signal.SIGKILL:  # after which the next run sweeps
        assert not list((tmp_path / "out").rglob(".*"))
        assert (tmp_path / "out" / "library.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["bfgs", "lean"])
def test_the_estimate_of_memory_holds(tmp_path, method):
    """Peak of a process that bakes one set, against what the pool reckons with."""
    if not Path("/proc/self/status").exists():
        pytest.skip("the peak of a process is told by /proc (getrusage would tell that of the tests' own before it)")
    side = 512
    # Compiling takes more memory than a bake: the process that is measured is to find the kernels compiled.
    warm_up({(method, "ggx")})
    write_maps(
        tmp_path / "in" / "large", size=side, roles=("NormalGL", "Color", "Roughness", "AO", "Metallic", "Height")
    )
    program = (
        "import sys; from pathlib import Path; from brdffit.library import bake, run;"
        "options = {'method': sys.argv[3]} | ({'quality': 'draft'} if sys.argv[3] == 'bfgs' else {});"
        "tasks = run._tasks(Path(sys.argv[1]), sys.argv[2], None, options);"
        "task = tasks['large']; bake.warm_up({(sys.argv[3], 'ggx')});"
        "read = bake.read_set(task);"
        "bake.bake_set(task, read, 1);"
        "print(Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[0])"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "in"), str(tmp_path / "out"), method]
    result = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT)
    assert 1024 * int(result.stdout) < pool.BYTES_PER_WORKER + side * side * BYTES_PER_TEXEL
