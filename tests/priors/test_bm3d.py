"""BM3D against a plain version of itself, its parts against their definitions, and its results against another program's."""

import sys

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.experiments.bench import denoisers
from shadowgram.experiments.bench.machine import Machine
from shadowgram.experiments.bench.spec import BenchSpec
from shadowgram.priors import _bm3d_kernels as kernels
from shadowgram.priors._bm3d_transforms import biorthogonal, cosine, noise_covariances
from shadowgram.priors.bm3d import _PROFILES

rng = np.random.default_rng(20)
U = np.uint64


def picture(height, width):
    """Squares, a disc, stripes and a slope: something of everything."""
    y, x = np.mgrid[:height, :width] * 128 / max(height, width)
    image = 0.2 + 0.002 * x + 0.1 * np.sin(y / 3) * (x > 90)
    image[(y // 16 + x // 16) % 3 == 0] += 0.3
    image[(y - 80) ** 2 + (x - 40) ** 2 < 500] = 0.9
    image[(y > 20) & (y < 60) & (x % 7 < 3) & (x > 60)] = 0.1
    return image


def leaves(size):
    """Discs that cover one another, of random radii, grays and shadings: much like a photograph."""
    random, image = np.random.default_rng(1), np.zeros((size, size))
    y, x = np.mgrid[:size, :size]
    for _ in range(400):
        (cy, cx), radius = random.uniform(0, size, 2), 3 + random.pareto(1.5) * 3
        gray, slope = random.uniform(0.1, 0.9), random.normal(0, 0.004, 2)
        inside = (y - cy) ** 2 + (x - cx) ** 2 < radius**2
        image[inside] = (gray + slope[0] * (y - cy) + slope[1] * (x - cx))[inside]
    return image


def noisy(image, sigma, seed=0):
    return (image + sigma * np.random.default_rng(seed).standard_normal(image.shape)).astype(np.float32)


def psnr(found, clean):
    return -10 * np.log10(np.mean((found - clean) ** 2))


# A plain version, float64, one block at a time --------------------------------------------------------------------------


def haar_matrix(n):
    """Orthonormal Haar transform: rows by the first place of the pairs of means that they compare."""
    matrix, apart = np.eye(n), 1
    while apart < n:
        for k in range(0, n, 2 * apart):
            low, high = matrix[k].copy(), matrix[k + apart].copy()
            matrix[k], matrix[k + apart] = (low + high) / 2**0.5, (low - high) / 2**0.5
        apart *= 2
    return matrix


def block(image, place):
    y, x = place
    return image[y : y + 8, x : x + 8]


def alike(guide, place, settings, farthest):
    """Places of the nearest blocks, by brute force: a power of two of them."""
    found = []
    for y in range(guide.shape[0] - 7):
        for x in range(guide.shape[1] - 7):
            down, across = y - place[0], x - place[1]
            distance = np.sum((block(guide, place) - block(guide, (y, x))) ** 2)
            if max(abs(down), abs(across)) <= settings.reach and distance < farthest:
                found.append((distance, down**2 + across**2, down, across, (y, x)))
    found = [one[-1] for one in sorted(found)[: settings.most]]
    return found[: 2 ** int(np.log2(len(found)))]


def group_variances(matrix, covariance, places, shape):
    """Variances (k, i, j) of the coefficients of a group, from the covariance (pixel, pixel) of the noise; None is white."""
    n = len(places)
    if covariance is None:
        return np.ones((n, 8, 8))
    numbers, both, along = np.arange(np.prod(shape)).reshape(shape), np.kron(matrix, matrix), haar_matrix(n)
    pixels = [block(numbers, place).ravel() for place in places]
    pairs = np.array([[np.sum((both @ covariance[np.ix_(a, b)]) * both, axis=1) for b in pixels] for a in pixels])
    return np.einsum("ki,kj,ijc->kc", along, along, pairs).reshape(n, 8, 8)


def plain_stage(image, pilot, settings, covariance):
    matrix, step = settings.transform(), min(settings.step, 2)
    window = np.outer(np.kaiser(8, 2), np.kaiser(8, 2))
    inverse = np.linalg.inv(matrix)
    guide = image if pilot is None else pilot
    total, weights = np.zeros(image.shape), np.zeros(image.shape)
    farthest = 64 * (settings.near + settings.far * image.std())
    ys, xs = (sorted({*range(0, size - 7, step), size - 8}) for size in image.shape)
    for place in [(y, x) for y in ys for x in xs]:
        places = alike(guide, place, settings, farthest)
        along = haar_matrix(len(places))
        variances = group_variances(matrix, covariance, places, image.shape)

        def transformed(one, places=places, along=along):
            return np.tensordot(along, np.array([matrix @ block(one, p) @ matrix.T for p in places]), 1)

        group = transformed(image)
        if pilot is None:
            factors = (group**2 > 2.7**2 * variances).astype(float)
        else:
            power = transformed(pilot) ** 2
            factors = power / (power + variances)
        factors[0, 0, 0] = 1
        weight = 1 / np.sum(factors**2 * variances)
        filtered = np.tensordot(along.T, factors * group, 1)
        for one, p in zip(filtered, places, strict=True):
            block(total, p)[:] += weight * window * (inverse @ one @ inverse.T)
            block(weights, p)[:] += weight * window
    return total / weights


def plain_bm3d(image, sigma, profile, spectrum):
    zero = (image.min() + image.max()) / 2
    reduced = np.pad((image.astype(float) - zero) / sigma, 4, "symmetric")
    covariance = None if spectrum is None else dense_covariance(spectrum, reduced.shape)
    first, second = _PROFILES[profile]
    pilot = plain_stage(reduced, None, first, covariance)
    return (plain_stage(reduced, pilot, second, covariance) * sigma + zero)[4:-4, 4:-4]


def dense_covariance(spectrum, shape):
    """Covariance (pixel, pixel) of noise of variance 1, periodic, from its power spectral density."""
    pixels = np.array(list(np.ndindex(shape)))
    autocovariance = np.fft.ifft2(spectrum / spectrum.mean()).real
    lags = (pixels[:, None] - pixels[None]) % spectrum.shape
    return autocovariance[lags[..., 0], lags[..., 1]]


@pytest.mark.parametrize(("shape", "profile"), [((10, 19), "normal"), ((13, 16), "normal"), ((17, 12), "fast")])
def test_it_is_the_plain_version(shape, profile):
    image = noisy(picture(128, 128)[10 : 10 + shape[0], 55 : 55 + shape[1]], 0.05)
    found = sg.priors.BM3D(profile=profile)(image, 0.05)
    np.testing.assert_allclose(found, plain_bm3d(image, 0.05, profile, None), atol=2e-6)


def test_it_is_the_plain_version_in_coloured_noise():
    shape = (9, 11)
    spectrum = 0.1 + np.abs(np.fft.fft2(rng.random((4, 3)), shape)) ** 2
    image = noisy(picture(128, 128)[10:19, 55:66], 0.05)
    found = sg.priors.BM3D(spectrum=spectrum)(image, 0.05)
    np.testing.assert_allclose(found, plain_bm3d(image, 0.05, "normal", spectrum), atol=2e-6)


# Parts ------------------------------------------------------------------------------------------------------------------


def test_the_cosine_transform_is_its_definition():
    for k in range(8):
        for n in range(8):
            norm = np.sqrt(1 / 8) if k == 0 else np.sqrt(2 / 8)
            assert cosine()[k, n] == pytest.approx(norm * np.cos(np.pi * k * (n + 0.5) / 8), abs=1e-15)


def test_the_wavelet_transform_is_its_filter_bank():
    """Level by level on a signal, with the sums of periodic samples written out; rows are scaled to unit norm afterwards."""
    taps = np.array([3, -3, -22, 22, 128, 128, 22, -22, -3, 3]) / 256

    def bank(signal):
        if signal.size == 1:
            return signal
        half, size = signal.size // 2, signal.size
        means = [sum(taps[t] * signal[(2 * i + t - 4) % size] for t in range(10)) for i in range(half)]
        return np.concatenate([bank(np.array(means)), signal[::2] - signal[1::2]])

    plain = np.array([bank(one) for one in np.eye(8)]).T
    np.testing.assert_allclose(biorthogonal(), plain / np.linalg.norm(plain, axis=1, keepdims=True), atol=1e-15)
    np.testing.assert_allclose(biorthogonal()[0], 8**-0.5, atol=1e-15)
    np.testing.assert_allclose(biorthogonal()[1:].sum(axis=1), 0, atol=1e-15)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (5, 3), (4, 37)])
