"""What a laboratory captures: block means, thresholds, sums, drift, gain, and codes that slip."""

import math

import numpy as np
import pytest

from shadowgram.xray.captured import (
    Capture,
    background_gain,
    binary_codes,
    block_means,
    drift,
    from_images,
    slip,
    summed,
)


def sliding(rng, rows, columns, shots, share=0.5):
    strip = (rng.random((rows, columns + shots - 1)) < share).astype(np.uint8)
    return np.stack([strip[:, q : q + columns] for q in range(shots)])


def block_mean_by_loops(image, size, r, c):
    """Mean over a block, sample by sample on a fine grid of 1/20 pixel."""
    fine = np.kron(image, np.ones((20, 20)))
    top, left = round(20 * r * size[0]), round(20 * c * size[1])
    return fine[top : top + round(20 * size[0]), left : left + round(20 * size[1])].mean()


@pytest.mark.parametrize("size", [(1, 1), (7, 7), (2.5, 3), (1.05, 6.4)])
def test_block_means_weigh_by_area(size):
    images = np.random.default_rng(1).random((2, 14, 21))
    found = block_means(images, size)
    assert found.shape == (2, int(14 / size[0] + 1e-9), int(21 / size[1] + 1e-9))
    for (q, r, c), value in np.ndenumerate(found):
        assert value == pytest.approx(block_mean_by_loops(images[q], size, r, c), abs=1e-12)


