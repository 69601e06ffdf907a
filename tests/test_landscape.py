"""The error landscape of one texel: its path is the fit's own, and the picture's floor is where the path ends."""

import numpy as np
import pytest
from click.testing import CliRunner

from brdffit.cli import main
from brdffit.errors import InputError, OutputError
from brdffit.landscape import Landscape, landscape
from brdffit.report.plots import save_landscape
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.svbrdf import Svbrdf


@pytest.fixture(scope="module")
def bumpy():
    size = (16, 16)
    slope = 0.25 * np.random.default_rng(7).standard_normal((*size, 2))
    normal = np.concatenate([slope, np.ones((*size, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    full = np.ones((*size, 3), np.float32)
    log_roughness = log_tensor_from_perceptual(np.full(size, 0.3, np.float32))
    return Svbrdf(normal.astype(np.float32), log_roughness, 0.6 * full, 0.0 * full)


@pytest.fixture(scope="module")
def found(bumpy):
    return landscape(bumpy, 1, (3, 4), side=24)


def test_the_search_only_goes_down(found):
    assert len(found.path) > 2
    assert (np.diff(found.values) <= 1e-6).all()
    assert found.values[-1] < found.values[0]
    assert found.path[-1, 1] == 0.0


def test_the_path_ends_on_the_floor(found):
    """Nothing in the picture is lower than the end of the path, but for what the grid and rounding can tell."""
    assert found.error.min() >= found.values[-1] - 1e-3
    assert found.error.min() <= found.values[-1] + 0.05
    i, j = np.unravel_index(np.argmin(found.error), found.error.shape)
    step = np.log(found.roughness[1] / found.roughness[0])
    assert abs(np.log(found.roughness[j] / found.path[-1, 0])) < 2.5 * step
    assert abs(found.angle[i]) < 2.5 * (found.angle[1] - found.angle[0])


def test_the_picture_holds_the_path(found):
    assert (np.diff(found.roughness) > 0).all() and (np.diff(found.angle) > 0).all()
    for values, along in ((found.roughness, found.path[:, 0]), (found.angle, found.path[:, 1])):
        assert values[0] <= along.min() and along.max() <= values[-1]
    assert ((found.error >= 0.0) & np.isfinite(found.error)).all()


def test_a_flat_set_needs_no_step(bumpy):
    flat = bumpy.replace(normal=np.broadcast_to(np.float32([0, 0, 1]), (16, 16, 3)).copy())
    there = landscape(flat, 2, (0, 0), side=5)
    assert there.values[-1] < 1e-4
    assert there.path[-1, 0] == pytest.approx(0.3**2, rel=0.01)


@pytest.mark.parametrize(
    ("level", "texel", "sentence"),
    [
        (9, (0, 0), "has no level 9, expected 0 to 4"),
        (1, (8, 0), "no texel 8,0, expected column 0 to 7 and row 0 to 7"),
    ],
)
def test_what_there_is_not(bumpy, level, texel, sentence):
    with pytest.raises(InputError, match=sentence):
        landscape(bumpy, level, texel)


def made():
    roughness, angle = np.geomspace(0.01, 0.5, 6), np.linspace(-2, 2, 7)
    path = np.array([[0.3, 1.0], [0.1, 0.0]])
    return Landscape(1, 0, 0, roughness, angle, np.ones((7, 6)) * roughness, path, np.array([0.5, 0.1]))


@pytest.mark.parametrize(("name", "head"), [("a.svg", b"<?xml"), ("deep/b.png", b"\x89PNG")])
def test_it_is_drawn_by_suffix(tmp_path, name, head):
    path = tmp_path / name
    save_landscape(made(), "title", path)
    assert path.read_bytes().startswith(head)
    assert [each.name for each in path.parent.iterdir()] == [path.name]


def test_other_suffixes_are_refused(tmp_path):
    with pytest.raises(OutputError, match=r"expected a picture that ends in \.svg or \.png"):
        save_landscape(made(), "title", tmp_path / "a.bmp")


@pytest.mark.parametrize("text", ["3", "a,b", "1,-2", ""])
def test_a_texel_is_two_numbers(text):
    result = CliRunner().invoke(main, ["landscape", "set", "--texel", text])
    assert result.exit_code == 2 and "X,Y" in result.output
