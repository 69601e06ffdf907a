"""The index page of a library: one self-contained file, drawn from the record and the thumbnails."""

from __future__ import annotations

import base64
import shlex
from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, select_autoescape

from brdffit.library.store import Store

FILE_NAME = "index.html"


def write_page(store: Store, record: Mapping[str, Any], sources: Mapping[str, str]) -> None:
    """Write index.html from a record and the thumbnails of its sets.

    Args:
        store: the output of the library.
        record: from ``write_record``.
        sources: where each set was read from, for the command that compares it.

    Raises:
        OutputError: when it cannot be written.
    """
    seconds = record["volatile"]["seconds"]
    rows = [
        _row(store, key, said, seconds[key]) | {"source": shlex.quote(sources[key])}
        for key, said in record["sets"].items()
    ]
    environment = Environment(
        loader=PackageLoader("brdffit.library", "."), autoescape=select_autoescape(default=True), trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    template = environment.get_template("index.html.j2")
    store.write(FILE_NAME, template.render(rows=rows, record=record))


def _row(store: Store, key: str, said: Mapping[str, Any], seconds: Mapping[str, float]) -> dict[str, Any]:
    """The page's row of one set."""
    known = [snr for snr in said["snr_db"] if snr is not None]
    picture = store.read(f"{key}/preview.png")
    return {
        **said,
        "key": key,
        "report": shlex.quote(key.replace("/", "-") + "-report"),
        "picture": "" if picture is None else base64.b64encode(picture).decode(),
        "lowest": min(known, default=None),
        "first": said["snr_db"][1] if len(said["snr_db"]) > 1 else None,
        "mean": sum(known) / len(known) if known else None,
        "seconds": sum(seconds.values()),
        "phases": ", ".join(f"{name} {spent:.2f} s" for name, spent in seconds.items()),
    }
