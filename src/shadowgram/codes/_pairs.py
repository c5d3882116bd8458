"""What an imager tells a code designer: which pairs of code columns meet on the detector, and how much each meeting costs.

Every voxel of a row sees a *window* of J neighbouring code columns with fixed weights, and two voxels v, v' that share detector
elements have the inner product (HᵀH)_vv' = Σ_jj' C_jj' E[a + j, b + j'], where a and b are their first columns and
E[x, x'] = Σ_q t_q[x] t_q[x'] is all that the inner product knows of the code. Its square is a quadratic form in the J² numbers E,
and all voxel pairs with the same a and b = a + d add up to one form: the table below. This makes a sweep over the code cost
O(N²L) instead of O(N²L²Q), exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

WIDEST_WINDOW = 3  # a table over all patterns of a window pair has 2^(J²) entries
MOST_ENTRIES = 4e8  # numbers in a table: 3 GB


@dataclass(frozen=True, eq=False)
class PairTable:
    """Quadratic forms of the Gram cost Σ_{v≠v'} (HᵀH)²_vv' and of its diagonal, over windows of J code columns.

    Attributes
    ----------
    first : code column of the first window, ≤ 0 where voxels see columns left of the code.
    pairs : (column, distance, J², J²) forms: Eᵀ pairs[a, d] E, E = E[a + j, a + d + j'] with index j·J + j', summed over all
        ordered voxel pairs v ≠ v' of one code row whose windows begin at `first` + a and d columns further right.
    own, own_linear, own_count : (column, J², J²), (column, J²), (column,): Σ_v of (HᵀH)²_vv as a form, of (HᵀH)_vv as a linear
        form, and of 1, over the voxels whose window begins there.
    rows : code rows that share a detector row, Δd/Δc; voxels of these rows meet too, those of other rows never.
    bands : number of bands L, which sets how far open elements repel each other.
    shape : (y, x) elements of the code.
    """

    first: int
    pairs: np.ndarray
    own: np.ndarray
    own_linear: np.ndarray
    own_count: np.ndarray
    rows: int
    bands: int
    shape: tuple[int, int]

    @property
    def window(self) -> int:
        """J, code columns that a voxel sees."""
        return round(self.own_linear.shape[1] ** 0.5)


def pair_table(
    first: np.ndarray, weights: np.ndarray, voxel: np.ndarray, detector: np.ndarray, rows: int, shape: tuple[int, int]
) -> PairTable:
    """Table of an imager whose voxels see windows of the code.

    Parameters
    ----------
    first : (band, piece) first code column that a piece of a voxel sees.
    weights : (j, band, piece) weights of that and the next columns.
    voxel, detector : (piece,) column of the cube and of the snapshot that a piece belongs to. Pieces of one voxel are neighbours.
    rows : code rows a detector row.
    shape : (y, x) elements of the code.

    Raises
    ------
    ValueError
        If a voxel sees more than three code columns, or the table would not fit in memory.
    """
    bands = len(first)
    columns = int(voxel.max()) + 1
    begin = np.full((bands, columns), np.iinfo(np.int64).max)
    np.minimum.at(begin.T, voxel, first.T)
    late = (first - begin[:, voxel])[None] + np.arange(len(weights))[:, None, None]
    window = int(late[weights > 0].max()) + 1
    if window > WIDEST_WINDOW:
        raise ValueError(
            f"a voxel sees {window} code columns at once, and codes are designed for at most {WIDEST_WINDOW}: use bands no"
            " wider than the dispersion over a code element, or a model of first order (shear='centre')"
        )
    spread = np.zeros((len(voxel), bands, window))
    for j in range(len(weights)):
        piece, band = np.meshgrid(np.arange(len(voxel)), np.arange(bands), indexing="ij")
        seen = weights[j].T > 0
        spread[piece[seen], band[seen], late[j].T[seen]] += weights[j].T[seen]
    low = int(begin.min())
    start = np.ascontiguousarray(begin.T - low)
    partners = _partners(voxel, detector, columns)
    reach = 1 + max(int(start[list(other)].max() - start[c].min()) for c, other in enumerate(partners) if other)
    square = window * window
    size = int(start.max()) + 1
    if size * reach * 2**square > MOST_ENTRIES:
        raise ValueError(
            f"the design of this code needs a table of {size} columns x {reach} distances, too big for memory: use a"
            " smaller code and tile it, or shear='edge'"
        )
    pairs = np.zeros((size, reach, square, square))
    own, linear, count = np.zeros((size, square, square)), np.zeros((size, square)), np.zeros(size)
    left = np.array([c for c, other in enumerate(partners) for _ in other], np.int64)
    right = np.array([d for other in partners for d in other], np.int64)
    order = np.argsort(voxel, kind="stable")
    bounds = np.searchsorted(voxel[order], np.arange(columns + 1))
    _add_pairs(left, right, start, spread[order], detector[order].astype(np.int64), bounds, pairs, own, linear, count)
    return PairTable(low, pairs, own, linear, count, rows, bands, shape)


def _partners(voxel: np.ndarray, detector: np.ndarray, columns: int) -> list[list[int]]:
    """Voxel columns, in order, that share a detector column with each voxel column."""
    on: dict[int, list[int]] = {}
    for v, d in zip(voxel.tolist(), detector.tolist(), strict=True):
        on.setdefault(d, []).append(v)
    found: list[set[int]] = [set() for _ in range(columns)]
    for group in on.values():
        for v in group:
            found[v].update(group)
    return [sorted(group) for group in found]


@njit(cache=True, nogil=True)
def _add_pairs(left, right, start, spread, detector, bounds, pairs, own, linear, count):
    """Add every ordered voxel pair (column left[i] band k, column right[i] band l) whose second window does not begin before."""
    window, bands = spread.shape[2], spread.shape[1]
    form = np.empty(window * window)
    for i in range(left.size):
        c, d = left[i], right[i]
        for k in range(bands):
            for l in range(bands):
                distance = start[d, l] - start[c, k]
                if distance < 0:
                    continue
                form[:] = 0
                for p in range(bounds[c], bounds[c + 1]):
                    for r in range(bounds[d], bounds[d + 1]):
                        if detector[p] == detector[r]:
                            for j in range(window):
                                for jj in range(window):
                                    form[j * window + jj] += spread[p, k, j] * spread[r, l, jj]
                a = start[c, k]
                if c == d and k == l:
                    count[a] += 1
                    linear[a] += form
                    target = own[a]
                else:
                    target = pairs[a, distance]
                twice = 2.0 if distance > 0 else 1.0  # the pair in the other order has a negative distance
                for m in range(form.size):
                    for n in range(form.size):
                        target[m, n] += twice * form[m] * form[n]
