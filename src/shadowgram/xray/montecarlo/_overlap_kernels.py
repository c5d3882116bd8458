"""Whether two closed meshes share a volume, found from faces drawn a little into their own bodies."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from ._mesh_kernels import STACK, mesh_inside, net_crossing

_SHRINK = 50.0  # in depths: how far a drawn-in face keeps from its edges, so that it stays within wedges of 3° and more


@njit(cache=True, nogil=True, error_model="numpy")
def _drawn_in(row, depth, corner):
    """Move a face by `depth` against its normal and its edges inwards, into `corner` (3, 3); false if it has no area."""
    a, b, c = row[0:3], row[0:3] + row[3:6], row[0:3] + row[6:9]
    normal = np.cross(row[3:6], row[6:9])
    twice_area = math.sqrt((normal * normal).sum())
    la, lb, lc = math.sqrt(((c - b) ** 2).sum()), math.sqrt(((a - c) ** 2).sum()), math.sqrt(((b - a) ** 2).sum())
    around = la + lb + lc
    if not twice_area > 1e-14 * around * around:
        return False
    centre = (la * a + lb * b + lc * c) / around
    radius = twice_area / around
    scale = 1.0 - min(_SHRINK * depth / radius, 0.5)
    centre_in = centre - depth / twice_area * normal
    corner[0] = centre_in + scale * (a - centre)
    corner[1] = centre_in + scale * (b - centre)
    corner[2] = centre_in + scale * (c - centre)
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _apart(corner, box):
    """Whether the box around three corners misses a box."""
    apart = False
    for k in range(3):
        apart |= corner[:, k].max() < box[k] or corner[:, k].min() > box[3 + k]
    return apart


@njit(cache=True, nogil=True, error_model="numpy")
def reaches_into(triangle, meshes, depth):
    """Whether a face of a closed mesh (`triangle` as in `Meshes`), drawn into its body by `depth`, has a part inside mesh 0.

    Two bodies that share a volume deeper than `depth` have such a face in one of them: from a place inside both, go
    straight on to the first surface; just before it one is still inside the other body. Bodies that only touch have none.
    """
    stack, corner = np.empty(STACK, np.int64), np.empty((3, 3))
    box = meshes.node_box[meshes.root[0]]
    for i in range(triangle.shape[0]):
        if not _drawn_in(triangle[i], depth, corner) or _apart(corner, box):
            continue
        for k in range(3):
            p, d = corner[k], corner[(k + 1) % 3] - corner[k]
            t, change = net_crossing(meshes, 0, stack, p[0], p[1], p[2], d[0], d[1], d[2], 0.0, False)
            if (t < 1.0 and change != 0) or mesh_inside(meshes, 0, stack, p[0], p[1], p[2], d[0], d[1], d[2]):
                return True
    return False
