"""Halftone codes: complementary, even on a torus, and blue or green in their spectra."""

import numpy as np
import pytest
from scipy import ndimage

from shadowgram.codes import _halftone_kernels as kernels
from shadowgram.codes import boolean, halftone
from shadowgram.codes.halftone import blue_noise, green_noise, void_and_cluster


def spectrum(pattern):
    """(frequencies in cycles per element, power / power of white noise), both (y, x)."""
    share = pattern.mean()
    power = np.abs(np.fft.fft2(pattern - share)) ** 2 / pattern.size / (share * (1 - share))
    radius = np.hypot(np.fft.fftfreq(pattern.shape[0])[:, None], np.fft.fftfreq(pattern.shape[1]))
    radius[0, 0] = np.inf
    return radius, power


def power_below(pattern, frequency):
    radius, power = spectrum(pattern)
    return power[radius < frequency].mean()


def peak(pattern, width=0.02):
    """Frequency of the ring of that width with the largest mean power, and this power."""
    radius, power = spectrum(pattern)
    edges = np.arange(width, 0.7, width)
    rings = [power[(radius >= r) & (radius < r + width)].mean() for r in edges]
    return edges[np.argmax(rings)] + width / 2, max(rings)


def energy(labels, weights):
    """Σ over pairs of elements of the same class, with plain loops; weights[dy, dx] on the torus."""
    ny, nx = labels.shape
    total = 0
    for y in range(ny):
        for x in range(nx):
            for v in range(ny):
                for u in range(nx):
                    if labels[y, x] == labels[v, u]:
                        total += int(weights[(v - y) % ny, (u - x) % nx])
    return total


def on_torus(stencil, shape):
    """weights[dy, dx] of a stencil, at every offset of the torus."""
    full = np.zeros(shape, np.int64)
    for i in range(stencil.weights.shape[0]):
        for j in range(stencil.weights.shape[1]):
            full[(i + stencil.corner[0]) % shape[0], (j + stencil.corner[1]) % shape[1]] += stencil.weights[i, j]
    return full


MAKERS = {
    "blue": lambda **kw: blue_noise(**kw),
    "green": lambda **kw: green_noise(cluster=2.5, **kw),
}


@pytest.mark.parametrize("kind", MAKERS)
@pytest.mark.parametrize(("shots", "shape"), [(1, (5, 7)), (2, (16, 16)), (3, (17, 31)), (7, (6, 9)), (4, (1, 40))])
def test_complementary_with_equal_shots(kind, shots, shape):
    code = MAKERS[kind](shots=shots, shape=shape, seed=3)
    assert code.shape == (shots, *shape)
    assert code.dtype == np.uint8
    assert (code.sum(axis=0) == 1).all()
    assert np.ptp(code.sum(axis=(1, 2), dtype=int)) <= 1
    assert np.array_equal(code, MAKERS[kind](shots=shots, shape=shape, seed=3))


@pytest.mark.parametrize("kind", MAKERS)
def test_seeds_differ(kind):
    one, two = (MAKERS[kind](shots=3, shape=(16, 16), seed=s) for s in (0, 1))
    assert not np.array_equal(one, two)


def test_more_shots_than_elements():
    code = blue_noise(shots=9, shape=(2, 3), seed=0)
    assert code.sum() == 6
    assert (code.sum(axis=0) == 1).all()


def test_every_shot_is_blue():
    """Little power at low frequencies, a peak near the principal frequency √(1/6) = 0.41; a random code has neither."""
    code, white = (make(shots=6, shape=(128, 128), seed=0) for make in (blue_noise, boolean))
    for blue, plain in zip(code, white, strict=True):
        assert power_below(blue, 0.15) < 0.04 < 0.8 < power_below(plain, 0.15)
        frequency, height = peak(blue)
        assert 0.85 < frequency / 6**-0.5 < 1.2
        assert height > 1.4


def test_no_seam():
    """Neighbours across the edge open in the same shot: 1 in 6 for a random code, hardly ever for blue noise."""
    code = blue_noise(shots=6, shape=(90, 130), seed=0)
    inside = (code[:, :-1] & code[:, 1:]).sum() / (89 * 130)
    seams = (code[:, 0] & code[:, -1]).sum() + (code[:, :, 0] & code[:, :, -1]).sum()
    assert inside < 0.01
    assert seams <= 5


