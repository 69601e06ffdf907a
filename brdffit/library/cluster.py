"""The same work on many machines, by a Dask scheduler that the user has started.

Root and output must be the same places for all machines (a shared folder, or an address that fsspec knows). A task
takes one thread, for a Dask worker runs as many tasks at once as it has threads.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import TYPE_CHECKING

from brdffit.errors import InputError
from brdffit.library.bake import bake_set, read_set, sentence_of, warm_up
from brdffit.library.pool import Job
from brdffit.library.task import Outcome, Task

if TYPE_CHECKING:
    from distributed import Client

#: Seconds to wait for the scheduler to answer.
_TIMEOUT = 20


def run_on_cluster(scheduler: str, jobs: Sequence[Job]) -> Generator[Outcome, None, None]:
    """Bake all jobs by the workers of a Dask scheduler; outcomes are yielded as tasks end.

    Dask itself repeats the task of a lost worker, at most as often as its setting ``allowed-failures`` says.

    Raises:
        InputError: when Dask is not installed, or the scheduler does not answer.
    """
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        raise InputError("A scheduler needs Dask, which is not installed: pip install 'brdffit[cluster]'.") from error
    try:
        client = Client(scheduler, timeout=_TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"The scheduler '{scheduler}' does not answer ({type(error).__name__}), expected the address of a Dask "
            "scheduler such as tcp://host:8786."
        ) from error
    with client:
        _warm_up(client, {(job.task.method, job.task.options.get("model")) for job in jobs})
        largest_first = sorted(jobs, key=lambda job: (-job.texels, job.task.key))
        futures = {
            client.submit(
                _bake, job.task, key=f"brdffit-{job.task.key}-{id(job)}", pure=False, priority=-place
            ): job.task
            for place, job in enumerate(largest_first)
        }
        try:
            for future in as_completed(list(futures), loop=client.loop):
                task = futures.pop(future)
                failure = future.exception()
                if failure is None:
                    yield future.result()
                else:
                    yield Outcome(
                        task.key,
                        f"'{task.found.source}' was set aside: the cluster could not bake it "
                        f"({type(failure).__name__}: {' '.join(str(failure).split())[:200]}).",
                    )
                future.release()
        finally:
            client.cancel(list(futures))


def _warm_up(client: Client, methods_and_models: set[tuple[str, str | None]]) -> None:
    """Compile on one worker of each machine first: workers that start together would each compile the same kernels."""
    hosts: dict[str, str] = {}
    for address, worker in client.scheduler_info(n_workers=-1)["workers"].items():
        hosts.setdefault(worker["host"], address)
    warming = [
        client.submit(warm_up, methods_and_models, workers=[address], allow_other_workers=True, pure=False)
        for address in hosts.values()
    ]
    client.gather(warming, errors="skip")


def _bake(task: Task) -> Outcome:
    """On a worker."""
    try:
        return bake_set(task, read_set(task), threads=1)
    except Exception as error:
        return Outcome(task.key, sentence_of(error, task))