def test_the_kernels_transform_every_block(height, width):
    image = rng.standard_normal((height + 7, width + 7)).astype(np.float32)
    matrix = rng.standard_normal((8, 8)).astype(np.float32)
    sums = rng.standard_normal((height, width, 8, 8)).astype(np.float32)
    found, back = np.empty_like(sums), np.zeros_like(image)
    planes, line = np.empty(64 * width, np.float32), U(8 * width)
    rows = np.empty((height + 7) * 8 * width, np.float32)
    kernels.analyse(
        matrix.ravel(), image.ravel(), U(width + 7), U(1), U(height + 7), U(width), U(1), planes, rows
    )  # fmt: skip
    kernels.analyse(matrix.ravel(), rows, line, line, U(height), U(width), U(8), planes, found.ravel())
    rows[:] = 0
    kernels.synthesise(matrix.ravel(), sums.ravel(), line, line, U(height), U(width), U(8), planes, rows)
    kernels.synthesise(
        matrix.ravel(), rows, U(width + 7), U(1), U(height + 7), U(width), U(1), planes, back.ravel()
    )  # fmt: skip
    expected = np.zeros_like(image)
    for y in range(height):
        for x in range(width):
            np.testing.assert_allclose(found[y, x], matrix @ block(image, (y, x)) @ matrix.T, atol=1e-4)
            block(expected, (y, x))[:] += matrix @ sums[y, x] @ matrix.T
    np.testing.assert_allclose(back, expected, atol=1e-3)


