"""Laws of the reference and of pyramids: convergence, agreement with the plain shader, filters, threads, lookup."""

from __future__ import annotations

import numpy as np
import pytest
import shading_oracle as shading
from export_support import random_svbrdf

from brdffit.errors import InputError, UnknownNameError
from brdffit.files.image_io import write_mip_exr
from brdffit.fitting.options import FitOptions
from brdffit.methods import get_method, lobe_method_names
from brdffit.models import model_names
from brdffit.render import scenes
from brdffit.render.lights import Lights
from brdffit.render.pictures import render_appearance
from brdffit.render.reference import pair_errors, render_halves, render_reference
from brdffit.render.terms import LOBE_ONLY, Terms
from brdffit.roughness import log_tensor_from_perceptual, tensor_from_log
from brdffit.svbrdf import Svbrdf, level_sizes

#: Sums in single precision, and the polynomial exponentials of the kernels.
KERNEL = 2e-4
LIGHTS = Lights(np.array([(0.3, 0.2, 1.0), (-0.5, 0.4, 0.6)]), np.array([(1.0, 0.8, 0.5), (0.3, 0.6, 0.9)]))


def smooth_svbrdf(size=(8, 8), roughness=0.5, seed=0):
    """Isotropic, gentle slopes: a footprint that few samples average well."""
    random = np.random.default_rng(seed)
    slope = random.uniform(-0.3, 0.3, (*size, 2))
    normal = np.concatenate([slope, np.ones((*size, 1))], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    perceptual = random.uniform(roughness, roughness + 0.2, size).astype(np.float32)
    colours = random.uniform(0.1, 0.9, (2, *size, 3)).astype(np.float32)
    return Svbrdf(normal.astype(np.float32), log_tensor_from_perceptual(perceptual), colours[0], colours[1])


def constant(model="ggx", size=(8, 8)):
    one = smooth_svbrdf((1, 1))
    arrays = {name: np.broadcast_to(array, (*size, 3)).copy() for name, array in one.arrays().items()}
    return Svbrdf(**arrays, model=model)


def shaded(texel_arrays, scene, at, lights=LIGHTS, profile=shading.ggx_profile):
    """Radiance of one pixel by the plain shader, of (..., C) texel parameters; double precision."""
    normal, tensor, specular, diffuse = (np.asarray(a, float) for a in texel_arrays)
    total = 0.0
    for direction, irradiance in zip(lights.direction, lights.irradiance, strict=True):
        light = scene.frame[at].astype(float) @ direction
        if light[2] > 0.0:
            brdf = shading.brdf(light, scene.view[at].astype(float), normal, tensor, specular, diffuse, profile=profile)
            total = total + brdf * irradiance
    return total


@pytest.mark.parametrize("model", model_names())
@pytest.mark.parametrize("isotropic", [True, False])
def test_kernels_agree_with_the_plain_shader(model, isotropic):
    """One texel wide textures: nothing is interpolated, every pixel shades the texel itself."""
    base = random_svbrdf((1, 1), model=model, seed=4) if not isotropic else constant(model, (1, 1))
    scene = scenes.sphere((1, 1), 0, (6, 6))
    profile, shape = shading.PROFILES[model], None if base.shape is None else float(base.shape[0, 0])

    def with_shape(q, c, _):
        return profile(q, c, None if shape is None else np.full_like(q, shape))

    tensor = tensor_from_log(base.log_roughness[0, 0].astype(float))
    texel = base.normal[0, 0], tensor, base.specular[0, 0], base.diffuse[0, 0]
    pictures = [render_reference(base, scene, LIGHTS, samples=4), render_appearance([base], scene, LIGHTS)]
    for at in np.argwhere(scene.coverage > 0.0):
        expected = shaded(texel, scene, tuple(at), profile=with_shape)
        for picture in pictures:
            np.testing.assert_allclose(picture[tuple(at)], expected, rtol=KERNEL, atol=1e-5)


# Networks that say lobes outright keep nothing exactly.
@pytest.mark.parametrize("method", sorted(set(lobe_method_names()) - {"bfgs", "latent", "mipnet"}))
def test_a_constant_material_is_the_same_by_every_closed_form(method):
    base = constant()
    base = base.replace(height=np.zeros(base.size, np.float32)) if method == "height" else base
    if method in ("flatten", "height"):
        # They make normals of their own: only the flat material is constant to them.
        base = base.replace(normal=np.broadcast_to(np.array([0, 0, 1], np.float32), (*base.size, 3)).copy())
    chosen = get_method(method)
    pyramid = chosen.bake_lobes(base, chosen.options())
    for level in range(4):
        scene = scenes.plane(base.size, level, (4, 4))
        truth = render_reference(base, scene, LIGHTS, samples=64)
        np.testing.assert_allclose(render_appearance(pyramid, scene, LIGHTS), truth, rtol=KERNEL)


def test_the_reference_is_the_average_under_the_box():
    """Against a dense midpoint rule over the bilinear base, shaded in NumPy: a writing of its own."""
    base = smooth_svbrdf()
    scene = scenes.plane(base.size, 1, (4, 4), shift=(0.3, 0.1))
    picture = render_reference(base, scene, LIGHTS, samples=16384)
    for at in [(0, 0), (3, 2)]:
        np.testing.assert_allclose(picture[at], dense_average(base, scene, at), rtol=1e-3)


def dense_average(base, scene, at, side=128):
    """Mean of the shaded bilinear base over one pixel's box."""
    offset = (np.arange(side) + 0.5) / side - 0.5
    x, y = np.meshgrid(offset, offset)
    place = scene.centre[at] + np.stack([x, y], -1) @ scene.axes[at].T - 0.5
    low = np.floor(place).astype(int)
    part = place - low

    def bilinear(image):
        height, width = base.size
        i, j = low[..., 0], low[..., 1]
        fx, fy = part[..., :1], part[..., 1:]
        corners = [image[(j + b) % height, (i + a) % width].astype(float) for b in (0, 1) for a in (0, 1)]
        return (corners[0] * (1 - fx) + corners[1] * fx) * (1 - fy) + (corners[2] * (1 - fx) + corners[3] * fx) * fy

    perceptual = np.exp(base.log_roughness[..., :1] / 4.0)
    square = bilinear(perceptual)[..., 0] ** 4
    normal = bilinear(base.normal)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    tensor = np.stack([square, square, np.zeros_like(square)], -1)
    return shaded((normal, tensor, bilinear(base.specular), bilinear(base.diffuse)), scene, at).mean(axis=(0, 1))


def test_the_reference_converges_at_its_rate_and_knows_its_error():
    """One jittered sample a stratum: on a smooth field the squared error of N samples falls as 1 / N^2."""
    base = smooth_svbrdf((32, 32))
    scene = scenes.plane(base.size, 1, (16, 16))
    truth = render_reference(base, scene, LIGHTS, samples=65536)
    errors, own = [], []
    for samples in (32, 128, 512, 2048):
        found = render_halves(base, scene, LIGHTS, samples=samples)
        errors.append(np.mean((found.radiance - truth) ** 2))
        own.append(np.mean(found.squared_error))
    rate = np.polyfit(np.log([32, 128, 512, 2048]), np.log(errors), 1)[0]
    assert -2.3 < rate < -1.7
    # 256 footprints of very unequal errors: their mean squares are good to some ten percent.
    np.testing.assert_allclose(own, errors, rtol=0.35)


def test_strata_wider_than_texels_average_what_they_skip():
    """32 x 32 texels under a pixel and 64 samples: no bias, and an error that is known."""
    base = smooth_svbrdf((32, 32), roughness=0.4)
    scene = scenes.plane(base.size, 5, (16, 16))
    rough, dense = (render_halves(base, scene, LIGHTS, samples=n) for n in (64, 16384))
    # All pixels share one footprint, so they share its error: about as large as the halves say.
    error = np.sqrt(np.mean((rough.radiance - dense.radiance) ** 2))
    assert error < 4.0 * np.sqrt(np.mean(rough.squared_error))
    assert error < 0.1 * dense.radiance.mean()


@pytest.mark.parametrize("pixel_filter", ["box", "gaussian", "mitchell"])
def test_filters_weigh_a_linear_field_alike(pixel_filter):
    """Diffuse albedo that is linear along x: every symmetric filter gives its value at the pixel's centre."""
    base = constant(size=(16, 16))
    ramp = np.linspace(0.1, 0.9, 16, dtype=np.float32)
    base.diffuse[:] = ramp[None, :, None]
    terms = Terms(lobe=False, fresnel=False)
    scene = scenes.plane(base.size, 1, (8, 8))
    picture = render_reference(base, scene, LIGHTS, terms=terms, pixel_filter=pixel_filter, samples=4096)
    flat = render_reference(base.replace(diffuse=np.ones_like(base.diffuse)), scene, LIGHTS, terms=terms, samples=4)
    middle = np.interp(scene.centre[4, 2:6, 0], np.arange(16) + 0.5, ramp)
    np.testing.assert_allclose(picture[4, 2:6] / flat[4, 2:6], np.repeat(middle[:, None], 3, 1), rtol=2e-3)


def test_a_shift_by_a_whole_pixel_rolls_the_picture():
    base = smooth_svbrdf()
    still, moved = (scenes.plane(base.size, 1, (6, 6), shift=(shift, 0.0)) for shift in (0.0, 1.0))
    one, other = (render_reference(base, scene, LIGHTS, samples=64) for scene in (still, moved))
    np.testing.assert_allclose(other[:, :-1], one[:, 1:], rtol=1e-5)
    levels = [level.svbrdf for level in get_method("naive").bake_lobes(base, FitOptions()).levels]
    one, other = (render_appearance(levels, scene, LIGHTS) for scene in (still, moved))
    np.testing.assert_allclose(other[:, :-1], one[:, 1:], rtol=1e-5)


def test_pictures_do_not_depend_on_threads():
    base = smooth_svbrdf()
    scene = scenes.slanted(base.size, (24, 24))
    pictures = [render_reference(base, scene, samples=64, threads=threads) for threads in (1, 3)]
    np.testing.assert_array_equal(*pictures)
    errors = [pair_errors(base, [base], [1, 2], [3, 4], 16, samples=64, threads=threads) for threads in (1, 3)]
    np.testing.assert_array_equal(errors[0][0], errors[1][0])


@pytest.mark.parametrize("off", ["masking", "fresnel", "diffuse", "cosine", "lobe"])
def test_a_term_that_is_off_is_gone(off):
    """Each term against the plain shader's own pieces, taken apart by hand."""
    base = constant(size=(1, 1))
    scene = scenes.plane((1, 1), 0, (1, 1))
    one = Lights(np.array([(0.6, 0.2, 0.7)]), np.ones((1, 3)))
    picture = render_reference(base, scene, one, terms=Terms(**{off: False}), samples=4)[0, 0]
    light, view = (scene.frame[0, 0] @ one.direction[0]).astype(float), scene.view[0, 0].astype(float)
    normal, specular, diffuse = base.normal[0, 0], base.specular[0, 0].astype(float), base.diffuse[0, 0].astype(float)
    tensor = tensor_from_log(base.log_roughness[0, 0].astype(float))
    of_light, of_view = (shading.into_frame(each, normal.astype(float)) for each in (light, view))
    half = (of_light + of_view) / np.linalg.norm(of_light + of_view)
    cosine = 1.0 if off == "cosine" else of_light[2]
    visibility = 1.0 if off == "masking" else shading.smith_visibility(of_light, of_view, tensor)
    weight = 0.0 if off == "fresnel" else shading.schlick(half @ of_view)
    fresnel = specular + (1.0 - specular) * weight
    lobe = 0.0 if off == "lobe" else shading.distribution(half, tensor) * visibility * fresnel * cosine
    losses = [0.0 if off == "fresnel" else shading.schlick(each[2]) for each in (of_light, of_view)]
    matt = diffuse * (1 - specular) * (1 - losses[0]) * (1 - losses[1]) * cosine / np.pi
    np.testing.assert_allclose(picture, lobe + (0.0 if off == "diffuse" else matt), rtol=KERNEL)


def test_lobe_only_is_the_lobe():
    base = constant(size=(1, 1))
    scene = scenes.plane((1, 1), 0, (1, 1))
    one = Lights(np.array([(0.6, 0.2, 0.7)]), np.ones((1, 3)))
    half = scene.view[0, 0] + scene.frame[0, 0] @ one.direction[0]
    local = shading.into_frame(half / np.linalg.norm(half), base.normal[0, 0])
    expected = base.specular[0, 0] * shading.distribution(local, tensor_from_log(base.log_roughness[0, 0]))
    np.testing.assert_allclose(render_reference(base, scene, one, terms=LOBE_ONLY, samples=4)[0, 0], expected, KERNEL)


def test_four_dimensions_and_two_agree_in_value():
    """Random pairs with the lobe alone against the half-angle integral: two writings of one number."""
    from brdffit.fitting.batch import model_kernels
    from brdffit.halfangle.apparent_lobe import base_of
    from brdffit.halfangle.measure import measure

    base = smooth_svbrdf((16, 16), roughness=0.5)
    pyramids = [get_method(name).bake_lobes(base, FitOptions()) for name in ("naive", "vmf", "lean")]
    levels = [pyramid[2].svbrdf for pyramid in pyramids]
    columns, rows = np.array([0, 1, 3]), np.array([2, 0, 3])
    error, square = pair_errors(base, levels, columns, rows, 16384, terms=LOBE_ONLY, samples=4096)
    integral = measure(
        base_of(base), base.size, levels, columns, rows, pixel_filter="box", exponent=3,
        kernels=model_kernels("ggx", "ggx"), nodes=4096,
    )  # fmt: skip
    # 16384 pairs at lobes that fill a tenth of the hemisphere: some percent of the error.
    np.testing.assert_allclose(error / square, integral.error, rtol=0.15)


@pytest.mark.parametrize("size", [(16, 16), (12, 20)])
def test_trilinear_lookup_agrees_with_a_texture_system(tmp_path, size):
    """Diffuse alone under one light is the diffuse map times a constant: the lookup is laid bare."""
    oiio = pytest.importorskip("OpenImageIO")
    random = np.random.default_rng(2)
    levels = []
    for height, width in level_sizes(size):
        diffuse = random.random((height, width, 3)).astype(np.float32)
        normal = np.broadcast_to(np.array([0, 0, 1], np.float32), (height, width, 3)).copy()
        rough = np.zeros((height, width, 3), np.float32)
        levels.append(Svbrdf(normal, rough, np.zeros_like(diffuse), diffuse))
    file = tmp_path / "diffuse.exr"
    write_mip_exr(file, [level.diffuse for level in levels], ("R", "G", "B"))
    one = Lights(np.array([(0.0, 0.0, 1.0)]), np.full((1, 3), np.pi))
    options = oiio.TextureOpt()
    options.swrap = options.twrap = oiio.Wrap.Periodic
    options.interpmode, options.mipmode = oiio.InterpMode.Bilinear, oiio.MipMode.Trilinear
    system = oiio.TextureSystem()
    for level in (0, 0.5, 1.25, 2):
        scene = scenes.plane(size, level, (4, 5), shift=(0.3, 0.4))
        picture = render_appearance(levels, scene, one, terms=Terms(lobe=False, fresnel=False))
        for at in np.ndindex(4, 5):
            s, t = scene.centre[at] / (size[1], size[0])
            # It blends two levels linearly in the width of the filter, we in its logarithm, as hardware does.
            fine, part = divmod(level, 1)
            step = 2.0**fine * (1.0 + part)
            found = system.texture(str(file), options, s, t, step / size[1], 0.0, 0.0, step / size[0], 3)
            np.testing.assert_allclose(picture[at], found, atol=2e-5, err_msg=f"level {level} at {at}")


def test_what_cannot_be_rendered_is_refused():
    base, scene = constant(), scenes.plane((16, 16), 0, (2, 2))
    with pytest.raises(InputError, match="made for a base of"):
        render_reference(base, scene)
    with pytest.raises(UnknownNameError):
        render_reference(base, scenes.plane(base.size, 0, (2, 2)), samples="standrad")
    base.normal[0, 0, 0] = np.nan
    with pytest.raises(InputError, match="not finite"):
        render_reference(base, scenes.plane(base.size, 0, (2, 2)))


def test_progress_reaches_the_end():
    base, told = constant(), []
    scene = scenes.plane(base.size, 0, (8, 8))
    render_reference(base, scene, samples=4, progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (64, 64)
    assert told == sorted(told)
