"""How far a picture is from its reference; every figure is a plain number, with its formula in its docstring.

Pictures are (h, w, 3) linear radiance unless it says "displayed", which is what a screen shows, in [0, 1]. Libraries
that take long to load (FLIP, scikit-image) are imported where they are used.
"""

from __future__ import annotations

import math
import os
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from brdffit.colour import LUMINANCE, encode_srgb

#: Guards the quotient of `relative_l2` for black pictures: a mean squared radiance far below any lit one.
EPSILON = 1e-6
#: Mean luminance of a displayed reference, before the curve; highlights then stay below white.
KEY = 0.22
#: Exposures that HDR-FLIP compares, within the range that it finds itself; one a stop would cost many times as much.
_EXPOSURES = 3
#: Luminance, in units of the exposed scene, that the curve takes to white.
WHITE = 6.0


class PictureFigures(NamedTuple):
    """Figures of one picture: SNR in dB, relative squared error, FLIP in [0, 1] (0: the same), SSIM, energy kept."""

    snr_db: float
    relative_l2: float
    flip_hdr: float
    flip_ldr: float
    ssim: float
    energy_kept: float


def snr_db(picture: NDArray, reference: NDArray) -> float:
    """-10 log10( sum (P - R)^2 / sum R^2 ) in dB over all pixels and channels; infinite where they are equal.

    A black reference under a picture that is not black gives -infinity.
    """
    error, power = _squares(picture, reference)
    if error == 0.0:
        return math.inf
    return -10.0 * math.log10(error / power) if power > 0.0 else -math.inf


def snr_db_of_halves(picture: NDArray, halves: NDArray) -> float:
    """`snr_db` against a reference that is itself sampled: two independent halves A and B (2, h, w, 3) of it.

    The picture may be sampled too: two halves P and Q (2, h, w, 3), independent of each other and of the reference.
    Then sum (P - A)(Q - B) is the squared error and sum A B the power without the noise of either, on average (as in
    Kemppinen's Noise2Noise loss, which bears noisy references); infinite where no error is left, or less than none.
    """
    error, power = _squares_of_halves(picture, halves)
    if error <= 0.0:
        return math.inf
    return -10.0 * math.log10(error / power) if power > 0.0 else -math.inf


def snr_of_errors(errors: NDArray, power: NDArray) -> NDArray:
    """-10 log10( sum of squared errors / sum of squared reference ) in dB over texels: (M, n) and (n,) give (M,).

    Both may be estimates whose own noise averages out, so that no error left, or less than none, is infinite. The
    quotient is of sums: a few pairs of light and viewer meet the peak of one texel's sharp lobe and miss another's, and
    a mean of quotients would be that of the texels that were missed.
    """
    total = np.asarray(errors, np.float64).sum(axis=1) / max(float(np.sum(power, dtype=np.float64)), 1e-300)
    return np.where(total > 0.0, -10.0 * np.log10(np.maximum(total, 1e-300)), np.inf)


def relative_l2(picture: NDArray, reference: NDArray, epsilon: float = EPSILON, halves: NDArray | None = None) -> float:
    """Kemppinen et al. 2023, equation 5: mean (P - R)^2 / (mean P^2 + epsilon).

    The paper divides by the prediction P, held constant in the gradient, because its reference is noisy: the gradient
    is then linear in R, and the noise of R averages out of it (a noisy R in the denominator would bias it). As a figure
    it does not treat both sides alike: P = s R gives (1 - 1/s)^2, so that too bright costs less than too dark; `snr_db`
    divides by the reference and gives (s - 1)^2. With ``halves`` of the reference its noise is left out of the error.
    """
    count = max(1, np.size(reference))
    error, _ = _squares(picture, reference) if halves is None else _squares_of_halves(picture, halves)
    whole = picture if np.ndim(picture) == np.ndim(reference) else np.mean(picture, axis=0)
    power = float(np.square(whole, dtype=np.float64).sum())
    return max(error, 0.0) / count / (power / count + epsilon)


def energy_kept(picture: NDArray, reference: NDArray) -> float:
    """Sum of the picture's radiance over the reference's; 1 where both are black."""
    total = float(np.sum(reference, dtype=np.float64))
    own = float(np.sum(picture, dtype=np.float64))
    if total == 0.0:
        return 1.0 if own == 0.0 else math.inf
    return own / total


def exposure_of(reference: NDArray) -> float:
    """Factor that brings the mean luminance of a reference to `KEY`; 1 for a black one."""
    mean = float(np.mean(np.asarray(reference, np.float64) @ LUMINANCE))
    return KEY / mean if mean > 0.0 else 1.0


def tone_map(radiance: NDArray, exposure: float) -> NDArray:
    """Displayed values in [0, 1] (float32): exposure, Reinhard's curve with white at `WHITE` (2002, eq. 4), sRGB."""
    x = np.maximum(np.asarray(radiance, np.float32) * np.float32(exposure), 0.0)
    mapped = np.clip(x * (1.0 + x / WHITE**2) / (1.0 + x), 0.0, 1.0)
    return encode_srgb(mapped).astype(np.float32)


