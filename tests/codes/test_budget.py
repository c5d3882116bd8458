"""Designs whose elements are open in more than one shot, against brute force."""

import itertools
import math

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.codes._board import Board
from shadowgram.codes._budget import BudgetBoard, budget_start
from shadowgram.codes._design import _board, design
from shadowgram.operators import as_matrix


def camera(ny, nx, s, ratio=1, **changes):
    geometry = {"detector_shape": (ny, nx), "detector_pitch": 10.0 * ratio, "code_pitch": 10.0, "mask_position": s}
    return sg.SSCSI(wavelengths=(450.0, 650.0), **(geometry | changes))


def cassi(kind, *shape, **changes):
    return kind(cube_shape=shape, wavelengths=(450.0, 650.0), **changes)


IMAGERS = [
    *(camera(2, 9, 0.3, shear=shear) for shear in ("edge", "centre", "exact")),
    *(camera(1, 5, 0.3, 2, shear=shear) for shear in ("edge", "exact")),
    camera(2, 4, 0.6, 2),
    camera(1, 3, 0.35, 3),
    camera(2, 9, 0.25, dispersion_ratio=1.6),
    camera(2, 9, 0.4, dispersion_ratio=0.5),
    camera(2, 9, 0.2, bands=5),
    cassi(sg.CASSI, 4, 3, 6),
    cassi(sg.CASSI, 4, 3, 6, shear="exact", band_shift=1.3),
    cassi(sg.DualCASSI, 4, 3, 5),
    cassi(sg.DualCASSI, 4, 3, 5, shear="exact", band_shift=0.7),
]


def name(imager):
    return f"{type(imager).__name__}-{'x'.join(map(str, imager.code_shape))}-{imager.shear}"


def recomputed(imager, code, *, c1=2.5, repulsion=0.7):
    """Eq. (3.17) with HᵀH over the mean number of open shots, and 1/distance over ordered pairs of open elements of a shot."""
    H = as_matrix(imager.operator(code))
    gram = H.T @ H / code.sum(axis=0).mean()
    own, bands = np.diag(gram), imager.resolution.cube_shape[0]
    total = (gram**2).sum() - (own**2).sum() + c1 * ((own - 1) ** 2).sum()
    for shot in code:
        for (y, x), (yy, xx) in itertools.permutations(np.argwhere(shot).tolist(), 2):
            if max(abs(y - yy), abs(x - xx)) < bands:
                total += repulsion / math.hypot(y - yy, x - xx)
    return total


def start_of(imager, shots=4, transmittance=0.55):
    return design(
        imager, shots=shots, seed=0, c1=2.5, repulsion=0.7, transmittance=transmittance, tolerance=0, max_sweeps=0
    )


@pytest.mark.parametrize("imager", IMAGERS, ids=name)
def test_every_move_costs_what_is_recomputed(imager):
    start = start_of(imager)
    board, state = _board(imager, start.code, start.weights, False), np.array([1], np.uint64)
    assert isinstance(board, BudgetBoard)
    opened, code, moves = start.code.sum(axis=0), start.code, 0
    cost = recomputed(imager, code)
    assert start.costs == pytest.approx([cost], rel=1e-9)
    for place in np.random.default_rng(0).permutation(code[0].size):
        change, moved = board.sweep(np.array([place]), state)
        assert np.array_equal(board.code.sum(axis=0), opened)
        changed = np.argwhere((board.code != code).any(axis=0).ravel())
        assert changed.ravel().tolist() == [place] * moved
        code = board.code
        new = recomputed(imager, code)
        assert abs(cost + change - new) <= 1e-9 * new
        assert new <= cost * (1 + 1e-9)
        cost, moves = new, moves + moved
    assert moves >= 4
    assert board.cost() == pytest.approx(cost, rel=1e-9)


@pytest.mark.parametrize("imager", [IMAGERS[2], IMAGERS[4], IMAGERS[10], IMAGERS[13]], ids=name)
def test_chosen_move_is_the_cheapest(imager):
    start = start_of(imager)
    board, state, moves = _board(imager, start.code, start.weights, False), np.array([1], np.uint64), 0
    for place in np.random.default_rng(1).permutation(start.code[0].size)[:6]:
        before = board.code
        opened = before.reshape(4, -1)[:, place]
        costs = [recomputed(imager, before)]
        for taken, given in itertools.product(np.flatnonzero(opened), np.flatnonzero(opened == 0)):
            other = before.copy()
            other.reshape(4, -1)[[taken, given], place] = 0, 1
            costs.append(recomputed(imager, other))
        moves += board.sweep(np.array([place]), state)[1]
        assert recomputed(imager, board.code) <= min(costs) * (1 + 1e-9)
    assert moves >= 2


