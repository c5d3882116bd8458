"""Designs of tiles that repeat over a mask: what one costs is its share of what the whole mask costs."""

import itertools
import math

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.codes._board import meetings
from shadowgram.codes._design import Weights, _board, design, exchange
from shadowgram.operators import as_matrix


def camera(ny, nx, s, ratio=1, **changes):
    geometry = {"detector_shape": (ny, nx), "detector_pitch": 10.0 * ratio, "code_pitch": 10.0, "mask_position": s}
    return sg.SSCSI(wavelengths=(450.0, 650.0), **(geometry | changes))


def cassi(kind, *shape, **changes):
    return kind(cube_shape=shape, wavelengths=(450.0, 650.0), **changes)


# Imagers whose voxels see nothing beside the mask, which is a whole number of the tiles.
WHOLE = [
    (camera(8, 16, 0.25, shear="edge"), (4, 8)),
    (camera(4, 16, 0.25), (4, 8)),
    (camera(5, 16, 0.25), (5, 16)),
    (camera(2, 8, 0.25, 2), (4, 8)),
    (camera(4, 8, 0.5, 2, shear="edge"), (8, 16)),
    (camera(6, 12, 0.25), (3, 6)),
    (cassi(sg.CASSI, 3, 6, 12), (3, 4)),
    (cassi(sg.CASSI, 3, 4, 12, band_shift=1.3, shear="exact"), (4, 12)),
    (cassi(sg.DualCASSI, 3, 6, 14), (3, 8)),
]
# Tiles that fit a mask only in part, and the narrowest possible.
PARTS = [
    (camera(11, 22, 0.25), (6, 13)),
    (camera(4, 10, 0.3, 2), (6, 11)),
    (camera(8, 19, 0.2, dispersion_ratio=1.5), (6, 9)),
    (camera(5, 9, 0.3), (5, 9)),
    (cassi(sg.DualCASSI, 3, 4, 9, band_shift=0.7, shear="exact"), (3, 7)),
    (camera(16, 32, 0.25), (9, 10)),
    (cassi(sg.CASSI, 6, 9, 12), (9, 6)),
]
# Lower or narrower than L: an element stands within the reach of its own copies.
LOW = [
    (camera(3, 16, 0.25), (1, 16)),
    (camera(4, 16, 0.25), (2, 8)),
    (camera(2, 8, 0.25, 2), (2, 8)),
    (cassi(sg.CASSI, 5, 6, 12, band_shift=0.4), (6, 3)),
    (cassi(sg.DualCASSI, 3, 2, 14), (2, 8)),
]


def name(value):
    if isinstance(value, tuple):
        return f"{value[0]}x{value[1]}"
    return f"{type(value).__name__}-{'x'.join(map(str, value.code_shape))}-{value.shear}"


def start_of(shots, tile, seed=0):
    return sg.codes.boolean(shots=shots, shape=(1, math.prod(tile)), seed=seed).reshape(shots, *tile)


def repulsion_of(code, bands):
    """Σ 1/distance from the open elements of a tile to all but their own copies in the (2L − 1)² around, on a plane of tiles."""
    _, ny, nx = code.shape
    side = range(1 - bands, bands)
    return sum(
        1 / math.hypot(dy, dx)
        for shot in code
        for y, x in np.argwhere(shot)
        for dy, dx in itertools.product(side, repeat=2)
        if (dy % ny or dx % nx) and shot[(y + dy) % ny, (x + dx) % nx]
    )


