"""Building the tree of boxes over a mesh: the binned surface-area heuristic of Wald (IEEE Symp. Interactive Ray Tracing, 2007)."""

from __future__ import annotations

import numpy as np
from numba import njit

LEAF = 4
"""Most triangles in a leaf."""

_BINS = 16
_DEEPEST_BY_AREA = 32  # below, ranges are halved, which bounds the depth by 32 + log₂ of the triangles
_BOX_COST = 2.0  # of a pair of boxes, in triangle tests, as measured by benchmarks/xray_bodies.py


@njit(cache=True, nogil=True)
def _bounds(boxes, order, start, stop, out):
    """The box around the boxes of a range of triangles."""
    out[:3] = np.inf
    out[3:] = -np.inf
    for i in range(start, stop):
        for k in range(3):
            out[k] = min(out[k], boxes[order[i], k])
            out[3 + k] = max(out[3 + k], boxes[order[i], 3 + k])


@njit(cache=True, nogil=True)
def _area(box):
    """Half the surface of a box; 0 for an empty one."""
    x, y, z = box[3] - box[0], box[4] - box[1], box[5] - box[2]
    return x * y + y * z + z * x if x >= 0.0 else 0.0


@njit(cache=True, nogil=True)
def _centre(boxes, triangle, axis):
    """Twice the coordinate of a triangle's box centre."""
    return boxes[triangle, axis] + boxes[triangle, 3 + axis]


@njit(cache=True, nogil=True)
def _spread(boxes, order, start, stop, axis):
    """(Lowest, highest) of the centres of a range."""
    low, high = np.inf, -np.inf
    for i in range(start, stop):
        c = _centre(boxes, order[i], axis)
        low, high = min(low, c), max(high, c)
    return low, high


@njit(cache=True, nogil=True)
def _bin(value, low, scale):
    """The bin of a centre."""
    return min(int((value - low) * scale), _BINS - 1)


@njit(cache=True, nogil=True)
def _filled(boxes, order, start, stop, axis, low, scale, bins, counts):
    """Sort a range into bins along an axis: the box and the number of triangles of each."""
    counts[:] = 0
    bins[:, :3] = np.inf
    bins[:, 3:] = -np.inf
    for i in range(start, stop):
        triangle = order[i]
        b = _bin(_centre(boxes, triangle, axis), low, scale)
        counts[b] += 1
        for k in range(3):
            bins[b, k] = min(bins[b, k], boxes[triangle, k])
            bins[b, 3 + k] = max(bins[b, 3 + k], boxes[triangle, 3 + k])


@njit(cache=True, nogil=True)
def _grow(box, other):
    """Make a box hold another."""
    for k in range(3):
        box[k] = min(box[k], other[k])
        box[3 + k] = max(box[3 + k], other[3 + k])


@njit(cache=True, nogil=True)
def _best_cut(bins, counts, right, box):
    """(Σ area · triangles, first bin on the right) of the cheapest cut between bins."""
    box[:3] = np.inf
    box[3:] = -np.inf
    count = 0
    for b in range(_BINS - 1, 0, -1):
        _grow(box, bins[b])
        count += counts[b]
        right[b] = _area(box) * count
    box[:3] = np.inf
    box[3:] = -np.inf
    count, total = 0, counts.sum()
    best, cut = np.inf, 0
    for b in range(1, _BINS):
        _grow(box, bins[b - 1])
        count += counts[b - 1]
        cost = _area(box) * count + right[b]
        if 0 < count < total and cost < best:
            best, cut = cost, b
    return best, cut


@njit(cache=True, nogil=True)
def _chosen(boxes, order, start, stop, bins, counts, right, box):
    """(Cost, axis, lowest centre, bins per length, cut) of the cheapest cut of a range; cut 0 if all centres coincide."""
    best, axis, origin, per_length, cut = np.inf, 0, 0.0, 0.0, 0
    for k in range(3):
        low, high = _spread(boxes, order, start, stop, k)
        if high <= low:
            continue
        scale = _BINS / (high - low)
        if not np.isfinite(scale):
            continue
        _filled(boxes, order, start, stop, k, low, scale, bins, counts)
        cost, place = _best_cut(bins, counts, right, box)
        if cost < best:
            best, axis, origin, per_length, cut = cost, k, low, scale, place
    return best, axis, origin, per_length, cut


@njit(cache=True, nogil=True)
def _parted(boxes, order, start, stop, axis, low, scale, cut):
    """Bring the triangles left of the cut to the front of a range; where the others begin."""
    i, j = start, stop
    while i < j:
        if _bin(_centre(boxes, order[i], axis), low, scale) < cut:
            i += 1
        else:
            j -= 1
            order[i], order[j] = order[j], order[i]
    return i


@njit(cache=True, nogil=True)
def grow_tree(boxes, order, node_box, node_child):
    """Build the tree over all `boxes` (triangle, 6); the number of nodes.

    `order`, the numbers of the triangles, is sorted so that a leaf is a range of it. `node_box` (node, 6) and `node_child`
    (node, 2) have room for 2 · triangles − 1 nodes and are filled as in `Meshes`: node 0 is the root, siblings lie side by side.
    """
    bins, counts, right, box = np.empty((_BINS, 6)), np.empty(_BINS, np.int64), np.empty(_BINS), np.empty(6)
    waiting = np.empty((96, 4), np.int64)
    waiting[0] = (0, 0, order.size, 0)
    top, nodes = 1, 1
    while top:
        top -= 1
        node, start, stop, depth = waiting[top]
        count = stop - start
        _bounds(boxes, order, start, stop, node_box[node])
        middle = -1
        if count > 1 and depth < _DEEPEST_BY_AREA:
            cost, axis, low, scale, cut = _chosen(boxes, order, start, stop, bins, counts, right, box)
            if cut and (count > LEAF or cost + _BOX_COST * _area(node_box[node]) < count * _area(node_box[node])):
                middle = _parted(boxes, order, start, stop, axis, low, scale, cut)
        if middle < 0 and count > LEAF:
            middle = (start + stop) // 2
        if middle < 0:
            node_child[node] = (-1 - start, count)
            continue
        node_child[node] = (nodes, nodes + 1)
        waiting[top] = (nodes + 1, middle, stop, depth + 1)
        waiting[top + 1] = (nodes, start, middle, depth + 1)
        top += 2
        nodes += 2
    return nodes
