"""Neural materials: kernels against a slow oracle and against differences, the same bytes on any number of threads."""

import numpy as np
import pytest
from neural_support import predicted, shift_of

from brdffit.neural.network import Design, Learner, Network, Reader
from brdffit.neural.pyramid import Layout, periodic_taps

#: Sums of a few dozen float32 products through four layers.
SINGLE = 2e-5
#: Of a float32 gradient against differences in float64 of a function with kinks.
QUOTIENT = 0.01

SIZE = (8, 16)


def queries(count, rng, size=SIZE):
    made = np.zeros((count, 8), np.float32)
    made[:, :2] = rng.uniform(-20, 40, (count, 2))
    made[:, 2] = rng.uniform(0, max(size).bit_length() - 1, count)
    made[:, 3:7] = rng.uniform(-0.65, 0.65, (count, 4))
    return made


def network_of(**design):
    """One whose offsets are large enough to matter and whose levels differ."""
    network = Network(Design(SIZE, **design), seed=3)
    rng = np.random.default_rng(4)
    for name, layers in network.design.layers.items():
        for k in range(len(layers)):
            weight, bias = network.taken(name, k)
            gain = {("offset", 3): 8.0, ("decoder", 3): 0.28}.get((name, k), 1.0)
            network.put(name, k, weight * gain, 0.1 * rng.standard_normal(len(bias)))
    texels = network.pyramid.reshape(-1, 8)
    texels[:, :7] *= 4
    # Lobes of an alpha about 0.2, within the bounds of the width.
    texels[:, 2] = 0.8 + 0.4 * rng.uniform(-1, 1, len(texels))
    return network


DESIGNS = [{"tilted": False}, {"tilted": True}, {"tilted": True, "with_offset": False}]


def test_the_paper_has_3332_weights():
    assert Design((128, 128), tilted=False).weights == 3332


@pytest.mark.parametrize("design", DESIGNS)
def test_both_stages_are_what_the_formulas_say(design):
    network = network_of(**design)
    asked = queries(150, np.random.default_rng(5))
    expected = np.array([predicted(network, query) for query in asked])
    assert (expected > 0.1).any() and (expected < 0).any()
    np.testing.assert_allclose(Reader(network, 1).predict(asked), np.maximum(expected, 0), atol=SINGLE)


def test_a_guided_design_begins_with_white_light_on_the_colours_of_its_texels():
    network = Network(Design(SIZE, with_offset=False), seed=3)
    colour = np.array([1.2, 0.0, -2.2])
    network.pyramid.reshape(-1, 8)[:, 3:6] = colour
    found = np.array([predicted(network, query) for query in queries(200, np.random.default_rng(10))])
    bright = found[np.abs(found[:, 0]) > 0.05]
    masks = 0.1 + 1.0 / (1.0 + np.exp(-colour))
    assert len(bright) > 50
    np.testing.assert_allclose(bright / bright[:, :1], np.broadcast_to(masks / masks[0], bright.shape), atol=0.15)


def loss_of(network, asked, targets, logarithmic, held, sigma):
    found = np.array([predicted(network, query, sigma) for query in asked])
    if logarithmic:
        return float(((np.log1p(found) - np.log1p(targets)) ** 2).mean())
    return float((((found - targets) / (1 + held)) ** 2).mean())


@pytest.mark.parametrize("sigma", [0.0, 1.3])
@pytest.mark.parametrize("logarithmic", [True, False])
@pytest.mark.parametrize("design", DESIGNS)
def test_gradients_are_those_of_differences(design, logarithmic, sigma):
    network = network_of(**design)
    rng = np.random.default_rng(6)
    asked, targets = queries(64, rng), rng.uniform(0, 2, (64, 3)).astype(np.float32)
    learner = Learner(network, 1)
    learner.refresh(sigma)
    loss, gradients = learner.accumulate(asked, targets, logarithmic)
    held = np.array([predicted(network, query, sigma) for query in asked])
    # Below, the gradient passes a clamp straight through, so that what went too low comes back.
    assert held.min() > -0.2
    assert loss == pytest.approx(loss_of(network, asked, targets, logarithmic, held, sigma), rel=1e-4)
    assert set(gradients) == set(network.parameters())
    check_gradients(network, gradients, lambda: loss_of(network, asked, targets, logarithmic, held, sigma), rng)


