"""The network's runner: what it computes, for any unit, size and file; and what the shipped weights reach."""

import itertools
import os

import numpy as np
import pytest
import pywt

import shadowgram as sg
from shadowgram.priors import FFDNet
from shadowgram.priors._ffdnet_file import Layers, to_onnx

SIZES = [(8, 8), (9, 12), (12, 9), (33, 21)]


def scene(shape, seed=0):
    """Blocks of different tones, (y, x) in 0..1."""
    rng = np.random.default_rng(seed)
    blocks = np.kron(rng.uniform(0, 1, (8, 8)), np.ones((8, 8)))
    return blocks[: shape[0], : shape[1]]


def noisy_scene(shape, sigma=0.1, seed=0):
    return scene(shape, seed) + sigma * np.random.default_rng(seed + 1).standard_normal(shape)


def small_layers(*, residual, biased, seed=3):
    rng = np.random.default_rng(seed)
    sizes = [5, 6, 3, 4]
    weights = [0.3 * rng.standard_normal((b, a, 3, 3)) for a, b in itertools.pairwise(sizes)]
    biases = [biased * 0.1 * rng.standard_normal(b) for b in sizes[1:]]
    return Layers(
        weights=tuple(w.astype(np.float32) for w in weights),
        biases=tuple(b.astype(np.float32) for b in biases),
        residual=residual,
    )


