"""Effects that are off: what then still must hold, what a sample says of it, and that it is really not there."""

import dataclasses
import math

import numpy as np
import pytest
from test_fitting import bake, check, surface

from brdffit import pipeline
from brdffit.assessment import assess
from brdffit.errors import InputError, UnknownNameError
from brdffit.export.manifest import build_manifest
from brdffit.files.image_io import write_png
from brdffit.fitting.batch import make_output, model_kernels
from brdffit.fitting.effects import complete, kernels_of, reached, seen_by
from brdffit.fitting.method import NonlinearFit
from brdffit.fitting.options import FitOptions
from brdffit.fitting.sampling import LevelSample, Lobes
from brdffit.fitting.status import KEPT, NO_SPECULAR, NOT_REACHED, STATUS_NAMES
from brdffit.footprint import filter_channels, filter_texels, get_pixel_filter
from brdffit.halfangle.apparent_lobe import base_of
from brdffit.halfangle.measure import lobe_parameters, random_texels, snr
from brdffit.halfangle.objective import MOMENTS
from brdffit.halfangle.quadrature import NODE_ROWS
from brdffit.methods import Baked, Material, get_method
from brdffit.models import get_model
from brdffit.roughness import log_tensor_from_perceptual
from brdffit.textures.conversion import to_svbrdf
from brdffit.textures.reading import read_texture_set

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
#: Sums in single precision end a search a little elsewhere; both ends are as good (parameters, and relative error).
SAME, AS_GOOD = 5e-3, 1e-4
FIELDS = ("normal", "log_roughness", "specular", "diffuse")


def coloured(seed=0, size=(16, 16), **fields):
    """Bumpy, with colours that follow the normal, a diffuse colour, and roughness that varies."""
    rng = np.random.default_rng(seed)
    base = surface(size=size, spread=0.15, seed=seed, **fields)
    side = 0.5 + 1.5 * base.normal[..., :1]
    base.specular[:] = np.clip(side * [0.9, 0.5, 0.2] + (1 - side) * [0.1, 0.4, 0.9], 0.02, 1.0)
    base.log_roughness[..., :2] += rng.normal(0, 0.3, (*size, 1)).astype(np.float32)
    base.diffuse[:] = rng.uniform(0.0, 0.8, (*size, 3))
    return base


def same_bytes(one, other, fields=FIELDS):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in fields)


# Reach


@pytest.mark.parametrize("reach", [(0, 1), (1, 2), (3, 9)])
@pytest.mark.parametrize("pixel_filter", ["box", "mitchell"])
def test_what_is_reached_is_as_in_a_full_bake_and_the_rest_as_the_naive_baseline(reach, pixel_filter):
    base = coloured(occlusion=np.random.default_rng(1).uniform(0, 1, (16, 16)).astype(np.float32))
    full = bake(base, pixel_filter=pixel_filter)
    part = check_reach(bake(base, pixel_filter=pixel_filter, reach=reach), reach)
    naive = get_method("naive").bake_lobes(base, FitOptions(pixel_filter=pixel_filter))
    for k, (level, whole, plain) in enumerate(zip(part.levels, full.levels, naive.levels, strict=True)):
        if reach[0] <= k <= reach[1]:
            assert same_bytes(level.svbrdf, whole.svbrdf, (*FIELDS, "occlusion"))
            assert np.array_equal(level.status, whole.status) and np.array_equal(level.residual, whole.residual)
        else:
            for name in (*FIELDS, "occlusion"):
                np.testing.assert_allclose(getattr(level.svbrdf, name), getattr(plain.svbrdf, name), atol=2e-6)


def check_reach(pyramid, reach):
    for k, level in enumerate(pyramid.levels):
        out = not reach[0] <= k <= reach[1]
        assert (level.status == NOT_REACHED).all() == out and (level.evaluations is None) == out
    return pyramid


