"""Workers of this machine: who bakes what, on how many threads, and what happens when one dies.

Sets go out largest first, so that none is left alone at the end. A set takes its share of the memory, by an estimate,
and the same share of the cores: a large one runs nearly alone on many threads, small ones run one a core. A worker that
dies is replaced; its set is tried again twice, each time with twice the memory and with no other set read ahead beside
it, then set aside.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import connection as pipes
from typing import Any

from brdffit.library import worker as worker_process
from brdffit.library.task import Outcome, Task

#: Peak memory of a bake in bytes: a texel of level 0, and a worker as such; a test measures that both are enough.
BYTES_PER_TEXEL, BYTES_PER_WORKER = 240, 400 << 20
ATTEMPTS = 3
#: Seconds that a worker has to leave before it is killed.
_PATIENCE = 10.0


@dataclass
class Job:
    """A task with what it needs."""

    task: Task
    texels: int
    attempts: int = 0
    alone: bool = False
    threads: int = 1

    @property
    def memory(self) -> int:
        """Estimated peak in bytes; a set whose worker died may have been short of it."""
        return self.texels * BYTES_PER_TEXEL << self.attempts


class Worker:
    """A process, the job that it bakes, and the next one, which it reads meanwhile."""

    def __init__(self, context: Any) -> None:
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=worker_process.main, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()  # or the end of the process would not end the connection
        self.now: Job | None = None
        self.next: Job | None = None

    def tell(self, *message: Any) -> None:
        """Send a message; a dead worker is seen elsewhere."""
        try:
            self.pipe.send(message)
        except (BrokenPipeError, ConnectionResetError):
            pass


class Pool:
    """Workers that bake jobs.

    Args:
        cores: to be used at once.
        workers: most processes.
        memory: bytes that all sets in work may take together, by estimate.
    """

    def __init__(self, cores: int, workers: int, memory: int) -> None:
        self.cores, self.most, self.memory = cores, max(1, min(workers, cores)), memory
        self.workers: list[Worker] = []
        self.pending: list[Job] = []

    def run(self, jobs: Sequence[Job]) -> Generator[Outcome, None, None]:
        """Bake all; outcomes are yielded as jobs end. However it ends, no worker process is left."""
        self.pending = sorted(jobs, key=lambda job: (-job.texels, job.task.key))
        context = multiprocessing.get_context("spawn")
        try:
            with _one_thread_each():
                self.workers = [Worker(context) for _ in range(min(self.most, len(jobs)))]
                left = len(jobs)
                while left:
                    self._hand_out()
                    for outcome in self._listen(context):
                        left -= 1
                        yield outcome
        finally:
            self._stop()

    def _reserved(self) -> int:
        return sum(job.memory for worker in self.workers for job in (worker.now, worker.next) if job is not None)

    def _hand_out(self) -> None:
        for worker in self.workers:
            free = self.cores - sum(other.now.threads for other in self.workers if other.now is not None)
            if worker.now is None and free > 0:
                job = worker.next or self._take() or self._steal()
                if job is None:
                    continue
                worker.next = None
                # Cores in proportion to memory; when little is left to do, what is free is shared out.
                share = round(self.cores * job.memory / self.memory)
                waiting = len(self.pending) + sum(other.next is not None for other in self.workers)
                job.threads = max(1, min(free, max(share, free // (1 + waiting))))
                worker.now = job
                worker.tell("bake", job.task, job.threads)
        busy = [worker for worker in self.workers if worker.now is not None and worker.next is None]
        for worker in busy:
            # Not near the end: a set that is read ahead would wait for its worker while another is free for it.
            if len(self.pending) < len(self.workers) or worker.now is None or worker.now.alone:
                continue
            worker.next = self._take(ahead=True)
            if worker.next is not None:
                worker.tell("read", worker.next.task)

    def _take(self, ahead: bool = False) -> Job | None:
        """The largest pending job whose memory fits; larger ones wait until memory is free."""
        room = self.memory - self._reserved()
        idle = not ahead and not any(worker.now for worker in self.workers)
        for index, job in enumerate(self.pending):
            if (job.memory <= room or idle) and not (ahead and job.alone):
                return self.pending.pop(index)
        return None

    def _steal(self) -> Job | None:
        """Take a job that a busy worker has read ahead but not begun."""
        for other in self.workers:
            if other.now is not None and other.next is not None:
                job, other.next = other.next, None
                other.tell("drop", job.task.key)
                return job
        return None

    def _listen(self, context: Any) -> Iterator[Outcome]:
        """Wait for any worker; yields the outcomes of jobs that were finished or given up."""
        by_pipe = {worker.pipe: worker for worker in self.workers}
        for pipe in pipes.wait(list(by_pipe)):
            worker = by_pipe[pipe]  # type: ignore[index]
            try:
                outcome = worker.pipe.recv()
                worker.now = None
                yield outcome
            except (EOFError, OSError):
                self.workers[self.workers.index(worker)] = Worker(context)
                yield from self._died(worker)

    def _died(self, worker: Worker) -> Iterator[Outcome]:
        worker.process.join()
        worker.pipe.close()
        if worker.next is not None:
            # Reading it may have killed the worker: it is not read beside another set again.
            worker.next.alone = True
            self.pending.append(worker.next)
        job = worker.now
        if job is None:
            return
        job.attempts, job.alone = job.attempts + 1, True
        if job.attempts < ATTEMPTS:
            self.pending.append(job)
            return
        yield Outcome(
            job.task.key,
            f"'{job.task.found.source}' was set aside: its worker died {ATTEMPTS} times "
            f"({_end(worker.process.exitcode)}); it may need more memory than there is.",
        )

    def _stop(self) -> None:
        for worker in self.workers:
            if worker.now is None:
                worker.pipe.close()
            elif worker.process.is_alive():
                worker.process.terminate()
        until = time.monotonic() + _PATIENCE
        for worker in self.workers:
            worker.process.join(max(0.0, until - time.monotonic()))
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
            worker.pipe.close()
        self.workers = []


def _end(code: int | None) -> str:
    if code is not None and code < 0:
        try:
            return f"by {signal.Signals(-code).name}"
        except ValueError:
            return f"by signal {-code}"
    return f"exit code {code}"


class _one_thread_each:
    """Libraries with threads of their own take one in each worker: threads are shared out here."""

    _NAMES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENIMAGEIO_THREADS", "NUMBA_NUM_THREADS")

    def __enter__(self) -> None:
        self.before = {name: os.environ.get(name) for name in self._NAMES}
        os.environ.update(dict.fromkeys(self._NAMES, "1"))

    def __exit__(self, *error: object) -> None:
        for name, value in self.before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def memory_limit() -> int:
    """Bytes that a library may take: four fifths of what the machine, or its control group, has."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else 8 << 30
    for file in ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"):
        try:
            with open(file, encoding="ascii") as limit:
                total = min(total, int(limit.read()))
        except (OSError, ValueError):
            continue
    return total * 4 // 5
