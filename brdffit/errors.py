"""Errors that a user can mend: each is one sentence with what was found and what was expected."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class BrdffitError(Exception):
    """Something the user can mend; its text is one full sentence, shown as it stands (exit code 1)."""

    def __str__(self) -> str:
        # File names need not be UTF-8: what cannot be shown is escaped, or the sentence could not be printed.
        return super().__str__().encode("utf-8", "backslashreplace").decode("utf-8")


class InputError(BrdffitError):
    """An input file or folder that cannot be used as given."""


class OutputError(BrdffitError):
    """An output that could not be written; what was there before is still there."""


class UnknownNameError(BrdffitError):
    """A method, model or preset that does not exist (a wrong command line: exit code 2)."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        known = sorted(known)
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.4)
        hint = f"did you mean '{near[0]}'? " if near else ""
        super().__init__(f"There is no {kind} '{name}': {hint}known are {', '.join(known)}.")
