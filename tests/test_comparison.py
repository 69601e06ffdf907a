"""The comparison: what it measures on sets whose answer is known, and that its records are whole."""

import dataclasses
import re

import numpy as np
import pytest
from click.testing import CliRunner
from report_support import comparison as handmade

from brdffit.cli import main
from brdffit.comparison import views
from brdffit.comparison.compare import _free_name, _name, compare
from brdffit.comparison.lobes import SIDE, lobe_view, representative_texels, same_place
from brdffit.comparison.maps import TILE, map_strip
from brdffit.comparison.options import CompareOptions, variant
from brdffit.comparison.set_comparison import SetComparison
from brdffit.comparison.surroundings import read_environment
from brdffit.errors import InputError, UnknownNameError
from brdffit.files.image_io import write_png
from brdffit.fitting.options import FitOptions
from brdffit.render import lights, scenes
from brdffit.render.environment import Environment
from brdffit.report.records import (
    KEPT_SUFFIX,
    MOST_ANISOTROPY,
    PROBE_LIGHTING,
    picture_names,
    to_json,
    unpack,
)
from brdffit.report.summary import groups, overall, through_probe
from brdffit.report.writing import write_report
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf, level_sizes

#: As little as still shows everything.
SMALL = {"pixels": 16, "frames": 3, "texels": 4, "pairs": 16, "lobes": 2, "samples": "draft"}


