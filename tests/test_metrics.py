"""Metrics against closed forms, plain loops and scikit-image."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shadowgram import metrics

# Mean over the bands of skimage.metrics.structural_similarity(truth[k], estimate[k], data_range=peak,
# gaussian_weights=True, sigma=1.5, use_sample_covariance=False), scikit-image 0.26.0, of `analytic_pair(shape)`.
SKIMAGE_SSIM = [
    ((3, 23, 31), 1.0, 0.9394448471468967),
    ((3, 23, 31), 2.5, 0.9436658265650998),
    ((1, 11, 11), 1.0, 0.9328076837422213),
    ((2, 64, 12), 1.0, 0.9466168799277781),
]


def analytic_pair(shape):
    band, y, x = np.meshgrid(*(np.arange(n, dtype=float) for n in shape), indexing="ij")
    truth = 0.5 + 0.3 * np.sin(0.7 * x + 0.2 * y * (band + 1)) + 0.2 * np.cos(0.05 * x * y)
    return truth + 0.1 * np.sin(1.3 * x - 2.1 * y + band) + 0.02 * band, truth


@pytest.mark.parametrize(("shape", "peak", "golden"), SKIMAGE_SSIM)
def test_ssim_equals_scikit_image(shape, peak, golden):
    x, truth = analytic_pair(shape)
    assert metrics.ssim(x, truth, peak=peak) == pytest.approx(golden, abs=1e-9)


def test_ssim_of_an_image_is_that_of_one_band():
    x, truth = analytic_pair((1, 20, 17))
    assert metrics.ssim(x[0], truth[0], peak=1.0) == metrics.ssim(x, truth, peak=1.0)


def test_ssim_of_two_constants():
    # No contrast on either side: only the luminance term is left.
    a, b, c1 = 0.2, 0.6, 0.01**2
    got = metrics.ssim(np.full((2, 12, 13), a), np.full((2, 12, 13), b), peak=1.0)
    assert got == pytest.approx((2 * a * b + c1) / (a**2 + b**2 + c1), rel=1e-12)


def test_ssim_is_one_only_for_equal_images():
    truth = np.random.default_rng(0).random((2, 15, 16))
    assert metrics.ssim(truth, truth, peak=1.0) == pytest.approx(1.0, abs=1e-15)
    assert metrics.ssim(1 - truth, truth, peak=1.0) < 0  # the negative of an image


def test_psnr_closed_forms():
    truth = np.zeros((4, 5, 6), np.float32)
    assert metrics.psnr(truth + 0.01, truth, peak=1.0) == pytest.approx(40.0, abs=1e-4)  # float32 input
    assert metrics.psnr(truth[0] + 255, truth[0], peak=255) == pytest.approx(0.0)
    assert metrics.psnr(truth, truth, peak=1.0) == math.inf


def test_psnr_of_8_bit_images_does_not_wrap():
    a, b = np.zeros((4, 4), np.uint8), np.full((4, 4), 255, np.uint8)
    assert metrics.psnr(a, b, peak=255) == pytest.approx(0.0)


@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(1, 5), st.integers(1, 5))
def test_rms_and_sam_equal_plain_loops(seed, bands, ny, nx):
    rng = np.random.default_rng(seed)
    x, truth = rng.random((bands, ny, nx)), rng.random((bands, ny, nx)) + 0.01
    errors, angles = [], []
    for i in range(ny):
        for j in range(nx):
            u, v = x[:, i, j], truth[:, i, j]
            errors.append(math.sqrt(sum((u - v) ** 2) / bands))
            angles.append(math.acos(min(1.0, u @ v / math.sqrt((u @ u) * (v @ v)))))
    assert metrics.rms(x, truth) == pytest.approx(np.mean(errors), rel=1e-12)
    assert metrics.sam(x, truth) == pytest.approx(np.mean(angles), abs=1e-7)  # the arc cosine is good to √ε
    assert metrics.rms(x, truth) <= math.sqrt(np.mean((x - truth) ** 2)) * (1 + 1e-12)


def test_rms_of_one_bad_pixel():
    truth = np.zeros((3, 4, 5))
    x = truth.copy()
    x[:, 1, 2] = 0.5
    assert metrics.rms(x, truth) == pytest.approx(0.5 / 20)


def test_sam_is_blind_to_brightness_and_exact_for_small_angles():
    rng = np.random.default_rng(1)
    truth = rng.random((6, 4, 5)) + 0.1
    assert metrics.sam(truth * rng.uniform(0.1, 9, (4, 5)), truth) < 1e-15
    x = np.array([1.0, 1e-9]).reshape(2, 1, 1)
    assert metrics.sam(x, np.array([2.0, 0.0]).reshape(2, 1, 1)) == pytest.approx(1e-9, rel=1e-6)
    assert metrics.sam(-truth, truth) == pytest.approx(np.pi)


@pytest.mark.parametrize("scale", [1e-200, 1.0, 1e200])
def test_sam_of_any_magnitude(scale):
    x = scale * np.array([1.0, 0.0, 0.0]).reshape(3, 1, 1)
    truth = scale * np.array([1.0, 1.0, 0.0]).reshape(3, 1, 1)
    assert metrics.sam(x, truth) == pytest.approx(np.pi / 4)


def test_sam_of_zero_spectra():
    truth = np.zeros((3, 1, 2))
    x = truth.copy()
    x[:, 0, 0] = 1.0
    assert metrics.sam(truth, truth) == 0.0
    assert metrics.sam(x, truth) == pytest.approx(np.pi / 4)  # one pixel at π/2, one at 0


METRICS = [
    lambda x, t: metrics.psnr(x, t, peak=1.0),
    lambda x, t: metrics.ssim(x, t, peak=1.0),
    metrics.rms,
    metrics.sam,
]


@pytest.mark.parametrize("metric", METRICS)
def test_bad_input_is_refused(metric):
    cube = np.ones((3, 12, 13))
    with pytest.raises(ValueError, match=r"arrays of one shape, got \(3, 12, 13\) for the estimate and \(3, 12, 14\)"):
        metric(cube, np.ones((3, 12, 14)))
    holed = cube.copy()
    holed[1, 2, 3] = np.nan
    with pytest.raises(ValueError, match="the truth holds NaN"):
        metric(cube, holed)
    with pytest.raises(ValueError, match="the estimate holds NaN"):
        metric(holed, cube)
    with pytest.raises(TypeError, match="real numbers, got an estimate of complex128"):
        metric(cube.astype(complex), cube)
    with pytest.raises(ValueError, match=r"takes non-empty arrays \(band, y, x\)"):
        metric(cube[None], cube[None])
    with pytest.raises(ValueError, match=r"takes non-empty arrays \(band, y, x\)"):
        metric(cube[:0], cube[:0])


@pytest.mark.parametrize("metric", [metrics.rms, metrics.sam])
def test_spectral_metrics_need_bands(metric):
    with pytest.raises(ValueError, match=r"takes non-empty arrays \(band, y, x\), got shape \(12, 13\)"):
        metric(np.ones((12, 13)), np.ones((12, 13)))


def test_ssim_needs_room_for_its_window():
    with pytest.raises(ValueError, match="at least 11 × 11 pixels, got 12 × 10"):
        metrics.ssim(np.ones((3, 12, 10)), np.ones((3, 12, 10)), peak=1.0)


@pytest.mark.parametrize("peak", [0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("metric", [metrics.psnr, metrics.ssim])
def test_peak_must_be_positive(metric, peak):
    with pytest.raises(ValueError, match="peak is the largest value"):
        metric(np.ones((12, 12)), np.ones((12, 12)), peak=peak)
