"""Correlation codes against their definitions, in plain loops, and matrices against what defines them."""

import numpy as np
import pytest

from shadowgram.codes.classical import (
    correlate,
    decoding,
    hadamard,
    hadamard_code,
    linear_mura,
    mosaic,
    mura,
    s_code,
    s_matrix,
    ura,
)


def periodic_correlation(a, g):
    """Σ_i a(i) g(i + s) at every displacement s, with plain loops."""
    ny, nx = a.shape
    out = np.zeros((ny, nx))
    for sy in range(ny):
        for sx in range(nx):
            for y in range(ny):
                for x in range(nx):
                    out[sy, sx] += float(a[y, x]) * float(g[(y + sy) % ny, (x + sx) % nx])
    return out


def element(r, s, i, j):
    """A(i, j) of a URA (r = s + 2) or MURA (r = s), as published."""
    residues_r, residues_s = ({k * k % n for k in range(1, n)} for n in (r, s))
    if i == 0:
        return 0
    if j == 0:
        return 1
    return int((i in residues_r) == (j in residues_s))


BASIC = {
    "ura(5, 3)": ura(5, 3),
    "ura(3, 5)": ura(3, 5),
    "ura(13, 11)": ura(13, 11),
    "mura(3)": mura(3),
    "mura(5)": mura(5),
    "mura(7)": mura(7),
    "mura(11)": mura(11),
    "mura(13)": mura(13),
    "linear_mura(5)": linear_mura(5),
    "linear_mura(29)": linear_mura(29),
}


def test_patterns_are_the_published_ones():
    assert all(ura(7, 5)[i, j] == element(7, 5, i, j) for i in range(7) for j in range(5))
    assert all(ura(5, 7)[j, i] == element(7, 5, i, j) for i in range(7) for j in range(5))
    assert all(mura(11)[i, j] == element(11, 11, i, j) for i in range(11) for j in range(11))
    assert linear_mura(5).tolist() == [[0, 1, 0, 0, 1]]