@pytest.mark.parametrize("model", ["ggx", "generalised-beckmann"])
def test_an_anisotropic_base_is_averaged_as_the_naive_baseline_does(model):
    base = coloured()
    base.log_roughness[..., 0] += 1.0
    base.log_roughness[..., 2] -= 0.4
    pyramid, naive = (
        bake(base, model=model, reach=(4, 4)),
        get_method("naive").bake_lobes(base, FitOptions(model=model)),
    )
    for level, plain in zip(pyramid.levels[:4], naive.levels, strict=False):
        assert level.svbrdf.model == model
        for name in ("log_roughness", "normal", *(["shape"] if model != "ggx" else [])):
            np.testing.assert_allclose(getattr(level.svbrdf, name), getattr(plain.svbrdf, name), atol=1e-5)


def test_level_0_stays_as_authored_out_of_reach_too():
    base = coloured()
    pyramid = bake(base, keep_level_0=True, reach=(1, 1))
    assert (pyramid[0].status == KEPT).all() and same_bytes(pyramid[0].svbrdf, base)
    assert (pyramid[2].status == NOT_REACHED).all()


def test_beyond_the_coarsest_level_the_coarsest_is_meant():
    assert reached((12, 14), 5) == range(4, 5)
    assert reached(None, 5) == range(5)


@pytest.mark.parametrize("reach", [(2, 1), (-1, 3)])
def test_a_reach_is_a_range_of_levels(reach):
    with pytest.raises(InputError, match=r"^The reach is .* to .*, expected the first and the last level from 0 up\.$"):
        bake(surface(), reach=reach)


def test_only_what_is_reached_is_refined():
    pyramid = bake(coloured(), reach=(1, 2), refine=True)
    (note,) = (note for note in pyramid.notes if note.startswith("Refined"))
    assert "level 1" in note and "level 2" in note and "level 0" not in note and "level 3" not in note
    check_reach(pyramid, (1, 2))


def test_the_manifest_holds_every_option_and_counts_what_is_not_reached():
    pyramid = bake(coloured(), reach=(0, 1), coupling=False)
    assert pyramid.notes == ["Pixels read levels 0 to 1 alone; the others are averaged, not fitted."]
    baked = Baked.of_lobes(pyramid)
    measured = assess(Material(coloured()), baked)
    assert [bool(figures) for figures in measured] == [True, True, False, False, False]
    manifest = build_manifest(baked, name="set", status_names=STATUS_NAMES, measured=measured)
    assert manifest["options"].keys() == {each.name for each in dataclasses.fields(FitOptions)} - {"threads"}
    assert manifest["options"]["reach"] == (0, 1) and manifest["levels"][2]["statuses"] == {"not reached": 16}


# Diffuse colour and normals


def test_diffuse_colour_never_touches_the_lobes_and_is_the_average():
    base = coloured()
    for on, off in zip(bake(base).levels, bake(base, coupling=False).levels, strict=True):
        assert same_bytes(on.svbrdf, off.svbrdf, ("normal", "log_roughness", "specular"))
        expected = filter_channels(base.diffuse, off.svbrdf.size, get_pixel_filter("box"), "tile")
        np.testing.assert_allclose(off.svbrdf.diffuse, expected, atol=1e-6)
        assert np.abs(on.svbrdf.diffuse - expected).max() > 1e-4


def test_on_flat_normals_there_is_no_coupling():
    rng = np.random.default_rng(2)
    base = surface(slopes=(0.0, 0.0), diffuse=rng.uniform(0, 0.8, (8, 8, 3)).astype(np.float32))
    for on, off in zip(bake(base).levels, bake(base, coupling=False).levels, strict=True):
        np.testing.assert_allclose(on.svbrdf.diffuse, off.svbrdf.diffuse, atol=1e-6)


# Colour


def test_one_tint_is_fitted_alike_by_the_luminance_and_by_the_channels():
    base = coloured()
    base.specular[:] = base.specular[..., :1] * np.float32([0.9, 0.6, 0.3])
    alike(base, {}, {"colour": "shared"})


def alike(base, one, other):
    """Two kinds of fit end at the same lobes, or at lobes as good."""
    for a, b in zip(bake(base, **one).levels, bake(base, **other).levels, strict=True):
        np.testing.assert_allclose(a.svbrdf.normal, b.svbrdf.normal, atol=SAME)
        np.testing.assert_allclose(a.svbrdf.log_roughness, b.svbrdf.log_roughness, atol=SAME)
        np.testing.assert_allclose(a.svbrdf.specular, b.svbrdf.specular, rtol=SAME)
        np.testing.assert_allclose(a.residual, b.residual, atol=AS_GOOD)


