"""Algorithm 1 of the source as it is printed: the local cost is evaluated anew for every shot of every element.

It is here to be compared with: `shadowgram.codes.design` finds the same codes and keeps its costs up to date instead. Two things
are not as printed. The inner products over the shots (3.12) are taken from which shot each element is open in, which needs no sum
over the shots; Table 3.1 of the source counts them as one operation too. And pairs of a voxel that sees the element with one that
does not count in both orders, as in the cost (3.17); line 10 counts them once, so that it is not the change of the cost.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from shadowgram.codes._board import inverse_distance
from shadowgram.codes._design_kernels import cheapest


class PlainBoard:
    """A complementary code being improved by Algorithm 1, for an SSCSI with edge shear and Δc = Δd.

    Parameters
    ----------
    code : (shot, y, x), every element open in one shot.
    mask_position, bands : s and L of the imager.
    c1, repulsion : weights of the diagonal, and of the distances between open elements.

    Notes
    -----
    Source: Salazar (2022), Algorithm 1 and eqs. (3.4), (3.5), (3.17) and (3.18).
    """

    def __init__(self, code: np.ndarray, *, mask_position: float, bands: int, c1: float, repulsion: float) -> None:
        shots, ny, nx = code.shape
        place = np.arange(nx) * (1 - mask_position)
        first = np.floor(place + 1e-9).astype(np.int64)
        self._first = first
        self._share = np.clip((first + 1) / (1 - mask_position) - np.arange(nx), 0, 1)
        # Find(r1, r2): columns of the detector with a band that sees column x of the code.
        columns = np.arange(nx)
        self._begin, self._end = np.searchsorted(first, columns - bands), np.searchsorted(first, columns, side="right")
        self._labels = np.full((ny, max(nx, int(first[-1]) + bands + 1)), -1, np.int64)
        self._labels[:, :nx] = code.argmax(axis=0)
        self._omega = inverse_distance(bands)
        self._bands, self._c1, self._repulsion = bands, float(c1), float(repulsion)
        self._shots, self._nx = shots, nx

    @property
    def code(self) -> np.ndarray:
        """(shot, y, x) uint8."""
        return (self._labels[:, : self._nx] == np.arange(self._shots)[:, None, None]).astype(np.uint8)

    def affected(self) -> np.ndarray:
        """(x,) number of voxels that see an element of each column, which its local cost is summed over."""
        at = np.arange(self._nx)[:, None] - self._first
        return ((at >= 0) & (at < self._bands)).sum(axis=1) + ((at >= 1) & (at <= self._bands)).sum(axis=1)

    def cost(self) -> float:
        """The whole cost (3.17), lines 2 and 15."""
        return _cost(
            self._labels, self._nx, self._first, self._share, self._bands, self._omega, self._c1, self._repulsion
        )

    def sweep(self, order: np.ndarray, state: np.ndarray) -> None:
        """Open every element of `order` (y·width + x) in its cheapest shot, lines 4 to 14."""
        _sweep(
            self._labels, self._nx, self._first, self._share, self._begin, self._end, self._bands, self._omega, self._c1,
            self._repulsion, self._shots, order, state,
        )  # fmt: skip


@njit(nogil=True, inline="always")
def _meet(row, one, other):
    return np.float64((row[one] == row[other]) & (row[one] >= 0))  # no branch: which way it goes cannot be foretold


@njit(nogil=True)
def _inner(row, share, a, b):
    """Σ_q t̂ t̂ (3.12) of two voxels of one detector element, which see the code columns a, a + 1 and b, b + 1."""
    rest = 1 - share
    return (
        share * share * _meet(row, a, b)
        + share * rest * (_meet(row, a, b + 1) + _meet(row, a + 1, b))
        + rest * rest * _meet(row, a + 1, b + 1)
    )


@njit(nogil=True)
def _spread(labels, nx, y, x, shot, omega):
    """Ω ⊙ t̃ (3.18) of a shot around an element, itself left out."""
    reach = omega.shape[0] // 2
    total = 0.0
    for yy in range(max(y - reach, 0), min(y + reach + 1, labels.shape[0])):
        for xx in range(max(x - reach, 0), min(x + reach + 1, nx)):
            total += omega[yy - y + reach, xx - x + reach] * np.float64(labels[yy, xx] == shot)
    return total


@njit(nogil=True)
def _local(row, x, first, share, begin, end, bands, c1):
    """Terms of the cost that the voxels I take part in which see column x."""
    total = 0.0
    for m in range(begin[x], end[x]):
        at = x - first[m]  # the band whose left column it is
        for k in range(max(at - 1, 0), min(at + 1, bands)):
            for other in range(bands):
                inner = _inner(row, share[m], first[m] + k, first[m] + other)
                if other == k:
                    total += c1 * (inner - 1) ** 2
                else:
                    # The other order is not visited if the other voxel is not in I.
                    total += inner * inner * (1.0 if other == at or other == at - 1 else 2.0)
    return total


@njit(cache=True, nogil=True)
def _sweep(labels, nx, first, share, begin, end, bands, omega, c1, repulsion, shots, order, state):
    scores = np.empty(shots)
    for place in order:
        y, x = place // nx, place % nx
        row = labels[y]
        for shot in range(shots):
            row[x] = shot
            scores[shot] = _local(row, x, first, share, begin, end, bands, c1)
            if repulsion != 0:
                scores[shot] += 2 * repulsion * _spread(labels, nx, y, x, shot, omega)
        row[x] = cheapest(scores, state)


@njit(cache=True, nogil=True)
def _cost(labels, nx, first, share, bands, omega, c1, repulsion):
    total = 0.0
    for y in range(labels.shape[0]):
        row = labels[y]
        for m in range(first.size):
            for k in range(bands):
                for other in range(bands):
                    inner = _inner(row, share[m], first[m] + k, first[m] + other)
                    total += inner * inner if other != k else c1 * (inner - 1) ** 2
        if repulsion != 0:
            for x in range(nx):
                own = labels[y, x]
                total += repulsion * _spread(labels, nx, y, x, own, omega)
    return total
