"""The BRDF around a lobe: masking and shadowing, Fresnel, diffuse, and directions drawn from it.

    f (n.l) = [F D(h) G2 / (4 n.l n.v) + diffuse (1 - specular)(1 - w(n.l))(1 - w(n.v)) / pi] n.l

with F = specular + (1 - specular) w(v.h) faded out where specular is below 2%, w Schlick's weight; 0 where the light
is below the horizon of n. A viewer below it counts as one on it, n.v = 0, as engines clamp it: what a slanted view
shows in place of a bump that faces away is another bump, never a hole. Reflected light stays bounded: at n.v <= 0, G2
/ (4 n.l n.v) is at most 1 / (2 n.l S) with S^2 = v' Sigma v, so a lobe of colour 1 reflects at most (2 / S) int D(h)
(v.h)+ dh = (n.v + sqrt(n.v^2 + S^2)) / S <= 1, and falls smoothly as n turns away. With (1 - w(n.l))(1 - w(n.v)) the
specular and the diffuse reflection of a smooth surface add up to at most 1 (Shirley et al. 1997); with 1 - F(v.h),
white plastic would reflect 115% at 75 degrees.

The renderer's loops inline ``reflect``, for any lobe and any choice of terms; ``brdf``, ``draw`` and ``drawn_density``
do the same for arrays of lobes, for appearances that are rendered in numpy. They take and return arrays of n rows:
``normal`` (n, 3) unit vectors in tangent space, ``tensor`` (n, 3) Sigma as (XX, YY, XY) in alpha^2,
``specular`` and ``diffuse`` (n, 3) linear RGB, directions (n, 3) unit vectors in tangent space away from the surface.

Sources: Walter et al. 2007 (microfacet BRDF); Heitz, JCGT 3(2), 2014 (anisotropic Smith, height-correlated masking and
shadowing); Schlick 1994 (Fresnel).
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from brdffit._jit import inline, kernel, specialise
from brdffit.models import get_model
from brdffit.models.ggx import profile  # bound anew for other models

real = np.float32

# Terms of the BRDF; a kernel bound to False for a term has no code for it.
LOBE = True
MASKING = True
FRESNEL = True
DIFFUSE = True
COSINE = True

#: Below this cosine the quotient of the visibility term overflows single precision; at such angles nothing is visible.
_LEAST_COSINE = 1e-4
#: Reflectance below which a surface has no Fresnel peak: no real material reflects less than 2%.
LEAST_REFLECTANCE = 0.02


@inline
def fifth_power(cosine):
    """Schlick's weight (1 - cosine)^5."""
    m = min(max(real(1.0) - cosine, real(0.0)), real(1.0))
    m2 = m * m
    return m2 * m2 * m


@inline
def reflect(x, y, z, i_xx, i_yy, i_xy, t_xx, t_yy, t_xy, amplitude, shape, h_x, h_y, h_z, l_x, l_y, l_z, v_x, v_y, v_z):
    """(lobe, cosine): the reflection of a lobe without colour and Fresnel, and n.l.

    (x, y, z) is the normal, ``i_xx``... the inverse of the tensor ``t_xx``..., ``amplitude`` K(shape) /
    (pi sqrt(det Sigma)). Vectors are transformed to the frame of n, R'w = (w_xy - k n_xy, n.w) with
    k = (w_xy.n_xy) / (1 + n_z) + w_z. G2 / (4 n.l n.v) is the height-correlated Smith term of GGX,
    1 / (2 (n.l sqrt(n.v^2 + v' Sigma v) + n.v sqrt(n.l^2 + l' Sigma l))), for every lobe: the differences of masking
    between lobes do not show in pictures. With MASKING or COSINE both results are 0 where the light is below the
    horizon of n.
    """
    per = real(1.0) / max(real(1.0) + z, real(1e-6))
    n_l = l_x * x + l_y * y + l_z * z
    n_v = v_x * x + v_y * y + v_z * z
    cosine = real(1.0)
    if COSINE:
        cosine = n_l
    if MASKING or COSINE:
        cosine = cosine if n_l > real(0.0) else real(0.0)
    lobe = real(0.0)
    if LOBE:
        along = h_x * x + h_y * y
        k = along * per + h_z
        a, b, c = h_x - k * x, h_y - k * y, along + h_z * z
        q = max(a * (i_xx * a + real(2.0) * i_xy * b) + i_yy * b * b, real(0.0))
        lobe = amplitude * cosine * profile(q, min(c * c, real(1.0)), shape)
        # A lobe ends at its own horizon.
        lobe = lobe if c > real(0.0) else real(0.0)
        if MASKING:
            k = (v_x * x + v_y * y) * per + v_z
            a, b = v_x - k * x, v_y - k * y
            of_view = a * (t_xx * a + real(2.0) * t_xy * b) + t_yy * b * b
            k = (l_x * x + l_y * y) * per + l_z
            a, b = l_x - k * x, l_y - k * y
            of_light = a * (t_xx * a + real(2.0) * t_xy * b) + t_yy * b * b
            u_l, u_v = max(n_l, real(_LEAST_COSINE)), max(n_v, real(_LEAST_COSINE))
            lobe *= real(0.5) / (
                u_l * np.sqrt(u_v * u_v + max(of_view, real(0.0))) + u_v * np.sqrt(u_l * u_l + max(of_light, real(0.0)))
            )
    return lobe, cosine


