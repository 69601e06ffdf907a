"""The walls of the house: which module may import which, and a few habits; read from the sources, nothing is run."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCES = sorted(path for package in ("brdffit", "baselines") for path in (ROOT / package).rglob("*.py"))
TREES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES}

#: Longest file, in lines; most are under 300.
MAX_LINES = 400
#: Longest function, in lines below its docstring.
MAX_FUNCTION_LINES = 60
#: Kernels that are one loop over a texel's data, where each call would cost what it saves in lines; and what is still
#: to be cut.
LONG_FUNCTIONS = {
    "brdffit.fitting.bfgs": {"minimise"},
    "brdffit.fitting.interpolation": {"interpolated_errors"},
    "brdffit.fitting.shortcuts": {"closed_form"},
    "brdffit.fitting.texel": {"fit_texel"},
    "brdffit.halfangle.apparent_lobe": {"_gather"},
    "brdffit.halfangle.quadrature": {"tabulate"},
    "brdffit.learned.kernels.footprints": {"add_lobes"},
    "brdffit.learned.kernels.moments": {"features"},
    "brdffit.learned.kernels.saying": {"say"},
    "brdffit.microgeometry.kernels.traversal": {"meet"},
    "brdffit.probes.kernels.tree": {"filter_by_tree"},
}

#: What the modules of a room must not import: the arrows of the architecture, read against their direction.
#: (textures and render know svbrdf and the Pyramid of methods.py; the command line knows all.)
FORBIDDEN = {
    "brdffit": {"baselines"},
    "brdffit.errors": {"brdffit.svbrdf", "brdffit.methods", "brdffit.textures", "brdffit.models"},
    "brdffit.roughness": {"brdffit.svbrdf", "brdffit.methods", "brdffit.textures", "brdffit.models"},
    "brdffit.svbrdf": {"brdffit.methods", "brdffit.textures", "brdffit.models", "brdffit.fitting", "brdffit.footprint"},
    "brdffit.models": {"brdffit.halfangle", "brdffit.fitting", "brdffit.methods", "brdffit.textures", "brdffit.render"},
    "brdffit.halfangle": {"brdffit.fitting", "brdffit.textures", "brdffit.render", "brdffit.pipeline", "brdffit.cli"},
    "brdffit.fitting": {"brdffit.textures", "brdffit.render", "brdffit.pipeline", "brdffit.cli"},
    "brdffit.methods": {
        "brdffit.textures", "brdffit.render", "brdffit.halfangle", "brdffit.fitting", "brdffit.pipeline", "brdffit.cli"
    },
    "brdffit.footprint": {
        "brdffit.textures", "brdffit.render", "brdffit.models", "brdffit.halfangle", "brdffit.fitting",
        "brdffit.pipeline",
    },
    "brdffit.textures": {
        "brdffit.fitting", "brdffit.halfangle", "brdffit.models", "brdffit.render", "brdffit.pipeline", "brdffit.cli",
        "brdffit.export",
    },
    "brdffit.files": {
        "brdffit.svbrdf", "brdffit.methods", "brdffit.textures", "brdffit.models", "brdffit.render", "brdffit.export"
    },
    "brdffit.export": {
        "brdffit.fitting", "brdffit.halfangle", "brdffit.models", "brdffit.render", "brdffit.pipeline", "brdffit.cli"
    },
    # Small networks know no materials; probes are a house of their own beside files and writers.
    "brdffit.nets": {
        "brdffit.svbrdf", "brdffit.methods", "brdffit.fitting", "brdffit.halfangle", "brdffit.textures",
        "brdffit.render", "brdffit.learned",
    },
    # A neural material learns from whatever answers queries, and draws through the renderer.
    "brdffit.neural": {
        "brdffit.fitting", "brdffit.halfangle", "brdffit.export", "brdffit.comparison", "brdffit.planning",
        "brdffit.report", "brdffit.pipeline", "brdffit.library", "brdffit.models",
    },
    # A traced height answers queries and is a truth, shaded as the renderer does; it does not know who asks.
    "brdffit.microgeometry": {
        "brdffit.fitting", "brdffit.neural", "brdffit.learned", "brdffit.nets", "brdffit.comparison",
        "brdffit.planning", "brdffit.export", "brdffit.methods", "brdffit.pipeline", "brdffit.cli", "click",
    },
    "brdffit.neural.kernels": {"brdffit.svbrdf", "brdffit.microgeometry", "brdffit.textures", "brdffit.methods"},
    "brdffit.learned": {"brdffit.render", "brdffit.export", "brdffit.comparison", "brdffit.report", "brdffit.probes"},
    "brdffit.probes": {
        "brdffit.svbrdf", "brdffit.methods", "brdffit.fitting", "brdffit.halfangle", "brdffit.textures",
        "brdffit.comparison",
    },
    # The geometry of a lobe is shared; what the half-angle integral is made of is not: rendering checks it.
    "brdffit.render": {
        "brdffit.fitting", "brdffit.textures", "brdffit.pipeline", "brdffit.cli", "brdffit.halfangle.apparent_lobe",
        "brdffit.halfangle.quadrature", "brdffit.halfangle.objective", "brdffit.halfangle.measure",
        "brdffit.halfangle.closed_forms",
    },
    # Its workers bake as the command bake does; the fit and the lobe it knows by their methods alone.
    "brdffit.library": {"brdffit.models", "brdffit.halfangle", "brdffit.report", "brdffit.console", "brdffit.cli"},
    # The report draws; it computes nothing.
    "brdffit.report": {
        "brdffit.fitting", "brdffit.halfangle", "brdffit.render", "brdffit.models", "brdffit.svbrdf", "brdffit.methods",
        "brdffit.pipeline", "brdffit.comparison", "brdffit.landscape", "brdffit.cli",
    },
    # The page draws by itself; what it shows was baked by the one road.
    "brdffit.viewer": {
        "brdffit.fitting", "brdffit.halfangle", "brdffit.models", "brdffit.render", "brdffit.report",
        "brdffit.comparison", "brdffit.planning", "brdffit.library", "brdffit.neural", "brdffit.learned", "matplotlib",
    },
    # What is said of a result; the road asks it, not the other way round.
    "brdffit.assessment": {"brdffit.pipeline", "brdffit.textures", "brdffit.export", "brdffit.cli"},
    # Data for the console, which prints it.
    "brdffit.doctor": {"brdffit.render", "brdffit.console", "brdffit.cli", "brdffit.report", "rich", "click"},
    "brdffit.comparison": {
        "brdffit.cli", "brdffit.library", "brdffit.planning", "brdffit.report.page", "matplotlib", "jinja2"
    },
    # A plan stands on all that bakes and measures, and none of that on a plan.
    "brdffit.planning": {"brdffit.cli", "brdffit.library", "brdffit.report.page", "matplotlib", "jinja2", "click"},
    # What a scene file says can be told without a kernel.
    "brdffit.planning.description": {"brdffit.render", "brdffit.fitting", "brdffit.halfangle", "brdffit.comparison"},
    "baselines": {"brdffit.fitting", "brdffit.halfangle", "brdffit.textures", "brdffit.render", "brdffit.cli"},
}  # fmt: skip


def module_name(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree):
    """Every module that a source imports, at the top or inside a function, but for type checkers alone."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute here"
            # `from package import module` imports package.module, if it is one; a name that is none does no harm.
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def within(module, room):
    return module == room or module.startswith(room + ".")