def test_a_shared_fit_is_that_of_the_luminance_with_the_hue_of_the_average():
    base = coloured()
    grey = np.repeat((base.specular @ LUMINANCE)[..., None], 3, axis=2).astype(np.float32)
    shared, of_grey = bake(base, colour="shared"), bake(base.replace(specular=grey))
    for one, other in zip(shared.levels, of_grey.levels, strict=True):
        np.testing.assert_allclose(one.svbrdf.normal, other.svbrdf.normal, atol=SAME)
        luminance = one.svbrdf.specular @ LUMINANCE
        np.testing.assert_allclose(luminance, other.svbrdf.specular[..., 0], rtol=SAME)
        average = filter_channels(base.specular, one.svbrdf.size, get_pixel_filter("box"), "tile")
        hue = one.svbrdf.specular / luminance[..., None]
        np.testing.assert_allclose(hue, average / (average @ LUMINANCE)[..., None], rtol=1e-5)


def test_a_grey_set_is_none_the_wiser():
    base = surface(colour=(0.5, 0.5, 0.5))
    for one, other in zip(bake(base).levels, bake(base, colour="shared").levels, strict=True):
        assert same_bytes(one.svbrdf, other.svbrdf) and np.array_equal(one.residual, other.residual)


@pytest.mark.parametrize("off", [{"colour": "shared"}, {"correlation": False}])
@pytest.mark.parametrize("pixel_filter", ["box", "mitchell"])
def test_black_has_no_hue(off, pixel_filter):
    base = coloured()
    base.specular[:8] = 0.0
    base.specular[8:12, :, 0] = 0.0
    for level in check(bake(base, pixel_filter=pixel_filter, **off)).levels:
        average = filter_channels(base.specular, level.svbrdf.size, get_pixel_filter(pixel_filter), "tile")
        black = (average <= 0).all(axis=2)
        assert (level.svbrdf.specular[black] == 0.0).all()
        assert (level.svbrdf.specular[average <= 0] <= 1e-6).all()
    black = base.replace(specular=np.zeros_like(base.specular))
    for level in bake(black, pixel_filter=pixel_filter, **off).levels:
        assert (level.status == NO_SPECULAR).all() and not level.svbrdf.specular.any()


def test_an_unknown_colour_is_named_with_the_nearest():
    with pytest.raises(UnknownNameError, match="shared"):
        bake(surface(), colour="share")


# Correlation


@pytest.mark.parametrize("specular", ["free", "held"])
def test_where_the_colour_is_constant_there_is_no_correlation(specular):
    base = coloured()
    base.specular[:] = np.float32([0.9, 0.6, 0.3])
    alike(base, {"specular": specular}, {"specular": specular, "correlation": False})


def test_without_correlation_no_colour_moves_a_lobe():
    """The lobes are those of a white base, as bright as this one in the mean."""
    base, white = coloured(), coloured()
    mean = np.mean(base.specular, dtype=np.float64)
    white.specular[:] = mean
    for one, other in zip(bake(base, correlation=False).levels, bake(white).levels, strict=True):
        assert same_bytes(one.svbrdf, other.svbrdf, ("normal", "log_roughness"))
        average = filter_channels(base.specular, one.svbrdf.size, get_pixel_filter("box"), "tile")
        np.testing.assert_allclose(one.svbrdf.specular, average * other.svbrdf.specular / mean, rtol=1e-5)


def test_each_effect_helps_where_it_is_there():
    """Judged against the truth, with everything, where red follows the normal and green hardly does."""
    base = coloured()
    base.specular[:] = np.float32([0.0, 0.15, 0.05])
    base.specular[..., 0] = 0.02 + 0.98 * (base.normal[..., 0] > 0)
    sample = LevelSample(base, 2, *random_texels((4, 4), 16, seed=0))
    ways = [FitOptions(), FitOptions(colour="shared"), FitOptions(correlation=False)]
    error = sample.measure([sample.fit(options)[0] for options in ways], nodes=1024, samples=(16, 32)).error
    everything, shared, uncorrelated = map(snr, error)
    assert everything > shared + 0.1 and shared > uncorrelated + 0.1, (everything, shared, uncorrelated)


