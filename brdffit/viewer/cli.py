"""The command `view`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from brdffit.cli_options import choice, known, reading_options


@click.command()
@click.argument("source", metavar="SET_OR_BAKE")
@click.option("-o", "--output", type=click.Path(path_type=Path), default=Path("view.html"), help="The page.")
@click.option("--methods", multiple=True, metavar="A,B,...", show_default="bfgs", help="Methods to show, a panel each.")
@click.option("--quality", **choice("draft", "standard", "fine"), show_default="standard", help="Accuracy of the fit.")
@click.option("--preset", callback=known("preset"), help="Also show the compressed textures of this engine.")
@click.option(
    "--environment", metavar="FILE", show_default="drawn by the page", help="Light: an equirectangular .hdr or .exr."
)
@click.option("--open", "show", is_flag=True, help="Open the page when done.")
@reading_options
def view(
    source: str, output: Path, methods: tuple[str, ...], quality: str | None, preset: str | None,
    environment: str | None, show: bool, **reading: Any,
) -> None:  # fmt: skip
    """Write one HTML page that shows a set averaged, baked and true, moving.

    SET_OR_BAKE is a texture set, or a folder that `brdffit bake` wrote. The page needs no connection, only a browser.
    """
    from brdffit.console import BakeDisplay
    from brdffit.viewer.command import view as write

    named = tuple(name.strip() for each in methods for name in each.split(",") if name.strip()) or ("bfgs",)
    with BakeDisplay() as display:
        page = write(
            source, output, methods=named, quality=quality or "standard", preset=preset, environment=environment,
            reading=reading, progress=display,
        )  # fmt: skip
    click.echo(f"{page}: {page.stat().st_size / 1e6:.1f} MB")
    if show:
        click.launch(page.resolve().as_uri())
