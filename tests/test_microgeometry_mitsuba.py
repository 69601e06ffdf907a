"""The tracer against Mitsuba 3 on the same mesh: pixel by pixel, within the noise of both."""

import numpy as np
import pytest

from brdffit.microgeometry.heightfield import HeightField
from brdffit.microgeometry.tracer import Effects, Microgeometry
from tests.test_microgeometry import bumps, material, toward

mitsuba = pytest.importorskip("mitsuba", reason="the extra 'tracers' is not installed")
mitsuba.set_variant("scalar_rgb")

SIZE, TILES, PIXELS, SAMPLES = 24, 5, 12, 256
#: Differences of 144 pixels over their standard errors, which eight runs tell with 7 degrees of freedom: as Student's t
#: their root mean square is 1.18, and the largest exceeds 7.5 in one of a hundred correct runs.
WORST, ROOT_MEAN_SQUARE = 7.5, 1.4


def mesh(height, bsdf):
    """The periodic height as Mitsuba's mesh: TILES x TILES tiles around the one at the origin, rows along -y."""
    count = TILES * SIZE + 1
    j, i = np.mgrid[:count, :count] - SIZE * (TILES // 2)
    vertices = np.stack([i, -j, height[j % SIZE, i % SIZE]], axis=-1).reshape(-1, 3).astype(np.float32)
    a = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    b, c, d = a + 1, a + count, a + count + 1
    # Counterclockwise from above; both share the diagonal from a to d.
    faces = np.concatenate([np.stack([a, d, b], axis=1), np.stack([a, c, d], axis=1)]).astype(np.uint32)
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict(bsdf)
    properties["face_normals"] = True
    shape = mitsuba.Mesh("height", len(vertices), len(faces), props=properties)
    parameters = mitsuba.traverse(shape)
    parameters["vertex_positions"], parameters["faces"] = vertices.ravel(), faces.ravel()
    parameters.update()
    return shape


def picture(height, bsdf, view, light, bounces, reference):
    """(mean, standard error) (PIXELS, PIXELS) of Mitsuba, and positions (PIXELS, PIXELS, 2) with axes of its pixels."""
    up = np.array([0.0, 1.0, 0.0])
    centre = np.array([SIZE / 2, -SIZE / 2, reference])
    transform = mitsuba.ScalarTransform4f
    to_world = transform().look_at(target=centre, origin=centre + 40.0 * view, up=up) @ transform().scale([6, 6, 1])
    sensor = mitsuba.load_dict({
        "type": "orthographic", "to_world": to_world,
        "film": {"type": "hdrfilm", "width": PIXELS, "height": PIXELS, "rfilter": {"type": "box"}},
        "sampler": {"type": "independent", "sample_count": SAMPLES},
    })  # fmt: skip
    scene = mitsuba.load_dict({
        "type": "scene", "mesh": mesh(height, bsdf),
        "lamp": {"type": "directional", "direction": list(-light), "irradiance": 1.0},
    })  # fmt: skip
    integrator = mitsuba.load_dict({"type": "path", "max_depth": bounces + 2, "rr_depth": 1000})
    runs = [np.array(integrator.render(scene, sensor, seed=n, spp=SAMPLES // 8))[..., 0] for n in range(8)]
    found = []
    for film in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)):
        ray, _ = sensor.sample_ray(0.0, 0.0, film, (0.5, 0.5))
        origin, direction = np.array(ray.o), np.array(ray.d)
        at = origin + direction * (reference - origin[2]) / direction[2]
        found.append([at[0] + 0.5, -at[1] + 0.5])
    corner, right, down = np.array(found)
    return np.mean(runs, axis=0), np.std(runs, axis=0, ddof=1) / np.sqrt(8), corner, right - corner, down - corner


@pytest.mark.parametrize(
    ("bsdf", "parameters", "bounces"),
    [
        ({"type": "diffuse", "reflectance": 0.8}, {"diffuse": 0.8, "specular": 0.0}, 0),
        ({"type": "diffuse", "reflectance": 0.8}, {"diffuse": 0.8, "specular": 0.0}, 3),
        # Fresnel 1, and so smooth that correlated and separable masking agree.
        (
            {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": 0.12},
            {"diffuse": 0.0, "specular": 1.0, "alpha": 0.12},
            0,
        ),
    ],
    ids=["direct", "bounces", "glossy"],
)
def test_pixels_agree(bsdf, parameters, bounces):
    height = bumps(SIZE, 1.5, seed=2).astype(np.float32)
    view, light = toward(45, -60), toward(55, 100)
    field = HeightField.of(material(height, **parameters), shading="geometry")
    theirs, error, corner, right, down = picture(height, bsdf, view, light, bounces, field.reference)
    film = (np.arange(PIXELS) + 0.5) / PIXELS
    rng = np.random.default_rng(0)
    jitter = (rng.random((SAMPLES, PIXELS, PIXELS, 2)) - 0.5) / PIXELS
    x, y = film[None, None, :] + jitter[..., 0], film[None, :, None] + jitter[..., 1]
    position = (corner + x[..., None] * right + y[..., None] * down).reshape(-1, 2)
    count = len(position)
    found = Microgeometry(field, Effects(bounces=bounces)).reflect(
        position, np.tile(view, (count, 1)), np.tile(light, (count, 1)), 3
    )
    ours = found[:, 0].astype(float).reshape(SAMPLES, PIXELS, PIXELS)
    noise = np.hypot(error, ours.std(axis=0) / np.sqrt(SAMPLES))
    apart = (ours.mean(axis=0) - theirs) / np.maximum(noise, 1e-3 * theirs.mean())
    # There is something to compare: light, and what differs from pixel to pixel.
    assert theirs.mean() > 0.005 and theirs.std() > 0.2 * theirs.mean()
    assert np.abs(apart).max() < WORST and np.sqrt(np.square(apart).mean()) < ROOT_MEAN_SQUARE
    total = np.sqrt(np.square(noise).mean() / apart.size)
    assert abs(ours.mean() - theirs.mean()) < 4.0 * total
