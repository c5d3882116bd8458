"""Kernels of the design of codes whose elements are open in several shots.

sets[y, i] has bit q where the element is open in shot q; closed columns beside the code have none. E[x, x'] is the number of shots
that two elements share, and the cost of a pair of windows is its form itself: there are too many values for a table.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from ._coupling_kernels import spread_out
from ._design_kernels import draw


class Forms(NamedTuple):
    """Costs of pairs of windows as forms of the numbers E; names as in `_design_kernels.Lookup`.

    Attributes
    ----------
    pairs : (column, distance, J², J²), the diagonal's in distance 0.
    linear : (column, J²), of distance 0.
    cross : (column, J², J²).
    """

    window: tuple[int, ...]
    pairs: np.ndarray
    linear: np.ndarray
    cross: np.ndarray
    rows: int
    offset: int
    wrap: bool


@njit(nogil=True, inline="always")
def _count(bits):
    """Set bits of a uint64."""
    bits -= (bits >> np.uint64(1)) & np.uint64(0x5555555555555555)
    bits = (bits & np.uint64(0x3333333333333333)) + ((bits >> np.uint64(2)) & np.uint64(0x3333333333333333))
    bits = (bits + (bits >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (bits * np.uint64(0x0101010101010101)) >> np.uint64(56)


@njit(nogil=True)
def _pair_cost(window, form, upper, a, lower, b, shared):
    J = len(window)
    for j in range(J):
        for k in range(J):
            shared[j * J + k] = np.float64(_count(upper[a + j] & lower[b + k]))
    total = 0.0
    for m in range(J * J):
        part = 0.0
        for n in range(J * J):
            part += form[m, n] * shared[n]
        total += part * shared[m]
    return total


@njit(nogil=True)
def _own_cost(forms, row, a, shared):
    """Cost of the windows at a, and of their pairs with each other, in one row."""
    total = _pair_cost(forms.window, forms.pairs[a, 0], row, a, row, a, shared)
    for m in range(shared.size):
        total += forms.linear[a, m] * shared[m]
    return total


@njit(nogil=True)
def _element_cost(forms, sets, y, x, shared):
    """Cost of all pairs of windows of which one at least sees element x of row y."""
    window, J, reach, row = forms.window, len(forms.window), forms.pairs.shape[1], sets[y]
    total = 0.0
    for a in range(x - J + 1, x + 1):
        total += _own_cost(forms, row, a, shared)
        for distance in range(1, reach):
            total += _pair_cost(window, forms.pairs[a, distance], row, a, row, a + distance, shared)
            if a - distance < x - J + 1:  # else both windows see x, and the pair is counted from the other
                left = a - distance
                total += _pair_cost(window, forms.pairs[left, distance], row, left, row, a, shared)
    top = y - y % forms.rows
    for other in range(top, top + forms.rows):
        if other == y:
            continue
        for a in range(x - J + 1, x + 1):
            total += _pair_cost(window, forms.cross[a], row, a, sets[other], a, shared)
            for distance in range(1, reach):
                left = a - distance
                total += _pair_cost(window, forms.pairs[a, distance], row, a, sets[other], a + distance, shared)
                total += _pair_cost(window, forms.pairs[left, distance], sets[other], left, row, a, shared)
    return total


@njit(cache=True, nogil=True)
def budget_cost(forms, sets, begin, end):
    """Gram cost of a whole code, of the windows that begin at begin ≤ a < end."""
    window, shared = forms.window, np.empty(len(forms.window) ** 2)
    total = 0.0
    for y in range(sets.shape[0]):
        top = y - y % forms.rows
        for a in range(begin, end):
            total += _own_cost(forms, sets[y], a, shared)
            for distance in range(1, forms.pairs.shape[1]):
                total += _pair_cost(window, forms.pairs[a, distance], sets[y], a, sets[y], a + distance, shared)
            for other in range(top, top + forms.rows):
                if other > y:
                    total += _pair_cost(window, forms.cross[a], sets[y], a, sets[other], a, shared)
                if other != y:
                    for distance in range(1, forms.pairs.shape[1]):
                        form = forms.pairs[a, distance]
                        total += _pair_cost(window, form, sets[y], a, sets[other], a + distance, shared)
    return total


@njit(nogil=True)
def _place(forms, sets, y, x, value, nx):
    """Give element x of row y, and its copies in the margins of a tile, a set of shots."""
    at = x + forms.offset
    if forms.wrap:
        for i in range(at % nx, sets.shape[1], nx):
            sets[y, i] = value
    else:
        sets[y, at] = value


@njit(cache=True, nogil=True)
def budget_sweep(forms, field, stencil, weight, copies, sets, order, state):
    """Move one open shot of each of the elements `order` to where it is cheapest. Returns the change of cost, and the moves."""
    shots, _, nx = field.shape
    shared, one = np.empty(len(forms.window) ** 2), np.uint64(1)
    change, moves = 0.0, 0
    for place in order:
        y, x = place // nx, place % nx
        at = x + forms.offset
        old = sets[y, at]
        start = _element_cost(forms, sets, y, at, shared)
        best, taken, given, equal = 0.0, -1, -1, 1
        for p in range(shots):
            if not (old >> np.uint64(p)) & one:
                continue
            for q in range(shots):
                if (old >> np.uint64(q)) & one:
                    continue
                sets[y, at] = old ^ (one << np.uint64(p)) ^ (one << np.uint64(q))
                gain = _element_cost(forms, sets, y, at, shared) - start
                gain += 2 * weight * (field[q, y, x] - field[p, y, x] + copies)
                limit = 1e-9 * (1 + abs(start))
                if gain < best - limit:
                    best, taken, given, equal = gain, p, q, 1
                elif gain <= best + limit:
                    equal += 1  # at random among equals: rounding must not decide
                    if draw(state) % np.uint64(equal) == 0:
                        best, taken, given = gain, p, q
        sets[y, at] = old
        if taken >= 0:
            _place(forms, sets, y, x, old ^ (one << np.uint64(taken)) ^ (one << np.uint64(given)), nx)
            change += best
            moves += 1
            if weight != 0:
                spread_out(field[taken], y, x, stencil, -1.0, forms.wrap)
                spread_out(field[given], y, x, stencil, 1.0, forms.wrap)
    return change, moves
