"""Layers against plain numpy and against differences; Adam against its formula; files of weights."""

import json

import numpy as np
import pytest

from brdffit._jit import kernel
from brdffit.errors import InputError
from brdffit.nets.adam import Adam
from brdffit.nets.doubles import (
    EIGHT,
    chosen,
    eight,
    exponential,
    greatest,
    least,
    logarithm,
    magnitude,
    put,
    root,
    with_sign,
)
from brdffit.nets.layers import DenseChain, DenseNet
from brdffit.nets.weights import digest_of, read_weights, shaped, write_weights

#: Sums of a thousand float32 products.
SINGLE = 2e-4
#: Of a difference quotient in float32 of a function with kinks.
QUOTIENT = 0.02


@kernel
def eightfold(a, b, out, logs, powers):
    for i in range(0, a.size, EIGHT):
        x, y = eight(a, i), eight(b, i)
        z = least(greatest(root(x) * 2.0 + 1.0 / y - x, -1.0), 0.5)
        put(out, i, chosen(x - 0.5, z, with_sign(magnitude(z), y)))
        put(logs, i, logarithm(x))
        put(powers, i, exponential(y))


def matrix(net, layer):
    """A dense layer's weights as (inputs, outputs), from their blocks."""
    blocks = layer.blocks_of(net.weights)[:, 0]
    return blocks.transpose(1, 2, 0, 3).reshape(layer.ins * 16, layer.outs * 16).astype(float)


def chain_by_numpy(net, rows):
    values = rows.astype(float)
    for layer in net.layers:
        values = np.pad(values, ((0, 0), (0, 16 * layer.ins - values.shape[1]))) @ matrix(net, layer)
        values += net.weights[layer.bias]
        values = np.where(values > 0, values, layer.slope * values)
    return values[:, : net.sizes[-1]]


def convolution_by_numpy(net, layer, image):
    """Zeros beyond the border; image (H, W, C)."""
    r, side = layer.reach, 2 * layer.reach + 1
    height, width = image.shape[:2]
    image = np.pad(image, ((r, r), (r, r), (0, 16 * layer.ins - image.shape[2])))
    blocks = layer.blocks_of(net.weights).astype(float)
    out = np.zeros((height, width, 16 * layer.outs)) + net.weights[layer.bias]
    for tap in range(side * side):
        part = image[tap // side : tap // side + height, tap % side : tap % side + width]
        out += part @ blocks[:, tap].transpose(1, 2, 0, 3).reshape(16 * layer.ins, 16 * layer.outs)
    return np.where(out > 0, out, layer.slope * out)


def dense_net_by_numpy(net, image):
    features = np.pad(image.astype(float), ((0, 0), (0, 0), (0, -image.shape[2] % 16)))
    for layer in net.layers[:-1]:
        features = np.concatenate([features, convolution_by_numpy(net, layer, features)], axis=2)
    return convolution_by_numpy(net, net.layers[-1], features)[..., : net.outs]


def test_chain_is_what_numpy_says():
    rng = np.random.default_rng(1)
    net = DenseChain((39, 64, 20, 6), rng)
    rows = rng.standard_normal((2101, 39)).astype(np.float32)
    np.testing.assert_allclose(net.forward(rows), chain_by_numpy(net, rows), atol=SINGLE)
    assert len(net.forward(rows[:0])) == 0


@pytest.mark.parametrize("reach", [0, 1])
def test_dense_net_is_what_numpy_says(reach):
    rng = np.random.default_rng(2)
    net = DenseNet(7, 20, 3, reach, rng)
    image = rng.standard_normal((5, 16, 7)).astype(np.float32)
    np.testing.assert_allclose(net.forward(image), dense_net_by_numpy(net, image), atol=SINGLE)


def directional(function, vector, direction, step):
    kept = vector.copy()
    vector[:] = kept + step * direction
    above = function()
    vector[:] = kept - step * direction
    below = function()
    vector[:] = kept
    return (above - below) / (2 * step)


def check_weights(net, loss, gradient, rng):
    for layer in net.layers:
        for part in (layer.weights, layer.bias):
            # Along the gradient itself, which no cancellation hides, and a little off it.
            direction = np.zeros_like(net.weights)
            size = np.abs(gradient[part]).max()
            direction[part] = gradient[part] / size + 0.3 * rng.standard_normal(gradient[part].size)
            direction /= np.linalg.norm(direction)
            expected = float(gradient.astype(float) @ direction)
            assert directional(loss, net.weights, direction, 3e-3) == pytest.approx(expected, rel=QUOTIENT)


def test_gradient_of_a_chain():
    rng = np.random.default_rng(3)
    net = DenseChain((11, 33, 16, 5), rng)
    rows = rng.standard_normal((1500, 11)).astype(np.float32)
    weigh = rng.standard_normal((1500, 5)).astype(np.float32)
    net.forward(rows, keep=True)
    net.backward(weigh)
    check_weights(net, lambda: float((chain_by_numpy(net, rows) * weigh).sum()), net.gradient.copy(), rng)


@pytest.mark.parametrize("reach", [0, 1])
def test_gradient_of_a_dense_net(reach):
    rng = np.random.default_rng(4)
    net = DenseNet(6, 18, 3, reach, rng)
    image = rng.standard_normal((6, 8, 6)).astype(np.float32)
    weigh = rng.standard_normal((6, 8, 18)).astype(np.float32)
    net.forward(image)
    by_image = net.backward(weigh)
    gradient = net.gradient.copy()

    def loss():
        return float((dense_net_by_numpy(net, image) * weigh).sum())

    check_weights(net, loss, gradient, rng)
    direction = by_image / np.linalg.norm(by_image)
    expected = float((by_image.astype(float) * direction).sum())
    assert directional(loss, image, direction, 3e-3) == pytest.approx(expected, rel=QUOTIENT)


def test_adam_is_its_formula():
    rng = np.random.default_rng(5)
    weights = rng.standard_normal(40).astype(np.float32)
    expected, m, v = weights.astype(float), 0.0, 0.0
    adam = Adam(40, (0.9, 0.95), 1e-6)
    for t in range(1, 6):
        g = rng.standard_normal(40).astype(np.float32)
        m, v = 0.9 * m + 0.1 * g, 0.95 * v + 0.05 * g.astype(float) ** 2
        expected -= 0.01 * (m / (1 - 0.9**t)) / (np.sqrt(v / (1 - 0.95**t)) + 1e-6)
        adam.step(weights, g, 0.01)
        assert not g.any()
    np.testing.assert_allclose(weights, expected, atol=1e-5)


def test_a_chain_learns_a_function():
    rng = np.random.default_rng(6)
    net = DenseChain((2, 32, 32, 1), rng)
    adam = Adam(net.weights.size)
    errors = []
    for _ in range(300):
        rows = rng.uniform(-1, 1, (512, 2)).astype(np.float32)
        wrong = net.forward(rows, keep=True) - np.sin(3 * rows[:, :1]) * rows[:, 1:]
        errors.append(float((wrong**2).mean()))
        net.backward(wrong / len(wrong))
        adam.step(net.weights, net.gradient, 5e-3)
    assert np.mean(errors[-20:]) < 0.05 * errors[0]


def test_weights_round_trip_byte_for_byte(tmp_path):
    arrays = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.ones(3, np.float32)}
    one, two = tmp_path / "one.npz", tmp_path / "two.npz"
    write_weights(one, arrays, {"kind": "test", "seed": 3})
    found, meta = read_weights(one, "test")
    assert meta["seed"] == 3 and meta["digest"] == digest_of(arrays)
    assert all(np.array_equal(found[name], arrays[name]) for name in arrays)
    write_weights(two, found, {"kind": "test", "seed": 3})
    assert one.read_bytes() == two.read_bytes()


