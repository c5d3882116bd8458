"""Coded apertures: what each family promises."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import shadowgram as sg

sizes = st.tuples(st.integers(1, 9), st.integers(1, 9))


@given(shots=st.integers(1, 7), shape=sizes, seed=st.integers(0, 2**32 - 1))
def test_boolean_is_complementary_with_equal_shots(shots, shape, seed):
    code = sg.codes.boolean(shots=shots, shape=shape, seed=seed)
    assert code.dtype == np.uint8
    assert (code.sum(axis=0) == 1).all()
    counts = code.sum(axis=(1, 2), dtype=int)
    assert counts.max() - counts.min() <= 1
    assert np.array_equal(code, sg.codes.boolean(shots=shots, shape=shape, seed=seed))


def test_seeds_differ():
    one, two = (sg.codes.boolean(shots=3, shape=(16, 16), seed=s) for s in (0, 1))
    assert not np.array_equal(one, two)


@pytest.mark.parametrize("transmittance", [0.1, 0.5, 0.9])
def test_random_transmittance(transmittance):
    """Within 5 standard deviations of the mean: a false alarm in 2 million."""
    code = sg.codes.random(shots=4, shape=(100, 100), seed=0, transmittance=transmittance)
    spread = (transmittance * (1 - transmittance) / code.size) ** 0.5
    assert abs(code.mean() - transmittance) < 5 * spread
    assert np.array_equal(sg.codes.random(shots=1, shape=(3, 3), seed=0, transmittance=1.0), np.ones((1, 3, 3)))


@given(shots=st.integers(1, 5), bands=st.integers(1, 8), shape=sizes, seed=st.integers(0, 99))
def test_ideal_colored_is_complementary_per_voxel(shots, bands, shape, seed):
    code = sg.codes.colored(shots=shots, shape=(bands, *shape), seed=seed)
    assert code.shape == (shots, bands, *shape)
    assert (code.sum(axis=0) == 1).all()


@given(shots=st.integers(2, 5), bands=st.integers(1, 9), shape=sizes, seed=st.integers(0, 99))
def test_four_filters_cover_every_voxel(shots, bands, shape, seed):
    code = sg.codes.colored(shots=shots, shape=(bands, *shape), filters="four", seed=seed)
    assert (code.sum(axis=0) >= 1).all()
    spectra = {tuple(s) for s in code.transpose(0, 2, 3, 1).reshape(-1, bands)}
    assert len(spectra) <= 4


def test_four_filters_are_used_equally():
    code = sg.codes.colored(shots=3, shape=(8, 100, 100), filters="four", seed=0)
    spectra, counts = np.unique(code.transpose(0, 2, 3, 1).reshape(-1, 8), axis=0, return_counts=True)
    assert {"".join(map(str, s)) for s in spectra} == {"11110000", "00001111", "00111100", "11000011"}
    # binomial with p = 1/4 and 30,000 draws, pairs drawn together: 5 standard deviations are about 550
    assert np.abs(counts - 7500).max() < 550


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: sg.codes.boolean(shots=0, shape=(4, 4), seed=0), "at least one shot"),
        (lambda: sg.codes.boolean(shots=2, shape=(4, 4), seed=-1), "seed must be a whole number"),
        (lambda: sg.codes.boolean(shots=2, shape=(4, 0), seed=0), r"must be \(y, x\)"),
        (lambda: sg.codes.boolean(shots=2, shape=(2, 4, 4), seed=0), r"must be \(y, x\)"),
        (lambda: sg.codes.colored(shots=2, shape=(4, 4), seed=0), r"must be \(band, y, x\)"),
        (lambda: sg.codes.colored(shots=1, shape=(4, 4, 4), seed=0, filters="four"), "at least 2 shots"),
        (lambda: sg.codes.colored(shots=2, shape=(4, 4, 4), seed=0, filters="five"), '"ideal" or "four"'),
        (lambda: sg.codes.random(shots=2, shape=(4, 4), seed=0, transmittance=0.0), "transmittance must lie"),
        (lambda: sg.codes.check_code(np.ones((2, 4, 5)), (4, 4)), r"shape \(shot, 4, 4\), got \(2, 4, 5\)"),
        (lambda: sg.codes.check_code(np.ones((0, 4, 4)), (4, 4)), "shape"),
        (lambda: sg.codes.check_code(255 * np.ones((2, 4, 4)), (4, 4)), "divide an 8-bit code by 255"),
        (lambda: sg.codes.check_code(-np.ones((2, 4, 4)), (4, 4)), "transmittance must lie"),
        (lambda: sg.codes.check_code(np.full((2, 4, 4), np.nan), (4, 4)), "transmittance must lie"),
        (lambda: sg.codes.check_code(np.full((2, 4, 4), "a"), (4, 4)), "values of type"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_check_code_keeps_gray_and_packs_binary():
    assert sg.codes.check_code(np.eye(4), (4, 4)).dtype == np.uint8
    assert sg.codes.check_code(np.eye(4) / 2, (4, 4)).dtype == np.float32
    assert sg.codes.check_code(np.eye(4, dtype=bool), (4, 4)).shape == (1, 4, 4)
