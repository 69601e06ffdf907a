"""What options of the command line mean: their checks, and those that several commands share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import click

OUTPUT_HELP = "Folder to write to; a set gets a subfolder there."
SCENE_HELP = "Instead of SET: every surface of this scene, as its plan says; see `brdffit plan`."
LEVELS_FROM_HELP = "Start at level K of a very large height map; finer relief becomes roughness."
LIGHTS_HELP = "Lights to fit for: point, sun, lamp, window, sky, mixed, or radii in degrees."
SET_HELP = "Another option of the method, see `brdffit methods NAME`; repeatable."

#: Flags that left for ``--set``, each with how it is said now.
MOVED = {
    "--tolerance": "fit.tolerance=0.1", "--levels": "levels=4", "--pixel-filter": "pixel_filter=gaussian",
    "--keep-level-0": "keep_level_0=true", "--min-roughness": "min_roughness=0.1", "--loss": "fit.loss=l1",
    "--refine": "fit.refine=true", "--lobe": "lobe=isotropic", "--normal": "fit.normal=mean",
    "--density": "density=uniform", "--specular": "fit.specular=held", "--model": "model=beckmann",
}  # fmt: skip


class Command(click.Command):
    """A command that answers a flag of a former version with the ``--set`` that replaces it."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            if error.option_name == "--compress":
                raise click.UsageError(
                    '--compress is said in library.toml: compress = "best" under [options].', ctx
                ) from error
            if error.option_name not in MOVED:
                raise
            said = f"{error.option_name} is now said by --set, for example --set {MOVED[error.option_name]}"
            raise click.UsageError(f"{said}; `brdffit methods bfgs` lists all options.", ctx) from error


def settings_of(ctx: click.Context, parameter: click.Parameter, pairs: tuple[str, ...]) -> dict[str, str]:
    """NAME=VALUE, repeated, as a mapping."""
    from brdffit.options import parse_settings

    return parse_settings(pairs)


def set_option(command: Callable) -> Callable:
    """``--set NAME=VALUE``."""
    return click.option("--set", "assigned", multiple=True, callback=settings_of, metavar="NAME=VALUE", help=SET_HELP)(
        command
    )


def known(kind: str) -> Callable[[click.Context, click.Parameter, str | None], str | None]:
    """A callback that refuses an unknown method, model or preset with the nearest name (exit code 2)."""

    def check(ctx: click.Context, parameter: click.Parameter, name: str | None) -> str | None:
        from brdffit.export.presets import preset_names
        from brdffit.methods import BY_NAME, method_names, one_of
        from brdffit.models import model_names

        own_class = kind == "method" and ":" in (name or "")
        if name is not None and not own_class:
            names = {"method": method_names, "model": model_names, "preset": preset_names}[kind]()
            of_method = BY_NAME if kind == "method" else ()
            if name in of_method and ctx.command.name != "methods":
                raise click.BadParameter(f"`brdffit {name} train SET` makes what '{name}' learns, a bake does not.")
            one_of(kind, name, [*names, *of_method])
        return name

    return check


def roles_of(ctx: click.Context, parameter: click.Parameter, pairs: tuple[str, ...]) -> dict[str, str] | None:
    """ROLE=FILE, repeated, as a mapping."""
    roles: dict[str, str] = {}
    for pair in pairs:
        role, equals, file = pair.partition("=")
        if not (role and equals and file):
            raise click.BadParameter(f"'{pair}' is not of the form ROLE=FILE, for example normal=bumps.png.")
        if role in roles:
            raise click.BadParameter(f"'{role}' is given twice.")
        roles[role] = file
    return roles or None


def texel_of(ctx: click.Context, parameter: click.Parameter, text: str) -> tuple[int, int]:
    """X,Y as (column, row)."""
    column, comma, row = text.partition(",")
    if not (comma and column.strip().isdecimal() and row.strip().isdecimal()):
        raise click.BadParameter(f"'{text}' is not of the form X,Y, for example 12,7.")
    return int(column), int(row)


def reading_options(command: Callable) -> Callable:
    """Options that say how a set is read."""
    for option in (
        click.option("--height-scale", type=float, metavar="TEXELS", help="Height of white over black, in texels."),
        click.option("--material", metavar="NAME", help="Name of a material, if the file has several."),
        click.option("--denoise-normals", is_flag=True, help="Remove noise of 8-bit codes from normals."),
        click.option(
            "--wrap",
            **choice("tile", "clamp"),
            show_default="as the file says, or tile",
            help="What is beyond the borders.",
        ),
        click.option("--normal-y", **choice("gl", "dx"), help="Green of normals points up (gl) or down (dx)."),
        click.option(
            "--role",
            "roles",
            multiple=True,
            callback=roles_of,
            metavar="ROLE=FILE",
            help="A file's role, as roughness=r.png; repeatable.",
        ),
    ):
        command = option(command)
    return command


def choice(*names: str) -> dict[str, Any]:
    """A choice that is passed on only if given; its ``show_default`` names the default that holds otherwise."""
    return {"type": click.Choice(names)}


def refuse_beside_scene(context: click.Context, allowed: Sequence[str]) -> None:
    """Refuse, beside --scene, every option that is not ``allowed``, since the plan decides it (click.UsageError)."""
    for parameter in context.command.params:
        name = parameter.name or ""
        if name not in allowed and context.get_parameter_source(name) == click.core.ParameterSource.COMMANDLINE:
            raise click.UsageError(f"{parameter.opts[0]} cannot be given beside --scene: the plan decides it.")


def shard_of(ctx: click.Context, parameter: click.Parameter, text: str | None) -> tuple[int, int] | None:
    """i/n as two numbers."""
    if text is None:
        return None
    part, slash, parts = text.partition("/")
    if not (slash and part.isdigit() and parts.isdigit() and 1 <= int(part) <= int(parts)):
        raise click.BadParameter(f"'{text}' is not of the form i/n with 1 <= i <= n, for example 3/8.")
    return int(part), int(parts)
