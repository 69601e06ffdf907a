"""The command line: names, exit codes, what is passed on; the bake itself is a fake here."""

import importlib.metadata
import re
import sys
import types
from pathlib import Path

import click
import numpy as np
import pytest
from click.testing import CliRunner

from brdffit.cli import bake, library, main
from brdffit.cli_options import MOVED
from brdffit.errors import InputError, OutputError, UnknownNameError
from brdffit.export.presets import preset_names
from brdffit.files.image_io import write_png
from brdffit.fitting.options import QUALITIES, FitOptions
from brdffit.fitting.status import CONVERGED, FALLBACK
from brdffit.methods import Baked, Level, Pyramid, get_method, method_names
from brdffit.models import model_names
from brdffit.options import described, make_options
from brdffit.svbrdf import Svbrdf, level_sizes
from brdffit.textures import READING_OPTIONS

METHODS = ["bfgs", "naive", "toksvig", "vmf", "lean", "filament", "godot", "flatten", "height", "ndm", "texture-space"]
MODELS = ["ggx", "blinn-phong", "ashikhmin-shirley", "beckmann", "generalised-beckmann"]


@pytest.fixture
def run():
    runner = CliRunner()
    return lambda *arguments: runner.invoke(main, [str(argument) for argument in arguments])


def small_pyramid():
    levels = []
    for height, width in level_sizes((4, 8)):
        three = np.ones((height, width, 3), dtype=np.float32)
        status = np.full((height, width), CONVERGED, dtype=np.uint8)
        status[0, 0] = FALLBACK
        levels.append(Level(Svbrdf(three, three, three, three), status=status, seconds=0.5))
    return Pyramid("bfgs", FitOptions(), levels)


@pytest.fixture
def baked(monkeypatch, tmp_path):
    """A stand-in for the bake: records how it was called, reports some progress, raises what it is told to."""
    calls = types.SimpleNamespace(arguments=None, error=None)

    def bake_to_folder(source, output, *, progress=None, **options):
        calls.arguments = {"source": source, "output": output, **options}
        progress.phase("compiling")
        progress.phase("fitting")
        progress(0, 10, 32)
        if calls.error is not None:
            raise calls.error
        progress(0, 32, 32)
        progress.phase("finishing")
        folder = tmp_path / "set"
        folder.mkdir()
        (folder / "preview.png").write_bytes(b"picture")
        return types.SimpleNamespace(
            folder=folder,
            baked=Baked.of_lobes(small_pyramid()),
            measured=[{"snr_db": 17.25, "energy_kept": 0.987}, {"snr_db": None}],
            notes=["A sentence for the user."],
            manifest={"preset": {"note": ""}},
            seconds={"compiling": 12.0, "fitting": 1.5},
        )

    monkeypatch.setitem(sys.modules, "brdffit.pipeline", types.SimpleNamespace(bake_to_folder=bake_to_folder))
    return calls


def test_help_names_the_commands(run):
    """That it starts without the heavy libraries is held in test_architecture."""
    shown = run("--help").stdout
    assert all(f"\n  {name} " in shown for name in main.commands)


@pytest.mark.parametrize(
    "command, names, expected", [("methods", method_names, METHODS), ("models", model_names, MODELS)]
)
def test_lists_are_plain_for_scripts_and_told_for_people(run, command, names, expected):
    plain = run(command, "--plain")
    assert plain.exit_code == 0 and plain.stdout.split("\n") == [*names(), ""]
    assert set(expected) <= set(names()) and names()[0] == expected[0]


def test_models_come_with_a_line_each(run):
    lines = run("models").stdout.splitlines()
    assert len(lines) == len(model_names())
    assert all(re.match(rf"{name} +\S+ \S", line) for name, line in zip(model_names(), lines, strict=True))


def test_methods_come_with_a_line_each(run):
    lines = run("methods").stdout.splitlines()
    assert len(lines) == len(method_names())
    assert all(re.match(rf"{name} +\S+ \S", line) for name, line in zip(method_names(), lines, strict=True))


def test_bake_passes_on_only_what_was_given(run, baked):
    """Defaults stand in one place: FitOptions, and the preset for what it cannot store."""
    assert run("bake", "some/set").exit_code == 0
    assert baked.arguments == {
        "source": "some/set", "output": Path("out"), "method": "bfgs", "preset": "plain", "bits": 8, "preview": True,
    }  # fmt: skip


