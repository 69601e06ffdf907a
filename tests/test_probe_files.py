"""What a probe writes and reads: packed radiance, containers, presets, the folder, and sentences for bad input."""

import json
import subprocess
import sys

import numpy as np
import OpenImageIO as oiio
import pytest
from probes_support import lamps, latlong, probe, relative_l1, write_exr

from brdffit.errors import InputError
from brdffit.probes import bake, cli
from brdffit.probes.bake import ProbeOptions, bake_probe, make_probe
from brdffit.probes.containers import (
    RADIANCE_FORMATS,
    pack_r11g11b10f,
    pack_rgb9e5,
    read_cube_file,
    unpack_r11g11b10f,
    unpack_rgb9e5,
    write_cube,
)
from brdffit.probes.cubemap import directions, halved, mean_radiance
from brdffit.probes.curves import CURVES
from brdffit.probes.direct import packed_source
from brdffit.probes.filtering import METHODS, Exact
from brdffit.probes.harmonics import nine_basis
from brdffit.probes.presets import PRESETS
from brdffit.probes.reading import LAYOUTS
from brdffit.probes.shelf import named_environments
from brdffit.probes.split_sum import dfg_table, scale_and_bias
from brdffit.probes.sun import find_sun


def radiances():
    rng = np.random.default_rng(0)
    return (np.exp(rng.uniform(-8.0, 10.9, (4000, 1))) * rng.random((4000, 3))).astype(np.float32)


def test_shared_exponents_err_by_half_a_unit_of_the_largest_channel():
    x = radiances()
    back = unpack_rgb9e5(pack_rgb9e5(x))
    assert np.all(np.abs(back - x) <= x.max(axis=1, keepdims=True) / 512.0 * 1.0001)
    edge = np.array([[0.0, 0.0, 0.0], [65408.0, 1.0, 1e-9], [1e9, np.float32(511.7), 511.7]])
    back = unpack_rgb9e5(pack_rgb9e5(edge))
    np.testing.assert_allclose(back[:, 0], [0.0, 65408.0, 65408.0])


def test_small_floats_err_by_half_a_unit_of_their_mantissa():
    x = radiances()
    back = unpack_r11g11b10f(pack_r11g11b10f(x))
    unit = np.array([2.0**-7, 2.0**-7, 2.0**-6])
    assert np.all(np.abs(back - x) <= np.maximum(x, 2.0**-14) * unit * 1.0001)
    assert np.isfinite(unpack_r11g11b10f(pack_r11g11b10f(np.full((1, 3), 1e9)))).all()


def chain(n=32, levels=4):
    out = [lamps(n)]
    while len(out) < levels:
        out.append(halved(out[-1]))
    return out


@pytest.mark.parametrize("container, suffix", [("ktx2", ".ktx2"), ("dds", ".dds"), ("ktx1", ".ktx")])
@pytest.mark.parametrize("texel_format", RADIANCE_FORMATS)
def test_what_is_written_is_read_again(tmp_path, container, suffix, texel_format):
    if container == "ktx1" and RADIANCE_FORMATS[texel_format].opengl is None:
        return
    # A block holds a line of colours: no lamps of single texels.
    levels = [0.2 * directions(n) + 1.0 for n in (32, 16, 8, 4)] if texel_format == "bc6h" else chain()
    write_cube(tmp_path / f"cube{suffix}", container, levels, texel_format, {"sh": "1 2 3"})
    read = read_cube_file(tmp_path / f"cube{suffix}")
    assert read.texel_format == texel_format and len(read.levels) == 4
    bound = {"rgba32f": 0.0, "rgba16f": 1e-3, "rgb9e5": 2e-3, "r11g11b10f": 1.6e-2, "bc6h": 0.06}[texel_format]
    for stored, level in zip(read.levels, levels, strict=True):
        assert np.all(np.abs(stored - level) <= bound * level.max(axis=-1, keepdims=True))
    if container == "ktx1":
        assert read.metadata["sh"] == "1 2 3"


