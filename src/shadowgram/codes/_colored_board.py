"""The state of a design of a colored code: every element (band, y, x) is one voxel's, and open in one shot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from ._board import inverse_distance
from ._coupling_kernels import fill_repulsion, spread_out
from ._design_kernels import cheapest


@dataclass(frozen=True, eq=False)
class VoxelPairs:
    """Voxels of one row that share detector elements, as compressed rows; voxel (band, x) has the number band·width + x.

    Attributes
    ----------
    start : (voxel + 1,) where the partners of each voxel begin.
    partner : (pair,) numbers of the voxels, every pair in both orders.
    square : (pair,) (DᵀD)²_vv' of the dispersion D: what the pair costs if both are open in one shot.
    own : (voxel,) (DᵀD)_vv.
    shape : (band, y, x) of the code.
    """

    start: np.ndarray
    partner: np.ndarray
    square: np.ndarray
    own: np.ndarray
    shape: tuple[int, int, int]

    @property
    def bands(self) -> int:
        """Number of bands L."""
        return self.shape[0]


class ColoredBoard:
    """A complementary colored code being improved; methods as of `Board`. The diagonal of HᵀH does not depend on the code."""

    def __init__(self, pairs: VoxelPairs, code: np.ndarray, *, c1: float, repulsion: float) -> None:
        self.pairs, self.weight = pairs, repulsion
        self.shots, bands, ny, nx = code.shape
        self.shape = (bands, ny, nx)
        self.labels = np.ascontiguousarray(code.argmax(axis=0).transpose(1, 0, 2)).reshape(ny, bands * nx)
        self.stencil = inverse_distance(bands)
        self.constant = c1 * ny * float(((pairs.own - 1) ** 2).sum())
        self.field = np.zeros(code.shape)
        if repulsion:
            planes = (self.shots * bands, ny, nx)
            fill_repulsion(self.field.reshape(planes), self.stencil, code.reshape(planes), False)

    @property
    def code(self) -> np.ndarray:
        """(shot, band, y, x) uint8."""
        bands, ny, nx = self.shape
        labels = self.labels.reshape(ny, bands, nx).transpose(1, 0, 2)
        return (labels == np.arange(self.shots)[:, None, None, None]).astype(np.uint8)

    def cost(self) -> float:
        """The whole cost, computed afresh."""
        p = self.pairs
        voxel = np.repeat(np.arange(len(p.own)), np.diff(p.start))
        gram = sum(float(p.square[row[voxel] == row[p.partner]].sum()) for row in self.labels)
        return self.constant + gram + self.weight * float((self.field * self.code).sum())

    def sweep(self, order: np.ndarray, state: np.ndarray) -> tuple[float, int]:
        """Open every element of `order` (flat (band, y, x) index) in its cheapest shot; the change of cost, and how many moved."""
        p = self.pairs
        return _sweep(p.start, p.partner, p.square, self.field, self.stencil, self.weight, self.labels, order, state)


@njit(cache=True, nogil=True)
def _sweep(start, partner, square, field, stencil, weight, labels, order, state):
    shots, _, ny, nx = field.shape
    scores = np.empty(shots)
    change, moves = 0.0, 0
    for place in order:
        band, y, x = place // (ny * nx), place // nx % ny, place % nx
        voxel, row = band * nx + x, labels[y]
        for shot in range(shots):
            scores[shot] = 2 * weight * field[shot, band, y, x]
        for i in range(start[voxel], start[voxel + 1]):
            scores[row[partner[i]]] += 2 * square[i]  # the pair counts in both orders
        old, new = row[voxel], cheapest(scores, state)
        if new != old:
            change += scores[new] - scores[old]
            moves += 1
            row[voxel] = new
            if weight != 0:
                spread_out(field[old, band], y, x, stencil, -1.0, False)
                spread_out(field[new, band], y, x, stencil, 1.0, False)
    return change, moves