def by_loops(layers, image, levels):
    """The network from its definition, in float64, on an image with even sides."""
    height, width = image.shape[0] // 2, image.shape[1] // 2
    x = np.zeros((5, height, width))
    for i in range(height):
        for j in range(width):
            x[:, i, j] = [*image[2 * i, 2 * j : 2 * j + 2], *image[2 * i + 1, 2 * j : 2 * j + 2], levels[2 * i, 2 * j]]
    for number, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True), 1):
        y = np.zeros((len(weight), height, width))
        for o, i, j in np.ndindex(*y.shape):
            y[o, i, j] = bias[o]
            for c, a, b in np.ndindex(*weight.shape[1:]):
                if 0 <= i + a - 1 < height and 0 <= j + b - 1 < width:
                    y[o, i, j] += float(weight[o, c, a, b]) * x[c, i + a - 1, j + b - 1]
        x = np.maximum(y, 0) if number < len(layers.weights) else y
    result = np.zeros(image.shape)
    for c, i, j in np.ndindex(4, height, width):
        result[2 * i + c // 2, 2 * j + c % 2] = x[c, i, j]
    return image - result if layers.residual else result


@pytest.mark.parametrize("residual", [False, True])
@pytest.mark.parametrize("biased", [False, True])
@pytest.mark.parametrize("shape", [(8, 8), (9, 11), (10, 13)])
def test_computes_what_its_definition_says(tmp_path, residual, biased, shape):
    layers = small_layers(residual=residual, biased=biased)
    path = tmp_path / "small.onnx"
    path.write_bytes(to_onnx(layers, "test"))
    image = noisy_scene(shape).astype(np.float32)
    levels = np.linspace(0.05, 0.2, image.size, dtype=np.float32).reshape(shape)
    if biased:
        low, high = np.percentile(image.astype(float), (1, 99))
        scale = max(high - low, 0.2 * 255 / 75)
        offset = (low + high - scale) / 2
    else:
        offset, scale = image.mean(dtype=float), 1.0
    extra = [(0, size % 2) for size in shape]
    inner = np.pad((image - offset) / scale, extra, "reflect"), np.pad(levels / scale, extra, "reflect")
    expected = by_loops(layers, *inner)[: shape[0], : shape[1]] * scale + offset
    np.testing.assert_allclose(FFDNet(path=path)(image, levels), expected, rtol=0, atol=2e-6)


@pytest.mark.parametrize("shape", SIZES)
@pytest.mark.parametrize(
    ("factor", "offset"), [(4096.0, 0.0), (2500.0, 700.0), (1e-20, 0.0), (1e30, -3e29), (1.0, 50.0)]
)
def test_any_unit_of_the_image_gives_the_same(shape, factor, offset):
    image = noisy_scene(shape)
    denoise = FFDNet()
    expected = factor * denoise(image, 0.1).astype(float) + offset
    found = denoise(factor * image + offset, factor * 0.1)
    assert found.dtype == np.float32
    assert found.shape == shape
    # A large offset costs digits of the image before it comes to us.
    digits = 4e-7 * (abs(offset) + factor)
    np.testing.assert_allclose(found, expected, rtol=0, atol=3e-5 * factor + 10 * digits)


def test_imported_weights_with_biases_take_any_unit_too(tmp_path):
    path = tmp_path / "small.onnx"
    path.write_bytes(to_onnx(small_layers(residual=False, biased=True), "test"))
    image = noisy_scene((16, 17))
    expected = 300 * FFDNet(path=path)(image, 0.1).astype(float) + 20
    np.testing.assert_allclose(FFDNet(path=path)(300 * image + 20, 30), expected, rtol=1e-4, atol=1e-2)


def test_the_same_bits_for_any_number_of_threads():
    image = noisy_scene((64, 64)).repeat(3, 0).repeat(3, 1)
    with sg.threads(1):
        expected = FFDNet()(image, 0.1)
    for count in (2, 3):
        with sg.threads(count):
            assert np.array_equal(FFDNet()(image, 0.1), expected)


def test_without_noise_the_image_comes_back():
    image = noisy_scene((9, 14)).astype(np.float32)
    found = FFDNet()(image, 0)
    assert np.array_equal(found, image)
    assert found is not image


def test_a_constant_image_comes_back():
    assert np.array_equal(FFDNet()(np.full((8, 9), 7.25), 2.0), np.full((8, 9), 7.25, np.float32))


def test_a_map_that_is_the_same_everywhere_is_one_number():
    image = noisy_scene((15, 20))
    assert np.array_equal(FFDNet()(image, np.full((15, 20), 0.1)), FFDNet()(image, 0.1))


def test_a_map_says_where_the_noise_is():
    clean = scene((64, 64))
    levels = np.zeros((64, 64))
    levels[:, 32:] = 0.2
    image = clean + levels * np.random.default_rng(5).standard_normal(clean.shape)
    found = FFDNet()(image, levels)
    assert np.array_equal(found[:, :32], image.astype(np.float32)[:, :32])
    assert np.std(found - clean) < 0.35 * np.std(image - clean)


def test_far_too_large_a_sigma_gives_finite_values():
    assert np.isfinite(FFDNet()(noisy_scene((16, 16)), 1e6)).all()
    assert np.isfinite(FFDNet()(noisy_scene((16, 16)) * 1e-30, 1e8)).all()


@pytest.mark.parametrize("biased", [False, True])
def test_the_largest_and_the_smallest_numbers_give_finite_values(tmp_path, biased):
    path = tmp_path / "small.onnx"
    path.write_bytes(to_onnx(small_layers(residual=True, biased=biased), "test"))
    signs = np.sign(noisy_scene((16, 16)) - 0.5)
    for factor in (3.4e38, 1e-45):
        for sigma in (factor, 1e-45, 3.4e38):
            assert np.isfinite(FFDNet(path=path)(factor * signs, sigma)).all()


@pytest.mark.parametrize(
    ("image", "sigma", "message"),
    [
        (np.full((8, 8), np.nan), 0.1, "finite"),
        (np.zeros((7, 9)), 0.1, "8×8"),
        (np.zeros((8, 8)), -0.1, "0 or more"),
        (np.zeros((8, 8)), np.nan, "0 or more"),
        (np.zeros((8, 8)), np.ones((4, 4)), "map"),
    ],
)
def test_bad_input_is_refused(image, sigma, message):
    with pytest.raises(ValueError, match=message):
        FFDNet()(image, sigma)


def test_a_file_that_is_not_a_network_is_refused(tmp_path):
    path = tmp_path / "other.onnx"
    with pytest.raises(FileNotFoundError):
        FFDNet(path=path)(noisy_scene((8, 8)), 0.1)
    path.write_bytes(b"not a network")
    with pytest.raises(ValueError, match=r"other\.onnx is not a network for gray images; make one with"):
        FFDNet(path=path)(noisy_scene((8, 8)), 0.1)
    whole = to_onnx(small_layers(residual=True, biased=False), "test")
    path.write_bytes(whole[:-30])
    with pytest.raises(ValueError, match="not a network for gray images"):
        FFDNet(path=path)(noisy_scene((8, 8)), 0.1)
    path.write_bytes(whole.replace(b"shadowgram.network", b"shadowgram.letters"))
    with pytest.raises(ValueError, match="not a network for gray images"):
        FFDNet(path=path)(noisy_scene((8, 8)), 0.1)


def test_a_file_that_has_changed_is_read_again(tmp_path):
    path = tmp_path / "small.onnx"
    image = noisy_scene((8, 8))
    path.write_bytes(to_onnx(small_layers(residual=True, biased=False, seed=3), "test"))
    first = FFDNet(path=path)(image, 0.1)
    path.write_bytes(to_onnx(small_layers(residual=True, biased=False, seed=4), "test"))
    os.utime(path, ns=(1, 1))
    assert not np.array_equal(FFDNet(path=path)(image, 0.1), first)


def test_wrong_layers_are_refused():
    good = small_layers(residual=True, biased=False)
    with pytest.raises(ValueError, match="layer 1 of a gray FFDNet takes 5 channels"):
        Layers(weights=(good.weights[0][:, :4], *good.weights[1:]), biases=good.biases, residual=True)
    with pytest.raises(ValueError, match="gives 4 channels, got 3"):
        Layers(weights=good.weights[:2], biases=good.biases[:2], residual=True)
    broken = good.weights[0].copy()
    broken[0, 0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        Layers(weights=(broken, *good.weights[1:]), biases=good.biases, residual=True)


# PSNR of the bm3d package, version 4.0.3, on the same images.
@pytest.mark.parametrize(("level", "bm3d"), [(15, 30.95), (25, 28.42), (50, 24.99)])
def test_better_than_bm3d_on_a_photograph_that_was_not_trained_on(level, bm3d):
    photograph = pywt.data.camera() / 255
    clean = photograph.reshape(256, 2, 256, 2).mean((1, 3))[64:192, 64:192]
    noise = np.random.default_rng(0).standard_normal(clean.shape)
    found = FFDNet()(clean + level / 255 * noise, level / 255)
    assert sg.metrics.psnr(found, clean, peak=1.0) > bm3d
