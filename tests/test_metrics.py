"""Metrics reproduce what is computed by hand, and hold still where nothing differs."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from brdffit.render import metrics

#: Two lit pixels and a black one, red, green and blue alike.
REFERENCE = np.array([[3.0], [4.0], [0.0]], np.float32).repeat(3, axis=1).reshape(1, 3, 3)
PICTURE = np.array([[3.0], [3.0], [2.0]], np.float32).repeat(3, axis=1).reshape(1, 3, 3)


def noise(seed, shape=(24, 24, 3), scale=1.0):
    return (scale * np.random.default_rng(seed).random(shape)).astype(np.float32)


def test_snr_by_hand():
    # Error 0 + 1 + 4, power 9 + 16 + 0.
    assert metrics.snr_db(PICTURE, REFERENCE) == pytest.approx(-10 * math.log10(5 / 25))
    assert metrics.snr_db(REFERENCE, REFERENCE) == math.inf
    # A black prediction errs by all there is: 0 dB; twice the truth too.
    assert metrics.snr_db(0 * REFERENCE, REFERENCE) == pytest.approx(0.0)
    assert metrics.snr_db(2 * REFERENCE, REFERENCE) == pytest.approx(0.0)
    assert metrics.snr_db(REFERENCE, 0 * REFERENCE) == -math.inf


def test_relative_l2_is_equation_5_and_divides_by_the_prediction():
    assert metrics.relative_l2(PICTURE, REFERENCE, epsilon=0.0) == pytest.approx(5 / 22)
    # P = s R gives (1 - 1/s)^2: half as bright costs 1, twice as bright a quarter.
    assert metrics.relative_l2(2 * REFERENCE, REFERENCE, epsilon=0.0) == pytest.approx(0.25)
    assert metrics.relative_l2(0.5 * REFERENCE, REFERENCE, epsilon=0.0) == pytest.approx(1.0)
    # Black: mean R^2 over epsilon, 75 / 9 for the nine numbers.
    assert metrics.relative_l2(0 * REFERENCE, REFERENCE, epsilon=0.1) == pytest.approx(75 / 9 / 0.1)


def test_snr_of_errors_is_the_quotient_of_sums():
    errors, power = np.array([[0.1, 4.0, 0.4], [0.0, 0.0, 0.0], [-0.1, 0.05, 0.0]]), np.array([1.0, 10.0, 4.0])
    found = metrics.snr_of_errors(errors, power)
    assert found[0] == pytest.approx(-10 * math.log10(4.5 / 15.0))
    # No error, and an estimate of it that noise took below zero.
    assert found[1] == found[2] == math.inf


def test_halves_of_a_noisy_reference_leave_its_noise_out():
    """By hand: (P - A)(P - B) over A B. And on average: the truth itself has no error, whatever the noise."""
    halves = np.array([2.0, 4.0]).reshape(2, 1, 1, 1)
    assert metrics.snr_db_of_halves(np.full((1, 1, 1), 5.0), halves) == pytest.approx(-10 * math.log10(3 * 1 / 8))
    assert metrics.relative_l2(np.full((1, 1, 1), 5.0), halves[0], 0.0, halves) == pytest.approx(3 / 25)
    # Less than no error: between the halves.
    assert metrics.snr_db_of_halves(np.full((1, 1, 1), 3.0), halves) == math.inf
    assert metrics.relative_l2(np.full((1, 1, 1), 3.0), halves[0], 0.0, halves) == 0.0

    truth = noise(4, (64, 64, 3)) + 0.5
    noisy = truth + 0.2 * np.random.default_rng(5).standard_normal((2, *truth.shape))
    picture = 1.1 * truth
    biased, unbiased = metrics.snr_db(picture, noisy.mean(axis=0)), metrics.snr_db_of_halves(picture, noisy)
    assert unbiased == pytest.approx(20.0, abs=0.3)
    assert biased < 18.0
    with pytest.raises(ValueError, match="halves"):
        metrics.snr_db_of_halves(picture, truth)


def test_energy_by_hand():
    assert metrics.energy_kept(PICTURE, REFERENCE) == pytest.approx(8 / 7)
    assert metrics.energy_kept(0 * PICTURE, 0 * REFERENCE) == 1.0
    assert metrics.energy_kept(PICTURE, 0 * REFERENCE) == math.inf


def test_shapes_must_agree():
    with pytest.raises(ValueError, match=r"\(1, 3, 3\)"):
        metrics.snr_db(np.zeros((2, 3, 3)), REFERENCE)


def test_exposure_brings_the_mean_to_the_key():
    grey = np.full((4, 4, 3), 5.0, np.float32)
    assert metrics.exposure_of(grey) == pytest.approx(metrics.KEY / 5.0)
    assert metrics.exposure_of(0 * grey) == 1.0


def test_tone_curve_by_hand():
    # Reinhard with white at 6: 1 -> (1 + 1/36) / 2, and 6 -> (6 + 1) / 7 = 1.
    display = metrics.tone_map(np.array([0.0, 1.0, 6.0, 50.0]), 1.0)
    assert display[0] == 0.0
    assert display[1] == pytest.approx(1.055 * ((1 + 1 / 36) / 2) ** (1 / 2.4) - 0.055, abs=1e-6)
    assert display[2] == pytest.approx(1.0, abs=1e-6)
    assert display[3] == pytest.approx(1.0, abs=1e-6)
    ramp = metrics.tone_map(np.linspace(0, 6, 500), 1.0)
    assert (np.diff(ramp) > 0).all()


def test_stability_by_hand():
    frames = np.array([0.0, 1.0, 0.0, 1.0])[:, None, None]
    slow = np.array([0.0, 0.25, 0.5, 0.75])[:, None, None]
    assert metrics.change_per_frame(frames) == pytest.approx(1.0)
    assert metrics.relative_change(frames, slow) == pytest.approx(4.0)
    assert metrics.relative_change(slow, slow) == 1.0
    still = np.ones((3, 2, 2))
    assert metrics.relative_change(still, still) == 1.0
    assert metrics.relative_change(frames, 0 * frames) == math.inf
    assert metrics.change_per_frame(frames[:1]) == 0.0


def test_perceptual_figures_know_the_same_picture_and_order_worse_ones():
    reference = noise(1, scale=2.0)
    slight, strong = reference * 1.05, np.roll(reference, 3, axis=0)
    same, a, b = (metrics.compare_pictures(p, reference) for p in (reference, slight, strong))
    assert (same.flip_hdr, same.flip_ldr, same.ssim) == pytest.approx((0.0, 0.0, 1.0), abs=1e-6)
    assert same.snr_db == math.inf and same.energy_kept == 1.0
    for name in ("flip_hdr", "flip_ldr"):
        assert 0.0 < getattr(a, name) < getattr(b, name) <= 1.0
    assert 1.0 > a.ssim > b.ssim


def test_flip_of_black_and_white():
    """FLIP of white against black is 1 by its own definition, but for rounding of its colour transform."""
    black = np.zeros((16, 16, 3), np.float32)
    assert metrics.flip_ldr(black + 1, black) == pytest.approx(1.0, abs=0.05)
    assert metrics.flip_hdr(black, black) == 0.0
    assert metrics.flip_hdr(black + 1, black) == 1.0


def test_ssim_of_flat_pictures_is_its_luminance_term():
    """With no variance SSIM is (2 a b + c) / (a^2 + b^2 + c), c = 0.01^2."""
    a, b = 0.3, 0.5
    found = metrics.ssim(np.full((16, 16, 3), a, np.float32), np.full((16, 16, 3), b, np.float32))
    assert found == pytest.approx((2 * a * b + 1e-4) / (a * a + b * b + 1e-4), abs=1e-4)


def test_pictures_below_the_window():
    tiny = noise(3, (4, 4, 3))
    assert metrics.ssim(tiny, tiny) == 1.0
    assert metrics.ssim(tiny, tiny + 0.1) == 0.0


@given(st.floats(0.01, 100.0), st.integers(0, 5))
@settings(max_examples=20, deadline=None)
def test_figures_do_not_depend_on_the_unit_of_light(unit, seed):
    """All but HDR-FLIP, whose exposures are whole numbers of its own, and eq. 5 near its epsilon."""
    reference, picture = noise(seed, (12, 12, 3)) + 0.1, noise(seed + 9, (12, 12, 3)) + 0.1
    one, other = (metrics.compare_pictures(u * picture, u * reference) for u in (1.0, np.float32(unit)))
    assert other.snr_db == pytest.approx(one.snr_db, abs=1e-4)
    assert other.energy_kept == pytest.approx(one.energy_kept, rel=1e-5)
    assert other.ssim == pytest.approx(one.ssim, abs=1e-4)
    assert other.flip_ldr == pytest.approx(one.flip_ldr, abs=1e-4)
