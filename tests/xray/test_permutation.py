"""The permutation test: its p-values without a target, its finds with one, and its power."""

import numpy as np
import pytest

from shadowgram.xray._captured_kernel import self_correlation
from shadowgram.xray.capture_files import read_capture
from shadowgram.xray.permutation import detection_power, permutation_test


def sliding(rng, rows, columns, shots, share=0.5, step=1):
    strip = (rng.random((rows, columns + step * (shots - 1))) < share).astype(np.uint8)
    return np.stack([strip[:, step * q : step * q + columns] for q in range(shots)])


def drifting(rng, shots):
    """Counts without a target: a bowl-shaped drift and what is left of its wobbles, correlated from shot to shot."""
    slow = 400 * np.linspace(-1, 1, shots) ** 2
    wobble = np.convolve(rng.normal(0, 12, shots + 8), np.ones(9) / 3, "valid")
    return rng.poisson(3000 + slow) + wobble


def share_by_least_squares(codes, values, order, lag):
    """1 − GCV/variance as the docstring says it: ridge regression with a smooth prior, in image space, for one lag."""
    from scipy.ndimage import gaussian_filter

    shots = len(values)
    area = codes.mean(axis=(1, 2))
    terms = np.column_stack([np.polynomial.legendre.legvander(np.linspace(-1, 1, shots), order), area])
    rest = values - terms @ np.linalg.lstsq(terms, values, rcond=None)[0]
    width = max(codes.shape[1:]) / 16
    blurred = np.stack([gaussian_filter(code.astype(float), max(width, 1), mode="reflect").ravel() for code in codes])
    blurred -= blurred.mean(axis=1, keepdims=True)
    blurred -= blurred.mean(axis=0)
    design = np.roll(blurred, lag, axis=0) / np.sqrt((blurred**2).sum() / shots)
    best = -np.inf
    for ridge in np.geomspace(0.02, 200, 17):
        hat = design @ np.linalg.solve(design.T @ design + ridge * np.eye(design.shape[1]), design.T)
        left = np.sum((rest - hat @ rest) ** 2) / np.trace(np.eye(shots) - hat) ** 2 * shots
        best = max(best, 1 - left / np.mean(rest**2))
    return best


def test_statistics_are_those_of_a_plain_ridge_regression():
    rng = np.random.default_rng(0)
    codes = sliding(rng, 7, 10, 90)
    picture = np.zeros((7, 10))
    picture[2:5, 3:7] = 40
    counts = rng.poisson(2000 + (codes * picture).sum(axis=(1, 2))).astype(float)
    found = permutation_test(codes, counts, drift_order=2)
    assert found.statistic == pytest.approx(share_by_least_squares(codes, counts, 2, 0), abs=1e-9)
    for place in (0, 17, -1):
        wanted = share_by_least_squares(codes, counts, 2, found.lags[place])
        assert found.null[place] == pytest.approx(wanted, abs=1e-9)
    assert found.p_value == (1 + (found.null >= found.statistic).sum()) / (1 + len(found.null))


@pytest.mark.parametrize("kind", ["sliding", "separate", "sparse"])
def test_p_values_without_a_target_are_uniform(kind):
    found = []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        if kind == "separate":
            codes = rng.integers(0, 2, (120, 8, 8))
        else:
            codes = sliding(rng, 8, 8, 120, share=0.5 if kind == "sliding" else 0.1)
            codes[~codes.any(axis=(1, 2)), 0, 0] = 1
        counts = drifting(rng, 120) + 300 * codes.mean(axis=(1, 2))  # the open area alone is no picture
        found.append(permutation_test(codes, counts).p_value)
    found = np.sort(found)
    # Kolmogorov's distance stays below 1.63/√n with a probability of 99 %.
    assert np.abs(found - (np.arange(120) + 0.5) / 120).max() < 1.63 / np.sqrt(120)
    # 5 % of 120 is 6, and more than 13 would come once in 300 times.
    assert (found <= 0.05).sum() <= 13


@pytest.mark.parametrize("step", [1, 2])
def test_a_square_is_found_with_the_least_possible_p(step):
    rng = np.random.default_rng(3)
    codes = sliding(rng, 16, 16, 200, step=step)
    picture = np.zeros((16, 16))
    picture[5:10, 4:9] = 14.0
    counts = drifting(rng, 200) + (codes * picture).sum(axis=(1, 2))
    found = permutation_test(codes, counts, drifting(rng, 200))
    assert found.p_value == found.least_p == 1 / (1 + len(found.null))
    assert found.significant
    assert f"p = {found.p_value:.2g}" in found.verdict
    assert not permutation_test(codes, drifting(rng, 200)).significant


def test_lags_begin_where_the_code_is_another_one():
    rng = np.random.default_rng(4)
    codes = sliding(rng, 12, 12, 150)
    along = permutation_test(codes, rng.poisson(900, 150))
    assert 10 <= along.moves_in <= 13
    assert along.lags.tolist() == list(range(along.moves_in, 150 - along.moves_in + 1))
    fast = permutation_test(sliding(rng, 12, 12, 150, step=3), rng.poisson(900, 150))
    assert 3 <= fast.moves_in <= 5
    upright = permutation_test(codes.transpose(0, 2, 1), rng.poisson(900, 150))
    assert upright.moves_in == along.moves_in
    assert permutation_test(rng.integers(0, 2, (60, 12, 12)), rng.poisson(900, 60)).moves_in <= 2
    chosen = permutation_test(codes, rng.poisson(900, 150), lags=range(20, 60))
    assert chosen.lags.tolist() == list(range(20, 60))


