"""The state of a design whose elements are open in more than one shot: a light budget other than 1/Q."""

from __future__ import annotations

import math

import numpy as np

from . import _budget_kernels as kernels
from . import _coupling_kernels as coupling_kernels
from ._board import copies_around, inverse_distance, placed
from ._pairs import PairTable

MOST_SHOTS = 64  # a set of shots is a 64-bit number


def budget_start(shots: int, shape: tuple[int, int], transmittance: float, rng: np.random.Generator) -> np.ndarray:
    """(shot, y, x) code whose elements are open in ⌊Qτ⌋ or ⌈Qτ⌉ shots, on average a share τ or just above, drawn at random."""
    elements = shape[0] * shape[1]
    least, more = divmod(math.ceil(transmittance * shots * elements - 1e-6), elements)
    opened = rng.permutation(np.where(np.arange(elements) < more, least + 1, least)).reshape(shape)
    rank = rng.permuted(np.broadcast_to(np.arange(shots)[:, None, None], (shots, *shape)), axis=0)
    return (rank < opened).astype(np.uint8)


class BudgetBoard:
    """A code being improved whose elements each keep their number of open shots; the cost is of HᵀH over the mean of that number.

    Parameters and methods as of `Board`, which does the same for one open shot, much faster.
    """

    def __init__(self, table: PairTable, code: np.ndarray, *, c1: float, repulsion: float, wrap: bool) -> None:
        self.shots, ny, nx = code.shape
        self.shape = ny, nx
        opened = float(code.sum(axis=0).mean())
        forms, linear = table.pairs / opened**2, -2 * c1 / opened * table.own_linear
        forms[:, 0] += c1 / opened**2 * table.own
        cross = 2 / opened**2 * (table.pairs[:, 0] + table.own)
        (forms, linear, cross), offset, self._windows = placed(table, nx, wrap, [forms, linear, cross])
        self.forms = kernels.Forms((0,) * table.window, forms, linear, cross, table.rows, offset, wrap)
        self.constant = c1 * float(table.own_count.sum()) * ny * (nx / table.shape[1] if wrap else 1)
        bits = (code.astype(np.uint64) << np.arange(self.shots, dtype=np.uint64)[:, None, None]).sum(axis=0)
        self.sets = np.zeros((ny, len(forms)), np.uint64)
        if wrap:
            self.sets[:] = bits[:, (np.arange(len(forms)) - offset) % nx]
        else:
            self.sets[:, offset : offset + nx] = bits
        self.stencil, self.weight = inverse_distance(table.bands), repulsion
        self.copies = copies_around(self.stencil, ny, nx) if wrap else 0.0
        self.field = np.zeros(code.shape)
        if repulsion:
            coupling_kernels.fill_repulsion(self.field, self.stencil, code, wrap)

    @property
    def code(self) -> np.ndarray:
        """(shot, y, x) uint8."""
        sets = self.sets[:, self.forms.offset : self.forms.offset + self.shape[1]]
        return ((sets >> np.arange(self.shots, dtype=np.uint64)[:, None, None]) & np.uint64(1)).astype(np.uint8)

    def cost(self) -> float:
        """The whole cost, computed afresh."""
        gram = kernels.budget_cost(self.forms, self.sets, *self._windows)
        return self.constant + gram + self.weight * float(((self.field - self.copies) * self.code).sum())

    def sweep(self, order: np.ndarray, state: np.ndarray) -> tuple[float, int]:
        """Move one open shot of every element of `order` to where it is cheapest; the change of cost, and how many moved."""
        return kernels.budget_sweep(
            self.forms, self.field, self.stencil, self.weight, self.copies, self.sets, order, state
        )
