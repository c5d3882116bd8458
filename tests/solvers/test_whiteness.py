"""Whiteness of residuals: against plain sums, its law for white noise, and what a wrong model does to it."""

import math

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.solvers.whiteness import LAGS, residual_whiteness


@pytest.mark.parametrize("shape", [(9, 8), (2, 6, 11), (3, 8, 8)])
def test_equals_plain_sums(shape):
    rng = np.random.default_rng(0)
    r = rng.standard_normal(shape)
    lit = rng.random(shape) < 0.9
    found = residual_whiteness(r, lit)
    shots, rows, columns = (1, *shape)[-3:]
    r, lit = r.reshape(shots, rows, columns), lit.reshape(shots, rows, columns)
    for (down, right), correlation, score in zip(LAGS, found.correlations, found.scores, strict=True):
        total = square = fourth = 0.0
        for q in range(shots):
            for i in range(rows):
                for j in range(columns):
                    k, m = i + down, j + right
                    if 0 <= k < rows and 0 <= m < columns and lit[q, i, j] and lit[q, k, m]:
                        a, b = r[q, i, j], r[q, k, m]
                        total += a * b
                        square += (a * a + b * b) / 2
                        fourth += (a * b) ** 2
        assert correlation == pytest.approx(total / square, rel=1e-12)
        assert score == pytest.approx(total / math.sqrt(fourth), rel=1e-12)
    assert abs(found.z) == max(abs(score) for score in found.scores)
    assert abs(found.correlation) == max(abs(one) for one in found.correlations)


@pytest.mark.parametrize("photons", [False, True])
def test_scores_of_white_noise_have_mean_zero_and_deviation_one(photons):
    rng = np.random.default_rng(1)
    brightness = 1 + 30 * (np.mgrid[:24, :24][1] > 12) if photons else np.ones((24, 24))
    scores = [
        residual_whiteness(np.sqrt(brightness) * rng.standard_normal((2, 24, 24)), np.ones((2, 24, 24), bool)).scores
        for _ in range(300)
    ]
    assert np.abs(np.mean(scores, axis=0)).max() < 4 / math.sqrt(300)
    assert np.std(scores, axis=0) == pytest.approx(1, abs=0.15)


def test_expected_is_the_deviation_of_the_correlation():
    rng = np.random.default_rng(2)
    found = [residual_whiteness(rng.standard_normal((40, 40))) for _ in range(200)]
    assert np.std([one.correlations[0] for one in found]) == pytest.approx(found[0].expected, rel=0.15)


def test_scale_does_not_matter():
    r = np.random.default_rng(3).standard_normal((2, 20, 20))
    for scale in (1e-200, 1e150):
        assert residual_whiteness(scale * r).scores == pytest.approx(residual_whiteness(r).scores)


@pytest.mark.parametrize("residual", [np.zeros((2, 8, 8)), np.ones((3, 3)), np.zeros((0, 4, 4))])
def test_too_little_says_nothing(residual):
    found = residual_whiteness(residual)
    assert (found.z, found.correlation, found.expected) == (0, 0, 0)


@pytest.mark.parametrize(
    ("residual", "lit", "error", "message"),
    [
        (np.ones(5), None, ValueError, "residual \\(shot, y, x\\)"),
        (np.full((4, 4), np.nan), None, ValueError, "finite"),
        (np.ones((4, 4), complex), None, TypeError, "real numbers"),
        (np.ones((4, 4)), np.ones((4, 5), bool), ValueError, "lit must have"),
    ],
)
def test_arguments_are_checked(residual, lit, error, message):
    with pytest.raises(error, match=message):
        residual_whiteness(residual, lit)


def test_a_mask_out_of_place_shows():
    cube = sg.scenes.chart(size=64, bands=8, seed=0).values.astype(np.float32)
    imager = sg.DualCASSI(cube_shape=cube.shape, wavelengths=(450, 650))
    code = sg.codes.boolean(shots=4, shape=imager.code_shape, seed=0)
    H = imager.operator(code)
    y = sg.noise.awgn(H.forward(cube), snr_db=30, seed=0)
    right = sg.solve(sg.EigenTV(), H, y).whiteness
    wrong = sg.solve(sg.EigenTV(), imager.operator(np.roll(code, 1, axis=1)), y).whiteness
    assert abs(right.correlation) < 0.1
    assert abs(wrong.correlation) > 0.1
    assert abs(wrong.z) > 2 * abs(right.z)