# Horizon


def test_far_from_its_horizon_a_lobe_needs_none():
    base = surface(spread=0.02, alpha=0.1, size=(16, 16))
    alike(base, {}, {"horizon": False})


def test_without_a_horizon_lobes_go_on_behind_it():
    """And with it they do not: the kernels are different ones."""
    steep, behind = np.array([-3.0, 0.0, math.log(0.3), math.log(0.3), 0.0, 0.0]), np.zeros((NODE_ROWS, 4), np.float32)
    behind[0], behind[2] = -0.8, 0.6
    values = {}
    for horizon in (True, False):
        kernels, out = model_kernels("ggx", "ggx", horizon=horizon), np.zeros(4, np.float32)
        kernels.values(steep, behind, kernels.log_normalisation, out, np.zeros(16))
        values[horizon] = out.copy()
    assert (values[True] == 0.0).all() and (values[False] > 0.0).all()


# Kernels that leave out what is held


@pytest.mark.parametrize("model", ["ggx", "beckmann"])
def test_moments_that_are_left_out_are_those_that_a_held_search_does_not_read(model):
    rng = np.random.default_rng(3)
    nodes = np.zeros((NODE_ROWS, 96), np.float32)
    nodes[:3] = (lambda v: v / np.linalg.norm(v, axis=0))(rng.normal(0, 0.4, (3, 96)) + [[0], [0], [1]])
    nodes[6:8] = rng.uniform(0, 1, (2, 96))
    frame = np.array([3.0, 0, 0, 0, 3.0, 0, 0, 0, 1.0])
    found = {}
    for turns in (True, False):
        for stretches in (True, False):
            out = np.zeros(MOMENTS)
            model_kernels(model, model, turns=turns, stretches=stretches).moments(nodes, frame, np.float32(0), out)
            found[turns, stretches] = out
    full = found[True, True]
    for (turns, stretches), out in found.items():
        expected = full.copy()
        for start in (0, 7):
            if not turns:
                expected[start + 4 : start + 6] = 0.0
            if not stretches:
                expected[start + 1] += expected[start + 3]
                expected[start + 2 : start + 4] = 0.0
        np.testing.assert_allclose(out, expected, rtol=1e-4, atol=1e-5 * np.abs(full).max())


# A sample is fitted as the whole bake


