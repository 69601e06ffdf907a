"""Which way cube maps lie: letters on faces, presets, and Filament's cmgen where it is installed."""

import json

import numpy as np
import pytest
from container_support import node
from probes_support import probe, relative_l1, write_exr

from brdffit.probes import compare
from brdffit.probes.bake import ProbeOptions, make_probe
from brdffit.probes.cmgen import beside_cmgen, installed
from brdffit.probes.containers import read_cube_file
from brdffit.probes.cubemap import directions, look_up
from brdffit.probes.harmonics import NINE_CONSTANTS, irradiance_nine, nine_basis
from brdffit.probes.letters import lettered_cube
from brdffit.probes.presets import PRESETS
from brdffit.probes.reading import as_cube, read_surroundings
from brdffit.probes.writing import latlong_of


def test_no_face_with_letters_is_another_turned_or_mirrored():
    cube = lettered_cube(64)
    stencils = [face.max(axis=-1) for face in cube]
    for face in stencils:
        turned = [np.rot90(face, k) for k in (1, 2, 3)] + [np.rot90(face[:, ::-1], k) for k in range(4)]
        # "+X" mirrored is nearly itself, but for its sides; each differs in some thousandth of its ink at least.
        assert min(np.abs(face - each).mean() for each in turned) > 1e-3
    assert len({tuple(np.round(face[4, 4], 3)) for face in cube}) == 6


def test_letters_come_back_from_a_lat_long_picture(tmp_path):
    write_exr(tmp_path / "letters.exr", latlong_of(lettered_cube(), 256))
    cube = as_cube(read_surroundings(tmp_path / "letters.exr"), 64)
    assert relative_l1(cube, lettered_cube(64)) < 0.1


@pytest.mark.parametrize("preset", [name for name, each in PRESETS.items() if each.container in ("ktx1", "ktx2")])
def test_an_engine_finds_the_letters_where_they_are(tmp_path, preset):
    """Looked up as the engine turns its directions, the stored faces are those of the world."""
    assert probe(f"letters -o {tmp_path} --for {preset} --size 64 --levels 3").exit_code == 0
    folder = tmp_path / "letters"
    assert (folder / "faces.png").stat().st_size > 5000
    stored = read_cube_file(folder / json.loads((folder / "manifest.json").read_text())["specular"]).levels[0]
    mirror = PRESETS[preset].mirror
    sign = np.array([-1.0 if mirror == axis else 1.0 for axis in "xyz"])
    world, at = lettered_cube(64), directions(64)
    assert np.abs(look_up(stored, at * sign) - world).mean() < 0.02
    assert not mirror or np.abs(look_up(stored, at) - world).mean() > 0.1


def test_the_centre_of_a_lat_long_picture_is_stated_and_may_be_overridden(tmp_path):
    picture = np.full((64, 128, 3), 0.1, np.float32)
    picture[31:33, 63:65] = 50.0
    write_exr(tmp_path / "mark.exr", picture)
    cases = (("plain", None, (0, 0, -1)), ("filament", None, (0, 0, 1)), ("plain", "+x", (1, 0, 0)))
    for preset, centre, wanted in cases:
        made = make_probe(tmp_path / "mark.exr", ProbeOptions(preset, size=16, levels=3, centre=centre))
        brightest = made.source.sum(axis=-1).reshape(-1).argmax()
        assert directions(made.source.shape[1]).reshape(-1, 3)[brightest] @ np.array(wanted) > 0.99
        assert made.preset.centre == (centre or PRESETS[preset].centre)


def test_inspect_draws_the_faces_of_files_and_folders(tmp_path):
    probe(f"letters -o {tmp_path} --size 32 --levels 3 --no-picture")
    for source in (tmp_path / "letters", tmp_path / "letters" / "specular.ktx2"):
        result = probe(f"inspect {source} -o {tmp_path}/faces.png")
        assert result.exit_code == 0 and "faces.png" in result.output
        assert (tmp_path / "faces.png").stat().st_size > 5000
        (tmp_path / "faces.png").unlink()


def test_filaments_file_holds_harmonics_with_their_constants(tmp_path):
    """Its shader sums sh[0] + sh[1] y + sh[2] z + ... + sh[8] (x^2 - y^2)."""
    probe(f"letters -o {tmp_path} --for filament --size 32 --levels 3 --no-picture")
    text = read_cube_file(tmp_path / "letters" / "specular.ktx").metadata["sh"]
    stored = np.array(text.split(), float).reshape(9, 3)
    at = directions(4).reshape(-1, 3)
    x, y, z = at.T
    drawn = np.stack([x**0, y, z, x, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y], axis=1) @ stored
    np.testing.assert_allclose(drawn, nine_basis(at) @ irradiance_nine(lettered_cube(64)), rtol=0.02, atol=0.01)


def test_other_readers_find_six_faces_and_all_levels(tmp_path):
    """KTX2 by ktx-parse, BC6H in DDS by three.js's DDSLoader."""
    for preset in ("plain", "three"):
        probe(f"letters -o {tmp_path}/{preset} --for {preset} --size 64 --levels 5 --no-picture")
    files = [tmp_path / "plain" / "letters" / "specular.ktx2", tmp_path / "three" / "letters" / "specular.dds"]
    result = node("cubes.mjs", *files)
    assert result.returncode == 0, result.stderr
    ktx, dds = (json.loads(line) for line in result.stdout.splitlines())
    assert ktx == {"faces": 6, "size": 64, "format": 123, "levels": 5}
    assert dds["cube"] and (dds["size"], dds["levels"]) == (64, 5)
    # Faces one after another, each with its levels; a block of 4x4 texels is 16 bytes.
    sizes = [[n, (n // 4) ** 2 * 16] for n in (64, 32, 16, 8, 4)]
    assert dds["images"] == 6 * sizes


def test_cmgen_agrees_about_the_world_and_errs_more(tmp_path):
    if not installed():
        pytest.skip("cmgen is not installed (Debian: libfilament-tools)")
    picture = latlong_of(lettered_cube(), 256)
    write_exr(tmp_path / "room.exr", picture)
    # Turned otherwise, cmgen's levels would be nothing like ours.
    assert beside_cmgen(tmp_path / "room.exr", 0.005, 1, 64)["cmgen"]["errors"][0] < 0.1
    picture[60:62, 100:102] = 20000.0
    write_exr(tmp_path / "room.exr", picture)
    record = beside_cmgen(tmp_path / "room.exr", 0.005, 1, 64)
    assert record["brdffit"]["error"] < 0.1 * record["cmgen"]["error"]


def test_the_comparison_goes_on_without_cmgen(monkeypatch, tmp_path):
    monkeypatch.setattr(compare, "installed", lambda: None)
    told = []
    assert compare._beside_cmgen([tmp_path / "a.hdr"], 1, 64, told.append) == []
    assert "not on the PATH" in told[0]
    assert NINE_CONSTANTS.shape == (9,)
