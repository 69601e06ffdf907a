"""Tables on disk: JSON with their purpose, their origin and the error of each level; and making them level by level."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from brdffit.errors import InputError, UnknownNameError
from brdffit.files.atomic import write_text
from brdffit.probes.curves import get_curve
from brdffit.probes.table_fit import LevelSearch, TableLevel, TableRequest
from brdffit.probes.tables import BASE_SIZE, TERMS

_SHIPPED = Path(__file__).parent / "data"
#: Levels of a table: 128^2 to 2^2, of which level 0 is copied.
LEVELS = 7
#: Texels along a face of the irradiance cube that a table for irradiance fills.
IRRADIANCE_SIZE = 16


@dataclass(frozen=True)
class TableFile:
    """A table with its origin.

    Attributes:
        name: name of the file, as "ggx-const-8".
        curve: name of the roughness curve that it is valid for; "irradiance" for the clamped cosine.
        levels: the table of each level that there is.
        terms, taps: polynomials, and reads of each frame.
    """

    name: str
    curve: str
    levels: dict[int, TableLevel]
    terms: str
    taps: int

    @property
    def tables(self) -> dict[int, NDArray]:
        """Table (5, terms, 3 taps) of each level."""
        return {number: level.table for number, level in self.levels.items()}

    @property
    def is_whole(self) -> bool:
        """Whether it filters all levels of a probe, but level 0, which is copied."""
        return set(self.levels) == set(range(1, LEVELS))


def shipped_tables() -> list[str]:
    """Names of the tables that come with the program, those of few taps first."""
    names = [path.stem.rpartition("-") for path in _SHIPPED.glob("*.json")]
    return ["".join(each) for each in sorted(names, key=lambda each: (each[0], int(each[2])))]


def load_table(name_or_path: str | Path) -> TableFile:
    """A shipped table by its name, or one from a file.

    Raises:
        UnknownNameError: when no table has that name.
        InputError: when the file cannot be read or holds no table.
    """
    path = Path(name_or_path)
    if path.suffix != ".json":
        if str(name_or_path) not in shipped_tables():
            raise UnknownNameError("table", str(name_or_path), shipped_tables())
        path = _SHIPPED / f"{name_or_path}.json"
    return _parsed(path)


def _read(path: Path) -> dict:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"'{path}' cannot be read as a table ({error}).") from error
    if not isinstance(record, dict) or "levels" not in record or "taps" not in record:
        raise InputError(f"'{path}' is no table of `brdffit probe table`: it has no levels.")
    return record


def _parsed(path: Path) -> TableFile:
    record = _read(path)
    try:
        levels = {
            each["level"]: TableLevel(
                np.array(each["table"], float), each["size"], each["error"], each["seconds"], each["history"]
            )
            for each in record["levels"]
        }
        table = TableFile(path.stem, record["curve"], levels, record["terms"], record["taps"])
        shape = (5, TERMS[table.terms], 3 * table.taps)
        if any(level.table.shape != shape for level in levels.values()):
            raise ValueError(f"a level is not of shape {shape}")
        return table
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"'{path}' is no whole table of `brdffit probe table` ({error!r}).") from error


def make_table(
    output: Path, request: TableRequest, curve: str, command: str, begin_with: list[TableFile] | None = None,
    listener: Callable[[str], None] | None = None,
) -> TableFile:  # fmt: skip
    """Fit the levels of a table and write ``output`` after each; a file of the same request is continued.

    Args:
        output: a .json file.
        request: taps, terms and effort.
        curve: a roughness curve for 7 levels, or "irradiance".
        command: command line to record in the file.
        begin_with: tables with as many taps and at most as many terms, used as additional starts.
        listener: called with a line for each step.

    Raises:
        InputError: when ``output`` holds the table of another request, there is no such curve, or ``begin_with`` is not
            as said.
        OutputError: when ``output`` cannot be written.
    """
    asked = {**asdict(request), "curve": curve, "base_size": BASE_SIZE}
    record = {**asked, "command": command, "versions": {n: version(n) for n in ("brdffit", "numpy", "scipy")}}
    for table in begin_with or []:
        if table.taps != request.taps or TERMS[table.terms] > TERMS[request.terms]:
            raise InputError(
                f"The table '{table.name}' has {table.taps} taps of {table.terms} terms: a search begins with as many "
                f"taps as it has ({request.taps}) and at most as many terms ({request.terms})."
            )
    done: list[dict] = []
    if output.exists():
        old = _read(output)
        if any(old.get(key) != value for key, value in asked.items()):
            raise InputError(f"'{output}' holds a table that was asked for otherwise: move it away or name another.")
        done = old["levels"]
    if curve == "irradiance":
        goals = {3: (IRRADIANCE_SIZE, 1.0)}
    else:
        alphas = get_curve(curve, LEVELS, BASE_SIZE).alphas()
        goals = {level: (BASE_SIZE >> level, alphas[level]) for level in range(1, LEVELS)}
    # What cannot be written is told before the search.
    write_text(output, json.dumps({**record, "levels": done}, separators=(",", ":")) + "\n")
    # Small levels come first: they take seconds and show mistakes early.
    for level in sorted(goals, reverse=True):
        if any(each["level"] == level for each in done):
            continue
        n, alpha = goals[level]
        begin = [each.tables[level] for each in begin_with or [] if level in each.levels]
        found = LevelSearch(n, alpha, request, begin, listener).run()
        done.append(
            {
                "level": level,
                "size": found.size,
                "alpha": alpha,
                "error": round(found.error, 5),
                "seconds": round(found.seconds, 1),
                "history": found.history,
                "table": np.round(found.table, 6).tolist(),
            }
        )
        write_text(output, json.dumps({**record, "levels": done}, separators=(",", ":")) + "\n")
        if listener:
            listener(f"level {level} done: {found.error:.4f} on held-out texels, {found.seconds:.0f} s")
    return _parsed(output)