def test_blocks_are_written_as_a_cube_with_all_levels(tmp_path):
    levels = chain(levels=6)
    write_cube(tmp_path / "cube.dds", "dds", levels, "bc6h")
    sizes = [6 * max(n // 4, 1) ** 2 * 16 for n in (32, 16, 8, 4, 2, 1)]
    data = (tmp_path / "cube.dds").read_bytes()
    assert len(data) == 148 + sum(sizes)
    # Caps of a cube map with six faces; DXGI_FORMAT_BC6H_UF16, and the cube flag of the DX10 header.
    assert int.from_bytes(data[112:116], "little") == 0xFE00
    assert [int.from_bytes(data[at : at + 4], "little") for at in (128, 136)] == [95, 4]
    face = oiio.ImageInput.open(str(tmp_path / "cube.dds"))
    assert (face.spec().width, face.spec().nchannels) >= (32, 3)
    pixels = np.asarray(face.read_image(0, 0, 0, 3, oiio.FLOAT))
    face.close()
    # Whichever way the reader lays faces out, +X comes first.
    np.testing.assert_allclose(np.log2(pixels[:32, :32]), np.log2(levels[0][0]), atol=0.6)


def test_radiance_beyond_a_format_never_becomes_infinite(tmp_path):
    bright = [np.full((6, 16, 16, 3), 1e6, np.float32)]
    for texel_format in ("rgba16f", "rgb9e5", "r11g11b10f"):
        write_cube(tmp_path / "cube.ktx2", "ktx2", bright, texel_format)
        stored = read_cube_file(tmp_path / "cube.ktx2").levels[0]
        assert np.isfinite(stored).all()
        np.testing.assert_allclose(stored, RADIANCE_FORMATS[texel_format].largest, rtol=2e-2)


def test_damaged_and_foreign_files_are_named(tmp_path):
    write_cube(tmp_path / "cube.ktx2", "ktx2", chain(), "rgba16f")
    data = (tmp_path / "cube.ktx2").read_bytes()
    (tmp_path / "short.ktx2").write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match="truncated or damaged"):
        read_cube_file(tmp_path / "short.ktx2")
    (tmp_path / "no.ktx2").write_bytes(b"hello")
    with pytest.raises(InputError, match="no KTX2"):
        read_cube_file(tmp_path / "no.ktx2")
    (tmp_path / "none.ktx2").write_bytes(data[:20] + bytes(8) + data[28:])
    with pytest.raises(InputError, match="6 faces of 0x0"):
        read_cube_file(tmp_path / "none.ktx2")
    (tmp_path / "manifest.json").write_text('{"outputs": []}')
    result = probe(f"inspect {tmp_path}")
    assert result.exit_code == 1 and "is not the manifest of a probe" in result.output


def test_the_split_sum_has_its_closed_form_and_published_values():
    assert scale_and_bias(np.array([1.0]), 1.0).sum() == pytest.approx(1.0 - np.log(2.0), abs=1e-3)
    assert scale_and_bias(np.array([0.5]), 0.25)[0] == pytest.approx([0.835, 0.022], abs=1e-3)
    table = dfg_table(8)
    total = table.sum(axis=-1)
    # A smooth mirror of F0 = 1 loses nothing; no entry gives more than it gets.
    assert np.all(total <= 1.0 + 2e-3) and np.all(total[0] > 0.97)


def test_a_sun_is_found_where_it_is_and_a_sky_is_none():
    cube = np.full((6, 64, 64, 3), 0.3, np.float32)
    assert find_sun(cube) is None
    cube[2, 20:22, 40:42] = [20000.0, 18000.0, 15000.0]
    sun = find_sun(cube)
    expected = directions(64)[2, 20:22, 40:42].mean(axis=(0, 1))
    assert np.dot(sun.direction, expected / np.linalg.norm(expected)) > 0.99999
    assert sun.radiance == pytest.approx([20000.0, 18000.0, 15000.0], rel=1e-3)
    assert 0.5 < sun.share < 1.0


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """A lat-long picture of directions with a lamp."""
    picture = latlong(64)
    picture[20, 40] = 300.0
    path = tmp_path_factory.mktemp("environments") / "room.exr"
    write_exr(path, picture)
    return path


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_writes_what_it_promises(environment, tmp_path, preset):
    result = probe(f"{environment} -o {tmp_path} --for {preset} --size 32 --levels 5 --no-picture --centre=-z")
    assert result.exit_code == 0, result.output
    folder = tmp_path / "room"
    manifest = json.loads((folder / "manifest.json").read_text())
    assert {each.name for each in folder.iterdir()} == {*manifest["files"], "manifest.json"}
    assert [level["size"] for level in manifest["levels"]] == [32, 16, 8, 4, 2]
    assert all(level["error"] <= 0.01 and abs(level["bias"]) < 0.01 for level in manifest["levels"])
    assert manifest["curve"]["name"] == PRESETS[preset].curve and "lod" in manifest["curve"]
    if PRESETS[preset].container in ("ktx2", "ktx1"):
        stored = read_cube_file(folder / manifest["specular"]).levels
        # The colour of a rough direction is about its own: as the engine turns its look-up, it finds the world's.
        sign = np.array([-1.0 if PRESETS[preset].mirror == axis else 1.0 for axis in "xyz"])
        way = directions(stored[3].shape[1]) * sign
        assert np.corrcoef(stored[3].reshape(-1), (1.0 + way).reshape(-1))[0, 1] > 0.9
        assert len(stored) == 5


def test_harmonics_in_a_file_are_those_of_its_cube(environment, tmp_path):
    for preset in ("filament", "bevy", "plain"):
        probe(f"{environment} -o {tmp_path} --for {preset} --size 32 --levels 5 --no-picture --force")
        folder = tmp_path / "room"
        suffix = ".ktx" if preset == "filament" else ".ktx2"
        cube = read_cube_file(folder / f"irradiance{suffix}").levels[0]
        nine = np.array(json.loads((folder / "harmonics.json").read_text())["coefficients"])
        assert relative_l1(nine_basis(directions(32)) @ nine, cube) < 0.08


def test_a_bake_draws_states_and_is_not_made_twice(environment, tmp_path):
    command = f"{environment} -o {tmp_path} --size 32 --levels 4 --tolerance 0.005"
    first = probe(command)
    assert first.exit_code == 0 and "error" in first.output
    assert (tmp_path / "room" / "picture.png").stat().st_size > 10_000
    assert "up to date" in probe(command).output
    assert "up to date" not in probe(f"{command} --rotate 90").output
    described = probe(f"inspect {tmp_path}/room").output
    assert "A probe of" in described and "level 3" in described
    assert "rgb9e5, 4 levels" in probe(f"inspect {tmp_path}/room/specular.ktx2").output
    assert "latlong, 128x64" in probe(f"inspect {environment}").output


def test_only_what_is_copied_is_called_so(environment, tmp_path):
    """Brute force has no error either, and a copy has one where its texels were clamped."""
    command = f"{environment} -o {tmp_path} --size 32 --levels 4 --method brute --no-picture"
    lines = [line for line in probe(command).output.splitlines() if line.startswith("  level ")]
    assert ["copied" in line for line in lines] == [True, False, False, False]
    assert "error" not in lines[0] and "error 0.00%" in lines[1]
    picture = latlong(64)
    picture[20, 40] = 3e6
    write_exr(tmp_path / "sun.exr", picture)
    clamped = probe(f"{tmp_path}/sun.exr -o {tmp_path} --size 32 --levels 4 --no-picture").output
    assert "copied, error" in next(line for line in clamped.splitlines() if line.startswith("  level 0"))


def test_nothing_is_filtered_for_a_folder_that_cannot_be_written(environment, tmp_path, monkeypatch):
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "notes.txt").touch()
    monkeypatch.setattr(bake, "make_probe", None)
    result = probe(f"{environment} -o {tmp_path}")
    assert result.exit_code == 1 and "room' holds 'notes.txt'" in result.output


