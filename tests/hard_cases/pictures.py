"""Draws each case: the apparent lobe of its first texel, the closed-form start and the fitted lobe, side by side.

PYTHONPATH=tests python -m hard_cases.pictures -o FOLDER [NAME ...]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib
import numpy as np
from lobe_oracle import apparent_lobe, bilinear, lobe, normal_of_slopes, unit

from brdffit.fitting.sampling import Lobes
from hard_cases.catalogue import CASES, Case
from hard_cases.closed_form import closed_form_start

matplotlib.use("Agg")
from matplotlib import pyplot

#: Pixels of a picture, samples of the footprint along an axis, decades of light that are shown.
SIDE, SAMPLES, DECADES = 96, 24, 4


def footprint(case: Case, svbrdf, size):
    """(weights, normals, log tensors, colours) of texel (0, 0) under a box as wide as the texel."""
    at = (np.arange(SAMPLES) + 0.5) / SAMPLES
    y, x = np.meshgrid(at * svbrdf.size[0] / size[0], at * svbrdf.size[1] / size[1], indexing="ij")
    y, x = y.ravel(), x.ravel()
    arrays = [bilinear(each, y, x, svbrdf.wrap) for each in (svbrdf.normal, svbrdf.log_roughness, svbrdf.specular)]
    return np.full(len(y), 1 / len(y)), unit(arrays[0] + [0, 0, 1e-9]), arrays[1], arrays[2]


def draw(case: Case, model: str, path: Path) -> None:
    """One picture: half vectors as slopes around the fitted lobe, logarithm of the lobe's value."""
    base = case.make(model)
    sample = case.sample(model, base)
    lobes, output = sample.fit()
    weights = footprint(case, base, sample.size)
    slopes = weights[1][:, :2] / np.maximum(weights[1][:, 2:], 0.05)
    spread = np.abs(slopes - slopes.mean(axis=0)).max()
    reach = min(1.3 * spread + 4.0 * float(np.exp(0.5 * lobes.theta[0, 2:4].max())), 6.0)
    grid = np.linspace(-reach, reach, SIDE)
    x, y = np.meshgrid(grid + slopes[:, 0].mean(), -grid + slopes[:, 1].mean())
    h = normal_of_slopes(-x.ravel(), -y.ravel())
    pictures = {"target": apparent_lobe(model, h, weights).sum(axis=1)}
    for name, found in (("start", closed_form_start(sample)), ("fit", Lobes(*lobes))):
        normal = normal_of_slopes(*found.theta[0, :2])
        value = lobe(model, h, normal, found.theta[0, 2:5], found.theta[0, 5])
        pictures[name] = value * found.scale[0].sum()
    top = max(float(pictures["target"].max()), 1e-12)
    figure, axes = pyplot.subplots(1, 3, figsize=(6, 2.3))
    for axis, (name, values) in zip(axes, pictures.items(), strict=True):
        shown = np.log10(np.maximum(values.reshape(SIDE, SIDE) / top, 10.0**-DECADES))
        axis.imshow(shown, vmin=-DECADES, vmax=0, cmap="magma", extent=(-reach, reach, -reach, reach))
        axis.set_title(name if name != "fit" else f"fit, error {output.residual[0]:.2g}", fontsize=8)
        axis.tick_params(labelsize=6)
    figure.suptitle(f"{case.name}, {model}", fontsize=9)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def main() -> None:
    """Draw the cases that are named, or all."""
    parser = argparse.ArgumentParser(description="Draw the target lobe of each hard case, its start and its fit.")
    parser.add_argument("-o", "--output", type=Path, default=Path("hard-cases"))
    parser.add_argument("--model", default="ggx")
    parser.add_argument("names", nargs="*")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    for case in CASES:
        if arguments.model in case.models and (not arguments.names or case.name in arguments.names):
            draw(case, arguments.model, arguments.output / f"{case.name.replace(' ', '-')}.png")


if __name__ == "__main__":
    main()