@inline
def constant_profile(q, C, s):
    """Profile 1, for a distribution that the caller evaluates and passes as the amplitude."""
    return real(1.0)


@kernel
def brdf_rows(normal, tensor, amplitude, of_lobe, shape, specular, diffuse, view, light, out):
    """Write the BRDF times n.l into ``out`` (n, 3); see ``brdf``.

    ``amplitude`` is K(shape) of the lobe, or D(h) itself unless ``of_lobe``.
    """
    for i in range(out.shape[0]):
        xx, yy, xy = float(tensor[i, 0]), float(tensor[i, 1]), float(tensor[i, 2])
        # Rounding of the stored entries can make a very anisotropic tensor indefinite.
        determinant = max(xx * yy - xy * xy, max(1e-12 * xx * yy, 1e-30))
        v_x, v_y, v_z = view[i, 0], view[i, 1], view[i, 2]
        l_x, l_y, l_z = light[i, 0], light[i, 1], light[i, 2]
        x, y, z = normal[i, 0], normal[i, 1], normal[i, 2]
        h_x, h_y, h_z = l_x + v_x, l_y + v_y, l_z + v_z
        length = np.sqrt(h_x * h_x + h_y * h_y + h_z * h_z)
        out[i, 0], out[i, 1], out[i, 2] = real(0.0), real(0.0), real(0.0)
        if length < real(1e-4):
            continue
        per = real(1.0) / length
        peak = amplitude[i]
        if of_lobe:
            peak = real(peak / (math.pi * math.sqrt(determinant)))
        lobe, cosine = reflect(
            x, y, z, real(yy / determinant), real(xx / determinant), real(-xy / determinant), real(xx), real(yy),
            real(xy), peak, shape[i], h_x * per, h_y * per, h_z * per, l_x, l_y, l_z, v_x, v_y, v_z,
        )  # fmt: skip
        strongest = max(specular[i, 0], max(specular[i, 1], specular[i, 2]))
        rim = min(strongest * real(1.0 / LEAST_REFLECTANCE), real(1.0))
        grazing = fifth_power(real(0.5) * length) * rim
        matt = cosine * real(1.0 / math.pi)
        matt *= (real(1.0) - fifth_power(l_x * x + l_y * y + l_z * z) * rim) * (
            real(1.0) - fifth_power(v_x * x + v_y * y + v_z * z) * rim
        )
        for k in range(3):
            s = specular[i, k]
            out[i, k] = lobe * (s * (real(1.0) - grazing) + grazing) + matt * diffuse[i, k] * max(
                real(1.0) - s, real(0.0)
            )


@kernel
def draw_rows(normal, tensor, share, view, u, out):
    """Write one direction for each lobe into ``out`` (n, 3); see ``draw``."""
    for i in range(out.shape[0]):
        x, y, z = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        angle = 2.0 * math.pi * u[i, 1]
        first = u[i, 0]
        of_lobe = first < share[i]
        if of_lobe:
            first = min(first / share[i], 1.0 - 1e-9)
            r = math.sqrt(first / (1.0 - first))
            xx, yy, xy = float(tensor[i, 0]), float(tensor[i, 1]), float(tensor[i, 2])
            l_11 = math.sqrt(xx)
            root = math.sqrt(max(xx * yy - xy * xy, max(1e-12 * xx * yy, 1e-30)))
            a, b = r * math.cos(angle), r * math.sin(angle)
            s, t = l_11 * a, xy / l_11 * a + root / l_11 * b
            c = 1.0 / math.sqrt(1.0 + s * s + t * t)
            s, t = s * c, t * c
        else:
            first = min((first - share[i]) / max(1.0 - share[i], 1e-9), 1.0)
            r = math.sqrt(first)
            s, t, c = r * math.cos(angle), r * math.sin(angle), math.sqrt(max(1.0 - first, 0.0))
        per = 1.0 / max(1.0 + z, 1e-6)
        k = (s * x + t * y) * per
        w_x, w_y, w_z = s - k * x + c * x, t - k * y + c * y, c * z - s * x - t * y
        if of_lobe:
            twice = 2.0 * (w_x * view[i, 0] + w_y * view[i, 1] + w_z * view[i, 2])
            w_x, w_y, w_z = twice * w_x - view[i, 0], twice * w_y - view[i, 1], twice * w_z - view[i, 2]
        out[i, 0], out[i, 1], out[i, 2] = w_x, w_y, w_z