@pytest.mark.parametrize("farthest", [110.0, 1e6])
def test_matching_finds_what_brute_force_finds(farthest):
    """Whole numbers, so that distances are exact and many are equal."""
    height, width, reach, most = 21, 33, 6, 16
    image = rng.integers(0, 3, (height, width)).astype(np.float32)
    guide = np.full((height, width + 2 * reach + 64), kernels.OUTSIDE)
    guide[:, reach : reach + width] = image
    steps = sorted((y * y + x * x, y, x) for y in range(-reach, reach + 1) for x in range(-reach, reach + 1))
    down, across = (np.array([step[axis] for step in steps]) for axis in (1, 2))
    ys, xs = np.array([0, 5, 13]), np.array([0, 3, 11, 25])
    keys, found = np.empty((3, 4, most), np.int64), np.empty(64, np.float32)
    kernels.match(
        guide.ravel(), guide.shape[1], ys, reach, xs, down, across, height - 8, int(np.float32(farthest).view(np.int32)), most,
        64, np.zeros(72, np.float32), found, found.view(np.int32), np.empty(4, np.int64), keys.ravel(),
    )  # fmt: skip
    settings = _PROFILES["normal"][0]._replace(reach=reach, most=most)
    for i, y in enumerate(ys):
        for j, x in enumerate(xs):
            there = keys[i, j][keys[i, j] != kernels.NONE] & 0xFFFFFFFF
            places = [(y + down[s], x + across[s]) for s in there]
            expected = alike(image, (y, x), settings, farthest)
            assert places[: len(expected)] == expected
            assert len(places) < 2 * len(expected)


def test_covariances_of_white_noise_are_overlaps_of_blocks():
    covariances = noise_covariances(cosine(), np.ones((40, 50)), 2).reshape(9, 9, 8, 8)
    np.testing.assert_allclose(covariances[4, 4], 1, atol=1e-6)
    rows = np.array([np.dot(one[1:], one[:-1]) for one in cosine()])
    np.testing.assert_allclose(covariances[4, 5], np.tile(rows, (8, 1)), atol=1e-6)
    np.testing.assert_allclose(covariances[5, 4], np.tile(rows[:, None], (1, 8)), atol=1e-6)


# Quality ----------------------------------------------------------------------------------------------------------------

