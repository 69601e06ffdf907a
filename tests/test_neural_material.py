"""Training, files and commands of neural materials."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from neural_support import CheckeredDepth

from brdffit.appearance import Appearance, Lookups
from brdffit.cli import main
from brdffit.errors import InputError
from brdffit.methods import get_method, method_names
from brdffit.microgeometry.queries import Queries, read_queries, write_queries
from brdffit.microgeometry.tracer import Microgeometry
from brdffit.nets.training import checkpoint_path, train
from brdffit.nets.weights import read_weights, write_weights
from brdffit.neural.material import read_material
from brdffit.neural.measured import Measured
from brdffit.neural.questions import RADIUS, Answers, batch_of, directions, error_of, random_queries
from brdffit.neural.source import learned_size
from brdffit.neural.training import NeuralTask, check_memory
from brdffit.pipeline import read_set
from brdffit.render import scenes
from brdffit.render.pictures import render_appearance
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.procedural import make_set
from brdffit.textures.reading import read_texture_set

SIZE = (32, 32)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A material learned for a few seconds, and its path."""
    path = tmp_path_factory.mktemp("neural") / "checker.npz"
    task = NeuralTask(CheckeredDepth(), SIZE, seed=1)
    train(task, path, minutes=None, steps=800, seed=1)
    return task, path


def test_batches_are_spread_evenly_and_directions_are_upper_units():
    queries = batch_of((16, 8), np.random.default_rng(2))
    cells = np.floor(queries[:, :2] * 2).astype(int)
    assert len(np.unique(cells, axis=0)) == len(queries) == 4 * 16 * 8
    for each in directions(queries):
        np.testing.assert_allclose(np.linalg.norm(each, axis=1), 1.0, atol=1e-6)
        assert each[:, 2].min() >= np.sqrt(1 - RADIUS**2) - 1e-5


def test_answers_are_asked_in_texels_of_the_source():
    """A material of half the texels reads the same points, under a filter twice as wide in the source's texels."""

    class Recorder:
        size = (64, 32)

        def query(self, position, sigma, light, view, seed):
            self.asked = position, sigma
            return np.ones((len(position), 3), np.float32)

    source = Recorder()
    queries = random_queries(10, (32, 16), np.random.default_rng(3), 2.0)
    found = Answers(source, (32, 16)).to(queries, 0)
    np.testing.assert_allclose(source.asked[0], 2.0 * queries[:, :2], rtol=1e-6)
    np.testing.assert_allclose(source.asked[1], 2.0 * 0.5 * 4)
    # pi M cos: that of a white surface that faces the light is 1.
    np.testing.assert_allclose(found[:, 0], np.pi * directions(queries)[0][:, 2], rtol=1e-5)


def test_errors_hold_no_noise_of_the_truth():
    rng = np.random.default_rng(8)
    truth, found = rng.uniform(0, 1, (2, 200000, 3))
    error, power = error_of(found, truth + rng.standard_normal((2, 200000, 3)))
    np.testing.assert_allclose([error, power], [np.mean((found - truth) ** 2), np.mean(truth**2)], atol=0.01)


def test_learning_lowers_the_error_tenfold_and_the_offset_helps(trained, tmp_path):
    task, _ = trained
    task.learner.refresh(0.0)
    error, power = task.held.errors(task.learner)
    assert (error < 0.1 * power).all()
    flat = NeuralTask(CheckeredDepth(), SIZE, seed=1, with_offset=False)
    train(flat, tmp_path / "flat.npz", minutes=None, steps=800, seed=1)
    flat.learner.refresh(0.0)
    assert error[0] < 0.6 * flat.held.errors(flat.learner)[0][0]


def test_files_hold_what_was_learned(trained):
    task, path = trained
    material = read_material(path)
    assert isinstance(material, Appearance)
    queries = random_queries(500, SIZE, np.random.default_rng(4))
    task.learner.refresh(0.0, as_stored=True)
    np.testing.assert_array_equal(material.reader.predict(queries), task.learner.predict(queries))
    found, meta = read_weights(path, "neural material")
    error, _ = task.held.errors(task.learner)
    np.testing.assert_allclose(meta["mse_by_level"], error, rtol=1e-3)
    # Two textures of 7 channels of 16 bits, a third more for levels, and the networks.
    assert sum(each.nbytes for each in found.values()) < 1024 * (7 / 3 * 14 + 1) + 4 * task.network.design.weights


