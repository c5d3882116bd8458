"""Whether the loops of an outline keep apart."""

from __future__ import annotations

from numba import njit


@njit(cache=True, nogil=True)
def _side(edges, i, x, y):
    """Twice the area of edge i and a point: positive if it lies to the left."""
    ax, ay = edges[i, 0], edges[i, 1]
    return (edges[i, 2] - ax) * (y - ay) - (edges[i, 3] - ay) * (x - ax)


@njit(cache=True, nogil=True)
def _boxes_meet(edges, i, j):
    """Whether the boxes around two edges meet."""
    for k in range(2):
        if max(edges[i, k], edges[i, k + 2]) < min(edges[j, k], edges[j, k + 2]):
            return False
        if max(edges[j, k], edges[j, k + 2]) < min(edges[i, k], edges[i, k + 2]):
            return False
    return True


@njit(cache=True, nogil=True)
def _folds_back(edges, i, j):
    """Whether edge j, which begins where edge i ends, runs back over it."""
    ux, uy = edges[i, 2] - edges[i, 0], edges[i, 3] - edges[i, 1]
    vx, vy = edges[j, 2] - edges[j, 0], edges[j, 3] - edges[j, 1]
    return ux * vy - uy * vx == 0.0 and ux * vx + uy * vy < 0.0


@njit(cache=True, nogil=True)
def _follows(edges, i, j):
    """Whether edge j begins where edge i ends."""
    return edges[i, 2] == edges[j, 0] and edges[i, 3] == edges[j, 1]


@njit(cache=True, nogil=True)
def _meet(edges, i, j):
    """Whether two edges cross or touch."""
    a, b = _side(edges, i, edges[j, 0], edges[j, 1]), _side(edges, i, edges[j, 2], edges[j, 3])
    c, d = _side(edges, j, edges[i, 0], edges[i, 1]), _side(edges, j, edges[i, 2], edges[i, 3])
    return min(a, b) <= 0.0 <= max(a, b) and min(c, d) <= 0.0 <= max(c, d)


@njit(cache=True, nogil=True)
def first_contact(edges):
    """The first two edges that cross or touch and are not neighbours, or are and run back over one another; (−1, −1) if none."""
    count = edges.shape[0]
    for i in range(count):
        for j in range(i + 1, count):
            if not _boxes_meet(edges, i, j):
                continue
            after, before = _follows(edges, i, j), _follows(edges, j, i)
            if after or before:
                if (after and _folds_back(edges, i, j)) or (before and _folds_back(edges, j, i)):
                    return i, j
            elif _meet(edges, i, j):
                return i, j
    return -1, -1