# Of the package bm3d 4.0.3 with its default settings, on one thread, dB:
#   np.savez("in.npz", **{str(s): noisy(leaves(128), s / 255) for s in (15, 25, 50)})
#   psnr(bm3d.bm3d(np.load("in.npz")[str(s)].astype(float), s / 255), leaves(128))
OTHER = {15: 30.62, 25: 27.11, 50: 23.2}
OTHER_SMALL = {15: 30.83, 25: 28.07, 50: 24.26}  # likewise leaves(32)


@pytest.mark.parametrize("level", OTHER)
def test_it_denoises_as_well_as_another_program(level):
    sigma = level / 255
    for clean, other in ((leaves(128), OTHER), (leaves(32), OTHER_SMALL)):
        found = sg.priors.BM3D()(noisy(clean, sigma), sigma)
        assert psnr(found, clean) > other[level] - 0.1


@pytest.mark.parametrize("level", OTHER)
def test_the_fast_profile_costs_little(level):
    clean, sigma = leaves(128), level / 255
    found = sg.priors.BM3D(profile="fast")(noisy(clean, sigma), sigma)
    assert psnr(found, clean) > OTHER[level] - 0.6


@pytest.mark.parametrize("profile", ["normal", "fast"])
def test_the_spectrum_of_coloured_noise_helps(profile):
    clean, sigma = picture(70, 96), 0.1
    fy, fx = np.fft.fftfreq(70)[:, None], np.fft.fftfreq(96)
    for spectrum in (np.exp(-40 * (fy**2 + fx**2)), np.exp(-100 * fx**2) + 0 * fy):
        white = np.random.default_rng(3).standard_normal(clean.shape)
        noise = np.fft.ifft2(np.fft.fft2(white) * np.sqrt(spectrum / spectrum.mean())).real
        image = clean + sigma * noise
        known = psnr(sg.priors.BM3D(profile=profile, spectrum=spectrum)(image, sigma), clean)
        assert known > psnr(sg.priors.BM3D(profile=profile)(image, sigma), clean) + 2


# Contract ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(8, 8), (9, 13), (32, 32), (33, 50), (8, 300), (131, 9)])
@pytest.mark.parametrize("profile", ["normal", "fast"])
def test_any_size_is_denoised(shape, profile):
    clean = np.linspace(0, 1, shape[0])[:, None] + np.linspace(0, 1, shape[1])
    image = noisy(clean, 0.2)
    found = sg.priors.BM3D(profile=profile)(image, 0.2)
    assert found.shape == shape
    assert found.dtype == np.float32
    assert np.mean((found - clean) ** 2) < 0.4 * np.mean((image - clean) ** 2)


def test_units_do_not_matter():
    image, denoise = noisy(picture(40, 51), 0.1), sg.priors.BM3D()
    plain = denoise(image, 0.1)
    np.testing.assert_array_equal(denoise(1024 * image, 102.4), 1024 * plain)
    np.testing.assert_array_equal(denoise(-image, 0.1), -plain)
    found = denoise(3000 * image.astype(float) + 5000, 300.0)
    assert np.abs(found - (3000 * plain + 5000)).max() < 0.1


@pytest.mark.parametrize("profile", ["normal", "fast"])
def test_threads_do_not_matter(profile):
    image, results = noisy(picture(150, 290), 0.1), []
    for count in (1, 2, 8):
        with sg.threads(count):
            results.append(sg.priors.BM3D(profile=profile)(image, 0.1))
    np.testing.assert_array_equal(results[1], results[0])
    np.testing.assert_array_equal(results[2], results[0])


def test_the_image_is_left_as_it_was():
    image = noisy(picture(20, 20), 0.1)
    before = image.copy()
    sg.priors.BM3D()(image, 0.1)
    np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize("value", [0.0, -3.7, 1e5])
def test_a_constant_image_stays(value):
    image = np.full((12, 20), value, np.float32)
    np.testing.assert_array_equal(sg.priors.BM3D()(image, 0.1), image)


