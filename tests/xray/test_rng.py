"""The random streams: uniform, independent between draws, histories and seeds, and a function of (seed, history) alone.

Statistical tests are seeded. Each would raise a false alarm for one choice of seeds in 16 000 (4 standard deviations, 6e-5).
"""

import numpy as np
import pytest
from scipy import stats

from shadowgram.xray.montecarlo._jit import SOURCES, entry
from shadowgram.xray.montecarlo.rng import begin, disk, exponential, mix, normal, uniform

ALARM = 6e-5
MASK = (1 << 64) - 1
GOLDEN = 0x9E3779B97F4A7C15


def _entries(sources):
    @entry
    def mixed(values, out):
        for i in range(values.size if sources else 0):
            out[i] = mix(values[i])

    @entry
    def streams(seed, first, stream, out):
        """Row i holds the first numbers of history first + i."""
        for i in range(out.shape[0] if sources else 0):
            begin(stream, seed, first + i)
            for j in range(out.shape[1]):
                out[i, j] = uniform(stream)

    @entry
    def laws(seed, stream, out):
        begin(stream, seed, 0)
        for i in range(out.shape[0] if sources else 0):
            out[i, 0] = exponential(stream)
            out[i, 1] = normal(stream)
            out[i, 2], out[i, 3] = disk(stream)

    return mixed, streams, laws


_mixed, _streams, _laws = _entries(SOURCES)


def draws(seed, first, histories, count):
    out = np.zeros((histories, count))
    _streams(seed, first, np.zeros(2, np.uint64), out)
    return out


def mixes(values):
    out = np.zeros(len(values), np.uint64)
    _mixed(np.asarray(values, np.uint64), out)
    return out


def even(values, bins):
    """Chance of counts as uneven as these, for numbers that should be uniform on [0, 1)."""
    counts = np.bincount((values.ravel() * bins).astype(int), minlength=bins)
    assert len(counts) == bins
    return stats.chisquare(counts).pvalue


def pairs_even(a, b, bins=32):
    return even(((a * bins).astype(int) + b) / bins, bins * bins)


def correlation(a, b):
    """In standard deviations of what independent numbers give."""
    return np.corrcoef(a, b)[0, 1] * np.sqrt(len(a))


# ---- the mixing function -----------------------------------------------------------------------------------------------------


def in_python(z):
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 & MASK
    z = (z ^ (z >> 27)) * 0x94D049BB133111EB & MASK
    return z ^ (z >> 31)


def undone(z):
    """The number that is mixed to z: what a bijection must have."""

    def unshifted(y, by):
        x = y
        for _ in range(64 // by + 1):
            x = y ^ (x >> by)
        return x

    z = unshifted(z, 31) * pow(0x94D049BB133111EB, -1, 1 << 64) & MASK
    z = unshifted(z, 27) * pow(0xBF58476D1CE4E5B9, -1, 1 << 64) & MASK
    return unshifted(z, 30)


SAMPLE = [0, 1, MASK, 1 << 63, *(1 << i for i in range(64)), *range(2, 1000)] + [
    int(z) for z in np.random.default_rng(1).integers(0, MASK, 2000, np.uint64)
]


def test_mix_is_the_function_that_can_be_undone():
    found = [int(z) for z in mixes(SAMPLE)]
    assert found == [in_python(z) for z in SAMPLE]
    assert [undone(z) for z in found] == SAMPLE


def test_mix_gives_the_known_numbers_of_splitmix64():
    state = [(1234567 + i * GOLDEN) & MASK for i in range(1, 6)]
    assert mixes(state).tolist() == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]


def test_every_bit_changes_half_of_the_bits():
    values = np.random.default_rng(2).integers(0, MASK, 4000, np.uint64)
    plain = mixes(values)
    for bit in range(64):
        changed = np.bitwise_count(mixes(values ^ np.uint64(1 << bit)) ^ plain)
        # 64 · 4000 coin flips: 32 ± 0.063
        assert changed.mean() == pytest.approx(32, abs=4 * np.sqrt(16 / 4000))


# ---- streams -----------------------------------------------------------------------------------------------------------------


