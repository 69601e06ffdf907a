"""The cost of effects that are off: a fit without an effect must take no longer than code or data that never had it.

Three fits of the same texels are timed: with the effect, without it, and one that never had it. The third is of a base
that lacks what the effect needs, or uses kernels from whose source the lines of the effect were cut.
"""

from __future__ import annotations

import ast
import importlib.util
import inspect
import shutil
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from benchmarks.materials import load_any, load_procedural, real_sets
from benchmarks.record import Section, Target
from brdffit import _jit
from brdffit.colour import LUMINANCE
from brdffit.fitting import batch, method
from brdffit.fitting.method import NonlinearFit
from brdffit.fitting.options import FitOptions
from brdffit.halfangle import objective, quadrature
from brdffit.models import get_model
from brdffit.svbrdf import Svbrdf
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.procedural import make_set
from brdffit.textures.reading import read_texture_set

#: Share by which a fit without an effect may take longer than one that never had it.
ALLOWED = 0.03
_SET, _LEVELS = "metal-plates-006", 2
_WITHOUT_NORMAL = ("normal",)


@dataclass(frozen=True)
class Row:
    """The fits that are timed: with the effect, without it, and one that never had it."""

    effect: str
    never: str
    ways: tuple[Callable[[], object], Callable[[], object], Callable[[], object]]


def measure_effects(materials: Path, quick: bool) -> Section:
    """Every effect that a fit can leave out."""
    side, rounds = (64, 21) if quick else (96, 61)
    section = Section(
        "effects",
        "Effects that are off",
        f"Levels 0 and 1 of a crop of {side}x{side} texels, standard quality, GGX, box filter, one thread, processor "
        f"seconds, in turn; medians of {rounds} rounds, and of the ratios within a round. Never: the time of data or "
        "of kernels without the effect; +-: standard error of a median. Levels beyond the reach are of a crop four "
        "times as large, for averaging them has a cost that does not grow. The normal map's row is of reading alone.",
    )
    large = _base(materials, 2 * side)
    if isinstance(large, str):
        section.problems.append(large)
        return section
    base = _crop(large, side)
    with tempfile.TemporaryDirectory() as scratch:
        for row in (*_of_data(base), _of_reach(large), *_of_kernels(base), _of_reading(materials, Path(scratch))):
            section.rows.append(_timed(row, rounds))
    worst = max(section.rows, key=lambda row: row["off / never"])
    horizon = next(row["off / on"] for row in section.rows if row["effect"] == "horizon")
    ratio, error = (float(part) for part in horizon.split(" +- "))
    section.targets = [
        Target("time of an effect that is off over that of never having it", f"<= {1 + ALLOWED}",
               f"worst {worst['off / never']} ({worst['effect']})",
               float(worst["off / never"].split()[0]) <= 1 + ALLOWED),
        Target("time without the horizon over that with it", "<= 1, within two errors", horizon,
               ratio <= 1.0 + 2.0 * error),
    ]  # fmt: skip
    return section


def _timed(row: Row, rounds: int) -> dict[str, Any]:
    """Medians of a row. Each round begins with another of the three, so that none is always the first."""
    for way in row.ways:
        way()  # compiles and warms caches
    seconds = np.zeros((rounds, 3))
    for k in range(rounds):
        for way in np.roll(np.arange(3), k):
            start = time.process_time()
            row.ways[way]()
            seconds[k, way] = time.process_time() - start
    on, off, never = (float(each) for each in np.median(seconds, axis=0))
    return {
        "effect": row.effect,
        "never": row.never,
        "on s": on,
        "off s": off,
        "never s": never,
        "off / on": _with_error(seconds[:, 1] / seconds[:, 0]),
        "off / never": _with_error(seconds[:, 1] / seconds[:, 2]),
    }


def _with_error(ratios: NDArray) -> str:
    """Median and its standard error, from the quartiles."""
    error = 1.253 / 1.349 * float(np.subtract(*np.quantile(ratios, (0.75, 0.25)))) / len(ratios) ** 0.5
    return f"{np.median(ratios):.3f} +- {error:.3f}"


def _base(materials: Path, side: int) -> Svbrdf | str:
    """A crop of a real set, or of a shipped one if there is none, with a diffuse colour."""
    path = real_sets(materials).get(_SET)
    loaded = load_procedural("hammered-metal", 2 * side) if path is None else load_any(_SET, path)
    if isinstance(loaded, str):
        return loaded
    base = _crop(loaded, side)
    return base.replace(diffuse=np.clip(0.5 * base.specular + 0.2, 0.0, 1.0), height=None)


def _crop(svbrdf: Svbrdf, side: int) -> Svbrdf:
    return svbrdf.replace(**{name: array[:side, :side].copy() for name, array in svbrdf.arrays().items()})


def _bake(base: Svbrdf, levels: int = _LEVELS, **options: Any) -> Callable[[], object]:
    asked = FitOptions(lights="point", levels=levels, threads=1, **options)
    return lambda: NonlinearFit().bake_lobes(base, asked)


def _of_data(base: Svbrdf) -> list[Row]:
    """Effects that a base may lack."""
    luminance = base.specular @ LUMINANCE
    grey = base.replace(specular=np.repeat(luminance[..., None], 3, axis=2))
    white = base.replace(specular=np.ones_like(base.specular))
    black = base.replace(diffuse=np.zeros_like(base.diffuse))
    on = _bake(base)
    return [
        Row("colour in channels", "a grey set", (on, _bake(base, colour="shared"), _bake(grey))),
        Row("correlation", "a set with a white specular", (on, _bake(base, correlation=False), _bake(white))),
        Row("coupling of diffuse and normal", "a set without diffuse", (on, _bake(base, coupling=False), _bake(black))),
    ]  # fmt: skip