@pytest.mark.parametrize(("shots", "transmittance"), [(4, 0.55), (3, 0.5), (8, 0.25), (2, 0.9), (7, 0.2)])
def test_light_is_what_was_asked(shots, transmittance):
    imager = camera(9, 16, 0.25)
    start = design(imager, shots=shots, seed=3, transmittance=transmittance, max_sweeps=0)
    found = design(imager, shots=shots, seed=3, transmittance=transmittance, max_sweeps=3)
    opened = found.code.sum(axis=0, dtype=int)
    assert abs(found.code.mean() - transmittance) < 1 / found.code.size
    assert set(np.unique(opened)) <= {math.floor(shots * transmittance), math.ceil(shots * transmittance)}
    assert np.array_equal(opened, start.code.sum(axis=0))
    assert not np.array_equal(found.code, start.code)
    assert found.costs[-1] < found.costs[0]
    assert found.costs[-1] == pytest.approx(_board(imager, found.code, found.weights, False).cost(), rel=1e-9)


def test_a_start_is_spread_evenly():
    code = budget_start(5, (40, 50), 0.5, np.random.default_rng(0))
    assert set(np.unique(code.sum(axis=0))) == {2, 3}
    assert code.mean() == 0.5
    assert np.abs(code.mean(axis=(1, 2)) - 0.5).max() < 0.04  # 3.6 standard deviations
    assert np.abs(code.mean(axis=(0, 1)) - 0.5).max() < 0.15


def test_as_many_shots_as_a_set_holds():
    """The last shot is the highest bit of a number."""
    imager = camera(7, 10, 0.3)
    start = start_of(imager, shots=64, transmittance=0.4)
    assert start.costs[0] == pytest.approx(recomputed(imager, start.code), rel=1e-9)
    assert start.code[63].any()
    board = _board(imager, start.code, start.weights, False)
    assert np.array_equal(board.code, start.code)
    change, moves = board.sweep(np.arange(70), np.array([1], np.uint64))
    assert moves > 0
    assert start.costs[0] + change == pytest.approx(recomputed(imager, board.code), rel=1e-9)


def test_the_least_light_is_the_complementary_code():
    imager = camera(9, 12, 0.25)
    found, plain = design(imager, shots=4, seed=0, transmittance=0.25), design(imager, shots=4, seed=0)
    assert np.array_equal(found.code, plain.code)
    assert found.costs == plain.costs


def test_both_boards_agree_on_a_complementary_code():
    imager = camera(4, 10, 0.3)
    code = sg.codes.boolean(shots=3, shape=imager.code_shape, seed=0)
    table = imager.pair_table()
    budget = BudgetBoard(table, code, c1=2.5, repulsion=0.7, wrap=False)
    board = Board(table, code, c1=2.5, repulsion=0.7, coupling=0.0, wrap=False)
    assert budget.cost() == pytest.approx(board.cost(), rel=1e-12)


def test_seeds():
    imager = camera(9, 12, 0.25)
    one, again, other = (design(imager, shots=4, seed=seed, transmittance=0.5) for seed in (0, 0, 1))
    assert np.array_equal(one.code, again.code)
    assert one.costs == again.costs
    assert not np.array_equal(one.code, other.code)
    assert one.converged


@pytest.mark.parametrize(
    ("shots", "choices", "message"),
    [
        (3, {"transmittance": 0.3}, "between 1/3, the complementary code, and 1, got 0.3"),
        (3, {"transmittance": 0.0}, "between 1/3"),
        (3, {"transmittance": 1.0}, "between 1/3"),
        (3, {"transmittance": math.nan}, "between 1/3"),
        (
            3,
            {"transmittance": 0.5, "coupling": 1.0},
            "coupling is for codes of one mask whose elements are open in one",
        ),
        (65, {"transmittance": 0.5}, "for at most 64 shots, got 65"),
    ],
    ids=str,
)
def test_bad_input(shots, choices, message):
    with pytest.raises(ValueError, match=message):
        design(camera(9, 12, 0.25), shots=shots, seed=0, **choices)
