"""The whole road: a set of files in, a pyramid of files out, for every method and model; interrupted in the middle."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from brdffit.errors import OutputError, UnknownNameError
from brdffit.files.image_io import write_png
from brdffit.methods import get_method, lobe_method_names
from brdffit.models import model_names
from brdffit.pipeline import bake, bake_to_folder
from brdffit.roughness import eigenvalues_of_log, tensor_from_log
from brdffit.svbrdf import level_sizes
from brdffit.textures.procedural import make_set

SIZE = 32
IMAGES = ("normal", "roughness", "specular", "diffuse")


@pytest.fixture(scope="session")
def glossy_tiles(tmp_path_factory):
    return make_set("glossy-tiles", tmp_path_factory.mktemp("sets") / "glossy-tiles", SIZE)


def digests(folder):
    """SHA-256 of every picture below a folder."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.suffix in (".exr", ".png")
    }


def stable(value):
    """A manifest without what a clock or a thread count says."""
    if isinstance(value, dict):
        return {
            key: stable(each) for key, each in value.items() if "second" not in key and key not in ("threads", "timing")
        }
    return [stable(each) for each in value] if isinstance(value, list) else value


@pytest.mark.parametrize("method", lobe_method_names())
def test_every_method_writes_its_pyramid(method, glossy_tiles, tmp_path):
    report = bake_to_folder(glossy_tiles, tmp_path, method=method, preview=False)
    assert report.folder == tmp_path / "glossy-tiles"
    manifest = json.loads((report.folder / "manifest.json").read_text())
    assert len(manifest["levels"]) == len(report.baked.sizes) == len(level_sizes((SIZE, SIZE)))
    for level, measured in zip(report.baked.lobes.levels, report.measured, strict=True):
        assert level.svbrdf.is_finite() and np.isfinite(measured["snr_db"])
    for name in IMAGES:
        assert (report.folder / f"{name}.exr").is_file()


@pytest.mark.parametrize("model", model_names())
def test_every_model_gives_the_same_bytes_for_any_threads(model, glossy_tiles, tmp_path):
    runs = [
        bake_to_folder(glossy_tiles, tmp_path / f"{n}-{threads}", model=model, threads=threads, preview=False)
        for n, threads in enumerate((1, 2, 2))
    ]
    first, *others = (digests(run.folder) for run in runs)
    assert first and all(first == other for other in others)
    manifests = [stable(json.loads((run.folder / "manifest.json").read_text())) for run in runs]
    assert manifests[0] == manifests[1] == manifests[2]


def test_exr_levels_are_the_pyramid(glossy_tiles, tmp_path):
    report = bake_to_folder(glossy_tiles, tmp_path, preview=False)
    for mip_level, level in enumerate(report.baked.lobes.levels):
        found = level.svbrdf
        expected = {
            "normal": found.normal,
            "roughness": tensor_from_log(found.log_roughness),
            "specular": found.specular,
            "diffuse": found.diffuse,
        }
        for name, array in expected.items():
            image = oiio.ImageInput.open(str(report.folder / f"{name}.exr"))
            pixels = image.read_image(0, mip_level, 0, 3, oiio.FLOAT)
            names = image.spec().channelnames
            image.close()
            # OpenEXR sorts channels by name: XX, XY, YY.
            order = ["XX", "YY", "XY"] if name == "roughness" else names
            pixels = np.asarray(pixels).reshape(array.shape)[..., [names.index(each) for each in order]]
            np.testing.assert_allclose(pixels, array, rtol=1e-6, atol=1e-7)


def test_unknown_names(glossy_tiles):
    for options in ({"method": "bfsg"}, {"model": "ggy"}, {"quality": "fien"}, {"preset": "gltff"}, {"levles": 3},
                    {"pixel_filter": "bax"}, {"density": "cosin"}):  # fmt: skip
        with pytest.raises(UnknownNameError, match="did you mean"):
            bake(glossy_tiles, **options)


def test_svbrdf_in_pyramid_out(glossy_tiles):
    pyramid = bake(glossy_tiles, levels=2, quality="draft").lobes
    again = bake(pyramid[0].svbrdf, levels=1, method="naive")
    assert len(pyramid) == 2 and again.sizes == [(SIZE, SIZE)]
    assert get_method("naive").name == again.method


