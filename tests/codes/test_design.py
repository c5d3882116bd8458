"""The design of codes against brute force: the cost (3.17) from dense matrices and plain loops, after every move."""

import itertools
import math

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.codes._board import meetings
from shadowgram.codes._design import Weights, _board, design, exchange
from shadowgram.operators import as_matrix

# The displacement curve of a prism, px; both ends are extended.
PRISM = ((460.0, 0.0), (500.0, 0.7), (560.0, 1.5), (640.0, 2.1))
WEIGHTS = Weights(c1=2.5, repulsion=0.7, coupling=0.0)


def camera(ny, nx, s, ratio=1, **changes):
    geometry = {"detector_shape": (ny, nx), "detector_pitch": 10.0 * ratio, "code_pitch": 10.0, "mask_position": s}
    return sg.SSCSI(wavelengths=(450.0, 650.0), **(geometry | changes))


def cassi(kind, *shape, **changes):
    return kind(cube_shape=shape, wavelengths=(450.0, 650.0), **changes)


# Both regimes and their border, Δd/Δc of 1, 2 and 3, β on either side of 1, given bands, the mask on the detector and far from it.
SSCSIS = [
    *(camera(3, 9, 0.3, shear=shear) for shear in ("edge", "centre", "exact")),
    *(camera(2, 5, 0.3, 2, shear=shear) for shear in ("edge", "centre", "exact")),
    *(camera(2, 6, 0.5, 2, shear=shear) for shear in ("edge", "exact")),
    *(camera(2, 5, 0.6, 2, shear=shear) for shear in ("edge", "centre", "exact")),
    *(camera(1, 3, 0.35, 3, shear=shear) for shear in ("edge", "exact")),
    camera(1, 3, 0.75, 3),
    camera(2, 11, 0.25, dispersion_ratio=1.6),
    camera(3, 11, 0.4, dispersion_ratio=0.5),
    camera(2, 4, 0.25, 2, dispersion_ratio=1.7),
    camera(3, 9, 0.2, bands=5),
    camera(3, 8, 0.3, bands=2, shear="edge"),
    camera(2, 5, 0.25, 2, bands=4),
    camera(2, 4, 0.0, 2),
    camera(4, 7, 0.96),
    camera(1, 14, 0.25),
    camera(7, 2, 0.6),
]
LAWS = [
    {},
    {"shear": "exact"},
    {"band_shift": 2},
    {"band_shift": 1.3},
    {"band_shift": 0.7, "shear": "exact"},
    {"band_shift": 0.4},
    {"dispersion": PRISM},
    {"dispersion": PRISM, "shear": "exact"},
    {"shear": "exact", "reference_bands": 2},
]
WIDE = {"band_shift": 1.6, "shear": "exact"}  # a voxel of a dual disperser would see four columns
APART = {"band_shift": 8}  # no two elements meet
SINGLE = [cassi(sg.CASSI, 4, 3, 7, **law) for law in (*LAWS, WIDE, APART)]
DUAL = [cassi(sg.DualCASSI, 4, 3, 6, **law) for law in LAWS]
COLORED = [cassi(sg.ColoredCASSI, 3, 2, 6, **law) for law in (*LAWS, WIDE)]
IMAGERS = [*SSCSIS, *SINGLE, *DUAL, *COLORED]


def name(imager):
    if isinstance(imager, sg.SSCSI):
        kind = f"SSCSI-{imager.shear}-s{imager.mask_position}-ratio{imager.pitch_ratio}-beta{imager.dispersion_ratio}"
        return f"{kind}-bands{imager.bands}"
    law = "curve" if imager.dispersion else imager.band_shift
    return f"{type(imager).__name__}-{imager.shear}-{law}-{imager.reference_bands}"


def bands_of(imager):
    return imager.resolution.cube_shape[0]


def start_of(imager, shots=3, seed=0):
    size = math.prod(imager.code_shape)
    return sg.codes.boolean(shots=shots, shape=(1, size), seed=seed).reshape(shots, *imager.code_shape)


def repulsion_of(code, bands):
    """Σ 1/distance over ordered pairs of open elements of a shot in a window of (2L − 1)²."""
    total = 0.0
    for shot in code.reshape(-1, *code.shape[-2:]):
        opened = np.argwhere(shot)
        apart = np.abs(opened[:, None] - opened).reshape(-1, 2)
        near = apart[(apart.max(axis=1) < bands) & (apart.max(axis=1) > 0)]
        total += (1 / np.hypot(*near.T)).sum()
    return total


