"""What the tests of probes share: small environments, exact levels, the first pass written plainly, files, commands."""

import shlex

import numpy as np
from click.testing import CliRunner

from brdffit.cli import main
from brdffit.files.image_io import write_mip_exr
from brdffit.probes.cubemap import directions, pad
from brdffit.probes.direct import filtered_exactly, packed_source
from brdffit.probes.downsampling import jacobian, read_weights


def lamps(n, seed=0, bright=2000.0):
    """(6, n, n, 3): a soft sky, a darker floor, and a few bright texels."""
    rng = np.random.default_rng(seed)
    up = directions(n)[..., 1:2]
    sky = 0.3 + 0.4 * np.maximum(up, 0.0) * np.array([0.7, 0.9, 1.2]) + 0.1 * rng.random((6, n, n, 3))
    for _ in range(5):
        f, j, i = rng.integers(6), rng.integers(n), rng.integers(n)
        sky[f, j, i] += bright * rng.random(3)
    return sky.astype(np.float32)


def exact_level(cube, n, alpha):
    return filtered_exactly(packed_source(cube), directions(n).reshape(-1, 3), alpha).reshape(6, n, n, 3)


def relative_l1(picture, exact):
    return float(np.abs(picture - exact).sum() / exact.sum())


def downsampled(cube, kind="quadratic"):
    """The next coarser level of a cube map: by four reads, or "exact", by 16 texels each with its own Jacobian."""
    n, spline = cube.shape[1] // 2, np.array([1.0, 3.0, 3.0, 1.0]) / 8.0
    fine = [[np.s_[a : a + 2 * n : 2, b : b + 2 * n : 2] for b in range(4)] for a in range(4)]
    if kind == "exact":
        centre = (2.0 * np.arange(2 * n) + 1.0) / (2 * n) - 1.0
        # Beyond an edge J is mirrored, as the weights of the reads are.
        density = np.pad(jacobian(centre[None, :], centre[:, None]), 1, mode="symmetric")
        plain = np.outer(spline, spline)[:, :, None, None]
        own = plain * np.array([[density[at] for at in row] for row in fine])
        weights = 0.5 * (own / own.sum(axis=(0, 1)) + plain)
    else:
        near, far = [0.25, 0.75, 0.0, 0.0], [0.0, 0.0, 0.75, 0.25]
        reads = [np.outer(*each) for each in ((near, near), (near, far), (far, near), (far, far))]
        weights = np.einsum("rab,rji->abji", reads, read_weights(n)[:, 1:-1, 1:-1])
    padded = pad(cube)
    return sum(weights[a, b, None, ..., None] * padded[:, *fine[a][b]] for a in range(4) for b in range(4))


def latlong(height=64):
    """A picture whose colour is its direction: red to +X, green up, blue to +Z."""
    polar = (np.arange(height) + 0.5) / height * np.pi
    azimuth = ((np.arange(2 * height) + 0.5) / height - 1.0) * np.pi
    x, z = np.sin(polar)[:, None] * np.sin(azimuth), -np.sin(polar)[:, None] * np.cos(azimuth)
    y = np.broadcast_to(np.cos(polar)[:, None], x.shape)
    return (1.0 + np.stack([x, y, z], axis=-1)).astype(np.float32)


def write_exr(path, pixels):
    levels = [np.ascontiguousarray(pixels, np.float32)]
    while levels[-1].shape[:2] != (1, 1):
        h, w = levels[-1].shape[:2]
        levels.append(levels[-1][: max(h // 2, 1), : max(w // 2, 1)])
    write_mip_exr(path, levels, ("R", "G", "B"))


def probe(arguments):
    """What `brdffit probe ARGUMENTS` returns."""
    return CliRunner().invoke(main, ["probe", *shlex.split(arguments)])
