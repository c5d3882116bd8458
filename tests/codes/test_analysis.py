"""Spectra, noise colours and clusters of codes."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import shadowgram as sg
from shadowgram.codes.analysis import aapsd, band_power, bartlett, clusters, frequencies, noise_colour

SIZES = ((96, 130), (128, 128), (192, 160))
DENSITIES = (1 / 3, 1 / 5, 1 / 10)


def loops(code, root):
    """Bartlett's spectrum by plain sums, eq. (3.19)."""
    ny, nx = code.shape[1] // root, code.shape[2] // root
    wy, wx = (np.exp(-2j * np.pi * np.outer(np.arange(n), np.arange(n)) / n) for n in (ny, nx))
    spectra = []
    for shot in code:
        for i in range(root):
            for j in range(root):
                part = shot[i * ny : (i + 1) * ny, j * nx : (j + 1) * nx].astype(float)
                if part.any():
                    spectra.append(np.abs(wy @ part @ wx) ** 2 / (part**2).sum())
    return np.mean(spectra, axis=0)


@pytest.mark.parametrize(("shape", "root"), [((2, 12, 20), 2), ((1, 13, 22), 3), ((3, 9, 9), 1), ((1, 11, 9), 4)])
def test_spectrum_is_the_equation(shape, root):
    code = np.random.default_rng(0).random(shape)
    density = bartlett(code, root * root)
    wanted = loops(code.astype(np.float32), root)
    assert density.shape == (shape[1] // root, shape[2] // root)
    np.testing.assert_allclose(density, wanted, rtol=1e-12)
    rows, columns = aapsd(code, root * root)
    np.testing.assert_allclose(rows, [wanted[:, k].mean() for k in range(wanted.shape[1])], rtol=1e-12)
    np.testing.assert_allclose(columns, [wanted[k].mean() for k in range(wanted.shape[0])], rtol=1e-12)


@given(shots=st.integers(1, 3), side=st.integers(4, 12), seed=st.integers(0, 99), root=st.sampled_from([1, 2]))
def test_power_is_normalised_and_shots_average(shots, side, seed, root):
    code = sg.codes.random(shots=shots, shape=(side, side + 3), seed=seed, transmittance=0.7)
    code[:, ::2, ::2] = 1  # no sub-region is empty
    density = bartlett(code, root * root)
    assert density.mean() == pytest.approx(1, rel=1e-12)  # Parseval
    np.testing.assert_allclose(density, np.mean([bartlett(shot, root * root) for shot in code], axis=0), rtol=1e-12)


def test_empty_sub_regions_are_skipped():
    code = np.zeros((2, 8, 8), np.uint8)
    code[0, 1, 2] = 1  # an impulse has a flat spectrum
    np.testing.assert_array_equal(bartlett(code, 4), np.ones((4, 4)))


def test_constant_term_is_the_open_elements_of_a_sub_region():
    assert bartlett(np.tile([0, 1], (8, 4)), 4)[0, 0] == 8


def test_frequencies_fit_the_spectrum():
    wave = 0.5 + 0.5 * np.cos(2 * np.pi * np.arange(32) * 3 / 16)
    rows, _ = aapsd(np.tile(wave, (32, 1)), 4)
    assert frequencies(16)[1 + rows[1:8].argmax()] == 3 / 16


def test_band_power_counts_each_frequency_once():
    code = sg.codes.boolean(shots=2, shape=(64, 96), seed=1)
    rows = aapsd(code)[0]
    parts = [band_power(rows, low, high) for low, high in itertools.pairwise([0, 1 / 24, 1 / 6, 1 / 3, 0.5])]
    assert sum(parts) == pytest.approx(1, rel=1e-12)
    assert parts[0] == pytest.approx((rows[1] + rows[-1]) / rows[1:].sum(), rel=1e-12)
    density = bartlett(code)
    fy, fx = np.meshgrid(frequencies(16), frequencies(24), indexing="ij")
    inside = (np.hypot(fy, fx) > 0.2) & (np.hypot(fy, fx) <= 0.3)
    wanted = density[inside].sum() / (density.sum() - density[0, 0])
    assert band_power(density, 0.2, 0.3) == pytest.approx(wanted, rel=1e-12)


def filtered(shape, density, seed, low, high, axes):
    """Four shots of noise with frequencies from low to high, of which the highest values are open."""
    rng = np.random.default_rng(seed)
    grid = np.meshgrid(*(np.fft.fftfreq(n) for n in shape), indexing="ij")
    frequency = np.sqrt(sum(np.square(grid[axis]) for axis in axes))
    noise = np.fft.fft2(rng.standard_normal((4, *shape)))
    noise[:, (frequency < low) | (frequency > high)] = 0
    noise = np.fft.ifft2(noise).real
    return (noise >= np.quantile(noise, 1 - density, axis=(1, 2), keepdims=True)).astype(np.uint8)


def colours(code, blocks=16):
    """Colours over both axes, along x and along y."""
    return [noise_colour(s, elements=code.size) for s in (bartlett(code, blocks), *aapsd(code, blocks))]


@pytest.mark.parametrize("shape", [(32, 32), (64, 64), *SIZES])
@pytest.mark.parametrize("shots", [1, 2, 3, 10])
def test_patterns_without_order_are_white(shape, shots):
    for seed in range(4):
        for code in (
            sg.codes.random(shots=shots, shape=shape, seed=seed),
            sg.codes.random(shots=shots, shape=shape, seed=seed, transmittance=0.1),
            sg.codes.boolean(shots=max(shots, 2), shape=shape, seed=seed),
        ):
            assert colours(code, 4) == ["white"] * 3
            assert [noise_colour(s) for s in aapsd(code, 16)] == ["white"] * 2  # the default is for 16 sub-regions


@pytest.mark.parametrize("density", DENSITIES)
@pytest.mark.parametrize("shape", SIZES)
def test_colours_of_filtered_noise(shape, density):
    for seed in range(3):
        assert colours(filtered(shape, density, seed, 0.35, 9, (0, 1))) == ["blue"] * 3
        assert colours(filtered(shape, density, seed, 0.15, 0.3, (0, 1)))[0] == "green"
        assert colours(filtered(shape, density, seed, 0, 0.12, (0, 1))) == ["red"] * 3
        assert colours(filtered(shape, density, seed, 0.3, 9, (1,)))[1:] == ["blue", "white"]
        assert colours(filtered(shape, density, seed, 0.15, 0.3, (1,)))[1:] == ["green", "white"]
        assert colours(filtered(shape, density, seed, 0.1, 0.25, (0,)))[1:] == ["white", "green"]
        assert colours(filtered(shape, density, seed, 0, 0.12, (0,)))[1:] == ["white", "red"]


def test_colour_without_the_number_of_elements():
    for density, seed in itertools.product(DENSITIES, range(4)):
        assert noise_colour(aapsd(filtered((128, 128), density, seed, 0.3, 9, (1,))[0])[0]) == "blue"
        assert noise_colour(aapsd(filtered((128, 128), density, seed, 0.12, 0.3, (1,))[0])[0]) == "green"


def test_clusters_further_apart_than_a_sub_region_need_fewer_of_these():
    """Pairs of open elements, about 20 apart: in sub-regions of 16 elements no frequency is low enough to lack."""
    rng = np.random.default_rng(0)
    code = np.zeros((64, 256), np.uint8)
    for row in code:
        for start in 20 * np.arange(12) + rng.integers(20) + rng.integers(-3, 4, 12):
            row[start : start + 4] = 1
    assert noise_colour(aapsd(code, 256)[0], elements=code.size) == "red"
    assert noise_colour(aapsd(code, 4)[0], elements=code.size) == "green"


def runs_by_loops(row):
    return [len(list(group)) for value, group in itertools.groupby(row) if value]


@given(
    seed=st.integers(0, 999),
    p=st.floats(0, 1),
    shape=st.tuples(st.integers(1, 3), st.integers(1, 4), st.integers(1, 9)),
)
def test_clusters_by_loops(seed, p, shape):
    code = (np.random.default_rng(seed).random(shape) < p).astype(np.uint8)
    lengths = [n for shot in code for row in shot for n in runs_by_loops(row)]
    found = clusters(code)
    assert found.histogram.tolist() == [lengths.count(n + 1) for n in range(shape[2])]
    assert found.runs_per_row == len(lengths) / (shape[0] * shape[1])
    assert found.mean_run == pytest.approx(np.mean(lengths) if lengths else 0)
    assert found.transmittance == pytest.approx(code.mean())


@pytest.mark.parametrize("counts", [(1, 8), (3, 8), (7, 8), (0, 5), (5, 5)])
def test_chance_is_the_mean_over_all_rows(counts):
    """Every row of n elements, weighed with its probability."""
    opened, n = counts
    p = opened / n
    wanted = np.zeros(n)
    for row in itertools.product((0, 1), repeat=n):
        for length in runs_by_loops(row):
            wanted[length - 1] += p ** sum(row) * (1 - p) ** (n - sum(row))
    code = np.zeros((2, n), np.uint8)
    code[:, :opened] = 1
    found = clusters(code)
    np.testing.assert_allclose(found.chance_histogram, 2 * wanted, rtol=1e-12, atol=1e-15)
    assert found.chance_runs_per_row == pytest.approx(wanted.sum())
    if opened:
        assert found.chance_mean_run == pytest.approx(n * p / wanted.sum())
        assert found.clustering == pytest.approx(opened / found.chance_mean_run)
    else:
        assert (found.mean_run, found.chance_mean_run, found.clustering) == (0, 0, 1)


def test_random_codes_have_the_runs_of_chance():
    """500,000 elements: a relative spread of the mean run of about 0.2 %, so 1 % is 5 standard deviations."""
    for p in (0.1, 0.5):
        found = clusters(sg.codes.random(shots=2, shape=(500, 500), seed=0, transmittance=p))
        assert found.mean_run == pytest.approx(found.chance_mean_run, rel=0.01)
        assert found.chance_mean_run == pytest.approx(1 / (1 - p), rel=0.003)
    assert clusters(filtered((128, 128), 0.2, 0, 0.1, 0.2, (1,))).clustering > 1.3
    assert clusters(filtered((128, 128), 0.2, 0, 0.3, 9, (1,))).clustering < 0.9


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: aapsd(np.ones((8, 8)), blocks=8), "square number of sub-regions"),
        (lambda: aapsd(np.ones((8, 8)), blocks=0), "square number"),
        (lambda: aapsd(np.ones((8, 8)), blocks=4.0), "square number"),
        (lambda: aapsd(np.ones((8, 7))), r"8 × 7 elements cannot be cut into 4 × 4"),
        (lambda: aapsd(np.zeros((2, 8, 8))), "closed everywhere"),
        (lambda: aapsd(np.ones(8)), r"\(shot, y, x\) or \(y, x\), got the shape \(8,\)"),
        (lambda: aapsd(np.ones((2, 3, 8, 8))), "one band at a time"),
        (lambda: aapsd(2 * np.ones((8, 8))), "transmittance must lie"),
        (lambda: band_power(np.ones(8), 0.3, 0.3), "0 ≤ low < high"),
        (lambda: band_power(np.ones(8), -0.1, 0.3), "0 ≤ low < high"),
        (lambda: band_power(np.ones((2, 2, 2)), 0.1, 0.3), "must be one of aapsd or bartlett"),
        (lambda: noise_colour(np.array([1.0, np.nan])), "not negative"),
        (lambda: noise_colour(np.ones(8), elements=0), "number of elements"),
        (lambda: noise_colour(bartlett(np.ones((8, 8)))), "the same everywhere"),
        (lambda: clusters(np.full((4, 4), 0.5)), "got gray ones"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call()