@pytest.mark.parametrize(("p", "q"), [(5, 3), (3, 5), (7, 5), (13, 11)])
def test_autocorrelation_of_a_ura_has_two_values(p, q):
    pattern = ura(p, q)
    overlap = periodic_correlation(pattern, pattern)
    assert pattern.dtype == np.uint8
    assert overlap[0, 0] == pattern.sum() == (p * q + 1) // 2
    assert set(overlap.ravel()[1:]) == {(p * q + 1) // 4}


@pytest.mark.parametrize("name", BASIC)
def test_sidelobes_of_the_decoding_array_are_flat(name):
    pattern = BASIC[name]
    image = periodic_correlation(pattern, decoding(pattern))
    assert image[0, 0] == pytest.approx(1, abs=1e-12)
    assert np.abs(image.ravel()[1:]).max() < 1e-12


@pytest.mark.parametrize("name", BASIC)
def test_decoding_array_is_the_published_one(name):
    """+1 behind open elements and −1 behind closed ones, but +1 at the origin of a MURA."""
    pattern = BASIC[name]
    published = np.where(pattern, 1.0, -1.0)
    if "mura" in name:
        published[0, 0] = 1
    assert np.array_equal(decoding(pattern), published / pattern.sum())


@pytest.mark.parametrize(
    "pattern",
    [np.roll(mura(7), (2, 5), axis=(0, 1)), mura(7).T, 1 - ura(7, 5), np.random.default_rng(1).random((6, 9))],
    ids=["rolled", "transposed", "complement", "gray"],
)
def test_decoding_other_patterns(pattern):
    image = periodic_correlation(pattern, decoding(pattern))
    image[0, 0] -= 1
    assert np.abs(image).max() < 1e-12


@pytest.mark.parametrize("name", BASIC)
def test_mosaic_repeats_the_pattern(name):
    pattern = BASIC[name]
    p, q = pattern.shape
    mask = mosaic(pattern)
    assert mask.shape == (2 * p - 1, 2 * q - 1)
    for y in range(2 * p - 1):
        for x in range(2 * q - 1):
            assert mask[y, x] == pattern[(y - p + 1) % p, (x - q + 1) % q]


@pytest.mark.parametrize("pattern", [ura(7, 5), mura(7), linear_mura(13)], ids=["ura", "mura", "linear"])
def test_a_point_decodes_to_a_single_peak(pattern):
    """A point source shines through the mosaic on the detector; the decoding array is laid on it at every displacement."""
    p, q = pattern.shape
    mask, g = mosaic(pattern), decoding(pattern)
    for sy, sx in [(0, 0), (p // 2, q // 2), (p - 1, 1)]:
        detector = [[3.0 * mask[y + p - 1 - sy, x + q - 1 - sx] for x in range(q)] for y in range(p)]
        got = correlate(np.array(detector), g)
        for ty in range(p):
            for tx in range(q):
                want = sum(detector[y][x] * g[(y - ty) % p, (x - tx) % q] for y in range(p) for x in range(q))
                assert got[ty, tx] == pytest.approx(want, abs=1e-12)
                assert want == pytest.approx(3.0 if (ty, tx) == (sy, sx) else 0.0, abs=1e-12)


@pytest.mark.parametrize("pattern", [ura(11, 13), mura(17)], ids=["ura", "mura"])
def test_scenes_are_recovered(pattern):
    p, q = pattern.shape
    scenes = np.random.default_rng(0).random((2, p, q))
    mask = mosaic(pattern)
    snapshots = np.zeros_like(scenes)
    for sy in range(p):
        for sx in range(q):
            shadow = mask[p - 1 - sy : 2 * p - 1 - sy, q - 1 - sx : 2 * q - 1 - sx]
            snapshots += scenes[:, sy, sx, None, None] * shadow
    assert np.allclose(correlate(snapshots, decoding(pattern)), scenes, rtol=0, atol=1e-12)


def test_noise_of_the_decoded_image():
    g = decoding(ura(31, 29))
    assert (g**2).sum() == pytest.approx(4 / (31 * 29), rel=0.01)


ORDERS = [1, 2, 4, 8, 12, 16, 20, 24, 28, 32, 36, 40, 44, 48, 56, 60, 64, 68, 72, 76, 80, 84, 88, 96, 104, 108]


@pytest.mark.parametrize("order", ORDERS)
def test_hadamard(order):
    H = hadamard(order)
    assert H.dtype == np.int8
    assert set(H.ravel().tolist()) <= {1, -1}
    wide = H.astype(int)
    assert np.array_equal(wide @ wide.T, order * np.eye(order, dtype=int))
    assert (H[0] == 1).all()
    assert (H[:, 0] == 1).all()


def test_which_hadamard_orders_are_made():
    made = []
    for n in range(1, 110):
        try:
            made.append(len(hadamard(n)))
        except ValueError:
            continue
    assert made == ORDERS


@pytest.mark.parametrize("order", [1, 3, 7, 11, 15, 19, 23, 31, 35, 43, 47, 63, 67, 127, 143, 255, 323, 511])
def test_s_matrix(order):
    S = s_matrix(order)
    assert S.dtype == np.uint8
    assert set(S.ravel().tolist()) <= {0, 1}
    S = S.astype(int)
    J, identity = np.ones((order, order), int), np.eye(order, dtype=int)
    assert np.array_equal(4 * S @ S.T, (order + 1) * (identity + J))
    assert np.array_equal(2 * (2 * S.T - J) @ S, (order + 1) * identity)
    assert all(np.array_equal(np.roll(S[i - 1], -1), S[i]) for i in range(1, order))


@pytest.mark.parametrize("shape", [(20, 30), (7, 11)])
@pytest.mark.parametrize("shots", [1, 7, 15, 35])
def test_s_code_deals_the_columns_out_equally(shots, shape):
    code = s_code(shots=shots, shape=shape, seed=4)
    assert code.shape == (shots, *shape)
    assert code.dtype == np.uint8
    assert (code.sum(axis=0) == (shots + 1) // 2).all()
    columns, counts = np.unique(code.reshape(shots, -1), axis=1, return_counts=True)
    assert {tuple(c) for c in columns.T} == {tuple(c) for c in s_matrix(shots).T}
    assert np.ptp(counts) <= 1
    assert np.array_equal(code, s_code(shots=shots, shape=shape, seed=4))
    assert shots == 1 or not np.array_equal(code, s_code(shots=shots, shape=shape, seed=5))


def test_columns_lie_at_random_places():
    """Neighbours share a column as often as chance says, 1 in 7: within 5 standard deviations."""
    code = s_code(shots=7, shape=(100, 100), seed=0)
    same = (code[:, :, 1:] == code[:, :, :-1]).all(axis=0)
    assert abs(same.mean() - 1 / 7) < 5 * (6 / 49 / same.size) ** 0.5


@pytest.mark.parametrize("shots", [2, 8, 12])
def test_hadamard_code(shots):
    code = hadamard_code(shots=shots, shape=(24, 24), seed=1)
    assert code.dtype == np.uint8
    assert code[0].all()
    assert (code[1:].sum(axis=(1, 2)) == 24 * 24 // 2).all()
    opened, counts = np.unique(code.sum(axis=0), return_counts=True)
    assert dict(zip(opened.tolist(), counts.tolist(), strict=True)) == {
        shots // 2: 576 - 576 // shots,
        shots: 576 // shots,
    }
    # What elements of 1 and −1 would give.
    signed = 2 * code.astype(int) - code[0]
    columns = {tuple(c) for c in signed.reshape(shots, -1).T.tolist()}
    assert columns == {tuple(c) for c in hadamard(shots).T.tolist()}


@pytest.mark.parametrize("n", [7, 15, 31])
def test_gain_of_multiplexing(n):
    """The numbers of the docstrings, from the inverse matrix: additive noise of unit variance, then photon noise."""
    inverse = np.linalg.inv(s_matrix(n).astype(float))
    assert (inverse**2).sum(axis=1) ** -0.5 == pytest.approx((n + 1) / (2 * n**0.5))
    x = np.random.default_rng(0).random(n)
    assert inverse**2 @ (s_matrix(n) @ x) == pytest.approx(2 * x.sum() / (n + 1))
    half = np.linalg.inv((hadamard(n + 1) + 1) / 2)
    gains = (half**2).sum(axis=1) ** -0.5
    assert gains[1:] == pytest.approx((n + 1) ** 0.5 / 2)
    assert gains[0] == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ura(9, 7), r"twin primes.* got \(9, 7\); use \(7, 5\) or \(13, 11\)"),
        (lambda: ura(7, 3), r"use \(5, 3\) or \(7, 5\)"),
        (lambda: ura(-5, 1), r"use \(5, 3\)"),
        (lambda: ura(5.0, 3), "p must be a whole number, got 5.0"),
        (lambda: mura(9), "odd prime, got p=9; use 7 or 11"),
        (lambda: mura(2), "odd prime, got p=2; use 3$"),
        (lambda: mura(-3), "use 3$"),
        (lambda: linear_mura(7), r"prime 4m \+ 1, got 7; use 5 or 13"),
        (lambda: linear_mura(1), "use 5$"),
        (lambda: mosaic(np.ones(3)), r"shape \(y, x\), got \(3,\)"),
        (lambda: decoding(np.ones((3, 3))), "spectrum of this pattern has a zero"),
        (lambda: decoding(np.zeros((3, 3))), "spectrum of this pattern has a zero"),
        (lambda: decoding(255 * mura(3)), "divide an 8-bit code by 255"),
        (lambda: correlate(np.ones((5, 3)), decoding(mura(5))), r"as large as .* got \(5, 3\) and \(5, 5\)"),
        (lambda: hadamard(6), "order 6 can be made here; use 4 or 8"),
        (lambda: hadamard(92), "use 88 or 96"),
        (lambda: hadamard(0), "use 1$"),
        (lambda: s_matrix(6), "order 6 can be made here; use 3 or 7"),
        (lambda: s_matrix(0), "use 1$"),
        (lambda: s_matrix(27), "use 23 or 31"),
        (lambda: s_code(shots=8, shape=(4, 4), seed=0), "use 7 or 11"),
        (lambda: s_code(shots=7, shape=(4, 0), seed=0), r"must be \(y, x\)"),
        (lambda: s_code(shots=7, shape=(4, 4), seed=-1), "seed must be a whole number"),
        (lambda: hadamard_code(shots=3, shape=(4, 4), seed=0), "use 2 or 4"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call()