def test_there_is_something_to_police():
    names = {module_name(path) for path in SOURCES}
    assert {"brdffit", "brdffit.methods", "brdffit.models.ggx", "baselines.lean"} <= names
    assert "OpenImageIO" in imports(TREES[ROOT / "brdffit/files/image_io.py"])


@pytest.mark.parametrize("room", FORBIDDEN)
def test_arrows_point_one_way(room):
    wrong = [
        f"{module_name(path)} imports {module}"
        for path, tree in TREES.items()
        if within(module_name(path), room)
        for module in imports(tree)
        if any(within(module, other) for other in FORBIDDEN[room])
    ]
    assert not wrong


def test_only_the_command_line_knows_the_library():
    importers = {
        module_name(path)
        for path, tree in TREES.items()
        if any(within(module, "brdffit.library") for module in imports(tree))
    }
    assert {name for name in importers if not within(name, "brdffit.library")} == {"brdffit.cli"}


def test_one_file_imports_openimageio():
    importers = [path.name for path, tree in TREES.items() if any(within(m, "OpenImageIO") for m in imports(tree))]
    assert importers == ["image_io.py"]


def test_one_file_compiles():
    """numba.njit and numba.jit, however they are imported, stand in _jit.py alone: one place for the flags."""
    compilers = {"njit", "jit", "jitclass", "vectorize", "guvectorize", "cfunc"}
    for path, tree in TREES.items():
        if path.name == "_jit.py":
            continue
        named = {
            alias.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and within(node.module or "", "numba")
            for alias in node.names
        }
        attributes = {
            node.attr
            for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ("numba", "nb")
        }
        assert not compilers & (named | attributes), module_name(path)


def test_nothing_prints():
    """The command line speaks through its console; everything else is silent."""
    for path, tree in TREES.items():
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)]
        assert not [call.lineno for call in calls if call.func.id == "print"], module_name(path)


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_every_module_says_what_it_is_and_stays_short(path):
    source = path.read_text(encoding="utf-8")
    if path.name != "__init__.py" or source.strip():
        assert ast.get_docstring(TREES[path])
    assert len(source.splitlines()) <= MAX_LINES


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_functions_stay_short(path):
    """A docstring and a signature may be as long as they need; a name that is no longer long leaves the list."""
    long = set()
    for node in ast.walk(TREES[path]):
        if isinstance(node, ast.FunctionDef):
            body = node.body[1:] if ast.get_docstring(node) and len(node.body) > 1 else node.body
            if body[-1].end_lineno - body[0].lineno + 1 > MAX_FUNCTION_LINES:
                long.add(node.name)
    assert long == LONG_FUNCTIONS.get(module_name(path), set())


def test_the_command_line_starts_without_the_heavy_libraries():
    """`brdffit --help` must answer at once: a fresh interpreter that imports the command line holds none of these."""
    script = (
        "import sys, brdffit.cli; "
        "sys.exit(','.join({'numpy', 'scipy', 'numba', 'OpenImageIO', 'nlopt', 'rich'} & set(sys.modules)) or 0)"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT, check=False)
    assert result.returncode == 0, result.stderr