def test_bake_passes_every_option_on(run, baked):
    arguments = (
        "set.gltf -o there --preset gltf --quality fine --method lean --model beckmann --set pixel_filter=mitchell "
        "--set levels=3 --threads 2 --normal-y dx --wrap clamp --set fit.specular=free --bits 16 --role normal=a.png "
        "--role orm=b=c.png --height-scale 4 --denoise-normals --material wall --no-preview --lights lamp "
        "--set fit.loss=l1"
    )
    assert run("bake", *arguments.split()).exit_code == 0
    assert baked.arguments == {
        "source": "set.gltf", "output": Path("there"), "preset": "gltf", "quality": "fine", "method": "lean",
        "model": "beckmann", "pixel_filter": "mitchell", "levels": "3", "threads": 2, "normal_y": "dx", "wrap": "clamp",
        "fit.specular": "free", "bits": 16, "roles": {"normal": "a.png", "orm": "b=c.png"}, "height_scale": 4.0,
        "denoise_normals": True, "material": "wall", "preview": False, "lights": "lamp",
        "fit.loss": "l1",
    }  # fmt: skip


def test_defaults_that_help_shows_are_those_of_the_options(run):
    shown = " ".join(run("bake", "--help").stdout.split())
    for option in ("quality", "model"):
        stretch = re.search(rf"--{option.replace('_', '-')} .*?\[default: \(([^;)]+)\)", shown)
        assert stretch and stretch[1] == str(getattr(FitOptions(), option)), option
    assert f"[{'|'.join(QUALITIES)}]" in shown


def test_bake_reports_levels_notes_times_and_where_it_is(run, baked):
    result = run("bake", "set")
    first = next(line.split() for line in result.stdout.splitlines() if "8x4" in line)
    assert first == ["0", "8x4", "17.2", "98.7%", "1", "64"]
    second = next(line.split() for line in result.stdout.splitlines() if "4x2" in line)
    assert second == ["1", "4x2", "-", "-", "1", "16"]
    assert "A sentence for the user." in result.stdout and "fitting 1.5 s" in result.stdout
    assert "preview.png" in result.stdout.splitlines()[-1]
    # The compile is announced, and told apart.
    assert "once on this machine" in result.stderr and "Compiled in" in result.stderr


@pytest.mark.parametrize(
    "error", [InputError("'x.png' is empty, expected an image."), OutputError("No room in 'out'.")]
)
def test_bad_input_and_output_exit_with_1_and_their_sentence(run, baked, error):
    baked.error = error
    result = run("bake", "set")
    assert result.exit_code == 1
    assert str(error) in result.stderr and "Traceback" not in result.output
    assert "8x4" not in result.stdout


def test_a_name_that_turns_out_unknown_exits_with_2(run, baked):
    baked.error = UnknownNameError("method", "no.module:Nothing", ["bfgs"])
    assert run("bake", "set", "--method", "no.module:Nothing").exit_code == 2
    assert baked.arguments["method"] == "no.module:Nothing"


@pytest.mark.parametrize(
    ("method", "sentence"),
    [("no.module:Nothing", "cannot be loaded: No module named 'no'"), ("json:loads", "is no method"),
     ("json:JSONDecoder", "is no method"), ("json:Nothing", "has no attribute 'Nothing'")],
)  # fmt: skip
def test_what_is_no_method_is_told(method, sentence):
    with pytest.raises(InputError, match=sentence):
        get_method(method)


def test_a_method_that_runs_only_when_named_is_known(run, baked):
    refused = run("bake", "set", "--method", "neural")
    assert refused.exit_code == 2 and "`brdffit neural train SET` makes what 'neural' learns" in refused.stderr
    assert baked.arguments is None and "neural" not in run("methods", "--plain").stdout
    assert "neural.file" in run("methods", "neural", "--plain").stdout


def test_an_interrupt_exits_with_130(run, baked):
    baked.error = KeyboardInterrupt()
    result = run("bake", "set")
    assert result.exit_code == 130 and "Interrupted" in result.stderr


@pytest.mark.parametrize(
    "option, wrong, near",
    [("--method", "leann", "lean"), ("--model", "beckman", "beckmann"), ("--preset", "unrael", "unreal")],
)
def test_unknown_names_exit_with_2_and_the_nearest(run, baked, option, wrong, near):
    result = run("bake", "set", option, wrong)
    assert result.exit_code == 2 and f"did you mean '{near}'?" in result.stderr
    assert baked.arguments is None


@pytest.mark.parametrize(
    "arguments",
    ["", "set --set levels", "set --set =3", "set --set levels=2 --set levels=3", "set --quality best", "set --bits 10",
     "set --role normal", "set --role normal=", "set --role =a.png", "set --role normal=a --role normal=b",
     "set --threads 0", "set --normal-y up", "set --wrap mirror", "set --no-such-option", "set another"],
)  # fmt: skip
def test_a_wrong_command_line_exits_with_2(run, baked, arguments):
    result = run("bake", *arguments.split())
    assert result.exit_code == 2 and "Error" in result.stderr and baked.arguments is None


def test_help_of_a_bake_fits_a_screen(run):
    assert len(run("bake", "--help").stdout.splitlines()) <= 50
    for command, most in ((bake, 14), (library, 14)):
        own = [each for each in command.params if isinstance(each, click.Option) and each.name not in READING_OPTIONS]
        assert len(own) <= most


