"""Weights on disk: an .npz of arrays and ``meta``, a JSON text with their provenance and a digest of the arrays.

numpy writes fixed dates into the archive, so the same arrays give the same bytes.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError, OutputError

#: Version of the file's layout.
FORMAT = 1


def digest_of(arrays: Mapping[str, NDArray]) -> str:
    """SHA-256 in hexadecimal over names, types, shapes and bytes of the arrays, in the order of their names."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode() + array.tobytes())
    return digest.hexdigest()


def write_weights(path: Path, arrays: Mapping[str, NDArray], meta: Mapping[str, Any]) -> None:
    """Write a file in full or not at all; ``format`` and ``digest`` are added to its meta.

    Raises:
        OutputError: when it cannot be written; an older file is then left as it was.
    """
    text = json.dumps({**meta, "format": FORMAT, "digest": digest_of(arrays)}, indent=1, sort_keys=True)
    data = io.BytesIO()
    np.savez_compressed(data, allow_pickle=False, **arrays, meta=np.array(text))
    fresh = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        fresh.write_bytes(data.getvalue())
        fresh.replace(path)
    except OSError as error:
        raise OutputError(f"'{path}' could not be written: {error.strerror or error}.") from error
    finally:
        with contextlib.suppress(OSError):
            fresh.unlink()


def read_weights(path: Path, kind: str) -> tuple[dict[str, NDArray], dict[str, Any]]:
    """(arrays by name, meta) of a file of weights of this ``kind``.

    Raises:
        InputError: when the file cannot be read, is no file of weights, has another format or kind, does not match its
            digest, or holds numbers that are not finite.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            found = {name: archive[name] for name in archive.files}
        meta = json.loads(str(found.pop("meta")))
    except OSError as error:
        raise InputError(f"The weights '{path}' cannot be read: {error.strerror or error}.") from error
    except (ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"'{path}' is no file of weights: expected an .npz of arrays and 'meta'.") from error
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        version = meta.get("format") if isinstance(meta, dict) else None
        raise InputError(f"The weights '{path}' have format {version}, expected {FORMAT}.")
    if meta.get("kind") != kind:
        raise InputError(f"The weights '{path}' are of kind '{meta.get('kind')}', expected '{kind}'.")
    if meta.get("digest") != digest_of(found):
        raise InputError(f"The weights '{path}' are damaged: their digest is not the one that their meta gives.")
    for name, array in found.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise InputError(f"The weights '{path}' hold numbers in '{name}' that are not finite.")
    return found, meta


def shaped(arrays: Mapping[str, NDArray], name: str, shape: tuple[int, ...], path: Path) -> NDArray:
    """The array of this name, of the weights read from ``path``.

    Raises:
        InputError: when it is missing or has another shape.
    """
    if name not in arrays:
        raise InputError(f"The weights '{path}' hold no array '{name}'.")
    if arrays[name].shape != shape:
        raise InputError(f"The weights '{path}' hold '{name}' of shape {arrays[name].shape}, expected {shape}.")
    return arrays[name]
