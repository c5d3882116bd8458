"""The linear route to a scan: the response of every mask cell, tallied once, and the shots of any code from it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from shadowgram._threads import thread_count

from .arrays import Floats, desk
from .run import Setup, batch_edges
from .tallies import Sums

SIDES, SETS, GROUPS = 4, 16, 2
CORE_SHARE = 4
"""Cells of the view are followed so many times for each time of a cell outside it, from which only leaks come."""
_TOUCHING = 1e-9
"""mm."""
_LEAST_AIR = 0.5
"""Weight of a photon forced to collide in the air: one in a hundred does, and half a photon for each leaves the counts
from air twice as exact as those from a bright target, in five sixths of the time that a tenth takes.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Response:
    """Counts that the cells of a mask give, per photon of the source.

    Attributes
    ----------
    terms : (group, side, set, row, column) coefficients of the products of transmittances; group 0 is the target, 1 air
        and all else.
    open : (group, row, column) counts with this cell and its neighbours open.
    standard_error : of `open`; same shape.
    columns : of the view; `margin` more on either side are in the arrays, since light leaks in through the frame.
    margin : columns.
    histories : that were followed.

    Notes
    -----
    What the mask itself scatters is not in it: it does not depend on single cells. `offset` of a scan takes it from a direct run.
    """

    terms: Floats
    open: Floats
    standard_error: Floats
    columns: int
    margin: int
    histories: int

    @property
    def image(self) -> Floats:
        """(row, column) counts from the target through the open cells of the view, the truth that a reconstruction looks for."""
        return self.open[0, :, self.margin : self.margin + self.columns]

    def shots(self, codes: ArrayLike) -> Floats:
        """Mean counts per photon of the source for coded shots, (group, shot).

        Parameters
        ----------
        codes : (shot, row, column) of the view, with whole columns of 0 assumed beside it, or a strip (row, columns +
            shots − 1) that slides by one
            column a shot.

        Raises
        ------
        ValueError
            If the shape does not fit, or a value is not 0 or 1.
        """
        windows = self._windows(codes)
        total = np.zeros((GROUPS, windows.shape[1]))
        for side in range(SIDES):
            for subset in range(SETS):
                term = self.terms[:, side, subset]
                if term.any():
                    total += np.einsum("gij,iqj->gq", term, _product(windows, side, subset), optimize=True)
        return total

    def _windows(self, codes: ArrayLike) -> NDArray[np.float64]:
        """(row + 2, shot, column + 2): transmittance of all cells that the terms may ask for."""
        code = np.asarray(codes, float)
        rows = self.terms.shape[3]
        fits = code.ndim in (2, 3) and code.shape[-2] == rows
        if not fits or (code.shape[-1] < self.columns if code.ndim == 2 else code.shape[-1] != self.columns):
            raise ValueError(
                f"codes must be (shot, {rows}, {self.columns}) or a strip ({rows}, at least {self.columns}), got {code.shape}"
            )
        if not np.isin(code, (0.0, 1.0)).all():
            raise ValueError(
                "a mask cell is 0 (closed) or 1 (open); got other values, round or threshold the code first"
            )
        side = self.margin + 1
        if code.ndim == 2:
            padded = np.pad(code, ((1, 1), (side, side)))
            return np.lib.stride_tricks.sliding_window_view(padded, self.columns + 2 * side, axis=1)
        return np.pad(code, ((0, 0), (1, 1), (side, side))).transpose(1, 0, 2)


def _product(windows: NDArray[np.float64], side: int, subset: int) -> NDArray[np.float64]:
    """(row, shot, column): the product of the transmittances of a set of cells."""
    across, along = (1 if side & 1 else -1), (1 if side & 2 else -1)
    rows, columns = windows.shape[0] - 2, windows.shape[2] - 2
    product = np.ones((rows, windows.shape[1], columns))
    for cell, (i, j) in enumerate(((0, 0), (0, across), (along, 0), (along, across))):
        if subset >> cell & 1:
            product = product * windows[1 + i : 1 + i + rows, :, 1 + j : 1 + j + columns]
    return product