@pytest.mark.parametrize("sigma", [0, 1e-30])
def test_without_noise_the_image_comes_back(sigma):
    image = noisy(picture(16, 16), 0.1)
    found = sg.priors.BM3D()(image, sigma)
    np.testing.assert_array_equal(found, image)
    assert not np.shares_memory(found, image)


@pytest.mark.parametrize("sigma", [1e-6, 1e3, 1e30])
def test_any_sigma_gives_finite_values(sigma):
    image = noisy(picture(24, 31), 0.1)
    found = sg.priors.BM3D()(image, sigma)
    assert np.isfinite(found).all()
    assert image.min() - 1e-3 <= found.min()
    assert found.max() <= image.max() + 1e-3


def test_a_spectrum_with_zeros_gives_finite_values():
    spectrum = np.zeros((16, 20))
    spectrum[0, 3] = spectrum[0, -3] = 1
    assert np.isfinite(sg.priors.BM3D(spectrum=spectrum)(noisy(picture(16, 20), 0.1), 0.1)).all()


def test_it_has_a_name():
    image = noisy(picture(16, 16), 0.1)
    np.testing.assert_array_equal(sg.priors.get("bm3d")(image, 0.1), sg.priors.BM3D()(image, 0.1))


@pytest.mark.parametrize(
    ("settings", "image", "sigma", "error", "words"),
    [
        ({}, np.zeros((7, 20)), 0.1, ValueError, "at least 8×8"),
        ({}, np.zeros(64), 0.1, ValueError, "image \\(y, x\\)"),
        ({}, np.full((9, 9), np.nan), 0.1, ValueError, "finite"),
        ({}, np.zeros((9, 9), complex), 0.1, TypeError, "real"),
        ({}, np.zeros((9, 9)), -0.1, ValueError, "0 or more"),
        ({}, np.zeros((9, 9)), np.nan, ValueError, "0 or more"),
        ({}, np.zeros((9, 9)), np.ones((9, 9)), ValueError, "one number"),
        ({}, np.zeros((9, 9)), "much", TypeError, "standard deviation"),
        ({"spectrum": np.ones((9, 10))}, np.zeros((9, 9)), 0.1, ValueError, "spectrum \\(9, 10\\)"),
    ],
)
def test_bad_images_are_refused(settings, image, sigma, error, words):
    with pytest.raises(error, match=words):
        sg.priors.BM3D(**settings)(image, sigma)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"profile": "best"}, "normal, fast, got 'best'"),
        ({"spectrum": np.ones(9)}, "shape \\(9,\\)"),
        ({"spectrum": np.ones((9, 9), complex)}, "complex"),
        ({"spectrum": -np.ones((9, 9))}, "negative"),
        ({"spectrum": np.zeros((9, 9))}, "positive"),
        ({"spectrum": np.full((9, 9), np.inf)}, "finite"),
    ],
)
def test_bad_settings_are_refused(settings, words):
    with pytest.raises(ValueError, match=words):
        sg.priors.BM3D(**settings)


# Benchmark --------------------------------------------------------------------------------------------------------------


def test_the_benchmark_times_it():
    row = next(
        denoisers.denoiser_cases(BenchSpec(seconds=0.0), Machine(cpu="", bandwidth=10.0, peak=100.0, packed=True))
    )
    assert row.case == "BM3D 32×32"
    assert 0 < row.floor_ms < row.ms
    # 16 rows of 32 columns at 39² displacements in each stage, 12 operations a column
    assert denoisers.work("BM3D", 32).flops == 2 * 16 * 32 * 39**2 * 12
    assert denoisers.work("TV", 32) is None


@pytest.mark.skipif(not denoisers.SCRIPT.is_file(), reason="the peers need a checkout of the repository")
def test_the_peers_say_what_is_missing():
    row = next(
        denoisers.denoiser_cases(BenchSpec(seconds=0.0), Machine(cpu="", bandwidth=10.0, peak=100.0, packed=True))
    )
    (found,) = denoisers.compare({row.case: row}, sys.executable)
    assert (found["case"], found["peer"].split()[0]) == (row.case, "bm3d")
    assert found["skipped"] == "it is not installed" if found["ms"] is None else found["ratio"] > 1
    assert not list(denoisers.compare({}, sys.executable))
