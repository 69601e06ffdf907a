"""Standard output as commands print to it."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

#: Width in columns where no terminal sets one: wide enough that file names are not broken.
_PIPED_WIDTH = 200


def plain_console() -> Console:
    """Standard output: paths and sentences are data, not markup, and no line is broken."""
    console = Console(highlight=False, markup=False, emoji=False, soft_wrap=True)
    if not console.is_terminal:
        console.width = _PIPED_WIDTH
    return console


def plain_table(*columns: str, justify: str = "left") -> Table:
    """A table without a frame, whose cells are folded where they are too long."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column, justify=justify, overflow="fold")  # type: ignore[arg-type]
    return table
