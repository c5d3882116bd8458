"""Noise statistics against their closed forms.

Statistical bounds are 5 standard errors wide: with a right implementation one such check fails for fewer than one seed
in a million (two-sided normal tail 6e-7), and the seeds are fixed.
"""

import math

import numpy as np
import pytest

from shadowgram import noise

FIVE = 5.0


@pytest.mark.parametrize("snr_db", [0, 20, 37.5])
def test_awgn_has_the_stated_ratio(snr_db):
    y = np.random.default_rng(1).random((3, 101, 99)) * 7
    added = noise.awgn(y, snr_db=snr_db, seed=2) - y
    sigma = math.sqrt(np.mean(y**2) / 10 ** (snr_db / 10))
    n = y.size
    assert abs(added.mean()) < FIVE * sigma / math.sqrt(n)
    assert abs(added.std() / sigma - 1) < FIVE / math.sqrt(2 * n)
    assert abs(np.mean(added[:, :, 1:] * added[:, :, :-1])) < FIVE * sigma**2 / math.sqrt(n)  # white along x
    assert abs(np.mean(np.abs(added) > 1.959964 * sigma) - 0.05) < FIVE * math.sqrt(0.05 * 0.95 / n)  # Gaussian tails


def test_awgn_signal_is_the_mean_square_over_all_snapshots():
    y = np.stack([np.zeros((200, 200)), np.full((200, 200), 2.0)])
    added = noise.awgn(y, snr_db=10, seed=0) - y
    sigma = math.sqrt(2.0 / 10)
    for shot in added:  # the dark snapshot is as noisy as the bright one
        assert abs(shot.std() / sigma - 1) < FIVE / math.sqrt(2 * shot.size)


def test_awgn_without_noise_and_seeds():
    y = np.random.default_rng(0).random((2, 5, 7), dtype=np.float32)
    assert np.array_equal(noise.awgn(y, snr_db=math.inf, seed=0), y)
    assert np.array_equal(noise.awgn(y, snr_db=30, seed=4), noise.awgn(y, snr_db=30, seed=4))
    assert not np.array_equal(noise.awgn(y, snr_db=30, seed=4), noise.awgn(y, snr_db=30, seed=5))


@pytest.mark.parametrize("level", [0.0, 0.002, 0.3])
def test_sensor_mean_and_variance(level):
    full_well, read_noise, bits, n = 20_000.0, 12.0, 14, 90_000
    y = np.full((1, 300, 300), level)
    shot = noise.sensor(y, seed=3, full_well=full_well, read_noise=read_noise, bits=bits, saturation=1.0)
    step = full_well / (2**bits - 1)
    variance = level * full_well + read_noise**2 + step**2 / 12  # shot, read, quantisation; electrons²
    sigma = math.sqrt(variance) / full_well
    assert abs(shot.mean() - level) < FIVE * sigma / math.sqrt(n)
    assert abs(shot.std() / sigma - 1) < FIVE / math.sqrt(2 * n)


def test_sensor_units_follow_the_input():
    y = np.random.default_rng(0).random((2, 30, 31))
    one = noise.sensor(y, seed=1, saturation=1.2)
    assert np.allclose(noise.sensor(1000 * y, seed=1, saturation=1200.0), 1000 * one, rtol=1e-12)
    # By default the brightest pixel fills the well.
    assert np.array_equal(noise.sensor(y, seed=1), noise.sensor(y, seed=1, saturation=float(y.max())))


def test_sensor_quantises():
    y = np.linspace(0, 1, 4096).reshape(1, 64, 64)
    shot = noise.sensor(y, seed=0, full_well=1e10, read_noise=0, bits=4)
    # At 1e10 electrons shot noise is far below a step of 1/15.
    assert np.allclose(np.unique(shot), np.arange(16) / 15, atol=1e-12)
    assert np.abs(shot - y).max() <= 0.5 / 15 + 1e-4


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_sensor_saturates_and_says_so(dtype):
    y = np.concatenate([np.full(300, 0.1), np.full(100, 3.7)]).astype(dtype).reshape(1, 20, 20)
    level = 1.1  # not a float32 number
    shot = noise.sensor(y, seed=0, saturation=level)
    assert shot.max() == dtype(level)
    assert noise.saturated(shot, saturation=level) == 0.25
    assert noise.saturated(y, saturation=5.0) == 0.0


