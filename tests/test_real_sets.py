"""Real texture sets as people have them: each is read, inspected and baked, or a sentence says what to give it.

They lie beside the checkout, not in it; without them everything here is skipped.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from brdffit import bake
from brdffit.errors import InputError
from brdffit.files.image_io import read_mip_exr
from brdffit.fitting.options import QUALITIES
from brdffit.methods import lobe_method_names
from brdffit.pipeline import bake_to_folder
from brdffit.roughness import DEFAULT_MIN_ROUGHNESS, tensor_from_log
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.inspection import inspect_set
from brdffit.textures.reading import read_texture_set

MATERIALS = Path(__file__).parent.parent.parent / "shared" / "materials"
SETS = sorted(path.name for path in MATERIALS.iterdir() if path.is_dir()) if MATERIALS.is_dir() else []
CHROME = "chrome-049a-flat-control"
#: Side of the crop that the quick tests bake.
CROP = 64
#: Storage of the tensor as a logarithm in single precision: alpha^2 = 4e-6 has a logarithm of -12.4.
STORED = 1e-5
#: Difference of the axes, by quality: a search stops where little is left to gain, and the roughness map has an edge.
ISOTROPIC = {"draft": 5e-3, "standard": 3e-3, "fine": 1e-3}
#: A lobe's own width, found again by such a search.
FITTED = 0.01

pytestmark = pytest.mark.skipif(not SETS, reason="no real texture sets in ../shared/materials")
each_set = pytest.mark.parametrize("name", SETS or ["none"])


def cropped(name, side=CROP, **reading):
    base = to_svbrdf(read_texture_set(MATERIALS / name, **reading), min_roughness=DEFAULT_MIN_ROUGHNESS)
    return base.replace(**{key: np.ascontiguousarray(array[:side, :side]) for key, array in base.arrays().items()})


def assert_sound(baked):
    """Finite everywhere, unit normals, positive tensors, as stored in the files."""
    pyramid = baked.lobes
    for level in pyramid.levels:
        assert level.svbrdf.is_finite()
        tensor = tensor_from_log(level.svbrdf.log_roughness).astype(np.float64)
        assert np.isfinite(tensor).all()
        assert (tensor[..., 0] * tensor[..., 1] > tensor[..., 2] ** 2).all()
        np.testing.assert_allclose(np.linalg.norm(level.svbrdf.normal, axis=-1), 1.0, atol=1e-4)
    assert pyramid[len(pyramid) - 1].svbrdf.size == (1, 1)


@each_set
def test_a_set_is_read_and_every_method_bakes_a_crop_of_it(name):
    texture_set = read_texture_set(MATERIALS / name)
    found = inspect_set(texture_set)
    assert found.maps and found.statistics["roughness_mean"] > 0.0
    base = cropped(name, 32)
    for method in lobe_method_names():
        if method == "height" and base.height is None:
            with pytest.raises(InputError, match="--role height="):
                bake(base, method=method)
            continue
        assert_sound(bake(base, method=method, **({"quality": "draft"} if method == "bfgs" else {})))


@pytest.mark.parametrize(
    "method, quality", [*(("bfgs", quality) for quality in QUALITIES), ("lean", ""), ("vmf", ""), ("naive", "")]
)
def test_flat_chrome_stays_isotropic_and_as_glossy_as_authored(method, quality):
    """Its normal map dithers by one code; taken at its word that would widen the lobe five times, along one axis."""
    base = cropped(CHROME, denoise_normals=True)
    assert not base.log_roughness[..., 2].any()
    np.testing.assert_array_equal(base.log_roughness[..., 0], base.log_roughness[..., 1])
    authored = np.exp(base.log_roughness[..., 0].astype(np.float64))
    assert authored.min() == pytest.approx(DEFAULT_MIN_ROUGHNESS**4, rel=STORED)
    for level in bake(base, method=method, **({"quality": quality} if quality else {})).lobes.levels:
        xx, yy, xy = np.moveaxis(tensor_from_log(level.svbrdf.log_roughness).astype(np.float64), -1, 0)
        isotropic = ISOTROPIC[quality] if method == "bfgs" else STORED
        np.testing.assert_allclose(yy, xx, rtol=isotropic)
        assert (np.abs(xy) <= isotropic * xx).all()
        assert xx.min() >= authored.min() * (1.0 - STORED)
        assert xx.max() <= authored.max() * (1.0 + FITTED)


@pytest.mark.slow
@each_set
def test_a_whole_set_is_written_without_a_number_that_is_none(name, tmp_path):
    """From files to files: LEAN at the size of the set, the fit at standard quality on a crop."""
    for method in ("lean", "bfgs"):
        source = MATERIALS / name if method == "lean" else cropped(name, 128)
        report = bake_to_folder(source, tmp_path / method, method=method, name=name)
        files = sorted(report.folder.glob("*.exr"))
        assert {"normal.exr", "roughness.exr", "specular.exr", "diffuse.exr"} <= {file.name for file in files}
        for file in files:
            levels = read_mip_exr(file)
            assert levels[-1].shape[:2] == (1, 1)
            assert all(np.isfinite(level).all() for level in levels), file.name
        assert (report.folder / "preview.png").stat().st_size > 0
        assert (report.folder / "manifest.json").stat().st_size > 0