@pytest.mark.parametrize("flag", MOVED)
def test_a_flag_that_left_says_where_it_went(run, baked, flag):
    command = "library" if flag == "--model" else "bake"
    result = run(command, "set", flag)
    assert result.exit_code == 2 and baked.arguments is None
    last = result.stderr.strip().splitlines()[-1]
    assert f"{flag} is now said by --set, for example --set {MOVED[flag]}" in last
    name, _, value = MOVED[flag].partition("=")
    assert make_options(FitOptions, {name: value}, "'bfgs'") != FitOptions()


def test_a_library_says_where_the_time_of_blocks_is_said(run):
    result = run("library", "sets", "--compress", "best")
    assert result.exit_code == 2 and 'compress = "best" under [options]' in result.stderr


def test_an_option_of_another_method_is_refused(run, tmp_path):
    for assignment, told in (("fit.loss=l1", "Method 'lean' has no option 'fit.loss'"), ("level=1", "'levels'")):
        result = run("bake", write_set(tmp_path / "waves"), "--method", "lean", "--set", assignment)
        assert result.exit_code == 2
        (line,) = result.stderr.strip().splitlines()
        assert told in line


def test_every_option_of_a_method_is_told(run):
    for name in method_names():
        lines = run("methods", name).stdout.splitlines()
        for each in described(get_method(name).options).values():
            (line,) = (line for line in lines if line.split()[:1] == [each.full_name])
            assert each.says in line and each.values in line
    assert run("methods", "bgfs").exit_code == 2


def test_an_unknown_command_exits_with_2(run):
    assert run("bakes").exit_code == 2


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_is_accepted(run, baked, name):
    assert run("bake", "set", "--preset", name).exit_code == 0
    assert baked.arguments["preset"] == name


def write_set(folder, roughness=0.5):
    """A normal map of gentle waves and a roughness map, as 8-bit pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    slope = 0.2 * np.sin(np.arange(16) * np.pi / 4)
    normal = np.stack(np.broadcast_arrays(slope, slope[:, None], 1.0), axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    write_png(folder / "waves_NormalGL.png", np.rint(127.5 + 127.5 * normal).astype(np.uint8))
    grey = np.linspace(roughness, roughness + 0.2, 256).reshape(16, 16, 1)
    write_png(folder / "waves_Roughness.png", np.rint(255 * grey).astype(np.uint8))
    return folder


def test_inspect_tells_roles_conventions_and_statistics(run, tmp_path):
    result = run("inspect", write_set(tmp_path / "waves"))
    assert result.exit_code == 0, result.stderr
    assert result.stdout.startswith("waves: 16x16, wrap tile, normal Y gl (name)")
    assert re.search(r"normal +waves_NormalGL.png +16x16 +8 ", result.stdout)
    assert re.search(r"roughness +waves_Roughness.png +16x16 +8 ", result.stdout)
    mean = re.search(r"roughness mean +(\S+)", result.stdout)
    assert mean and float(mean[1]) == pytest.approx(0.6, abs=0.01)


def test_inspect_reads_as_it_is_told(run, tmp_path):
    folder = write_set(tmp_path / "waves")
    (folder / "waves_NormalGL.png").rename(folder / "bumps.png")
    result = run("inspect", folder, "--role", "normal=bumps.png", "--normal-y", "dx", "--wrap", "clamp")
    assert result.exit_code == 0, result.stderr
    assert "wrap clamp, normal Y dx (given)" in result.stdout
    assert "DirectX" in result.stdout


def test_inspect_of_what_cannot_be_baked_exits_with_1(run, tmp_path):
    folder = write_set(tmp_path / "waves")
    write_png(folder / "waves_NormalGL.png", np.zeros((16, 16, 3), dtype=np.uint8))
    result = run("inspect", folder)
    assert result.exit_code == 1 and "Looks wrong" in result.stdout
    missing = run("inspect", tmp_path / "nowhere")
    assert missing.exit_code == 1 and "nowhere" in missing.stderr and not missing.stdout


def test_the_console_script_points_here():
    (script,) = [point for point in importlib.metadata.entry_points(group="console_scripts") if point.name == "brdffit"]
    assert script.load() is main


def test_a_picture_is_drawn_in_a_terminal_without_a_screen_and_nowhere_else(tmp_path, monkeypatch, capsys):
    from brdffit import console

    path = tmp_path / "preview.png"
    red_over_blue = np.zeros((4, 4, 3), np.uint8)
    red_over_blue[:2, :, 0], red_over_blue[2:, :, 2] = 255, 255
    write_png(path, red_over_blue)
    console.show_picture(path)
    assert capsys.readouterr().out == ""
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(console.sys, "platform", "linux")
    terminal = console.Console(force_terminal=True, color_system="truecolor", width=2)
    monkeypatch.setattr(console, "plain_console", lambda: terminal)
    console.show_picture(path)
    # One row of two half blocks: each is red above and blue below.
    assert capsys.readouterr().out.count("38;2;255;0;0;48;2;0;0;255m\u2580") == 2
