"""The manifest of a baked set: what was read, what was asked, what came out.

The same inputs and options give the same manifest but for its part ``volatile`` (seconds, threads, machine);
``stable_digest`` is the SHA-256 of everything else, the written files included, so two bakes are the same if and only
if their digests are.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from brdffit.files.atomic import first_other
from brdffit.files.image_io import file_sha256
from brdffit.machine import core_count, versions
from brdffit.methods import Baked, Level

FORMAT = 1
FILE_NAME = "manifest.json"


def build_manifest(
    baked: Baked,
    *,
    name: str,
    inputs: Iterable[tuple[str, str | Path]] = (),
    conventions: Mapping[str, Any] | None = None,
    status_names: Sequence[str] = (),
    measured: Sequence[Mapping[str, Any]] = (),
    notes: Iterable[str] = (),
    digests: Mapping[Path, str] | None = None,
) -> dict[str, Any]:
    """The manifest of a result, before it is written (`write_baked` adds what it wrote).

    Args:
        baked: what a method returned.
        name: name of the set.
        inputs: (role, path) of every file that was read; paths are recorded by file name, contents by SHA-256.
        conventions: how the inputs were read: normal Y, wrap, roughness convention, and the like.
        status_names: name of each code of ``Level.status``.
        measured: per level what was measured against the reference, such as ``snr_db`` and ``energy_kept``.
        notes: sentences for the user, after the method's own.
        digests: SHA-256 of inputs as they were when they were read; files without one are hashed now.

    Raises:
        InputError: when an input cannot be read any more.
    """
    options = dataclasses.asdict(baked.options)
    threads = options.pop("threads")
    known = digests or {}
    return {
        "format": FORMAT,
        "name": name,
        "versions": versions(),
        "method": baked.method,
        "model": baked.lobes.model if baked.lobes else None,
        "options": options,
        "wrap": baked.wrap,
        "conventions": dict(conventions or {}),
        "inputs": [
            {"role": role, "file": Path(path).name, "sha256": known.get(Path(path)) or file_sha256(Path(path))}
            for role, path in sorted((role, str(path)) for role, path in inputs)
        ],
        "levels": [
            level_record(size, k, level, status_names, measured[k] if k < len(measured) else {})
            for k, (size, level) in enumerate(zip(baked.sizes, baked.levels, strict=True))
        ],
        "notes": [*baked.notes, *notes],
        "volatile": {
            "seconds": [level.seconds if level else None for level in baked.levels],
            "threads": threads or core_count(),
            "machine": f"{platform.system()} {platform.machine()}",
        },
    }


def level_record(
    size: tuple[int, int],
    mip_level: int,
    level: Level | None,
    status_names: Sequence[str] = (),
    measured: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The manifest's record of one level; ``level`` is None where there are no lobes.

    ``residual_snr_db`` is -10 log10 of the mean residual as the method itself saw it; null for closed forms, and where
    nothing is left of the residual.
    """
    height, width = size
    record: dict[str, Any] = {"level": mip_level, "width": width, "height": height, "texels": height * width}
    if level is None:
        return {**record, **(measured or {})}
    if level.status is not None:
        counts = np.bincount(level.status.ravel())
        record["statuses"] = {
            status_names[code] if code < len(status_names) else str(code): int(count)
            for code, count in enumerate(counts)
            if count
        }
    if level.evaluations is not None:
        record["evaluations"] = int(level.evaluations.sum(dtype=np.int64))
    if level.residual is not None:
        mean = float(level.residual.mean(dtype=np.float64))
        record["residual_snr_db"] = -10.0 * math.log10(mean) if mean > 0.0 else None
    return {**record, **(measured or {})}


def stable_digest(manifest: Mapping[str, Any]) -> str:
    """SHA-256 of a manifest without its parts ``volatile`` and ``stable_digest``."""
    kept = {key: value for key, value in manifest.items() if key not in ("volatile", "stable_digest")}
    return hashlib.sha256(to_json(kept).encode()).hexdigest()


def to_json(manifest: Mapping[str, Any]) -> str:
    """Text of a manifest: keys sorted, numbers that are not finite as null, one line break at the end."""
    text = json.dumps(_plain(manifest), indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n"
    # File names need not be UTF-8; what is none is written as JSON's own escape, and read back as it was.
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def foreign_file(folder: Path) -> str | None:
    """A file of ``folder`` that its manifest does not list, as a relative path; None when all of it is ours, or empty.

    Raises:
        OSError: when the folder cannot be read.
    """
    try:
        manifest = json.loads((folder / FILE_NAME).read_text(encoding="utf-8"))
        ours = {FILE_NAME, *manifest["files"]} if manifest["format"] >= 1 else set()
    except (FileNotFoundError, ValueError, KeyError, TypeError, AttributeError):
        ours = set()
    return first_other(folder, ours)


def _plain(value: Any) -> Any:
    """The same value in types that JSON has, without NumPy types and paths; numbers that are not finite as None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, Path):
        return value.as_posix()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