def test_the_chain_of_the_source_gives_back_codes_and_counts():
    rng = np.random.default_rng(2)
    codes = sliding(rng, 6, 8, 20)
    lit = 300 + 4000 * np.kron(codes, np.ones((7, 7))) + rng.normal(0, 900, (20, 42, 56))
    images = rng.integers(0, 4000, (20, 9, 11)).astype(np.uint16)
    dark = np.full((9, 11), 12)
    found = from_images(lit, images, images // 2, dark=dark)
    np.testing.assert_array_equal(found.codes, codes)
    np.testing.assert_allclose(found.counts, (images.reshape(20, -1).sum(axis=1, dtype=float) - 12 * 99) / 1000)
    np.testing.assert_allclose(found.background, ((images // 2).reshape(20, -1).sum(axis=1, dtype=float) - 1188) / 1000)


def test_threshold_is_the_mean_of_each_shot():
    dim = np.array([[[1.0, 3.0], [3.0, 1.0]]])
    np.testing.assert_array_equal(binary_codes(np.concatenate([dim, 100 * dim]))[0], [[0, 1], [1, 0]])
    np.testing.assert_array_equal(binary_codes(np.concatenate([dim, 100 * dim]))[1], [[0, 1], [1, 0]])


@pytest.mark.parametrize("order", [0, 1, 3, 5])
def test_drift_finds_its_order_and_its_shape(order):
    rng = np.random.default_rng(order)
    codes = sliding(rng, 8, 8, 256)
    weights = np.zeros(order + 1)
    weights[-1] = 40.0
    true = np.polynomial.legendre.legval(np.linspace(-1, 1, 256), weights)
    counts = 5000 + true + 900 * codes.mean(axis=(1, 2)) + rng.normal(0, 12, 256)
    found = drift(codes, counts)
    assert found.order == order
    assert found.residual == pytest.approx(12, rel=0.15)
    assert found.criteria[order] == 0
    wanted = true - true.mean() if order else np.zeros(256)
    # Six terms leave at most a quarter of a shot's noise.
    assert np.abs(found.values - wanted).max() < 12
    assert drift(codes, counts, order=2).criteria is None


def test_drift_leaves_what_a_background_tells():
    rng = np.random.default_rng(3)
    codes, air = sliding(rng, 8, 8, 128), rng.normal(800, 60, 128)
    assert drift(codes, 2000 + 1.5 * air + rng.normal(0, 5, 128), air).residual == pytest.approx(5, rel=0.2)
    assert drift(codes, 2000 + 1.5 * air + rng.normal(0, 5, 128)).residual > 60


@pytest.mark.parametrize("true", [0.0, 0.8, 1.2])
def test_gain_between_runs_is_within_its_error(true):
    off = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        codes, slow = sliding(rng, 8, 8, 200), 300 * np.linspace(-1, 1, 200) ** 2
        air = 1000 + slow + rng.normal(0, 40, 200)
        found = background_gain(codes, 1500 - 2 * slow + true * air + rng.normal(0, 20, 200), air)
        off.append((found.value - true) / found.standard_error)
    assert abs(np.mean(off)) < 3 / math.sqrt(12)
    assert 0.5 < np.std(off) < 1.7


@pytest.mark.parametrize("true", [-2.0, 0.0, 2.0])
def test_codes_that_run_apart_are_found(true):
    rng = np.random.default_rng(5)
    strip = rng.integers(0, 2, (16, 16 + 300))
    codes = np.stack([strip[:, q + 8 : q + 24] for q in range(256)])
    picture = np.zeros((16, 16))
    picture[4:10, 3:9] = 60.0
    step = true / 255
    seen = []
    for q in range(256):
        by = q + 8 + step * (q - 127.5)
        low = math.floor(by)
        seen.append((1 - by + low) * strip[:, low : low + 16] + (by - low) * strip[:, low + 1 : low + 17])
    counts = rng.poisson(400 + (np.array(seen) * picture).sum(axis=(1, 2)))
    found = slip(codes, counts, tried=np.arange(-12, 13) / 4)
    assert abs(found.cells - true) < 3 * found.standard_error
    assert found.standard_error < 0.4
    assert (found.p_value < 1e-3) == (true != 0)
    other = slip(codes.transpose(0, 2, 1), counts, axis="y", tried=np.arange(-12, 13) / 4)
    np.testing.assert_allclose(other.likelihoods, found.likelihoods, atol=1e-6)


def test_counts_without_a_picture_tell_no_slip():
    rng = np.random.default_rng(6)
    codes = sliding(rng, 8, 8, 120)
    found = slip(codes, rng.poisson(1000, 120))
    assert found.p_value > 0.05


CODES = np.ones((3, 4, 4), np.uint8)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Capture(codes=CODES, counts=np.ones(4)), "there are 3 codes and 4 values of counts"),
        (
            lambda: Capture(codes=CODES, counts=np.ones(3), background=np.ones(5)),
            "there are 3 codes and 5 values of background",
        ),
        (lambda: Capture(codes=CODES, counts=np.array([1.0, -2, 3])), "counts cannot be negative, got -2 in shot 1"),
        (lambda: Capture(codes=CODES, counts=np.array([1.0, 2, np.nan])), "counts must be finite, got nan in shot 2"),
        (lambda: Capture(codes=CODES * [[[0]], [[1]], [[1]]], counts=np.ones(3)), "code 0 of 3 has no open cell"),
        (lambda: Capture(codes=CODES[0], counts=np.ones(3)), "codes are numbers (shot, y, x)"),
        (lambda: Capture(codes=CODES - 0.5 * np.eye(4), counts=np.ones(3)), "block means and a threshold"),
        (lambda: Capture(codes=CODES, counts=np.array(["1", "2", "3"])), "counts must be a number for each shot"),
        (lambda: Capture(codes=CODES, counts=np.ones(3)).every(4), "from 1 to 3; got 4"),
        (lambda: block_means(CODES, 5), "from 1 to 4 pixels a side in these images, got 5"),
        (lambda: block_means(CODES, 0.5), "got 0.5"),
        (lambda: block_means("none", 2), "images are numbers"),
        (lambda: binary_codes(CODES), "the image of code 0 is the same everywhere"),
        (lambda: summed(CODES[0]), "images of the detector are numbers (shot, y, x)"),
        (lambda: summed(CODES, dark=np.ones((2, 2))), "must have the shape (4, 4)"),
        (lambda: summed(CODES, divisor=0), "divisor must be positive, got 0"),
        (lambda: drift(CODES, np.ones(3), order=2), "from 0 to half the 3 shots, got 2"),
        (lambda: background_gain(CODES, np.ones(3), np.ones(3), order=0), "does not change from shot to shot"),
        (lambda: slip(CODES, np.ones(3), tried=[1, 2, 3]), "rising numbers of cells with 0 among them"),
        (lambda: slip(CODES, np.ones(3), axis="z"), "axis is 'x' or 'y', got 'z'"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(make, message):
    with pytest.raises(ValueError, match=r"^[^\n]+$") as raised:
        make()
    assert message in str(raised.value)
