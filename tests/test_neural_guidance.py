"""A traced surface guides a neural material: where each point is seen, and the frames of texels."""

import numpy as np
import pytest
from neural_support import CheckeredDepth, shift_of

from brdffit.microgeometry.queries import TracedSource
from brdffit.microgeometry.tracer import Microgeometry
from brdffit.nets.training import train
from brdffit.neural.guidance import GUIDED, set_texels, true_shifts
from brdffit.neural.network import Design, Network
from brdffit.neural.questions import directions, random_queries
from brdffit.neural.training import NeuralTask
from brdffit.svbrdf import Svbrdf
from brdffit.textures.encoding import height_gradient, normals_from_gradient, slopes_of_normals

SIDE = 32


#: Albedos of the left and of the right half of a tile.
ORANGE, BLUE = (0.6, 0.25, 0.05), (0.05, 0.2, 0.4)


def waves(side=SIDE, height=2.0, normal=None, halves=None):
    """A surface of two waves, of a lobe with an alpha of 0.2; grey, or with ``halves`` of two albedos."""
    row, column = np.indices((side, side)) + 0.5
    heights = (height * np.sin(2.0 * np.pi * column / side) * np.cos(2.0 * np.pi * row / side)).astype(np.float32)
    ones = np.ones((side, side, 3), np.float32)
    log = np.full_like(ones, 2.0 * np.log(0.2))
    log[..., 2] = 0.0
    if normal is None:
        normal = normals_from_gradient(height_gradient(heights, "tile")).astype(np.float32)
    specular, diffuse = 0.3 * ones, 0.2 * ones
    if halves is not None:
        specular, diffuse = 0.04 * ones, np.where(column[..., None] < side / 2, *halves).astype(np.float32)
    return Microgeometry.of(Svbrdf(normal, log, specular, diffuse, height=heights), threads=1)


class Alone:
    """A source that answers queries and does not tell its surface."""

    def __init__(self, source):
        self.size, self.query = source.size, source.query


def test_shifts_are_told_in_texels_of_the_material():
    source = waves()
    queries = random_queries(200, (16, 16), np.random.default_rng(1), 0.0)
    fine = source.parallax(2.0 * queries[:, :2].astype(float), directions(queries)[1])
    assert np.abs(fine).max() > 1.0
    np.testing.assert_allclose(true_shifts(source, (16, 16), queries), 0.5 * fine, atol=1e-5)


def test_a_plane_has_its_own_slopes_and_alpha():
    normal = np.zeros((SIDE, SIDE, 3), np.float32)
    normal[:] = np.array([-0.3, 0.2, 1.0]) / np.linalg.norm([-0.3, 0.2, 1.0])
    network = Network(Design((16, 16)))
    kept = network.pyramid.reshape(-1, 8)[:, GUIDED:].copy()
    set_texels(waves(height=0.0, normal=normal), network)
    texels = network.pyramid.reshape(-1, 8)
    np.testing.assert_allclose(texels[:, :2], np.broadcast_to([0.3, -0.2], (len(texels), 2)), atol=1e-5)
    np.testing.assert_allclose(np.exp(-4.0 * texels[:, 2]), 0.2**2, rtol=1e-3)
    assert np.array_equal(texels[:, GUIDED:], kept)


def test_colours_are_the_means_of_the_maps_under_each_filter():
    network = Network(Design((16, 16)))
    set_texels(waves(halves=(ORANGE, BLUE)), network)
    masks = 0.1 + 1.0 / (1.0 + np.exp(-network.pyramid.reshape(-1, 8)[:, 3:6].astype(float)))
    orange, blue = (np.array(each) + 0.04 for each in (ORANGE, BLUE))
    # Shares of the largest, 0.64; none below the bound of 0.1 + 0.02.
    expected = [np.clip(each / 0.64, 0.12, 1.0) for each in (orange, blue, 0.5 * (orange + blue))]
    first = masks[:256].reshape(16, 16, 3)
    for found, each in zip((first[5, 4], first[5, 12], masks[-1]), expected, strict=True):
        np.testing.assert_allclose(found, each, atol=0.01)


def test_a_guided_material_finds_hues_within_a_hundred_steps(tmp_path):
    source = waves(halves=(ORANGE, BLUE))
    task = NeuralTask(source, (16, 16), seed=2, threads=1)
    train(task, tmp_path / "hues.npz", minutes=None, steps=100, seed=2)
    queries = random_queries(2000, (16, 16), np.random.default_rng(5), 0.0)
    true, found = task.answers.to(queries, 1, 64), task.learner.predict(queries)
    lit = true.sum(axis=1) > 0.1
    hue = [(each[lit, 0] - each[lit, 2]) / np.maximum(each[lit].sum(axis=1), 0.1) for each in (true, found)]
    assert np.std(hue[0]) > 0.3
    assert np.sqrt(np.mean(np.square(hue[1] - hue[0]))) < 0.4 * np.std(hue[0])


def test_the_coarsest_width_is_the_variance_of_all_slopes_and_lobes():
    source, network = waves(height=1.0), Network(Design((16, 16)))
    set_texels(source, network)
    slopes = slopes_of_normals(source.normals).reshape(-1, 2)
    expected = slopes.var(axis=0).sum() + 0.2**2
    np.testing.assert_allclose(np.exp(-4.0 * network.pyramid.reshape(-1, 8)[-1, 2]), expected, rtol=0.02)


@pytest.mark.slow
def test_a_guided_material_learns_the_parallax_and_keeps_what_the_surface_gives(tmp_path):
    source = waves()
    task = NeuralTask(source, (16, 16), seed=2, threads=1)
    given = task.network.pyramid.reshape(-1, 8)[:, :GUIDED].copy()
    train(task, tmp_path / "waves.npz", minutes=None, steps=400, seed=2)
    assert np.array_equal(task.network.pyramid.reshape(-1, 8)[:, :GUIDED], given)
    queries = random_queries(300, (16, 16), np.random.default_rng(3), 0.0)
    true = true_shifts(source, (16, 16), queries)
    wrong = np.array([shift_of(task.network, query) for query in queries]) - true
    assert np.abs(wrong).mean() < 0.4 * np.abs(true).mean()
    # Of the same queries without the surface.
    alone = NeuralTask(Alone(source), (16, 16), seed=2, threads=1)
    train(alone, tmp_path / "alone.npz", minutes=None, steps=400, seed=2)
    error, without = (each.held.errors(each.learner)[0] for each in (task, alone))
    assert error[:2].sum() < 0.8 * without[:2].sum()


@pytest.mark.parametrize("paper", [False, True])
def test_neither_the_paper_nor_other_sources_are_guided(paper):
    assert isinstance(waves(), TracedSource) and not isinstance(CheckeredDepth(), TracedSource)
    task = NeuralTask(waves() if paper else CheckeredDepth(), (16, 16), paper=paper, threads=1)
    before = task.network.pyramid.copy()
    assert task.guide is None
    task.accumulate(np.random.default_rng(4))
    gradient = task.trained["pyramid"].gradient.reshape(-1, 8)
    assert np.abs(gradient[:, :GUIDED]).max() > 0.0 and np.abs(task.trained["offset"].gradient).max() > 0.0
    assert np.array_equal(task.network.pyramid, before)