def _of_reach(base: Svbrdf) -> Row:
    """Levels that no pixel reads."""
    ways = _bake(base, levels=6), _bake(base, levels=6, reach=(0, 1)), _bake(base, levels=2)
    return Row("levels beyond the reach", "as many levels as are reached", ways)


def _of_kernels(base: Svbrdf) -> list[Row]:
    """Effects that kernels may lack."""
    cut = "kernels whose source has no line of it"
    flat = base.replace(normal=np.broadcast_to(np.float32([0, 0, 1]), base.normal.shape).copy())
    on, rows = _bake(base), []
    for effect, svbrdf, options, switches in (
        ("horizon", base, {"horizon": False}, {"HORIZON": False}),
        ("anisotropy", base, {"lobe": "isotropic"}, {"STRETCHES": False}),
        ("variation of normals", flat, {"normal": "mean"}, {"TURNS": False}),
    ):
        off = _bake(svbrdf, **options)
        rows.append(Row(effect, cut, (on, off, _with(_kernels_without(**switches), off))))
    return rows


def _with(kernels: batch.ModelKernels, bake: Callable[[], object]) -> Callable[[], object]:
    def way() -> object:
        with mock.patch.object(method, "kernels_of", lambda *_: kernels):
            return bake()

    return way


def _of_reading(materials: Path, scratch: Path) -> Row:
    """A set with a normal map that is not read, against the same folder without that file.

    Both are folders of maps alone: a material's own document, which names them, takes time of its own.
    """
    path = real_sets(materials).get(_SET) or make_set("hammered-metal", scratch / "made", 512)
    whole, bare = scratch / "whole", scratch / "bare"
    for folder in (whole, bare):
        folder.mkdir()
    for role, named in read_texture_set(path).maps.items():
        shutil.copy(named.path, whole / named.path.name)
        if role not in ("normal", "height"):
            shutil.copy(named.path, bare / named.path.name)

    def read(folder: Path, without: tuple[str, ...] = ()) -> Callable[[], object]:
        return lambda: to_svbrdf(read_texture_set(folder, without=without), without=without)

    never = read(bare, _WITHOUT_NORMAL)
    return Row("normal map", "a set without the file", (read(whole), read(whole, _WITHOUT_NORMAL), never))


class _Cut(ast.NodeTransformer):
    """Removes the code from a kernel's source that its switches leave out."""

    def __init__(self, switches: dict[str, bool]) -> None:
        self.switches = switches

    def visit_Name(self, node: ast.Name) -> ast.AST:
        return ast.Constant(self.switches[node.id]) if node.id in self.switches else node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        known = isinstance(node.op, ast.Not) and isinstance(node.operand, ast.Constant)
        return ast.Constant(not node.operand.value) if known else node  # type: ignore[attr-defined]

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.AST:
        self.generic_visit(node)
        decided = isinstance(node.op, ast.Or) and any(isinstance(e, ast.Constant) and e.value for e in node.values)
        return ast.Constant(True) if decided else node

    def visit_If(self, node: ast.If) -> Any:
        self.generic_visit(node)
        if isinstance(node.test, ast.Constant):
            return node.body if node.test.value else node.orelse
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.test, ast.Constant):
            return node.body if node.test.value else node.orelse
        return node


def without_lines(template: Any, **switches: bool) -> str:
    """Source of a kernel without these switches and without the lines that they leave out."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(template.py_func)))
    return ast.unparse(ast.fix_missing_locations(_Cut(switches).visit(tree)))


@cache
def _kernels_without(**switches: bool) -> batch.ModelKernels:
    """GGX's kernels, compiled from sources without these switches."""
    name = "_".join(switches).lower()
    folder = Path(_jit.CACHE_FOLDERS["fitting"]) / "benchmark"  # a lasting place: kernels are cached by it
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"without_{name}.py"
    text = ["import math", "import numpy as np", "from brdffit._jit import kernel"]
    templates = {objective: (objective.moments, objective.lobe_values), quadrature: (quadrature.tabulate,)}
    for module, kernels in templates.items():
        text += [f"import {module.__name__} as own"]
        text += ["globals().update({name: each for name, each in vars(own).items() if not name.startswith('__')})"]
        text += [without_lines(kernel, **switches) for kernel in kernels]
    source = "\n".join(text) + "\n"
    if not file.exists() or file.read_text(encoding="utf-8") != source:
        file.write_text(source, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(f"without_{name}", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # a cached kernel names its module
    spec.loader.exec_module(module)
    model = get_model("ggx")
    full = batch.model_kernels("ggx", "ggx")
    made = {}
    for each, function, kind in (
        ("moments", "profile_gradient", objective.moments_type),
        ("lobe_values", "profile", objective.lobe_values_type),
        ("tabulate", "profile", quadrature.tabulate_type),
    ):
        bindings = {function: getattr(model, function), "real": np.float32}
        made[each] = _jit.specialise(getattr(module, each), "_never", **bindings)
        made[each].compile(kind(_jit.types.float32).signature.args)
    return full._replace(moments=made["moments"], values=made["lobe_values"], tabulate=made["tabulate"])
