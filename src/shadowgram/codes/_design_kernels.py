"""Kernels of the code design: costs of pairs of windows by lookup, and sweeps that give every element its best shot.

A code that opens every element in one shot is an array of labels, labels[y, i] = the shot; closed columns beside the code hold
-1. Column i of the labels and of the tables is the same place; both have margins so wide that no index needs a check.
`window` is a tuple of J zeros: its length is known to the compiler, which unrolls the loops over it.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from ._coupling_kernels import add_coupling, move_pairs, spread_out

_ALONE = 1 << 30  # a shot that no element is open in


class Lookup(NamedTuple):
    """Costs of pairs of windows, by which of their columns are open in the same shot.

    Attributes
    ----------
    window : tuple of J zeros.
    pairs : (column, distance, 2^(J²)) of windows in one row, by bit j·J + j' of "column j of the left window is open with column j'
        of the right one"; distance 0 has the costs of the diagonal in it.
    cross : (column, 2^(J²)) of the same window in two rows of one detector row.
    rows : code rows a detector row.
    offset : column of the tables where the code begins.
    wrap : whether the code is a tile.
    """

    window: tuple[int, ...]
    pairs: np.ndarray
    cross: np.ndarray
    rows: int
    offset: int
    wrap: bool


class Fields(NamedTuple):
    """What the elements of a code do to the cost of the others, kept up to date with every move.

    Attributes
    ----------
    repulsion : (shot, y, x) Σ of the stencil over the open elements of the shot around; weighted by `weight`.
    copies : what an element of a tile adds to the field where it is itself, by its copies.
    coupling : (y, distance, x) Σ of the kernel over the places around whose pair (x, x + distance) is open in the same shot;
        weighted by gains[distance]. Empty where there is no coupling.
    """

    repulsion: np.ndarray
    stencil: np.ndarray
    weight: float
    copies: float
    coupling: np.ndarray
    kernel: np.ndarray
    gains: np.ndarray


@njit(cache=True, nogil=True)
def expand(forms, linear, constant, tables):
    """tables[i, bits] = Eᵀ forms[i] E + linear[i]·E + constant[i] for every pattern of bits E."""
    for i in range(forms.shape[0]):
        tables[i, 0] = constant[i]
        for bits in range(1, tables.shape[1]):
            low = 0
            while not (bits >> low) & 1:
                low += 1
            rest = bits & (bits - 1)
            value = tables[i, rest] + forms[i, low, low] + linear[i, low]
            for other in range(low + 1, forms.shape[1]):
                if (rest >> other) & 1:
                    value += forms[i, low, other] + forms[i, other, low]
            tables[i, bits] = value


@njit(nogil=True, inline="always")
def _same(one, other):
    return np.int64(one == other and one >= 0)


@njit(nogil=True)
def _bits(window, upper, a, lower, b):
    """Which columns of the windows at a (row `upper`) and b (row `lower`) are open in the same shot."""
    bits = 0
    for j in range(len(window)):
        for jj in range(len(window)):
            bits |= _same(upper[a + j], lower[b + jj]) << (j * len(window) + jj)
    return bits


@njit(nogil=True)
def _add_far(window, costs, upper, x, lower, j, b, turned, scores):
    """Add what the windows x − j of row `upper` and b of row `lower` cost together if x is open in each shot, less if in none.

    Only the shots of the window at b differ from none: no loop over all shots is needed. `turned`: b comes first.
    """
    J = len(window)
    fixed = 0
    for jj in range(J):
        if jj != j:
            for k in range(J):
                fixed |= _same(upper[x - j + jj], lower[b + k]) << (k * J + jj if turned else jj * J + k)
    for k in range(J):
        shot = lower[b + k]
        seen = shot < 0
        for before in range(k):
            seen = seen or lower[b + before] == shot
        if seen:
            continue
        bits = fixed
        for after in range(k, J):
            bits |= _same(shot, lower[b + after]) << (after * J + j if turned else j * J + after)
        scores[shot] += costs[bits] - costs[fixed]


@njit(nogil=True)
def _add_near(window, pairs, row, x, scores):
    """Add what the pairs of windows cost that overlap, or are the same, and of which one at least sees x, less if x were in a
    shot of its own.
    """
    J = len(window)
    old = row[x]
    for distance in range(min(J, pairs.shape[1])):
        for a in range(x - J + 1 - distance, x + 1):
            b, costs = a + distance, pairs[a, distance]
            row[x] = _ALONE
            alone = costs[_bits(window, row, a, row, b)]
            for place in range(a, b + J):
                shot = row[place]
                seen = place == x or shot < 0
                for before in range(a, place):
                    seen = seen or row[before] == shot
                if not seen:
                    row[x] = shot
                    scores[shot] += costs[_bits(window, row, a, row, b)] - alone
                    row[x] = _ALONE
    row[x] = old


@njit(nogil=True)
def _add_gram(lookup, labels, y, x, scores):
    """Add the cost of all voxel pairs that element (y, x) takes part in, up to a constant, if it is open in each of the shots."""
    window, pairs = lookup.window, lookup.pairs
    J, reach, row = len(window), pairs.shape[1], labels[y]
    _add_near(window, pairs, row, x, scores)
    for j in range(J):
        a = x - j
        for distance in range(J, reach):
            right, left = a + distance, a - distance
            _add_far(window, pairs[a, distance], row, x, row, j, right, False, scores)
            _add_far(window, pairs[left, distance], row, x, row, j, left, True, scores)
    top = y - y % lookup.rows
    for other in range(top, top + lookup.rows):
        if other == y:
            continue
        for j in range(J):
            a = x - j
            _add_far(window, lookup.cross[a], row, x, labels[other], j, a, False, scores)
            for distance in range(1, reach):
                right, left = a + distance, a - distance
                _add_far(window, pairs[a, distance], row, x, labels[other], j, right, False, scores)
                _add_far(window, pairs[left, distance], row, x, labels[other], j, left, True, scores)


@njit(cache=True, nogil=True)
def gram_cost(lookup, labels, begin, end):
    """Gram cost of a whole code, of the windows that begin at begin ≤ a < end."""
    window, pairs = lookup.window, lookup.pairs
    total = 0.0
    for y in range(labels.shape[0]):
        top = y - y % lookup.rows
        for a in range(begin, end):
            for distance in range(pairs.shape[1]):
                total += pairs[a, distance, _bits(window, labels[y], a, labels[y], a + distance)]
            for other in range(top, top + lookup.rows):
                if other > y:
                    total += lookup.cross[a, _bits(window, labels[y], a, labels[other], a)]
                if other != y:
                    for distance in range(1, pairs.shape[1]):
                        total += pairs[a, distance, _bits(window, labels[y], a, labels[other], a + distance)]
    return total


@njit(nogil=True, inline="always")
def draw(state):
    """Next number of splitmix64, uint64."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(nogil=True)