def material(size=(16, 16), bumps=0.0, seed=3):
    """A grey metal of perceptual roughness 0.5; bumps are random slopes."""
    random = np.random.default_rng(seed)
    slope = bumps * random.standard_normal((*size, 2))
    normal = np.concatenate([slope, np.ones((*size, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    full = np.ones((*size, 3), np.float32)
    log_roughness = log_tensor_from_perceptual(np.full(size, 0.5, np.float32))
    return Svbrdf(normal.astype(np.float32), log_roughness, 0.6 * full, 0.1 * full)


def small_ask(*methods, **options):
    return CompareOptions(methods=methods, options={"quality": "draft", "threads": 1, **options}, **SMALL)


@pytest.fixture(scope="module")
def bumpy():
    """(Comparison, pictures) of a bumpy set by four methods, of which one wants a height map."""
    phases = []

    class Listener:
        def phase(self, text):
            phases.append(text)

        def __call__(self, level, done, total):
            assert done <= total

    found = compare([material(bumps=0.2)], small_ask("bfgs", "naive", "vmf", "height"), listener=Listener())
    assert any("baking by naive (2 of 4)" in phase for phase in phases)
    return found


def test_a_constant_material_is_kept_by_every_method():
    """Whatever averages equal texels finds them again: no error is left but that of single precision."""
    result = compare([material()], small_ask("bfgs", "naive", "toksvig", "lean"))[0].sets[0]
    for each in result.methods:
        for level in each.levels:
            assert level.half_angle_snr_db > 60.0, (each.method, level)
            assert level.pair_snr_db > 60.0, (each.method, level)
            assert level.energy_kept == pytest.approx(1.0, abs=1e-3)
    for view in result.views:
        for shot in view.shots:
            if shot.figures is not None:
                # Light that has a size is sampled on both sides; halves take the noise out of the squared error, but
                # for what is left of it over so few pixels, and leave it in what is seen.
                sampled = view.lighting != "small lights"
                assert shot.figures.snr_db > (45.0 if sampled else 60.0), (view.key, shot.method)
                assert shot.figures.flip_ldr < (0.015 if sampled else 0.01)
            else:
                assert shot.change == pytest.approx(1.0, abs=0.05), (view.key, shot.method)


def test_records_are_whole(bumpy):
    found, pictures, _ = bumpy
    result = found.sets[0]
    assert [each.method for each in result.methods] == ["bfgs", "naive", "vmf"]
    assert sorted(picture_names(found)) == sorted(pictures)
    assert all(picture.dtype == np.uint8 for picture in pictures.values())
    # A slice in time: pixels of a column down, frames across.
    assert pictures["pictures/set-1/rotation-bfgs.png"].shape == (SMALL["pixels"], SMALL["frames"], 3)
    assert pictures["pictures/set-1/near-environment-reference.png"].shape == (10, 10, 3)
    assert {view.group for view in result.views} == {"distance", "motion", "scene"}
    for view in result.views:
        shown = [shot.method for shot in view.shots]
        assert shown[:3] == ["bfgs", "naive", "vmf"]
        assert all((shot.figures is None) == (view.group == "motion") for shot in view.shots)
        assert all((shot.change is None) == (view.group != "motion") for shot in view.shots)
    assert [level.size for level in result.methods[0].levels] == level_sizes((16, 16))
    assert result.distances == {"near": 0, "mid": 3, "far": 4}
    assert {lobe.level for lobe in result.lobes} == {1, 3, 4}
    assert all(set(lobe.grids) == {"reference", "bfgs", "naive", "vmf"} for lobe in result.lobes)
    assert found.machine["cores"] and found.machine["numpy"]
    assert [info.name for info in found.methods if info.fit] == ["bfgs"]


def test_views_of_the_environment_are_drawn_once_more_through_a_probe():
    asked = dataclasses.replace(small_ask("naive"), lit=("environment",), through_probe="activision")
    found, pictures, _ = compare([material(bumps=0.2)], asked)
    seen = {view.key: view for view in found.sets[0].views}
    for key in ("near-environment", "mid-environment", "far-environment", "sphere"):
        exact, through = seen[key], seen[key + "-probe"]
        assert (exact.lighting, through.lighting) == ("environment", PROBE_LIGHTING)
        assert exact.exposure == through.exposure
        np.testing.assert_array_equal(pictures[exact.reference], pictures[through.reference])
        assert (pictures[exact.shots[0].picture] != pictures[through.shots[0].picture]).any()
    # Methods are not ranked by them.
    assert [row.views for row in overall(found)] == [sum(not key.endswith("-probe") for key in seen) - 2]
    assert groups(found)[-1] == ("through a probe", PROBE_LIGHTING)
    (row,) = through_probe(found)
    assert row.views == 5 and row.probe_db < row.exact_db and row.probe_error > row.exact_error


def test_a_method_that_cannot_is_told_with_its_sentence(bumpy):
    (skipped,) = bumpy[0].sets[0].skipped
    assert skipped.method == "height"
    assert "height" in skipped.reason and skipped.reason.endswith(".")


def test_averaged_maps_lose_to_the_fit_on_bumps(bumpy):
    figures = {each.method: each.levels[2] for each in bumpy[0].sets[0].methods}
    assert figures["bfgs"].half_angle_snr_db > figures["vmf"].half_angle_snr_db > figures["naive"].half_angle_snr_db


def test_level_0_is_shown_filtered_and_as_authored(bumpy):
    kept = "bfgs" + KEPT_SUFFIX
    where = [view.key for view in bumpy[0].sets[0].views if any(shot.method == kept for shot in view.shots)]
    assert where == ["near-small-lights", "near-lamps", "near-environment", "shift", "rotation"]


@pytest.mark.parametrize(("options", "kept"), [({}, ["naive" + KEPT_SUFFIX]), ({"keep_level_0": True}, [])])
def test_nothing_is_kept_twice(options, kept):
    work = SetComparison("set", material(), small_ask("naive", **options), ["naive"], studio(), None)
    assert list(work._kept([work.base, material((8, 8))], "naive")) == kept


def test_a_comparison_can_be_written_and_read(bumpy, tmp_path):
    path = write_report(*bumpy[:2], tmp_path / "report")
    assert b"height" in path.read_bytes()
    assert to_json(bumpy[0])


def test_the_report_links_a_page_of_the_viewer_and_keeps_it_when_drawn_anew(tmp_path):
    asked = dataclasses.replace(small_ask("naive", "lean", "bfgs", "vmf", "toksvig"), viewer=True)
    made = compare([material(bumps=0.2)], asked)
    assert list(made.viewer) == [made.comparison.sets[0].viewer] == ["viewer/set-1.html"]
    names = re.findall(r'"name":"(.*?)"', made.viewer["viewer/set-1.html"])
    assert names == ["bfgs", "lean", "vmf"]  # the fit first; the page makes averages itself
    folder = tmp_path / "report"
    page = write_report(made.comparison, made.pictures, folder, made.viewer)
    assert 'href="viewer/set-1.html"' in page.read_text(encoding="utf-8")
    before = (folder / "viewer" / "set-1.html").read_bytes()
    result = CliRunner().invoke(main, ["compare", "--from", str(folder / "records.json")])
    assert result.exit_code == 0, result.output
    assert (folder / "viewer" / "set-1.html").read_bytes() == before
    (folder / "viewer" / "set-1.html").unlink()
    result = CliRunner().invoke(main, ["compare", "--from", str(folder / "records.json")])
    assert result.exit_code == 1 and "viewer/set-1.html" in result.output


@pytest.mark.slow
def test_a_set_that_the_viewer_cannot_draw_has_no_page():
    asked = dataclasses.replace(small_ask("naive"), viewer=True)
    made = compare([material().replace(model="beckmann")], asked)
    assert made.viewer == {} and made.comparison.sets[0].viewer == ""


def test_no_method_at_all():
    with pytest.raises(InputError, match=r"No method can bake 'set-1'.*height"):
        compare([material()], small_ask("height"))


def test_sets_of_one_name_are_told_apart():
    assert _free_name("steel", []) == "steel"
    assert _free_name("steel", ["steel", "steel-2"]) == "steel-3"


def test_a_picture_that_is_no_environment_is_told(tmp_path):
    for name, size, told in (("square", (8, 8), "is 8x8, expected a lat-long"), ("strip", (4, 24), "is a strip, ")):
        write_png(tmp_path / f"{name}.png", np.full(size, 128, np.uint8))
        with pytest.raises(InputError, match=told):
            read_environment(str(tmp_path / f"{name}.png"))


def test_pictures_of_eight_bits_light_a_scene_linearly(tmp_path):
    write_png(tmp_path / "grey.png", np.full((4, 8), 128, np.uint8))
    write_png(tmp_path / "sky.png", np.full((4, 8, 4), 128, np.uint8))
    # 128 of 255 is 0.2158 by the formula of IEC 61966-2-1.
    for name in ("grey", "sky"):
        np.testing.assert_allclose(read_environment(str(tmp_path / f"{name}.png")).radiance, 0.2158, atol=1e-4)


def test_a_set_is_called_as_its_folder(tmp_path):
    (tmp_path / "steel.v2").mkdir()
    assert _name(tmp_path / "steel.v2", 0) == "steel.v2"
    assert _name(tmp_path / "steel.gltf", 0) == "steel"


def test_what_is_asked():
    ask = CompareOptions.of(methods=["bfgs,naive", "lean", "naive"], quick=True, quality="fine")
    assert ask.methods == ("bfgs", "naive", "lean")
    assert ask.pixels < CompareOptions().pixels and ask.options == {"quality": "fine"}
    assert CompareOptions.of(quick=True).options == {"quality": "draft"}
    with pytest.raises(UnknownNameError, match="naive"):
        CompareOptions.of(methods=["naiv"])
    with pytest.raises(UnknownNameError, match="did you mean 'held'"):
        CompareOptions.of(methods=["bfgs+hold"])


def test_a_variant_is_the_method_with_another_option():
    method, options = variant("bfgs+held+isotropic", {"quality": "draft"})
    assert method.name == "bfgs"
    assert options == FitOptions(quality="draft", specular="held", lobe="isotropic")


def studio():
    grey = Environment(np.ones((8, 16, 3), np.float32))
    return views.Studio(pixels=12, frames=4, samples="draft", environment=grey, lights=lights.few(), threads=1)


def test_frames_side_by_side_are_the_frames():
    base, angles = material(bumps=0.2), [0.0, 0.3, 0.9]
    parts = [scenes.plane(base.size, 0, (12, 1), rotation=angle) for angle in angles]
    together = studio().method([base], scenes.side_by_side(parts), views.SMALL_LIGHTS)
    apart = [studio().method([base], part, views.SMALL_LIGHTS) for part in parts]
    assert np.array_equal(together, np.concatenate(apart, axis=2))
    assert not np.array_equal(apart[0], apart[2])


def test_a_still_surface_moves_with_its_reference():
    """The change of a method that is the reference is 1, whatever the scene; a brighter one changes more."""
    frames = {"reference": np.random.default_rng(2).random((3, 4, 4, 3))}
    frames |= {"same": frames["reference"], "twice": 2.0 * frames["reference"]}
    assert [shot.change for shot in views._moving_shots(frames)] == [1.0, pytest.approx(2.0)]


def test_distances_are_held_to_the_levels_there_are():
    assert views.distances_of((1024, 1024)) == {"near": 0, "mid": 3, "far": 7}
    assert views.distances_of((16, 4)) == {"near": 0, "mid": 3, "far": 4}
    assert views.distances_of((1024, 1024), 2) == {"near": 0, "mid": 1, "far": 1}


def test_the_lobe_of_a_constant_material_is_its_own():
    base = material()
    view = lobe_view(base, {"naive": base}, 0, (3, 5), pixel_filter="box", errors={"naive": np.inf})
    truth, own = (unpack(view.grids[name], (SIDE, SIDE)) for name in ("reference", "naive"))
    assert truth.max() == pytest.approx(1.0, abs=1e-3)
    assert np.abs(truth - own).max() < 2e-3
    # Through the peak at h = z, and symmetric about it.
    assert view.peak_at == pytest.approx((0.0, 0.0), abs=1e-6)
    assert np.abs(truth - truth[::-1, ::-1]).max() < 2e-3
    # GGX at its peak is rho / (pi alpha^2), here with the blur of a cell in alpha^2.
    blurred = 0.5**4 + (view.extent / (SIDE - 1)) ** 2
    assert view.peak == pytest.approx(0.6 / (np.pi * blurred), rel=1e-3)
    assert view.snr_db == {"naive": 99.0}


def test_the_lobe_of_a_ridge_is_long_across_it():
    """Normals that lean left and right make an apparent lobe that is wide in x, and its axis says so."""
    base = material((8, 8))
    lean = np.where(np.arange(8) % 2, 0.25, -0.25)[None, :].repeat(8, axis=0)
    normal = np.stack([lean, np.zeros((8, 8)), np.sqrt(1 - lean**2)], axis=-1).astype(np.float32)
    base = base.replace(normal=normal, log_roughness=log_tensor_from_perceptual(np.full((8, 8), 0.3, np.float32)))
    level = material((4, 4))
    view = lobe_view(base, {"naive": level}, 1, (1, 1), pixel_filter="box", errors={"naive": 0.0})
    assert abs(view.axis[0]) > 0.999
    truth = unpack(view.grids["reference"], (SIDE, SIDE))
    assert (truth.max(axis=0) > 0.2).sum() > 2 * (truth.max(axis=1) > 0.2).sum()


def test_texels_are_quantiles_of_the_error():
    errors = np.array([5.0, 1.0, 3.0, 2.0, 4.0])
    columns, rows = np.arange(5), 10 * np.arange(5)
    assert representative_texels(errors, columns, rows, 3) == [(1, 10), (2, 20), (0, 0)]
    assert len(representative_texels(errors, columns, rows, 9)) == 5
    assert same_place((3, 0), (4, 4), (16, 8)) == (7, 2)
    assert same_place((0, 0), (1, 1), (1, 1)) == (0, 0)


def test_maps_by_hand():
    half = material((2, 2))
    stretched = half.log_roughness.copy()
    stretched[..., 0] += 2.0 * np.log(MOST_ANISOTROPY)
    strip = map_strip([half, half.replace(log_roughness=stretched)])
    assert strip.shape == (2 * TILE, 2 * TILE) and strip.dtype == np.uint8
    assert (strip[:TILE, :TILE] == 128).all() and (strip[TILE:, :TILE] == 0).all()
    assert (strip[TILE:, TILE:] == 255).all()


def test_the_command_wants_sets_or_records(tmp_path):
    for arguments in ([], ["data/sets/none", "--from", "records.json"]):
        result = CliRunner().invoke(main, ["compare", *arguments])
        assert result.exit_code == 2 and "--from" in result.output
    result = CliRunner().invoke(main, ["compare", str(tmp_path / "none"), "--methods", "naiv"])
    assert result.exit_code == 2 and "did you mean 'naive'" in result.output


def test_the_command_draws_anew_and_prints_the_table(tmp_path):
    folder = tmp_path / "report"
    write_report(*handmade(), folder)
    (folder / "index.html").unlink()
    result = CliRunner().invoke(main, ["compare", "--from", str(folder / "records.json")])
    assert result.exit_code == 0, result.output
    assert (folder / "index.html").exists()
    lines = {line.split()[0]: line for line in result.output.splitlines() if line.split()}
    assert "*21.0" in lines["bfgs"] and "*" not in lines["height"]
    assert "no height. It has no height map." in result.output