def coupling_of(code, gains, wrap=False):
    """Σ_d gains[d] Σ K(Δ) S_d(i) S_d(i + Δ) / 2 over ordered pairs of places, by plain loops."""
    labels = code.argmax(axis=0)
    ny, nx = labels.shape
    half = min(4, (min(ny, nx) - 1) // 2)
    total = 0.0
    for d in range(1, len(gains)):
        met = {
            (y, x)
            for y, x in itertools.product(range(ny), range(nx))
            if (wrap or x + d < nx) and labels[y, x] == labels[y, (x + d) % nx]
        }
        for y, x in met:
            for dy, dx in itertools.product(range(-half, half + 1), repeat=2):
                there = ((y + dy) % ny, (x + dx) % nx) if wrap else (y + dy, x + dx)
                if (dy, dx) != (0, 0) and there in met:
                    total += gains[d] / 2 * round(4096 * math.exp(-(dy**2 + dx**2) / (2 * 1.5**2))) / 4096
    return total


def recomputed(imager, code, weights):
    """Eq. (3.17) from the dense sensing matrix, with the repulsion and the coupling from plain loops."""
    H = as_matrix(imager.operator(code))
    gram = H.T @ H
    own = np.diag(gram)
    total = (gram**2).sum() - (own**2).sum() + weights.c1 * ((own - 1) ** 2).sum()
    if weights.repulsion:
        total += weights.repulsion * repulsion_of(code, bands_of(imager))
    if weights.coupling:
        total += coupling_of(code, weights.coupling * meetings(imager.pair_table()))
    return total


def by_loops(imager, code, weights):
    """Eq. (3.17) as it is written, pixel by pixel: G[k, l] = Σ_q t̂[k] t̂[l] where every pixel is one column of voxels."""
    seen = imager.effective_code(code)
    _, bands, ny, nx = seen.shape
    total = weights.repulsion * repulsion_of(code, bands)
    for m, n, k, l in itertools.product(range(ny), range(nx), range(bands), range(bands)):
        G = sum(shot[k, m, n] * shot[l, m, n] for shot in seen)
        total += weights.c1 * (G - 1) ** 2 if k == l else G**2
    return total


def seeded():
    return np.array([1], np.uint64)


def check_every_move(imager, weights, sweeps=1):
    """Sweep element by element, recomputing the cost after every accepted move; the number of moves."""
    code = start_of(imager)
    board, state, rng = _board(imager, code, weights, False), seeded(), np.random.default_rng(5)
    cost, moves = recomputed(imager, code, weights), 0
    assert board.cost() == pytest.approx(cost, rel=1e-9)
    for place in np.concatenate([rng.permutation(code[0].size) for _ in range(sweeps)]):
        change, moved = board.sweep(np.array([place]), state)
        changed = np.argwhere(board.code.argmax(axis=0).ravel() != code.argmax(axis=0).ravel())
        assert changed.ravel().tolist() == [place] * moved
        if not moved:
            assert change == 0
            continue
        code = board.code
        new = recomputed(imager, code, weights)
        assert abs(cost + change - new) <= 1e-9 * new
        assert new <= cost * (1 + 1e-9)
        cost, moves = new, moves + 1
    assert board.cost() == pytest.approx(cost, rel=1e-9)
    assert (code.sum(axis=0) == 1).all()
    return moves


@pytest.mark.parametrize("imager", IMAGERS, ids=name)
def test_every_move_costs_what_is_recomputed(imager):
    assert check_every_move(imager, WEIGHTS, sweeps=2) >= 4


@pytest.mark.parametrize("weights", [(0.0, 0.0), (0.0, 3.0), (40.0, 0.0)], ids=str)
@pytest.mark.parametrize("imager", [SSCSIS[2], SSCSIS[5], SINGLE[1], DUAL[4], COLORED[1]], ids=name)
def test_every_move_with_other_weights(imager, weights):
    assert check_every_move(imager, Weights(c1=weights[0], repulsion=weights[1], coupling=0.0)) >= 3


@pytest.mark.parametrize(
    "imager",
    [
        *(camera(5, 9, 0.3, shear=shear) for shear in ("edge", "exact")),
        camera(2, 4, 0.4, 2),
        camera(3, 5, 0.6, 2),
        camera(4, 7, 0.3, dispersion_ratio=1.5),
        cassi(sg.CASSI, 3, 5, 8),
        cassi(sg.CASSI, 3, 4, 7, band_shift=1.3, shear="exact"),
        cassi(sg.DualCASSI, 3, 6, 5, shear="exact"),
        camera(9, 10, 0.3),
    ],
    ids=name,
)
def test_every_move_with_coupling(imager):
    assert check_every_move(imager, Weights(c1=2.5, repulsion=0.7, coupling=1.3)) >= 5


@pytest.mark.parametrize(
    "imager",
    [*SSCSIS[:3], SSCSIS[14], SSCSIS[15], SSCSIS[17], camera(4, 8, 0.5), *DUAL],
    ids=name,
)
def test_cost_is_the_equation_as_it_is_written(imager):
    found = design(imager, shots=3, seed=0, c1=2.5, repulsion=0.7, max_sweeps=2, tolerance=0)
    assert found.costs[0] == pytest.approx(by_loops(imager, start_of(imager), WEIGHTS), rel=1e-9)
    assert found.costs[-1] == pytest.approx(by_loops(imager, found.code, WEIGHTS), rel=1e-9)


@pytest.mark.parametrize("kind", [sg.CASSI, sg.DualCASSI, sg.ColoredCASSI])
@pytest.mark.parametrize("shear", ["centre", "exact"])
def test_one_band(kind, shear):
    imager = cassi(kind, 1, 4, 5, shear=shear)
    found = design(imager, shots=3, seed=0, max_sweeps=2)
    assert found.costs[-1] == pytest.approx(recomputed(imager, found.code, found.weights), abs=1e-12)
    assert found.costs[-1] <= found.costs[0]
    assert (found.code.sum(axis=0) == 1).all()


def shots_of_element(code, place):
    """The code with the element in each of the shots."""
    flat = code.reshape(len(code), -1)
    for shot in range(len(code)):
        other = flat.copy()
        other[:, place] = 0
        other[shot, place] = 1
        yield other.reshape(code.shape)


def opened_in(code, place):
    return int(code.reshape(len(code), -1)[:, place].argmax())


@pytest.mark.parametrize("coupling", [0.0, 0.8])
@pytest.mark.parametrize(
    "imager",
    [SSCSIS[0], SSCSIS[2], SSCSIS[5], SSCSIS[8], SSCSIS[14], SINGLE[0], DUAL[1], COLORED[4]],
    ids=name,
)
def test_chosen_shot_is_the_cheapest(imager, coupling):
    weights = Weights(c1=2.5, repulsion=0.7, coupling=0.0 if imager in COLORED else coupling)
    code = start_of(imager, shots=4)
    board, state, left = _board(imager, code, weights, False), seeded(), set()
    for place in np.random.default_rng(2).permutation(code[0].size)[:9]:
        costs = [recomputed(imager, one, weights) for one in shots_of_element(board.code, place)]
        old = opened_in(board.code, place)
        change, _ = board.sweep(np.array([place]), state)
        new = opened_in(board.code, place)
        assert costs[new] <= min(costs) * (1 + 1e-9)
        assert change == pytest.approx(costs[new] - costs[old], abs=1e-9 * costs[old])
        left.add((old, new))
    assert len(left) > 3


def test_equal_shots_are_drawn_evenly_and_the_draw_can_be_repeated():
    imager = camera(20, 20, 0.0)  # one band: all codes cost the same
    code = start_of(imager, shots=4)

    def swept(seed):
        board = _board(imager, code, WEIGHTS, False)
        assert board.sweep(np.arange(400), np.array([seed], np.uint64))[0] == 0
        return board.code

    assert np.array_equal(swept(3), swept(3))
    assert not np.array_equal(swept(3), swept(4))
    share = np.mean([swept(seed) for seed in range(10)], axis=(0, 2, 3))
    assert np.abs(share - 0.25).max() < 0.03  # 4.4 standard deviations of 4000 draws


def test_only_the_cheapest_shots_are_drawn():
    """An element with two cheapest shots is opened in either, and never in the dearer one."""
    imager = cassi(sg.CASSI, 2, 1, 4)
    labels = np.array([0, 1, 2, 2])
    code = (labels == np.arange(3)[:, None])[:, None].astype(np.uint8)
    weights = Weights(c1=0.0, repulsion=0.0, coupling=0.0)
    costs = [recomputed(imager, one, weights) for one in shots_of_element(code, 1)]
    assert costs[1] < min(costs[0], costs[2])  # a shot of its own is cheapest
    two = code[[0, 2]] | code[[1, 1]] * np.array([[[1]], [[0]]], np.uint8)
    costs = [recomputed(imager, one, weights) for one in shots_of_element(two, 1)]
    assert costs[0] == costs[1]
    drawn = set()
    for seed in range(20):
        board = _board(imager, two, weights, False)
        board.sweep(np.array([1]), np.array([seed], np.uint64))
        drawn.add(opened_in(board.code, 1))
        board = _board(imager, code, weights, False)
        board.sweep(np.array([1]), np.array([seed], np.uint64))
        assert opened_in(board.code, 1) == 1
    assert drawn == {0, 1}


@pytest.mark.parametrize("shear", ["edge", "exact"])
def test_meetings_of_columns(shear):
    """L − d of the L bands of a pixel have a partner d columns further right, and as many to the left."""
    weights = meetings(camera(4, 16, 0.25, shear=shear).pair_table())
    assert weights == pytest.approx([2 * (4 - d) if d else 0 for d in range(len(weights))])
    shared = np.zeros(4)
    for x, k, l in itertools.product(range(9), range(4), range(4)):
        if k != l and 0 <= x + k - l < 9:
            shared[abs(k - l)] += 1
    assert meetings(cassi(sg.CASSI, 4, 3, 9).pair_table()) == pytest.approx(shared / 9)


@pytest.mark.parametrize("coupling", [0.0, 1.3])
@pytest.mark.parametrize(
    "imager",
    [camera(5, 9, 0.3), camera(2, 4, 0.3, 2), cassi(sg.CASSI, 3, 4, 8), cassi(sg.DualCASSI, 3, 3, 6)],
    ids=name,
)
def test_every_exchange_costs_what_is_recomputed(imager, coupling):
    weights = Weights(c1=2.5, repulsion=0.7, coupling=coupling)
    code = start_of(imager)
    board, exchanges = _board(imager, code, weights, False), 0
    cost, light = recomputed(imager, code, weights), code.sum(axis=(1, 2))
    for place in np.random.default_rng(1).permutation(code[0].size)[:20]:
        before = board.code
        change, moved = board.exchange(np.array([place]))
        assert (board.code.sum(axis=0) == 1).all()
        assert (board.code.sum(axis=(1, 2)) == light).all()
        assert (board.code != before).any(axis=0).sum() == 2 * moved
        new = recomputed(imager, board.code, weights)
        assert abs(cost + change - new) <= 1e-9 * new
        assert change < 0 or not moved
        cost, exchanges = new, exchanges + moved
    assert exchanges >= 5


def test_exchange_takes_the_best_partner():
    imager, weights = camera(6, 9, 0.3), Weights(c1=2.5, repulsion=0.7, coupling=0.5)
    code = start_of(imager)
    cost, exchanges = recomputed(imager, code, weights), 0
    for y, x in itertools.product(range(0, 6, 2), range(0, 9, 2)):
        board = _board(imager, code, weights, False)
        gains = [0.0]
        for yy, xx in itertools.product(range(max(y - 1, 0), min(y + 2, 6)), range(max(x - 2, 0), min(x + 3, 9))):
            other = code.copy()
            other[:, [y, yy], [x, xx]] = other[:, [yy, y], [xx, x]]
            gains.append(recomputed(imager, other, weights) - cost)
        gain, moved = board.exchange(np.array([y * 9 + x]))
        assert gain == pytest.approx(min(gains), abs=1e-9 * cost)
        exchanges += moved
    assert exchanges >= 8


def test_exchange_refines_a_design():
    imager = camera(16, 16, 0.25)
    found = design(imager, shots=3, seed=0, coupling=0.5)
    better = exchange(imager, found)
    light = [one.code.sum(axis=(1, 2)).tolist() for one in (found, better)]
    assert light[0] == light[1]
    assert (better.code.sum(axis=0) == 1).all()
    assert better.costs[: len(found.costs)] == found.costs
    assert len(better.costs) > len(found.costs)
    assert all(b <= a for a, b in itertools.pairwise(better.costs[found.sweeps :]))
    assert better.costs[-1] < found.costs[-1]
    assert better.costs[-1] == pytest.approx(_board(imager, better.code, found.weights, False).cost(), rel=1e-9)
