"""The whole BRDF in plain numpy, written apart from the kernels that it checks: lobe, masking, Fresnel, diffuse.

Vectors are (..., 3) and broadcast; directions point away from the surface. Results keep their three components apart
in memory (planar), which is what makes their slices fast.

Sources: Walter et al. 2007 (microfacet BRDF); Heitz, JCGT 3(2), 2014 (anisotropic Smith, height-correlated masking and
shadowing); Schlick 1994 (Fresnel).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import gamma

#: profile(q, C, shape): the lobe but for 1 / (pi sqrt(det Sigma)), q = x' Sigma^-1 x and C = (n.h)^2, normalised.
Profile = Callable[[NDArray, NDArray, NDArray | None], NDArray]

# Lobes vanish long before C falls so low; it keeps 1 / C^2 finite.
_LEAST_C = 1e-6
# At 1 - C this small log(C) / (1 - C) is -1 to single precision.
_LEAST_BELOW = np.float32(1e-7)
# Below it the quotient of the visibility term overflows single precision; nothing is seen at such an angle anyway.
_LEAST_COSINE = 1e-4
#: Reflectance below which a surface has no Fresnel peak: no real material reflects less than 2%.
_LEAST_REFLECTANCE = 0.02


def ggx_profile(q: NDArray, C: NDArray, shape: NDArray | None = None) -> NDArray:
    """GGX: (q + C)^-2."""
    return 1.0 / np.square(q + C)


def beckmann_profile(q: NDArray, C: NDArray, shape: NDArray | None = None) -> NDArray:
    """Beckmann: exp(-q / C) / C^2."""
    C = np.maximum(C, _LEAST_C)
    return np.exp(-q / C) / np.square(C)


def generalised_beckmann_profile(q: NDArray, C: NDArray, shape: NDArray | None = None) -> NDArray:
    """Generalised Beckmann: exp(-(q / C)^p) / (Gamma(1 + 1/p) C^2) with p = exp(shape)."""
    if shape is None:
        return beckmann_profile(q, C)
    C = np.maximum(C, _LEAST_C)
    power = np.exp(shape)
    return np.exp(-np.power(q / C, power)) / (gamma(1.0 + 1.0 / power) * np.square(C))


def ashikhmin_shirley_profile(q: NDArray, C: NDArray, shape: NDArray | None = None) -> NDArray:
    """Ashikhmin-Shirley, and Blinn-Phong where isotropic: exp(q log(C) / (1 - C)) / C; the quotient is -1 at C = 1."""
    C = np.maximum(C, _LEAST_C)
    below = np.maximum(1.0 - C, _LEAST_BELOW)
    return np.exp(q * np.minimum(np.log1p(-below) / below, -1.0)) / C


#: The lobes of the models, by name.
PROFILES: dict[str, Profile] = {
    "ggx": ggx_profile,
    "beckmann": beckmann_profile,
    "generalised-beckmann": generalised_beckmann_profile,
    "ashikhmin-shirley": ashikhmin_shirley_profile,
    "blinn-phong": ashikhmin_shirley_profile,
}


def components(x: NDArray, y: NDArray, z: NDArray) -> NDArray:
    """Vectors (..., 3) of their components, planar in memory."""
    out = np.empty((3, *np.broadcast_shapes(x.shape, y.shape, z.shape)), np.result_type(x, y, z))
    out[0], out[1], out[2] = x, y, z
    return np.moveaxis(out, 0, -1)


def dot(one: NDArray, other: NDArray) -> NDArray:
    """Scalar products (...) of vectors (..., 3)."""
    return one[..., 0] * other[..., 0] + one[..., 1] * other[..., 1] + one[..., 2] * other[..., 2]


def normalise(vector: NDArray) -> NDArray:
    """Unit vectors (..., 3)."""
    return vector / np.sqrt(dot(vector, vector))[..., None]


def into_frame(vector: NDArray, normal: NDArray) -> NDArray:
    """Vectors (..., 3) in the frame of unit normals (..., 3): the one that the shortest rotation of z to n carries.

    R'w = (w_xy - k n_xy, n.w) with k = (w_xy.n_xy) / (1 + n_z) + w_z. (n_z = -1 has no shortest rotation.)
    """
    x, y, z = normal[..., 0], normal[..., 1], normal[..., 2]
    along = vector[..., 0] * x + vector[..., 1] * y
    k = along / np.maximum(1.0 + z, 1e-6)
    k += vector[..., 2]
    along += vector[..., 2] * z
    return components(vector[..., 0] - k * x, vector[..., 1] - k * y, along)


def distribution(
    half: NDArray, tensor: NDArray, profile: Profile = ggx_profile, shape: NDArray | None = None
) -> NDArray:
    """D(h) (...) of half vectors (..., 3) in the frame of the normal, Sigma (..., 3) given as (XX, YY, XY)."""
    xx, yy, xy = tensor[..., 0], tensor[..., 1], tensor[..., 2]
    x, y, z = half[..., 0], half[..., 1], half[..., 2]
    determinant = np.maximum(xx * yy - xy * xy, np.finfo(np.float32).tiny)
    q = (x * (yy * x - 2.0 * xy * y) + xx * y * y) / determinant
    return profile(np.maximum(q, 0.0), z * z, shape) / (np.pi * np.sqrt(determinant))


def smith_visibility(light: NDArray, view: NDArray, tensor: NDArray) -> NDArray:
    """G2 / (4 n.l n.v) (...) of directions (..., 3) in the frame of the normal, held above the horizon.

    Height-correlated Smith for GGX: 1 / (2 (n.l sqrt(n.v^2 + v' Sigma v) + n.v sqrt(n.l^2 + l' Sigma l))). Other lobes
    use it too: masking differs between them by less than a picture shows.
    """
    n_l, n_v = np.maximum(light[..., 2], _LEAST_COSINE), np.maximum(view[..., 2], _LEAST_COSINE)
    return 0.5 / (
        n_l * np.sqrt(n_v * n_v + _stretch(view, tensor)) + n_v * np.sqrt(n_l * n_l + _stretch(light, tensor))
    )


def schlick(cosine: NDArray) -> NDArray:
    """Weight w (...) of grazing reflection at v.h = cosine: F = specular + (1 - specular) w."""
    m = np.clip(1.0 - cosine, 0.0, 1.0)
    m2 = m * m
    return m2 * m2 * m


def rim(specular: NDArray) -> NDArray:
    """Factor (...) of `schlick`: 1, but fading where specular (..., 3) is below 2%, so that black stays black."""
    strongest = np.maximum(np.maximum(specular[..., 0], specular[..., 1]), specular[..., 2])
    return np.minimum(strongest / _LEAST_REFLECTANCE, 1.0)


def brdf(
    light: NDArray,
    view: NDArray,
    normal: NDArray,
    tensor: NDArray,
    specular: NDArray,
    diffuse: NDArray,
    *,
    profile: Profile = ggx_profile,
    shape: NDArray | None = None,
) -> NDArray:
    """The BRDF times n.l, (..., 3): what a directional light of unit irradiance sends to the viewer.

    F D G2 / (4 n.l n.v) n.l + diffuse (1 - specular)(1 - w(n.l))(1 - w(n.v)) n.l / pi, w of `schlick`; zero where light
    or viewer is below the texel's horizon. What a smooth surface reflects, F(n.v), and what is left to the diffuse part
    add up to at most 1 (Shirley et al. 1997); with 1 - F(v.h) in its place, white plastic would give back 115% at 75
    degrees.

    Args:
        light: (..., 3) unit vectors to the light, tangent space of the texture.
        view: (..., 3) unit vectors to the viewer.
        normal: (..., 3) unit normals.
        tensor: (..., 3) Sigma as (XX, YY, XY), in alpha^2.
        specular: (..., 3) reflectance at normal incidence.
        diffuse: (..., 3) diffuse albedo.
        profile: the lobe.
        shape: (...) further parameter of the lobe.
    """
    plain, peak, matt = brdf_terms(light, into_frame(view, normal), view, normal, tensor, specular, profile, shape)
    matt = (diffuse * under_specular(specular)) * matt[..., None]
    return specular * plain[..., None] + peak[..., None] + matt


def under_specular(specular: NDArray) -> NDArray:
    """What the lobe leaves to the diffuse part at normal incidence, 1 - specular (..., 3); 0 for a scale above 1."""
    return np.maximum(1.0 - specular, 0.0)


def brdf_terms(
    light: NDArray,
    of_view: NDArray,
    view: NDArray,
    normal: NDArray,
    tensor: NDArray,
    specular: NDArray,
    profile: Profile = ggx_profile,
    shape: NDArray | None = None,
) -> tuple[NDArray, NDArray, NDArray]:
    """The BRDF times n.l in three terms (...): specular * plain + peak + diffuse * under_specular(specular) * matt.

    For renderers that average many texels: colours enter as plain sums. ``of_view`` is ``into_frame(view, normal)``,
    the same for every light; the rest is as in `brdf`.
    """
    middle = light + view
    per_length = 1.0 / np.sqrt(dot(middle, middle))
    of_light = into_frame(light, normal)
    # The frame is a rotation, so the half vector in it is the half vector of what is in it.
    lobe = distribution((of_light + of_view) * per_length[..., None], tensor, profile, shape)
    lit = (of_light[..., 2] > 0.0) & (of_view[..., 2] > 0.0)
    cosine = np.where(lit, of_light[..., 2], 0.0)
    lobe *= smith_visibility(of_light, of_view, tensor)
    lobe *= cosine
    edge = rim(specular)
    peak = lobe * schlick(dot(view, middle) * per_length) * edge
    through = (1.0 - schlick(of_light[..., 2]) * edge) * (1.0 - schlick(of_view[..., 2]) * edge)
    return lobe - peak, peak, cosine * through * np.float32(1.0 / np.pi)


def _stretch(direction: NDArray, tensor: NDArray) -> NDArray:
    x, y = direction[..., 0], direction[..., 1]
    return x * (tensor[..., 0] * x + 2.0 * tensor[..., 2] * y) + tensor[..., 1] * y * y
