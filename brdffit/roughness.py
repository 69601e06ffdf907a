"""The one place where names of roughness are converted.

Inside the program there is one roughness: the tensor ``Sigma``, 2x2 symmetric positive definite, in
units of alpha^2, in the tangent plane of the normal; it is stored as its matrix logarithm
``[[a, c], [c, b]]`` in the order (a, b, c).  Files and engines use other parameters:

- perceptual roughness ``r`` in [0, 1]: alpha = r^2 (glTF, Unreal, Filament, Godot, Unity's 1 - smoothness)
- gloss ``g`` = 1 - r
- the level of a reflection probe: ``probes.curves``, a curve for each engine
- Blinn-Phong exponent ``p``: alpha^2 = 2 / (p + 2)
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

#: Perceptual roughness below which a lobe is not trusted in single precision (Filament's desktop limit).
DEFAULT_MIN_ROUGHNESS = 0.045


def alpha_squared_from_perceptual(roughness: NDArray) -> NDArray:
    """alpha^2 = r^4 for perceptual roughness r."""
    return np.square(np.square(roughness))


def perceptual_from_alpha_squared(alpha_squared: NDArray) -> NDArray:
    """r = (alpha^2)^(1/4)."""
    return np.sqrt(np.sqrt(alpha_squared))


def alpha_from_perceptual(roughness: NDArray) -> NDArray:
    """alpha = r^2."""
    return np.square(roughness)


def perceptual_from_alpha(alpha: NDArray) -> NDArray:
    """r = sqrt(alpha)."""
    return np.sqrt(alpha)


def exponent_from_alpha_squared(alpha_squared: NDArray) -> NDArray:
    """p = 2 / alpha^2 - 2."""
    return 2.0 / alpha_squared - 2.0


def log_tensor_from_perceptual(roughness: NDArray) -> NDArray:
    """Isotropic log tensor (..., 3) as (a, b, c) of perceptual roughness (...); r must be positive."""
    a = 4.0 * np.log(roughness)
    return np.stack([a, a, np.zeros_like(a)], axis=-1)


def perceptual_from_log_tensor(log_tensor: NDArray) -> NDArray:
    """Perceptual roughness (...) of the isotropic lobe with the same det Sigma as log_tensor (..., 3)."""
    return np.exp((log_tensor[..., 0] + log_tensor[..., 1]) / 8.0)


def tensor_from_log(log_tensor: NDArray) -> NDArray:
    """Sigma as (XX, YY, XY) of its matrix logarithm (a, b, c); shapes (..., 3).

    With t = (a+b)/2, d = (a-b)/2, r = sqrt(d^2 + c^2) the eigenvalues are e^(t+r) and e^(t-r), and the squared sine
    of the major axis from the nearer of x and y is c^2 / (2 r (r + |d|)). Nothing cancels, so the minor axis survives
    in single precision where cosh r - sinh r would lose it.
    """
    t, d, c, r = _split(log_tensor)
    major, minor = np.exp(t + r), np.exp(t - r)
    safe = np.where(r > 0, r, 1)
    far = np.square(c / safe) / (2 * (1 + np.abs(d) / safe))
    along, across = major * (1 - far) + minor * far, major * far + minor * (1 - far)
    # (e^(t+r) - e^(t-r)) / (2 r) = e^(t-r) expm1(2 r) / (2 r)
    off = c * (minor * np.expm1(2 * r) / (2 * safe))
    out = np.stack([np.where(d >= 0, along, across), np.where(d >= 0, across, along), off], axis=-1)
    return out.astype(log_tensor.dtype, copy=False)


def log_from_tensor(tensor: NDArray) -> NDArray:
    """Matrix logarithm (a, b, c) of Sigma given as (XX, YY, XY); shapes (..., 3); Sigma must be positive definite.

    With eigenvalues e^(t +- r): log Sigma = t I + (r / s) [[d', c'], [c', -d']] where d' = (XX-YY)/2, c' = XY and
    s = sqrt(d'^2 + c'^2); r / s has the limit 1 / mean eigenvalue where Sigma is isotropic.
    """
    mean, half, c, s = _split(np.asarray(tensor, dtype=np.float64))
    det = np.maximum(tensor[..., 0] * tensor[..., 1] - np.square(tensor[..., 2]), np.finfo(np.float64).tiny)
    t = 0.5 * np.log(det)
    ratio = s / mean
    with np.errstate(divide="ignore", invalid="ignore"):
        exact = np.arctanh(np.minimum(ratio, 1.0 - 1e-16)) / np.where(s > 0, s, 1.0)
        quotient = np.where(ratio > 1e-6, exact, 1.0 / mean)
    return np.stack([t + quotient * half, t - quotient * half, quotient * c], axis=-1).astype(tensor.dtype, copy=False)


def eigenvalues_of_log(log_tensor: NDArray) -> tuple[NDArray, NDArray]:
    """Eigenvalues (major, minor) of Sigma, both (...), of its logarithm (..., 3): alpha^2 along the two axes."""
    t, _, _, r = _split(log_tensor)
    return np.exp(t + r), np.exp(t - r)


def clipped_log(log_tensor: NDArray, min_roughness: float) -> NDArray:
    """Log tensors (..., 3) with the eigenvalues of Sigma clipped to [``min_roughness``^4, 1]; the axes stay."""
    low = 4.0 * math.log(min_roughness)
    mean, half, off, radius = _split(log_tensor)
    major, minor = np.clip(mean + radius, low, 0.0), np.clip(mean - radius, low, 0.0)
    mean, shrink = 0.5 * (major + minor), 0.5 * (major - minor) / np.where(radius > 0.0, radius, 1.0)
    return np.stack([mean + shrink * half, mean - shrink * half, shrink * off], axis=-1)


def _split(abc: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Mean, half difference, off-diagonal and radius of symmetric 2x2 matrices given as (xx, yy, xy)."""
    mean = 0.5 * (abc[..., 0] + abc[..., 1])
    half = 0.5 * (abc[..., 0] - abc[..., 1])
    return mean, half, abc[..., 2], np.hypot(half, abc[..., 2])
