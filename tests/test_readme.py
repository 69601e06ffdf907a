"""The README is kept: its commands run, its tables and quotations are those of the code."""

from __future__ import annotations

import inspect
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from brdffit.export.presets import get_preset, preset_names
from brdffit.fitting.options import QUALITIES
from brdffit.methods import Method
from brdffit.textures.procedural import make_set

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = [line for block in re.findall(r"```sh\n(.*?)```", TEXT, re.S) for line in block.splitlines() if line]
MAKE = [line for line in COMMANDS if line.startswith("make ")]
BRDFFIT = [line for line in COMMANDS if line.startswith("brdffit ")]
PROGRAMS = re.findall(r"```python\n(.*?)```", TEXT, re.S)
SETS = ("glossy-tiles", "grooved-record", "hammered-metal", "brushed-metal", "pebbles", "plaster-wall", "rocky-terrain")
# Planning measures each effect of a scene, a comparison draws each method in every light, a neural material is learned
# for minutes before it is drawn, a landscape scans a domain, and a probe is filtered to a tolerance.
SLOW = (
    "brdffit plan",
    "brdffit bake --scene",
    "brdffit compare",
    "brdffit neural",
    "brdffit landscape",
    "brdffit probe",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the sets that the commands name, small."""
    folder = tmp_path_factory.mktemp("readme")
    for name in SETS:
        make_set(name, folder / "data" / "sets" / name, size=32)
    make_set("brushed-strokes-4k", folder / "data" / "large" / "brushed-strokes-4k", size=32)
    shutil.copytree(ROOT / "data" / "scenes", folder / "data" / "scenes")
    return folder


# What a make that runs these tests hands down to a make within them: its options and its command line's variables.
HANDED_DOWN = {"MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES", "OPTIONS", "OUT", "SET", "SETS", "LIB", "SCENE"}


def run(command, folder):
    inherited = {name: value for name, value in os.environ.items() if name not in HANDED_DOWN}
    environment = inherited | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_commands_were_found():
    assert len(MAKE) + len(BRDFFIT) == len(COMMANDS)
    assert {"make bake", "make test"} <= set(MAKE)
    assert {line.split()[1] for line in BRDFFIT} == {
        "bake", "compare", "doctor", "inspect", "landscape", "library", "methods", "models", "neural", "plan", "probe",
        "scene",
    }  # fmt: skip


@pytest.mark.parametrize(
    "command", [pytest.param(each, marks=[pytest.mark.slow] * each.startswith(SLOW)) for each in BRDFFIT]
)
def test_a_command_runs(command, folder):
    result = run(shlex.split(command), folder)
    assert result.returncode == 0, result.stderr
    assert result.stdout


@pytest.mark.parametrize("command", MAKE)
def test_a_make_target_exists(command):
    result = run([*shlex.split(command), "--dry-run"], ROOT)
    assert result.returncode == 0, result.stderr
    named = set(re.findall(r"^(\w[\w-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.M))
    assert shlex.split(command)[1] in named


@pytest.mark.slow
@pytest.mark.parametrize("command", [line for line in MAKE if line.startswith("make bake")])
def test_make_bakes(command, tmp_path):
    if Path(sys.prefix).resolve() != ROOT / ".venv":
        pytest.skip("make would set up an environment of its own")
    result = run([*shlex.split(command), f"OUT={tmp_path}"], ROOT)
    assert result.returncode == 0, result.stderr
    assert [path.name for path in tmp_path.glob("*/preview.png")] == ["preview.png"]


def test_the_program_runs(folder):
    (program,) = [text for text in PROGRAMS if "import brdffit" in text]
    result = run([sys.executable, "-c", program], folder)
    assert result.returncode == 0, result.stderr
    assert len(result.stdout.splitlines()) == 4


def test_the_protocol_is_quoted_as_it_is():
    (quoted,) = [text for text in PROGRAMS if "class Method" in text]
    assert quoted.strip() in inspect.getsource(Method)


def test_tables_name_every_preset_and_quality():
    rows = {name: row for name, row in re.findall(r"^\| `(\w[\w-]*)` \|(.*)\|$", TEXT, re.M)}
    assert set(rows) == {*preset_names(), *QUALITIES}
    for name in preset_names():
        preset, cells = get_preset(name), [cell.strip() for cell in rows[name].split("|")]
        assert (cells[0], cells[2], cells[3]) == (preset.normal_y, preset.lobe, preset.specular)


def test_files_that_are_named_exist():
    for name in re.findall(r"\]\((\w[\w/.-]+)\)|`((?:brdffit|baselines)/[\w/]+\.py)`|`(data)/`", TEXT):
        assert (ROOT / "".join(name)).exists(), name