def test_the_material_is_drawn_as_it_was_learned(trained):
    """Through ``Appearance``: radiance over pi of the same queries, the same for any tile and any size of base."""
    _, path = trained
    material = read_material(path, base=(64, 64))
    queries = random_queries(300, SIZE, np.random.default_rng(5), 2.0)
    light, view = directions(queries)
    # The box of a pixel is as wide as a Gaussian of 1 / sqrt(12) pixels; level 2 is one of 2 texels, 4 of the base's.
    detail = np.full(300, np.log2(4.0 * np.sqrt(12.0)))
    lookups = Lookups(2.0 * queries[:, :2] + np.array([64.0, -128.0]), np.zeros((300, 2, 2)), detail, view)
    texels = material.look_up(lookups)
    expected = material.reader.predict(queries) / np.pi
    np.testing.assert_allclose(material.evaluate(texels, view, light), expected, atol=2e-4)


def test_samples_follow_their_density(trained):
    material = read_material(trained[1])
    rng = np.random.default_rng(6)
    lookups = Lookups(np.zeros((20000, 2)), np.zeros((20000, 2, 2)), np.zeros(20000), np.tile([0.0, 0, 1], (20000, 1)))
    texels = material.look_up(lookups)
    drawn = material.sample(texels, lookups.view, rng.random((20000, 2)))
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0, atol=1e-9)
    # The mean of z / pdf is the integral of z over the hemisphere.
    ratio = drawn[:, 2] / material.pdf(texels, lookups.view, drawn)
    np.testing.assert_allclose(ratio.mean(), np.pi, rtol=1e-6)
    assert material.evaluate(texels, -lookups.view, drawn).max() == 0.0


def test_same_seed_same_material_on_any_number_of_threads_and_when_resumed(tmp_path, monkeypatch):
    def learned(name, threads, **more):
        task = NeuralTask(CheckeredDepth(), (16, 16), seed=5, threads=threads)
        train(task, tmp_path / name, minutes=None, steps=30, seed=5, **more)
        return {key: value.tobytes() for key, value in task.network.parameters().items()}

    def stopped(seconds, step, done, loss, figure):
        if step == 17:
            raise KeyboardInterrupt

    one = learned("one.npz", 1)
    assert learned("two.npz", 2) == one
    # A checkpoint after each step, and an interrupt before that of the last.
    monkeypatch.setattr("brdffit.nets.training._FIGURE_SECONDS", -1.0)
    with pytest.raises(KeyboardInterrupt):
        learned("three.npz", 2, told=stopped)
    assert read_weights(checkpoint_path(tmp_path / "three.npz"), "checkpoint of neural material")[1]["steps"] == 16
    assert learned("three.npz", 1, resume=True) == one
    assert not checkpoint_path(tmp_path / "three.npz").exists()


def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    file = tmp_path / "material.npz"
    task = NeuralTask(CheckeredDepth(), (16, 16))
    arrays = {f"{name}.{kind}": each.weights for name, each in task.networks().items()
              for kind in ("weights", "mean", "square")}  # fmt: skip
    meta = {"kind": "checkpoint of neural material", "steps": 1, "seconds": 1.0, "losses": [], "figures": []}

    def resumed(**said):
        write_weights(checkpoint_path(file), arrays, meta | said)
        train(task, file, minutes=None, steps=1, resume=True, settings=task.settings)

    resumed(**task.settings, seed=0)
    file.unlink()
    for said, sentence in (
        ({"seed": 0}, "is of an older version of brdffit: train without --resume"),
        ({**task.settings, "seed": 1}, "has seed 1, expected 0"),
        ({**task.settings, "seed": 0, "paper": True}, "has paper True, expected False"),
    ):
        with pytest.raises(InputError, match=sentence):
            resumed(**said)
        assert not file.exists()