def check_gradients(network, gradients, loss, rng):
    """Each gradient against differences along it, which no cancellation hides, and a little off it."""
    for name, gradient in gradients.items():
        values = network.parameters()[name]
        assert np.abs(gradient).max() > 0
        direction = gradient / np.abs(gradient).max()
        direction += 0.2 * rng.standard_normal(direction.size) * (gradient != 0)
        step = 1e-4 / np.abs(direction).max()
        kept, ends = values.copy(), []
        for side in (1, -1):
            # What float32 makes of the step is divided by.
            values[:] = kept + np.float32(side * step) * direction
            ends.append((loss(), values.astype(float)))
        values[:] = kept
        expected = float(gradient.astype(float) @ (ends[0][1] - ends[1][1]))
        assert ends[0][0] - ends[1][0] == pytest.approx(expected, rel=QUOTIENT), name


@pytest.mark.parametrize("sigma", [0.0, 1.3])
def test_gradients_of_the_guided_offset_are_those_of_differences(sigma):
    network = network_of()
    rng = np.random.default_rng(16)
    asked, true = queries(64, rng), rng.uniform(-1, 1, (64, 2)).astype(np.float32)
    learner = Learner(network, 1)
    learner.refresh(sigma)
    loss, gradients = learner.guide(asked, true)

    def expected() -> float:
        wrong = np.array([shift_of(network, query, sigma) for query in asked]) - true
        return float((np.sqrt(np.square(wrong).sum(axis=1) + 0.25**2) - 0.25).mean())

    assert loss == pytest.approx(expected(), rel=1e-4)
    assert set(gradients) == {"offset", "offset_texture"}
    check_gradients(network, gradients, expected, rng)


def test_gradients_are_the_same_bytes_on_any_number_of_threads():
    rng = np.random.default_rng(7)
    asked, targets = queries(64 * 21, rng), rng.uniform(0, 2, (64 * 21, 3)).astype(np.float32)
    found = []
    for threads in (1, 2, 5):
        learner = Learner(network_of(), threads)
        learner.refresh(0.7)
        found.append([learner.accumulate(asked, targets, False) for _ in range(2)])
    for other in found[1:]:
        for (loss, gradients), (expected_loss, expected) in zip(other, found[0], strict=True):
            assert loss == expected_loss
            assert all(gradients[name].tobytes() == expected[name].tobytes() for name in expected)


def test_one_noisy_sample_leaves_the_mean_where_it_is():
    """The default loss has the gradient 0, on average, at the mean of its targets; the logarithm's has not."""
    network = network_of(with_offset=False)
    network.put("decoder", 3, network.taken("decoder", 3)[0], np.full(6, 0.7))
    rng = np.random.default_rng(8)
    asked = np.repeat(queries(1, rng), 64 * 400, axis=0)
    asked[:, 2] = 1.0
    truth = predicted(network, asked[0])
    assert truth.min() > 0.1
    noise = rng.exponential(1.0, (len(asked), 3))
    targets = (truth * noise / noise.mean(axis=0)).astype(np.float32)
    pulls = {}
    for logarithmic in (True, False):
        learner = Learner(network, 1)
        gradients = learner.accumulate(asked, targets, logarithmic)[1]
        pulls[logarithmic] = np.abs(gradients["decoder"]).max()
    assert pulls[False] < 0.05 * pulls[True]


@pytest.mark.parametrize("sigma", [0.0, 0.6, 3.0, 8.0])
def test_blur_is_its_own_adjoint_and_keeps_the_mean(sigma):
    layout = Layout(SIZE)
    rng = np.random.default_rng(9)
    ones, out = np.ones(layout.learned, np.float32), np.zeros(layout.floats, np.float32)
    layout.read_through(ones, sigma, out)
    np.testing.assert_allclose(out, 1.0, atol=1e-6)
    a, b = (rng.standard_normal(n).astype(np.float32) for n in (layout.learned, layout.floats))
    layout.read_through(a, sigma, out)
    assert float(out.astype(float) @ b) == pytest.approx(float(a.astype(float) @ layout.pull_back(b, sigma)), abs=1e-3)


@pytest.mark.parametrize("length", [2, 4, 64])
@pytest.mark.parametrize("sigma", [0.3, 1.0, 5.0])
def test_taps_are_the_gaussian_summed_over_periods(length, sigma):
    from neural_support import circulant

    taps = periodic_taps(sigma, length)
    row = np.zeros(length)
    np.add.at(row, np.arange(-(len(taps) // 2), len(taps) // 2 + 1) % length, taps)
    np.testing.assert_allclose(row, circulant(sigma, length)[0], atol=1e-6)