def mask_response(
    setup: Setup,
    *,
    solid: int,
    first_column: int,
    columns: int,
    margin: int,
    histories_per_cell: int,
    seed: int,
    threads: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Response:
    """Tally what every cell of a mask gives at the detectors.

    Parameters
    ----------
    setup : with variance reduction or analog; the mask's pattern does not matter.
    solid : the mask's index among the solids.
    first_column : of the view, in the mask.
    columns, margin : of the view, and how many more on either side the source lights.
    histories_per_cell : source photons through each cell of the view.
    seed : of the run.
    threads : all processors if None; the result does not depend on it.

    Raises
    ------
    ValueError
        If the plate is so thick, or the light so oblique, that a photon crosses more than one cell across or along; if
        the source is a pencil, or the view with its margin reaches beyond the plate.
    """
    _check_view(setup, solid, first_column - margin, first_column + columns + margin)
    cells, times = _cells(setup, solid, first_column, columns, margin)
    closed = _closed(setup)
    rows, slots = times.shape
    shape = (GROUPS, SIDES, SETS, rows, slots)
    size = int(np.prod(shape))
    sums = Sums.of_size(size + GROUPS * rows * slots)
    rounds = -(-histories_per_cell // CORE_SHARE)
    edges = [edge * len(cells) for edge in batch_edges(rounds)]

    def one(first: int, last: int) -> Floats:
        return _batch(closed, solid, cells, shape, seed, first, last)

    with ThreadPoolExecutor(threads or thread_count()) as pool:
        spans = list(pairwise(edges))
        for done, vector in enumerate(pool.map(lambda span: one(*span), spans), start=1):
            sums.add(vector, edges[done] - edges[done - 1])
            progress(done, len(spans))
    # A cell is followed `times` times a round, and stands for the whole of what goes through it.
    norm = len(cells) / times
    mean, error = sums.mean(), sums.standard_error()
    flat = (GROUPS, rows, slots)
    return Response(
        terms=mean[:size].reshape(shape) * norm,
        open=mean[size:].reshape(flat) * norm,
        standard_error=error[size:].reshape(flat) * norm,
        columns=columns,
        margin=margin,
        histories=sums.histories,
    )


def _check_view(setup: Setup, solid: int, first: int, last: int) -> None:
    if setup.source.cosine >= 1:
        raise ValueError(
            "the response of a mask needs a source that sends its photons into a cone; this one is a pencil"
        )
    masks, body = setup.geometry.masks, setup.geometry.body[solid]
    ends = masks.corner[body, 0] + masks.step[body, 0] * np.array([first, last])
    low, high = setup.geometry.box[solid, [0, 3]]
    if ends.min() < low - _TOUCHING or ends.max() > high + _TOUCHING:
        raise ValueError(
            f"the view of the mask with its margin, x from {ends.min():g} to {ends.max():g} mm, reaches beyond the plate, "
            f"{low:g} to {high:g} mm; make the margin smaller"
        )


def _cells(setup: Setup, solid: int, first: int, columns: int, margin: int) -> tuple[NDArray[np.int64], Floats]:
    """The order in which cells are followed, and how often each comes in it, (row, slot).

    An entry is (row, column in the mask, slot, how often the cell came before, how often it comes).
    """
    rows = int(setup.geometry.masks.shape[setup.geometry.body[solid], 0])
    slots = columns + 2 * margin
    times = np.ones((rows, slots), np.int64)
    times[:, margin : margin + columns] = CORE_SHARE
    listed = [
        (i, first - margin + j, j, turn, times[i, j])
        for turn in range(CORE_SHARE)
        for i in range(rows)
        for j in range(slots)
        if turn < times[i, j]
    ]
    return np.array(listed, np.int64), times.astype(float)


def _closed(setup: Setup) -> Setup:
    """The same scene with its masks closed, which is how photons meet them that come back."""
    masks = setup.geometry.masks
    closed = setup.geometry._replace(masks=masks._replace(open=np.zeros_like(masks.open)))
    return replace(setup, geometry=closed, rules=setup.rules._replace(least_air=_LEAST_AIR))


def _batch(
    setup: Setup, solid: int, cells: NDArray[np.int64], shape: tuple[int, ...], seed: int, first: int, last: int
) -> Floats:
    from ._response_kernels import response_batch

    terms = np.zeros(shape)
    scratch = desk(len(setup.solid_names), len(setup.detector_names))
    arrays = (setup.geometry, setup.physics, setup.source, setup.detectors, setup.rules)
    stopped = response_batch(
        *arrays, scratch, setup.empty_tally(), solid, cells, seed, first, last, terms, np.zeros(4 + SETS)
    )
    if stopped >= 0:
        raise ValueError(
            f"a photon of history {stopped} crosses more than one cell wall across or along the mask: the plate is too thick "
            "for its pitch, or the light too oblique; run the scan directly"
        )
    return np.concatenate([terms.ravel(), terms.sum(axis=(1, 2)).ravel()])