def test_the_paper_learns_radiance_under_unit_irradiance_on_the_plane(tmp_path):
    task = NeuralTask(CheckeredDepth(), (8, 8), seed=6, paper=True)
    train(task, tmp_path / "paper.npz", minutes=None, steps=200, seed=6)
    material = read_material(tmp_path / "paper.npz")
    assert material.network.design.weights == 3332 and material.on_plane
    # A fixed set of 220 queries a texel.
    assert len(task.batches) == task.kept and sum(len(q) for q, _ in task.batches.values()) == pytest.approx(
        220 * 64, rel=0.1
    )
    queries = random_queries(64, (8, 8), np.random.default_rng(7), 0.0)
    light, view = directions(queries)
    lookups = Lookups(
        queries[:, :2].astype(float), np.zeros((64, 2, 2)), np.full(64, np.log2(0.5 * np.sqrt(12.0))), view
    )
    found = material.evaluate(material.look_up(lookups), view, light)
    np.testing.assert_allclose(found, material.reader.predict(queries) * light[:, 2:] / np.pi, atol=1e-4)
    error, power = task.held.errors(task.learner)
    assert (error < 0.3 * power).all()


@pytest.mark.parametrize("damage", ["digest", "shape", "nan", "size", "kind", "text", "older"])
def test_damaged_materials_are_one_sentence(trained, tmp_path, damage):
    arrays, meta = read_weights(trained[1], "neural material")
    path = tmp_path / "damaged.npz"
    if damage == "digest":
        text = json.dumps({**meta, "digest": "0" * 64})
        np.savez(path, **arrays, meta=np.array(text))
    elif damage == "text":
        path.write_text("no weights")
    else:
        if damage == "shape":
            arrays["pyramid.1"] = arrays["pyramid.1"][:-1]
        if damage == "nan":
            arrays["decoder.1.weight"][3, 4] = np.nan
        changed = {"size": {"size": [32, 24]}, "kind": {"kind": "other"}, "older": {"own_colour": None}}.get(damage, {})
        write_weights(path, arrays, {**meta, **changed})
    with pytest.raises(InputError) as caught:
        read_material(path)
    assert str(path) in str(caught.value) and str(caught.value).count(". ") == 0
    result = CliRunner().invoke(main, ["neural", "render", str(path), "-o", str(tmp_path / "out")])
    assert result.exit_code == 1 and result.output.startswith("Error: ")
    assert not (tmp_path / "out").exists()


def test_sizes_become_powers_of_two_and_that_is_told():
    assert learned_size((512, 512), 128) == ((128, 128), [])
    size, notes = learned_size((300, 200), 100)
    assert size == (128, 64) and "200x300 texels is learned as 64x128" in notes[0]
    assert "nothing finer" in learned_size((64, 64), 128)[1][0]
    with pytest.raises(InputError, match="cannot be learned"):
        learned_size((64, 64), 100000)


def test_memory_is_predicted(monkeypatch):
    check_memory((128, 128))
    monkeypatch.setattr("brdffit.neural.training.free_memory", lambda: 1000 * 1000)
    with pytest.raises(InputError, match="GiB of memory"):
        check_memory((128, 128))


def test_without_height_nothing_is_written(tmp_path):
    make_set("brushed-metal", tmp_path / "flat", 32)
    for each in (tmp_path / "flat").glob("*Height*"):
        each.unlink()
    result = CliRunner().invoke(main, ["neural", "train", str(tmp_path / "flat"), "-o", str(tmp_path / "m.npz")])
    assert result.exit_code == 1 and "has no height map" in result.output
    assert not list(tmp_path.glob("*.npz"))


def test_a_place_that_cannot_be_written_is_told_before_the_training(tmp_path):
    (tmp_path / "file").touch()
    for output, told in (("file/material.npz", "is a file, expected a folder"), ("folder.npz", "is a folder")):
        (tmp_path / "folder.npz").mkdir(exist_ok=True)
        result = CliRunner().invoke(main, ["neural", "train", str(tmp_path), "-o", str(tmp_path / output)])
        assert result.exit_code == 1 and told in result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.npz"]


