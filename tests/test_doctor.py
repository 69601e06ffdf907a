"""The doctor: what is built into a set is found, where it was put; what is not there is not; a manifest is believed."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner
from test_fitting import surface

from brdffit.cli import main
from brdffit.doctor import LEAST_SHARE, diagnose
from brdffit.errors import InputError
from brdffit.pipeline import bake_to_folder
from brdffit.textures.procedural import make_set

SIZE = (32, 32)
ALPHA_FLOOR = 0.045**2


def cases(svbrdf, **options):
    return {finding.case: finding for finding in diagnose(svbrdf, quality="draft", levels=2, **options).findings}


def test_a_quiet_set_has_no_hard_case():
    diagnosis = diagnose(surface(SIZE, spread=0.05, alpha=0.3, colour=(0.5, 0.5, 0.5)), quality="draft")
    assert not diagnosis.findings and not diagnosis.notes
    assert [each.level for each in diagnosis.levels] == [0, 1, 2, 3, 4, 5]


def test_what_lies_where_nothing_is_does_not_count():
    opacity = np.ones(SIZE, np.float32)
    opacity[:, 16:] = 0.0
    one = surface(SIZE, spread=0.05, alpha=0.3, colour=(0.5, 0.5, 0.5)).replace(opacity=opacity, wrap="clamp")
    other = one.replace(**{name: getattr(one, name).copy() for name in ("normal", "log_roughness", "specular")})
    other.specular[:, 20:], other.log_roughness[:, 20:, :2] = 1.0, 2.0 * np.log(0.02)
    last = [diagnose(each, quality="draft").levels[-1].treatment.measured_db for each in (one, other)]
    # Without weights the mirrors of the other half take 20 dB; with them the nodes differ, which at 40 dB is 2 or 3.
    assert last[0] > 30.0 and last[1] == pytest.approx(last[0], abs=4.0)


def place(base, case):
    """Put one hard case into the block at row 8, column 16."""
    block = np.s_[8:16, 16:24]
    if case == "normals on the horizon":
        base.normal[9, 17] = 1.0, 0.0, 0.0
    elif case == "steep normals":
        base.normal[9, 17] = np.array([5.0, 0.0, 1.0]) / np.sqrt(26.0)
    elif case == "mirrors at the roughness floor":
        base.log_roughness[9, 17, :2] = 2.0 * np.log(ALPHA_FLOOR)
    elif case == "roughness one":
        base.log_roughness[9, 17, :2] = 0.0
    elif case == "strong anisotropy":
        base.log_roughness[9, 17] = -1.0, -7.0, 0.0
    elif case == "no specular":
        base.specular[9, 17] = 0.0
    elif case == "needles":
        base.log_roughness[8:10, 16:18, :2] = 2.0 * np.log(0.01)
        base.normal[9, 17] = 0.6, 0.0, 0.8
    elif case == "sharp lobes beside wide ones":
        base.log_roughness[8:12, 16:24, :2] = 2.0 * np.log(0.03)
    elif case == "single bright texels":
        base.specular[block] = 1e-3
        base.specular[9, 17] = 1.0
    elif case == "colour that goes with the normal":
        base.normal[block], base.normal[8:12, 16:24] = (0.6, 0, 0.8), (-0.6, 0, 0.8)
        base.specular[block], base.specular[8:12, 16:24] = (1, 0.5, 0), (0, 0.5, 1)
    elif case == "brightness that goes with the normal":
        base.normal[block], base.normal[8:12, 16:24] = (0.6, 0, 0.8), (-0.6, 0, 0.8)
        base.specular[block], base.specular[8:12, 16:24] = 1.0, 0.05
    else:
        raise AssertionError(case)


@pytest.mark.parametrize(
    "case, level",
    [
        ("normals on the horizon", 0),
        ("steep normals", 0),
        ("mirrors at the roughness floor", 0),
        ("roughness one", 0),
        ("strong anisotropy", 0),
        ("no specular", 0),
        ("needles", 1),
        ("sharp lobes beside wide ones", 3),
        ("single bright texels", 3),
        ("colour that goes with the normal", 3),
        ("brightness that goes with the normal", 3),
    ],
)
def test_what_was_put_there_is_found_there(case, level):
    base = surface(SIZE, slopes=(0.0, 0.0), alpha=0.3, colour=(0.5, 0.5, 0.5))
    place(base, case)
    found = cases(base)[case]
    assert found.level == level and found.texels >= 1
    assert found.texels / (SIZE[0] * SIZE[1] >> 2 * level) == found.share >= LEAST_SHARE
    top = found.worst[0]
    assert top[0] == level and (top[1], top[2]) == ((17, 9) if level == 0 else (16 >> level, 8 >> level))
    assert sum(found.treatment.statuses.values()) == found.treatment.texels == len(found.worst)
    assert found.meaning.endswith(".")


def test_odd_sizes_are_told():
    assert any("no power of two" in note for note in diagnose(surface((9, 5)), quality="draft").notes)


def test_flat_maps_that_dither_and_short_normals_are_told_from_the_files(tmp_path):
    import OpenImageIO as oiio

    def write(name, pixels):
        spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], "uint8")
        out = oiio.ImageOutput.create(str(tmp_path / name))
        assert out.open(str(tmp_path / name), spec) and out.write_image(np.ascontiguousarray(pixels)) and out.close()

    rng = np.random.default_rng(0)
    normal = np.dstack([rng.integers(127, 129, (16, 16, 2)), np.full((16, 16), 255)])
    normal[0, 0, 2] = 254  # a blue channel that says something
    write("wall_normal_gl.png", normal.astype(np.uint8))
    write("wall_roughness.png", np.full((16, 16, 3), 10, np.uint8))
    assert "normals that their codes cannot tell" in cases(tmp_path)
    assert "flat map that dithers" not in cases(tmp_path)
    assert "flat map that dithers" in cases(tmp_path, reading={"denoise_normals": True})
    normal = np.dstack([rng.integers(90, 165, (16, 16, 2)), rng.integers(200, 230, (16, 16))])
    write("wall_normal_gl.png", normal.astype(np.uint8))
    assert "short normals" in cases(tmp_path)


def test_a_manifest_says_what_the_bake_did(tmp_path):
    folder = make_set("glossy-tiles", tmp_path / "glossy-tiles", size=32)
    report = bake_to_folder(folder, tmp_path / "out", quality="draft", preview=False, specular="held")
    diagnosis = diagnose(folder, manifest=report.folder / "manifest.json")
    assert diagnosis.options["quality"] == "draft" and diagnosis.options["specular"] == "held"
    for level, record in zip(diagnosis.levels, report.manifest["levels"], strict=True):
        assert level.treatment.statuses == record["statuses"]
        assert level.treatment.measured_db == record["snr_db"]
    for text in ("{}", "[", '{"options": {}, "levels": []}'):
        (tmp_path / "broken.json").write_text(text)
        with pytest.raises(InputError, match=r"^'.*broken\.json' .*expected the manifest\.json of a bake\.$"):
            diagnose(folder, manifest=tmp_path / "broken.json")


def test_the_command_prints_and_gives_json(tmp_path):
    folder = make_set("grooved-record", tmp_path / "grooved-record", size=32)
    printed = CliRunner().invoke(main, ["doctor", str(folder), "--quality", "draft"])
    assert printed.exit_code == 0, printed.output
    assert "grooved-record: 32x32" in printed.output and "The hardest level is" in printed.output
    asked = CliRunner().invoke(main, ["doctor", str(folder), "--quality", "draft", "--json"])
    record = json.loads(asked.stdout)
    assert record["name"] == "grooved-record" and {each["case"] for each in record["findings"]}
    for finding in record["findings"]:
        assert finding["case"] in printed.output
