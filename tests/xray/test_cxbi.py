"""The backscatter imager's operator against dense matrices written with plain loops from the equation."""

import itertools

import numpy as np
import pytest
import scipy.io

import shadowgram as sg
from shadowgram.operators import as_matrix
from shadowgram.xray._cxbi_operator import ListOperator, ReversedOperator, SlidingOperator
from shadowgram.xray.cxbi import sliding_step

CASES = [
    ((4, 6), 9, 1),
    ((5, 7), 12, 2),
    ((3, 3), 2, 1),
    ((1, 8), 5, 3),
    ((7, 4), 6, 5),
    ((6, 1), 4, 1),
    ((5, 5), 1, 1),
    ((2, 9), 6, 8),
]


def box_share(width, k):
    """Share of the light of the cell k places away, by the midpoint rule on shadows that are piecewise linear."""
    if width == 0:
        return float(k == 0)
    n = 200_000
    s = (np.arange(n) + 0.5) / n * width - width / 2
    return np.maximum(0, 1 - np.abs(k + s)).mean()


def sensing_matrix(codes, *, leakage=0.0, penumbra=(0.0, 0.0), sensitivity=None):
    """(shot, cell): what falls on a cell of the target is the code about it, blurred, inside the window."""
    shots, ny, nx = codes.shape
    share = [{k: box_share(w, k) for k in range(-max(ny, nx), max(ny, nx) + 1)} for w in penumbra]
    A = np.zeros((shots, ny, nx))
    for q, i, j, a, b in itertools.product(range(shots), range(ny), range(nx), range(ny), range(nx)):
        passed = leakage + (1 - leakage) * codes[q, a, b]
        A[q, i, j] += share[0][a - i] * share[1][b - j] * passed
    if sensitivity is not None:
        A *= sensitivity
    return A.reshape(shots, -1)


def sliding_codes(shape, shots, step, seed=0, gray=False):
    ny, nx = shape
    rng = np.random.default_rng(seed)
    mask = rng.random((ny, nx + (shots - 1) * step))
    if not gray:
        mask = (mask < 0.5).astype(np.uint8)
        mask[0] = 1  # every window has an open cell
        mask[-1, ::2] = 0 if ny > 1 else mask[-1, ::2]
    return mask, np.stack([mask[:, q * step : q * step + nx] for q in range(shots)])


def core_of(A):
    return getattr(A, "outer", A)


def check(A, wanted):
    assert np.abs(as_matrix(A) - wanted).max() < 1e-12
    assert np.abs(as_matrix(A.H) - wanted.T).max() < 1e-12
    assert sg.testing.dot_test(A) < 1e-12
    assert sg.testing.dot_test(A, np.float32) < 1e-5


@pytest.mark.parametrize(("shape", "shots", "step"), CASES)
@pytest.mark.parametrize("by_fft", [False, True])
def test_sliding_mask_equals_the_dense_matrix(shape, shots, step, by_fft):
    mask, codes = sliding_codes(shape, shots, step, gray=True)
    A = sg.CXBI(shape=shape).operator(mask, step=step)
    if isinstance(A, SlidingOperator):
        A.__dict__["_by_fft"] = by_fft
    check(A, sensing_matrix(codes))
    assert isinstance(A, ListOperator) == (step >= shape[1])


@pytest.mark.parametrize(("shape", "shots", "step"), CASES)
def test_codes_that_slide_are_kept_as_a_strip(shape, shots, step):
    _, codes = sliding_codes(shape, shots, step, gray=True)
    A = sg.CXBI(shape=shape).operator(codes)
    check(A, sensing_matrix(codes))
    if shots > 1 and step < shape[1]:
        assert isinstance(A, SlidingOperator)
        assert A.step == step
        assert A.strip.shape[1] == shape[1] + (shots - 1) * step
        back = sg.CXBI(shape=shape).operator(codes[::-1])
        assert isinstance(back, ReversedOperator)
        check(back, sensing_matrix(codes[::-1]))
    else:
        assert isinstance(A, ListOperator)


