"""The state of a design that is being improved: labels with their margins, tables of costs and fields."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from . import _coupling_kernels as coupling_kernels
from . import _design_kernels as kernels
from ._pairs import PairTable

COUPLING_WIDTH = 1.5  # code elements; standard deviation of the Gaussian by which pairs around a place are weighted
_COUPLING_REACH = 4


class Board:
    """A complementary code being improved, and its cost.

    Parameters
    ----------
    table : of the imager.
    code : (shot, y, x), every element open in one shot; of the tile, if `wrap`.
    c1, repulsion, coupling : weights of the diagonal, of the distances between open elements, and of pairs around a place.
    wrap : the code is a tile that is repeated over the mask.
    """

    def __init__(
        self, table: PairTable, code: np.ndarray, *, c1: float, repulsion: float, coupling: float, wrap: bool
    ) -> None:
        shots, ny, nx = code.shape
        self.lookup, self._windows = _lookup(table, nx, c1, wrap)
        columns = len(self.lookup.pairs)
        labels = code.argmax(axis=0)
        self.labels = np.full((ny, columns), -1, np.int64)
        if wrap:
            self.labels[:] = labels[:, (np.arange(columns) - self.lookup.offset) % nx]
        else:
            self.labels[:, self.lookup.offset : self.lookup.offset + nx] = labels
        self.fields = self._fields(table, code, repulsion, coupling)
        self.shots, self.shape = shots, (ny, nx)

    def _fields(self, table: PairTable, code: np.ndarray, repulsion: float, coupling: float) -> kernels.Fields:
        lookup, (_, ny, nx) = self.lookup, code.shape
        stencil = inverse_distance(table.bands)
        field = np.zeros(code.shape)
        if repulsion:
            coupling_kernels.fill_repulsion(field, stencil, code, lookup.wrap)
        kernel = _gaussian(min(_COUPLING_REACH, (min(ny, nx) - 1) // 2))
        distances = lookup.pairs.shape[1] if coupling else 0
        pairs = np.zeros((ny if distances else 0, distances, nx), np.float32)
        gains = coupling * meetings(table) if distances else np.zeros(0)
        coupling_kernels.fill_coupling(pairs, kernel, self.labels, lookup.offset, lookup.wrap)
        copies = copies_around(stencil, ny, nx) if lookup.wrap else 0.0
        return kernels.Fields(field, stencil, float(repulsion), copies, pairs, kernel, gains)

    @property
    def code(self) -> np.ndarray:
        """(shot, y, x) uint8."""
        labels = self.labels[:, self.lookup.offset : self.lookup.offset + self.shape[1]]
        return (labels == np.arange(self.shots)[:, None, None]).astype(np.uint8)

    def cost(self) -> float:
        """The whole cost, computed afresh."""
        fields = self.fields
        total = kernels.gram_cost(self.lookup, self.labels, *self._windows)
        total += fields.weight * float(((fields.repulsion - fields.copies) * self.code).sum())
        if fields.gains.size:
            total += coupling_kernels.coupling_cost(fields.coupling, fields.gains, self.labels, self.lookup.offset)
        return total

    def sweep(self, order: np.ndarray, state: np.ndarray) -> tuple[float, int]:
        """Open every element of `order` (y·width + x) in its cheapest shot; the change of cost, and how many moved."""
        change, moves = kernels.sweep(self.lookup, self.fields, self.labels, order, state)
        return float(change), int(moves)

    def exchange(self, order: np.ndarray) -> tuple[float, int]:
        """Exchange elements of `order` with those around where that lowers the cost; the change of cost, and how many."""
        change, exchanges = kernels.exchange(self.lookup, self.fields, self.labels, order, _AROUND)
        return float(change), int(exchanges)


def meetings(table: PairTable) -> np.ndarray:
    """(distance,) voxel pairs that meet on a pair of columns so far apart, each way, weighted by the square of what they share."""
    return table.pairs.sum(axis=(0, 2, 3)) / table.shape[1]


_AROUND = np.array([(dy, dx) for dy in range(-1, 2) for dx in range(-2, 3) if (dy, dx) != (0, 0)])


def inverse_distance(bands: int) -> np.ndarray:
    """Ω of eq. (3.18): (2L − 1, 2L − 1) inverse distances from the middle, 0 there."""
    side = np.arange(1 - bands, bands)
    distance = np.hypot(side[:, None], side)
    distance[bands - 1, bands - 1] = math.inf
    return _exact(1 / distance, 40)


def copies_around(stencil: np.ndarray, ny: int, nx: int) -> float:
    """Sum of a stencil over the copies of its middle in a tiling of (ny, nx)."""
    half = len(stencil) // 2
    return float(stencil[half % ny :: ny, half % nx :: nx].sum())


def _gaussian(reach: int) -> np.ndarray:
    """Weights of places around, in whole 4096ths, 0 in the middle."""
    side = np.arange(-reach, reach + 1)
    kernel = np.exp(-(side[:, None] ** 2 + side**2) / (2 * COUPLING_WIDTH**2))
    kernel[reach, reach] = 0
    return _exact(kernel, 12)  # the field is float32


def _exact(weights: np.ndarray, bits: int) -> np.ndarray:
    """Weights rounded to whole multiples of 2^−bits, so that a field is the same in whatever order they were added up."""
    return np.ldexp(np.rint(np.ldexp(weights, bits)), -bits)


def _lookup(table: PairTable, width: int, c1: float, wrap: bool) -> tuple[kernels.Lookup, tuple[int, int]]:
    """Costs by pattern, with margins, and the range of columns at which windows begin."""
    forms = table.pairs.copy()
    forms[:, 0] += c1 * table.own
    linear = np.zeros(forms.shape[:3])
    linear[:, 0] = -2 * c1 * table.own_linear
    constant = np.zeros(forms.shape[:2])
    constant[:, 0] = c1 * table.own_count
    between = 2 * (table.pairs[:, 0] + table.own)
    cross = _expanded(between, np.zeros(between.shape[:2]), np.zeros(len(between)))
    (pairs, cross), offset, windows = placed(table, width, wrap, [_expanded(forms, linear, constant), cross])
    return kernels.Lookup((0,) * table.window, pairs, cross, table.rows, offset, wrap), windows


def placed(
    table: PairTable, width: int, wrap: bool, columns: Sequence[np.ndarray]
) -> tuple[list[np.ndarray], int, tuple[int, int]]:
    """Put arrays (column, …) of a table where the labels of a code have their columns, with margins of zeros or of copies.

    Returns them, the place of the code's first column, and the range of places at which windows begin.
    """
    size, reach = table.pairs.shape[:2]
    margin = reach + 2 * table.window
    if wrap:
        span = (np.arange(width + 2 * margin) - margin) % width
        tiles = []
        for one in columns:
            tile = np.zeros((width, *one.shape[1:]))
            # One tile's part of what all its copies along a row cost.
            np.add.at(tile, (np.arange(size) + table.first) % width, width / table.shape[1] * one)
            tiles.append(tile[span])
        return tiles, margin, (margin, margin + width)
    # Windows may begin left of the code, and the code may reach beyond all windows, to either side.
    begin = margin + max(table.first, 0)
    offset, end = begin - table.first, begin + size
    after = max(end, offset + width) + margin - end
    return [np.pad(one, ((begin, after), *[(0, 0)] * (one.ndim - 1))) for one in columns], offset, (begin, end)


def _expanded(forms: np.ndarray, linear: np.ndarray, constant: np.ndarray) -> np.ndarray:
    """Values of the forms (…, J², J²) for every pattern of bits, (…, 2^(J²))."""
    square = forms.shape[-1]
    tables = np.empty((constant.size, 1 << square))
    kernels.expand(forms.reshape(-1, square, square), linear.reshape(-1, square), constant.ravel(), tables)
    return tables.reshape(*constant.shape, -1)