def test_bad_weights_are_one_sentence(tmp_path):
    path = tmp_path / "w.npz"
    good = {"a": np.zeros(3, np.float32)}
    with pytest.raises(InputError, match="cannot be read"):
        read_weights(tmp_path / "none.npz", "test")
    path.write_bytes(b"not an archive")
    with pytest.raises(InputError, match="no file of weights"):
        read_weights(path, "test")
    np.savez(path, a=np.array([{"pickled": 1}], dtype=object), meta=np.array("{}"))
    with pytest.raises(InputError, match="no file of weights"):
        read_weights(path, "test")
    write_weights(path, good, {"kind": "other"})
    with pytest.raises(InputError, match="kind 'other', expected 'test'"):
        read_weights(path, "test")
    np.savez(path, **good, meta=np.array(json.dumps({"format": 99, "kind": "test"})))
    with pytest.raises(InputError, match="format 99, expected 1"):
        read_weights(path, "test")
    np.savez(path, **good, meta=np.array(json.dumps({"format": 1, "kind": "test", "digest": "0"})))
    with pytest.raises(InputError, match="damaged"):
        read_weights(path, "test")
    write_weights(path, {"a": np.array([1.0, np.nan], np.float32)}, {"kind": "test"})
    with pytest.raises(InputError, match="not finite"):
        read_weights(path, "test")
    with pytest.raises(InputError, match="shape"):
        shaped(good, "a", (4,), path)
    with pytest.raises(InputError, match="no array 'b'"):
        shaped(good, "b", (4,), path)


def test_vectors_of_doubles_are_numbers():
    """Operators, roots, logarithms and choices, against numpy; float32 is widened and rounded."""
    a, b = np.random.default_rng(50).uniform(0.01, 3.0, 64), np.random.default_rng(51).normal(0, 3, 64)
    single, out, logs, powers = b.astype(np.float32), np.zeros(64), np.zeros(64), np.zeros(64, np.float32)
    eightfold(a, single, out, logs, powers)
    z = np.clip(np.sqrt(a) * 2 + 1 / single.astype(float) - a, -1.0, 0.5)
    np.testing.assert_allclose(out, np.where(a > 0.5, z, np.copysign(np.abs(z), single)), rtol=1e-13)
    np.testing.assert_allclose(logs, np.log(a), atol=1e-7)
    np.testing.assert_allclose(powers, np.exp(single.astype(float)), rtol=3e-7)