def test_a_probe_too_large_for_the_memory_is_refused(environment, monkeypatch):
    monkeypatch.setattr(bake, "free_memory", lambda: 2**20)
    with pytest.raises(InputError, match="a smaller --size"):
        make_probe(environment, ProbeOptions(size=64, levels=3))


def test_outputs_of_environments_of_one_name_have_two(environment, tmp_path):
    twin = tmp_path / environment.name
    twin.write_bytes(environment.read_bytes())
    assert named_environments([environment, twin]) == {"room": environment, "room-2": twin}


def test_one_damaged_environment_of_many_is_named(environment, tmp_path):
    many = tmp_path / "many"
    many.mkdir()
    for name in ("a", "b"):
        (many / f"{name}.exr").write_bytes(environment.read_bytes())
    (many / "broken.exr").write_bytes(environment.read_bytes()[:3000])
    result = probe(f"{many} -o {tmp_path}/out --size 16 --levels 3 --no-picture")
    assert result.exit_code == 1
    assert "2 of 3 environments done" in result.output and "broken.exr" in result.output
    assert {each.name for each in (tmp_path / "out").iterdir()} == {"a", "b"}


def test_scaling_keeps_what_clamping_cuts(tmp_path):
    picture = latlong(64)
    picture[20, 40] = 3e5
    write_exr(tmp_path / "sun.exr", picture)
    options = ProbeOptions(size=32, levels=3, texel_format="rgba16f")
    clamped = make_probe(tmp_path / "sun.exr", options)
    assert clamped.clamped > 0 and max(level.radiance.max() for level in clamped.levels) <= 65504.0
    scaled = make_probe(tmp_path / "sun.exr", ProbeOptions(size=32, levels=3, texel_format="rgba16f", scale=True))
    assert scaled.clamped == 0 and scaled.scale < 1.0
    assert max(level.radiance.max() for level in scaled.levels) <= 65504.0