@kernel
def density_rows(normal, tensor, share, view, light, out):
    """Write the density of ``draw`` into ``out`` (n,); see ``drawn_density``."""
    for i in range(out.shape[0]):
        x, y, z = float(normal[i, 0]), float(normal[i, 1]), float(normal[i, 2])
        h_x, h_y, h_z = light[i, 0] + view[i, 0], light[i, 1] + view[i, 1], light[i, 2] + view[i, 2]
        length = math.sqrt(h_x * h_x + h_y * h_y + h_z * h_z)
        cosine = light[i, 0] * x + light[i, 1] * y + light[i, 2] * z
        found = (1.0 - share[i]) * max(cosine, 0.0) / math.pi
        if length > 1e-6:
            h_x, h_y, h_z = h_x / length, h_y / length, h_z / length
            xx, yy, xy = float(tensor[i, 0]), float(tensor[i, 1]), float(tensor[i, 2])
            determinant = max(xx * yy - xy * xy, max(1e-12 * xx * yy, 1e-30))
            along = h_x * x + h_y * y
            k = along / max(1.0 + z, 1e-6) + h_z
            a, b, c = h_x - k * x, h_y - k * y, along + h_z * z
            q = (yy * a * a - 2.0 * xy * a * b + xx * b * b) / determinant + c * c
            # v.h is |l + v| / 2.
            found += share[i] * max(c, 0.0) / (math.pi * math.sqrt(determinant) * q * q * 2.0 * length)
        out[i] = found


def brdf(
    normal: NDArray,
    tensor: NDArray,
    specular: NDArray,
    diffuse: NDArray,
    view: NDArray,
    light: NDArray,
    *,
    model: str = "ggx",
    shape: NDArray | None = None,
    density: NDArray | None = None,
) -> NDArray:
    """The BRDF times n.l, (n, 3) float32: radiance to the viewer under a light of irradiance 1 on a facing surface.

    Args:
        model: the lobe D(h).
        shape: (n,) further parameter of the lobe, or None.
        density: (n,) values of D(h) per steradian, for a distribution of normals that is not one of these models;
            ``tensor`` is then used only by the masking term, and ``model`` and ``shape`` are ignored.
    """
    count = len(light)
    of_lobe = density is None
    if density is None:
        chosen = get_model(model)
        shape = np.full(count, chosen.default_shape, np.float32) if shape is None else shape
        density = _normalisation(chosen, shape)
    else:
        shape = np.zeros(count, np.float32)
    out = np.empty((count, 3), np.float32)
    _brdf_rows(model if of_lobe else None)(
        _rows(normal, 3), _rows(tensor, 3), np.ascontiguousarray(density, np.float32), of_lobe,
        np.ascontiguousarray(shape, np.float32), _rows(specular, 3), _rows(diffuse, 3), _rows(view, 3),
        _rows(light, 3), out,
    )  # fmt: skip
    return out


def draw(normal: NDArray, tensor: NDArray, share: NDArray, view: NDArray, u: NDArray) -> NDArray:
    """A direction (n, 3) float64 for each row, with the density of ``drawn_density``.

    With probability ``share`` (n,) it is the view mirrored at a half vector drawn from the GGX lobe (which has the
    longest tails of all lobes here), otherwise cosine-distributed about the normal. ``u`` (n, 2) is uniform in [0, 1).
    Some directions lie below the horizon, where the BRDF is 0.
    """
    out = np.empty((len(u), 3))
    draw_rows(_rows(normal, 3), _rows(tensor, 3), _double(share), _double(view), _double(u), out)
    return out


def drawn_density(normal: NDArray, tensor: NDArray, share: NDArray, view: NDArray, light: NDArray) -> NDArray:
    """Density (n,) float64 per steradian with which ``draw`` returns ``light``.

    share D(h) (n.h) / (4 v.h) + (1 - share) (n.l) / pi, D of GGX.
    """
    out = np.empty(len(light))
    density_rows(_rows(normal, 3), _rows(tensor, 3), _double(share), _double(view), _double(light), out)
    return out


def share_of_lobe(specular: NDArray, diffuse: NDArray) -> NDArray:
    """The share (n,) of directions that ``draw`` should take from the lobe: its share of the albedo, in [0.1, 0.9]."""
    lobe, matt = specular.mean(axis=1, dtype=np.float64), diffuse.mean(axis=1, dtype=np.float64)
    return np.clip(lobe / np.maximum(lobe + matt, 1e-9), 0.1, 0.9)


def _normalisation(model: Any, shape: NDArray) -> NDArray:
    """K(shape) (n,)."""
    if model.shape_bounds is None or (len(shape) and (shape == shape[0]).all()):
        return np.full(len(shape), np.exp(model.log_normalisation(float(shape[0]) if len(shape) else 0.0)[0]))
    return np.exp([model.log_normalisation(float(each))[0] for each in shape])


@cache
def _brdf_rows(model: str | None) -> Any:
    """``brdf_rows`` of a model, or with None of a density that the caller evaluates."""
    name = "density" if model is None else model
    bound = constant_profile if model is None else get_model(model).profile
    return specialise(brdf_rows, "_" + name.replace("-", "_"), profile=bound)


def _rows(array: NDArray, width: int) -> NDArray:
    return np.ascontiguousarray(array, np.float32).reshape(-1, width)


def _double(array: NDArray) -> NDArray:
    return np.ascontiguousarray(array, np.float64)