@pytest.mark.parametrize(
    "off",
    [
        {"colour": "shared"},
        {"correlation": False, "coupling": False, "pixel_filter": "gaussian"},
        {"horizon": False},
        {"lobe": "isotropic", "normal": "mean", "colour": "shared"},
    ],
    ids=lambda off: "-".join(off),
)
def test_a_sample_is_fitted_as_in_a_whole_bake(off):
    base, options = coloured(wrap="clamp"), FitOptions(levels=3, **off)
    for k, level in enumerate(NonlinearFit().bake_lobes(base, options).levels):
        columns, rows = random_texels(level.svbrdf.size, 12, seed=k)
        (theta, scale), output = LevelSample(base, k, columns, rows, options).fit()
        np.testing.assert_allclose(scale, level.svbrdf.specular[rows, columns], rtol=1e-6)
        np.testing.assert_allclose(output.diffuse, level.svbrdf.diffuse[rows, columns], rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(theta, lobe_parameters(level.svbrdf, columns, rows), atol=1e-6)
        assert np.array_equal(output.residual, level.residual[rows, columns])


def test_options_may_be_given_anew_for_each_fit():
    sample, asked = LevelSample(coloured(), 1, *random_texels((8, 8), 20, seed=1)), FitOptions(colour="shared")
    anew, own = sample.fit(asked)[1], LevelSample(coloured(), 1, sample.columns, sample.rows, asked).fit()[1]
    assert all(np.array_equal(a, b) for a, b in zip(anew, own, strict=True))
    again = (
        LevelSample(coloured(), 0, *random_texels((16, 16), 9, seed=2)).at(1, sample.columns, sample.rows).fit(asked)[1]
    )
    assert all(np.array_equal(a, b) for a, b in zip(anew, again, strict=True))
    few = sample.subset(5).fit(asked)[1]
    assert np.array_equal(few.specular, anew.specular[:5])


@pytest.mark.parametrize("wrap", ["tile", "clamp"])
@pytest.mark.parametrize("pixel_filter", ["box", "gaussian", "mitchell"])
def test_single_texels_are_filtered_as_whole_levels_are(wrap, pixel_filter):
    image = np.random.default_rng(4).uniform(0, 1, (13, 21, 3)).astype(np.float32)
    for size in ((13, 21), (6, 10), (1, 1)):
        whole = filter_channels(image, size, get_pixel_filter(pixel_filter), wrap)
        columns, rows = random_texels(size, 9, seed=0)
        few = filter_texels(image, size, get_pixel_filter(pixel_filter), wrap, columns, rows)
        np.testing.assert_allclose(few, whole[rows, columns], atol=1e-6)


def test_nothing_off_leaves_nothing_to_complete():
    base = base_of(coloured())
    seen, output = seen_by(base, FitOptions()), make_output(3)
    assert seen.base is base and not seen.averaged
    output.specular[:] = 0.7
    complete(output, seen, {})
    assert (output.specular == np.float32(0.7)).all()
    ggx = get_model("ggx")
    assert kernels_of(FitOptions(), ggx, ggx) == model_kernels("ggx", "ggx")


# Maps that are not read


@pytest.fixture
def folder(tmp_path):
    """A set with all that a set may have, and a name that tells the normal's Y."""
    rng = np.random.default_rng(5)
    made = tmp_path / "wall"
    made.mkdir()
    slope = 0.5 + 0.1 * rng.standard_normal((16, 16, 3))
    slope[..., 2] = 0.95
    pictures = {"color": rng.uniform(0.2, 0.8, (16, 16, 3)), "roughness": rng.uniform(0.3, 0.6, (16, 16, 1)),
                "normal": slope, "height": rng.uniform(0, 1, (16, 16, 1)), "ao": rng.uniform(0.5, 1, (16, 16, 1)),
                "metallic": rng.uniform(0, 1, (16, 16, 1))}  # fmt: skip
    for name, picture in pictures.items():
        write_png(made / f"wall_{name}.png", np.rint(255 * np.clip(picture, 0, 1)).astype(np.uint8))
    return made


def test_maps_that_nothing_needs_are_not_read_even_if_they_are_gone(folder):
    without = ("normal", "ao")
    texture_set = read_texture_set(folder, without=without)
    (folder / "wall_normal.png").unlink()
    (folder / "wall_height.png").write_bytes(b"no picture")
    (folder / "wall_ao.png").unlink()
    svbrdf = to_svbrdf(texture_set, without=without)
    assert (svbrdf.normal == [0, 0, 1]).all() and svbrdf.height is None and svbrdf.occlusion is None
    assert svbrdf.specular.std() > 0.0 and svbrdf.size == (16, 16)
    assert [note for note in texture_set.notes if "normal, height, ao" in note]
    with pytest.raises(InputError):
        to_svbrdf(texture_set)


def test_a_whole_bake_does_not_read_them_either(folder, tmp_path):
    for name in ("normal", "height"):
        path = folder / f"wall_{name}.png"
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])  # its header can be read, its texels cannot
    report = pipeline.bake_to_folder(folder, tmp_path / "out", without=("normal",), levels=2, preview=False)
    assert {each["role"] for each in report.manifest["inputs"]} == {"base_color", "roughness", "metallic", "ao"}
    assert report.manifest["options"]["normal"] == "mean"
    assert (report.baked.lobes[1].svbrdf.normal == [0, 0, 1]).all()


def test_without_its_normals_a_set_is_the_set_that_never_had_any(folder):
    with_normals = pipeline.bake(folder, without=("normal",), levels=2)
    for name in ("normal", "height"):
        (folder / f"wall_{name}.png").unlink()
    never = pipeline.bake(folder, without=("normal",), levels=2)
    for one, other in zip(with_normals.lobes.levels, never.lobes.levels, strict=True):
        assert same_bytes(one.svbrdf, other.svbrdf)
    with pytest.raises(InputError, match="no normal map and no height map"):
        pipeline.bake(folder)


