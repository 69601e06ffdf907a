"""Where a library is written: a folder, or an address that fsspec knows (a bucket, a server).

In a folder each set is replaced as a whole (see ``files.atomic``). Other file systems have no such exchange: there a
set is complete if it has a manifest, which is removed first and written last.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import re
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from brdffit.errors import InputError, OutputError
from brdffit.export import writing as export
from brdffit.export.manifest import FILE_NAME
from brdffit.files import atomic
from brdffit.library.task import Task
from brdffit.methods import Baked
from brdffit.pipeline import Write

try:
    import fcntl
except ImportError:  # Windows has none
    fcntl = None  # type: ignore[assignment]


Manifest = Callable[[], dict[str, Any]]
Picture = Callable[[], NDArray] | None


class Store(Protocol):
    """The output of a library."""

    def read(self, name: str) -> bytes | None:
        """A file's bytes, or None where there is none."""

    def size(self, name: str) -> int | None:
        """The number of a file's bytes, or None where there is no file."""

    def write(self, name: str, text: str) -> None:
        """Write a file as a whole."""

    def writing(self, task: Task, size: tuple[int, int]) -> contextlib.AbstractContextManager[Write]:
        """Check that the set can be written, then give the function that writes it."""

    def alone(self) -> contextlib.AbstractContextManager[None]:
        """Hold a lock, where the file system has locks, while files are read and rewritten."""

    def sweep(self) -> None:
        """Remove what killed runs left."""


def open_store(address: str) -> Store:
    """The store of an address.

    Raises:
        InputError: when the address needs a package that is missing, or names no file system.
    """
    return _Remote(address) if "://" in address else _Folder(Path(address))


def manifest_of(store: Store, key: str) -> dict[str, Any] | None:
    """The manifest of a set, or None where there is none that can be read."""
    try:
        manifest = json.loads(store.read(f"{key}/{FILE_NAME}") or b"null")
    except ValueError:
        return None
    return manifest if isinstance(manifest, dict) else None


def writing(task: Task, size: tuple[int, int]) -> contextlib.AbstractContextManager[Write]:
    """What writes the set of a task."""
    return open_store(task.output).writing(task, size)


class _Folder:
    """A folder of this machine, or one that machines share."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def read(self, name: str) -> bytes | None:
        try:
            return (self.root / name).read_bytes()
        except OSError:
            return None

    def size(self, name: str) -> int | None:
        try:
            return (self.root / name).stat().st_size
        except OSError:
            return None

    def write(self, name: str, text: str) -> None:
        final = self.root / name
        part = final.with_name(f".{name}.{_host()}-{os.getpid()}.part")
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            with part.open("w", encoding="utf-8", errors="backslashreplace") as file:  # names need not be UTF-8
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, final)
        except OSError as error:
            raise OutputError(f"'{final}' could not be written: {error.strerror}.") from error
        finally:
            part.unlink(missing_ok=True)

    @contextlib.contextmanager
    def writing(self, task: Task, size: tuple[int, int]) -> Iterator[Write]:
        folder = self.root / task.key
        export.check_writable(folder, size, task.preset, task.bits)

        def write(baked: Baked, manifest: Manifest, picture: Picture) -> dict[str, Any]:
            return export.write_baked(
                baked, folder, name=task.found.name, preset=task.preset, bits=task.bits,
                compress=task.compress, manifest=manifest, preview=picture,
            )  # fmt: skip

        yield write

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            handle = os.open(self.root, os.O_RDONLY) if fcntl is not None else None
        except OSError as error:
            raise OutputError(f"'{self.root}' cannot be written: {error.strerror}.") from error
        try:
            if handle is not None:
                with contextlib.suppress(OSError):  # some network file systems have no locks
                    fcntl.flock(handle, fcntl.LOCK_EX)
            yield
        finally:
            if handle is not None:
                os.close(handle)

    def sweep(self) -> None:
        """Remove our own names that no living run holds; put back an old set whose replacement never came."""
        if not self.root.is_dir():
            return
        for parent, folders, files in os.walk(self.root):
            for name in files:
                if _is_left_over(name):
                    Path(parent, name).unlink(missing_ok=True)
            left = {name[1:].partition(".brdffit-")[0] for name in folders if name[0] == "." and ".brdffit-" in name}
            for name in sorted(left):
                atomic.sweep(Path(parent, name))
            folders[:] = [name for name in folders if name[0] != "."]


def _host() -> str:
    return re.sub(r"[^A-Za-z0-9]", "_", platform.node())


def _is_left_over(name: str) -> bool:
    """Whether a file was being written by a process of this machine that lives no more."""
    match = re.fullmatch(r"\..*\." + _host() + r"-(\d+)\.part", name)
    if match is None:
        return False
    try:
        os.kill(int(match[1]), 0)
    except (ProcessLookupError, OverflowError):
        return True
    except OSError:
        pass
    return False


class _Remote:
    """Anything fsspec knows."""

    def __init__(self, address: str) -> None:
        try:
            import fsspec
        except ImportError as error:
            raise InputError(
                f"'{address}' is an address and needs fsspec, which is not installed: pip install 'brdffit[cluster]'."
            ) from error
        self.address = address
        try:
            self.files, self.root = fsspec.core.url_to_fs(address)
        except (ImportError, ValueError) as error:
            raise InputError(f"'{address}' cannot be opened: {error}.") from error

    def read(self, name: str) -> bytes | None:
        try:
            return self.files.cat_file(f"{self.root}/{name}")
        except (OSError, KeyError):
            return None

    def size(self, name: str) -> int | None:
        try:
            return self.files.size(f"{self.root}/{name}")
        except (OSError, KeyError):
            return None

    def write(self, name: str, text: str) -> None:
        try:
            self.files.pipe_file(f"{self.root}/{name}", text.encode("utf-8", "backslashreplace"))
        except OSError as error:
            raise OutputError(f"'{self.address}/{name}' could not be written: {error}.") from error

    @contextlib.contextmanager
    def writing(self, task: Task, size: tuple[int, int]) -> Iterator[Write]:
        with tempfile.TemporaryDirectory(prefix="brdffit-") as here:
            export.check_writable(Path(here) / "set", size, task.preset, task.bits)

            def write(baked: Baked, manifest: Manifest, picture: Picture) -> dict[str, Any]:
                written = export.write_baked(
                    baked, Path(here) / "set", name=task.found.name, preset=task.preset, bits=task.bits,
                    compress=task.compress, manifest=manifest, preview=picture,
                )  # fmt: skip
                target = f"{self.root}/{task.key}"
                try:
                    if self.files.exists(target):
                        if self.files.exists(f"{target}/{FILE_NAME}"):
                            self.files.rm_file(f"{target}/{FILE_NAME}")
                        self.files.rm(target, recursive=True)
                    for name in (*written["files"], FILE_NAME):
                        self.files.makedirs(f"{target}/{name}".rpartition("/")[0], exist_ok=True)
                        self.files.put_file(f"{here}/set/{name}", f"{target}/{name}")
                except OSError as error:
                    raise OutputError(f"'{self.address}/{task.key}' could not be written: {error}.") from error
                return written

            yield write

    def alone(self) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def sweep(self) -> None:
        """Nothing to remove: a set that is not complete has no manifest, and is replaced."""