def by_the_book(seed, history, count):
    """The stream as the module's text describes it, in Python's whole numbers."""
    key = in_python((seed + GOLDEN) & MASK)
    start = in_python((key + history * GOLDEN) & MASK)
    step = start ^ key
    step = (step ^ (step >> 33)) * 0xFF51AFD7ED558CCD & MASK
    step = (step ^ (step >> 33)) * 0xC4CEB9FE1A85EC53 & MASK
    step = (step ^ (step >> 33)) | 1
    return [(in_python((start + k * step) & MASK) >> 11) / 2**53 for k in range(1, count + 1)]


@pytest.mark.parametrize("seed", [0, 1, 12345, 2**40 + 7, 2**63 - 1])
@pytest.mark.parametrize("history", [0, 1, 12_345_678, 10**15])
def test_a_stream_is_a_function_of_seed_and_history(seed, history):
    assert draws(seed, history, 1, 20)[0].tolist() == by_the_book(seed, history, 20)


def test_a_history_is_the_same_alone_and_among_others():
    together = draws(7, 0, 1000, 8)
    for history in (0, 1, 500, 999):
        np.testing.assert_array_equal(draws(7, history, 1, 8)[0], together[history])
    assert not np.array_equal(draws(8, 0, 1000, 8), together)


def test_no_two_streams_begin_alike():
    # Two of 2²⁰ numbers of 53 bits would agree by chance once in 16 000 seeds.
    first = draws(3, 0, 1 << 20, 1).ravel()
    assert len(np.unique(first)) == 1 << 20
    assert first.min() >= 0.0
    assert first.max() < 1.0


@pytest.mark.parametrize("seed", [0, 1, 2**62])
def test_first_draws_of_histories_are_uniform(seed):
    for draw in draws(seed, 0, 1 << 20, 3).T:
        assert even(draw, 1024) > ALARM


def test_a_long_stream_is_uniform():
    assert even(draws(5, 77, 1, 1 << 22), 4096) > ALARM


def test_first_draws_of_seeds_are_uniform():
    first = np.array([draws(seed, 0, 1, 4)[0] for seed in range(1 << 14)])
    for draw in first.T:
        assert even(draw, 256) > ALARM
    assert abs(correlation(first[:-1, 0], first[1:, 0])) < 4


@pytest.mark.parametrize("seed", [0, 1, 31])
def test_neighbouring_histories_are_independent(seed):
    found = draws(seed, 0, 1 << 20, 2)
    for apart in (1, 2, 8, 64, 1024, 1 << 16):
        assert abs(correlation(found[:-apart, 0], found[apart:, 0])) < 4
        # History h's second draw against the first of h + apart: streams that overlap would show here.
        assert abs(correlation(found[:-apart, 1], found[apart:, 0])) < 4
        # Every history in one pair only, else the counts are not those of independent pairs.
        blocks = found[:, 0].reshape(-1, 2, apart)
        assert pairs_even(blocks[:, 0].ravel(), blocks[:, 1].ravel()) > ALARM


def test_draws_of_a_history_are_independent():
    found = draws(9, 0, 1 << 19, 6)
    for i in range(6):
        for j in range(i):
            assert abs(correlation(found[:, i], found[:, j])) < 4
            assert pairs_even(found[:, i], found[:, j]) > ALARM


@pytest.mark.parametrize(("one", "other"), [(0, 1), (1, 2), (0, 1 << 32), (5, (1 << 62) + 5)])
def test_neighbouring_seeds_are_independent(one, other):
    a, b = draws(one, 0, 1 << 19, 1).ravel(), draws(other, 0, 1 << 19, 1).ravel()
    assert abs(correlation(a, b)) < 4
    assert abs(correlation(a[1:], b[:-1])) < 4
    assert pairs_even(a, b) > ALARM


# ---- other laws --------------------------------------------------------------------------------------------------------------


def test_exponential_normal_and_disk():
    found = np.zeros((1 << 20, 4))
    _laws(11, np.zeros(2, np.uint64), found)
    length, deviate, x, y = found.T
    assert length.min() >= 0.0
    assert even(-np.expm1(-length), 1024) > ALARM
    assert even(stats.norm.cdf(deviate), 1024) > ALARM
    squared = x * x + y * y
    assert squared.max() < 1.0
    assert even(squared, 1024) > ALARM
    angle = np.arctan2(y, x) / (2 * np.pi) % 1.0
    assert even(angle, 1024) > ALARM
    assert pairs_even(squared, angle) > ALARM
    assert abs(correlation(length[1:], length[:-1])) < 4
    assert abs(correlation(deviate[1:], deviate[:-1])) < 4