def test_codes_that_come_again_are_left_out():
    rng = np.random.default_rng(5)
    codes = np.concatenate([rng.integers(0, 2, (50, 8, 8))] * 3)
    found = permutation_test(codes, rng.poisson(900, 150))
    assert not {50, 100} & set(found.lags.tolist())


def test_large_codes_are_tested_on_blocks():
    rng = np.random.default_rng(10)
    codes = sliding(rng, 40, 130, 160, step=5)
    picture = np.zeros((40, 130))
    picture[10:22, 30:70] = 4.0
    counts = rng.poisson(3000 + (codes * picture).sum(axis=(1, 2)))
    found = permutation_test(codes, counts)
    assert found.p_value == found.least_p
    assert 22 <= found.moves_in <= 30


def test_self_correlation_is_that_of_a_plain_sum():
    codes = sliding(np.random.default_rng(6), 5, 6, 20)
    centred = codes - 0.0
    centred -= centred.mean(axis=(1, 2), keepdims=True)
    for lag in (0, 1, 4, 11):
        later = np.roll(centred, -lag, axis=0)
        best = -np.inf
        for axis in (1, 2):
            for by in range(-5, 6):
                moved = np.zeros_like(later)
                length = later.shape[axis]
                for k in range(length):
                    if 0 <= k + by < length:
                        source = [slice(None)] * 3
                        source[axis], target = k + by, [slice(None)] * 3
                        target[axis] = k
                        moved[tuple(target)] = later[tuple(source)]
                best = max(best, (centred * moved).sum() / (centred**2).sum())
        assert self_correlation(codes)[lag] == pytest.approx(best, abs=1e-5)


def test_power_rises_from_the_level_to_one():
    rng = np.random.default_rng(7)
    codes = sliding(rng, 12, 12, 160)
    counts = rng.poisson(4000, 160)
    found = detection_power(codes, counts, contrasts=(0.0001, 0.05, 0.1, 0.4), simulations=60, seed=1)
    assert found.power[0] < 0.15
    assert found.power[-1] == 1
    assert (np.diff(found.power) >= -0.05).all()
    assert found.side == (3, 3)
    assert 0.0001 < found.smallest < 0.4
    again = detection_power(codes, counts, contrasts=(0.0001, 0.05, 0.1, 0.4), simulations=60, seed=1)
    assert again.power.tolist() == found.power.tolist()
    assert detection_power(codes, counts, contrasts=(0.0001,), simulations=5).smallest == np.inf


def test_power_is_that_of_targets_that_are_really_there():
    rng = np.random.default_rng(8)
    finds = []
    for _ in range(40):
        codes = sliding(rng, 12, 12, 160)
        top, left = rng.integers(0, 10, 2)
        square = codes[:, top : top + 3, left : left + 3].sum(axis=(1, 2))
        finds.append(permutation_test(codes, rng.poisson(3850 + 150 * square / square.mean())).significant)
    expected = detection_power(codes, rng.poisson(4000, 160), contrasts=(0.0375,), simulations=100).power[0]
    assert abs(np.mean(finds) - expected) < 0.25
    assert 0.2 < expected < 0.98


CODES = sliding(np.random.default_rng(9), 6, 6, 60)
WIDE = sliding(np.random.default_rng(9), 10, 60, 60)  # every code shares cells with every other


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: permutation_test(CODES, np.ones(59)), "there are 60 codes and 59 values of counts"),
        (lambda: permutation_test(CODES, np.ones(60)), "explain the counts entirely"),
        (lambda: permutation_test(CODES[:20], np.arange(20.0) ** 2 % 7), "take more shots"),
        (lambda: permutation_test(WIDE, np.arange(60.0) ** 2 % 7), "which leaves 0 lags to compare with"),
        (lambda: permutation_test(CODES, np.arange(60.0) % 7, drift_order=31), "from 0 to half the 60 shots, got 31"),
        (lambda: permutation_test(CODES, np.arange(60.0) % 7, lags=[1, 2]), "leaves 2 lags"),
        (lambda: permutation_test(CODES[:1].repeat(60, 0), np.arange(60.0) % 7), "the same in every shot"),
        (lambda: detection_power(CODES, np.arange(60.0) % 7, side=(7, 2)), "6 × 6 cells, got (7, 2)"),
        (lambda: detection_power(CODES, np.arange(60.0) % 7, 9 + np.arange(60.0) % 5), "not above the background"),
    ],
)
def test_what_cannot_be_is_said_in_a_line(make, message):
    with pytest.raises(ValueError, match=r"^[^\n]+$") as raised:
        make()
    assert message in str(raised.value)


@pytest.fixture(scope="module")
def cxbi(data):
    folder = data / "cxbi"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    return folder


@pytest.mark.parametrize("percent", [1, 10, 50])
@pytest.mark.parametrize("target", ["UD", "box"])
def test_targets_of_the_simulated_scans_are_found(cxbi, percent, target):
    folder = cxbi / "gate" / str(percent)
    scan = read_capture(folder / "code_it1.mat", folder / f"y_{target}.mat", folder / "y_air.mat")
    found = permutation_test(scan.codes, scan.counts, scan.background)
    assert found.p_value == found.least_p < 0.003
    assert found.statistic > 0.5


def test_nothing_is_found_in_the_laboratory_scan_and_a_square_would_be(cxbi):
    folder = cxbi / "experiment"
    scan = read_capture(folder / "codes_bin.mat", folder / "y_target.mat", folder / "y_empty.mat")
    for order in (None, 1, 4, 9):
        assert permutation_test(scan.codes, scan.counts, scan.background, drift_order=order).p_value > 0.2
    power = detection_power(scan.codes, scan.counts, scan.background, contrasts=(0.1, 0.3), side=(7, 7))
    assert power.power[0] > 0.75
    assert power.power[1] == 1