def cheapest(scores, state):
    """Shot of the lowest score, at random among equals: rounding must not decide."""
    best = scores.min()
    limit = best + 1e-9 * (1 + abs(best))
    count, chosen = 0, 0
    for shot in range(scores.size):
        if scores[shot] <= limit:
            count += 1
            if draw(state) % np.uint64(count) == 0:
                chosen = shot
    return chosen


@njit(nogil=True)
def _move(lookup, fields, labels, y, x, new):
    """Open element (y, x) in the shot `new` instead of the one it is in."""
    old, at, nx = labels[y, x + lookup.offset], x + lookup.offset, fields.repulsion.shape[2]
    if fields.weight != 0:
        spread_out(fields.repulsion[old], y, x, fields.stencil, -1.0, lookup.wrap)
        spread_out(fields.repulsion[new], y, x, fields.stencil, 1.0, lookup.wrap)
    if fields.gains.size:
        move_pairs(fields.coupling, fields.kernel, labels[y], y, x, at, old, new, lookup.wrap)
    if lookup.wrap:
        for i in range(at % nx, labels.shape[1], nx):
            labels[y, i] = new
    else:
        labels[y, at] = new


@njit(nogil=True)
def _score(lookup, fields, labels, y, x, scores):
    """scores[q] = what element (y, x) costs if it is open in shot q, up to a constant."""
    scores[:] = 0
    _add_gram(lookup, labels, y, x + lookup.offset, scores)
    if fields.weight != 0:
        for shot in range(scores.size):
            scores[shot] += 2 * fields.weight * fields.repulsion[shot, y, x]
        scores[labels[y, x + lookup.offset]] -= 2 * fields.weight * fields.copies
    if fields.gains.size:
        add_coupling(
            fields.coupling, fields.kernel, fields.gains, labels[y], y, x, x + lookup.offset, lookup.wrap, scores
        )


@njit(cache=True, nogil=True)
def sweep(lookup, fields, labels, order, state):
    """Visit the elements `order` (y·width + x) and open each in its cheapest shot. Returns the change of cost and the moves."""
    shots, _, nx = fields.repulsion.shape
    scores = np.empty(shots)
    change, moves = 0.0, 0
    for place in order:
        y, x = place // nx, place % nx
        _score(lookup, fields, labels, y, x, scores)
        old, new = labels[y, x + lookup.offset], cheapest(scores, state)
        if new != old:
            change += scores[new] - scores[old]
            moves += 1
            _move(lookup, fields, labels, y, x, new)
    return change, moves


@njit(cache=True, nogil=True)
def exchange(lookup, fields, labels, order, partners):
    """Exchange the shots of element order[i] and of one of the elements (dy, dx) = partners away, where that lowers the cost most.

    Returns the change of cost and the exchanges. Every shot keeps its number of open elements.
    """
    shots, ny, nx = fields.repulsion.shape
    scores, others = np.empty(shots), np.empty(shots)
    change, exchanges = 0.0, 0
    for place in order:
        y, x = place // nx, place % nx
        _score(lookup, fields, labels, y, x, scores)
        old = labels[y, x + lookup.offset]
        best, partner = -1e-9 * (1 + abs(scores[old])), -1
        for i in range(partners.shape[0]):
            yy, xx = y + partners[i, 0], x + partners[i, 1]
            if lookup.wrap:
                yy, xx = yy % ny, xx % nx
            elif not (0 <= yy < ny and 0 <= xx < nx):
                continue
            new = labels[yy, xx + lookup.offset]
            if new == old:
                continue
            _move(
                lookup, fields, labels, y, x, new
            )  # the two may be neighbours: what the second costs depends on the first
            _score(lookup, fields, labels, yy, xx, others)
            gain = scores[new] - scores[old] + others[old] - others[new]
            _move(lookup, fields, labels, y, x, old)
            if gain < best:
                best, partner = gain, i
        if partner >= 0:
            yy, xx = (y + partners[partner, 0]) % ny, (x + partners[partner, 1]) % nx
            new = labels[yy, xx + lookup.offset]
            _move(lookup, fields, labels, y, x, new)
            _move(lookup, fields, labels, yy, xx, old)
            change += best
            exchanges += 1
    return change, exchanges
