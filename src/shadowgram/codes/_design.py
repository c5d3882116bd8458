"""Coded apertures designed for an imager: Algorithm 1 of Salazar (2022) for the cost (3.17), kept up to date instead of recomputed.

======================  ===============  ========================================================================================
symbol                  name             meaning
======================  ===============  ========================================================================================
Q, L                    shots            snapshots; bands
c₁                      c1               weight of the diagonal: Σ_v ((HᵀH)_vv − 1)²; large values make the open elements cluster
Ω                       repulsion        weight of Σ 1/distance over pairs of open elements of one shot
                        coupling         weight of pairs of columns that meet in one shot at neighbouring places: not in the source
ε₀                      tolerance        a sweep that changes the cost by less, of that at the start, is the last
======================  ===============  ========================================================================================

Cost = Σ_{v≠v'} (HᵀH)²_vv' + c₁ Σ_v ((HᵀH)_vv − 1)² + repulsion Σ 1/|i − j| + coupling Σ_d w_d Σ K(i' − i) S_d(i) S_d(i').

HᵀH is that of the detector's rows, with the imager's own shear and in either regime; where elements are open in several shots,
it is divided by their mean number. The sum of the repulsion is over open elements i ≠ j of one shot within the (2L − 1)² window
of eq. (3.18); sums over pairs count both orders, but that of the coupling counts each pair of places i, i' once. S_d(i) is 1
where the elements i and i + d of a row are open in the same shot, K a Gaussian of 1.5 elements that reaches 4, and w_d the
number of voxel pairs that meet on columns d apart, for a column of the mask.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np

from shadowgram._threads import run_chunks

from ._design_checks import (
    FilterImager,
    MaskImager,
    band_count,
    check_limits,
    checked_shape,
    checked_start,
    first_code,
    is_colored,
    is_number,
    pairs_of,
)
from .patterns import _generator, check_code

if TYPE_CHECKING:
    from ._colored_board import VoxelPairs
    from ._pairs import PairTable

_LARGEST = 1e100  # weight of a term: above it costs overflow
_BLOCK = 128  # side of the parts in which the elements are visited, and between which the work can be interrupted


class _Board(Protocol):
    @property
    def code(self) -> np.ndarray: ...

    def cost(self) -> float: ...

    def sweep(self, order: np.ndarray, state: np.ndarray) -> tuple[float, int]: ...


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Weights of the terms of the cost; see the top of this module."""

    c1: float
    repulsion: float
    coupling: float

    def __post_init__(self) -> None:
        for name, value in (("c1", self.c1), ("repulsion", self.repulsion), ("coupling", self.coupling)):
            if not is_number(value) or not 0 <= value <= _LARGEST:
                raise ValueError(f"{name} must be a number from 0 to {_LARGEST:g}, got {value!r}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Design:
    """A designed code and how it came about.

    Attributes
    ----------
    code : (shot, y, x) uint8 of 0 and 1; of the tile, where one was asked for.
    costs : cost of the start and after every sweep.
    moves : elements moved in every sweep.
    converged : whether the last sweep changed the cost by less than the tolerance.
    weights : of the terms of the cost.
    seed : of the design.
    tile : (y, x) elements of the tile; None where the code is that of the whole mask.
    """

    code: np.ndarray
    costs: tuple[float, ...]
    moves: tuple[int, ...]
    converged: bool
    weights: Weights
    seed: int
    tile: tuple[int, int] | None = None

    @property
    def sweeps(self) -> int:
        """Sweeps over the code until it stopped."""
        return len(self.moves)

    def mask(self, shape: tuple[int, int]) -> np.ndarray:
        """Code of a whole mask of `shape` (y, x) elements, `imager.code_shape`: a tile is repeated, and cut at the end.

        Examples
        --------
        >>> import shadowgram as sg
        >>> imager = sg.SSCSI(detector_shape=(32, 32), detector_pitch=10.0, code_pitch=10.0, mask_position=0.1875,
        ...                   wavelengths=(450, 650))
        >>> found = sg.codes.design(imager, shots=3, seed=0, tile=(8, 16))
        >>> imager.operator(found.mask(imager.code_shape)).out_shape
        (3, 32, 32)
        """
        ny, nx = self.code.shape[-2:]
        times = -(-shape[0] // ny), -(-shape[1] // nx)
        whole = np.tile(self.code, (*[1] * (self.code.ndim - 2), *times))
        return np.ascontiguousarray(whole[..., : shape[0], : shape[1]])


def default_c1(bands: int, shots: int, coupling: float = 0.0) -> float:
    """Weight of the diagonal that suits L bands and Q shots: 3.5 (L/Q)² for Q < L, plus 10 coupling L/Q for Q ≤ L.

    Too small a weight leaves open elements alone, and every voxel sees a blend; too large a one lines them up in long runs that
    many bands share. The study "codes-c1" says what the rule loses against the best weight, from L/Q = 1 to 12.

    Examples
    --------
    >>> import shadowgram as sg
    >>> sg.codes.default_c1(24, 6), sg.codes.default_c1(24, 6, coupling=1.0), sg.codes.default_c1(6, 8)
    (56.0, 96.0, 0.0)
    """
    load = bands / shots
    return (3.5 * load**2 if load > 1 else 0.0) + (10.0 * coupling * load if load >= 1 else 0.0)


def design(
    imager: MaskImager | FilterImager,
    *,
    shots: int,
    seed: int,
    c1: float | None = None,
    repulsion: float = 1.0,
    coupling: float = 0.0,
    transmittance: float | None = None,
    tile: tuple[int, int] | None = None,
    tolerance: float = 1e-3,
    max_sweeps: int = 100,
    start: np.ndarray | None = None,
    resume: Design | None = None,
    callback: Callable[[Design], None] | None = None,
) -> Design:
    """Design a code for an imager and say how it came about; `optimised` gives the code alone.

    From a Boolean code on, the elements are visited in random order, and each is opened in the shot where it costs least, until
    a sweep changes the cost by less than `tolerance` of that of the start.

    Parameters
    ----------
    imager : `SSCSI` in either regime, `CASSI`, `DualCASSI` or `ColoredCASSI`.
    shots : number of snapshots Q, at least 2.
    seed : of the start, the order of the visits and the choice among equals.
    c1 : weight of the diagonal; `default_c1` if not given. Without effect for a colored code, whose diagonal is fixed.
    repulsion : weight of 1/distance between open elements of one shot.
    coupling : weight of columns that meet in one shot at neighbouring places.
    transmittance : share of the shots in which an element is open, on average; 1/Q if not given. A larger one is for cameras that
        have little light; every element then keeps its number of open shots, ⌊Qτ⌋ or ⌈Qτ⌉.
    tile : (y, x) elements of a tile which repeats over the mask; its borders wrap around. `Design.mask` repeats it.
    tolerance : a sweep that changes the cost by less, of that of the start (ε₀), is the last.
    max_sweeps : limit of sweeps, those of `resume` included.
    start : (shot, y, x) complementary code to begin with, instead of a Boolean one.
    resume : a design to go on with, made with the same parameters; the result is as if it had never stopped.
    callback : called with the design so far after every sweep.

    Raises
    ------
    ValueError
        If a parameter is out of range or does not fit the imager.

    Notes
    -----
    Which to take, by the studies "fig-3-5", "codes-better" and "codes-light": the defaults for GPSR and for many bands a shot; a
    `coupling` of 1, and the imager's exact shear, for `EigenTV`; a `transmittance` of 3/8 to 1/2 where the read noise of the camera
    decides, and random codes there if the shots outnumber the bands.

    Source: Salazar (2022), Algorithm 1 and eq. (3.17); the evaluation by tables, the coupling and the budgets are ours.

    Examples
    --------
    >>> import shadowgram as sg
    >>> imager = sg.SSCSI(detector_shape=(32, 32), detector_pitch=10.0, code_pitch=10.0, mask_position=0.1875,
    ...                   wavelengths=(450, 650))
    >>> found = sg.codes.design(imager, shots=3, seed=0)
    >>> found.code.shape, found.converged, found.costs[-1] < found.costs[0]
    ((3, 32, 32), True, True)
    >>> imager.operator(found.code).out_shape
    (3, 32, 32)
    """
    shape = checked_shape(imager, shots, tile)
    tile = None if tile is None else (shape[0], shape[1])
    check_limits(tolerance, max_sweeps)
    _generator(seed)
    Weights(c1=0.0, repulsion=repulsion, coupling=coupling)  # before the coupling sets c1
    weights = Weights(
        c1=default_c1(band_count(imager), shots, coupling) if c1 is None else c1, repulsion=repulsion, coupling=coupling
    )
    if start is not None and (transmittance is not None or resume is not None):
        raise ValueError("a start is complementary and new: leave the transmittance and resume out, or the start")
    if resume is not None:
        code = _checked_resume(resume, weights, seed, tile, shots, shape, transmittance)
    elif start is not None:
        code = checked_start(start, shots, shape)
    else:
        code = first_code(shots, shape, transmittance, seed)
    board = _board(imager, code, weights, tile is not None)
    if resume is not None and abs(board.cost() - resume.costs[-1]) > 1e-6 * resume.costs[0]:
        raise ValueError("the design to go on from was made for another imager: its code has another cost here")
    costs, moves = (list(resume.costs), list(resume.moves)) if resume else ([board.cost()], [])
    done = resume is not None and resume.converged
    found = resume or Design(
        code=code, costs=tuple(costs), moves=(), converged=False, weights=weights, seed=seed, tile=tile
    )
    while not done and len(moves) < max_sweeps:
        change, moved = _sweep(board, shape, seed, len(moves))
        costs.append(costs[-1] + change)
        moves.append(moved)
        done = abs(change) <= tolerance * costs[0]
        found = replace(found, code=board.code, costs=tuple(costs), moves=tuple(moves), converged=done)
        if callback is not None:
            callback(found)
    return found


def exchange(imager: MaskImager, found: Design, *, tolerance: float = 1e-4, max_sweeps: int = 10) -> Design:
    """Refine a design by exchanging the shots of neighbouring elements where that lowers the cost.

    Moves of single elements have nearly come to an end there; an exchange can still pay, and keeps the light of every shot.

    Parameters
    ----------
    imager, found : the imager and its design, of one open shot an element.
    tolerance : a sweep that changes the cost by less, of that of the start, is the last.
    max_sweeps : limit of sweeps.

    Raises
    ------
    ValueError
        If the design does not fit the imager, or is of another kind.

    Examples
    --------
    >>> import shadowgram as sg
    >>> imager = sg.SSCSI(detector_shape=(16, 16), detector_pitch=10.0, code_pitch=10.0, mask_position=0.25,
    ...                   wavelengths=(450, 650))
    >>> found = sg.codes.design(imager, shots=2, seed=0)
    >>> better = sg.codes.exchange(imager, found)
    >>> better.costs[-1] <= found.costs[-1], (better.code.sum(axis=(1, 2)) == found.code.sum(axis=(1, 2))).all()
    (True, np.True_)
    """
    from ._board import Board

    if not isinstance(found, Design):
        raise TypeError(f"exchanges refine a Design, as shadowgram.codes.design returns it, got {type(found).__name__}")
    check_limits(tolerance, max_sweeps)
    if (found.code.sum(axis=0) != 1).any():
        raise ValueError("exchanges are for designs of one open shot an element: this one has several")
    code = checked_start(found.code, len(found.code), checked_shape(imager, len(found.code), found.tile))
    board = _board(imager, code, found.weights, found.tile is not None)
    if not isinstance(board, Board):
        raise ValueError("exchanges are for imagers with one mask: a colored code has converged when its design has")
    costs, moves, done = list(found.costs), list(found.moves), False
    for _ in range(max_sweeps):
        # By the number of all sweeps, so that one call after another goes on like one call.
        walk = _walk(code.shape[1:], np.random.default_rng([found.seed, 2, len(moves)]))
        parts = [board.exchange(part) for part in walk]
        costs.append(costs[-1] + sum(change for change, _ in parts))
        moves.append(sum(moved for _, moved in parts))
        done = abs(costs[-1] - costs[-2]) <= tolerance * costs[0]
        if done:
            break
    return replace(found, code=board.code, costs=tuple(costs), moves=tuple(moves), converged=done)


def optimised(
    imager: MaskImager | FilterImager,
    *,
    shots: int,
    seed: int,
    c1: float | None = None,
    coupling: float = 0.0,
    starts: int = 1,
) -> np.ndarray:
    """Optimised complementary code for an imager: the best of `starts` designs.

    Parameters
    ----------
    imager, shots, c1, coupling : as in `design`, which has more choices and tells the history.
    seed : of the first design; the next ones have the next numbers.
    starts : number of designs from different starts, which run side by side.

    Returns
    -------
    (shot, y, x) uint8 array of 0 and 1; (shot, band, y, x) for a colored CASSI. The same for any number of threads.

    Raises
    ------
    ValueError
        If a parameter is out of range or does not fit the imager.

    Notes
    -----
    Source: Salazar (2022), Algorithm 1 and eq. (3.17).

    Examples
    --------
    >>> import shadowgram as sg
    >>> imager = sg.SSCSI(detector_shape=(32, 32), detector_pitch=10.0, code_pitch=10.0, mask_position=0.1875,
    ...                   wavelengths=(450, 650))
    >>> code = sg.codes.optimised(imager, shots=3, seed=0)
    >>> code.shape, bool((code.sum(axis=0) == 1).all())
    ((3, 32, 32), True)
    """
    if not isinstance(starts, int | np.integer) or isinstance(starts, bool) or starts < 1:
        raise ValueError(f"starts must be a whole number of at least 1, got {starts!r}")
    _generator(seed)
    found: list[Design | None] = [None] * starts

    def run(first: int, last: int) -> None:
        for i in range(first, last):
            found[i] = design(imager, shots=shots, seed=seed + i, c1=c1, coupling=coupling)

    run_chunks(run, starts, 1)
    return min((one for one in found if one is not None), key=lambda one: one.costs[-1]).code


def _board(imager: MaskImager | FilterImager, code: np.ndarray, weights: Weights, wrap: bool) -> _Board:
    """What keeps the cost of a code of this imager up to date."""
    c1, repulsion = weights.c1, weights.repulsion
    complementary = bool((code.sum(axis=0) == 1).all())
    pairs = pairs_of(imager)
    colored = is_colored(imager)
    if weights.coupling and (colored or not complementary):
        raise ValueError("coupling is for codes of one mask whose elements are open in one shot: leave it 0 here")
    if colored:
        from ._colored_board import ColoredBoard

        return ColoredBoard(cast("VoxelPairs", pairs), code, c1=c1, repulsion=repulsion)
    table = cast("PairTable", pairs)
    reach = table.pairs.shape[1] + table.window - 1
    if wrap and code.shape[2] < reach:
        hint = "" if reach <= table.shape[1] else ": the mask is too narrow for tiles, leave the tile out"
        raise ValueError(f"a tile for this imager must be at least {reach} columns wide, got {code.shape[2]}{hint}")
    if wrap and code.shape[1] % table.rows:
        raise ValueError(f"a tile must hold whole detector rows, {table.rows} code rows each, got {code.shape[1]}")
    if complementary:
        from ._board import Board

        return Board(table, code, c1=c1, repulsion=repulsion, coupling=weights.coupling, wrap=wrap)
    from ._budget import BudgetBoard

    return BudgetBoard(table, code, c1=c1, repulsion=repulsion, wrap=wrap)


def _sweep(board: _Board, shape: tuple[int, ...], seed: int, number: int) -> tuple[float, int]:
    """Visit every element once; the order depends on the seed and the number of the sweep alone, so that a design can go on."""
    rng = np.random.default_rng([seed, 1, number])
    parts = _walk(shape, rng)
    state = rng.integers(1 << 63, size=1, dtype=np.uint64)
    done = [board.sweep(part, state) for part in parts]
    return sum(change for change, _ in done), sum(moved for _, moved in done)


def _walk(shape: tuple[int, ...], rng: np.random.Generator) -> list[np.ndarray]:
    """Flat places of all elements in random order: block after block, so that the fields around one stay in the cache."""
    places = np.arange(math.prod(shape)).reshape(shape)
    *_, ny, nx = shape
    corners = [(y, x) for y in range(0, ny, _BLOCK) for x in range(0, nx, _BLOCK)]
    blocks = [places[..., y : y + _BLOCK, x : x + _BLOCK].ravel() for y, x in corners]
    return [rng.permutation(blocks[i]) for i in rng.permutation(len(blocks))]


def _checked_resume(
    resume: Design,
    weights: Weights,
    seed: int,
    tile: tuple[int, int] | None,
    shots: int,
    shape: tuple[int, ...],
    transmittance: float | None,
) -> np.ndarray:
    """Code of a design that goes on."""
    if not isinstance(resume, Design):
        raise TypeError(f"resume takes a Design, as shadowgram.codes.design returns it, got {type(resume).__name__}")
    opened = 1.0 if transmittance is None else transmittance * shots
    same = (resume.weights, resume.seed, resume.tile, len(resume.code)) == (weights, seed, tile, shots)
    if not same or abs(resume.code.sum(axis=0).mean() - opened) > 1 / math.prod(shape):
        raise ValueError(
            "a design goes on with the parameters it was made with: shots, seed, tile, transmittance and weights; it has"
            f" {len(resume.code)} shots, seed {resume.seed}, tile {resume.tile}, transmittance"
            f" {resume.code.mean():.3g} and {resume.weights}"
        )
    return check_code(resume.code, shape)