@pytest.mark.parametrize(
    "changes, changed",
    [
        (dict(fit="lookup", texel_format="rgba32f"), [1, 2]),
        (dict(preset="godot", split=20.0), [0]),
        (dict(texel_format="rgba16f"), [0]),
    ],
    ids=["fitted", "cut", "clamped"],
)
def test_the_figures_of_a_level_are_those_of_its_texels_as_they_are_stored(tmp_path, changes, changed):
    picture = latlong(64)
    picture[20, 40] = 3e6
    write_exr(tmp_path / "sun.exr", picture)
    options = ProbeOptions(**{"size": 32, "levels": 4, "picture": False, **changes})
    made, manifest = bake_probe(tmp_path / "sun.exr", tmp_path / "out", options)
    for level, told in zip(made.levels, manifest["levels"], strict=True):
        request = level.request
        if request.alpha == 0.0:
            assert request.n == made.source.shape[1]
            error = relative_l1(level.radiance, made.source)
        else:
            error, bias = Exact(packed_source(made.source), request).error_and_bias(level.radiance)
            assert told["bias"] == pytest.approx(bias, abs=2e-6)
        energy = mean_radiance(level.radiance).sum() / mean_radiance(made.source).sum()
        assert told["error"] == pytest.approx(error, abs=2e-6)
        assert told["energy"] == pytest.approx(energy, abs=2e-6)
    assert all(manifest["levels"][k]["error"] > 0.02 for k in changed)


def test_no_stored_lobe_is_narrower_than_its_texel(tmp_path):
    """Narrow lobes are averaged over their texels: a lamp of one texel gives its energy wherever it lies."""
    for column in range(40, 46):
        picture = np.full((128, 256, 3), 0.01, np.float32)
        picture[40, column] = 1000.0
        write_exr(tmp_path / "lamp.exr", picture)
        averaged = make_probe(tmp_path / "lamp.exr", ProbeOptions("unreal", size=64, levels=5, tolerance=0.002))
        assert any("averaged" in note for note in averaged.notes)
        assert averaged.levels[1].request.points == 2
        assert averaged.levels[1].energy == pytest.approx(1.0, abs=5e-3)
    centre = make_probe(tmp_path / "lamp.exr", ProbeOptions("unreal", size=64, levels=5, keep_narrow=True))
    assert abs(centre.levels[1].energy - 1.0) > 0.01


@pytest.mark.parametrize(
    "asked, sentence",
    [
        (dict(size=48), "power of two"),
        (dict(levels=12), "levels were asked for"),
        (dict(curve="steep"), "no roughness curve"),
        (dict(tolerance=0.0), "tolerance"),
        (dict(size=0), "power of two"),
        (dict(size=1 << 20), "16 to 4096"),
        (dict(rotate=np.nan), "finite"),
        (dict(split=np.nan, method="sh"), "at least 1"),
        (dict(split=10.0), "takes no split"),
        (dict(preset="godot", texel_format="bc6h"), "EXR files of floats"),
        (dict(method="table", table="ggx-const-8"), "is for the curve"),
    ],
)
def test_what_cannot_be_asked_for_is_said(environment, asked, sentence):
    with pytest.raises(InputError, match=sentence):
        make_probe(environment, ProbeOptions(**{"size": 32, "levels": 4, **asked}))


@pytest.mark.parametrize("method, bound", [("brute", 1e-6), ("importance", 0.2), ("table", 0.15)])
def test_other_methods_state_their_error(environment, method, bound):
    options = ProbeOptions("activision", method=method, split=10.0, keep_narrow=True, table="ggx-const-8")
    if method == "brute":
        options = ProbeOptions("plain", size=32, levels=4, method=method)
    made = make_probe(environment, options)
    errors = [level.error for level in made.levels[1:]]
    assert max(errors) < bound


def test_the_command_line_knows_the_names_of_the_modules():
    assert set(cli.PRESET_NAMES) == set(PRESETS)
    assert set(cli.FORMAT_NAMES) == set(RADIANCE_FORMATS)
    assert set(cli.METHOD_NAMES) == set(METHODS)
    assert set(cli.LAYOUT_NAMES) <= set(LAYOUTS)
    assert {preset.curve for preset in PRESETS.values()} <= set(CURVES)


def test_help_of_probe_imports_nothing_heavy():
    script = (
        "import sys, brdffit.probes.cli; "
        "sys.exit(','.join({'numpy', 'scipy', 'numba', 'OpenImageIO', 'PIL'} & set(sys.modules)) or 0)"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