def test_height_alone_can_be_left(folder):
    texture_set = read_texture_set(folder, without=("height",))
    (folder / "wall_height.png").unlink()
    svbrdf = to_svbrdf(texture_set, without=("height",))
    assert svbrdf.height is None and svbrdf.normal[..., 0].std() > 0.0


def test_colours_cannot_be_done_without(folder):
    with pytest.raises(UnknownNameError, match="ao"):
        to_svbrdf(read_texture_set(folder), without=("a_o",))
    with pytest.raises(UnknownNameError):
        to_svbrdf(read_texture_set(folder), without=("base_color",))


def test_roughness_alone_varies_over_flat_normals():
    """The held search over flat normals finds what the free one finds."""
    base = surface(slopes=(0.0, 0.0), colour=(0.5, 0.5, 0.5))
    perceptual = np.random.default_rng(6).uniform(0.3, 0.7, (8, 8)).astype(np.float32)
    base.log_roughness[:] = log_tensor_from_perceptual(perceptual)
    alike(base, {"lobe": "isotropic"}, {"lobe": "isotropic", "normal": "mean"})


@pytest.mark.parametrize("off", [{"colour": "shared", "coupling": False}, {"correlation": False, "coupling": False}])
def test_level_0_as_authored_in_another_model_has_the_colours_as_authored(off):
    base = coloured()
    level = check(bake(base, model="beckmann", keep_level_0=True, levels=1, specular="held", **off)).levels[0]
    np.testing.assert_allclose(level.svbrdf.specular, base.specular, rtol=1e-5)
    assert np.array_equal(level.svbrdf.diffuse, base.diffuse)


def test_refinement_sees_every_effect():
    """It starts from the fit without an effect, and lowers the error of the whole base."""
    (note,) = bake(coloured(), colour="shared", levels=2, refine=True).notes
    before, after = (float(note.split("level 0 from ")[1].split(" to ")[k].split()[0]) for k in range(2))
    assert after > before


# Energy


def rim(size=(128, 128)):
    """Bumpy and black but for its first column, which the last texels of each level see through half a base texel."""
    base = surface(size=size, spread=0.3, alpha=0.05, seed=6)
    base.specular[:, 1:] = 0.0
    return base


@pytest.mark.parametrize("quality, level", [("draft", 4), ("standard", 6)])
def test_a_bounded_colour_is_bounded_by_the_exact_average_where_samples_are_at_random_points(quality, level):
    base, options = rim(), FitOptions(quality=quality, levels=level + 1, reach=(level, level))
    found = get_method("bfgs").bake_lobes(base, options).levels[level].svbrdf.specular
    exact = filter_channels(base.specular, found.shape[:2], get_pixel_filter("box"), "tile")
    beyond = exact[:, -1]
    assert beyond.min() > 0.0
    np.testing.assert_array_less(0.9099 * beyond, found[:, -1])
    np.testing.assert_array_less(found[:, -1], 1.0901 * beyond)
    rows = np.arange(len(found))
    sample = LevelSample(base, level, np.full(len(rows), len(rows) - 1), rows, options)
    np.testing.assert_allclose(sample.fit()[0].scale, found[:, -1], rtol=1e-6)


@pytest.mark.parametrize("samples", [48, 64])
def test_the_dense_rule_counts_what_a_footprint_sees_beyond_its_rim_once(samples):
    """48 samples for 32 texels once stood across texel centres, and were moved off them where they were cut."""
    base = rim()
    rows = np.arange(4)
    sample = LevelSample(base, 5, np.full(4, 3), rows)
    exact = filter_texels(base.specular, (4, 4), get_pixel_filter("box"), "tile", np.full(4, 3), rows)
    theta, _ = sample.fit()[0]
    energy = sample.measure([Lobes(theta, exact.astype(np.float64))], nodes=256, samples=(16, samples)).energy
    np.testing.assert_allclose(energy, 1.0, atol=0.01)
