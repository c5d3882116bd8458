"""The contract of every denoiser that ships: (image, sigma) → float32 image, whatever the size, the units and the threads."""

import numpy as np
import pytest

import shadowgram as sg

SIZES = [(8, 8), (9, 13), (32, 32), (33, 50)]


@pytest.fixture(params=["bm3d", "ffdnet", "tv"], scope="module")
def denoise(request):
    return sg.priors.get(request.param)


def blocks(shape):
    """Flat areas between 0 and 1."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    scene = np.full(shape, 0.2)
    scene[(y > 0.2 * shape[0]) & (y < 0.7 * shape[0]) & (x > 0.15 * shape[1]) & (x < 0.6 * shape[1])] = 0.9
    scene[(y > 0.5 * shape[0]) & (x > 0.7 * shape[1])] = 0.55
    return scene


def noisy(shape, sigma=0.1, seed=0):
    return blocks(shape) + sigma * np.random.default_rng(seed).standard_normal(shape)


def psnr(found, shape):
    return sg.metrics.psnr(found, blocks(shape), peak=1.0)


@pytest.mark.parametrize("shape", SIZES)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_gives_a_finite_float32_image_and_leaves_its_argument_alone(denoise, shape, dtype):
    image = noisy(shape).astype(dtype)
    before = image.copy()
    found = denoise(image, 0.1)
    assert found.shape == shape
    assert found.dtype == np.float32
    assert np.isfinite(found).all()
    assert not np.shares_memory(found, image)
    assert np.array_equal(image, before)


@pytest.mark.parametrize("shape", SIZES)
def test_the_same_bits_every_time_and_for_any_number_of_threads(denoise, shape):
    image = noisy(shape)
    with sg.threads(1):
        expected = denoise(image, 0.1)
        assert np.array_equal(denoise(image, 0.1), expected)
    for count in (2, 5):
        with sg.threads(count):
            assert np.array_equal(denoise(image, 0.1), expected)


def test_the_result_does_not_depend_on_what_was_denoised_before(denoise):
    image = noisy((32, 32))
    expected = denoise(image, 0.1)
    denoise(noisy((33, 50), seed=1), 0.3)
    assert np.array_equal(denoise(image, 0.1), expected)


@pytest.mark.parametrize("shape", [(32, 32), (33, 50)])
@pytest.mark.parametrize("sigma", [0.06, 0.1, 0.2])
def test_gains_more_than_3_db_on_flat_areas(denoise, shape, sigma):
    image = noisy(shape, sigma)
    assert psnr(denoise(image, sigma), shape) > psnr(image, shape) + 3


@pytest.mark.parametrize("scale", [1e4, 1e-3])
def test_units_do_not_matter(denoise, scale):
    image = noisy((32, 32))
    expected = denoise(image, 0.1)
    assert np.abs(denoise(scale * image, scale * 0.1) / scale - expected).max() < 2e-3


def test_layout_and_type_of_the_image_do_not_matter(denoise):
    counts = np.round(200 * np.clip(noisy((33, 50)), 0, 1)).astype(np.uint8)
    expected = denoise(counts.astype(np.float32), 20)
    for same in (counts, counts.astype(np.int64), np.asfortranarray(counts), counts.astype(float).tolist()):
        assert np.array_equal(denoise(same, 20), expected)
    assert np.array_equal(denoise(np.repeat(counts, 2, axis=1)[:, ::2], np.float32(20)), expected)


@pytest.mark.parametrize("shape", SIZES)
def test_without_noise_the_image_comes_back(denoise, shape):
    image = noisy(shape).astype(np.float32)
    assert np.array_equal(denoise(image, 0), image)


@pytest.mark.parametrize("value", [0.0, 0.5, -3.0])
def test_a_constant_image_stays_one(denoise, value):
    found = denoise(np.full((16, 24), value), 0.1)
    assert np.abs(found - value).max() < 0.02


@pytest.mark.parametrize("sigma", [1e-6, 10.0, 1e4])
def test_a_sigma_that_is_far_off_still_gives_an_image(denoise, sigma):
    """Noise far above the image's range, or far below its contrast: finite, and near what was there in terms of both."""
    image = noisy((32, 32))
    found = denoise(image, sigma)
    assert np.isfinite(found).all()
    margin = 0.3 * max(np.ptp(image), sigma)
    assert image.min() - margin < found.min() <= found.max() < image.max() + margin


@pytest.mark.parametrize(
    ("image", "sigma", "error", "message"),
    [
        (np.full((16, 16), np.nan), 0.1, ValueError, "finite values, got NaN or infinite ones"),
        (np.full((16, 16), np.inf), 0.1, ValueError, "finite values"),
        (np.full((16, 16), 1e300), 0.1, ValueError, "scale the image first"),
        (np.ones((16, 16), complex), 0.1, TypeError, "real numbers, got an array of complex128"),
        (np.ones((16, 16), "S1"), 0.1, TypeError, "real numbers"),
        (np.ones(64), 0.1, ValueError, r"at least 8×8 pixels, got \(64,\)"),
        (np.ones((3, 16, 16)), 0.1, ValueError, r"image \(y, x\) of at least 8×8 pixels, got \(3, 16, 16\)"),
        (np.ones((7, 9)), 0.1, ValueError, r"got \(7, 9\)"),
        (np.ones((0, 16)), 0.1, ValueError, r"got \(0, 16\)"),
        (np.ones((16, 16)), -0.1, ValueError, "0 or more, got -0.1"),
        (np.ones((16, 16)), np.nan, ValueError, "0 or more, got nan"),
        (np.ones((16, 16)), np.inf, ValueError, "0 or more, got inf"),
        (np.ones((16, 16)), "0.1", TypeError, "standard deviation in the image's units, got '0.1'"),
        (np.ones((16, 16)), np.full((16, 15), 0.1), ValueError, r"got an array of shape \(16, 15\)"),
    ],
)
def test_bad_input_gets_one_clear_sentence(denoise, image, sigma, error, message):
    with pytest.raises(error, match=message) as caught:
        denoise(image, sigma)
    assert "\n" not in str(caught.value)


def test_a_name_that_does_not_exist_gets_the_names_that_do():
    with pytest.raises(ValueError, match="there is no denoiser 'nlm': the names are 'bm3d', 'ffdnet', 'tv'"):
        sg.priors.get("nlm")