@pytest.mark.parametrize("transmittance", [0.01, 0.1, 0.3, 0.5, 0.9])
def test_blue_shots_made_one_by_one(transmittance):
    code = blue_noise(shots=2, shape=(120, 100), seed=0, transmittance=transmittance)
    assert (code.sum(axis=(1, 2), dtype=int) == round(transmittance * 12000)).all()
    principal = min(transmittance, 1 - transmittance) ** 0.5
    for shot in code:
        assert power_below(shot, principal / 4) < 0.05
        # Along y and x a grid carries no more than 1/2 cycle per element.
        assert peak(shot)[0] > 0.8 * min(principal, 0.5)
    # Two shots of their own overlap as often as two random ones: within 5 standard deviations.
    both = transmittance**2
    assert abs((code[0] & code[1]).mean() - both) < 5 * (both * (1 - both) / 12000) ** 0.5


def test_all_open():
    assert blue_noise(shots=2, shape=(4, 5), seed=0, transmittance=1.0).all()
    assert green_noise(shots=2, shape=(4, 5), seed=0, cluster=3, transmittance=1.0).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (5, 3), (16, 10)])
def test_ranks_are_a_permutation(shape):
    rank = void_and_cluster(shape, seed=2)
    assert rank.shape == shape
    assert np.array_equal(np.sort(rank, axis=None), np.arange(rank.size))


def test_every_level_is_blue():
    rank = void_and_cluster((128, 128), seed=0)
    for share in (0.005, 0.02, 0.06, 0.1, 0.2, 0.4, 0.5, 0.7, 0.9, 0.98):
        pattern = rank < round(share * rank.size)
        assert power_below(pattern, min(share, 1 - share) ** 0.5 / 4) < 0.1


def test_voids_are_filled_in_the_order_of_the_definition():
    """Against the definition: sum the weights of all open elements at every closed place, open the place with the least."""
    shape, rng = (7, 10), np.random.default_rng(1)
    pattern = (rng.random(shape) < 0.2).astype(np.int64)
    stencil = halftone._gaussian(1.5, shape)
    weights = on_torus(stencil, shape)
    order = halftone._fill_voids(pattern, 30, stencil, np.random.default_rng(5))
    ties = np.random.default_rng(5).permutation(pattern.size).reshape(shape)
    for place in order:
        sums = np.zeros(shape, np.int64)
        for y, x in np.argwhere(pattern):
            sums += np.roll(weights, (y, x), axis=(0, 1))
        keys = np.where(pattern == 0, sums * pattern.size + ties, np.iinfo(np.int64).max)
        assert place == keys.argmin()
        pattern.flat[place] = 1


@pytest.mark.parametrize(
    ("stencil", "classes"),
    [
        (halftone._gaussian(1.5, (8, 11)), 3),
        (halftone._gaussian(0.6, (8, 11)), 2),
        (halftone._band_pass(0.2, (8, 11)), 4),
    ],
    ids=["folded", "small", "band-pass"],
)
def test_exchanges_end_where_no_exchange_nearby_helps(stencil, classes):
    shape, reach = (8, 11), 2
    weights = on_torus(stencil, shape)
    labels = np.random.default_rng(0).permutation(np.arange(88) % classes).reshape(shape)
    before = labels.copy()
    halftone._exchange(labels, classes, stencil, reach, np.random.default_rng(1))
    assert np.array_equal(np.bincount(labels.ravel()), np.bincount(before.ravel()))
    lowest = energy(labels, weights)
    assert lowest < energy(before, weights)
    near = [(v, u) for v in range(-reach, reach + 1) for u in range(-reach, reach + 1)]
    for y, x in [(0, 0), (3, 5), (7, 10), (6, 0)]:
        for v, u in near:
            other = labels.copy()
            a, b = (y, x), ((y + v) % 8, (x + u) % 11)
            other[a], other[b] = labels[b], labels[a]
            assert energy(other, weights) >= lowest


def test_exchanges_lower_the_energy_of_filled_voids():
    shape = (64, 64)
    stencil, rng = halftone._gaussian(1.5, shape), np.random.default_rng(0)
    pattern = np.zeros(shape, np.int64)
    pattern.flat[halftone._fill_voids(pattern, 700, stencil, rng)] = 1
    before = (halftone._energy(pattern == 1, stencil) * pattern).sum()
    halftone._exchange(pattern, 2, stencil, 4, rng)
    after = (halftone._energy(pattern == 1, stencil) * pattern).sum()
    assert pattern.sum() == 700
    assert after < 0.99 * before