def test_sensor_stands_light_far_above_the_full_well():
    y = np.array([0.0, 1.0, 1e30])
    shot = noise.sensor(y, seed=0, read_noise=0, saturation=1.0)
    assert shot[2] == 1.0
    assert shot[0] == 0.0


def test_sensor_does_not_lift_the_dark():
    dark = noise.sensor(np.zeros((1, 100, 100)), seed=0, read_noise=9.0, bits=16, saturation=1.0)
    assert abs(dark.mean()) < FIVE * 9.0 / 10_000 / 100
    assert dark.min() < 0


@pytest.mark.parametrize(
    ("dtype", "expected"), [(np.float32, np.float32), (np.float64, np.float64), (np.uint8, np.float32)]
)
@pytest.mark.parametrize("add", [lambda y: noise.awgn(y, snr_db=30, seed=0), lambda y: noise.sensor(y, seed=0)])
def test_dtype_and_shape_are_kept(add, dtype, expected):
    y = (np.ones((2, 3, 4)) * 9).astype(dtype)
    before = y.copy()
    out = add(y)
    assert out.dtype == expected
    assert out.shape == y.shape
    assert np.array_equal(y, before)


@pytest.mark.parametrize("add", [lambda y: noise.awgn(y, snr_db=30, seed=0), lambda y: noise.sensor(y, seed=0)])
def test_bad_snapshots_are_refused(add):
    with pytest.raises(ValueError, match="hold NaN or infinity"):
        add(np.array([1.0, np.nan]))
    with pytest.raises(TypeError, match="real numbers, got an array of complex128"):
        add(np.ones(3, complex))


def test_zero_snapshots_are_refused():
    with pytest.raises(ValueError, match="zero everywhere"):
        noise.awgn(np.zeros((1, 3, 3)), snr_db=30, seed=0)
    with pytest.raises(ValueError, match="say it if y is zero everywhere"):
        noise.sensor(np.zeros((1, 3, 3)), seed=0)


def test_negative_light_is_refused():
    with pytest.raises(ValueError, match=r"not negative, got values down to -0\.5"):
        noise.sensor(np.array([1.0, -0.5]), seed=0)


@pytest.mark.parametrize(
    ("parameter", "value", "message"),
    [
        ("full_well", 0, "full_well is a number of electrons"),
        ("full_well", math.nan, "full_well is a number of electrons"),
        ("read_noise", -1, "read_noise is a standard deviation"),
        ("bits", 0, "bits is a whole number from 1 to 32"),
        ("bits", 12.5, "bits is a whole number from 1 to 32"),
        ("saturation", 0.0, "saturation is the light that fills the well"),
        ("saturation", math.inf, "saturation is the light that fills the well"),
        ("seed", None, "seed is a whole number"),
        ("seed", -1, "seed is a whole number"),
    ],
)
def test_silly_sensors_are_refused(parameter, value, message):
    with pytest.raises(ValueError, match=message):
        noise.sensor(np.ones((1, 3, 3)), **{"seed": 0, parameter: value})


@pytest.mark.parametrize("snr_db", [math.nan, -math.inf])
def test_silly_ratios_are_refused(snr_db):
    with pytest.raises(ValueError, match="snr_db is a ratio in dB"):
        noise.awgn(np.ones(3), snr_db=snr_db, seed=0)


def test_an_empty_recording_has_no_share():
    with pytest.raises(ValueError, match="at least one pixel"):
        noise.saturated(np.ones(0), saturation=1.0)