def test_flat_dithered_map_is_flat_and_glossy_where_that_is_asked_for(tmp_path):
    """8-bit codes 127 and 128 at random: slopes of a code are noise, not a surface."""
    folder = tmp_path / "flat"
    folder.mkdir()
    rng = np.random.default_rng(1)
    normal = np.dstack([rng.integers(127, 129, (SIZE, SIZE, 2)), np.full((SIZE, SIZE), 255)]).astype(np.uint8)
    write_png(folder / "Flat_NormalGL.png", normal)
    write_png(folder / "Flat_Roughness.png", np.full((SIZE, SIZE), 51, np.uint8))
    write_png(folder / "Flat_Color.png", np.full((SIZE, SIZE, 3), 200, np.uint8))
    write_png(folder / "Flat_Metallic.png", np.full((SIZE, SIZE), 255, np.uint8))
    for method in ("bfgs", "lean", "vmf"):
        for level in bake(folder, method=method, denoise_normals=True).lobes.levels:
            major, minor = eigenvalues_of_log(level.svbrdf.log_roughness)
            # Perceptual roughness within 1% of the authored 0.2, axes within 1% of each other.
            np.testing.assert_allclose(np.sqrt(np.sqrt(major)), 0.2, rtol=0.01)
            assert (major / minor < 1.01).all()


@pytest.mark.slow
def test_interrupt_leaves_the_old_output(tmp_path):
    source = make_set("hammered-metal", tmp_path / "hammered-metal", 512)
    output = tmp_path / "out"
    old = output / "hammered-metal"
    old.mkdir(parents=True)
    bake_to_folder(source, output, method="naive", preview=False)
    before = {path: path.read_bytes() for path in old.rglob("*") if path.is_file()}
    script = (
        # Background jobs of a shell ignore SIGINT, and children inherit that.
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from brdffit.pipeline import bake_to_folder\n"
        "class Tell:\n"
        "    def phase(self, name): print(name, flush=True)\n"
        "    def __call__(self, *level): pass\n"
        f"bake_to_folder({str(source)!r}, {str(output)!r}, quality='fine', preview=False, progress=Tell())\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        cwd=Path(__file__).parents[1], env={**os.environ},
    )  # fmt: skip
    assert process.stdout is not None
    for line in process.stdout:
        if line.strip() == "fitting":
            break
    time.sleep(0.5)
    assert process.poll() is None, "the bake ended before it could be interrupted"
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) != 0
    after = {path: path.read_bytes() for path in old.rglob("*") if path.is_file()}
    assert after == before
    assert sorted(path.name for path in output.iterdir()) == ["hammered-metal"]


_HASHED = """
import hashlib, sys
import brdffit
pyramid = brdffit.bake(sys.argv[1], levels=2).lobes
arrays = [array for level in pyramid.levels for array in level.svbrdf.arrays().values()]
print(hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest())
"""


@pytest.mark.slow
def test_a_run_that_compiles_and_one_that_loads_give_the_same_bytes(tmp_path):
    """The linker once took whichever copy of a callee was loaded first: some texels in ten thousand differed."""
    make_set("grooved-record", tmp_path / "record", size=512)
    environment = os.environ | {"BRDFFIT_CACHE": str(tmp_path / "cache")}
    found = [
        subprocess.run(
            [sys.executable, "-c", _HASHED, str(tmp_path / "record")], env=environment, check=True, text=True,
            capture_output=True,
        ).stdout
        for _ in range(2)
    ]  # fmt: skip
    assert found[0] == found[1]


def test_lobes_that_are_no_numbers_are_refused(tmp_path, monkeypatch):
    """Whoever made them: nothing is written, and what was there stays."""
    source = make_set("hammered-metal", tmp_path / "sets", size=32)
    naive = type(get_method("naive"))
    bake_lobes = naive.bake_lobes

    def broken(self, *arguments, **named):
        pyramid = bake_lobes(self, *arguments, **named)
        if len(pyramid.levels) > 2:  # not those few texels that are baked to compile
            pyramid.levels[1].svbrdf.normal[2, 3] = np.nan
        return pyramid

    monkeypatch.setattr(naive, "bake_lobes", broken)
    with pytest.raises(OutputError, match=r"'naive' made 1 texels of level 1 that are not finite"):
        bake_to_folder(source, tmp_path / "out", method="naive", preview=False)
    assert not (tmp_path / "out").exists() or not list((tmp_path / "out").iterdir())
