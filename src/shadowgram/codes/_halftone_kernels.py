"""Kernels of void-and-cluster on a torus: energies of the classes, the emptiest place of each, exchanges of two elements.

Places are numbered row by row: place = y·nx + x. Energies are whole numbers, so adding and taking away elements leaves no
rounding behind, and every machine makes the same pattern. A stencil is an array of weights and its corner: weights[0, 0] belongs
to the place `corner` away from the element, and weights[-corner] to the element itself.

The smallest key is found in a tree of n leaves, nodes n … 2n − 1: node i holds the smaller of nodes 2i and 2i + 1, and node 1 the
smallest of all.
"""

import numpy as np
from numba import njit

TAKEN = np.iinfo(np.int64).max  # key of a place that can no longer be chosen


@njit(cache=True, nogil=True)
def _climb(tree, first, last):
    """Repair the ancestors of the nodes first … last."""
    while last > 1:
        first, last = max(first >> 1, 1), last >> 1
        # From the last to the first: unless n is a power of two, a node of this range can be the child of another.
        for i in range(last, first - 1, -1):
            tree[i] = min(tree[2 * i], tree[2 * i + 1])


@njit(cache=True, nogil=True)
def grow(tree, keys):
    """Fill a tree with keys, in the order of the places."""
    n = keys.size
    tree[n:] = keys
    for i in range(n - 1, 0, -1):
        tree[i] = min(tree[2 * i], tree[2 * i + 1])


@njit(cache=True, nogil=True)
def _smallest(tree):
    n = tree.size // 2
    i = 1
    while i < n:
        i = 2 * i if tree[2 * i] == tree[1] else 2 * i + 1
    return i - n


@njit(cache=True, nogil=True)
def _bar(tree, place):
    leaf = tree.size // 2 + place
    tree[leaf] = TAKEN
    _climb(tree, leaf, leaf)


@njit(cache=True, nogil=True)
def _raise_keys(tree, nx, place, weights, corner):
    """Add the weights around a place to the keys of the places that can be chosen."""
    n = tree.size // 2
    ny = n // nx
    high, wide = weights.shape
    top, left = (place // nx + corner[0]) % ny, (place % nx + corner[1]) % nx
    for i in range(high):
        row = n + (top + i) % ny * nx
        for j in range(wide):
            leaf = row + left + j if left + j < nx else row + left + j - nx
            if tree[leaf] != TAKEN:
                tree[leaf] += weights[i, j]
        _climb(tree, row + left, row + min(left + wide, nx) - 1)
        if left + wide > nx:
            _climb(tree, row, row + left + wide - nx - 1)


@njit(cache=True, nogil=True)
def fill(turns, labels, trees, weights, corner):
    """Give the classes in turn the free place where their energy, the key, is smallest: their largest void."""
    for q in turns:
        place = _smallest(trees[q])
        labels.flat[place] = q
        for k in range(trees.shape[0]):
            _bar(trees[k], place)
        _raise_keys(trees[q], labels.shape[1], place, weights, corner)


@njit(cache=True, nogil=True)
def take(places, tree, nx, weights, corner):
    """Choose the smallest key, raise the keys around it, again and again; write the places down."""
    for i in range(places.size):
        places[i] = _smallest(tree)
        _bar(tree, places[i])
        _raise_keys(tree, nx, places[i], weights, corner)


@njit(cache=True, nogil=True)
def _add_row(field, row, column, count, sign, weights, i, j):
    # Unsigned offsets: an index that may be negative keeps a loop scalar.
    u, v = np.uintp(column), np.uintp(j)
    for k in range(count):
        field[row, u + np.uintp(k)] += sign * weights[i, v + np.uintp(k)]


@njit(cache=True, nogil=True)
def _add(field, y, x, sign, weights, corner):
    ny, nx = field.shape
    high, wide = weights.shape
    top, left = (y + corner[0]) % ny, (x + corner[1]) % nx
    before_seam = min(wide, nx - left)
    for i in range(high):
        row = (top + i) % ny
        _add_row(field, row, left, before_seam, sign, weights, i, 0)
        _add_row(field, row, 0, wide - before_seam, sign, weights, i, before_seam)


@njit(cache=True, nogil=True)
def add_open(pattern, field, weights, corner):
    """Add the weights around every open element."""
    for y in range(pattern.shape[0]):
        for x in range(pattern.shape[1]):
            if pattern[y, x]:
                _add(field, y, x, 1, weights, corner)


@njit(cache=True, nogil=True)
def _best_exchange(labels, fields, y, x, near, corner):
    """(y, x) of the element nearby whose exchange with the one at (y, x) lowers the energy most, or (−1, −1).

    With E_i(a) the energy of class i at place a, exchanging a of class i and b of class j lowers half the energy by
    E_i(a) − E_j(a) + E_j(b) − E_i(b) − 2w(0) + 2w(b − a).
    """
    ny, nx = labels.shape
    i = labels[y, x]
    self_weight = near[-corner[0], -corner[1]]
    best, best_y, best_x = 0, -1, -1
    for u in range(near.shape[0]):
        v = (y + corner[0] + u) % ny
        for s in range(near.shape[1]):
            h = (x + corner[1] + s) % nx
            j = labels[v, h]
            if j != i:
                gain = fields[i, y, x] - fields[j, y, x] + fields[j, v, h] - fields[i, v, h]
                gain += 2 * (near[u, s] - self_weight)
                if gain > best:
                    best, best_y, best_x = gain, v, h
    return best_y, best_x


@njit(cache=True, nogil=True)
def sweep(order, skip, labels, fields, near, near_corner, weights, corner):
    """Exchange each element, in this order, with its best partner nearby; return the number of exchanges.

    Elements of class `skip` are partners only.
    """
    exchanges = 0
    nx = labels.shape[1]
    for place in order:
        y, x = place // nx, place % nx
        i = labels[y, x]
        if i == skip:
            continue
        v, h = _best_exchange(labels, fields, y, x, near, near_corner)
        if v < 0:
            continue
        j = labels[v, h]
        labels[y, x], labels[v, h] = j, i
        _add(fields[i], y, x, -1, weights, corner)
        _add(fields[j], y, x, 1, weights, corner)
        _add(fields[j], v, h, -1, weights, corner)
        _add(fields[i], v, h, 1, weights, corner)
        exchanges += 1
    return exchanges
