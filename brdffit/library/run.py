"""A run over a library: find the sets, decide which must be baked, bake them, and write the record."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Protocol

from brdffit.errors import BrdffitError, InputError
from brdffit.files.atomic import terminated_as_exit
from brdffit.library.bake import open_set, warm_up
from brdffit.library.discovery import find_sets
from brdffit.library.page import write_page
from brdffit.library.pool import BYTES_PER_TEXEL, BYTES_PER_WORKER, Job, Pool, memory_limit
from brdffit.library.record import write_record
from brdffit.library.settings import Common, read_settings, split_options
from brdffit.library.state import code_digest, reason_to_bake
from brdffit.library.store import manifest_of, open_store
from brdffit.library.task import Found, Outcome, Task
from brdffit.machine import core_count
from brdffit.methods import get_method
from brdffit.options import refuse_unknown


class Listener(Protocol):
    """Receives the progress of a run."""

    def phase(self, name: str) -> None:
        """A phase begins: looking, compiling, baking."""

    def planned(self, plan: Plan) -> None:
        """The plan is made."""

    def finished(self, outcome: Outcome, sizes: Mapping[str, tuple[int, int]]) -> None:
        """A set is baked or set aside; ``sizes`` of all sets to be baked."""


@dataclass
class Plan:
    """What a run would do.

    Attributes:
        tasks: every set of the library, by key.
        reasons: for each set to be baked in this run, why.
        skipped: sets whose output is what would be written.
        sizes: (height, width) of each set to be baked.
        failures: sentences of sets that cannot be baked, by key.
    """

    tasks: dict[str, Task]
    reasons: dict[str, str] = field(default_factory=dict)
    skipped: list[str] = field(default_factory=list)
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)


@dataclass
class Summary:
    """What a run did.

    Attributes:
        plan: what it set out to do.
        outcomes: of the sets it tried, as they ended.
        failures: sentences by key.
        seconds: wall-clock seconds of baking, without looking and compiling.
    """

    plan: Plan
    outcomes: list[Outcome]
    failures: dict[str, str]
    seconds: float

    @property
    def texels(self) -> int:
        """Texels of all levels that were baked."""
        return sum(outcome.texels for outcome in self.outcomes)


def run_library(
    root: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    settings: str | os.PathLike[str] | None = None,
    only: Sequence[str] = (),
    shard: tuple[int, int] | None = None,
    force: bool = False,
    dry_run: bool = False,
    workers: int | None = None,
    memory: int | None = None,
    scheduler: str | None = None,
    listener: Listener | None = None,
    **options: Any,
) -> Summary:
    """Bake the sets below ``root`` into OUT/<place of the set>, but for those that are up to date.

    Args:
        root: folder of the library.
        output: folder, or an address that fsspec knows.
        settings: a file as ROOT/library.toml, which is the default.
        only: patterns (fnmatch); only sets whose place matches one are looked at.
        shard: (i, n), 1 <= i <= n: only each n-th set, from the i-th; n runs with all i make the whole.
        force: bake all, up to date or not.
        dry_run: plan only; nothing is written.
        workers: worker processes; None takes one a core.
        memory: bytes that all work may take; None takes four fifths of the machine's.
        scheduler: address of a Dask scheduler that does the work instead.
        listener: receives the progress.
        options: as of ``brdffit.pipeline.bake_to_folder``; they win over the settings.

    Returns:
        What was done; it also holds the sets that failed, which do not stop the run.

    Raises:
        InputError: for a root, settings or a scheduler that cannot be used.
        OutputError: when library.json or index.html cannot be written.
    """
    address = os.fspath(output) if "://" in os.fspath(output) else str(Path(output).resolve())
    store = open_store(address)
    tell = listener or _Silent()
    with terminated_as_exit():
        tell.phase("looking")
        if not dry_run:
            store.sweep()
        tasks = _tasks(Path(root), address, settings, options)
        chosen = [key for key in tasks if not only or any(fnmatchcase(key, pattern) for pattern in only)]
        if not chosen:
            raise InputError(
                f"None of the {len(tasks)} sets of '{root}' has a place that matches {', '.join(only)}; places are "
                f"like '{next(iter(tasks))}'."
            )
        if shard is not None:
            chosen = chosen[shard[0] - 1 :: shard[1]]
        plan = _plan(tasks, chosen, store, force)
        cores = core_count()
        count = min(workers or cores, cores)
        most = (memory or memory_limit()) - count * BYTES_PER_WORKER
        if scheduler is None:
            _refuse_giants(plan, most)
        tell.planned(plan)
        outcomes: list[Outcome] = []
        failures, seconds = dict(plan.failures), 0.0
        if dry_run:
            return Summary(plan, outcomes, failures, seconds)
        jobs = [Job(tasks[key], plan.sizes[key][0] * plan.sizes[key][1]) for key in plan.reasons]
        start = time.perf_counter()
        try:
            if jobs:
                tell.phase("compiling")
                warm_up({(job.task.method, job.task.options.get("model")) for job in jobs})
                tell.phase("baking")
                start = time.perf_counter()
                bake = _on_cluster(scheduler) if scheduler else Pool(cores, count, most).run
                with contextlib.closing(bake(jobs)) as results:
                    for outcome in results:
                        outcomes.append(outcome)
                        if outcome.error is not None:
                            failures[outcome.key] = outcome.error
                        tell.finished(outcome, plan.sizes)
        finally:
            # Also of a run that is interrupted: both are made from what lies in the folders.
            seconds = time.perf_counter() - start
            store.sweep()
            with store.alone():
                record = write_record(store, tasks, chosen, failures)
                write_page(store, record, {key: str(task.found.source) for key, task in tasks.items()})
    return Summary(plan, outcomes, failures, seconds)


def _tasks(
    root: Path, address: str, settings_file: str | os.PathLike[str] | None, options: Mapping[str, Any]
) -> dict[str, Task]:
    """Every set of the library with its options, by key."""
    settings = read_settings(None if settings_file is None else Path(settings_file), root)
    output = None if "://" in address else Path(address)
    if output == root.resolve():
        raise InputError(f"'{root}' is both the library and its output, expected another folder to write into.")
    split: dict[str, dict[str, Any]] = {}

    def of(found: Found) -> Task:
        said = settings.of(found, dict(options))
        same = json.dumps(said, sort_keys=True)
        if same not in split:
            split[same] = split_options(said)
        return Task(
            found=found,
            output=address,
            code=code_digest(split[same]["method"], split[same]["options"].get("model")),
            **split[same],
        )

    tasks = {found.key: of(found) for found in find_sets(root.resolve(), output, settings.is_left_out)}
    own = {name: value for name, value in options.items() if name not in Common.__struct_fields__}
    refuse_unknown({task.method: get_method(task.method).options for task in tasks.values()}, own)
    if not tasks:
        raise InputError(f"'{root}' holds no texture set, expected folders of textures such as Name_NormalGL.png.")
    return tasks


def _plan(tasks: dict[str, Task], chosen: Sequence[str], store: Any, force: bool) -> Plan:
    """Look at each chosen set: is it up to date, and if not, how large is it?"""
    plan = Plan(tasks)

    def look(key: str) -> tuple[str | None, tuple[int, int], str | None]:
        try:
            manifest = manifest_of(store, key)
            reason = reason_to_bake(tasks[key], manifest, lambda name: store.size(f"{key}/{name}"))
            if reason is None and force:
                reason = "forced"
            return reason, _size(tasks[key]) if reason else (0, 0), None
        except BrdffitError as error:
            return None, (0, 0), str(error)

    with ThreadPoolExecutor(2 * core_count()) as threads:
        for key, (reason, size, error) in zip(chosen, threads.map(look, chosen), strict=True):
            if error is not None:
                plan.failures[key] = error
            elif reason is None:
                plan.skipped.append(key)
            else:
                plan.reasons[key], plan.sizes[key] = reason, size
    return plan


def _size(task: Task) -> tuple[int, int]:
    """(height, width) by the headers alone: with Y given, no pixel is looked at."""
    return open_set(replace(task, reading={**task.reading, "normal_y": "gl"})).size


def _refuse_giants(plan: Plan, memory: int) -> None:
    """Fail sets that this machine has no memory for before the run, instead of losing their workers in it."""
    for key, (height, width) in list(plan.sizes.items()):
        needed = height * width * BYTES_PER_TEXEL
        if needed > memory:
            plan.failures[key] = (
                f"'{plan.tasks[key].found.source}' is {width}x{height} and needs about {needed / 2**30:.1f} GiB of "
                f"memory, expected at most {memory / 2**30:.1f} GiB: bake it on a larger machine, or raise --memory."
            )
            del plan.sizes[key], plan.reasons[key]


def _on_cluster(scheduler: str) -> Callable[[Sequence[Job]], Generator[Outcome, None, None]]:
    from brdffit.library.cluster import run_on_cluster

    return lambda jobs: run_on_cluster(scheduler, jobs)


class _Silent:
    """Nobody listens."""

    def phase(self, name: str) -> None: ...
    def planned(self, plan: Plan) -> None: ...
    def finished(self, outcome: Outcome, sizes: Mapping[str, tuple[int, int]]) -> None: ...