def flip_ldr(displayed: NDArray, displayed_reference: NDArray) -> float:
    """Mean FLIP (Andersson et al. 2020) of displayed pictures at its default 67 pixels a degree; 0 same, 1 at most."""
    return _flip(displayed, displayed_reference, "LDR")


def flip_hdr(picture: NDArray, reference: NDArray) -> float:
    """Mean HDR-FLIP (Andersson et al. 2021) of linear pictures: each pixel's worst of three exposures, taken from R."""
    if not np.any(reference):
        return 0.0 if not np.any(picture) else 1.0
    return _flip(np.maximum(picture, 0.0), np.maximum(reference, 0.0), "HDR")


def ssim(displayed: NDArray, displayed_reference: NDArray) -> float:
    """Structural similarity (Wang et al. 2004: Gaussian window, sigma 1.5) of displayed pictures; 1: the same.

    Pictures smaller than the window give 1 where equal, else 0.
    """
    from skimage.metrics import structural_similarity

    if min(displayed.shape[:2]) < 11:
        return float(np.array_equal(displayed, displayed_reference))
    return float(
        structural_similarity(
            displayed, displayed_reference, channel_axis=-1, data_range=1.0, gaussian_weights=True, sigma=1.5,
            use_sample_covariance=False,
        )
    )  # fmt: skip


def compare_pictures(
    picture: NDArray, reference: NDArray, exposure: float | None = None, halves: NDArray | None = None
) -> PictureFigures:
    """All figures of one picture.

    Args:
        picture: (h, w, 3) linear; with ``halves`` also (2, h, w, 3), two independent estimates that it is the mean of.
        reference: (h, w, 3) linear.
        exposure: of the displayed pictures, by default that of the reference.
        halves: (2, h, w, 3), independent estimates that the reference is the mean of: its noise, and that of a picture
            that is given by halves, is then left out of the squared errors. (FLIP and SSIM still see it.)
    """
    exposure = exposure_of(reference) if exposure is None else exposure
    whole = picture if picture.ndim == reference.ndim else picture.mean(axis=0)
    shown, shown_reference = tone_map(whole, exposure), tone_map(reference, exposure)
    return PictureFigures(
        snr_db=snr_db(whole, reference) if halves is None else snr_db_of_halves(picture, halves),
        relative_l2=relative_l2(picture, reference, halves=halves),
        flip_hdr=flip_hdr(whole, reference),
        flip_ldr=flip_ldr(shown, shown_reference),
        ssim=ssim(shown, shown_reference),
        energy_kept=energy_kept(whole, reference),
    )


def change_per_frame(frames: NDArray) -> float:
    """Mean absolute difference of one frame (first axis) from the next, over all pixels; 0 for a single frame."""
    frames = np.asarray(frames, np.float64)
    return float(np.abs(np.diff(frames, axis=0)).mean()) if len(frames) > 1 else 0.0


def relative_change(frames: NDArray, reference_frames: NDArray) -> float:
    """Change per frame over that of the reference: 1 moves as the truth does, more flickers, less is smeared.

    Where the truth stands still: 1 if the frames do too, else infinite.
    """
    own, true = change_per_frame(frames), change_per_frame(reference_frames)
    if true == 0.0:
        return 1.0 if own == 0.0 else math.inf
    return own / true


def _squares(picture: NDArray, reference: NDArray) -> tuple[float, float]:
    """Sums of (P - R)^2 and of R^2."""
    if np.shape(picture) != np.shape(reference):
        raise ValueError(f"the picture has shape {np.shape(picture)}, expected {np.shape(reference)} of its reference")
    difference = np.asarray(picture, np.float64) - np.asarray(reference, np.float64)
    return float(np.square(difference).sum()), float(np.square(reference, dtype=np.float64).sum())


def _squares_of_halves(picture: NDArray, halves: NDArray) -> tuple[float, float]:
    """Sums of (P - A)(Q - B) and of A B; P and Q are one where the picture has no halves."""
    halves, picture = np.asarray(halves, np.float64), np.asarray(picture, np.float64)
    own = picture if picture.ndim == halves.ndim else np.broadcast_to(picture, (2, *picture.shape))
    if halves.shape != own.shape or len(halves) != 2:
        raise ValueError(f"halves have shape {halves.shape}, expected {own.shape}")
    # Either half of the picture may be paired with either half of the reference: the mean of both ways is less noisy.
    one, other = own - halves, own - halves[::-1]
    error = 0.5 * float(np.sum(one[0] * one[1]) + np.sum(other[0] * other[1]))
    return error, float(np.sum(halves[0] * halves[1]))


def _flip(picture: NDArray, reference: NDArray, dynamic_range: str) -> float:
    # Its OpenMP threads would spin while they wait, which doubles the processor time of a small picture.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    import flip_evaluator

    pictures = [np.ascontiguousarray(each, np.float32) for each in (reference, picture)]
    parameters = {"numExposures": _EXPOSURES} if dynamic_range == "HDR" else {}
    return float(flip_evaluator.evaluate(*pictures, dynamic_range, applyMagma=False, parameters=parameters)[1])
