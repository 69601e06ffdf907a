"""A worker process: reads the next set in a thread while it bakes this one, and ends with the process that started it.

Messages to it: ("read", task), ("drop", key), ("bake", task, threads). From it: one ``Outcome`` for each ("bake", ...).
"""

from __future__ import annotations

import os
import queue
import signal
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from typing import Any, NoReturn

from brdffit.library.task import Outcome, Task


def main(connection: Connection) -> NoReturn:
    """Serve ``connection`` until it closes or SIGTERM comes."""
    # An interrupt is for the parent to decide; SIGTERM unwinds the stack, so that the half-written folder is removed.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _leave)
    inbox: queue.Queue[Any] = queue.Queue()
    threading.Thread(target=_listen, args=(connection, inbox), daemon=True).start()
    code = 0
    try:
        _serve(connection, inbox)
    except SystemExit as leaving:
        code = int(leaving.code or 0)
    except (BrokenPipeError, ConnectionResetError):
        code = 1
    finally:
        os._exit(code)  # without waiting for a read that nobody needs any more


def _leave(number: int, _frame: object) -> NoReturn:
    raise SystemExit(128 + number)


def _listen(connection: Connection, inbox: queue.Queue[Any]) -> None:
    """Put messages into the inbox; end the process when the connection ends, since the parent has then ended."""
    while True:
        try:
            inbox.put(connection.recv())
        except (EOFError, OSError):
            os._exit(1)


def _serve(connection: Connection, inbox: queue.Queue[Any]) -> NoReturn:
    from brdffit.library.bake import bake_set, read_set, sentence_of

    reader = ThreadPoolExecutor(1)
    ahead: dict[str, Future[Any]] = {}
    while True:
        kind, *said = inbox.get()
        if kind == "read":
            ahead[said[0].key] = reader.submit(read_set, said[0])
        elif kind == "drop":
            ahead.pop(said[0]).cancel()
        else:
            task, threads = said
            connection.send(_bake(task, threads, ahead.pop(task.key, None), read_set, bake_set, sentence_of))


def _bake(
    task: Task, threads: int, ahead: Future[Any] | None, read_set: Any, bake_set: Any, sentence_of: Any
) -> Outcome:
    try:
        return bake_set(task, ahead.result() if ahead is not None else read_set(task), threads)
    except Exception as error:
        return Outcome(task.key, sentence_of(error, task))