@pytest.mark.parametrize("shape", [(3, 40), (4, 5), (40, 40)])
def test_stencil_is_the_gaussian_summed_over_the_periods(shape):
    got = on_torus(halftone._gaussian(1.7, shape), shape) / halftone._UNIT
    for dy in range(shape[0]):
        for dx in range(shape[1]):
            want = sum(
                np.exp(-((dy + i * shape[0]) ** 2 + (dx + j * shape[1]) ** 2) / (2 * 1.7**2))
                for i in range(-12, 13)
                for j in range(-12, 13)
            )
            assert got[dy, dx] == pytest.approx(want, abs=4e-5)


def test_energy_is_the_circular_convolution():
    shape = (9, 14)
    stencil = halftone._gaussian(1.5, shape)
    pattern = np.random.default_rng(0).random(shape) < 0.3
    want = np.fft.ifft2(np.fft.fft2(pattern) * np.fft.fft2(on_torus(stencil, shape))).real
    assert np.array_equal(halftone._energy(pattern, stencil), np.rint(want).astype(np.int64))


def test_smallest_key_of_a_tree_of_any_size():
    rng = np.random.default_rng(0)
    for n in (1, 2, 3, 5, 12, 31, 32):
        tree = np.empty(2 * n, np.int64)
        keys = rng.permutation(n)
        kernels.grow(tree, keys)
        places = np.empty(n, np.int64)
        kernels.take(places, tree, n, np.zeros((1, 1), np.int64), (0, 0))
        assert np.array_equal(places, keys.argsort())


@pytest.mark.parametrize(("shots", "cluster"), [(4, 6), (6, 4), (6, 9), (12, 3)])
def test_every_shot_is_green(shots, cluster):
    """Clusters of about the asked size, power in a ring at √(g/M), little below it."""
    code = green_noise(shots=shots, shape=(128, 128), seed=0, cluster=cluster)
    ring = (1 / shots / cluster) ** 0.5
    for shot in code:
        frequency, height = peak(shot)
        assert frequency == pytest.approx(ring, abs=0.02)
        assert height > 3
        assert power_below(shot, ring / 2) < 0.1
    # Clusters are counted with diagonal neighbours, on the torus' first period: the cut ones make the mean smaller.
    sizes = [shot.sum() / ndimage.label(shot, np.ones((3, 3)))[1] for shot in code]
    assert 0.8 < np.mean(sizes) / cluster < 1.15


def test_green_shots_made_one_by_one():
    code = green_noise(shots=2, shape=(96, 128), seed=0, cluster=8, transmittance=0.2)
    assert (code.sum(axis=(1, 2), dtype=int) == round(0.2 * 96 * 128)).all()
    assert not np.array_equal(code[0], code[1])
    for shot in code:
        assert peak(shot)[0] == pytest.approx((0.2 / 8) ** 0.5, abs=0.02)
        assert power_below(shot, 0.08) < 0.05


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: blue_noise(shots=0, shape=(4, 4), seed=0), "at least one shot"),
        (lambda: blue_noise(shots=2, shape=(4, 0), seed=0), r"must be \(y, x\)"),
        (lambda: blue_noise(shots=2, shape=(4, 4), seed=-1), "seed must be a whole number"),
        (lambda: blue_noise(shots=2, shape=(4, 4), seed=0, transmittance=1.5), "transmittance must lie"),
        (
            lambda: blue_noise(shots=2, shape=(4, 4), seed=0, transmittance=0.01),
            "opens none of 16 elements; use at least",
        ),
        (
            lambda: green_noise(shots=2, shape=(4, 4), seed=0, cluster=1),
            "between 2 and the 8 elements .* use blue_noise",
        ),
        (lambda: green_noise(shots=2, shape=(4, 4), seed=0, cluster=9), "between 2 and the 8"),
        (lambda: green_noise(shots=2, shape=(4, 4), seed=0, cluster=float("nan")), "between 2 and the 8"),
        (lambda: green_noise(shots=2, shape=(4, 4), seed=0, cluster=3, transmittance=0), "transmittance must lie"),
        (lambda: void_and_cluster((4,), seed=0), r"must be \(y, x\)"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call()