def test_commands_train_resume_render_and_tell(tmp_path):
    make_set("pebbles", tmp_path / "pebbles", 32)
    file, out = tmp_path / "pebbles.npz", tmp_path / "out"
    asked = ["neural", "train", str(tmp_path / "pebbles"), "-o", str(file), "--size", "16", "--steps", "40"]
    result = CliRunner().invoke(main, asked, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert file.is_file() and file.with_suffix(".svg").is_file() and not checkpoint_path(file).exists()
    again = CliRunner().invoke(main, [*asked, "--resume"])
    assert again.exit_code == 1 and "no checkpoint" in again.output
    drawn = CliRunner().invoke(main, ["neural", "render", str(file), "-o", str(out)], catch_exceptions=False)
    assert drawn.exit_code == 0 and "level 4: MSE" in drawn.output and (out / "pebbles.png").is_file()
    told = CliRunner().invoke(main, ["neural", "info", str(file)], catch_exceptions=False)
    assert "16x16 texels, 5 levels, 3407 weights" in told.output and "level 4" in told.output


def test_the_method_learns_or_reads_a_material_and_is_drawn(tmp_path):
    method = get_method("neural")
    # It trains for minutes: only where it is named.
    assert "neural" not in method_names()
    read = read_set(make_set("pebbles", tmp_path / "pebbles", 32), {}, method.options())
    baked = method.bake(read.material, method.options(steps=30, size=16))
    assert baked.lobes is None and baked.appearance.base_size == (32, 32) and baked.sizes[0] == (32, 32)
    assert "learned in 30 steps" in baked.notes[-1]
    with pytest.raises(InputError, match="has none"):
        flat = read.material.svbrdf.replace(height=None)
        method.bake(type(read.material)(flat), method.options(steps=1))
    picture = render_appearance(baked.appearance, scenes.plane((32, 32), 1, (24, 24)))
    assert np.isfinite(picture).all() and picture.mean() > 1e-3


def measured_file(path, count=6000, radius=0.9):
    """Queries of a traced surface in a file, as a goniometer would have them."""
    svbrdf = to_svbrdf(read_texture_set(make_set("pebbles", path.parent / "pebbles", 32)))
    source, rng = Microgeometry.of(svbrdf), np.random.default_rng(1)
    asked = random_queries(count, (32, 32), rng)
    asked[:, 3:7] *= np.float32(radius / RADIUS)
    light, view = directions(asked)
    sigma = 0.5 * 2.0 ** asked[:, 2]
    value = sum(source.query(asked[:, :2], sigma, light, view, seed) for seed in range(4)) / 4.0
    arrays = (asked[:, :2], sigma, light, view, value)
    write_queries(path, Queries(*(np.asarray(each, np.float32) for each in arrays), size=(32, 32)))
    return path


def test_a_material_is_learned_from_measured_queries(tmp_path):
    source, file = measured_file(tmp_path / "measured.npz"), tmp_path / "material.npz"
    found = []
    for steps in (2, 400):
        asked = ["neural", "train", str(source), "-o", str(file), "--size", "16", "--steps", str(steps)]
        result = CliRunner().invoke(main, asked, catch_exceptions=False)
        assert result.exit_code == 0 and "6000 measured queries, 23 a texel of level 0" in result.output
        found.append(read_weights(file, "neural material")[1]["mse_by_level"])
    first, last = np.array(found)
    assert len(last) == 5 and last.mean() < 0.5 * first.mean()
    drawn = CliRunner().invoke(main, ["neural", "render", str(file), "-o", str(tmp_path)], catch_exceptions=False)
    assert drawn.exit_code == 0 and "the sheet shows the material alone" in drawn.output


def test_queries_of_directions_that_are_not_learned_are_left_out(tmp_path):
    found = read_queries(measured_file(tmp_path / "measured.npz", 2000))
    tilted = found._replace(light=np.tile(np.float32([0.995, 0.0, np.sqrt(1 - 0.995**2)]), (2000, 1)))
    with pytest.raises(InputError, match="at least 1024 queries .* within 79 degrees of the normal, and 0 of 2000"):
        Measured(tilted, (16, 16))
    kept = Measured(found, (16, 16))
    assert len(kept.held) == 125 and len(kept.queries) == 1875
    # A texel of this material is two of the file's, and so one level less.
    assert np.array_equal(np.sort(kept.queries[:, 2])[:5], np.zeros(5, np.float32))
    queries, targets = kept.batch(256, np.random.default_rng(0))
    assert (np.diff(queries[:, 1]) >= 0).all() and targets.shape == (256, 3)


def test_a_file_without_queries_is_refused(tmp_path, trained):
    asked = ["neural", "train", str(trained[1]), "-o", str(tmp_path / "m.npz"), "--steps", "1"]
    result = CliRunner().invoke(main, asked)
    assert result.exit_code == 1 and "holds no queries" in result.output and not (tmp_path / "m.npz").exists()