@pytest.mark.parametrize("shape", [(4, 6), (5, 7), (1, 3)])
def test_a_list_of_codes_equals_the_dense_matrix(shape):
    codes = np.random.default_rng(1).random((11, *shape))
    A = sg.CXBI(shape=shape).operator(codes)
    assert isinstance(A, ListOperator)
    check(A, sensing_matrix(codes))
    check(sg.CXBI(shape=shape).operator(codes, step=3), sensing_matrix(codes[::3]))


@pytest.mark.parametrize(("shape", "shots", "step"), [((4, 6), 7, 1), ((5, 7), 6, 2), ((3, 2), 4, 2)])
@pytest.mark.parametrize("penumbra", [(0.0, 0.0), (0.3, 0.0), (1.0, 2.0), (2.6, 0.45)])
@pytest.mark.parametrize("leakage", [0.0, 0.07])
@pytest.mark.parametrize("weighted", [False, True])
def test_options_equal_the_dense_matrix(shape, shots, step, penumbra, leakage, weighted):
    _, codes = sliding_codes(shape, shots, step)
    weights = np.random.default_rng(2).random(shape) if weighted else None
    A = sg.CXBI(shape=shape, leakage=leakage, penumbra=penumbra, sensitivity=weights).operator(codes)
    wanted = sensing_matrix(codes, leakage=leakage, penumbra=penumbra, sensitivity=weights)
    # The reference integrates the shadow numerically, to 1e-10 at best.
    assert np.abs(as_matrix(A) - wanted).max() < 1e-9
    assert np.abs(as_matrix(A.H) - as_matrix(A).T).max() < 1e-12
    assert sg.testing.dot_test(A) < 1e-12
    assert sg.testing.dot_test(A, np.float32) < 1e-5


def test_penumbra_weights_are_those_of_overlapping_boxes():
    codes = np.zeros((1, 1, 9))
    codes[0, 0, 4] = 1
    for width, wanted in (
        (0.5, {0: 0.875, 1: 0.0625}),
        (1, {0: 0.75, 1: 0.125}),
        (2, {0: 0.5, 1: 0.25}),
        (3, {0: 1 / 3, 1: 7 / 24, 2: 1 / 24}),
    ):
        row = as_matrix(sg.CXBI(shape=(1, 9), penumbra=(0.0, width)).operator(codes))[0]
        for k, share in wanted.items():
            assert row[4 + k] == pytest.approx(share, abs=1e-14)
            assert row[4 - k] == pytest.approx(share, abs=1e-14)
        assert row.sum() == pytest.approx(1)


@pytest.mark.parametrize(("shape", "shots", "step"), [((8, 40), 700, 1), ((9, 33), 301, 3), ((40, 64), 1500, 1)])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_direct_sums_and_transforms_agree(shape, shots, step, dtype):
    mask, _ = sliding_codes(shape, shots, step, gray=True)
    ways = [SlidingOperator(mask, shape[1], step) for _ in range(2)]
    for A, by_fft in zip(ways, (False, True), strict=True):
        A.__dict__["_by_fft"] = by_fft
    rng = np.random.default_rng(3)
    x, y = rng.random(shape).astype(dtype), rng.random(shots).astype(dtype)
    limit = 1e-12 if dtype == np.float64 else 3e-6
    for a, b in zip(*[(A.forward(x), A.adjoint(y)) for A in ways], strict=True):
        assert a.dtype == b.dtype == dtype
        assert np.abs(a - b).max() < limit * np.abs(a).max()


def test_both_ways_are_taken():
    rng = np.random.default_rng(0)
    assert not sg.CXBI(shape=(32, 32)).operator(rng.random((32, 543)))._by_fft
    assert sg.CXBI(shape=(64, 64)).operator(rng.random((64, 2111)))._by_fft