def coupling_of(code, gains):
    """Σ_d gains[d] Σ K(Δ) S_d(i) S_d(i + Δ) / 2 over places of a tile and those around, which may be of the next tile."""
    labels = code.argmax(axis=0)
    ny, nx = labels.shape
    half = min(4, (min(ny, nx) - 1) // 2)
    total = 0.0
    for d in range(1, len(gains)):
        met = labels == np.roll(labels, -d, axis=1)
        for dy, dx in itertools.product(range(-half, half + 1), repeat=2):
            if (dy, dx) != (0, 0):
                both = (met & np.roll(met, (-dy, -dx), axis=(0, 1))).sum()
                total += gains[d] / 2 * both * round(4096 * math.exp(-(dy**2 + dx**2) / (2 * 1.5**2))) / 4096
    return total


def gram_of(imager, code, c1, opened=1.0):
    H = as_matrix(imager.operator(code))
    gram = H.T @ H / opened
    own = np.diag(gram)
    return (gram**2).sum() - (own**2).sum() + c1 * ((own - 1) ** 2).sum()


def recomputed(imager, tile_code, weights):
    ny, nx = imager.code_shape
    times = ny // tile_code.shape[1], nx // tile_code.shape[2]
    total = gram_of(imager, np.tile(tile_code, (1, *times)), weights.c1) / math.prod(times)
    if weights.repulsion:
        total += weights.repulsion * repulsion_of(tile_code, imager.resolution.cube_shape[0])
    if weights.coupling:
        total += coupling_of(tile_code, weights.coupling * meetings(imager.pair_table()))
    return total


@pytest.mark.parametrize("coupling", [0.0, 1.3])
@pytest.mark.parametrize(("imager", "tile"), [*WHOLE, *LOW], ids=name)
def test_cost_is_the_share_of_the_repeated_code(imager, tile, coupling):
    weights = Weights(c1=2.5, repulsion=0.7, coupling=coupling)
    for seed in range(3):
        code = start_of(3, tile, seed)
        cost = _board(imager, code, weights, True).cost()
        assert cost == pytest.approx(recomputed(imager, code, weights), rel=1e-9)


@pytest.mark.parametrize(("imager", "tile"), [*WHOLE, *LOW], ids=name)
def test_cost_of_a_budget_is_the_share_of_the_repeated_code(imager, tile):
    found = design(imager, shots=4, seed=0, c1=2.5, repulsion=0.7, transmittance=0.6, tile=tile, max_sweeps=0)
    times = [n // t for n, t in zip(imager.code_shape, tile, strict=True)]
    opened = found.code.sum(axis=0).mean()
    cost = gram_of(imager, np.tile(found.code, (1, *times)), 2.5, opened) / math.prod(times)
    cost += 0.7 * repulsion_of(found.code, imager.resolution.cube_shape[0])
    assert found.costs[0] == pytest.approx(cost, rel=1e-9)


def check_every_step(board, fresh, elements, step):
    """Moves or exchanges of single elements: each must change the cost by what a new board says."""
    taken, cost = 0, board.cost()
    for place in np.random.default_rng(3).permutation(elements)[:60]:
        change, moved = step(np.array([place]))
        new = fresh(board.code).cost()
        assert abs(cost + change - new) <= 1e-9 * new
        assert new <= cost * (1 + 1e-9)
        cost, taken = new, taken + moved
    return taken


@pytest.mark.parametrize("coupling", [0.0, 1.3])
@pytest.mark.parametrize(("imager", "tile"), [*WHOLE, *PARTS, *LOW], ids=name)
def test_every_move_costs_what_is_recomputed(imager, tile, coupling):
    weights = Weights(c1=2.5, repulsion=0.7, coupling=coupling)
    board, state = _board(imager, start_of(3, tile), weights, True), np.array([1], np.uint64)
    moves = check_every_step(
        board,
        lambda code: _board(imager, code, weights, True),
        math.prod(tile),
        lambda place: board.sweep(place, state),
    )
    assert moves >= 2


@pytest.mark.parametrize(("imager", "tile"), [*WHOLE, *PARTS, *LOW], ids=name)
def test_every_exchange_costs_what_is_recomputed(imager, tile):
    weights = Weights(c1=2.5, repulsion=0.7, coupling=1.3)
    board = _board(imager, start_of(3, tile), weights, True)
    check_every_step(
        board,
        lambda code: _board(imager, code, weights, True),
        math.prod(tile),
        lambda place: board.exchange(place),
    )
    assert (board.code.sum(axis=0) == 1).all()


@pytest.mark.parametrize(("imager", "tile"), [*WHOLE, *LOW], ids=name)
def test_every_move_of_a_budget_costs_what_is_recomputed(imager, tile):
    found = design(imager, shots=4, seed=0, c1=2.5, repulsion=0.7, transmittance=0.6, tile=tile, max_sweeps=0)
    board, state = _board(imager, found.code, found.weights, True), np.array([1], np.uint64)
    moves = check_every_step(
        board,
        lambda code: _board(imager, code, found.weights, True),
        math.prod(tile),
        lambda place: board.sweep(place, state),
    )
    assert moves >= 2


@pytest.mark.parametrize("transmittance", [None, 0.5])
@pytest.mark.parametrize(
    ("imager", "tile"),
    [
        (camera(16, 64, 0.25, dispersion_ratio=0.5), (8, 16)),
        (camera(16, 64, 0.25, shear="edge", dispersion_ratio=0.5), (8, 16)),
        (camera(8, 32, 0.25, 2, dispersion_ratio=0.5), (8, 16)),
        (cassi(sg.DualCASSI, 5, 16, 28), (8, 14)),
    ],
    ids=name,
)
def test_a_tile_may_begin_anywhere(imager, tile, transmittance):
    """Where the detector looks at a whole number of tiles, all columns of a tile are seen alike."""
    found = design(imager, shots=3, seed=0, c1=3.0, transmittance=transmittance, tile=tile, max_sweeps=2)
    rows = getattr(imager, "pitch_ratio", 1)
    for shift in [(rows, 0), (2 * rows, 3), (0, 1), (0, 7), (3 * rows, 11)]:
        board = _board(imager, np.roll(found.code, shift, axis=(1, 2)), found.weights, True)
        assert board.cost() == pytest.approx(found.costs[-1], rel=1e-9)


def test_rows_of_any_tile_may_begin_anywhere():
    imager = cassi(sg.CASSI, 4, 12, 22)
    found = design(imager, shots=3, seed=0, coupling=0.5, tile=(8, 9), max_sweeps=2)
    for rows in (1, 5):
        board = _board(imager, np.roll(found.code, rows, axis=1), found.weights, True)
        assert board.cost() == pytest.approx(found.costs[-1], rel=1e-9)


@pytest.mark.parametrize("imager", [camera(8, 16, 0.25), camera(4, 8, 0.25, 2), cassi(sg.CASSI, 3, 6, 9)], ids=name)
def test_a_tile_as_large_as_the_mask(imager):
    """Only the repulsion crosses its borders."""
    found = design(imager, shots=3, seed=0, repulsion=0.0, tile=imager.code_shape)
    whole = design(imager, shots=3, seed=0, repulsion=0.0)
    assert found.code.shape == (3, *imager.code_shape)
    assert found.costs == pytest.approx(whole.costs, rel=1e-9)
    assert np.array_equal(found.code, whole.code)


def test_a_designed_tile():
    imager = camera(32, 64, 0.125)
    found = design(imager, shots=4, seed=0, coupling=0.5, tile=(16, 32))
    assert (found.code.shape, found.tile, found.converged) == ((4, 16, 32), (16, 32), True)
    assert (found.code.sum(axis=0) == 1).all()
    assert found.costs[-1] < 0.9 * found.costs[0]
    better = exchange(imager, found)
    assert better.costs[-1] < found.costs[-1]
    assert better.costs[-1] == pytest.approx(_board(imager, better.code, found.weights, True).cost(), rel=1e-9)
    boolean = start_of(4, (16, 32), seed=9)
    c1 = found.weights.c1
    repeated = [gram_of(camera(2, 64, 0.125), np.tile(code[:, :2], (1, 1, 2)), c1) for code in (boolean, better.code)]
    assert repeated[1] < 0.9 * repeated[0]


@pytest.mark.parametrize(
    ("imager", "tile", "message"),
    [
        (camera(8, 16, 0.25), (8, 5), "must be at least 6 columns wide, got 5"),
        (camera(8, 16, 0.25), (9, 16), r"at most those of the mask \(8, 16\), got \(9, 16\)"),
        (camera(8, 16, 0.25), (8, 17), r"at most those of the mask \(8, 16\), got \(8, 17\)"),
        (camera(8, 16, 0.25), (0, 16), r"must be \(y, x\) whole elements"),
        (camera(8, 16, 0.25), 8, r"must be \(y, x\) whole elements"),
        (camera(8, 16, 0.25), (7.9, 12), r"must be \(y, x\) whole elements"),
        (camera(8, 16, 0.25), (8, 16, 2), r"must be \(y, x\) whole elements"),
        (camera(4, 8, 0.25, 2), (3, 16), "whole detector rows, 2 code rows each, got 3"),
        (camera(4, 8, 0.25), (2, 6), "13 shots are more than the code has elements"),
    ],
    ids=str,
)
def test_bad_tiles(imager, tile, message):
    with pytest.raises(ValueError, match=message):
        design(imager, shots=13, seed=0, tile=tile)
