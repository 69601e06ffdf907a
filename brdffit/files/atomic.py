"""Replacing an output folder as a whole: at each moment the old one or the new one is there, never a half.

Everything is written under a hidden sibling name, flushed to the disk, and exchanged with the old folder in one system
call where there is one (Linux); elsewhere by two renames, which the next run repairs if it is killed between them. A
lock on the hidden folder tells a run that is at work from one that was killed; what killed runs left is swept up.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from brdffit.errors import OutputError

try:
    import fcntl
except ImportError:  # Windows has none; there, leavings are told by their age
    fcntl = None  # type: ignore[assignment]

_AT_FDCWD, _RENAME_EXCHANGE = -100, 2
_STALE_SECONDS = 24 * 3600.0


@contextlib.contextmanager
def fresh_file(path: Path) -> Iterator[Path]:
    """A file to write, which takes the place of ``path`` when the block ends without an error; its folder is made.

    Raises:
        OutputError: when it cannot be written; then what was there still is.
    """
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield fresh
        fresh.replace(path)
    except OSError as error:
        raise OutputError(f"'{path}' could not be written: {error.strerror or error}.") from error
    except OutputError as error:
        raise OutputError(str(error).replace(str(fresh), str(path))) from error
    finally:
        with contextlib.suppress(OSError):
            fresh.unlink()


def check_file(path: Path) -> None:
    """Check, before hours of work, that ``fresh_file`` can write a file later; its folder is made.

    Raises:
        OutputError: when it cannot.
    """
    if path.is_dir():
        raise OutputError(f"'{path}' is a folder, expected a file to write.")
    if path.parent.is_file():
        raise OutputError(f"'{path}' cannot be written: '{path.parent}' is a file, expected a folder.")
    trial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        trial.touch()
        trial.unlink()
    except OSError as error:
        raise OutputError(f"'{path}' cannot be written: {error.strerror or error}.") from error


def write_text(path: Path, text: str) -> None:
    """Write a file as ``fresh_file`` does."""
    with fresh_file(path) as fresh:
        fresh.write_text(text, encoding="utf-8")


def first_other(folder: Path, ours: Collection[str]) -> str | None:
    """The first file below ``folder`` that is not among ``ours``, as a relative path with "/" like these; or None."""
    for parent, folders, files in os.walk(folder):
        folders.sort()
        for name in sorted(files):
            path = Path(parent, name).relative_to(folder).as_posix()
            if path not in ours:
                return path
    return None


def check_writable(folder: str | Path, is_ours: Callable[[Path], str | None], needed_bytes: int = 0) -> None:
    """Check, before hours of work, that ``folder`` can be made or replaced later; nothing is left behind.

    Args:
        folder: the output folder, which need not exist.
        is_ours: says of an existing, non-empty folder what in it forbids replacing it (a relative path), or None.
        needed_bytes: free space that the output will take.

    Raises:
        OutputError: when it cannot.
    """
    folder = Path(folder)
    try:
        if folder.exists() and not folder.is_dir():
            raise OutputError(f"'{folder}' is a file, expected an output folder or a name that is free.")
        foreign = is_ours(folder) if folder.is_dir() else None
        if foreign is not None:
            raise OutputError(
                f"'{folder}' holds '{foreign}', which brdffit did not write: "
                "move it away or choose another output folder, for this one would be replaced as a whole."
            )
        above = folder.resolve().parent
        while not above.exists():
            above = above.parent
        if not above.is_dir():
            raise OutputError(f"'{folder}' cannot be made: '{above}' is a file, expected a folder.")
        trial = _sibling(above / folder.name, "try")
        trial.mkdir()
        trial.rmdir()
        free = shutil.disk_usage(above).free
    except OSError as error:
        raise OutputError(f"'{folder}' cannot be written: {error.strerror}.") from error
    if free < needed_bytes:
        raise OutputError(
            f"'{folder}' needs about {needed_bytes / 2**20:.0f} MiB, but its disk has {free / 2**20:.0f} MiB free."
        )


@contextlib.contextmanager
def replacing(folder: str | Path, is_ours: Callable[[Path], str | None]) -> Iterator[Path]:
    """A fresh folder to write into, which takes the place of ``folder`` when the block ends without an error.

    On an error, an interrupt or SIGTERM the fresh folder is removed and ``folder`` is as it was.

    Raises:
        OutputError: when the folder cannot be written or replaced.
    """
    check_writable(folder, is_ours)
    shown, folder = folder, Path(folder).resolve()
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        sweep(folder)
        fresh = _sibling(folder, "new")
        with terminated_as_exit():
            try:
                fresh.mkdir()
                with _locked(fresh):
                    yield fresh
                    _flush(fresh)
                    _take_place(fresh, folder)
                    _flush_entry(folder.parent)
            except OutputError as error:
                # A writer knows the hidden name only; the user knows the folder.
                raise OutputError(str(error).replace(str(fresh), str(shown))) from error
            finally:
                shutil.rmtree(fresh, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"'{shown}' could not be written: {error.strerror or error}.") from error


def _sibling(folder: Path, kind: str) -> Path:
    return folder.parent / f".{folder.name}.brdffit-{kind}-{os.getpid()}-{time.monotonic_ns():x}"


def _take_place(fresh: Path, folder: Path) -> None:
    """Put ``fresh`` where ``folder`` is; what was there ends under the name ``fresh``."""
    if not folder.exists():
        fresh.rename(folder)
    elif not _exchange(fresh, folder):
        old = _sibling(folder, "old")
        folder.rename(old)
        try:
            fresh.rename(folder)
        except BaseException:
            old.rename(folder)
            raise
        shutil.rmtree(old, ignore_errors=True)


def _exchange(one: Path, other: Path) -> bool:
    """Exchange two names in one step; False where the system or the file system has no such call."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    if renameat2(_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other), _RENAME_EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):
        return False
    raise OSError(code, os.strerror(code))


def sweep(folder: Path) -> None:
    """Remove what killed runs left beside ``folder``; give back an old folder whose replacement never came."""
    prefix = f".{folder.name}.brdffit-"
    for left in sorted(folder.parent.iterdir()):
        if not left.name.startswith(prefix) or not left.is_dir() or _is_at_work(left):
            continue
        if left.name.startswith(f"{prefix}old-") and not folder.exists():
            left.rename(folder)
        else:
            shutil.rmtree(left, ignore_errors=True)


def _is_at_work(left: Path) -> bool:
    try:
        if fcntl is None:
            return time.time() - left.stat().st_mtime < _STALE_SECONDS
        handle = os.open(left, os.O_RDONLY)
    except OSError:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold a lock on a folder; the system lets go of it when the process dies, however it dies."""
    if fcntl is None:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # some network file systems have no locks
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


@contextlib.contextmanager
def terminated_as_exit() -> Iterator[None]:
    """Let SIGTERM unwind the stack as an interrupt does, unless the program has its own handler."""
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
    ):
        yield
        return

    def leave(number: int, _frame: object) -> None:
        raise SystemExit(128 + number)

    signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _flush(folder: Path) -> None:
    """fsync every file and folder below."""
    for parent, _, files in os.walk(folder, topdown=False):
        for name in files:
            with open(os.path.join(parent, name), "rb+") as file:
                os.fsync(file.fileno())
        _flush_entry(Path(parent))


def _flush_entry(folder: Path) -> None:
    if not hasattr(os, "O_DIRECTORY"):
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
