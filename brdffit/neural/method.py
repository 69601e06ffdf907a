"""The method ``neural``: a material learned from the traced surface; comparisons include it only when it is named."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

from brdffit.errors import InputError
from brdffit.methods import Baked, Material, Progress
from brdffit.microgeometry.tracer import Effects, Microgeometry
from brdffit.nets.training import train
from brdffit.neural.material import read_material
from brdffit.neural.source import learned_size
from brdffit.neural.training import NeuralTask
from brdffit.options import BakeOptions, option


@dataclass(frozen=True)
class NeuralOptions(BakeOptions):
    """Options of the method ``neural``."""

    group: ClassVar[str] = "neural"

    file: str | None = option(None, "a material that `brdffit neural train` wrote; none: it is learned now")
    minutes: float = option(3.0, "how long it is learned, where there is no file", above=0.0)
    steps: int | None = option(None, "instead of minutes: same seed, same material", least=1)
    size: int = option(128, "texels of the longer side that is learned, a power of two", least=4, most=4096)
    bounces: int = option(0, "how often light goes from surface to surface", least=0, most=16)
    seed: int = option(0, "of the training", least=0)


class Neural:
    """Kuznetsov et al. 2021: textures of features and a small network, with a learned parallax offset."""

    name = "neural"
    summary = "neural material with parallax, learned from the traced height map (Kuznetsov et al. 2021)"
    options = NeuralOptions

    def prepare(self, material: Material, options: NeuralOptions) -> None:
        """Check that there is a height map to learn from, or a file.

        Raises:
            InputError: when there is neither.
        """
        if material.height is None and options.file is None:
            raise InputError("The method 'neural' learns a traced height map and this material has none.")

    def bake(self, material: Material, options: NeuralOptions, progress: Progress | None = None) -> Baked:
        """Learn the material, or read it from the file; see ``Method``. The result has no lobes."""
        self.prepare(material, options)
        if options.file is not None:
            learned = read_material(Path(options.file), material.size)
            return Baked(self.name, options, learned, notes=[f"The neural material is that of '{options.file}'."])
        source = Microgeometry.of(material.svbrdf, Effects(bounces=options.bounces), threads=options.threads)
        size, notes = learned_size(source.size, options.size)
        task = NeuralTask(source, size, options.seed, threads=options.threads)
        minutes = options.minutes if options.steps is None else None

        def told(seconds: float, step: int, done: float, loss: float, figure: float | None) -> None:
            if progress is not None:
                progress(0, round(1000 * min(done, 1.0)), 1000)

        with TemporaryDirectory() as folder:
            file = Path(folder, "material.npz")
            train(task, file, minutes=minutes, steps=options.steps, seed=options.seed, told=told)
            learned = read_material(file, material.size)
        steps = f"The neural material of {size[1]}x{size[0]} texels was learned in {learned.meta['steps']} steps."
        return Baked(self.name, options, learned, notes=[*source.notes, *notes, steps])
