"""``library.json``: every set of a library with figures of its manifest, and the sentences of those that failed.

It is made from the manifests each time, so no kill loses anything. Like a manifest it has a part ``volatile``; the rest
does not depend on how the work was shared out, or how often it was interrupted.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from typing import Any

from brdffit.export.manifest import to_json
from brdffit.library.store import Store, manifest_of
from brdffit.library.task import Task

FILE_NAME = "library.json"
FORMAT = 1


def write_record(
    store: Store, tasks: Mapping[str, Task], chosen: Collection[str], failures: Mapping[str, str]
) -> dict[str, Any]:
    """Write library.json.

    Args:
        store: the output.
        tasks: every set of the library.
        chosen: the sets that this run looked at; of others the earlier failures stand.
        failures: sentences of this run, by key.

    Returns:
        The record as written.

    Raises:
        OutputError: when it cannot be written.
    """
    try:
        before = json.loads(store.read(FILE_NAME) or b"{}")["failed"]
    except (ValueError, KeyError, TypeError):
        before = {}
    sets: dict[str, Any] = {}
    phases: dict[str, Any] = {}
    failed = dict(failures)
    for key in sorted(tasks):
        manifest = manifest_of(store, key)
        if key not in chosen and key in before:
            failed[key] = before[key]
        if key in failed or manifest is None or "request" not in manifest:
            continue
        sets[key] = _entry(manifest)
        phases[key] = manifest["volatile"].get("phases", {})
    record = {
        "format": FORMAT,
        "sets": sets,
        "failed": dict(sorted(failed.items())),
        "missing": [key for key in sorted(tasks) if key not in sets and key not in failed],
        "volatile": {"seconds": phases},
    }
    store.write(FILE_NAME, to_json(record))
    return record


def _entry(manifest: Mapping[str, Any]) -> dict[str, Any]:
    levels = manifest["levels"]
    return {
        "method": manifest["method"],
        "model": manifest["model"],
        "quality": manifest["options"].get("quality"),
        "preset": manifest["preset"]["name"],
        "width": levels[0]["width"],
        "height": levels[0]["height"],
        "texels": sum(level["texels"] for level in levels),
        "snr_db": [level.get("snr_db") for level in levels],
        "energy_kept": [level.get("energy_kept") for level in levels],
        "notes": manifest["notes"],
        "stable_digest": manifest["stable_digest"],
    }