@pytest.mark.parametrize("shape", [(32, 32), (64, 64)])
def test_threads_change_nothing(shape):
    rng = np.random.default_rng(4)
    mask = rng.random((shape[0], shape[1] + 2047))
    codes = rng.random((900, *shape))
    for A in (sg.CXBI(shape=shape).operator(given) for given in (mask, codes)):
        x, y = rng.random(A.in_shape), rng.random(A.out_shape)
        found = []
        for count in (1, 2, 3):
            with sg.threads(count):
                found.append((A.forward(x), A.adjoint(y)))
        for other in found[1:]:
            assert all(np.array_equal(a, b) for a, b in zip(found[0], other, strict=True))


def test_a_portal_scan_takes_little_memory_and_time():
    """256 × 1024 cells with as many shots as half of them: a matrix would have 34 thousand million numbers."""
    mask = (np.random.default_rng(0).random((256, 1024 + 131071)) < 0.1).astype(np.float32)
    A = sg.CXBI(shape=(256, 1024)).operator(mask)
    assert A.out_shape == (131072,)
    x = np.ones((256, 1024), np.float32)
    counts = A.forward(x)
    columns = mask.sum(axis=0, dtype=np.float64)
    wanted = np.convolve(columns, np.ones(1024), "valid")
    assert np.abs(counts - wanted).max() < 1e-5 * wanted.max()


def test_the_source_data_are_one_sliding_mask(data):
    cells = scipy.io.loadmat(data / "cxbi" / "gate" / "10" / "code_it1.mat")["code_shift"][0]
    code = np.stack(list(cells))
    for step in (1, 2, 4):
        assert sliding_step(code[::step]) == step
        A = sg.CXBI(shape=(32, 32)).operator(code[::step])
        assert A.forward(np.ones((32, 32))).shape == (512 // step,)
        x = np.random.default_rng(0).random((32, 32))
        assert np.abs(A.forward(x) - code[::step].reshape(-1, 1024) @ x.ravel()).max() < 1e-11


BAD = [
    (np.ones((3, 4, 6)), "codes of this imager are"),
    (np.ones((4, 4)), "codes of this imager are"),
    (np.ones((0, 4, 5)), "codes of this imager are"),
    (np.full((2, 4, 5), 255), "divide 8-bit codes by 255"),
    (np.full((2, 4, 5), -0.5), "from 0 to 1"),
    (np.full((2, 4, 5), np.nan), "from 0 to 1"),
    (np.full((2, 4, 5), "a"), "transmittances"),
    (np.stack([np.ones((4, 5)), np.zeros((4, 5))]), "code 1 of 2 has no open cell"),
    (np.eye(4, 20), "shot 4 of 16 sees no open cell"),
    ([np.ones((4, 5)), np.ones((4, 6))], "same size"),
]


@pytest.mark.parametrize(("codes", "message"), BAD)
def test_bad_codes_are_one_clear_line(codes, message):
    with pytest.raises(ValueError, match=message) as caught:
        sg.CXBI(shape=(4, 5)).operator(codes)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shape": (0, 4)}, "shape is"),
        ({"shape": 32}, "shape is"),
        ({"leakage": 1.0}, "leakage"),
        ({"leakage": float("nan")}, "leakage"),
        ({"penumbra": (0.0, -1.0)}, "penumbra"),
        ({"penumbra": (0.0, 99.0)}, "penumbra"),
        ({"penumbra": 0.5}, "penumbra"),
        ({"sensitivity": np.ones((5, 4))}, "sensitivity"),
        ({"sensitivity": np.zeros((4, 5))}, "sensitivity"),
        ({"sensitivity": np.full((4, 5), np.nan)}, "sensitivity"),
    ],
)
def test_bad_geometry_is_one_clear_line(options, message):
    with pytest.raises(ValueError, match=message):
        sg.CXBI(**({"shape": (4, 5)} | options))


@pytest.mark.parametrize("step", [0, 1.5, -2])
def test_a_step_is_a_whole_number(step):
    with pytest.raises(ValueError, match="step"):
        sg.CXBI(shape=(4, 5)).operator(np.ones((4, 9)), step=step)
