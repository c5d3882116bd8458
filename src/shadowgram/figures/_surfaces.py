"""Surfaces of the solids of an X-ray scene as polygons in the world, mm."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from shadowgram.xray._placed import Placed
from shadowgram.xray.montecarlo import arrays

Floats = NDArray[np.float64]
Polygons = list[Floats]

_AROUND = 40  # corners of a circle
_CELLS = 40  # voxels along a side, at most
# The sides of a cuboid as corners of the unit cube.
_SIDES = np.array([
    [[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0]],
    [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],
    [[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]],
    [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]],
    [[0, 1, 0], [0, 1, 1], [1, 1, 1], [1, 1, 0]],
    [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
], dtype=float)  # fmt: skip


def surface(placed: Placed, filled: NDArray[np.bool_] | None = None) -> Polygons:
    """The surface of a solid, each polygon (corner, 3).

    Parameters
    ----------
    filled : (material,) which materials are to be seen; of voxels, and of them alone.
    """
    if placed.kind == arrays.MESH:
        return list(placed.vertices[placed.faces])
    own = _OWN[placed.kind](placed) if filled is None else _voxels(placed, filled)
    return [polygon @ placed.turn + placed.origin for polygon in own]


def cuboid(low: Floats, high: Floats) -> Polygons:
    """The sides of a box between two corners."""
    return list(low + _SIDES * (high - low))


def _box(placed: Placed) -> Polygons:
    return cuboid(-placed.size, placed.size)


def _ellipsoid(placed: Placed) -> Polygons:
    around = np.linspace(0, 2 * np.pi, _AROUND + 1)
    down = np.linspace(0, np.pi, _AROUND // 2 + 1)[:, None]
    points = placed.size * np.stack(
        [np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down) + 0 * around], axis=-1
    )
    return list(_quads(points))


def _cylinder(placed: Placed) -> Polygons:
    around = np.linspace(0, 2 * np.pi, _AROUND + 1)
    rim = placed.size[0] * np.stack([np.cos(around), np.sin(around), 0 * around], axis=-1)
    along = np.array([0, 0, placed.size[2]])
    ends = np.stack([rim - along, rim + along])
    return [*_quads(ends), ends[0, :-1], ends[1, :-1]]


def _quads(points: Floats) -> Floats:
    """(quad, 4, 3) of a grid of points."""
    return np.stack([points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]], axis=2).reshape(-1, 4, 3)


def _outline(placed: Placed) -> Polygons:
    height = placed.size[2]
    found = []
    for loop in placed.loops:
        start, stop = loop, np.roll(loop, -1, axis=0)
        for (x0, y0), (x1, y1) in zip(start, stop, strict=True):
            found.append(np.array([[x0, y0, -height], [x1, y1, -height], [x1, y1, height], [x0, y0, height]]))
    for flat in _trapezoids(placed.loops):
        found += [np.c_[flat, np.full(len(flat), z)] for z in (-height, height)]
    return found


def _trapezoids(loops: tuple[Floats, ...]) -> Polygons:
    """What lies inside loops, cut along x at every corner: (4, 2) each."""
    edges = np.concatenate([np.c_[loop, np.roll(loop, -1, axis=0)] for loop in loops])
    edges = np.where((edges[:, 1] > edges[:, 3])[:, None], edges[:, [2, 3, 0, 1]], edges)  # upwards
    levels = np.unique(edges[:, 1::2])
    found = []
    for low, high in pairwise(levels):
        x0, y0, x1, y1 = edges[(edges[:, 1] <= low) & (edges[:, 3] >= high)].T
        slope = (x1 - x0) / (y1 - y0)
        left, right = x0 + slope * (low - y0), x0 + slope * (high - y0)
        order = np.lexsort((left + right,))
        for i, j in zip(order[::2], order[1::2], strict=True):
            found.append(np.array([[left[i], low], [left[j], low], [right[j], high], [right[i], high]]))
    return found


def _voxels(placed: Placed, filled: NDArray[np.bool_]) -> Polygons:
    """The sides between cells that are to be seen and others, of every n-th cell."""
    step = -(-np.array(placed.cells.shape) // _CELLS)
    seen = np.pad(filled[placed.cells[:: step[0], :: step[1], :: step[2]]], 1)
    pitch = placed.size / (np.array(seen.shape) - 2)
    found = []
    for axis in range(3):
        for way, side in ((1, _SIDES[axis]), (-1, _SIDES[axis + 3])):
            bare = seen & ~np.roll(seen, way, axis=axis)
            found += list((np.argwhere(bare)[:, None, :] - 1 + side) * pitch)
    return found


_OWN: dict[int, Callable[[Placed], Polygons]] = {
    arrays.BOX: _box,
    arrays.ELLIPSOID: _ellipsoid,
    arrays.CYLINDER: _cylinder,
    arrays.OUTLINE: _outline,
}
